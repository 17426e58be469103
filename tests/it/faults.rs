//! Law 7 where the disk fails, the process is killed or the power goes: a store is at its last commit or at the next one,
//! and giving the command again finishes the job.
//!
//! A sample in an ordinary run; every place in turn with `ESKER_SWEEP` (docs/testing.md has the counts).

use crate::support::{Random, TinyLas, esker_ok};
use esker::ingest::{IngestOptions, LatticeWish, ingest};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

const ENOSPC: i32 = 28;
const EIO: i32 = 5;

/// The shim, compiled.
pub fn shim(folder: &Path) -> PathBuf {
    let shim = folder.join("faults.so");
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/shim/faults.c");
    let arguments = ["-shared", "-fPIC", "-O1", "-o", shim.to_str().unwrap(), source, "-ldl", "-lpthread"];
    assert!(Command::new("cc").args(arguments).status().unwrap().success());
    shim
}

fn sweep() -> bool {
    std::env::var_os("ESKER_SWEEP").is_some()
}

/// A store of small nodes and two layers, and commands that change it.
struct Site {
    folder: tempfile::TempDir,
    shim: PathBuf,
    before: String,
}

/// A command, by its words; `STORE` stands for the store's path, `FOLDER` for the folder of the inputs.
struct Change {
    name: &'static str,
    words: &'static [&'static str],
    /// The file that it makes or changes.
    store: &'static str,
}

impl Change {
    /// Is the store not there before?
    fn makes(&self) -> bool {
        matches!(self.name, "first" | "merge")
    }
}

const CHANGES: [Change; 6] = [
    Change {
        name: "first",
        words: &["ingest", "WORK/n.esker", "FOLDER/dense.las", "FOLDER/other.las"],
        store: "n.esker",
    },
    Change { name: "ingest", words: &["ingest", "WORK/s.esker", "FOLDER/new.las"], store: "s.esker" },
    Change { name: "remove", words: &["remove", "WORK/s.esker", "dense"], store: "s.esker" },
    Change { name: "replace", words: &["replace", "WORK/s.esker", "other", "FOLDER/new.las"], store: "s.esker" },
    Change { name: "compact", words: &["compact", "WORK/s.esker"], store: "s.esker" },
    Change { name: "merge", words: &["merge", "WORK/m.esker", "FOLDER/s.esker", "FOLDER/t.esker"], store: "m.esker" },
];

impl Site {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let mut random = Random(77);
        let mut file = |name: &str, points: u64, origin: i32, side: u64| {
            let mut las = TinyLas::new(1);
            for _ in 0..points {
                las.push([0; 3].map(|_: i32| origin + random.below(side) as i32), random.next());
            }
            fs::write(at(name), las.bytes()).unwrap();
        };
        file("dense.las", 700, 0, 200);
        file("other.las", 500, 150, 200);
        file("thin.las", 30, 0, 400);
        file("new.las", 400, 100, 200);
        let options = IngestOptions {
            lattice: LatticeWish { quantum: Some([0.01; 3]), phase: None },
            resources: esker::ingest::Resources { threads: Some(1), ..Default::default() },
            g: 2,
            leaf_capacity: 16,
            ..IngestOptions::default()
        };
        let store = at("s.esker");
        ingest(&store, &[at("dense.las"), at("other.las")], &options, &()).unwrap();
        ingest(&store, &[at("thin.las")], &options, &()).unwrap();
        ingest(&at("t.esker"), &[at("new.las")], &options, &()).unwrap();
        let layers = esker::store::Store::open(&store).unwrap().snapshot().unwrap().site().roots.len();
        assert_eq!(layers, 2, "the thin scan is a layer of its own");
        let shim = shim(folder.path());
        let before = digest(&store);
        Self { folder, shim, before }
    }

    /// A folder with a copy of the store.
    fn work(&self) -> tempfile::TempDir {
        let work = tempfile::tempdir_in(self.folder.path()).unwrap();
        fs::copy(self.folder.path().join("s.esker"), work.path().join("s.esker")).unwrap();
        work
    }

    fn command(&self, change: &Change, work: &Path) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_esker"));
        for word in change.words {
            let word = word.replace("WORK", work.to_str().unwrap());
            command.arg(word.replace("FOLDER", self.folder.path().to_str().unwrap()));
        }
        command.args(["--threads", "1"]);
        command
    }

    /// With this fault on the files of the store.
    fn faulty(&self, change: &Change, work: &Path, fault: &str) -> Command {
        let mut command = self.command(change, work);
        command.env("LD_PRELOAD", &self.shim).env("ESKER_TEST_PATH", work.join(change.store));
        command.env("ESKER_TEST_FAULT", fault).env("ESKER_TEST_COUNT", work.join("count"));
        command
    }

    /// The digest after the change, and how many operations on the store's files it makes.
    fn trial(&self, change: &Change) -> (String, u64) {
        let work = self.work();
        succeeded(&self.faulty(change, work.path(), "none").output().unwrap(), change.name);
        let count = fs::read_to_string(work.path().join("count")).unwrap().trim().parse().unwrap();
        (digest(&work.path().join(change.store)), count)
    }

    /// The store is whole, and before or after the change; once more, the command finishes the job.
    fn check(&self, change: &Change, work: &Path, after: &str, context: &str) {
        let store = work.join(change.store);
        let found = if store.exists() && !esker::store::Store::is_unfinished(&store) {
            let output = Command::new(env!("CARGO_BIN_EXE_esker")).args(["verify", "--deep"]).arg(&store).output();
            succeeded(&output.unwrap(), context);
            digest(&store)
        } else {
            assert!(change.makes(), "{context}: the store is gone");
            String::new()
        };
        let is_after = found == after;
        let scans = if found.is_empty() { String::new() } else { esker_ok(&["scans", store.to_str().unwrap()]) };
        let is_before = found == self.before || change.makes() && scans.lines().count() < 2;
        assert!(is_before || is_after, "{context}: neither before nor after");
        if !is_after || matches!(change.name, "first" | "ingest" | "compact") {
            succeeded(&self.command(change, work).output().unwrap(), &format!("{context}, again"));
            assert_eq!(digest(&store), after, "{context}, again");
        }
        let left: Vec<_> = fs::read_dir(work).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert!(left.iter().all(|name| !name.to_string_lossy().contains("spill")), "{context}: {left:?}");
    }
}

