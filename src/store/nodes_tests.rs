//! Nodes that are loaded one page at a time are those of the whole index.

use super::testing::{elsewhere, options, replace, some_points};
use super::*;
use rusqlite::Connection;
use std::path::Path;

fn store(path: &Path, points: u64) {
    replace(&Store::create(path, options()).unwrap(), some_points(points));
}

/// All nodes in pre-order, by way of their parents.
fn walk(nodes: &Nodes) -> Result<Vec<Node>, StoreError> {
    let mut all = Vec::new();
    let mut open = nodes.roots()?;
    while let Some(node) = open.pop() {
        let children: Vec<Node> = nodes.children(&node)?.collect();
        open.extend(children.into_iter().rev());
        all.push(node);
    }
    Ok(all)
}

#[test]
fn pages_hold_the_nodes_of_the_whole_index_whatever_is_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.esker");
    store(&path, 12_000);
    for node_bytes in [0, 20_000, 1 << 30] {
        let snapshot = Store::open_with(&path, Limits { node_bytes, ..Limits::default() }).unwrap().snapshot().unwrap();
        let (nodes, index) = (snapshot.nodes(), snapshot.index().unwrap());
        let found = walk(&nodes).unwrap();
        assert_eq!(nodes.len(), index.len() as u64);
        assert_eq!(found.len(), index.len());
        for (ix, node) in (0..).zip(&found) {
            assert_eq!((node.ix(), &**node), (ix, index.head(ix)));
            assert_eq!((node.subtree(), node.is_root()), (index.subtree(ix), index.parent(ix).is_none()));
        }
        // In an order that has nothing to do with the tree.
        for i in 0..index.len() as NodeIx {
            let ix = (i * 7919) % index.len() as NodeIx;
            let node = nodes.node(ix).unwrap();
            assert_eq!((node.ix(), &*node), (ix, index.head(ix)));
            assert_eq!(nodes.find(0, node.cube).unwrap().map(|n| n.ix()), Some(ix));
            let zones = snapshot.with(|c| rows::load_zones(c, 0, node.cube)).unwrap();
            assert_eq!(*nodes.zones(&node).unwrap(), zones);
        }
        assert!(nodes.find(0, elsewhere()).unwrap().is_none());
        assert!(nodes.node(index.len() as NodeIx).is_err());
        let (loads, bytes) = nodes.loaded();
        assert!(loads > 5, "families and deep pages are both there: {loads} loads");
        assert!(bytes <= node_bytes, "{bytes} of {node_bytes}");
    }
}

#[test]
fn a_store_in_memory_has_the_same_nodes() {
    let store = Store::in_memory(options()).unwrap();
    replace(&store, some_points(5000));
    let snapshot = store.snapshot().unwrap();
    let index = snapshot.index().unwrap();
    // What is committed later is not seen.
    replace(&store, some_points(300));
    let nodes = snapshot.nodes();
    let found = walk(&nodes).unwrap();
    assert!(found.iter().zip(0..).all(|(node, ix)| node.ix() == ix && **node == *index.head(ix)));
    assert_eq!(found.len(), index.len());
    assert!(found.iter().all(|node| !nodes.zones(node).unwrap().own.is_empty() || node.own_points == 0));
}

#[test]
fn damage_is_named_where_it_is_looked_at_and_nowhere_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.esker");
    store(&path, 12_000);
    let sound = Store::open(&path).unwrap().snapshot().unwrap();
    let index = sound.index().unwrap();
    let rows = index.len();
    drop(sound);
    // Every tenth node is gone, one after the other, or says something else of its subtree under a right checksum.
    for victim in (1..rows).step_by(rows / 10) {
        let head = index.head(victim as NodeIx);
        for deleted in [true, false] {
            std::fs::copy(&path, folder.path().join("b.esker")).unwrap();
            let damaged = folder.path().join("b.esker");
            let connection = Connection::open(&damaged).unwrap();
            if deleted {
                rows::delete_node(&connection, head.layer, head.cube).unwrap();
            } else {
                let mut other = head.clone();
                other.subtree_nodes += 1;
                rows::put_node(&connection, &other).unwrap();
            }
            drop(connection);
            let snapshot = Store::open(&damaged).unwrap().snapshot().unwrap();
            let nodes = snapshot.nodes();
            let error = walk(&nodes).unwrap_err();
            assert!(matches!(error, StoreError::Damaged { table: "node", .. }), "{error}");
            // The root's other children are untouched, unless the victim is one of them.
            let root = nodes.root(0).unwrap().unwrap();
            if head.cube.k() + 1 < root.cube.k() {
                let whole = |child: &Node| !child.cube.contains_cube(head.cube);
                let others: Vec<Node> = nodes.children(&root).unwrap().filter(whole).collect();
                assert!(!others.is_empty());
                assert!(others.iter().all(|child| nodes.children(child).is_ok()));
            }
        }
    }
}
