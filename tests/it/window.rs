//! The real window, under a virtual display with software Vulkan: a script in place of hands, and what can be seen after.
//!
//! Without a display and without Xvfb this fails: the window is part of the product.

use crate::support::esker_ok;
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// A display for one test; ends with it.
struct Display {
    server: Child,
    name: String,
}

impl Display {
    fn start() -> Self {
        // The server chooses a free number and says which.
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "1400x1000x24", "-nolisten", "tcp"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("Xvfb is needed: apt-get install xvfb");
        let mut line = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
        Self { server, name: format!(":{}", line.trim()) }
    }

    /// Runs a script in the viewer; the lines that it printed.
    fn view(&self, folder: &Path, store: &Path, script: &str) -> Vec<serde_json::Value> {
        self.view_and(folder, store, script, |_| ())
    }

    /// The same; `then` is called after each line, with how many there are.
    fn view_and(&self, folder: &Path, store: &Path, script: &str, then: impl FnMut(usize)) -> Vec<serde_json::Value> {
        self.view_with(folder, store, &[], script, then)
    }

    fn view_with(
        &self,
        folder: &Path,
        store: &Path,
        options: &[&str],
        script: &str,
        mut then: impl FnMut(usize),
    ) -> Vec<serde_json::Value> {
        let file = folder.join("script.txt");
        fs::write(&file, script).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_esker"));
        command.args(["view", "--forget", "--script"]).arg(&file).arg(store).args(options).current_dir(folder);
        command.env("DISPLAY", &self.name).env_remove("WAYLAND_DISPLAY").env("XDG_RUNTIME_DIR", folder);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut stderr = child.stderr.take().unwrap();
        let told = std::thread::spawn(move || {
            let mut text = String::new();
            stderr.read_to_string(&mut text).map(|_| text)
        });
        let mut states: Vec<serde_json::Value> = Vec::new();
        for line in BufReader::new(child.stdout.take().unwrap()).lines() {
            states.push(serde_json::from_str(&line.unwrap()).unwrap());
            then(states.len());
        }
        let (status, stderr) = (child.wait().unwrap(), told.join().unwrap().unwrap());
        assert!(status.success() && !stderr.contains("panicked"), "{status}\n{stderr}");
        states
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

fn pixels(path: &Path) -> (u32, u32, Vec<u8>) {
    let decoder = png::Decoder::new(BufReader::new(fs::File::open(path).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    bytes.truncate(info.buffer_size());
    let channels = bytes.len() / (info.width * info.height) as usize;
    let rgb = bytes.chunks_exact(channels).flat_map(|p| [p[0], p[1], p[2]]).collect();
    (info.width, info.height, rgb)
}

/// A picture of half the size: small enough to be kept, and what a driver decides at edges hardly shows.
fn halved((width, height, rgb): (u32, u32, Vec<u8>)) -> (u32, u32, Vec<u8>) {
    let (w, h) = (width as usize / 2, height as usize / 2);
    let at = |x: usize, y: usize, c: usize| u16::from(rgb[(y * width as usize + x) * 3 + c]);
    let mean = |x: usize, y: usize, c: usize| {
        let sum = at(2 * x, 2 * y, c) + at(2 * x + 1, 2 * y, c) + at(2 * x, 2 * y + 1, c) + at(2 * x + 1, 2 * y + 1, c);
        (sum / 4) as u8
    };
    let pixels = (0..h).flat_map(|y| (0..w).map(move |x| (x, y)));
    let rgb = pixels.flat_map(|(x, y)| [mean(x, y, 0), mean(x, y, 1), mean(x, y, 2)]).collect();
    (w as u32, h as u32, rgb)
}

/// The share of pixels that differ by more than a little: fonts and splats' edges are the driver's.
fn difference(a: &[u8], b: &[u8]) -> f64 {
    let differs = |(a, b): (&[u8], &[u8])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 40);
    let pairs = a.chunks_exact(3).zip(b.chunks_exact(3));
    pairs.clone().filter(|p| differs((p.0, p.1))).count() as f64 / pairs.len() as f64
}

#[test]
fn a_script_uses_every_part_of_the_window() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let text = |name: &str| path(name).to_str().unwrap().to_owned();
    esker_ok(&["generate", "site", "--points", "150000", "--seed", "1", "-o", &text("scans")]);
    esker_ok(&["ingest", &text("site.esker"), &text("scans")]);
    let scans: serde_json::Value = serde_json::from_str(&esker_ok(&["scans", &text("site.esker"), "--json"])).unwrap();
    let names = serde_json::to_string(&scans).unwrap();
    let first = names.split("\"name\":\"").nth(1).unwrap().split('"').next().unwrap().to_owned();
    let display = Display::start();
    let script = format!(
        "size 1100 760\nwait complete\nstate\nshot start.png\n\
         key H\nwait 50\nwait complete\nstate\nshot help.png\nkey Esc\nwait complete\n\
         # every panel\n\
         click @quality\nclick @places\nclick @measure\nclick @clip\nclick @point\nclick @statistics\nstate\nshot panels.png\n\
         click @quality\nclick @places\nclick @clip\nclick @point\nclick @statistics\nwait 50\n\
         # a scan off and on\n\
         click @scan.{first}\nwait complete\nstate\nclick @scan.{first}\nwait complete\n\
         # turn, move, zoom\n\
         drag left 400 400 480 420\ndrag right 400 400 380 390\npoint 400 400\nwait complete\nwheel 2\nwait complete\nstate\n\
         # measure\n\
         key M\nclick 380 400\nwait complete\nclick 470 430\nwait complete\nstate\nshot measure.png\n\
         key Esc\n\
         # bookmark\n\
         click @places\nwait 50\nclick @bookmark.name\ntext door\nclick @bookmark.save\nwait 1500\nstate\n\
         # fly and walk\n\
         down W\nwait 300\nup W\nstate\nkey 1\nwait complete\nkey G\nwait 1500\nstate\nkey Esc\n\
         # colours\n\
         click @mode\nwait 50\nclick @mode.height\nwait complete\nshot height.png\n\
         # a picture without panels, and the points of a box\n\
         key P\nwait 400\nkey F\nwait complete\nclick @clip\nwait 50\nclick @clip.add\nwait 50\nclick @clip.export.1\nwait 1500\nstate\nshot clip.png\n\
         # another size, another device\n\
         size 500 400\nwait complete\nstate\nlose device\nwait 300\nwait complete\nstate\nquit\n"
    );
    let states = display.view(folder.path(), &path("site.esker"), &script);
    let [start, helped, panels, off, turned, measured, kept, flown, walked, exported, small, renewed] =
        states.as_slice()
    else {
        panic!("{} states", states.len())
    };
    assert!(start["points"].as_u64().unwrap() > 50_000 && start["complete"] == true, "{start}");
    assert_eq!((&start["size"][0], &start["size"][1]), (&1100.into(), &760.into()));
    // At first the site is seen, with a line that says how to move; whoever has seen the whole help needs it no more.
    assert!(start["help"] == false && start["hint"] == true && helped["help"] == true && helped["hint"] == false);
    assert_eq!(panels["open"].as_array().unwrap().len(), 8, "{panels}");
    assert!(off["points"].as_u64() < start["points"].as_u64() && off["hidden_scans"] == 1, "{off}");
    assert!(turned["hover"].is_array() && turned["eye"] != start["eye"], "{turned}");
    assert!(measured["measured"].as_u64() >= Some(2) && measured["measured_length"].as_f64() > Some(0.0), "{measured}");
    assert!(measured["picked"].as_array().unwrap().len() > 4, "{measured}");
    assert_eq!(kept["bookmarks"], serde_json::json!(["door"]), "{kept}");
    assert!(flown["mode"] == "Fly" && flown["eye"] != kept["eye"], "{flown}");
    // From above the middle down to the ground.
    let height = |state: &serde_json::Value| state["eye"][2].as_f64().unwrap();
    assert!(walked["mode"] == "Walk" && height(walked) + 20.0 < height(flown), "{walked}");
    assert!(exported["clips"] == 1 && path("clip.laz").exists(), "{exported}");
    assert_eq!((&small["size"][0], &small["size"][1]), (&500.into(), &400.into()), "{small}");
    assert!(renewed["complete"] == true && renewed["points"].as_u64() > Some(0), "{renewed}");
    let out = esker_ok(&["query", &text("clip.laz").replace("clip.laz", "site.esker"), "--count"]);
    assert!(out.trim().parse::<u64>().unwrap() > 100_000);
    // The bookmark is a view for `render`, too, and `info` names it.
    assert!(esker_ok(&["info", &text("site.esker")]).contains("\nbookmarks    door\n"));
    esker_ok(&["render", &text("site.esker"), "--bookmark", "door", "--size", "64x48", "-o", &text("door.png")]);

    let picture = pixels(&path("site-001.png"));
    assert_eq!((picture.0, picture.1), (1100, 760));
    let varied = picture.2.chunks_exact(3).collect::<std::collections::HashSet<_>>().len();
    assert!(varied > 100, "a picture of {varied} colours");
    for (shot, kept) in
        [("start.png", "viewer.png"), ("panels.png", "viewer-panels.png"), ("measure.png", "viewer-measure.png")]
    {
        let document = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(kept);
        let now = halved(pixels(&path(shot)));
        if std::env::var_os("ESKER_KEEP_PICTURES").is_some() {
            let rgba = now.2.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
            esker::render::Image { width: now.0, height: now.1, rgba }.write_png(&document, true).unwrap();
            fs::copy(path(shot), Path::new(env!("CARGO_TARGET_TMPDIR")).join(shot)).unwrap();
        }
        let then = pixels(&document);
        assert_eq!((now.0, now.1), (then.0, then.1), "{kept}");
        let differs = difference(&now.2, &then.2);
        println!("{kept}: {:.2} % of the pixels differ", differs * 100.0);
        assert!(differs < 0.05, "{kept} shows something else: {differs}");
    }
}

/// A store of some thousand points in `folder`.
fn small_store(folder: &Path, name: &str, kind: &str) -> PathBuf {
    let text = |name: String| folder.join(name).to_str().unwrap().to_owned();
    esker_ok(&["generate", kind, "--points", "20000", "-o", &text(format!("{name}.las"))]);
    esker_ok(&["ingest", &text(format!("{name}.esker")), &text(format!("{name}.las"))]);
    folder.join(format!("{name}.esker"))
}

/// A minimised window has no size on some systems, and a surface is lost when a display goes: nothing is drawn meanwhile,
/// and then everything is as before.
#[test]
fn a_window_without_a_size_or_a_surface_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let store = small_store(folder.path(), "torus", "torus");
    let script = "size 600 400\nwait complete\nkey Esc\nwait complete\nstate\nshot before.png\n\
                  size 0 0\nwait 50\nstate\nwait 300\nstate\nkey 1\nwheel 1\nlose device\nwait 300\nstate\n\
                  size 600 400\nkey F\nwait complete\nstate\n\
                  lose surface\nwait complete\nwait 300\nstate\nlose surface\nlose surface\nwait 300\nstate\nquit\n";
    let states = Display::start().view(folder.path(), &store, script);
    let [before, gone, later, still_gone, back, lost, lost_again] = states.as_slice() else {
        panic!("{} states", states.len())
    };
    let presented = |state: &serde_json::Value| state["presented"].as_u64().unwrap();
    assert_eq!(presented(later), presented(gone), "something is drawn into a window without a size: {later}");
    assert!(presented(still_gone) <= presented(gone) && still_gone["points"] == before["points"], "{still_gone}");
    assert!(back["complete"] == true && back["points"] == before["points"] && presented(back) > 0, "{back}");
    assert!(presented(lost) > presented(back), "nothing is drawn after the surface was lost: {lost}");
    assert!(presented(lost_again) > presented(lost) && lost_again["points"] == before["points"], "{lost_again}");
}

/// What is there stays, and the lower line says what has happened: for a file that is removed, and for another one in its
/// place, whose points must not be mixed with the first one's.
#[test]
fn a_store_that_vanishes_or_is_replaced_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let display = Display::start();
    for replaced in [false, true] {
        let name = if replaced { "replaced" } else { "removed" };
        let store = small_store(folder.path(), name, "torus");
        let other = small_store(folder.path(), &format!("{name}-other"), "spheres");
        let script = "size 600 400\nwait complete\nkey Esc\nwait complete\nstate\nwait 1500\nstate\n\
                      drag left 200 200 300 220\nwheel 3\nwait 600\nkey B\nwait 600\nstate\nquit\n";
        let states = display.view_and(folder.path(), &store, script, |lines| {
            if lines == 1 && replaced {
                fs::rename(&other, &store).unwrap();
            } else if lines == 1 {
                fs::remove_file(&store).unwrap();
            }
        });
        let [before, after, moved] = states.as_slice() else { panic!("{} states", states.len()) };
        assert!(before["error"].is_null() && before["points"] == 20_000, "{before}");
        for state in [after, moved] {
            let words = state["error"].as_str().unwrap_or_default();
            assert!(words.contains("removed, moved or replaced"), "{name}: {state}");
            assert!(state["points"].as_u64() > Some(1000), "{name}: {state}");
        }
        assert!(moved["bookmarks"].as_array().is_none_or(Vec::is_empty), "{name}: {moved}");
    }
}