fn digest(store: &Path) -> String {
    esker_ok(&["digest", store.to_str().unwrap()])
}

fn succeeded(output: &Output, context: &str) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{context}: {}\n{stderr}", output.status);
}

/// Some of `0..count`, or all in a sweep.
fn places(count: u64, sample: u64, random: &mut Random) -> Vec<u64> {
    if sweep() { (0..count).collect() } else { (0..sample).map(|_| random.below(count)).collect() }
}

#[test]
fn a_disk_that_fails_at_any_place_leaves_the_last_commit_or_the_next() {
    let site = Site::new();
    let mut random = Random(20_261_123);
    for change in &CHANGES {
        let (after, count) = site.trial(change);
        println!("{}: {count} operations", change.name);
        assert!(count > 20, "{}: the shim saw {count} operations", change.name);
        for place in places(count, 6, &mut random) {
            let faults = [
                format!("from:{place}:{ENOSPC}"),
                format!("from:{place}:{EIO}"),
                format!("once:{place}:{EIO}"),
                format!("once:{place}:{ENOSPC}"),
                format!("short:{place}"),
            ];
            for fault in faults {
                let context = format!("{} with {fault} of {count}", change.name);
                let work = site.work();
                let output = site.faulty(change, work.path(), &fault).output().unwrap();
                let stderr = String::from_utf8_lossy(&output.stderr);
                assert!(matches!(output.status.code(), Some(0 | 1)), "{context}: {}\n{stderr}", output.status);
                assert!(!stderr.contains("panicked"), "{context}: {stderr}");
                site.check(change, work.path(), &after, &context);
            }
        }
    }
}

#[test]
fn a_process_that_dies_in_the_middle_of_a_write_leaves_the_last_commit_or_the_next() {
    let site = Site::new();
    let mut random = Random(20_261_124);
    for change in &CHANGES {
        let (after, count) = site.trial(change);
        for place in places(count, 12, &mut random) {
            let context = format!("{} torn at {place} of {count}", change.name);
            let work = site.work();
            let output = site.faulty(change, work.path(), &format!("torn:{place}")).output().unwrap();
            assert_eq!(output.status.code(), Some(137), "{context}");
            site.check(change, work.path(), &after, &context);
        }
    }
}

