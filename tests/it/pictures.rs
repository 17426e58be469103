//! `esker render`: pictures of stores, drawn by whatever adapter there is. Without one this fails: pictures are part of
//! the product.

use crate::support::{esker_fails, esker_ok};
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Command;

fn pixels(path: &str) -> (u32, u32, Vec<u8>) {
    let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(path).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    (info.width, info.height, bytes)
}

/// An unlit point of colour (200, 100, 50) gives exactly that pixel, whether its file had 8 or 16 bits.
#[test]
fn colours_reach_the_picture_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let view =
        r#"{"eye":[0,-3,0],"target":[0,0,0],"up":[0,0,1],"projection":"perspective","fov_y_deg":60,"size":[64,48]}"#;
    fs::write(path("view.json"), view).unwrap();
    for (name, ty, factor) in [("eight", "uchar", 1_u16), ("sixteen", "ushort", 256), ("full", "ushort", 257)] {
        let rows: String = (0..25)
            .map(|i| {
                let (x, z) = (f64::from(i % 5 - 2) * 0.1, f64::from(i / 5 - 2) * 0.1);
                format!("{x} 0 {z} {} {} {}\n", 200 * factor, 100 * factor, 50 * factor)
            })
            .collect();
        let header = format!(
            "ply\nformat ascii 1.0\nelement vertex 25\nproperty double x\nproperty double y\nproperty double z\n\
             property {ty} red\nproperty {ty} green\nproperty {ty} blue\nend_header\n"
        );
        fs::write(path("p.ply"), header + &rows).unwrap();
        let (store, picture) = (path(&format!("{name}.esker")), path(&format!("{name}.png")));
        esker_ok(&["ingest", &store, &path("p.ply")]);
        esker_ok(&["render", &store, "--view", &path("view.json"), "--unlit", "-o", &picture]);
        let (width, height, bytes) = pixels(&picture);
        assert_eq!((width, height), (64, 48));
        let channels = bytes.len() / (64 * 48);
        let drawn = bytes.chunks_exact(channels).filter(|p| p[..3] == [200, 100, 50]).count();
        assert!(drawn >= 25, "{name}: {drawn} pixels have the colour");
        let reddish = bytes.chunks_exact(channels).filter(|p| p[0] > p[2]).count();
        assert_eq!(reddish, drawn, "{name}: a point has another colour");
    }
}

/// A store of one place was seen from a quantum away, in a corner.
#[test]
fn one_place_is_in_the_middle_of_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(path("one.csv"), "x,y,z,red,green,blue\n1,2,3,200,100,50\n1,2,3,200,100,50\n").unwrap();
    esker_ok(&["ingest", &path("one.esker"), &path("one.csv")]);
    let look = ["--size", "65x49", "--unlit", "--background", "000000", "-o"];
    esker_ok(&[&["render", &path("one.esker")], &look[..], &[&path("one.png")]].concat());
    let (width, height, bytes) = pixels(&path("one.png"));
    let channels = bytes.len() / (width * height) as usize;
    let drawn = |(_, p): &(usize, &[u8])| p[..3] == [200, 100, 50];
    let at: Vec<usize> = bytes.chunks_exact(channels).enumerate().filter(drawn).map(|(i, _)| i).collect();
    let middle = at.iter().fold([0, 0], |[x, y], i| [x + i % 65, y + i / 65]).map(|sum| sum as f64 / at.len() as f64);
    assert!((middle[0] - 32.0).abs() <= 1.0 && (middle[1] - 24.0).abs() <= 1.0, "{middle:?} of {} pixels", at.len());
}

/// Files with room for colours and none in it (all zero, as national LiDAR tiles have them) are shown by something else.
#[test]
fn colours_that_are_all_black_are_none() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let header = "ply\nformat ascii 1.0\nelement vertex 400\nproperty double x\nproperty double y\nproperty double z\n\
                  property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
    for (name, red, black) in [("black", 0, true), ("almost", 1, false)] {
        let rows: String = (0..400).map(|i| format!("{} {} {} {red} 0 0\n", i % 20, i / 20, i % 7)).collect();
        fs::write(path("p.ply"), header.to_owned() + &rows).unwrap();
        let (store, picture) = (path(&format!("{name}.esker")), path(&format!("{name}.png")));
        esker_ok(&["ingest", &store, &path("p.ply")]);
        esker_ok(&["render", &store, "--unlit", "--size", "160x120", "-o", &picture]);
        let (width, height, bytes) = pixels(&picture);
        let channels = bytes.len() / (width * height) as usize;
        let dark = bytes.chunks_exact(channels).any(|p| p[0] <= 1 && p[1] == 0 && p[2] == 0);
        assert_eq!(dark, !black, "{name}");
    }
}

