//! Points that a program has made go into a store like those of a file.

use crate::support::{esker_fails, esker_ok};
use esker::formats::PointTable;
use esker::ingest::{
    IngestError, IngestOptions, LatticeWish, Progress, Resources, digest, ingest, ingest_table, replace,
};
use esker::points::Column;
use esker::query::Query;
use esker::store::Store;
use std::fs;

const POINTS: usize = 70_000;

fn coordinate(i: usize, axis: usize) -> f64 {
    ((i * (7919 + 13 * axis)) % 50_021) as f64 * 0.01 + 5e5
}

fn table(name: &str) -> PointTable {
    let axis = |axis| (0..POINTS).map(|i| coordinate(i, axis)).collect::<Vec<_>>();
    let mut table = PointTable::new(name, axis(0), axis(1), axis(2)).unwrap();
    table.add("intensity", Column::U16((0..POINTS).map(|i| i as u16).collect())).unwrap();
    table.add("weight", Column::F32((0..POINTS).map(|i| i as f32 / 3.0).collect())).unwrap();
    table
}

/// The same, its columns added the other way round.
fn turned(name: &str) -> PointTable {
    let axis = |axis| (0..POINTS).map(|i| coordinate(i, axis)).collect::<Vec<_>>();
    let mut table = PointTable::new(name, axis(0), axis(1), axis(2)).unwrap();
    table.add("weight", Column::F32((0..POINTS).map(|i| i as f32 / 3.0).collect())).unwrap();
    table.add("Intensity", Column::U16((0..POINTS).map(|i| i as u16).collect())).unwrap();
    table
}

fn options() -> IngestOptions {
    let lattice = LatticeWish { quantum: Some([0.01; 3]), phase: None };
    IngestOptions { lattice, ..IngestOptions::default() }
}

#[test]
fn a_table_is_the_store_that_a_file_of_its_points_is() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut ply = b"ply\nformat binary_little_endian 1.0\nelement vertex 70000\nproperty double x\nproperty double y\n\
        property double z\nproperty ushort intensity\nproperty float weight\nend_header\n"
        .to_vec();
    for i in 0..POINTS {
        (0..3).for_each(|axis| ply.extend(coordinate(i, axis).to_le_bytes()));
        ply.extend((i as u16).to_le_bytes());
        ply.extend((i as f32 / 3.0).to_le_bytes());
    }
    fs::write(at("same.ply"), ply).unwrap();
    ingest(&at("file.esker"), &[at("same.ply")], &options(), &()).unwrap();
    let hash = |name: &str| digest(&at(name), &Resources::default(), &()).unwrap();
    for (name, memory_bytes, threads) in
        [("a.esker", None, None), ("b.esker", Some(1 << 20), Some(1)), ("c.esker", Some(1 << 20), Some(2))]
    {
        let report = ingest_table(
            &at(name),
            table("made"),
            &IngestOptions { resources: Resources { memory_bytes, threads, wait: false }, ..options() },
            &(),
        )
        .unwrap();
        assert_eq!((report.points, report.scans[0].name.as_str()), (POINTS as u64, "made"));
        assert_eq!(hash(name).points, hash("file.esker").points, "{name}");
        assert_eq!(hash(name).scans, hash("a.esker").scans, "{name}");
    }
    // Once is enough, whatever it is called and in whatever order; other values are other points.
    let again = ingest_table(&at("a.esker"), turned("again"), &options(), &()).unwrap();
    assert!(again.scans.is_empty() && again.skipped[0].reason.contains("already in the store as 'made'"), "{again:?}");
    let mut other = table("made");
    other.add("more", Column::U8(vec![1; POINTS])).unwrap();
    let added = ingest_table(&at("a.esker"), other, &options(), &()).unwrap();
    assert_eq!(added.scans[0].name, "made-2");
    let store = at("a.esker").to_str().unwrap().to_owned();
    esker_ok(&["verify", &store, "--deep"]);
    esker_fails(&["replace", &store, "made"], 1, &["'made' was made of a program's points", "name a file"]);
    assert!(matches!(replace(&at("a.esker"), "made", None, &options(), &()), Err(IngestError::NoFile(_))));
    assert_eq!(
        Query::new().count(&Store::open(&store).unwrap().snapshot().unwrap()).unwrap().points,
        2 * POINTS as u64
    );
}

#[test]
fn a_table_that_is_given_up_leaves_nothing() {
    struct Stop;
    impl Progress for Stop {
        fn cancelled(&self) -> bool {
            true
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.esker");
    let stopped = ingest_table(&path, table("made"), &options(), &Stop);
    assert!(matches!(stopped, Err(IngestError::Interrupted)), "{stopped:?}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    // None at all are a scan without points.
    let none = PointTable::new("none", Vec::new(), Vec::new(), Vec::new()).unwrap();
    assert_eq!(ingest_table(&path, none, &options(), &()).unwrap().scans[0].stored, 0);
}
