//! Stores before their first commit, and what is kept or left by who writes beside one.

use super::testing::{content, folder, options, prepare, replace, some_points, sorted};
use super::*;

/// No transaction is held of a store without a commit, and what it read then was of two generations.
#[test]
fn a_snapshot_of_nothing_stays_one_of_nothing() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    let nothing = store.snapshot().unwrap();
    replace(&store, some_points(700));
    assert_eq!(content(&nothing).unwrap(), []);
    assert_eq!(nothing.index().unwrap().heads().len(), 0);
    assert!(nothing.nodes().roots().unwrap().is_empty() && nothing.readable_index().unwrap().1.is_empty());
    assert_eq!(info(&nothing).unwrap().points, 0);
    assert_eq!(nothing.bookmarks().unwrap(), []);
    assert_eq!(content(&store.snapshot().unwrap()).unwrap(), sorted(some_points(700)));
}

/// Somebody looks while a store gets its first points: `verify` found the rows of one generation and the site of another.
#[test]
fn a_store_is_whole_while_it_gets_its_first_points() {
    for _ in 0..20 {
        let (_folder, path) = folder();
        let store = Store::create(&path, options()).unwrap();
        let looking = Store::open(&path).unwrap();
        std::thread::scope(|scope| {
            scope.spawn(|| replace(&store, some_points(700)));
            while looking.snapshot().unwrap().generation() == 0 {
                let report = verify(&looking, false, &|_, _| std::ops::ControlFlow::Continue(())).unwrap();
                assert_eq!(report.findings, []);
            }
        });
    }
}

/// A camera that was said to be kept went with the payload that was being written.
#[test]
fn a_bookmark_is_kept_whatever_becomes_of_the_payload() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    replace(&store, some_points(300));
    let snapshot = store.snapshot().unwrap();
    let mut writer = store.writer().unwrap();
    prepare(&mut writer, some_points(900), snapshot.scans());
    writer.put_bookmark("gate", "{}").unwrap();
    prepare(&mut writer, some_points(900), snapshot.scans());
    writer.remove_bookmark("nowhere").unwrap();
    prepare(&mut writer, some_points(900), snapshot.scans());
    writer.compact(|| false).unwrap();
    drop(writer);
    assert_eq!(store.snapshot().unwrap().bookmarks().unwrap(), [("gate".to_owned(), "{}".to_owned())]);
    assert_eq!(content(&store.snapshot().unwrap()).unwrap(), sorted(some_points(300)));
}

/// What a first ingest that is cut off has left holds nothing: neither its lattice nor its CRS is kept.
#[test]
fn a_provisional_store_gets_another_site() {
    let (_folder, path) = folder();
    let (store, writer) = Store::create_with_writer(&path, options()).unwrap();
    assert!(writer.is_provisional());
    drop((store, writer));
    let store = Store::open(&path).unwrap();
    let mut writer = store.writer().unwrap();
    let finer = crate::lattice::Lattice::uniform(1e-5).unwrap();
    writer.begin_anew(SiteOptions { lattice: finer.clone(), ..options() }).unwrap();
    drop(writer);
    assert_eq!(store.snapshot().unwrap().site().lattice, finer);
    replace(&store, some_points(300));
    // Not of a store that has had a commit, or was made to stay as it is.
    let mut writer = store.writer().unwrap();
    assert!(!writer.is_provisional() && writer.begin_anew(options()).is_err());
    let (_folder, path) = folder();
    let mut writer = Store::create(&path, options()).unwrap().writer().unwrap();
    assert!(!writer.is_provisional() && writer.begin_anew(options()).is_err());
}

/// Whoever else has made the file meanwhile keeps it.
#[test]
fn a_copy_takes_nothing_away() {
    let (folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    let taken = folder.path().join("copy.esker");
    std::fs::write(&taken, "notes").unwrap();
    assert!(matches!(store.copy_to(&taken, || false), Err(StoreError::AlreadyThere { .. })));
    let link = folder.path().join("link.esker");
    std::os::unix::fs::symlink("nowhere", &link).unwrap();
    assert!(matches!(store.copy_to(&link, || false), Err(StoreError::AlreadyThere { .. })));
    assert_eq!(std::fs::read_to_string(&taken).unwrap(), "notes");
    let copy = folder.path().join("free.esker");
    store.copy_to(&copy, || false).unwrap();
    assert_eq!(Store::open(&copy).unwrap().snapshot().unwrap().generation(), 0);
}