/// Two scans with the places of their scanners: walls of 40 x 40 points, five units before these.
fn scanned_walls(path: &Path) {
    let mut text = String::new();
    for (x, across) in [(10.0, "1 0 0 0\n0 1 0 0"), (-10.0, "0 1 0 0\n-1 0 0 0")] {
        text += &format!("40\n40\n{x} 20 2\n1 0 0\n0 1 0\n0 0 1\n{across}\n0 0 1 0\n{x} 20 2 1\n");
        for i in 0..1600 {
            let (column, row) = (i / 40, i % 40);
            text += &format!(
                "{} 5 {} 0.5 {} 120 90\n",
                f64::from(column) / 10.0 - 2.0,
                f64::from(row) / 10.0 - 2.0,
                row * 6
            );
        }
    }
    fs::write(path, text).unwrap();
}

#[test]
fn looks_stations_and_bookmarks_do_what_they_say() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    scanned_walls(&path("walls.ptx"));
    esker_ok(&["ingest", path("walls.esker").to_str().unwrap(), path("walls.ptx").to_str().unwrap()]);
    let scans = esker_ok(&["scans", path("walls.esker").to_str().unwrap(), "--json"]);
    let second = scans.split("\"name\": \"").nth(2).and_then(|s| s.split('"').next()).unwrap().to_owned();
    let script = format!(
        "size 720 760\nwait complete\nclick @hint.close\nclick @scans\nclick @color\nclick @quality\nwait 50\nstate\nshot plain.png\n\
         click @outlines\nwait 50\nstate\nshot outlines.png\nclick @haze\nwait 50\nstate\nshot haze.png\n\
         click @edl\nwait 50\nstate\nshot edl.png\nclick @boxes\nwait 50\nshot boxes.png\nclick @quality\n\
         # where a scanner stood, by key and by name\n\
         key L\nwait 50\nwait complete\nstate\nclick @places\nwait 50\nclick @station.{station}\nwait 50\nwait complete\nstate\n\
         # a bookmark, from elsewhere back to it, and away with it\n\
         click @bookmark.name\ntext here\nclick @bookmark.save\nwait 1000\nkey 1\nwait complete\nstate\n\
         click @bookmark.here\nwait 50\nwait complete\nstate\nclick @bookmark.remove.here\nwait 1000\nstate\n\
         # a box, twice to files\n\
         key F\nwait complete\nclick @clip\nwait 50\nclick @clip.add\nwait 50\nclick @clip.export.1\nwait 400\n\
         click @clip.export.1\nwait 400\nclick @clip.path.1\ntext clip.laz\nclick @clip.export.1\nwait 400\nstate\n\
         # half of the points, a name that there is not, all again\n\
         click @clip\nclick @places\nclick @scans\nwait 50\nclick @filter\ntext z < 2\nclick @filter.set\nwait 600\nwait complete\nstate\n\
         click @filter\ntext 0 or Colour = 1\nclick @filter.set\nwait 600\nstate\nclick @filter.clear\nwait 300\nwait complete\nstate\nquit\n",
        station = second.replace(' ', "~")
    );
    let states = Display::start().view(folder.path(), &path("walls.esker"), &script);
    let [plain, outlined, hazy, lit, first, stood, away, back, gone, exported, low, wrong, all] = states.as_slice()
    else {
        panic!("{} states", states.len())
    };
    assert_eq!((&plain["outlines_px"], &plain["haze"], &plain["hint"]), (&0.0.into(), &0.0.into(), &false.into()));
    assert!(outlined["outlines_px"].as_f64() > Some(1.0) && hazy["haze"].as_f64() > Some(0.2), "{hazy}");
    assert!(lit["edl"].as_f64() > plain["edl"].as_f64(), "{lit}");
    let shots = ["plain", "outlines", "haze", "edl", "boxes"].map(|name| pixels(&path(&format!("{name}.png"))).2);
    for (pair, name) in shots.windows(2).zip(["outlines", "haze", "edl", "boxes"]) {
        let differing = pair[0].chunks_exact(3).zip(pair[1].chunks_exact(3)).filter(|(a, b)| a != b).count();
        assert!(differing > 900, "{name} changes {differing} pixels");
    }
    let eye = |state: &serde_json::Value| [0, 1, 2].map(|i| state["eye"][i].as_f64().unwrap());
    let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
    assert!(near(eye(first), [10.0, 20.0, 2.0]) && near(eye(stood), [-10.0, 20.0, 2.0]), "{first} {stood}");
    assert!(!near(eye(away), eye(stood)) && near(eye(back), eye(stood)), "{away} {back}");
    assert_eq!([&away["bookmarks"], &gone["bookmarks"]], [&serde_json::json!(["here"]), &serde_json::json!([])]);
    // The second time another name is found; a name that was typed is kept to.
    assert!(path("clip.laz").exists() && path("clip-2.laz").exists() && !path("clip-3.laz").exists());
    assert!(
        exported["message"].as_str().unwrap_or_default().contains("exists already; give another name"),
        "{exported}"
    );
    let points = |state: &serde_json::Value| state["points"].as_u64().unwrap();
    assert_eq!((&low["filter"], points(low)), (&"z < 2".into(), 1600), "{low}");
    assert!(wrong["message"].as_str().unwrap_or_default().contains("Colour"), "{wrong}");
    assert_eq!((&wrong["filter"], points(wrong)), (&"z < 2".into(), 1600), "{wrong}");
    assert_eq!((&all["filter"], points(all)), (&serde_json::Value::Null, 3200), "{all}");
}

