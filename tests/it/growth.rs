//! Cost follows the change: what adding, replacing and removing a small scan reads of a large store.

use crate::support::{Random, TinyLas};
use esker::ingest::{IngestOptions, LatticeWish, Resources, digest, ingest, remove, replace};
use esker::lattice::{BIAS, Cube, LatticeBox, LatticePoint};
use esker::store::{Store, verify};
use rusqlite::Connection;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const CAPACITY: u32 = 12;
/// The site's low corner, at which an aligned cube begins: the root is as large as the site.
const LOW: i32 = 2731;
/// Nodes of up to so many points may be read with all that lies below them.
const TOGETHER: u64 = 32 * CAPACITY as u64;

fn options() -> IngestOptions {
    IngestOptions {
        lattice: LatticeWish { quantum: Some([0.01; 3]), phase: None },
        g: 3,
        leaf_capacity: CAPACITY,
        ..IngestOptions::default()
    }
}

struct Place(tempfile::TempDir);

impl Place {
    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// A file of points in a cube.
    fn file(&self, name: &str, points: u64, origin: i32, side: u64, random: &mut Random) -> PathBuf {
        let mut las = TinyLas::new(1);
        for _ in 0..points {
            las.push([0; 3].map(|_: i32| origin + random.below(side) as i32), random.next());
        }
        std::fs::write(self.path(name), las.bytes()).unwrap();
        self.path(name)
    }
}

/// A layer and the key of a node, as the file has them.
type Row = (u16, Vec<u8>);

fn meet(cube: Cube, area: &LatticeBox) -> bool {
    let cube = cube.to_box();
    (0..3).all(|axis| cube.min.0[axis] <= area.max.0[axis] && area.min.0[axis] <= cube.max.0[axis])
}

/// All node rows, and those that a change inside `area` may read: along the paths into the root's cells that it meets,
/// where winners of those cells come and go, their siblings, and what is read together with them.
fn rows(store: &Path, area: &LatticeBox) -> (Vec<Row>, BTreeSet<Row>) {
    let snapshot = Store::open(store).unwrap().snapshot().unwrap();
    let index = snapshot.index().unwrap();
    let root = index.head(index.root(0).unwrap()).cube;
    let cell = |at| Cube::containing(at, root.k() - snapshot.site().g).to_box();
    let area = &cell(area.min).union(&cell(area.max));
    let row = |node: u32| {
        let head = index.head(node);
        (head.layer, head.cube.node_key().0.to_vec())
    };
    let mut near: BTreeSet<Row> = index.roots().map(row).collect();
    for node in (0..index.len() as u32).filter(|&node| meet(index.head(node).cube, area)) {
        near.extend(index.children(node).map(row));
        if index.head(node).subtree_points <= TOGETHER {
            near.extend(index.subtree(node).map(row));
        }
    }
    ((0..index.len() as u32).map(row).collect(), near)
}

/// Adds to the checksums of these rows of both tables.
fn bend(store: &Path, rows: &[Row], by: i64) {
    let connection = Connection::open(store).unwrap();
    let transaction = connection.unchecked_transaction().unwrap();
    for (table, (layer, key)) in ["node", "zone"].iter().flat_map(|table| rows.iter().map(move |row| (table, row))) {
        let update = format!("UPDATE {table} SET checksum = checksum + ? WHERE layer = ? AND key = ?");
        assert_eq!(transaction.execute(&update, (by, layer, key)).unwrap(), 1, "a row is gone from {table}");
    }
    transaction.commit().unwrap();
}

/// Every row that a change has nothing to do with is damaged while it runs: it could not be read.
#[test]
fn a_small_change_of_a_large_store_reads_the_rows_around_it_and_no_others() {
    let place = Place(tempfile::tempdir().unwrap());
    let mut random = Random(2_025);
    let site = place.file("site.las", 60_000, LOW, 1 << 12, &mut random);
    let patch = place.file("patch.las", 400, LOW + 1100, 60, &mut random);
    let other = place.file("other.las", 450, LOW + 1110, 50, &mut random);
    let store = place.path("s.esker");
    ingest(&store, std::slice::from_ref(&site), &options(), &()).unwrap();
    let corner = |at: i64| LatticePoint([(BIAS + i64::from(LOW) + at) as u64; 3]);
    let area = LatticeBox { min: corner(1100), max: corner(1159) };
    type Step<'s> = (&'s str, Vec<PathBuf>, Box<dyn Fn() + 's>);
    let steps: [Step<'_>; 3] = [
        ("add", vec![site.clone(), patch.clone()], {
            let (store, patch) = (store.clone(), patch.clone());
            Box::new(move || {
                ingest(&store, std::slice::from_ref(&patch), &options(), &()).unwrap();
                let snapshot = Store::open(&store).unwrap().snapshot().unwrap();
                assert_eq!(snapshot.site().roots.len(), 1, "it became a layer");
            })
        }),
        ("replace", vec![site.clone(), other.clone()], {
            let store = store.clone();
            Box::new(move || {
                replace(&store, "patch", Some(&other), &options(), &()).unwrap();
            })
        }),
        ("remove", vec![site.clone()], {
            let store = store.clone();
            Box::new(move || {
                remove(&store, &["patch".into()], &Resources::default(), &()).unwrap();
            })
        }),
    ];
    for (what, left, step) in steps {
        let (all, near) = rows(&store, &area);
        assert!(all.len() > 3000 && near.len() * 10 < all.len(), "{what}: {} of {} are near", near.len(), all.len());
        let far: Vec<Row> = all.into_iter().filter(|row| !near.contains(row)).collect();
        bend(&store, &far, 1);
        step();
        bend(&store, &far, -1);
        let report = verify(&Store::open(&store).unwrap(), true, &|_, _| std::ops::ControlFlow::Continue(())).unwrap();
        assert!(report.findings.is_empty(), "{what}: {:?}", report.findings);
        let fresh = place.path(&format!("{what}.esker"));
        ingest(&fresh, &left, &options(), &()).unwrap();
        let digest = |store: &Path| digest(store, &Resources::default(), &()).unwrap().points.to_string();
        assert_eq!(digest(&store), digest(&fresh), "{what}");
    }
}
