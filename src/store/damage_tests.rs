//! Damage is found, named, and never read as points.

use super::connection::{self, Purpose};
use super::testing::{content, digested, options, points, prepare, replace, some_points, sorted, verified};
use super::*;
use proptest::prelude::*;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn what_was_written_is_whole_and_digests_depend_on_content_alone(points in points(500), rest in points(60)) {
        let store = Store::in_memory(options()).unwrap();
        replace(&store, points.clone());
        let report = verified(&store, true);
        prop_assert_eq!(&report.findings, &vec![]);
        prop_assert_eq!(report.points, points.len() as u64);
        let first = digested(&store);
        // Another order, other row ids, another generation.
        let mut reversed = points.clone();
        reversed.reverse();
        replace(&store, rest);
        replace(&store, reversed);
        prop_assert!(verified(&store, true).is_whole());
        prop_assert_eq!(digested(&store), first);
        // One bit of one attribute, and one scan for another.
        let mut other = points.clone();
        other[0].intensity ^= 1;
        replace(&store, other);
        prop_assert_ne!(digested(&store).points, first.points);
        let mut other = points;
        other.retain(|p| p.scan == 1);
        if !other.is_empty() {
            replace(&store, other.clone());
            let one = digested(&store);
            let mut writer = store.writer().unwrap();
            let snapshot = store.snapshot().unwrap();
            let mut scan = snapshot.scans()[0].clone();
            scan.identity[0] ^= 1;
            scan.name = "another name".into();
            writer.commit(Flip { scans_changed: vec![scan], ..Flip::default() }).unwrap();
            let two = digested(&store);
            prop_assert_eq!(one.points, two.points);
            prop_assert_ne!(one.scans, two.scans);
        }
    }
}

/// Where in `file` each blob lies: every place where its first bytes are, with the length that lies there in one piece.
/// All but one are what SQLite left behind when it moved the row.
fn places(file: &[u8], blobs: &[Vec<u8>]) -> Vec<Vec<(usize, usize)>> {
    let of = |blob: &Vec<u8>| {
        let starts = (0..file.len()).filter(|&i| file[i..].starts_with(&blob[..blob.len().min(24)]));
        let length = |start: usize| blob.iter().zip(&file[start..]).take_while(|(a, b)| a == b).count();
        starts.map(|start| (start, length(start))).collect()
    };
    blobs.iter().map(of).collect()
}

fn blobs(path: &Path, sql: &str) -> Vec<Vec<u8>> {
    let connection = connection::open(path, Purpose::Immutable).map_err(|e| e.at(path)).unwrap();
    let mut statement = connection.prepare(sql).unwrap();
    let rows = statement.query_map([], |row| row.get(0)).unwrap();
    rows.collect::<Result<_, _>>().unwrap()
}

#[test]
fn a_flipped_byte_is_found_wherever_it_is_and_never_read_as_points() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.esker");
    let points = some_points(900);
    replace(&Store::create(&path, options()).unwrap(), points.clone());
    let expected = sorted(points);
    let file = std::fs::read(&path).unwrap();
    let copy = folder.path().join("copy.esker");
    let read = |at: usize, mask: u8| {
        let mut damaged = file.clone();
        damaged[at] ^= mask;
        std::fs::write(&copy, &damaged).unwrap();
        let mut found = true;
        if let Ok(store) = Store::open(&copy) {
            found = !verified(&store, false).is_whole();
            match store.snapshot().and_then(|s| content(&s)) {
                Ok(content) => assert_eq!(content, expected, "byte {at} ^ {mask:#x}"),
                Err(_) => assert!(found, "byte {at} ^ {mask:#x}"),
            }
            let _ = store.snapshot().map(|s| (digest(&s, &|_| true).is_ok(), info(&s).is_ok()));
        }
        for name in ["copy.esker", "copy.esker-wal", "copy.esker-shm"] {
            let _ = std::fs::remove_file(folder.path().join(name));
        }
        found
    };
    // Anywhere, SQLite's own structures included.
    let step = file.len() / 500;
    for i in 0..500 {
        read(i * step + i % step, 1 << (i % 8));
    }
    for at in 0..100 {
        read(at, 0x5a);
    }
    // In rows: always found.
    let rows = ["SELECT bytes FROM chunk", "SELECT head FROM node", "SELECT zones FROM zone", "SELECT key FROM node"];
    for sql in rows {
        let places = places(&file, &blobs(&path, sql));
        assert!(!places.is_empty());
        for (i, copies) in places.into_iter().enumerate().take(30) {
            let flip = |at: fn(usize, usize) -> usize| {
                // Every copy is read; that of the row itself is found.
                copies.iter().filter(|(start, length)| read(at(*start, *length), 1 << (i % 8))).count() > 0
            };
            assert!(flip(|start, _| start), "{sql}: first byte of row {i}");
            assert!(flip(|start, length| start + length / 2), "{sql}: row {i}");
            assert!(flip(|start, length| start + length - 1), "{sql}: last byte of row {i}");
        }
    }
}

#[test]
fn a_file_that_was_cut_short_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.esker");
    replace(&Store::create(&path, options()).unwrap(), some_points(900));
    let file = std::fs::read(&path).unwrap();
    for length in [1, 99, 100, 4096, file.len() / 2, file.len() - 4096, file.len() - 1] {
        let copy = folder.path().join(format!("{length}.esker"));
        std::fs::write(&copy, &file[..length]).unwrap();
        if let Ok(store) = Store::open(&copy) {
            assert!(!verified(&store, false).is_whole(), "{length}");
            assert!(store.snapshot().and_then(|s| content(&s)).is_err(), "{length}");
        }
    }
}

