//! Logs that are not a file's own: left by a deleted store, or beside one that was put back from a copy.

use super::files::{wal, wal_bytes};
use super::testing::{elsewhere, folder, options, prepare, replace, some_points, verified};
use super::*;
use crate::codec::{BlockSize, Blocks};
use rusqlite::Connection;
use std::path::Path;
use std::time::Duration;

#[test]
fn a_new_store_replaces_no_file_and_adopts_no_log() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    assert!(matches!(Store::create(&path, options()), Err(StoreError::AlreadyThere { .. })));
    let mut writer = store.writer().unwrap();
    let change = prepare(&mut writer, some_points(300), &[]);
    // A reader that began before keeps the log from being emptied.
    let held = Connection::open(&path).unwrap();
    held.execute_batch("BEGIN").unwrap();
    assert_eq!(held.query_row("SELECT generation FROM site", [], |row| row.get::<_, i64>(0)), Ok(0));
    writer.commit(change).unwrap();
    let log = std::fs::read(wal(&path)).unwrap();
    assert!(!log.is_empty());
    drop((writer, held, store));
    std::thread::sleep(Duration::from_millis(150));
    std::fs::remove_file(&path).unwrap();
    std::fs::write(wal(&path), &log).unwrap();
    let store = Store::create(&path, options()).unwrap();
    assert_eq!(store.snapshot().unwrap().generation(), 0);
    assert!(store.snapshot().unwrap().scans().is_empty());
    drop(store);
    std::thread::sleep(Duration::from_millis(150));
    // The same when another store is moved to where the deleted one was.
    std::fs::write(wal(&path), &log).unwrap();
    let before = std::fs::read(&path).unwrap();
    assert!(matches!(Store::open(&path), Err(StoreError::ForeignWal { .. })));
    assert!(!Store::is_unfinished(&path));
    assert_eq!(std::fs::read(&path).unwrap(), before);
}

/// The file of a store and the log that a crash left beside it.
struct Crashed {
    file: Vec<u8>,
    log: Vec<u8>,
}

impl Crashed {
    /// While `work` of a writer is under way, or done under a reader that keeps it in the log.
    fn with<R>(store: &Store, path: &Path, work: impl FnOnce(&mut Writer) -> R) -> Self {
        let held = store.snapshot().unwrap();
        held.scans();
        let mut writer = store.writer().unwrap();
        let done = work(&mut writer);
        let crashed = Self { file: std::fs::read(path).unwrap(), log: std::fs::read(wal(path)).unwrap() };
        assert!(!crashed.log.is_empty());
        drop((done, writer, held));
        std::thread::sleep(Duration::from_millis(150));
        crashed
    }

    fn put(&self, path: &Path) {
        std::fs::write(path, &self.file).unwrap();
        std::fs::write(wal(path), &self.log).unwrap();
    }
}

/// Of each kind: rows that nothing refers to yet, and a commit.
#[test]
fn a_log_is_applied_to_its_own_file_in_its_own_state_and_to_no_other() {
    let (_folder, path) = folder();
    let fill = |path: &Path, points: u64| {
        let store = Store::create(path, options()).unwrap();
        replace(&store, some_points(points));
        store
    };
    let at_rest = |path: &Path| {
        std::thread::sleep(Duration::from_millis(150));
        assert_eq!(wal_bytes(path), 0);
        std::fs::read(path).unwrap()
    };
    let rows = |writer: &mut Writer| {
        for part in 0..40 {
            let id = writer.chunk_ids().reserve(1);
            let row =
                ChunkRow::new(id, (0, elsewhere()), part, 0, Blocks::new(1, BlockSize::LARGEST), vec![7; 1 << 19]);
            writer.put_chunks(&[row]).unwrap();
        }
    };
    let commit = |writer: &mut Writer| {
        let change = prepare(writer, some_points(900), Store::open(&path).unwrap().snapshot().unwrap().scans());
        writer.commit(change).unwrap();
    };
    let store = fill(&path, 300);
    let copy = {
        drop(store);
        at_rest(&path)
    };
    let store = Store::open(&path).unwrap();
    replace(&store, some_points(500));
    let with_rows = Crashed::with(&store, &path, rows);
    let with_commit = Crashed::with(&store, &path, commit);
    drop(store);
    let generation = |path: &Path| Store::open(path).map(|store| store.snapshot().unwrap().generation());
    for (crashed, expected) in [(&with_rows, 2), (&with_commit, 3)] {
        // Beside an older copy of the same store.
        std::fs::write(&path, &copy).unwrap();
        std::fs::write(wal(&path), &crashed.log).unwrap();
        assert!(matches!(generation(&path), Err(StoreError::ForeignWal { .. })));
        assert_eq!(std::fs::read(&path).unwrap(), copy);
        // Beside another store.
        let other = path.with_file_name("other.esker");
        drop(fill(&other, 200));
        let before = at_rest(&other);
        std::fs::write(wal(&other), &crashed.log).unwrap();
        assert!(matches!(generation(&other), Err(StoreError::ForeignWal { .. })));
        assert_eq!(std::fs::read(&other).unwrap(), before);
        std::fs::remove_file(wal(&other)).unwrap();
        assert_eq!(generation(&other).unwrap(), 1);
        std::fs::remove_file(&other).unwrap();
        // Beside its own.
        crashed.put(&path);
        assert_eq!(generation(&path).unwrap(), expected);
        assert_eq!(verified(&Store::open(&path).unwrap(), true).findings, []);
    }
    // A log that leaves of the file no more than a schema: hardly anything can be read with it.
    let other = path.with_file_name("empty.esker");
    drop(Store::create(&other, options()).unwrap());
    at_rest(&other);
    let foreign = Connection::open(&other).unwrap();
    foreign.execute_batch("UPDATE site SET generation = generation + 1").unwrap();
    std::thread::sleep(Duration::from_millis(150));
    std::fs::write(&path, &copy).unwrap();
    std::fs::copy(wal(&other), wal(&path)).unwrap();
    drop(foreign);
    assert!(matches!(generation(&path), Err(StoreError::ForeignWal { .. })));
    assert_eq!(std::fs::read(&path).unwrap(), copy);
    // What is no store's: its pages are not rows of the site.
    let other = path.with_file_name("other.db");
    let foreign = Connection::open(&other).unwrap();
    foreign
        .execute_batch(
            "PRAGMA page_size = 2048; PRAGMA journal_mode = WAL; CREATE TABLE t (a); INSERT INTO t VALUES (1)",
        )
        .unwrap();
    std::thread::sleep(Duration::from_millis(150));
    std::fs::write(&path, &copy).unwrap();
    std::fs::copy(wal(&other), wal(&path)).unwrap();
    assert!(matches!(generation(&path), Err(StoreError::ForeignWal { .. })));
    assert_eq!(std::fs::read(&path).unwrap(), copy);
}
