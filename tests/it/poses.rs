//! Scans that have a place of their own: what comes from several frames coincides, and goes back to where it came from.

use crate::support::{data_folder, esker_fails, esker_ok};
use esker::geometry::Pose;
use esker::query::Query;
use esker::store::{Snapshot, Store};
use std::fs;
use std::ops::ControlFlow;
use std::path::Path;

/// The lattice positions of a scan, sorted.
fn positions(snapshot: &Snapshot, scan: &str) -> Vec<[u64; 3]> {
    let mut found = Vec::new();
    let query = Query::new().scans([scan.to_owned()]).positions_only();
    query
        .run(snapshot, |batch| {
            found.extend(batch.positions.iter().map(|p| p.0));
            ControlFlow::Continue(())
        })
        .unwrap();
    found.sort_unstable();
    found
}

fn ingest(store: &Path, arguments: &[&str]) -> serde_json::Value {
    let all = [&["ingest", store.to_str().unwrap(), "--json"], arguments].concat();
    serde_json::from_str(&esker_ok(&all)).unwrap()
}

#[test]
fn posed_scans_of_one_place_coincide() {
    let Some(data) = data_folder() else { return };
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("spanner.esker");
    let place = |name: &str| data.join(name).to_str().unwrap().to_owned();
    let report = ingest(
        &store,
        &["--quantum", "0.0001", &place("derived/spanner_3platform_posed.e57"), &place("spanner_multiplatform")],
    );
    let scans = report["scans"].as_array().unwrap();
    assert_eq!(scans.len(), 6);
    let snapshot = Store::open(&store).unwrap().snapshot().unwrap();
    let tiles = ["ALS_Clip", "UAS_Clip", "MLS_Clip"].map(|name| positions(&snapshot, name));
    for (index, tile) in tiles.iter().enumerate() {
        let posed = positions(&snapshot, scans[index]["name"].as_str().unwrap());
        assert_eq!(posed.len() as u64, scans[index]["stored"].as_u64().unwrap());
        // In their frames these points were floats and turned about; placed, each is a point of the tile.
        let strangers = posed.iter().filter(|p| tile.binary_search(p).is_err()).count();
        assert_eq!(strangers, 0, "{} of {} points of scan {index}", strangers, posed.len());
        if index == 0 {
            assert_eq!(posed, *tile);
        }
    }
    // The scan keeps its place.
    let scan = snapshot.scans().iter().find(|s| s.pose[3] != 0.0).unwrap();
    assert_eq!([scan.pose[3], scan.pose[7], scan.pose[11]], [470_638.784, 3_810_234.354, 2276.969]);
    assert_eq!(scan.format, "e57");
}

/// X, Y, Z of every row of a CSV file.
fn csv(path: &Path) -> Vec<[f64; 3]> {
    let text = fs::read_to_string(path).unwrap();
    let row = |line: &str| {
        let mut words = line.split(',').map(|w| w.parse().unwrap());
        std::array::from_fn(|_| words.next().unwrap())
    };
    let mut rows: Vec<[f64; 3]> = text.lines().skip(1).map(row).collect();
    rows.sort_by(|a, b| a.partial_cmp(b).unwrap());
    rows
}