#[test]
fn a_whole_site_fits_its_default_picture() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    esker_ok(&["generate", "torus", "--points", "200000", "-o", &path("t.las")]);
    esker_ok(&["ingest", &path("t.esker"), &path("t.las")]);
    for mode in ["rgb", "height", "intensity", "class", "return", "scan", "level", "time"] {
        let picture = path(&format!("{mode}.png"));
        esker_ok(&["render", &path("t.esker"), "--color", mode, "--size", "320x240", "-o", &picture]);
        let (width, height, bytes) = pixels(&picture);
        let channels = bytes.len() / (320 * 240);
        assert_eq!((width, height), (320, 240));
        // The background's gradient is the same along a row.
        let row = |y: usize| &bytes[y * 320 * channels..(y + 1) * 320 * channels];
        let varied = |y: usize| row(y).chunks_exact(channels).any(|p| p != &row(y)[..channels]);
        assert!((0..240).filter(|&y| varied(y)).count() > 60, "{mode}: hardly anything was drawn");
        assert!(!varied(0) && !varied(239), "{mode}: the site is cut off");
    }
}

/// Points on a wavy ground of 40 by 40 units of 1000 steps, in whole steps, as PLY; moved by whole units.
fn write_ground(path: &Path, moved: [i64; 3]) {
    let side = 160_i64;
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
        side * side
    );
    for i in 0..side * side {
        let (row, column) = (i / side, i % side);
        // Somewhere within the cell of 250 steps, the same at every place.
        let within = |factor: i64| (i * factor + 77) % 199;
        let wave = (f64::from(row as i32) / 9.0).sin() + (f64::from(column as i32) / 13.0).cos();
        let steps = [column * 250 + within(7919), row * 250 + within(104_729), (wave * 1500.0) as i64];
        for (axis, steps) in steps.into_iter().enumerate() {
            let whole = moved[axis] + steps.div_euclid(1000);
            write!(text, "{whole}.{:03} ", steps.rem_euclid(1000)).unwrap();
        }
        writeln!(text, "{} {} {}", 40 + column, 200 - row, (i % 7) * 30).unwrap();
    }
    // Negative numbers are written as the whole below and a part above it: none here.
    assert!(moved.iter().all(|m| *m >= 10));
    fs::write(path, text).unwrap();
}

fn view_at(eye: [f64; 3], target: [f64; 3], moved: [i64; 3]) -> String {
    let at = |p: [f64; 3]| -> [f64; 3] { std::array::from_fn(|i| p[i] + moved[i] as f64) };
    format!(r#"{{"eye":{:?},"target":{:?},"fov_y_deg":60,"size":[480,320]}}"#, at(eye), at(target))
}

/// The part of the pixels that differ.
fn differing(a: &str, b: &str) -> f64 {
    let ((width, height, a), (w, h, b)) = (pixels(a), pixels(b));
    assert_eq!((width, height, a.len()), (w, h, b.len()));
    let channels = a.len() / (width * height) as usize;
    let differ = a.chunks_exact(channels).zip(b.chunks_exact(channels)).filter(|(a, b)| a != b).count();
    differ as f64 / f64::from(width * height)
}

/// The views of the ground: from afar, and from among its points.
const VIEWS: [[[f64; 3]; 2]; 2] = [[[20.0, -25.0, 22.0], [20.0, 20.0, 0.0]], [[20.1, 18.3, 2.9], [21.0, 24.0, 1.5]]];

/// At full detail what a picture shows does not depend on where the site is or how fine its lattice is. Splats have a
/// fixed size here: by default they are as large as the cells of the tree, which lie otherwise elsewhere.
#[test]
fn a_site_looks_the_same_at_the_origin_in_utm_at_1e7_and_on_a_finer_lattice() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let sites: [(&str, [i64; 3], &str); 5] = [
        ("origin", [10, 10, 10], "0.001"),
        ("utm", [447_010, 5_411_010, 310], "0.001"),
        ("far", [10_000_010, 10_000_010, 10_000_010], "0.001"),
        ("fine", [10, 10, 10], "0.0001"),
        ("fine-utm", [447_010, 5_411_010, 310], "0.0001"),
    ];
    for (name, moved, quantum) in sites {
        write_ground(&folder.path().join("ground.ply"), moved);
        let store = path(&format!("{name}.esker"));
        esker_ok(&["ingest", &store, &path("ground.ply"), "--quantum", quantum]);
        for (i, [eye, target]) in VIEWS.into_iter().enumerate() {
            fs::write(path("view.json"), view_at(eye, target, moved)).unwrap();
            let picture = path(&format!("{name}-{i}.png"));
            let look = ["--max-error-px", "0", "--point-size", "0", "--min-px", "5", "--shape", "paraboloid"];
            let what = ["render", &store, "--view", &path("view.json"), "-o", &picture];
            esker_ok(&[what.as_slice(), &look].concat());
            let differing = differing(&path(&format!("origin-{i}.png")), &picture);
            assert!(differing <= 0.001, "{name}, view {i}: {differing} of the pixels differ");
        }
    }
}

