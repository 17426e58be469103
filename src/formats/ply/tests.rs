//! PLY files made in memory: all encodings, odd headers, cut data.

use crate::formats::{FormatError, Piece, PointSource, ReadOptions, Tally, open};
use crate::points::{Column, ScalarType};

fn try_opened(content: &[u8]) -> Result<Box<dyn PointSource>, FormatError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sample.ply");
    std::fs::write(&path, content).unwrap();
    open(&path, &ReadOptions::default())
}

fn opened(content: &[u8]) -> Box<dyn PointSource> {
    try_opened(content).unwrap_or_else(|e| panic!("{e}"))
}

fn refusal(content: &[u8]) -> String {
    try_opened(content).err().map_or_else(|| "opened".to_owned(), |e| e.to_string())
}

fn records(source: &dyn PointSource, target: u64) -> Result<(Vec<u8>, Tally), FormatError> {
    let mut all = Vec::new();
    let mut sum = Tally::default();
    for piece in source.pieces(target) {
        let mut sink = |run: &[u8]| {
            all.extend_from_slice(run);
            true
        };
        let tally = source.read(piece, &mut sink)?;
        sum.read += tally.read;
        sum.truncated += tally.truncated;
    }
    Ok((all, sum))
}

/// One column of all records; `x`, `y`, `z` are the coordinates.
fn column(source: &dyn PointSource, name: &str) -> Column {
    let (all, _) = records(source, 7).unwrap();
    let layout = &source.info().layout;
    let rows = all.chunks_exact(layout.stride());
    if let Some(axis) = ["x", "y", "z"].iter().position(|a| *a == name) {
        let world = |r: &[u8]| f64::from_le_bytes(r[8 * axis..8 * axis + 8].try_into().unwrap());
        return Column::F64(rows.map(world).collect());
    }
    let i = layout.attributes.iter().position(|a| a.name == name).unwrap_or_else(|| panic!("no {name}"));
    let mut column = Column::with_capacity(layout.attributes[i].ty, 0);
    layout.extract(i, rows.map(|r| &r[24..]), &mut column);
    column
}

const TYPES: [(&str, ScalarType); 16] = [
    ("char", ScalarType::I8),
    ("int8", ScalarType::I8),
    ("uchar", ScalarType::U8),
    ("uint8", ScalarType::U8),
    ("short", ScalarType::I16),
    ("int16", ScalarType::I16),
    ("ushort", ScalarType::U16),
    ("uint16", ScalarType::U16),
    ("int", ScalarType::I32),
    ("int32", ScalarType::I32),
    ("uint", ScalarType::U32),
    ("uint32", ScalarType::U32),
    ("float", ScalarType::F32),
    ("float32", ScalarType::F32),
    ("double", ScalarType::F64),
    ("float64", ScalarType::F64),
];

/// A file of 20 vertices with one property `p{i}` per type and, in the middle, x, y, z of type `axis`; value `i + 3 j`.
fn sample(format: &str, axis: usize, list: bool) -> Vec<u8> {
    let mut header =
        format!("ply\nformat {format} 1.0\ncomment none\nelement first 2\nproperty uchar a\nproperty short b\n");
    header += "element other 1\nproperty list uchar int indices\nelement vertex 20\n";
    let mut types = Vec::new();
    for (i, (word, ty)) in TYPES.iter().enumerate() {
        if i == 9 {
            for name in ["x", "y", "z"] {
                header += &format!("property {} {name}\n", TYPES[axis].0);
                types.push(TYPES[axis].1);
            }
            if list {
                header += "property list uchar ushort neighbours\n";
            }
        }
        header += &format!("property {word} p{i}\n");
        types.push(*ty);
    }
    header += "element face 3\nproperty list uchar int vertex_indices\nend_header\n";
    let mut file = header.into_bytes();
    let mut put = |value: usize, ty: ScalarType, after: &str| {
        if format == "ascii" {
            file.extend(format!("{value}{after}").bytes());
            return;
        }
        let mut raw = match ty {
            ScalarType::F32 => (value as f32).to_le_bytes().to_vec(),
            ScalarType::F64 => (value as f64).to_le_bytes().to_vec(),
            _ => value.to_le_bytes()[..ty.size()].to_vec(),
        };
        if format == "binary_big_endian" {
            raw.reverse();
        }
        file.extend(raw);
    };
    for a in [1, 3] {
        put(a, ScalarType::U8, " ");
        put(a + 1, ScalarType::I16, "\n");
    }
    put(2, ScalarType::U8, " ");
    put(77, ScalarType::I32, " ");
    put(78, ScalarType::I32, "\r\n");
    for i in 0..20 {
        for (j, ty) in types.iter().enumerate() {
            if list && j == 12 {
                put(i % 3, ScalarType::U8, "\t");
                (0..i % 3).for_each(|k| put(k, ScalarType::U16, " "));
            }
            put(i + 3 * j, *ty, if j + 1 < types.len() { " " } else { " \n" });
        }
    }
    file
}

