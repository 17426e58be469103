//! Law 3 over time: whatever is added, removed, replaced, hidden and compacted, in whatever order and grouping, the store
//! is the one that a single ingest of what is left would have made.

use crate::support::{Random, TinyLas};
use esker::ingest::{
    IngestOptions, LatticeWish, Resources, compact, digest, ingest, merge, remove, replace, set_visible,
};
use esker::store::{Store, verify};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Histories in an ordinary run; with `ESKER_SWEEP`, [`SWEEP`].
const HISTORIES: u64 = 200;
const SWEEP: u64 = 5_000;

/// Beyond the ordinary ones, what a sweep has found: a replacement through two temporary files at once (906); a former root
/// with the points that it had, but with the parts of a root (2262, 4205).
const FOUND: [u64; 3] = [906, 2262, 4205];

/// Small nodes, so that a few hundred points make a tree of several levels and layers matter.
fn options(memory: Option<u64>) -> IngestOptions {
    IngestOptions {
        lattice: LatticeWish { quantum: Some([0.01; 3]), phase: None },
        resources: Resources { memory_bytes: memory, threads: Some(1), wait: false },
        g: 2,
        leaf_capacity: 12,
        ..IngestOptions::default()
    }
}

/// Files to choose from: dense ones beside each other, overlapping ones, thin wide ones, one far away, one that repeats
/// positions of another, of several point formats.
fn files(folder: &Path, random: &mut Random) -> Vec<PathBuf> {
    let mut made: Vec<TinyLas> = Vec::new();
    for i in 0..6_u64 {
        let origin = [0, 1, 2].map(|_| random.below(400) as i32);
        let (points, side) = match i {
            0 | 1 => (150 + random.below(250), 60),
            2 => (20 + random.below(40), 1000),
            3 => (1 + random.below(3), 8),
            4 => (60, 200),
            _ => (80, 120),
        };
        let far = if i == 4 { 100_000 } else { 0 };
        let format = [0, 1, 3, 1, 0, 2][i as usize];
        let mut las = TinyLas::new(format);
        for _ in 0..points {
            let at = origin.map(|o| far + o + random.below(side) as i32);
            las.push(at, random.next());
        }
        if i == 5 {
            for point in made[0].positions().into_iter().step_by(3) {
                las.push(point, random.below(2));
            }
        }
        made.push(las);
    }
    let path = |i: usize| folder.join(format!("f{i}.las"));
    made.iter().enumerate().for_each(|(i, las)| std::fs::write(path(i), las.bytes()).unwrap());
    (0..made.len()).map(path).collect()
}

fn checked(store: &Path, context: &str) -> [String; 2] {
    let report = verify(&Store::open(store).unwrap(), true, &|_, _| std::ops::ControlFlow::Continue(())).unwrap();
    assert!(report.findings.is_empty(), "{context}: {:?}", report.findings);
    let digest = digest(store, &Resources::default(), &()).unwrap();
    [digest.points.to_string(), digest.scans.to_string()]
}

