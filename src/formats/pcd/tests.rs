//! PCD files made in memory: all encodings, packed colours, padding, damage.

use crate::formats::{FormatError, PointSource, ReadOptions, open};
use crate::points::Column;

const NAMES: &str = "FIELDS x y z rgb intensity normal_x hist _ label rgba\n";
const TYPES: &str = "SIZE 4 8 4 4 4 4 2 1 1 4\nTYPE F F I F F F U U U U\nCOUNT 1 1 1 1 1 1 2 3 1 1\n";

fn header(data: &str) -> String {
    format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n{NAMES}{TYPES}WIDTH 10\nHEIGHT 2\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 20\nDATA {data}\n"
    )
}

/// The bytes of the fields of point `i`.
fn fields(i: u8) -> Vec<Vec<u8>> {
    let v = f32::from(i);
    let colour = u32::from_be_bytes([99, i, 100 + i, 200]);
    vec![
        v.to_le_bytes().to_vec(),
        (f64::from(i) * -0.5).to_le_bytes().to_vec(),
        i32::from(i).to_le_bytes().to_vec(),
        colour.to_le_bytes().to_vec(),
        (v / 8.0).to_le_bytes().to_vec(),
        1_f32.to_le_bytes().to_vec(),
        [u16::from(i).to_le_bytes(), 999_u16.to_le_bytes()].concat(),
        vec![7; 3],
        vec![i / 2],
        colour.to_le_bytes().to_vec(),
    ]
}

fn binary() -> Vec<u8> {
    let mut file = header("binary").into_bytes();
    file.extend((0..20).flat_map(|i| fields(i).concat()));
    file
}

/// LZF without a copy: literal runs are valid, too.
fn stored(plain: &[u8]) -> Vec<u8> {
    plain.chunks(32).flat_map(|c| [&[c.len() as u8 - 1], c].concat()).collect()
}

fn compressed() -> Vec<u8> {
    let rows: Vec<_> = (0..20).map(fields).collect();
    let plain: Vec<u8> = (0..10).flat_map(|f| rows.iter().flat_map(move |r| r[f].clone())).collect();
    let packed = stored(&plain);
    let sizes = [(packed.len() as u32).to_le_bytes(), (plain.len() as u32).to_le_bytes()].concat();
    [header("binary_compressed").into_bytes(), sizes, packed].concat()
}

fn ascii() -> Vec<u8> {
    let mut text = header("ascii");
    for i in 0..20_u8 {
        let colour = u32::from_be_bytes([99, i, 100 + i, 200]);
        let v = f64::from(i);
        // Both ways of writers: the float of those bits, and the integer.
        let packed = if i % 2 == 0 { format!("{:e}", f32::from_bits(colour)) } else { colour.to_string() };
        text += &format!("{v} {} {i} {packed} {} 1 {i} 999 7 7 7 {} {colour}\n", v * -0.5, v / 8.0, i / 2);
    }
    text.into_bytes()
}

/// A file of each encoding, 20 points each.
pub fn samples() -> Vec<Vec<u8>> {
    vec![binary(), compressed(), ascii()]
}

fn try_opened(content: &[u8]) -> Result<Box<dyn PointSource>, FormatError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.pcd");
    std::fs::write(&path, content).unwrap();
    open(&path, &ReadOptions::default())
}

fn records(source: &dyn PointSource) -> Result<Vec<u8>, FormatError> {
    let mut all = Vec::new();
    for piece in source.pieces(7) {
        let mut sink = |run: &[u8]| {
            all.extend_from_slice(run);
            true
        };
        let tally = source.read(piece, &mut sink)?;
        assert_eq!(tally.read + tally.truncated, piece.records);
    }
    Ok(all)
}

fn column(source: &dyn PointSource, name: &str) -> Column {
    let layout = &source.info().layout;
    let i = layout.attributes.iter().position(|a| a.name == name).unwrap_or_else(|| panic!("no {name}"));
    let mut column = Column::with_capacity(layout.attributes[i].ty, 0);
    layout.extract(i, records(source).unwrap().chunks_exact(layout.stride()).map(|r| &r[24..]), &mut column);
    column
}

