//! Damaged files: whatever the bytes, reading gives records or an error.

use super::las::samples::Sample;
use super::{FormatError, PointSource, ReadOptions, open_all};
use proptest::prelude::*;
use std::path::Path;
use std::sync::LazyLock;

/// More records than any sample has: a count that lies must not make the test long.
const ENOUGH: u64 = 100_000;

/// Reads all pieces of all scans; the number of records.
fn read_all(path: &Path) -> Result<u64, FormatError> {
    let sources = open_all(path, &ReadOptions::default())?;
    sources.iter().take(20).map(|source| read_source(&**source)).sum()
}

fn read_source(source: &dyn PointSource) -> Result<u64, FormatError> {
    let stride = source.info().layout.stride();
    let mut total = 0;
    // Few pieces, whatever the header says.
    let target = (source.info().records / 3).max(20);
    for piece in source.pieces(target).into_iter().take(50) {
        let mut given = 0;
        let mut sink = |run: &[u8]| {
            assert!(!run.is_empty() && run.len().is_multiple_of(stride) && run.len() <= (1 << 20).max(stride));
            given += (run.len() / stride) as u64;
            total += (run.len() / stride) as u64;
            total < ENOUGH
        };
        let tally = source.read(piece, &mut sink)?;
        assert_eq!(tally.read, given);
        assert!(tally.read + tally.truncated == piece.records || total >= ENOUGH);
        if total >= ENOUGH {
            break;
        }
    }
    Ok(total)
}

static SAMPLES: LazyLock<Vec<Vec<u8>>> = LazyLock::new(samples);

fn samples() -> Vec<Vec<u8>> {
    let spec = &b"LASF_Spec"[..];
    let descriptor = |code: u8| {
        let mut raw = vec![0; 192];
        (raw[2], raw[3], raw[4]) = (code, 0b1_1001, b'a');
        raw
    };
    let extra = [descriptor(9), descriptor(23), descriptor(1)].concat();
    let mut described = Sample { extra: 11, vlrs: vec![(spec, 4, extra)], ..Sample::new(6, 50) };
    described.evlrs = vec![(b"LASF_Projection", 2112, b"GEOGCS[\"WGS 84\",AUTHORITY[\"EPSG\",\"4326\"]]".to_vec())];
    let keys = [1_u16, 1, 0, 1, 3072, 0, 1, 32632].iter().flat_map(|w| w.to_le_bytes()).collect();
    let projected = Sample { vlrs: vec![(b"LASF_Projection", 34735, keys)], ..Sample::new(3, 50) };
    let mut files = vec![described.file(), projected.file()];
    for format in [1, 3, 5, 6, 7, 10] {
        files.push(Sample { chunk: Some(20), extra: 2, ..Sample::new(format, 50) }.file());
    }
    let head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 9\nproperty float x\nproperty double y\nproperty int z\nproperty uchar red\n\
             property list uchar ushort l\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let row = "1.5 2 3 200 2 7 8\n";
    files.push((head("ascii") + &row.repeat(9)).into_bytes());
    for format in ["binary_little_endian", "binary_big_endian"] {
        let mut file = head(format).into_bytes();
        (0..9).for_each(|i| file.extend([i; 17].iter().chain(&[1, 0, 5])));
        files.push(file);
        let mut file = head(format).replace("property list uchar ushort l\n", "").into_bytes();
        file.extend((0..9 * 17).map(|i| i as u8));
        files.push(file);
    }
    files.extend(texts());
    files.extend(super::e57::samples());
    files.extend(super::pcd::samples());
    files
}

fn texts() -> Vec<Vec<u8>> {
    let rows = |n: usize| (0..n).map(|i| format!("{i}.25 {} 3 0.5 1 2 {}\n", i * i, i % 7)).collect::<String>();
    let block = "3\n3\n1 2 3\n1 0 0\n0 1 0\n0 0 1\n0 1 0 0\n-1 0 0 0\n0 0 1 0\n5 6 7 1\n";
    let csv = format!("X,Y,Z,Intensity,R,G,B\n{}", rows(9).replace(' ', ","));
    let texts = [csv, rows(9), format!("5\n{}4\n{}", rows(5), rows(4)), format!("{block}{}", rows(9))];
    texts.map(String::into_bytes).to_vec()
}

#[test]
fn samples_are_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("f");
    for file in SAMPLES.iter() {
        std::fs::write(&path, file).unwrap();
        assert!(matches!(read_all(&path), Ok(9 | 20 | 50)), "{:?}", read_all(&path));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, max_shrink_iters: 200, ..ProptestConfig::default() })]

    #[test]
    fn damage_gives_records_or_an_error(
        which in any::<prop::sample::Index>(),
        flips in prop::collection::vec((any::<bool>(), any::<prop::sample::Index>(), any::<u8>(), 1_usize..5), 0..4),
        cut in prop::option::weighted(0.3, any::<prop::sample::Index>()),
    ) {
        let mut file = which.get(&SAMPLES).clone();
        for (early, place, value, run) in flips {
            // Headers and the heads of chunks are where damage tells.
            let reach = if early { file.len().min(400) } else { file.len() };
            let start = place.index(reach);
            let end = (start + run).min(file.len());
            file[start..end].fill(value);
        }
        if let Some(cut) = cut {
            file.truncate(cut.index(file.len()));
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f");
        std::fs::write(&path, &file).unwrap();
        match read_all(&path) {
            Ok(_) => {}
            Err(e) => prop_assert!(e.to_string().contains("f: ")),
        }
    }
}