#[test]
fn every_history_ends_in_the_store_of_what_is_left() {
    let sweep = std::env::var_os("ESKER_SWEEP").is_some();
    // A sweep may be cut in pieces.
    let from = std::env::var("ESKER_SWEEP_FROM").ok().and_then(|seed| seed.parse().ok()).unwrap_or(0);
    let seeds: Vec<u64> = if sweep { (from..SWEEP).collect() } else { (0..HISTORIES).chain(FOUND).collect() };
    let mut most_layers = 0;
    for seed in seeds {
        let mut random = Random(seed);
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path(), &mut random);
        let store = folder.path().join("s.esker");
        let mut expected: HashMap<Vec<usize>, [String; 2]> = HashMap::new();
        let mut present: Vec<usize> = Vec::new();
        let mut said = format!("seed {seed}:");
        for step in 0..4 + random.below(6) {
            let memory = if random.below(4) == 0 { Some(16 << 10) } else { None };
            let resources = Resources { memory_bytes: memory, threads: Some(1), wait: false };
            let absent: Vec<usize> = (0..files.len()).filter(|i| !present.contains(i)).collect();
            let name = |i: usize| format!("f{i}");
            match random.below(8) {
                0..4 if !absent.is_empty() => {
                    let mut new = absent.clone();
                    random.shuffle(&mut new);
                    new.truncate(1 + random.below(2) as usize);
                    said += &format!(" add {new:?} ({memory:?})");
                    let inputs: Vec<PathBuf> = new.iter().map(|&i| files[i].clone()).collect();
                    ingest(&store, &inputs, &options(memory), &()).unwrap_or_else(|e| panic!("{said}: {e}"));
                    present.extend(new);
                }
                _ if step == 0 => continue,
                4 | 5 if !present.is_empty() => {
                    let mut gone = present.clone();
                    random.shuffle(&mut gone);
                    gone.truncate(1 + random.below(2) as usize);
                    said += &format!(" remove {gone:?} ({memory:?})");
                    let names: Vec<String> = gone.iter().map(|&i| name(i)).collect();
                    remove(&store, &names, &resources, &()).unwrap_or_else(|e| panic!("{said}: {e}"));
                    present.retain(|i| !gone.contains(i));
                }
                6 if !present.is_empty() && !absent.is_empty() => {
                    let (old, new) = (present[0], absent[0]);
                    said += &format!(" replace {old} by {new} ({memory:?})");
                    let by = IngestOptions { name: Some(name(new)), ..options(memory) };
                    replace(&store, &name(old), Some(&files[new]), &by, &()).unwrap_or_else(|e| panic!("{said}: {e}"));
                    present.retain(|i| *i != old);
                    present.push(new);
                }
                7 if !present.is_empty() => {
                    said += " hide, compact";
                    set_visible(&store, &[name(present[0])], random.below(2) == 0, &resources, &()).unwrap();
                    compact(&store, None, &resources, &()).unwrap_or_else(|e| panic!("{said}: {e}"));
                    assert!(Store::open(&store).unwrap().snapshot().unwrap().site().roots.len() < 2);
                }
                _ => continue,
            }
            if !store.exists() {
                continue;
            }
            let found = checked(&store, &said);
            let layers = Store::open(&store).unwrap().snapshot().unwrap().site().roots.iter().flatten().count();
            most_layers = most_layers.max(layers);
            let mut set = present.clone();
            set.sort_unstable();
            let fresh = expected.entry(set.clone()).or_insert_with(|| {
                let fresh = folder.path().join(format!("{set:?}.esker"));
                let inputs: Vec<PathBuf> = set.iter().map(|&i| files[i].clone()).collect();
                if inputs.is_empty() {
                    ingest(&fresh, &files[..1], &options(None), &()).unwrap();
                    remove(&fresh, &["f0".into()], &Resources::default(), &()).unwrap();
                } else {
                    ingest(&fresh, &inputs, &options(None), &()).unwrap();
                }
                checked(&fresh, "fresh")
            });
            assert_eq!(*fresh, found, "{said}");
        }
    }
    // Otherwise nothing was said of layers.
    assert!(most_layers >= 3, "{most_layers}");
}

#[test]
fn merged_shards_are_the_store_of_all_their_scans() {
    for seed in 1000..1020 {
        let mut random = Random(seed);
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path(), &mut random);
        let at = |name: &str| folder.path().join(name);
        let cut = 1 + random.below(4) as usize;
        ingest(&at("a.esker"), &files[..cut], &options(None), &()).unwrap();
        // One scan in both.
        ingest(&at("b.esker"), &files[cut - 1..], &options(None), &()).unwrap();
        ingest(&at("all.esker"), &files, &options(None), &()).unwrap();
        let merged = merge(&at("m.esker"), &[at("a.esker"), at("b.esker")], &Resources::default(), &()).unwrap();
        assert_eq!(merged.skipped.len(), 1);
        assert_eq!(checked(&at("m.esker"), "merged"), checked(&at("all.esker"), "all"), "seed {seed}");
        let other = IngestOptions { lattice: LatticeWish { quantum: Some([0.02; 3]), phase: None }, ..options(None) };
        ingest(&at("c.esker"), &files[..1], &other, &()).unwrap();
        let refused = merge(&at("n.esker"), &[at("a.esker"), at("c.esker")], &Resources::default(), &());
        assert!(refused.unwrap_err().to_string().contains("--lattice"), "a store on another lattice was merged");
        assert!(!at("n.esker").exists());
    }
}

#[test]
fn many_layers_become_few_and_stay_the_same_store() {
    let mut random = Random(31);
    let folder = tempfile::tempdir().unwrap();
    let files: Vec<PathBuf> = (0..14_u64)
        .map(|i| {
            let mut las = TinyLas::new((i % 4) as u8);
            for _ in 0..90 + 10 * i {
                las.push([0; 3].map(|_: i32| random.below(500) as i32), random.next());
            }
            let path = folder.path().join(format!("f{i}.las"));
            std::fs::write(&path, las.bytes()).unwrap();
            path
        })
        .collect();
    let (store, fresh) = (folder.path().join("s.esker"), folder.path().join("fresh.esker"));
    let mut most = 0;
    for file in &files {
        // With so little memory every scan is built as a layer.
        ingest(&store, std::slice::from_ref(file), &options(Some(16 << 10)), &()).unwrap();
        let layers = Store::open(&store).unwrap().snapshot().unwrap().site().roots.iter().flatten().count();
        most = most.max(layers);
        assert!(layers <= 8, "{layers} layers");
    }
    assert_eq!(most, 8, "layers were never folded");
    ingest(&fresh, &files, &options(None), &()).unwrap();
    assert_eq!(checked(&store, "layers"), checked(&fresh, "fresh"));
}