#[test]
fn a_scan_goes_back_to_its_own_frame() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let text: String = (0..500).map(|i| format!("{} {} {}.5 {i}\n", i % 23 - 11, i % 7, i % 5)).collect();
    fs::write(at("local.xyz"), &text).unwrap();
    fs::write(at("other.xyz"), &text).unwrap();
    let pose = Pose::from_quaternion([4e5, 5.5e6, 120.0], [0.9, 0.1, -0.2, 0.3]).unwrap();
    let words: Vec<_> = pose.to_matrix().iter().map(f64::to_string).collect();
    fs::write(at("pose.txt"), words.join(" ") + "\n1 2 3 1 0 0 0\n").unwrap();
    let path = |name: &str| at(name).to_str().unwrap().to_owned();
    let store = at("s.esker");
    ingest(&store, &[&path("local.xyz"), &path("other.xyz"), "--pose", &path("pose.txt")]);
    let snapshot = Store::open(&store).unwrap().snapshot().unwrap();
    let quantum = snapshot.site().lattice.quantum_f64()[0];
    // The same numbers in two places: two scans.
    assert_eq!(snapshot.scans().len(), 2);
    assert_eq!(snapshot.scans()[0].pose, pose.to_matrix());
    let mut expected: Vec<[f64; 3]> = text
        .lines()
        .map(|l| {
            let mut words = l.split(' ').map(|w| w.parse().unwrap());
            std::array::from_fn(|_| words.next().unwrap())
        })
        .collect();
    expected.sort_by(|a, b| a.partial_cmp(b).unwrap());
    // In the world, the points are where the pose puts them; in the scan's frame, where they were.
    let s = store.to_str().unwrap().to_owned();
    esker_ok(&["query", &s, "--scan", "local", "-o", &path("world.csv"), "--attributes", "none"]);
    let mut world: Vec<_> = expected.iter().map(|p| pose.world_from_scan(*p)).collect();
    world.sort_by(|a, b| a.partial_cmp(b).unwrap());
    let largest = |found: &[[f64; 3]], expected: &[[f64; 3]]| {
        assert_eq!(found.len(), expected.len());
        let pairs = found.iter().flatten().zip(expected.iter().flatten());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    let off = largest(&csv(&at("world.csv")), &world);
    assert!(off <= 0.51 * quantum, "{off}");
    let frame = ["query", &s, "--scan", "local", "--frame", "scan", "-o"];
    esker_ok(&[&frame[..], &[&path("frame.csv"), "--attributes", "none"]].concat());
    // Half a step in the world, turned, and half a step here. Rows of equal x may come in another order, so x is rounded.
    let round = |rows: Vec<[f64; 3]>| {
        let mut rows: Vec<_> = rows.into_iter().map(|r| r.map(|v| (v * 100.0).round() / 100.0)).collect();
        rows.sort_by(|a, b| a.partial_cmp(b).unwrap());
        rows
    };
    assert_eq!(round(csv(&at("frame.csv"))), expected);
    // LAS has steps of the quantum.
    esker_ok(&[&frame[..], &[&path("frame.las")]].concat());
    let las = las::Reader::from_path(at("frame.las")).unwrap();
    assert_eq!(las.header().transforms().x.scale, quantum);
    assert!((las.header().bounds().min.z - 0.5).abs() <= 2.0 * quantum);
    esker_fails(
        &["query", &s, "--frame", "scan", "-o", &path("two.las")],
        1,
        &["the frame of a scan is for the points of one scan"],
    );
}

/// They kept the directions that they had in the scan's frame, beside positions in the world.
#[test]
fn normals_turn_with_their_scan_and_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(path("n.csv"), "x,y,z,nx,ny,nz\n10,0,0,1,0,0\n20,0,0,0,0,0\n30,0,0,nan,0,1\n40,0,0,0.6,0,0.8\n").unwrap();
    // A quarter turn about z, and larger by a tenth.
    fs::write(path("pose.txt"), "0 -1.1 0 5\n1.1 0 0 6\n0 0 1.1 7\n0 0 0 1\n").unwrap();
    let s = path("s.esker");
    esker_ok(&["ingest", &s, &path("n.csv"), "--pose", &path("pose.txt")]);
    let rows = |more: &[&str]| {
        let text = esker_ok(&[&["query", &s, "-o", "-", "--format", "csv"], more].concat());
        let mut rows: Vec<String> = text.lines().skip(1).map(str::to_owned).collect();
        rows.sort();
        rows
    };
    assert_eq!(rows(&[]), ["5,17,7,0,1,0", "5,28,7,0,0,0", "5,39,7,NaN,0,1", "5,50,7,0,0.6,0.8"]);
    assert_eq!(rows(&["--frame", "scan"]), ["10,0,0,1,0,0", "20,0,0,0,0,0", "30,0,0,NaN,0,1", "40,0,0,0.6,0,0.8"]);
    // Whole numbers can't be turned, and are told.
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
               property char nx\nproperty char ny\nproperty char nz\nend_header\n1 2 3 127 0 0\n";
    fs::write(path("i.ply"), ply).unwrap();
    let told = crate::support::esker(&["ingest", &path("i.esker"), &path("i.ply"), "--pose", &path("pose.txt")]);
    assert!(String::from_utf8_lossy(&told.stderr).contains("its normals are not three floats of one type"), "{told:?}");
}