#[test]
fn every_type_comes_back_in_every_encoding() {
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for axis in 0..TYPES.len() {
            for list in [false, true] {
                let source = opened(&sample(format, axis, list));
                let info = source.info();
                assert_eq!((info.records, info.missing), (20, 0), "{format}");
                let lost = info.warnings.join("; ");
                assert!(lost.contains("3 records of element `face` are not kept") && lost.contains("`first`"));
                assert_eq!(lost.contains("list property `neighbours`"), list);
                for (place, name) in ["x", "y", "z"].iter().enumerate() {
                    let expected = (0..20).map(|i| f64::from(i + 3 * (9 + place as i32))).collect();
                    assert_eq!(column(&*source, name), Column::F64(expected), "{format} {axis} {list}");
                }
                for (i, (_, ty)) in TYPES.iter().enumerate() {
                    let values = column(&*source, &format!("p{i}"));
                    assert_eq!(values.ty(), *ty);
                    let j = if i < 9 { i } else { i + 3 };
                    assert!((0..20).all(|r| values.as_f64(r) == (r + 3 * j) as f64), "{format} p{i}");
                }
            }
        }
    }
}

#[test]
fn names_are_pdals_where_they_mean_the_same() {
    let properties = [
        ("float x", "", ""),
        ("float y", "", ""),
        ("float z", "", ""),
        ("uchar red", "Red", "u8"),
        ("ushort green", "Green", "u16"),
        ("float blue", "blue", "f32"),
        ("uchar alpha", "alpha", "u8"),
        ("float nx", "NormalX", "f32"),
        ("float intensity", "Intensity", "f32"),
        ("ushort Intensity", "Intensity", "u16"),
        ("double gps_time", "GpsTime", "f64"),
        ("float time", "time", "f32"),
        ("uchar diffuse_red", "diffuse_red", "u8"),
        ("float scalar_Return_Number", "ReturnNumber", "f32"),
        ("float scalar_C2C_distances", "scalar_C2C_distances", "f32"),
        ("float scalar_Red", "scalar_Red", "f32"),
        ("uchar alpha", "alpha.2", "u8"),
        ("uchar alpha", "alpha.3", "u8"),
    ];
    let mut text = "ply\nformat ascii 1.0\nelement vertex 0\n".to_owned();
    properties.iter().for_each(|p| text += &format!("property {}\n", p.0));
    let source = opened((text + "end_header").as_bytes());
    let mut expected: Vec<_> = properties[3..].iter().map(|p| (p.1, p.2)).collect();
    let attributes = &source.info().layout.attributes;
    let mut found: Vec<_> = attributes.iter().map(|a| (&*a.name, a.ty.word())).collect();
    expected.sort_unstable();
    found.sort_unstable();
    assert_eq!(found, expected);
}

#[test]
fn bits_are_kept() {
    let mut file =
        b"ply\r\nformat binary_big_endian 1.0\r\nelement vertex 1\r\nproperty float x\r\nproperty double y\r\nproperty float z\r\nproperty float q\r\nend_header\r\n"
            .to_vec();
    file.extend(f32::NAN.to_be_bytes());
    file.extend(f64::NEG_INFINITY.to_be_bytes());
    file.extend(1.5_f32.to_be_bytes());
    file.extend(0xffc1_2345_u32.to_be_bytes());
    let source = opened(&file);
    let (all, tally) = records(&*source, 1).unwrap();
    assert_eq!(tally.read, 1);
    assert!(f64::from_le_bytes(all[..8].try_into().unwrap()).is_nan());
    assert_eq!(all[8..16], f64::NEG_INFINITY.to_le_bytes());
    assert_eq!(all[24..], 0xffc1_2345_u32.to_le_bytes());
}

