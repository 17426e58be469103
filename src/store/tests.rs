//! Laws of the store as a whole.

use super::files::{journal, wal, wal_bytes};
use super::testing::{content, elsewhere, folder, options, points, prepare, replace, some_points, sorted, verified};
use super::*;
use crate::codec::{BlockSize, Blocks};
use proptest::prelude::*;
use rusqlite::Connection;
use std::path::Path;
use std::time::{Duration, Instant};

fn names(path: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(path.parent().unwrap()).unwrap();
    let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn points_come_back_bit_for_bit(points in points(400)) {
        let store = Store::in_memory(options()).unwrap();
        replace(&store, points.clone());
        let snapshot = store.snapshot().unwrap();
        prop_assert_eq!(content(&snapshot).unwrap(), sorted(points.clone()));
        let index = snapshot.index().unwrap();
        for (i, head) in index.heads().iter().enumerate() {
            let node = i as NodeIx;
            prop_assert_eq!(index.find(0, head.cube), Some(node));
            let children: Vec<_> = index.children(node).collect();
            prop_assert_eq!(children.len(), head.children.count_ones() as usize);
            prop_assert!(children.iter().all(|&c| index.parent(c) == Some(node)));
            let below: usize = children.iter().map(|&c| index.subtree(c).len()).sum();
            prop_assert_eq!(index.subtree(node).len(), below + 1);
        }
        prop_assert_eq!(index.find(0, elsewhere()), None);
    }
}

#[test]
fn a_store_on_disk_is_one_file_when_nobody_uses_it() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    let points = some_points(2000);
    replace(&store, points.clone());
    drop(store);
    assert_eq!(names(&path), ["a store?#%.esker"]);
    let store = Store::open(&path).unwrap();
    assert_eq!(content(&store.snapshot().unwrap()).unwrap(), sorted(points));
    drop(store);
    std::thread::sleep(Duration::from_millis(250));
    assert_eq!(names(&path), ["a store?#%.esker"]);
}

#[test]
fn a_reader_keeps_its_generation_across_flips() {
    let (_folder, path) = folder();
    for store in [Store::create(&path, options()).unwrap(), Store::in_memory(options()).unwrap()] {
        let first = some_points(700);
        replace(&store, first.clone());
        let held = store.snapshot().unwrap();
        // Long enough for several renewals, before and after the flip.
        std::thread::sleep(Duration::from_millis(350));
        assert!(!store.changed(&held).unwrap());
        let second = some_points(1500);
        replace(&store, second.clone());
        std::thread::sleep(Duration::from_millis(350));
        replace(&store, second.clone());
        assert!(store.changed(&held).unwrap());
        assert_eq!(content(&held).unwrap(), sorted(first));
        let next = store.snapshot().unwrap();
        assert_eq!(next.generation(), held.generation() + 2);
        assert_eq!(content(&next).unwrap(), sorted(second.clone()));
        drop(held);
        // What the old generation left behind goes with the next flip.
        replace(&store, second);
        let left = store.snapshot().unwrap();
        let rows: i64 = left.with(|c| Ok(c.query_row("SELECT count(*) FROM garbage", [], |r| r.get(0))?)).unwrap();
        drop(next);
        assert!(rows == 0 || store.path().is_none());
    }
}

#[test]
fn several_threads_read_one_snapshot() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    let points = some_points(3000);
    replace(&store, points.clone());
    let snapshot = store.snapshot().unwrap();
    let expected = sorted(points);
    std::thread::scope(|scope| {
        for _ in 0..12 {
            scope.spawn(|| assert_eq!(content(&snapshot).unwrap(), expected));
        }
    });
}