/// Moved by a multiple of the root's side the tree is the same, so the picture is at any detail, with any splats.
#[test]
fn a_site_moved_by_its_root_looks_the_same_at_any_detail() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    // 2^18 * 125 steps of a millimetre are 32,768 units: a multiple of the sides of cubes up to 2^18 steps.
    for (name, moved) in [("here", [10; 3]), ("there", [32_778, 10 + 3 * 32_768, 32_778])] {
        write_ground(&folder.path().join("ground.ply"), moved);
        esker_ok(&["ingest", &path(&format!("{name}.esker")), &path("ground.ply"), "--quantum", "0.001"]);
        for (i, [eye, target]) in VIEWS.into_iter().enumerate() {
            fs::write(path("view.json"), view_at(eye, target, moved)).unwrap();
            for capacity in ["3000", "12345"] {
                let picture = path(&format!("{name}-{i}-{capacity}.png"));
                let view = path("view.json");
                let store = path(&format!("{name}.esker"));
                esker_ok(&["render", &store, "--view", &view, "--capacity", capacity, "-o", &picture]);
                let differing = differing(&path(&format!("here-{i}-{capacity}.png")), &picture);
                assert!(differing <= 0.001, "view {i}, {capacity} points: {differing} of the pixels differ");
            }
        }
    }
}

/// The columns of a statistics file, by name.
fn table(path: &str) -> impl Fn(&str, usize) -> f64 + use<> {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let head = lines.next().unwrap();
    let rows: Vec<_> = lines.collect();
    move |name, row| rows[row][head.iter().position(|h| h == name).unwrap()].parse().unwrap()
}

