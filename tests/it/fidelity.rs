//! Law 2 on every real file: what goes in comes out, bit for bit.

use crate::support::{RawLas, TinyLas, data_files, esker, esker_ok};
use esker::formats::{ReadOptions, open};
use esker::lattice::{Lattice, LatticePoint};
use esker::store::Store;
use std::fs;
use std::path::Path;

/// Files that the `las` and `laz` crates can't read either: Esker must name them and leave nothing behind.
fn refused(path: &Path, store: &Path) -> bool {
    let output = esker(&["ingest", store.to_str().unwrap(), path.to_str().unwrap()]);
    if output.status.success() {
        return false;
    }
    let stderr = String::from_utf8_lossy(&output.stderr);
    let name = path.file_name().unwrap().to_str().unwrap();
    assert!(stderr.contains(name), "{name} is not named: {stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
    assert!(!store.exists(), "{name}: a store was left behind");
    true
}

#[test]
fn every_las_and_laz_file_comes_back_record_for_record() {
    let folder = tempfile::tempdir().unwrap();
    let (mut same, mut unread) = (0, Vec::new());
    for path in data_files(&["las", "laz"]) {
        let store = folder.path().join("one.esker");
        let out = folder.path().join("out.las");
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if refused(&path, &store) {
            unread.push(name);
            continue;
        }
        esker_ok(&["query", store.to_str().unwrap(), "-o", out.to_str().unwrap()]);
        if let Some(before) = RawLas::read(&path) {
            let after = RawLas::read(&out).unwrap_or_else(|| panic!("{name}: the output can't be read"));
            let (a, b) = (&before.header, &after.header);
            assert_eq!(
                [a.x_scale_factor, a.y_scale_factor, a.z_scale_factor, a.x_offset, a.y_offset, a.z_offset],
                [b.x_scale_factor, b.y_scale_factor, b.z_scale_factor, b.x_offset, b.y_offset, b.z_offset],
                "{name}"
            );
            assert_eq!(a.point_data_record_format & 0x3f, b.point_data_record_format, "{name}");
            assert_eq!(before.records.len(), after.records.len(), "{name}");
            assert!(before.sorted() == after.sorted(), "{name}: records differ");
            same += 1;
        } else {
            unread.push(format!("{name} (read by Esker alone)"));
        }
        fs::remove_file(&out).unwrap();
        fs::remove_file(&store).unwrap();
    }
    println!("{same} files the same; not compared: {unread:?}");
    assert!(unread.len() <= same / 3, "too many files were not compared: {unread:?}");
}

/// Places with canonical record bytes, sorted.
type Records = Vec<(LatticePoint, Vec<u8>)>;

/// The points of a PLY file that have a place on the lattice, with their attributes as canonical bytes; and the largest
/// distance of a coordinate from its place, in quanta.
fn ply_points(path: &Path, lattice: &Lattice) -> Option<(Records, f64)> {
    let source = open(path, &ReadOptions::default()).ok()?;
    let layout = source.info().layout.clone();
    let (mut points, mut largest) = (Vec::new(), 0.0_f64);
    for piece in source.pieces(1 << 20) {
        source
            .read(piece, &mut |records| {
                for record in records.chunks_exact(layout.stride()) {
                    let world: [f64; 3] =
                        std::array::from_fn(|i| f64::from_le_bytes(record[8 * i..8 * i + 8].try_into().unwrap()));
                    let Ok(point) = lattice.lattice_from_world(world) else { continue };
                    let stored = lattice.world_from_lattice(point);
                    for i in 0..3 {
                        largest = largest.max((world[i] - stored[i]).abs() / lattice.quantum_f64()[i]);
                    }
                    let mut bytes = Vec::new();
                    layout.canonical_bytes(&record[24..], &mut bytes);
                    points.push((point, bytes));
                }
                true
            })
            .ok()?;
    }
    points.sort_unstable();
    Some((points, largest))
}

#[test]
fn every_ply_file_comes_back_within_half_a_quantum() {
    let folder = tempfile::tempdir().unwrap();
    let mut compared = 0;
    for path in data_files(&["ply"]) {
        let (store, out) = (folder.path().join("one.esker"), folder.path().join("out.ply"));
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if refused(&path, &store) {
            println!("{name}: refused");
            continue;
        }
        let lattice = Store::open(&store).unwrap().snapshot().unwrap().site().lattice.clone();
        esker_ok(&["query", store.to_str().unwrap(), "-o", out.to_str().unwrap()]);
        let (before, largest) = ply_points(&path, &lattice).unwrap_or_else(|| panic!("{name}: can't be read again"));
        let (after, _) = ply_points(&out, &lattice).unwrap_or_else(|| panic!("{name}: the output can't be read"));
        // An f64 at 1e6 with a quantum of 1e-6 has an ulp of a ten-thousandth of it.
        assert!(largest <= 0.501, "{name}: {largest} quanta");
        assert!(before == after, "{name}: points differ");
        compared += 1;
        fs::remove_file(&out).unwrap();
        fs::remove_file(&store).unwrap();
    }
    println!("{compared} PLY files the same");
    assert!(compared >= 10 || data_files(&["ply"]).is_empty());
}

#[test]
fn an_offset_of_noise_is_kept_and_so_are_the_records() {
    // What writers put there that take the mean of a centred cloud. The file was refused, and its scale was blamed.
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let mut las = TinyLas::new(1);
    for i in -50..50 {
        las.push([i, 7 * i, i32::MAX - i.abs()], i.unsigned_abs().into());
    }
    let mut file = las.bytes();
    let offsets = [1.2345678901234567e-17, -1.234567890123456e-25, 5e-324_f64];
    for (i, offset) in offsets.iter().enumerate() {
        file[155 + 8 * i..163 + 8 * i].copy_from_slice(&offset.to_le_bytes());
    }
    fs::write(at("noise.las"), file).unwrap();
    let report = esker_ok(&["ingest", &at("s.esker"), &at("noise.las")]);
    assert!(report.contains("100 points stored; positions recoverable, off by at most 1.235e-17"), "{report}");
    esker_ok(&["verify", &at("s.esker"), "--deep"]);
    esker_ok(&["query", &at("s.esker"), "-o", &at("back.las")]);
    let [before, after] = ["noise.las", "back.las"].map(|name| RawLas::read(Path::new(&at(name))).unwrap());
    assert_eq!([after.header.x_offset, after.header.y_offset, after.header.z_offset], offsets);
    assert_eq!(before.sorted(), after.sorted());
}