#[test]
fn the_log_stays_bounded_under_a_reader() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    replace(&store, some_points(100));
    let held = store.snapshot().unwrap();
    let mut writer = store.writer().unwrap();
    let base = writer.chunk_ids().reserve(2000);
    let cube = elsewhere();
    let mut largest = 0;
    for part in 0..480_u32 {
        let bytes = vec![part as u8; 1 << 20];
        let id = base + i64::from(part) * model::SLOT_STRIDE;
        writer.put_chunks(&[ChunkRow::new(id, (0, cube), part, 0, Blocks::new(1, BlockSize::LARGEST), bytes)]).unwrap();
        largest = largest.max(wal_bytes(&path));
    }
    // 480 MiB were written.
    assert!((128 << 20..256 << 20).contains(&largest), "{largest}");
    assert_eq!(content(&held).unwrap(), sorted(some_points(100)));
    drop(writer);
    assert_eq!(content(&held).unwrap(), sorted(some_points(100)));
    assert_eq!(wal_bytes(&path), 0);
}

/// What lies under the path now would be read as if it were the store that was opened.
#[test]
fn a_store_that_is_removed_or_replaced_is_told_and_never_mixed() {
    let (folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    let points = some_points(2000);
    replace(&store, points.clone());
    let held = store.snapshot().unwrap();
    let gone = |store: &Store| {
        let told = [store.snapshot().map(|_| ()), store.changed(&held).map(|_| ())];
        told.into_iter().all(|t| matches!(t, Err(StoreError::Gone { path: p }) if p == path))
    };
    let away = folder.path().join("away.esker");
    std::fs::rename(&path, &away).unwrap();
    assert!(gone(&store), "the file was moved away");
    let other = Store::create(&path, options()).unwrap();
    replace(&other, some_points(50));
    assert!(gone(&store), "another store lies there");
    assert!(matches!(store.writer(), Err(StoreError::Gone { .. })), "it is not written to either");
    assert_eq!(content(&held).unwrap(), sorted(points), "what was opened is still read");
    drop(other);
    std::fs::rename(&away, &path).unwrap();
    assert!(store.snapshot().is_ok(), "it is back");
}

#[test]
fn there_is_one_writer_and_it_is_named() {
    let (_folder, path) = folder();
    for store in [Store::create(&path, options()).unwrap(), Store::in_memory(options()).unwrap()] {
        let writer = store.writer().unwrap();
        let again = if store.path().is_some() { Store::open(&path).unwrap() } else { store.clone() };
        let error = again.writer().unwrap_err();
        assert!(matches!(error, StoreError::InUse { .. }), "{error}");
        drop(writer);
        drop(again.writer().unwrap());
    }
}

#[test]
fn a_writer_that_gives_up_leaves_nothing() {
    let (_folder, path) = folder();
    for store in [Store::create(&path, options()).unwrap(), Store::in_memory(options()).unwrap()] {
        replace(&store, some_points(300));
        let before = store.snapshot().unwrap();
        let mut writer = store.writer().unwrap();
        prepare(&mut writer, some_points(900), before.scans());
        drop(writer);
        assert!(!store.changed(&before).unwrap());
        let writer = store.writer().unwrap();
        assert_eq!(writer.leftovers(), Leftovers::default());
        assert_eq!(content(&store.snapshot().unwrap()).unwrap(), sorted(some_points(300)));
    }
}

#[test]
fn what_a_crash_leaves_is_removed_by_the_next_writer() {
    let (folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    replace(&store, some_points(300));
    let snapshot = store.snapshot().unwrap();
    let mut writer = store.writer().unwrap();
    let mut change = prepare(&mut writer, some_points(900), snapshot.scans());
    // A commit that is refused is like a crash before the flip, as far as the payload goes: its rows are committed.
    change.scans_removed = vec![77];
    writer.commit(change).unwrap_err();
    let copy = folder.path().join("copy.esker");
    std::fs::copy(&path, &copy).unwrap();
    std::fs::copy(wal(&path), wal(&copy)).unwrap();
    std::fs::write(Temporary::Spill.path(&copy, 17), b"x").unwrap();
    let store = Store::open(&copy).unwrap();
    assert_eq!(content(&store.snapshot().unwrap()).unwrap(), sorted(some_points(300)));
    let writer = store.writer().unwrap();
    assert!(writer.leftovers().chunk_rows > 10);
    assert_eq!(writer.leftovers().spill_files, 1);
    drop(writer);
    assert_eq!(store.writer().unwrap().leftovers(), Leftovers::default());
    assert_eq!(content(&store.snapshot().unwrap()).unwrap(), sorted(some_points(300)));
}

#[test]
fn a_change_that_contradicts_itself_is_refused_and_changes_nothing() {
    let store = Store::in_memory(options()).unwrap();
    let expect = |change: Flip, mut writer: Writer, word: &str| {
        let error = writer.commit(change).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
        assert_eq!(store.snapshot().unwrap().generation(), 0);
    };
    let begin = || {
        let mut writer = store.writer().unwrap();
        let change = prepare(&mut writer, some_points(300), &[]);
        (change, writer)
    };
    let (mut change, writer) = begin();
    change.scans_added[0].read += 1;
    expect(change, writer, "points read");
    let (mut change, writer) = begin();
    change.scans_added.pop();
    expect(change, writer, "is not there");
    let (mut change, writer) = begin();
    change.roots = Some(vec![Some(elsewhere())]);
    expect(change, writer, "root");
    let (mut change, writer) = begin();
    if let NodeChange::ReplaceAll(nodes) = &mut change.nodes {
        nodes.remove(0);
    }
    expect(change, writer, "missing");
    let (mut change, writer) = begin();
    change.scans_added[0].id = 99;
    expect(change, writer, "reserved");
}

#[test]
fn deltas_keep_what_they_do_not_name() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    replace(&store, some_points(600));
    let before = store.snapshot().unwrap();
    let index = before.index().unwrap();
    let mut writer = store.writer().unwrap();
    let node = (index.len() / 2) as NodeIx;
    let put = vec![(index.head(node).clone(), before.zones(node).unwrap().as_ref().clone())];
    let committed =
        writer.commit(Flip { nodes: NodeChange::Delta { put, delete: Vec::new() }, ..Flip::default() }).unwrap();
    assert_eq!((committed.generation, committed.removed_rows), (2, 0));
    let delete = vec![(0, index.head(node).cube)];
    let change = Flip { nodes: NodeChange::Delta { put: Vec::new(), delete }, ..Flip::default() };
    assert!(matches!(writer.commit(change), Err(StoreError::Inconsistent { .. })));
    assert_eq!(content(&store.snapshot().unwrap()).unwrap(), sorted(some_points(600)));
}

#[test]
fn removing_everything_gives_the_disk_back() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    let empty = std::fs::metadata(&path).unwrap().len();
    replace(&store, some_points(20_000));
    assert!(std::fs::metadata(&path).unwrap().len() > 4 * empty);
    let mut writer = store.writer().unwrap();
    let change = Flip {
        scans_removed: vec![1, 2],
        roots: Some(vec![None]),
        nodes: NodeChange::ReplaceAll(Vec::new()),
        ..Flip::default()
    };
    assert!(writer.commit(change).unwrap().removed_rows > 100);
    drop(writer);
    drop(store);
    assert!(std::fs::metadata(&path).unwrap().len() <= 2 * empty);
}