#[test]
fn a_process_that_is_killed_leaves_the_last_commit_or_the_next() {
    let site = Site::new();
    let mut random = Random(20_261_125);
    let mut cut_short = 0;
    for change in &CHANGES {
        let (after, _) = site.trial(change);
        let work = site.work();
        let begun = Instant::now();
        succeeded(&site.command(change, work.path()).output().unwrap(), change.name);
        let usual = begun.elapsed();
        for trial in 0..if sweep() { 200 } else { 8 } {
            let work = site.work();
            let mut child =
                site.command(change, work.path()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            let delay = usual.mul_f64(random.unit());
            std::thread::sleep(delay.max(Duration::from_micros(200)));
            child.kill().unwrap();
            cut_short += usize::from(!child.wait().unwrap().success());
            site.check(change, work.path(), &after, &format!("{} killed after {delay:?}, trial {trial}", change.name));
        }
    }
    assert!(cut_short > 5, "hardly anything was killed in time: {cut_short}");
}

/// What a process did to its files.
struct Step {
    what: u8,
    path: String,
    offset: u64,
    data: Vec<u8>,
}

fn read_log(path: &Path) -> Vec<Step> {
    let bytes = fs::read(path).unwrap();
    let mut rest = bytes.as_slice();
    let mut steps = Vec::new();
    let mut take = |n: usize| {
        let (head, tail) = rest.split_at(n);
        rest = tail;
        (head.to_vec(), tail.is_empty())
    };
    loop {
        let what = take(1).0[0];
        let length = u32::from_le_bytes(take(4).0.try_into().unwrap()) as usize;
        let path = String::from_utf8(take(length).0).unwrap();
        let offset = u64::from_le_bytes(take(8).0.try_into().unwrap());
        let (count, mut last) = take(8);
        let count = u64::from_le_bytes(count.try_into().unwrap()) as usize;
        let mut data = Vec::new();
        if count > 0 {
            (data, last) = take(count);
        }
        steps.push(Step { what, path, offset, data });
        if last {
            return steps;
        }
    }
}

/// A file after a power cut: what was synced, and of the rest what the disk happened to have written.
#[derive(Clone, Default)]
struct Disk {
    synced: Vec<u8>,
    unsynced: Vec<(u8, u64, Vec<u8>)>,
}

impl Disk {
    fn apply(content: &mut Vec<u8>, what: u8, offset: u64, data: &[u8]) {
        if what == b'T' {
            content.resize(offset as usize, 0);
        } else {
            let end = offset as usize + data.len();
            content.resize(content.len().max(end), 0);
            content[offset as usize..end].copy_from_slice(data);
        }
    }

    fn sync(&mut self) {
        for (what, offset, data) in std::mem::take(&mut self.unsynced) {
            Self::apply(&mut self.synced, what, offset, &data);
        }
    }

    /// Each unsynced step is there, torn at a sector, or lost; in order or not.
    fn after_power_cut(mut self, random: &mut Random, all_lost: bool) -> Vec<u8> {
        if all_lost {
            return self.synced;
        }
        random.shuffle(&mut self.unsynced);
        for (what, offset, mut data) in self.unsynced {
            match random.below(4) {
                0 => continue,
                1 => data.truncate(data.len() / 2 / 512 * 512),
                _ => {}
            }
            Self::apply(&mut self.synced, what, offset, &data);
        }
        self.synced
    }
}

#[test]
fn a_power_cut_leaves_the_last_commit_or_the_next() {
    let site = Site::new();
    let mut random = Random(20_261_126);
    for change in &CHANGES {
        let work = site.work();
        let log = work.path().join("log");
        let mut command = site.faulty(change, work.path(), "none");
        succeeded(&command.env("ESKER_TEST_LOG", &log).output().unwrap(), change.name);
        let after = digest(&work.path().join(change.store));
        let steps = read_log(&log);
        println!("{}: {} steps", change.name, steps.len());
        let name = |path: &str| Path::new(path).file_name().unwrap().to_string_lossy().into_owned();
        for cut in places(steps.len() as u64, 10, &mut random) {
            let place = site.work();
            let mut files: BTreeMap<String, Disk> = BTreeMap::new();
            let start = |file: &str| match fs::read(place.path().join(file)) {
                Ok(synced) => Disk { synced, unsynced: Vec::new() },
                Err(_) => Disk::default(),
            };
            for step in &steps[..=cut as usize] {
                let file = name(&step.path);
                // Shared memory and locks don't outlive the machine; the temporary file is removed as a leftover.
                if !file.ends_with(".esker") && !file.ends_with("-wal") && !file.ends_with("-journal") {
                    continue;
                }
                let disk = files.entry(file.clone()).or_insert_with(|| start(&file));
                match step.what {
                    b'S' => disk.sync(),
                    b'U' => {
                        files.remove(&file);
                        let _ = fs::remove_file(place.path().join(&file));
                    }
                    what => disk.unsynced.push((what, step.offset, step.data.clone())),
                }
            }
            let all_lost = random.below(3) == 0;
            for (file, disk) in files {
                fs::write(place.path().join(file), disk.after_power_cut(&mut random, all_lost)).unwrap();
            }
            site.check(change, place.path(), &after, &format!("{} cut at {cut} of {}", change.name, steps.len()));
        }
    }
}