/// Every frame of a walk is the picture that its camera alone gives, whatever was loaded before; nothing is loaded twice,
/// and the capacity is never passed.
#[test]
fn frames_of_a_walk_are_the_pictures_of_their_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    esker_ok(&["generate", "terrain", "--points", "400000", "-o", &path("t.las")]);
    esker_ok(&["ingest", &path("t.esker"), &path("t.las")]);
    let info = esker_ok(&["info", &path("t.esker"), "--json"]);
    let info: serde_json::Value = serde_json::from_str(&info).unwrap();
    let bound = |end: &str, i: usize| info["bounds"][end][i].as_f64().unwrap();
    let at = |x: f64, y: f64, z: f64| {
        [x, y, z]
            .iter()
            .enumerate()
            .map(|(i, t)| bound("min", i) + t * (bound("max", i) - bound("min", i)))
            .collect::<Vec<_>>()
    };
    let view = |eye: Vec<f64>, target: Vec<f64>| format!(r#"{{"eye":{eye:?},"target":{target:?},"size":[320,200]}}"#);
    let views = [
        view(at(0.5, -0.5, 9.0), at(0.5, 0.5, 0.0)),
        view(at(0.3, 0.2, 2.0), at(0.5, 0.6, 0.5)),
        view(at(0.3, 0.2, 2.0), at(0.5, 0.6, 0.5)),
        view(at(0.9, 0.9, 1.5), at(0.1, 0.1, 0.5)),
        view(at(0.5, -0.5, 9.0), at(0.5, 0.5, 0.0)),
    ];
    fs::write(path("walk.json"), format!("[{}]", views.join(","))).unwrap();
    for (i, view) in views.iter().enumerate() {
        fs::write(path(&format!("{i}.json")), view).unwrap();
    }
    let looks: [&[&str]; 3] = [
        &["--capacity", "60001"],
        &["--capacity", "9000", "--color", "height", "--shape", "paraboloid"],
        &["--capacity", "25000", "--where", "Classification = 2", "--color", "class"],
    ];
    for (look, options) in looks.into_iter().enumerate() {
        let (walk, stats) = (path(&format!("walk{look}.png")), path(&format!("{look}.csv")));
        let what = ["render", &path("t.esker"), "--path", &path("walk.json"), "--stats", &stats, "-o", &walk];
        esker_ok(&[what.as_slice(), options].concat());
        let of = table(&stats);
        for i in 0..views.len() {
            let single = path(&format!("{look}-{i}.png"));
            let what = ["render", &path("t.esker"), "--view", &path(&format!("{i}.json")), "-o", &single];
            esker_ok(&[what.as_slice(), options].concat());
            let frame = path(&format!("walk{look}-{i:04}.png"));
            assert!(fs::read(&frame).unwrap() == fs::read(&single).unwrap(), "{frame} is not {single}");
            let capacity: f64 = options[1].parse().unwrap();
            assert!(of("points", i) <= capacity && of("points", i) > 0.5 * capacity.min(9000.0), "{}", of("points", i));
        }
        assert!(of("bytes_uploaded", 0) >= 16.0 * of("points", 0) && of("bytes_read", 0) > 0.0);
        assert_eq!([of("parts_loaded", 2), of("bytes_uploaded", 2)], [0.0; 2], "the camera stood still");
    }
    // Without --force nothing is written over, not even half of a walk.
    fs::remove_file(path("walk0-0000.png")).unwrap();
    let again = ["render", &path("t.esker"), "--path", &path("walk.json"), "-o", &path("walk0.png")];
    esker_fails(&again, 1, &["walk0-0001.png", "--force"]);
    assert!(!Path::new(&path("walk0-0000.png")).exists());
}

/// Options of the look reach the picture.
#[test]
fn every_option_of_the_look_changes_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    write_ground(&folder.path().join("g.ply"), [10; 3]);
    esker_ok(&["ingest", &path("g.esker"), &path("g.ply")]);
    let draw = |name: &str, options: &[&str]| {
        let picture = path(&format!("{name}.png"));
        let what = ["render", &path("g.esker"), "--size", "240x160", "-o", &picture];
        esker_ok(&[what.as_slice(), options].concat());
        picture
    };
    let plain = draw("plain", &[]);
    let looks: [&[&str]; 14] = [
        &["--shape", "square", "--point-size", "2"],
        &["--shape", "paraboloid", "--point-size", "2"],
        &["--point-size", "2"],
        &["--min-px", "6"],
        &["--max-px", "1.5"],
        &["--unlit"],
        &["--edl", "4"],
        &["--shadows", "2", "--point-size", "2"],
        &["--fog", "10,20,ffffff"],
        &["--background", "ffffff"],
        &["--clip", "20,20,-inf,40,40,inf"],
        &["--cut", "20,20,-inf,40,40,inf"],
        &["--node-boxes"],
        &["--color", "height", "--range", "9,10"],
    ];
    let mut pictures = vec![plain];
    for (i, look) in looks.into_iter().enumerate() {
        let picture = draw(&i.to_string(), look);
        for other in &pictures {
            assert!(differing(other, &picture) > 0.002, "{look:?} looks as {other}");
        }
        pictures.push(picture);
    }
    // What one box keeps, the other cuts out: together they are the whole.
    let points = |options: &[&str]| {
        let stats = path("points.csv");
        draw("counted", &[options, &["--stats", &stats, "--force"]].concat());
        table(&stats)("points", 0)
    };
    assert!(points(&["--clip", "20,20,-inf,40,40,inf"]) < 0.5 * points(&[]));
    let (_, _, clear) = pixels(&draw("clear", &["--background", "none"]));
    assert_eq!(clear.len(), 240 * 160 * 4);
    assert!(clear.chunks_exact(4).any(|p| p[3] == 0) && clear.chunks_exact(4).any(|p| p[3] == 255));
}