#[test]
fn other_files_are_refused_by_name() {
    let (folder, path) = folder();
    let at = |name: &str| folder.path().join(name);
    let refused = |path: &Path| {
        let error = Store::open(path).unwrap_err();
        assert!(error.to_string().contains(&*path.to_string_lossy()), "{error}");
        error
    };
    assert!(matches!(refused(&at("missing")), StoreError::NotThere { .. }));
    assert!(matches!(refused(folder.path()), StoreError::Directory { .. }));
    std::fs::write(at("empty"), b"").unwrap();
    assert!(matches!(refused(&at("empty")), StoreError::NotAStore { .. }));
    std::fs::write(at("text"), "LASF".repeat(2000)).unwrap();
    assert!(matches!(refused(&at("text")), StoreError::NotAStore { .. }));
    Connection::open(at("other")).unwrap().execute_batch("CREATE TABLE t (a)").unwrap();
    assert!(matches!(refused(&at("other")), StoreError::NotAStore { .. }));
    drop(Store::create(&path, options()).unwrap());
    Connection::open(&path).unwrap().execute_batch("PRAGMA user_version = 7").unwrap();
    let error = refused(&path).to_string();
    assert!(error.contains("version 7") && error.contains("up to 1"), "{error}");
}

#[test]
fn a_first_filling_goes_straight_into_the_file_and_the_flip_through_the_log() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    let other = || Store::open(&path).unwrap().snapshot().unwrap().generation();
    let mut writer = store.writer().unwrap();
    writer.expect_many().unwrap();
    drop(prepare(&mut writer, some_points(3000), &[]));
    assert!(journal(&path).exists() && !wal(&path).exists());
    // An open transaction is in nobody's way.
    let impatient = Connection::open(&path).unwrap();
    impatient.busy_timeout(Duration::ZERO).unwrap();
    let generation = impatient.query_row("SELECT generation FROM site", [], |row| row.get::<_, i64>(0));
    assert_eq!(generation.unwrap(), 0);
    drop(impatient);
    assert_eq!(other(), 0);
    // Given up, it was never there.
    drop(writer);
    assert_eq!(other(), 0);
    let mut writer = store.writer().unwrap();
    writer.expect_many().unwrap();
    let change = prepare(&mut writer, some_points(3000), &[]);
    assert!(journal(&path).exists());
    // Who came meanwhile sees the commit.
    let early = Store::open(&path).unwrap();
    let nothing_yet = early.snapshot().unwrap();
    assert_eq!(nothing_yet.generation(), 0);
    // And who holds that there is nothing keeps nobody waiting.
    let begun = Instant::now();
    writer.commit(change).unwrap();
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
    assert_eq!((nothing_yet.scans().len(), nothing_yet.generation()), (0, 0));
    assert_eq!((early.snapshot().unwrap().generation(), other()), (1, 1));
    assert!(!journal(&path).exists());
    let held = store.snapshot().unwrap();
    assert_eq!(content(&held).unwrap(), sorted(some_points(3000)));
    // From then on there is only the log.
    writer.expect_many().unwrap();
    let change = prepare(&mut writer, some_points(400), held.scans());
    assert!(!journal(&path).exists());
    assert_eq!(other(), 1);
    writer.commit(change).unwrap();
    assert_eq!((held.generation(), other()), (1, 2));
}

