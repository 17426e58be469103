//! Law 2 on every real file: what goes in comes out, bit for bit.

use crate::support::{RawLas, data_files, esker, esker_ok};
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
