//! Cameras that are kept in a store.

use super::Store;
use super::testing::{folder, options, replace, some_points};

/// They make no new generation, and are there at once for whoever holds a snapshot.
#[test]
fn a_bookmark_that_another_handle_keeps_is_seen_at_once() {
    let (_folder, path) = folder();
    let store = Store::create(&path, options()).unwrap();
    replace(&store, some_points(700));
    let snapshot = store.snapshot().unwrap();
    for i in 0..20 {
        let name = format!("view {i:02}");
        Store::open(&path).unwrap().writer().unwrap().put_bookmark(&name, "{}").unwrap();
        assert_eq!(snapshot.bookmarks().unwrap().last().unwrap().0, name);
    }
}

#[test]
fn bookmarks_come_back() {
    let store = Store::in_memory(options()).unwrap();
    let mut writer = store.writer().unwrap();
    writer.put_bookmark("north", "{}").unwrap();
    writer.put_bookmark("north", "{\"eye\":[1,2,3]}").unwrap();
    let found = store.snapshot().unwrap().bookmarks().unwrap();
    assert_eq!(found, [("north".to_owned(), "{\"eye\":[1,2,3]}".to_owned())]);
    writer.remove_bookmark("south").unwrap();
    writer.remove_bookmark("north").unwrap();
    assert_eq!(store.snapshot().unwrap().bookmarks().unwrap(), []);
}