/// The environment may name the adapter, as for other programs on wgpu; a name that none has is no reason to draw elsewhere.
#[test]
fn an_adapter_may_be_asked_for_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    write_ground(&folder.path().join("g.ply"), [10; 3]);
    esker_ok(&["ingest", &path("g.esker"), &path("g.ply")]);
    let draw = |adapter: &str| {
        let arguments = ["render", &path("g.esker"), "--size", "64x48", "--force", "-o", &path("g.png")];
        let output =
            Command::new(env!("CARGO_BIN_EXE_esker")).args(arguments).env("WGPU_ADAPTER_NAME", adapter).output();
        let output = output.unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap() + &String::from_utf8(output.stdout).unwrap())
    };
    let (code, said) = draw("no such card");
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("no graphics adapter has \"no such card\" in its name"), "{said}");
    assert!(!Path::new(&path("g.png")).exists());
    let (_, known) = said.split_once("there are: ").unwrap();
    let known = known.lines().next().unwrap().split(", ").next().unwrap();
    let (code, said) = draw(&known.to_uppercase());
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains(&format!("drawn by {known}")), "{said}");
}

/// A store of two points, in its folder.
/// Scans that are hidden, or not asked for, have an entry in no legend.
#[test]
fn a_legend_lists_the_scans_that_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for (name, x) in [("a", 0), ("b", 1), ("c", 2)] {
        fs::write(path(&format!("{name}.xyz")), format!("{x} 2 3\n{x} 5 6\n")).unwrap();
    }
    // From so far away that no point is seen before the legend.
    fs::write(path("view.json"), view_at([0.0, -100.0, 0.0], [0.0, 0.0, 0.0], [0; 3])).unwrap();
    let store = path("s.esker");
    esker_ok(&["ingest", &store, &path("a.xyz"), &path("b.xyz"), &path("c.xyz")]);
    let corner = |asked: &[&str]| {
        let (view, picture) = (path("view.json"), path("p.png"));
        let mut arguments = vec!["render", &store, "--view", &view, "--color", "scan", "--legend"];
        arguments.extend(["--force", "-o", &picture]);
        arguments.extend(asked);
        esker_ok(&arguments);
        let (width, height, bytes) = pixels(&picture);
        let row = 4 * width as usize;
        let rows = bytes.chunks(row).skip(height as usize / 2 + 40);
        rows.flat_map(|row| row[..row.len() / 3].to_vec()).collect::<Vec<_>>()
    };
    let (all, one) = (corner(&[]), corner(&["--scan", "a"]));
    assert!(all != one);
    esker_ok(&["hide", &store, "b", "c"]);
    assert!(corner(&[]) == one);
    assert!(corner(&["--scan", "a", "--scan", "b", "--scan", "c"]) == all);
}

fn small_store(folder: &Path) -> String {
    let at = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    fs::write(at("a.xyz"), "1 2 3\n4 5 6\n").unwrap();
    esker_ok(&["ingest", &at("a.esker"), &at("a.xyz")]);
    at("a.esker")
}

/// A pipe was waited for for ever, a link was replaced, a folder that is not there was found after the work.
#[cfg(unix)]
#[test]
fn pictures_are_written_where_a_file_can_be() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let store = small_store(folder.path());
    let render = ["render", &store, "--size", "64x48", "--force"];
    assert!(Command::new("mkfifo").arg(path("pipe.png")).status().unwrap().success());
    std::os::unix::fs::symlink(path("nowhere.png"), path("dangling.png")).unwrap();
    let cases = [
        ("pipe.png", "is not a regular file".to_owned()),
        ("dangling.png", "is a link that leads nowhere".to_owned()),
        ("none/a.png", format!("the folder {} does not exist; create it first", path("none"))),
    ];
    for (name, expected) in &cases {
        esker_fails(&[&render[..], &["-o", &path(name)]].concat(), 1, &[name, expected]);
        esker_fails(&[&render[..], &["-o", &path("v.png"), "--stats", &path(name)]].concat(), 1, &[name, expected]);
    }
    assert!(!Path::new(&path("v.png")).exists());
    // A link that leads to a file stays one.
    fs::write(path("real.png"), "old").unwrap();
    std::os::unix::fs::symlink(path("real.png"), path("link.png")).unwrap();
    esker_ok(&[&render[..], &["-o", &path("link.png")]].concat());
    assert!(Path::new(&path("link.png")).is_symlink());
    assert_eq!(pixels(&path("real.png")).0, 64);
}

