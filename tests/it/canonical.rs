//! Law 3: the tree is a function of the points and the lattice, not of how they came.

use crate::support::{Random, RawLas, data_folder, esker_fails, esker_ok, las_like};
use std::fs;
use std::path::{Path, PathBuf};

/// A LAS file to cut and shuffle: a real tile if there is one, else a generated terrain.
fn tile(folder: &Path) -> PathBuf {
    if let Some(data) = data_folder() {
        let real = data.join("pdal_autzen/autzen_trim_7.las");
        if real.exists() {
            return real;
        }
    }
    let made = folder.join("made.las");
    esker_ok(&["generate", "terrain", "--points", "110000", "-o", made.to_str().unwrap()]);
    made
}

fn points_digest(store: &Path) -> String {
    esker_ok(&["digest", store.to_str().unwrap()]).lines().next().unwrap().to_owned()
}

struct Trial {
    folder: tempfile::TempDir,
    number: usize,
}

impl Trial {
    /// The `points` digest after these ingests, one command each.
    fn digest(&mut self, commands: &[Vec<&Path>], options: &[&str]) -> String {
        self.number += 1;
        let store = self.folder.path().join(format!("{}.esker", self.number));
        for inputs in commands {
            let mut arguments = vec!["ingest", store.to_str().unwrap()];
            arguments.extend(inputs.iter().map(|p| p.to_str().unwrap()));
            arguments.extend(options);
            esker_ok(&arguments);
        }
        esker_ok(&["verify", store.to_str().unwrap(), "--deep"]);
        points_digest(&store)
    }
}

#[test]
fn the_tree_does_not_depend_on_threads_memory_order_or_grouping() {
    let mut trial = Trial { folder: tempfile::tempdir().unwrap(), number: 0 };
    let path = tile(trial.folder.path());
    let bytes = fs::read(&path).unwrap();
    let records = RawLas::read(&path).unwrap().records;
    let expected = trial.digest(&[vec![&path]], &[]);

    assert_eq!(trial.digest(&[vec![&path]], &["--threads", "1"]), expected, "one thread");
    assert_eq!(trial.digest(&[vec![&path]], &["--threads", "2"]), expected, "two threads");
    assert_eq!(trial.digest(&[vec![&path]], &["--memory", "64MiB"]), expected, "64 MiB");
    assert_eq!(trial.digest(&[vec![&path]], &["--memory", "1MiB"]), expected, "spilling");
    assert_eq!(trial.digest(&[vec![&path]], &["--memory", "4GiB"]), expected, "4 GiB");

    let mut random = Random(20_261_122);
    let mut shuffled = records.clone();
    random.shuffle(&mut shuffled);
    let whole = trial.folder.path().join("shuffled.las");
    fs::write(&whole, las_like(&bytes, &shuffled)).unwrap();
    assert_eq!(trial.digest(&[vec![&whole]], &[]), expected, "shuffled");

    let parts: Vec<PathBuf> = (0..5)
        .map(|i| {
            let path = trial.folder.path().join(format!("part{i}.las"));
            let own: Vec<_> = shuffled.iter().skip(i).step_by(5).cloned().collect();
            fs::write(&path, las_like(&bytes, &own)).unwrap();
            path
        })
        .collect();
    let p: Vec<&Path> = parts.iter().map(PathBuf::as_path).collect();
    assert_eq!(trial.digest(std::slice::from_ref(&p), &[]), expected, "five files at once");
    let reversed: Vec<&Path> = p.iter().rev().copied().collect();
    assert_eq!(trial.digest(&[reversed], &["--memory", "1MiB"]), expected, "reversed, spilling");
    for _ in 0..3 {
        let mut order = p.clone();
        random.shuffle(&mut order);
        let cut = 1 + random.below(4) as usize;
        let commands: Vec<Vec<&Path>> = order.chunks(cut).map(<[_]>::to_vec).collect();
        assert_eq!(trial.digest(&commands, &[]), expected, "one by one: {commands:?}");
    }
}