#[test]
fn poses_are_one_each_and_rigid() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(path("a.xyz"), "1 2 3\n4 5 6\n").unwrap();
    fs::write(path("b.xyz"), "1 2 3\n4 5 7\n").unwrap();
    fs::write(path("one.txt"), "0 0 0 1 0 0 0\n").unwrap();
    fs::write(path("moved.txt"), "5 0 0 1 0 0 0\n").unwrap();
    fs::write(path("flat.txt"), "1 0 0 0 0 1 0 0 0 0 0 0 0 0 0 1\n").unwrap();
    let store = path("s.esker");
    let both = ["ingest", &store, &path("a.xyz"), &path("b.xyz"), "--pose"];
    esker_fails(&[&both[..], &[&path("one.txt")]].concat(), 1, &["1 poses are given for 2 files"]);
    esker_fails(&["ingest", &store, &path("a.xyz"), "--columns", "x,y"], 2, &["x, y and z are needed"]);
    esker_fails(&[&both[..], &[&path("flat.txt")]].concat(), 1, &["flat.txt: at byte 0", "the matrix is singular"]);
    esker_ok(&[&both[..], &[&path("one.txt"), "--pose", &path("moved.txt")]].concat());
    // The same again is skipped; the same elsewhere is another matter.
    let again = esker_ok(&[&both[..], &[&path("one.txt"), "--pose", &path("moved.txt")]].concat());
    assert_eq!(again.matches("skipped, already in the store").count(), 2, "{again}");
    esker_fails(
        &["ingest", &store, &path("b.xyz")],
        1,
        &["b.xyz: the store has it as 'b' with another pose", "replace"],
    );
}

#[test]
fn a_replaced_pose_is_the_pose_of_a_fresh_ingest() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let rows: String = (0..300).map(|i| format!("{} {} {}\n", i % 17, i % 13, i % 7)).collect();
    let block = |pose: &str| format!("100\n3\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n{pose} 1\n");
    let row = |l: &str| format!("{l} 0.5\n");
    let rows: String = rows.lines().map(row).collect();
    fs::write(path("two.ptx"), [block("5 0 0"), rows.clone(), block("0 50 0"), rows].concat()).unwrap();
    fs::write(path("moved.txt"), "1000 2000 3 0.8 0 0 0.6\n").unwrap();
    fs::write(path("again.txt"), "7 7 7 1 0 0 0\n").unwrap();
    let quantum = ["--quantum", "0.001"];
    let digest = |store: &str| esker_ok(&["digest", store]);
    let posed = |store: &str, pose: &str| {
        esker_ok(&[&["ingest", store, &path("two.ptx"), "--pose", &path(pose)][..], &quantum].concat());
    };
    let (store, fresh) = (path("s.esker"), path("fresh.esker"));
    posed(&store, "moved.txt");
    let before = digest(&store);
    // Read again as it is: the pose that was given stays.
    esker_ok(&["replace", &store, "two-2"]);
    assert_eq!(digest(&store).lines().next(), before.lines().next());
    // Both blocks elsewhere: as if they had been there from the start.
    for scan in ["two-2", "two-1"] {
        esker_ok(&["replace", &store, scan, "--pose", &path("again.txt")]);
    }
    posed(&fresh, "again.txt");
    assert_eq!(digest(&store), digest(&fresh));
    esker_ok(&["verify", &store, "--deep"]);
}