#[test]
fn all_encodings_give_the_same_points() {
    let expected = [
        "Alpha u8",
        "Blue u8",
        "Blue.2 u8",
        "Green u8",
        "Green.2 u8",
        "Intensity f32",
        "NormalX f32",
        "Red u8",
        "Red.2 u8",
        "hist[0] u16",
        "hist[1] u16",
        "label u8",
    ];
    let reference = records(&*try_opened(&binary()).unwrap()).unwrap();
    for file in [binary(), compressed(), ascii()] {
        let source = try_opened(&file).unwrap();
        let info = source.info();
        assert_eq!((info.records, info.missing, info.format), (20, 0, "pcd"));
        let found: Vec<_> = info.layout.attributes.iter().map(|a| format!("{} {}", a.name, a.ty.word())).collect();
        assert_eq!(found, expected);
        assert!(records(&*source).unwrap() == reference);
        let all = records(&*source).unwrap();
        let third = &all[3 * info.layout.stride()..];
        let p: [f64; 3] = std::array::from_fn(|i| f64::from_le_bytes(third[8 * i..8 * i + 8].try_into().unwrap()));
        assert_eq!(p, [3.0, -1.5, 3.0]);
        for (name, value) in
            [("Red", 3.0), ("Green", 103.0), ("Blue", 200.0), ("Alpha", 99.0), ("hist[1]", 999.0), ("label", 1.0)]
        {
            assert_eq!(column(&*source, name).as_f64(3), value, "{name}");
        }
    }
}

#[test]
fn the_viewpoint_is_the_pose() {
    let file = String::from_utf8(ascii()).unwrap().replace("VIEWPOINT 0 0 0 1 0 0 0", "VIEWPOINT 10 20 30 0 0 0 1");
    let source = try_opened(file.as_bytes()).unwrap();
    let all = records(&*source).unwrap();
    let third = &all[3 * source.info().layout.stride()..];
    let p: [f64; 3] = std::array::from_fn(|i| f64::from_le_bytes(third[8 * i..8 * i + 8].try_into().unwrap()));
    assert_eq!(p, [7.0, 21.5, 33.0]);
    assert!(source.info().warnings[0].contains("VIEWPOINT"));
}

#[test]
fn cut_files_give_their_whole_points() {
    for file in [binary(), ascii()] {
        let data = file.windows(5).position(|w| w == b"DATA ").unwrap() + 20;
        let whole = records(&*try_opened(&file).unwrap()).unwrap();
        for length in (data..file.len()).step_by(11) {
            let source = try_opened(&file[..length]).unwrap();
            assert_eq!(source.info().records + source.info().missing, 20);
            let all = records(&*source).unwrap();
            // The last number of a text may be cut and still be a number.
            let certain = all.len().saturating_sub(source.info().layout.stride());
            assert!(all[..certain] == whole[..certain], "{length}");
        }
    }
    // Compressed points come all or not at all.
    let file = compressed();
    assert!(try_opened(&file[..file.len() - 1]).err().unwrap().to_string().contains("compressed bytes, found"));
    let mut bent = file.clone();
    let last = bent.len() - 33;
    bent[last] = 255;
    assert!(records(&*try_opened(&bent).unwrap()).unwrap_err().to_string().contains("bytes compressed by LZF"));
}

#[test]
fn bad_headers_are_refused_with_their_place() {
    let good = String::from_utf8(ascii()).unwrap();
    let cases = [
        ("FIELDS x y z", "FIELDS x y w", "expected fields x, y and z, found x, y, w, rgb"),
        ("TYPE F F I", "TYPE F F Q", "expected FIELDS, SIZE, TYPE and COUNT before it that agree"),
        ("COUNT 1 1", "COUNT 1 -1", "expected a count of each field"),
        ("COUNT 1 1", "COUNT 1 99999999999", "that agree"),
        ("DATA ascii", "DATA zip", "expected DATA ascii, binary or binary_compressed"),
        ("WIDTH 10", "WIDTH ten", "expected a number, found `WIDTH ten`"),
        ("VIEWPOINT 0 0 0 1", "VIEWPOINT 0 0 0 0", "the quaternion is zero"),
        ("HEIGHT 2", "HAIGHT 2", "expected a line of a PCD header, found `HAIGHT 2`"),
    ];
    for (from, to, expected) in cases {
        let error = try_opened(good.replacen(from, to, 1).as_bytes()).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(expected), "{to}: {error}");
    }
    let error = try_opened(b"# .PCD v0.7\nVERSION 0.7\n").err().unwrap().to_string();
    assert!(error.contains("at byte 24: expected a DATA line, found the end of the header"), "{error}");
}