/// Where it begins, in which colours and with which points.
#[test]
fn the_window_begins_with_what_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    scanned_walls(&path("walls.ptx"));
    let store = path("walls.esker");
    esker_ok(&["ingest", store.to_str().unwrap(), path("walls.ptx").to_str().unwrap()]);
    let view =
        r#"{"eye":[10,12,3],"target":[10,25,2],"up":[0,0,1],"projection":"orthographic","height":9,"size":[640,480]}"#;
    fs::write(path("plan.json"), view).unwrap();
    let (store_name, view_name) = (store.to_str().unwrap(), path("plan.json").to_str().unwrap().to_owned());
    esker_ok(&["bookmark", store_name, "plan", "--view", &view_name]);
    let options = ["--bookmark", "plan", "--color", "height", "--where", "z < 2", "--scan", "1"];
    let states = Display::start().view_with(folder.path(), &store, &options, "wait complete\nstate\nquit\n", |_| ());
    let [state] = states.as_slice() else { panic!("{} states", states.len()) };
    assert_eq!(state["eye"], serde_json::json!([10.0, 12.0, 3.0]));
    assert_eq!((&state["points"], &state["hidden_scans"]), (&800.into(), &1.into()), "{state}");
    assert_eq!((&state["parallel"], &state["color"]), (&true.into(), &"height".into()), "{state}");
}