#[test]
fn a_transaction_that_is_larger_than_the_cache_is_in_nobodys_way() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    let mut writer = store.writer().unwrap();
    writer.expect_many().unwrap();
    // A byte less than ends it. Pages that left the cache before that would lock readers out until the end.
    let row = |bytes: usize, writer: &Writer| {
        ChunkRow::new(
            writer.chunk_ids().reserve(1),
            (0, elsewhere()),
            0,
            0,
            Blocks::new(1, BlockSize::LARGEST),
            vec![7; bytes],
        )
    };
    for i in 0..16 {
        let row = row((1 << 20) - usize::from(i == 0), &writer);
        writer.put_chunks(&[row]).unwrap();
    }
    assert!(journal(&path).exists(), "the transaction has ended");
    assert!(std::fs::metadata(&path).unwrap().len() < 1 << 20, "pages are in the file already");
    let impatient = Connection::open(&path).unwrap();
    impatient.busy_timeout(Duration::ZERO).unwrap();
    let generation = impatient.query_row("SELECT generation FROM site", [], |row| row.get::<_, i64>(0));
    assert_eq!(generation.unwrap(), 0);
}

#[test]
fn readers_of_a_store_that_is_first_filled_are_never_refused() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    let mut writer = store.writer().unwrap();
    writer.expect_many().unwrap();
    let done = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        let readers: Vec<_> = (0..3)
            .map(|_| {
                scope.spawn(|| {
                    let mut seen = vec![0];
                    while !done.load(std::sync::atomic::Ordering::Relaxed) {
                        seen.push(Store::open(&path).unwrap().snapshot().unwrap().generation());
                    }
                    seen
                })
            })
            .collect();
        for _ in 0..20 {
            drop(prepare(&mut writer, some_points(2000), &[]));
            assert!(journal(&path).exists());
        }
        let change = prepare(&mut writer, some_points(3000), &[]);
        writer.commit(change).unwrap();
        done.store(true, std::sync::atomic::Ordering::Relaxed);
        for reader in readers {
            let seen = reader.join().unwrap();
            assert!(seen.is_sorted() && seen.len() > 1);
        }
    });
    assert_eq!(content(&store.snapshot().unwrap()).unwrap(), sorted(some_points(3000)));
}