#[test]
fn text_coordinates_are_the_numbers_as_written() {
    let head =
        "ply \nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z \nend_header\n";
    let source = opened(format!("{head}-0.66641 nan 1e3\n\n 1 2 3").as_bytes());
    assert_eq!(column(&*source, "x"), Column::F64(vec![-0.66641, 1.0]));
    assert_eq!(column(&*source, "z"), Column::F64(vec![1000.0, 3.0]));
    for (text, line, bad) in [("1 2 x 4 5 6", 8, "x"), ("1 2 3\n4 5 six", 9, "six")] {
        let error = records(&*opened(format!("{head}{text}").as_bytes()), 1).unwrap_err().to_string();
        let expected = format!("line {line}: expected a value of type f64, found `{bad}`");
        assert!(error.contains(&expected), "{error}");
    }
    let bytes = head.replace("float x", "uchar x");
    let error = records(&*opened(format!("{bytes}256 1 1 1 1 1").as_bytes()), 1).unwrap_err().to_string();
    assert!(error.contains("expected a value of type u8, found `256`"), "{error}");
}

#[test]
fn vertices_of_a_text_are_one_a_line_or_read_word_by_word_and_never_mixed() {
    // A line with a value too many or too few shifted all values after it, and nobody said so.
    let read = |count: u64, rest: &str| {
        let axes = "property float x\nproperty float y\nproperty float z\n";
        let source = opened(format!("ply\nformat ascii 1.0\nelement vertex {count}\n{axes}{rest}").as_bytes());
        let read = records(&*source, 1).map(|(all, tally)| {
            let at = |i: usize| f64::from_le_bytes(all[8 * i..8 * i + 8].try_into().unwrap());
            ((0..all.len() / 8).map(at).collect::<Vec<_>>(), tally.read, tally.truncated + source.info().missing)
        });
        let warnings = source.info().warnings.iter().cloned().chain(source.found_while_reading());
        (read.map_err(|e| e.to_string()), warnings.collect::<Vec<_>>().join("; "))
    };
    let six = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    let faces = "element face 1\nproperty list uchar int l\n";
    for (rest, warning) in [
        ("end_header\n1 2 3\n4 5 6\n", ""),
        ("end_header\n\n1 2 3\r\n \n\t4 5 6", ""),
        ("end_header\n1 2 3\r4 5 6\r", ""),
        (&format!("{faces}end_header\n1 2 3\n4 5 6\n2 0 1\n"), "1 records of element `face` are not kept"),
        ("end_header\n1 2 3 4 5 6", "the vertices are not one a line"),
        ("end_header\n1 2\n3 4\n5 6\n", "the vertices are not one a line"),
        (&format!("{faces}end_header\n1 2 3 4\n5 6 2 0\n1"), "the vertices are not one a line"),
        ("end_header\n1 2 3\n4 5 6\n7 8 9\n", "line 10 and what follows are more than the header announces"),
    ] {
        let (read, warnings) = read(2, rest);
        assert_eq!(read.unwrap(), (six.to_vec(), 2, 0), "{rest}");
        assert!(warnings.contains(warning) && warning.is_empty() == warnings.is_empty(), "{rest}: {warnings}");
    }
    let line = "expected one vertex a line";
    for (count, rest, expected) in [
        (2, "end_header\n1 2 3 99\n4 5 6 99\n", "line 8: expected one vertex a line, or just as many values"),
        (3, "end_header\n1 2\n4 5\n6 7\n", "line 8: expected one vertex a line, or just as many values"),
        (2, "end_header\n1 2\n4 5 6\n", &format!("line 8: {line}, with the values that the header names, found fewer")),
        (
            2,
            "end_header\n1 2 3\n4 5 6 99\n",
            &format!("line 9: {line}, with the values that the header names, found more"),
        ),
        (
            3,
            "end_header\n1 2 3 9\n4 5 6\n7 8 9\n",
            &format!("line 8: {line}, with the values that the header names, found more"),
        ),
        (
            3,
            "end_header\n1 2 3\n4 5\n\n7 8 9\n",
            &format!("line 9: {line}, with the values that the header names, found fewer"),
        ),
        (2, &format!("{faces}end_header\n1 2 3\n4 5\n2 0 1\n"), "line 11: expected one vertex a line"),
    ] {
        let error = read(count, rest).0.unwrap_err();
        assert!(error.contains(expected), "{rest}: {error}");
    }
    // What is cut off has been a vertex a line.
    for (rest, found) in [("end_header\n1 2 3\n4 5", 1), ("end_header\n1 2", 0)] {
        let (_, whole, missing) = read(2, rest).0.unwrap();
        assert_eq!((whole, missing), (found, 2 - found), "{rest}");
    }
}