/// Changes rows behind the checksums' back: right checksums, wrong content.
#[test]
fn rows_that_are_whole_but_wrong_are_found() {
    let store = Store::in_memory(options()).unwrap();
    type Nodes = Vec<(model::NodeHead, model::Zones)>;
    let expect = |change: &dyn Fn(&mut Nodes), words: &str| {
        let snapshot = store.snapshot().unwrap();
        let mut writer = store.writer().unwrap();
        let mut flip = prepare(&mut writer, some_points(900), snapshot.scans());
        let NodeChange::ReplaceAll(nodes) = &mut flip.nodes else { panic!("a whole tree is replaced") };
        nodes.sort_by_key(|n| n.0.cube.node_key());
        change(nodes);
        writer.commit(flip).unwrap();
        drop(writer);
        let report = verified(&store, true);
        assert!(report.findings.iter().any(|f| f.to_string().contains(words)), "{words}: {:#?}", report.findings);
    };
    expect(&|nodes| nodes[1].0.shape.radius *= 2.0, "radius");
    expect(&|nodes| nodes[1].0.shape.spacing += 1.0, "spacing");
    expect(&|nodes| nodes[0].1.own.clear(), "zone maps are not those of its points");
    expect(&|nodes| nodes[0].1.subtree.clear(), "subtree's zone maps");
    expect(&|nodes| nodes[0].0.parts[0].last_step = None, "order of detail");
    expect(
        &|nodes| {
            let leaf = nodes.iter_mut().find(|n| n.0.leaf).unwrap();
            leaf.0.leaf = false;
        },
        "whether it is a leaf",
    );
    expect(&|nodes| nodes[0].0.parts[0].packed.truncate(1), "not those of the node's row");
    // A leaf's points where they do not belong: in the wrong node, by giving two nodes each other's chunks, which the
    // rows' own names give away.
    expect(
        &|nodes| {
            let (a, b) = (nodes[1].0.chunk_base, nodes[2].0.chunk_base);
            (nodes[1].0.chunk_base, nodes[2].0.chunk_base) = (b, a);
        },
        "belongs elsewhere",
    );
}

#[test]
fn the_rest_of_a_damaged_tree_stays_readable() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.esker");
    replace(&Store::create(&path, options()).unwrap(), some_points(900));
    let heads = blobs(&path, "SELECT head FROM node ORDER BY layer, key");
    let mut file = std::fs::read(&path).unwrap();
    for &(start, _) in &places(&file, &heads[heads.len() - 1..])[0] {
        file[start + 5] ^= 4;
    }
    std::fs::write(&path, &file).unwrap();
    let store = Store::open(&path).unwrap();
    let snapshot = store.snapshot().unwrap();
    assert!(matches!(snapshot.index(), Err(StoreError::Damaged { table: "node", .. })));
    let (index, damage) = snapshot.readable_index().unwrap();
    assert_eq!(index.len(), heads.len() - 1);
    assert!(!damage.is_empty());
    let mut cost = ReadCost::default();
    for head in index.heads() {
        (0..head.parts.len()).for_each(|part| drop(snapshot.read_part(head, part, &[0, 1], &mut cost).unwrap()));
    }
    assert!(cost.bytes > 0);
}

#[test]
fn info_adds_up() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.esker");
    let store = Store::create(&path, options()).unwrap();
    replace(&store, some_points(3000));
    let snapshot = store.snapshot().unwrap();
    let found = info(&snapshot).unwrap();
    let columns = found.position_bytes + found.scan_bytes + found.attribute_bytes.iter().map(|a| a.1).sum::<u64>();
    assert_eq!((found.points, columns), (3000, found.chunk_bytes));
    assert!(!found.in_use && found.chunk_bytes < found.total_bytes);
    let writer = store.writer().unwrap();
    assert!(info(&snapshot).unwrap().in_use);
    drop(writer);
    assert!(!info(&snapshot).unwrap().in_use);
}

#[test]
fn a_digest_that_is_ended_is_none() {
    let store = Store::in_memory(options()).unwrap();
    replace(&store, some_points(700));
    let snapshot = store.snapshot().unwrap();
    let asked_until = |end: u64| {
        let asked = AtomicU64::new(0);
        let found = digest(&snapshot, &|_| asked.fetch_add(1, Ordering::Relaxed) + 1 < end).unwrap();
        (found, asked.into_inner())
    };
    let (found, all) = asked_until(u64::MAX);
    assert_eq!(found, Some(digested(&store)));
    assert!(all > 3, "asked {all} times");
    for end in 1..=all {
        let (found, asked) = asked_until(end);
        assert!(
            found.is_none() && asked <= end + rayon::current_num_threads() as u64,
            "{asked} of {all}, ended at {end}"
        );
    }
}

#[test]
fn a_check_that_is_ended_gives_no_report_whenever_that_is() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::create(folder.path().join("a.esker"), options()).unwrap();
    replace(&store, some_points(700));
    let asked_until = |end: u64| {
        let asked = AtomicU64::new(0);
        let report = verify(&store, true, &|done, all| {
            assert!(done <= all && all == 1400);
            let now = asked.fetch_add(1, Ordering::Relaxed) + 1;
            if now >= end { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        (report, asked.into_inner())
    };
    let (report, all) = asked_until(u64::MAX);
    assert!(report.unwrap().is_whole() && all > 3, "asked {all} times");
    for end in 1..=all {
        let (report, asked) = asked_until(end);
        assert_eq!(report, None, "ended when asked for time {end} of {all}");
        // Nodes that other threads were at.
        assert!(asked <= end + rayon::current_num_threads() as u64, "asked {asked} times, ended at {end}");
    }
}