#[test]
fn who_waits_for_a_reader_ends_when_told_and_the_store_is_as_it_was() {
    // A reader of another program that keeps its lock made Ctrl-C wait for a minute, and the end of the writer for another.
    for at_flip in [true, false] {
        let (_folder, path) = folder();
        let store = Store::create(&path, options()).unwrap();
        let mut writer = store.writer().unwrap();
        writer.expect_many().unwrap();
        let change = prepare(&mut writer, some_points(3000), &[]);
        let reader = Connection::open(&path).unwrap();
        reader.execute_batch("BEGIN; SELECT * FROM site").unwrap();
        let begun = Instant::now();
        let stop = || begun.elapsed() > Duration::from_millis(100);
        let error = if at_flip {
            writer.commit_unless(change, &stop).unwrap_err()
        } else {
            let base = writer.chunk_ids().reserve(1);
            let cube = crate::lattice::Cube::containing(crate::lattice::LatticePoint::default(), 9);
            let row = |part: i64| {
                ChunkRow::new(base + part, (0, cube), 0, 0, Blocks::new(1, BlockSize::LARGEST), vec![0; 9 << 20])
            };
            writer.put_chunks_unless(&[row(0), row(1), row(2)], &stop).unwrap_err()
        };
        assert!(matches!(error, StoreError::Busy { .. }), "{error:?}");
        drop(writer);
        assert!(begun.elapsed() < Duration::from_secs(4), "{:?}", begun.elapsed());
        drop(reader);
        assert_eq!(store.snapshot().unwrap().generation(), 0);
        // Nobody in the way, nothing to stop for.
        replace(&store, some_points(2000));
        assert_eq!(content(&store.snapshot().unwrap()).unwrap(), sorted(some_points(2000)));
    }
}

#[test]
fn no_store_has_the_name_of_anothers_log() {
    // The other one's lock was its end, whichever of the two was there first.
    let (_folder, path) = folder();
    for _ in 0..2 {
        for suffix in ["-wal", "-shm", "-journal", "-lock"] {
            let beside = super::files::beside(&path, suffix);
            assert!(matches!(Store::create(&beside, options()), Err(StoreError::NameOfAnother { .. })), "{suffix}");
            assert!(!beside.exists());
        }
        let _ = Store::create(&path, options());
    }
}

#[test]
fn who_has_an_empty_store_open_keeps_it_while_it_is_filled() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    let held = Store::open(&path).unwrap().snapshot().unwrap();
    let mut writer = store.writer().unwrap();
    writer.expect_many().unwrap();
    let change = prepare(&mut writer, some_points(3000), &[]);
    assert_eq!(held.scans().len(), 0);
    assert_eq!(Store::open(&path).unwrap().snapshot().unwrap().generation(), 0);
    writer.commit(change).unwrap();
    assert_eq!((held.generation(), store.snapshot().unwrap().generation()), (0, 1));
}