/// The statistics were lost in the picture, or in a file called `-`, or lay there empty.
#[test]
fn statistics_have_a_place_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let store = small_store(folder.path());
    let picture = path("v.png");
    let render = ["render", &store, "--size", "64x48", "--force", "-o", &picture, "--stats"];
    fs::create_dir(path("below")).unwrap();
    let same = path("below/../v.png");
    for stats in [&picture, &same] {
        esker_fails(&[&render[..], &[stats]].concat(), 1, &["v.png", "is the picture's name, too"]);
    }
    assert!(!Path::new(&picture).exists());
    let table = esker_ok(&[&render[..], &["-"]].concat());
    let lines: Vec<_> = table.lines().collect();
    assert!(lines.len() == 2 && lines[0].starts_with("frame,points,") && lines[1].starts_with("0,2,"), "{table}");
    assert!(Path::new(&picture).exists());

    fs::create_dir(path("full")).unwrap();
    let shim = crate::faults::shim(folder.path());
    for output in [["v.png", "full/x.csv"], ["full/v.png", "x.csv"]] {
        let output = Command::new(env!("CARGO_BIN_EXE_esker"))
            .args(["render", &store, "--size", "64x48", "--force", "-o", &path(output[0]), "--stats", &path(output[1])])
            .env("LD_PRELOAD", &shim)
            .env("ESKER_TEST_PATH", "/full/")
            .env("ESKER_TEST_FAULT", "full:0")
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        assert_eq!(fs::read_dir(path("full")).unwrap().count(), 0);
    }
}

/// A plan shows north up, to scale; a region is all that is drawn, and fills the picture.
#[test]
fn a_region_and_a_plan_are_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    // Red in the west, green in the east, blue in the far north, all 0.1 apart.
    let mut text = "x,y,z,red,green,blue\n".to_owned();
    for (x0, y0, colour) in [(0.0, 0.0, "255,0,0"), (6.0, 0.0, "0,255,0"), (0.0, 50.0, "0,0,255")] {
        for i in 0..900 {
            let (x, y) = (x0 + f64::from(i % 30) / 10.0, y0 + f64::from(i / 30) / 10.0);
            writeln!(text, "{x},{y},0,{colour}").unwrap();
        }
    }
    fs::write(path("p.csv"), text).unwrap();
    let (store, picture) = (path("p.esker"), path("p.png"));
    esker_ok(&["ingest", &store, &path("p.csv")]);
    let drawn = |options: &[&str]| {
        let look = ["--unlit", "--background", "000000", "--size", "300x300", "--force", "-o", &picture];
        esker_ok(&[&["render", &store, "--top"], options, &look].concat());
        let (width, _, bytes) = pixels(&picture);
        let channels = bytes.len() / 90_000;
        // For each colour: how many pixels, and their means across and down.
        let of = |channel: usize| {
            let all: Vec<usize> = (0..90_000).filter(|i| bytes[i * channels + channel] > 200).collect();
            let mean = |value: &dyn Fn(usize) -> usize| {
                all.iter().map(|&i| value(i) as f64).sum::<f64>() / all.len().max(1) as f64
            };
            (all.len(), mean(&|i| i % width as usize), mean(&|i| i / width as usize))
        };
        [0, 1, 2].map(of)
    };
    let [red, green, blue] = drawn(&[]);
    assert!(red.0 > 50 && green.0 > 50 && blue.0 > 50, "{red:?} {green:?} {blue:?}");
    assert!(
        green.1 > red.1 + 20.0 && (green.2 - red.2).abs() < 2.0 && blue.2 + 200.0 < red.2,
        "{red:?} {green:?} {blue:?}"
    );
    let [red, green, blue] = drawn(&["--box=-1,-1,20,20"]);
    assert!(blue.0 == 0 && red.0 > 5000 && green.0 > 5000, "{red:?} {green:?} {blue:?}");
    let [red, green, blue] = drawn(&["--polygon", "POLYGON((-1 -1, 4 -1, 4 4, -1 4, -1 -1))"]);
    assert!(blue.0 + green.0 == 0 && red.0 > 60_000, "{red:?} {green:?} {blue:?}");
    esker_fails(&["render", &store, "--top", "--bookmark", "x", "-o", &picture], 2, &["cannot be used with"]);
}