#[test]
fn the_digest_notices_a_changed_point() {
    let mut trial = Trial { folder: tempfile::tempdir().unwrap(), number: 0 };
    let path = tile(trial.folder.path());
    let bytes = fs::read(&path).unwrap();
    let mut records = RawLas::read(&path).unwrap().records;
    let expected = trial.digest(&[vec![&path]], &[]);
    // The intensity of one record.
    records[777][12] ^= 1;
    let changed = trial.folder.path().join("changed.las");
    fs::write(&changed, las_like(&bytes, &records)).unwrap();
    assert_ne!(trial.digest(&[vec![&changed]], &[]), expected);
}

#[test]
fn a_rerun_adds_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = tile(folder.path());
    let store = folder.path().join("s.esker");
    let arguments = ["ingest", store.to_str().unwrap(), path.to_str().unwrap(), "--json"];
    esker_ok(&arguments);
    let before = esker_ok(&["digest", store.to_str().unwrap()]);
    let report: serde_json::Value = serde_json::from_str(&esker_ok(&arguments)).unwrap();
    assert_eq!(report["points"], 0);
    assert_eq!(report["skipped"].as_array().unwrap().len(), 1);
    // What it would be called otherwise is not dropped without a word.
    for (options, word) in [
        (&["--name", "other", "--crs", "EPSG:25832"][..], "; its name and its CRS stay as they are"),
        (&["--name", "other"], "; its name stays as it is"),
        (&["--crs", "EPSG:25832"], "; its CRS stays as it is"),
        (&[], "'"),
    ] {
        let report: serde_json::Value = serde_json::from_str(&esker_ok(&[&arguments[..], options].concat())).unwrap();
        let reason = report["skipped"][0]["reason"].as_str().unwrap();
        assert!(reason.ends_with(word), "{options:?}: {reason}");
    }
    assert_eq!(esker_ok(&["digest", store.to_str().unwrap()]), before);
}

/// A first ingest that is killed leaves a store of nothing: what is made of other files then is what they alone give.
#[test]
fn nothing_of_an_ingest_that_was_cut_off_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(at("fine.csv"), "x,y,z\n0.12345,0.2,0.3\n7,8,9\n").unwrap();
    esker_ok(&["ingest", &at("clean.esker"), &at("fine.csv")]);
    let lattice = esker::lattice::Lattice::uniform(0.5).unwrap();
    let crs = esker::points::Crs::parse("EPSG:2154");
    let site = esker::store::SiteOptions::new(lattice).crs(crs);
    // As it is found where the process is killed before its first commit.
    drop(esker::store::Store::create_with_writer(at("cut.esker"), site.clone()).unwrap());
    let report = esker_ok(&["ingest", &at("cut.esker"), &at("fine.csv")]);
    assert!(report.contains("positions exact"), "{report}");
    assert_eq!(esker_ok(&["digest", &at("cut.esker")]), esker_ok(&["digest", &at("clean.esker")]));
    assert!(!esker_ok(&["info", &at("cut.esker")]).contains("2154"));
    esker_ok(&["verify", &at("cut.esker"), "--deep"]);
    // What can't be read leaves no store, as if none had been there.
    drop(esker::store::Store::create_with_writer(at("again.esker"), site.clone()).unwrap());
    fs::write(at("bad.las"), "LASF, and nothing else").unwrap();
    esker_fails(&["ingest", &at("again.esker"), &at("bad.las")], 1, &["bad.las"]);
    esker_ok(&["ingest", &at("again.esker"), &at("fine.csv"), "--quantum", "0.00001"]);
    // One that was made to be filled keeps its lattice.
    drop(esker::store::Store::create(at("made.esker"), site).unwrap());
    esker_fails(
        &["ingest", &at("made.esker"), &at("fine.csv"), "--quantum", "0.1"],
        1,
        &["the store's quantum is 0.5"],
    );
}