#[test]
fn a_store_that_is_made_to_be_written_is_nobody_elses_and_is_removed_with_its_lock() {
    let (_folder, path) = folder();
    let (store, mut writer) = Store::create_with_writer(&path, options()).unwrap();
    assert!(matches!(Store::open(&path).unwrap().writer(), Err(StoreError::InUse { .. })));
    writer.expect_many().unwrap();
    drop(prepare(&mut writer, some_points(3000), &[]));
    drop(store);
    writer.remove_store();
    let left: Vec<_> = std::fs::read_dir(path.parent().unwrap()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(left.is_empty(), "{left:?}");
    assert!(matches!(Store::open(&path), Err(StoreError::NotThere { .. })));
    replace(&Store::create(&path, options()).unwrap(), some_points(300));
}

/// A journal that a program which was killed has left of another database: whoever opens a file beside it as SQLite does
/// undoes in it what the journal says.
fn foreign_journal(folder: &Path) -> Vec<u8> {
    let other = folder.join("other.db");
    let connection = Connection::open(&other).unwrap();
    // Its pages do not fit the cache, so that they and the journal are written before the end.
    connection
        .execute_batch(
            "PRAGMA page_size = 2048; PRAGMA cache_size = 2; CREATE TABLE t (b); \
             WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 60) INSERT INTO t SELECT zeroblob(1500) FROM n; \
             BEGIN; UPDATE t SET b = randomblob(1500)",
        )
        .unwrap();
    let left = std::fs::read(journal(&other)).unwrap();
    drop(connection);
    std::fs::remove_file(other).unwrap();
    left
}

#[test]
#[cfg(unix)]
fn a_link_to_a_store_is_the_store() {
    let (_folder, path) = folder();
    let link = path.with_file_name("link.esker");
    std::os::unix::fs::symlink(&path, &link).unwrap();
    let store = Store::create(&path, options()).unwrap();
    replace(&store, some_points(300));
    let linked = Store::open(&link).unwrap();
    let writer = linked.writer().unwrap();
    assert!(matches!(store.writer(), Err(StoreError::InUse { .. })));
    drop((writer, linked, store));
    std::thread::sleep(Duration::from_millis(150));
    // Nor is what lies beside it overlooked.
    std::fs::write(journal(&path), foreign_journal(path.parent().unwrap())).unwrap();
    let before = std::fs::read(&path).unwrap();
    assert!(matches!(Store::open(&link), Err(StoreError::ForeignJournal { .. })));
    assert!(!Store::is_unfinished(&link));
    assert_eq!(std::fs::read(&path).unwrap(), before);
}

#[test]
fn a_journal_beside_a_store_with_content_is_another_ones() {
    let (_folder, path) = folder();
    drop(Store::create(&path, options()).unwrap());
    std::fs::write(journal(&path), "of a deleted store").unwrap();
    // It may be its own as long as it is empty.
    let store = Store::open(&path).unwrap();
    replace(&store, some_points(300));
    drop(store);
    std::thread::sleep(Duration::from_millis(150));
    std::fs::write(journal(&path), foreign_journal(path.parent().unwrap())).unwrap();
    let before = std::fs::read(&path).unwrap();
    assert!(matches!(Store::open(&path), Err(StoreError::ForeignJournal { .. })));
    assert!(!Store::is_unfinished(&path));
    assert_eq!(std::fs::read(&path).unwrap(), before);
    // What it would have done.
    let _ = Connection::open(&path)
        .unwrap()
        .query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get::<_, i64>(0));
    assert_ne!(std::fs::read(&path).unwrap(), before);
}

#[test]
fn a_full_disk_leaves_the_store_as_it_was() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    replace(&store, some_points(300));
    let before = store.snapshot().unwrap();
    let full = |at_flip: bool| {
        let mut writer = store.writer().unwrap();
        let change = prepare(&mut writer, some_points(if at_flip { 900 } else { 0 }), before.scans());
        writer.limit_pages(before.with(|c| Ok(c.query_row("PRAGMA page_count", [], |r| r.get(0))?)).unwrap());
        let row = ChunkRow::new(
            writer.chunk_ids().reserve(1),
            (0, elsewhere()),
            0,
            0,
            Blocks::new(1, BlockSize::LARGEST),
            vec![7; 1 << 20],
        );
        let error = if at_flip { writer.commit(change).unwrap_err() } else { writer.put_chunks(&[row]).unwrap_err() };
        assert!(matches!(error, StoreError::Full { .. }), "{error}");
        if !at_flip {
            assert!(matches!(writer.commit(Flip::default()), Err(StoreError::Inconsistent { .. })));
        }
    };
    full(false);
    full(true);
    assert!(!store.changed(&before).unwrap());
    assert!(verified(&store, true).is_whole());
    replace(&store, some_points(900));
    assert_eq!(content(&store.snapshot().unwrap()).unwrap(), sorted(some_points(900)));
}