/// A surveyor looks while scans come in, from none on.
#[test]
fn scans_are_shown_as_they_are_ingested() {
    let folder = tempfile::tempdir().unwrap();
    let store = small_store(folder.path(), "torus", "torus");
    let text = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for kind in ["spheres", "terrain"] {
        esker_ok(&["generate", kind, "--points", "30000", "-o", &text(&format!("{kind}.las"))]);
    }
    esker_ok(&["remove", store.to_str().unwrap(), "torus"]);
    let script = "size 700 500\nwait 1000\nstate\nwait points 1\nwait complete\nstate\nwait points 40000\nwait complete\nstate\nquit\n";
    let states = Display::start().view_and(folder.path(), &store, script, |lines| {
        if let Some(kind) = ["spheres", "terrain"].get(lines - 1) {
            esker_ok(&["ingest", store.to_str().unwrap(), &text(&format!("{kind}.las"))]);
        }
    });
    let counts: Vec<u64> = states.iter().map(|s| s["points"].as_u64().unwrap()).collect();
    // Two scans of 30,000, less what would be finer than a pixel.
    assert!(counts[0] == 0 && counts[1] > 20_000 && counts[1] <= 30_000 && counts[2] > 40_000, "{counts:?}");
    assert!(states.iter().all(|s| s["error"].is_null()), "{states:?}");
    // The first ones are brought into the picture; those who look are not moved by what comes later.
    assert!(
        states[0]["eye"] != states[1]["eye"] && states[1]["generation"].as_u64() < states[2]["generation"].as_u64()
    );
}

#[test]
fn without_a_display_there_is_an_error_and_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let text = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    esker_ok(&["generate", "torus", "--points", "1000", "-o", &text("t.las")]);
    esker_ok(&["ingest", &text("t.esker"), &text("t.las")]);
    let mut command = Command::new(env!("CARGO_BIN_EXE_esker"));
    command.args(["view", &text("t.esker")]).env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY");
    let output = command.env_remove("WAYLAND_SOCKET").output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("there can be no window: neither WAYLAND_DISPLAY") && !stderr.contains(".rs"), "{stderr}");
}