#[test]
fn cut_files_give_their_whole_records() {
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for list in [false, true] {
            let whole = sample(format, 12, list);
            let all = records(&*opened(&whole), 5).unwrap().0;
            let data = whole.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
            for length in (data..whole.len()).step_by(13) {
                let source = opened(&whole[..length]);
                let (read, tally) = records(&*source, 5).unwrap();
                assert_eq!(tally.read + tally.truncated + source.info().missing, 20);
                // A number that is cut in the middle is still a number.
                let certain = if format == "ascii" { tally.read.saturating_sub(1) } else { tally.read };
                let certain = certain as usize * source.info().layout.stride();
                assert!(read[..certain] == all[..certain], "{format} {list} {length}");
                assert!(source.info().missing == 0 || !source.info().warnings.is_empty());
            }
        }
    }
}

#[test]
fn pieces_are_cut_where_records_have_one_size() {
    let count = |format, list| opened(&sample(format, 0, list)).pieces(7).len();
    assert_eq!(count("binary_little_endian", false), 3);
    assert_eq!(count("binary_little_endian", true), 1);
    assert_eq!(count("ascii", false), 1);
    for format in ["ascii", "binary_big_endian"] {
        let source = opened(&sample(format, 3, true));
        let mut part = Vec::new();
        let mut sink = |run: &[u8]| {
            part.extend_from_slice(run);
            true
        };
        let tally = source.read(Piece { first: 4, records: 9 }, &mut sink).unwrap();
        assert_eq!(tally, Tally { read: 9, truncated: 0 });
        let stride = source.info().layout.stride();
        assert!(part == records(&*source, 1).unwrap().0[4 * stride..13 * stride]);
    }
}

#[test]
fn bad_headers_are_refused_with_their_place() {
    let vertex = "element vertex 1\nproperty int x\nproperty int y\nproperty int z\n";
    let ascii = "ply\nformat ascii 1.0\n";
    let cases = [
        ("ply\nformat ascii 1.0\n", "at byte 21: expected the line `end_header`"),
        ("ply\nformat utf8 1.0\n", "at byte 4: expected format ascii"),
        ("ply\nend_header\n", "expected a `format` line in the header, found none"),
        ("ply\nformat ascii 1.0\nend_header\n", "expected an element `vertex` in the header, found none"),
        ("ply\nformat ascii 1.0\nproperty int x\n", "at byte 21: expected an element before its properties"),
        ("ply\nformat ascii 1.0\nelement vertex -1\n", "at byte 21: expected an element with a count"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\n", "expected a property with a known type"),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty list float int x\n",
            "expected a property with a known type",
        ),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\nend_header\n",
            "x, y and z of the vertices, found x",
        ),
        ("ply\nformat ascii 1.0\nhello\n", "at byte 21: expected format, comment"),
        ("ply\nformat ascii 1.0\nelement vertex 1", "expected a header line that ends"),
    ];
    for (text, expected) in cases {
        let error = refusal(text.as_bytes());
        assert!(error.contains(expected), "{text}: {error}");
    }
    // A list with a negative count.
    let list = "property list char int l\n";
    let mut file = format!("{ascii}{vertex}{list}end_header\n").replace("ascii", "binary_little_endian").into_bytes();
    let place = file.len() + 12;
    file.extend([0; 12]);
    file.push(255);
    let error = records(&*opened(&file), 1).unwrap_err().to_string();
    assert!(error.contains(&format!("at byte {place}: expected a list with a count")), "{error}");
}

#[test]
fn lying_counts_cost_nothing() {
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for list in ["", "property list uint double l\n"] {
            let head = format!(
                "ply\nformat {format} 1.0\nelement empty {0}\nelement before 1\nproperty list uint uint l\n\
                 element vertex {0}\nproperty int x\nproperty int y\nproperty int z\n{list}end_header\n",
                u64::MAX
            );
            for tail in ["", "\u{7f}\u{7f}\u{7f}\u{7f}", "9 9 9 9 9 9 9 9 9 9\n9 9 9"] {
                let source = opened(format!("{head}{tail}").as_bytes());
                assert!(source.info().missing > u64::MAX - 100);
                let (_, tally) = records(&*source, 1000).unwrap();
                assert_eq!(tally.read + tally.truncated, source.info().records);
            }
        }
    }
}

#[test]
fn lone_carriage_returns_end_lines() {
    let head = "ply\rformat binary_little_endian 1.0\relement vertex 1\rproperty int x\rproperty uchar y\rproperty uchar z\rend_header\r";
    let mut file = head.as_bytes().to_vec();
    file.extend([10, 0, 0, 0, 10, 13]);
    let source = opened(&file);
    assert_eq!(column(&*source, "x"), Column::F64(vec![10.0]));
    assert_eq!(column(&*source, "z"), Column::F64(vec![13.0]));
}
