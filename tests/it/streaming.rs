//! The stream over stores, with a pool in memory and a clock that only the test moves: what the frame gets, frame by
//! frame.

use crate::support::{Random, data_folder, esker_ok};
use esker::geometry::{Camera, DVec3, Projection, WorldBox};
use esker::lattice::{Lattice, LatticePoint};
use esker::points::Batch;
use esker::query::{Filter, Query, WantedPart};
use esker::store::{Snapshot, Store};
use esker::stream::gpu::{MemoryPool, Paint, PoolContent};
use esker::stream::{
    Content, Front, Limits, Loaded, Pending, PickPlace, ScanChoice, Selected, Shown, Source, StoreContent, StoreSource,
    Stream, StreamError, View,
};
use std::collections::{HashMap, HashSet};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::Notify;

const BLOCK_POINTS: u32 = 256;
const FRAME: Duration = Duration::from_millis(16);

/// The value is the class, with a number of its own for each paint.
#[derive(Debug)]
struct ClassPaint(u64);

impl Paint for ClassPaint {
    fn tag(&self) -> u64 {
        self.0
    }
    fn attributes(&self) -> Vec<String> {
        vec!["Classification".into()]
    }
    fn needs_scans(&self) -> bool {
        false
    }
    fn paint(&self, batch: &Batch, _: &Lattice, values: &mut Vec<u32>) {
        let tag = self.0 as u32 * 1000;
        match batch.column("Classification") {
            Some(column) => values.extend((0..batch.len()).map(|i| tag + column.as_f64(i) as u32)),
            None => values.resize(values.len() + batch.len(), tag),
        }
    }
}

/// A store behind a slow disk, which may stop altogether.
struct Slow {
    inner: StoreSource,
    disk: Arc<Disk>,
}

#[derive(Default)]
struct Disk {
    blocked: AtomicBool,
    released: Notify,
    load_ms: AtomicU64,
    /// Loads that were begun.
    loads: AtomicU64,
}

impl Disk {
    async fn wait(&self, time: Duration) {
        tokio::time::sleep(time).await;
        while self.blocked.load(Ordering::Acquire) {
            self.released.notified().await;
        }
    }

    fn release(&self) {
        self.blocked.store(false, Ordering::Release);
        self.released.notify_waiters();
    }
}

struct SlowContent {
    inner: Arc<StoreContent>,
    disk: Arc<Disk>,
}

impl Source for Slow {
    fn open(&self, shown: Shown) -> Pending<Result<Arc<dyn Content>, StreamError>> {
        let (source, disk) = (self.inner.clone(), self.disk.clone());
        Box::pin(async move {
            disk.wait(Duration::ZERO).await;
            let inner = Arc::new(source.open_now(&shown)?);
            Ok(Arc::new(SlowContent { inner, disk }) as Arc<dyn Content>)
        })
    }
}

impl Content for SlowContent {
    fn lattice(&self) -> &Lattice {
        self.inner.lattice()
    }
    fn paint(&self) -> u64 {
        self.inner.paint()
    }
    fn snapshot(&self) -> &Snapshot {
        self.inner.snapshot()
    }
    fn is_outdated(self: Arc<Self>) -> Pending<Result<bool, StreamError>> {
        Box::pin(async move { self.inner.is_outdated_now() })
    }
    fn select(self: Arc<Self>, view: View) -> Pending<Result<Selected, StreamError>> {
        Box::pin(async move {
            self.disk.wait(Duration::from_millis(1)).await;
            self.inner.select_now(&view)
        })
    }
    fn load(self: Arc<Self>, part: WantedPart) -> Pending<Result<Loaded, StreamError>> {
        Box::pin(async move {
            self.disk.loads.fetch_add(1, Ordering::AcqRel);
            self.disk.wait(Duration::from_millis(self.disk.load_ms.load(Ordering::Acquire))).await;
            self.inner.load_now(&part)
        })
    }
    fn point(self: Arc<Self>, part: WantedPart, index: u32) -> Pending<Result<Batch, StreamError>> {
        Box::pin(async move { self.inner.point_now(&part, index) })
    }
}

/// Everything that a walk needs.
struct Walk {
    store: Store,
    stream: Stream,
    disk: Arc<Disk>,
    pool: Arc<Mutex<PoolContent>>,
    shown: Shown,
    limits: Limits,
    bounds: WorldBox,
    last: Option<Front>,
    /// Does the store hide no scan?
    all_visible: bool,
    /// Bytes of the parts that newly entered what was wanted.
    entered_bytes: u64,
}

fn shown(tag: u64) -> Shown {
    Shown { scans: ScanChoice::default(), filter: None, paint: Arc::new(ClassPaint(tag)) }
}

fn run(test: impl AsyncFnOnce()) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap();
    runtime.block_on(test());
}

impl Walk {
    fn begin(store: &Path, limits: Limits) -> Self {
        let store = Store::open(store).unwrap();
        let snapshot = store.snapshot().unwrap();
        let lattice = snapshot.site().lattice.clone();
        let bounds = snapshot.scans().iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b)).unwrap();
        let corner = |p| lattice.world_from_lattice(p);
        let bounds = WorldBox::new(corner(bounds.min), corner(bounds.max)).unwrap();
        let disk = Arc::new(Disk::default());
        disk.load_ms.store(7, Ordering::Release);
        let pool = MemoryPool::new(limits.blocks(BLOCK_POINTS), BLOCK_POINTS);
        let content = pool.content();
        let source = Arc::new(Slow { inner: StoreSource::new(store.clone()), disk: disk.clone() });
        let shown = shown(1);
        let (stream, task) = Stream::new(source, Box::new(pool), shown.clone(), limits, lattice, || ());
        tokio::spawn(task);
        Self {
            store,
            stream,
            disk,
            pool: content,
            shown,
            limits,
            bounds,
            last: None,
            all_visible: true,
            entered_bytes: 0,
        }
    }

    /// One frame: looks at what there is to draw, and checks what must hold of every frame.
    async fn frame(&mut self) {
        let front = self.stream.front();
        let list = &front.list;
        assert!(list.points <= self.limits.points, "{} points are drawn", list.points);
        assert_eq!(list.points, list.blocks.iter().map(|b| u64::from(b.points)).sum::<u64>());
        let blocks = self.pool.lock().unwrap().blocks.len();
        assert!(blocks <= self.limits.blocks(BLOCK_POINTS) as usize, "the pool has grown to {blocks} blocks");
        // Closed: every parent is there and comes before, and parts come in order, none left out.
        for (i, node) in list.nodes.iter().enumerate() {
            assert!(node.parent.is_none_or(|p| (p as usize) < i && list.nodes[p as usize].cube == node.cube.parent()));
            let key = |n: &esker::stream::gpu::DrawNode| (n.cube.node_key(), n.layer);
            assert!(i == 0 || key(&list.nodes[i - 1]) < key(node), "not in node-key order");
        }
        let drawn = parts_of(&front);
        // Where something is hidden a part may have no points that match.
        let all = self.shows_all();
        for part in drawn.iter().filter(|p| all && p.2 > 0) {
            assert!(drawn.contains(&(part.0, part.1, part.2 - 1)), "a part is left out");
        }
        // And no part without those above that it refines.
        let layer = |p: &WantedPart| front.wanted.nodes[p.node as usize].layer;
        let is_drawn = |p: &WantedPart| drawn.contains(&(p.cube, layer(p), p.part));
        for part in front.wanted.parts.iter().filter(|p| all && is_drawn(p)) {
            let before = part.after.map(|before| &front.wanted.parts[before as usize]);
            assert!(before.is_none_or(is_drawn), "{:?} is drawn without what it refines", part.cube);
        }
        if let Some(last) = &self.last
            && last.number != front.number
        {
            let same = last.content.as_ref().zip(front.content.as_ref()).is_some_and(|(a, b)| Arc::ptr_eq(a, b));
            let wanted: HashMap<_, _> = front.wanted.parts.iter().map(|p| (p.id, p)).collect();
            let before: HashSet<_> = last.wanted.parts.iter().map(|p| p.id).collect();
            let entering = front.wanted.parts.iter().filter(|p| !same || !before.contains(&p.id));
            self.entered_bytes += entering.map(|p| 16 * u64::from(p.stored)).sum::<u64>();
            if same {
                // What was drawn and is still wanted is still drawn: no region loses what it had.
                let layer = |p: &WantedPart| last.wanted.nodes[p.node as usize].layer;
                let had = parts_of(last);
                for part in last.wanted.parts.iter().filter(|p| had.contains(&(p.cube, layer(p), p.part))) {
                    let still = !wanted.contains_key(&part.id) || drawn.contains(&(part.cube, layer(part), part.part));
                    assert!(still, "a part of {:?} that is wanted is gone", part.cube);
                }
            }
        } else if self.last.is_none() {
            self.entered_bytes += front.wanted.parts.iter().map(|p| 16 * u64::from(p.stored)).sum::<u64>();
        }
        self.last = Some(front);
        tokio::time::sleep(FRAME).await;
    }

    /// Frames until everything is there.
    async fn rest(&mut self) {
        for _ in 0..2000 {
            self.frame().await;
            let status = self.stream.status();
            assert_eq!(status.error_message, None);
            if status.complete && self.stream.front().list.complete {
                // What is told is what is seen a frame later, too.
                self.frame().await;
                if self.stream.status().complete {
                    return;
                }
            }
        }
        panic!("nothing comes to rest: {:?}", self.stream.status());
    }

    /// What is drawn: positions and values.
    fn drawn(&self) -> Vec<([u64; 3], u32)> {
        let front = self.stream.front();
        let content = self.pool.lock().unwrap();
        let mut points = Vec::new();
        for block in &front.list.blocks {
            let cube = front.list.nodes[block.node as usize].cube;
            let held = &content.blocks[block.block.0 as usize][..block.points as usize];
            points.extend(held.iter().map(|p| (p.unpack(cube).0, p.value)));
        }
        points.sort_unstable();
        points
    }

    fn shows_all(&self) -> bool {
        self.shown.filter.is_none() && self.shown.scans == ScanChoice::default() && self.all_visible
    }

    /// What a fresh query gives for this camera, at most so many points.
    fn fresh(&self, camera: &Camera, capacity: u64) -> Vec<([u64; 3], u32)> {
        let snapshot = self.store.snapshot().unwrap();
        let mut query = Query::new().view(camera.clone(), self.limits.error_px).capacity(capacity);
        if let Some(filter) = &self.shown.filter {
            query = query.filter(filter.clone());
        }
        let sees = |s: &&esker::store::model::Scan| self.shown.scans.sees(s.id, s.visible);
        query = query.scans(snapshot.scans().iter().filter(sees).map(|s| s.name.clone()));
        let (mut points, mut values) = (Vec::new(), Vec::new());
        query
            .attributes(["Classification"])
            .run(&snapshot, |batch| {
                points.extend(batch.positions.iter().map(|p: LatticePoint| p.0));
                self.shown.paint.paint(&batch, &snapshot.site().lattice, &mut values);
                ControlFlow::Continue(())
            })
            .unwrap();
        let mut fresh: Vec<_> = points.into_iter().zip(values).collect();
        fresh.sort_unstable();
        fresh
    }

    fn assert_fresh(&self, camera: &Camera, words: &str) {
        let (drawn, mut fresh) = (self.drawn(), self.fresh(camera, self.limits.points));
        if !self.shows_all() && drawn.len() < fresh.len() {
            // What a query goes on to take where first points do not match comes after all that is streamed.
            fresh = self.fresh(camera, drawn.len() as u64);
        }
        assert!(!fresh.is_empty(), "{words}: nothing is seen, so nothing is tested");
        assert!(drawn == fresh, "{words}: {} points drawn, a fresh selection has {}", drawn.len(), fresh.len());
    }

    /// A camera at places relative to the bounds' sides, looking to an angle.
    fn camera(&self, at: [f64; 3], turn: f64) -> Camera {
        let extent = self.bounds.extent();
        let eye = self.bounds.min() + extent * DVec3::from_array(at);
        let side = extent.truncate().length();
        let target = eye + DVec3::new(turn.cos(), turn.sin(), -0.35) * side * 0.3;
        Camera::new(eye, target, DVec3::Z, Projection::Perspective { fov_y_rad: 1.0 }, [800, 600]).unwrap()
    }

    fn set_shown(&mut self, shown: Shown) {
        self.stream.set_shown(&shown);
        self.shown = shown;
    }
}

/// The parts of which something is drawn.
fn parts_of(front: &Front) -> HashSet<(esker::lattice::Cube, u16, u32)> {
    let node = |b: &esker::stream::gpu::DrawBlock| &front.list.nodes[b.node as usize];
    front.list.blocks.iter().map(|b| (node(b).cube, node(b).layer, b.part)).collect()
}

/// A site of three overlapping scans.
fn site(folder: &Path, points: &str) -> std::path::PathBuf {
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    esker_ok(&["generate", "site", "--points", points, "--seed", "4", "-o", &path("scans")]);
    esker_ok(&["ingest", &path("site.esker"), &path("scans")]);
    folder.join("site.esker")
}

fn limits(points: u64) -> Limits {
    Limits { points, error_px: 1.0, ..Limits::default() }
}

#[test]
fn frames_go_on_while_the_disk_is_stuck() {
    let folder = tempfile::tempdir().unwrap();
    let store = site(folder.path(), "300000");
    run(async || {
        let mut walk = Walk::begin(&store, limits(80_000));
        walk.stream.set_camera(&walk.camera([0.5, 0.1, 3.0], 1.5));
        walk.rest().await;
        let at_rest = walk.stream.front();
        walk.disk.blocked.store(true, Ordering::Release);
        let started = std::time::Instant::now();
        let cameras: Vec<Camera> = (0..200).map(|i| walk.camera([0.5, 0.1, 3.0], 1.5 + f64::from(i) * 0.03)).collect();
        for camera in &cameras {
            walk.stream.set_camera(camera);
            walk.frame().await;
            assert_eq!(walk.stream.front().number, at_rest.number, "nothing came, so nothing changes");
        }
        assert!(started.elapsed() < Duration::from_secs(5), "a frame has waited: {:?}", started.elapsed());
        walk.disk.release();
        walk.rest().await;
        walk.assert_fresh(&cameras[199], "after the disk came back");
    });
}

/// The first picture waited until it was complete, for half a second at most, as if there were an older one to keep.
#[test]
fn a_first_picture_is_coarse_and_early() {
    let folder = tempfile::tempdir().unwrap();
    let store = site(folder.path(), "400000");
    // Loads under way are twice the threads and some: with many cores all of this small site comes at once.
    let threads = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    let test = async || {
        let mut walk = Walk::begin(&store, limits(300_000));
        walk.disk.load_ms.store(60, Ordering::Release);
        // As a window does, which knows colours a little later than where the points are.
        walk.frame().await;
        walk.set_shown(shown(2));
        walk.stream.set_camera(&walk.camera([0.5, 0.1, 3.0], 1.5));
        let started = tokio::time::Instant::now();
        while walk.stream.front().list.points == 0 {
            walk.frame().await;
        }
        let (first, coarse) = (started.elapsed(), walk.stream.front().list.clone());
        walk.rest().await;
        let (whole, complete) = (started.elapsed(), walk.stream.front().list.points);
        println!("{} points after {first:?}, {complete} after {whole:?}", coarse.points);
        assert!(
            first < Duration::from_millis(60 + 33 + 40) && !coarse.complete,
            "after {first:?}: {}",
            coarse.complete
        );
        assert!(coarse.points * 2 < complete && whole > 2 * first, "{} of {complete} after {whole:?}", coarse.points);
    };
    threads.install(|| run(test));
}

/// A camera that came and went leaves nothing: loads that were not begun are not, and what was being loaded is not uploaded.
#[test]
fn what_only_an_older_camera_wanted_is_neither_loaded_nor_uploaded() {
    let folder = tempfile::tempdir().unwrap();
    let store = site(folder.path(), "400000");
    run(async || {
        let mut walk = Walk::begin(&store, Limits { prefetch: false, ..limits(300_000) });
        // From afar little is wanted, from near more than is loaded at once.
        let [here, there] = [walk.camera([0.5, -6.0, 9.0], 1.5), walk.camera([0.5, 0.1, 3.0], 1.5)];
        walk.stream.set_camera(&here);
        walk.rest().await;
        let figures = |walk: &Walk| (walk.disk.loads.load(Ordering::Acquire), walk.stream.status().uploaded_bytes);
        let before = figures(&walk);
        walk.disk.load_ms.store(300, Ordering::Release);
        walk.stream.set_camera(&there);
        for _ in 0..6 {
            walk.frame().await;
        }
        walk.stream.set_camera(&here);
        walk.rest().await;
        for _ in 0..60 {
            walk.frame().await;
        }
        let (loads, uploaded) = figures(&walk);
        assert_eq!(uploaded, before.1, "what nobody wants any more was uploaded");
        let begun = loads - before.0;
        walk.stream.set_camera(&there);
        walk.disk.load_ms.store(1, Ordering::Release);
        walk.rest().await;
        let needed = walk.disk.loads.load(Ordering::Acquire) - loads;
        println!("{begun} of {needed} loads were begun");
        assert!(begun > 0 && begun < needed, "{begun} of {needed} loads were begun for a camera that was gone");
        walk.assert_fresh(&there, "there at last");
    });
}

async fn random_walk(store: &Path, seed: u64, points: u64, legs: u32) -> f64 {
    println!("seed {seed}, {}", store.display());
    let mut random = Random(seed);
    let mut walk = Walk::begin(store, limits(points));
    walk.limits.prefetch = seed.is_multiple_of(2);
    walk.stream.set_limits(walk.limits);
    let (mut at, mut turn) = ([0.5, 0.5, 1.5], 0.0);
    for leg in 0..legs {
        walk.disk.load_ms.store(random.below(60), Ordering::Release);
        // Slow, a fast turn, or a jump.
        let (steps, speed, turning) = match random.below(3) {
            0 => (30, 0.004, 0.01),
            1 => (10, 0.0, 0.3),
            _ => (1, 0.0, 0.0),
        };
        let direction: [f64; 3] = std::array::from_fn(|_| random.unit() - 0.5);
        if steps == 1 {
            at = [random.unit(), random.unit(), 0.3 + 2.0 * random.unit()];
            turn = random.unit() * 6.3;
        }
        for _ in 0..steps {
            at = std::array::from_fn(|i| at[i] + direction[i] * speed);
            turn += turning;
            walk.stream.set_camera(&walk.camera(at, turn));
            walk.frame().await;
        }
        if random.below(2) == 0 {
            let camera = walk.camera(at, turn);
            walk.rest().await;
            // A view of nothing has nothing to compare.
            if walk.fresh(&camera, 1).is_empty() {
                assert!(walk.drawn().is_empty());
            } else {
                walk.assert_fresh(&camera, &format!("leg {leg}"));
            }
        }
    }
    walk.rest().await;
    let uploaded = walk.stream.status().uploaded_bytes;
    let ratio = uploaded as f64 / walk.entered_bytes.max(1) as f64;
    println!("uploaded {uploaded} bytes, {ratio:.3} of what newly entered");
    ratio
}

#[test]
fn walks_over_a_generated_site_show_what_a_fresh_selection_has() {
    let folder = tempfile::tempdir().unwrap();
    let store = site(folder.path(), "400000");
    let seeds = if std::env::var_os("ESKER_SWEEP").is_some() { 40 } else { 4 };
    for seed in 0..seeds {
        run(async || {
            let ratio = random_walk(&store, seed, 60_000 + 10_000 * seed, 12).await;
            assert!(ratio <= 1.1, "{ratio}");
        });
    }
}

#[test]
fn walks_over_a_real_site_show_what_a_fresh_selection_has() {
    let Some(data) = data_folder() else { return };
    let file = data.join("pdal_autzen/autzen_trim_7.las");
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("real.esker");
    esker_ok(&["ingest", store.to_str().unwrap(), file.to_str().unwrap()]);
    run(async || {
        let ratio = random_walk(&store, 6, 50_000, 12).await;
        assert!(ratio <= 1.1, "{ratio}");
    });
}

#[test]
fn what_is_shown_can_change() {
    let folder = tempfile::tempdir().unwrap();
    let store = site(folder.path(), "300000");
    run(async || {
        let mut walk = Walk::begin(&store, limits(70_000));
        let camera = walk.camera([0.4, 0.0, 2.5], 1.4);
        walk.stream.set_camera(&camera);
        walk.rest().await;
        walk.assert_fresh(&camera, "everything");
        let everything = walk.drawn();
        let uploaded = walk.stream.status().uploaded_bytes;

        let mut choice = ScanChoice::default();
        choice.set(1, true, false);
        walk.set_shown(Shown { scans: choice, ..shown(1) });
        walk.rest().await;
        walk.assert_fresh(&camera, "without scan 1");
        assert_ne!(walk.drawn(), everything);

        walk.set_shown(Shown { filter: Some(Filter::parse("Classification = 2").unwrap()), ..shown(1) });
        walk.rest().await;
        walk.assert_fresh(&camera, "ground");

        walk.set_shown(shown(2));
        walk.rest().await;
        walk.assert_fresh(&camera, "another paint");

        // Back to what may still be there: at most what was uploaded for it the first time.
        let before = walk.stream.status().uploaded_bytes;
        walk.set_shown(shown(1));
        walk.rest().await;
        assert_eq!(walk.drawn(), everything);
        assert!(walk.stream.status().uploaded_bytes - before <= uploaded);

        walk.limits.points = 20_000;
        walk.stream.set_limits(walk.limits);
        // The list of before may be drawn until the new one is there, and its blocks stay as long as anybody holds it.
        walk.last = None;
        for _ in 0..60 {
            tokio::time::sleep(FRAME).await;
        }
        walk.rest().await;
        walk.assert_fresh(&camera, "a smaller budget");
        assert_eq!(walk.pool.lock().unwrap().blocks.len(), walk.limits.blocks(BLOCK_POINTS) as usize);

        walk.limits.points = 90_000;
        walk.stream.set_limits(walk.limits);
        walk.rest().await;
        walk.assert_fresh(&camera, "a larger budget");
    });
}

#[test]
fn a_new_scan_is_seen_without_a_restart_and_a_hidden_one_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let store = site(folder.path(), "200000");
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    esker_ok(&["generate", "torus", "--points", "50000", "-o", &path("t.las")]);
    run(async || {
        let mut walk = Walk::begin(&store, limits(300_000));
        let camera = Camera::looking_at_all(&walk.bounds, [800, 600]).unwrap();
        walk.stream.set_camera(&camera);
        walk.rest().await;
        walk.assert_fresh(&camera, "before");
        let generation = walk.stream.status().generation;
        // A copy of a scan, moved by nothing: its points are there twice.
        esker_ok(&["query", store.to_str().unwrap(), "--max-error", "0.3", "-o", &path("again.las")]);
        esker_ok(&["ingest", store.to_str().unwrap(), &path("again.las")]);
        for _ in 0..40 {
            walk.frame().await;
        }
        walk.rest().await;
        assert!(walk.stream.status().generation > generation);
        walk.assert_fresh(&camera, "with the new scan");
        esker_ok(&["hide", store.to_str().unwrap(), "again"]);
        walk.all_visible = false;
        for _ in 0..40 {
            walk.frame().await;
        }
        walk.rest().await;
        walk.assert_fresh(&camera, "with the new scan hidden");
    });
}

/// On its own threads, in real time, as a window has it.
#[test]
fn a_stream_with_threads_finds_the_stored_point_behind_a_drawn_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = site(folder.path(), "200000");
    let store = Store::open(&path).unwrap();
    let lattice = store.snapshot().unwrap().site().lattice.clone();
    let limits = limits(50_000);
    let pool = MemoryPool::new(limits.blocks(BLOCK_POINTS), BLOCK_POINTS);
    let content = pool.content();
    let source = Arc::new(StoreSource::new(store.clone()));
    let stream = Stream::spawn(source, Box::new(pool), shown(0), limits, lattice.clone(), || ()).unwrap();
    let snapshot = store.snapshot().unwrap();
    let bounds = snapshot.scans().iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b)).unwrap();
    let corner = |p| lattice.world_from_lattice(p);
    let bounds = WorldBox::new(corner(bounds.min), corner(bounds.max)).unwrap();
    stream.set_camera(&Camera::looking_at_all(&bounds, [640, 480]).unwrap());
    let started = std::time::Instant::now();
    while !stream.status().complete {
        assert!(started.elapsed() < Duration::from_secs(60), "{:?}", stream.status());
        std::thread::sleep(Duration::from_millis(5));
    }
    let front = stream.front();
    assert!(front.list.complete && front.list.points == 50_000);
    for block in front.list.blocks.iter().step_by(17) {
        let node = front.list.nodes[block.node as usize];
        let packed = content.lock().unwrap().blocks[block.block.0 as usize][block.points as usize - 1];
        let index = block.first + block.points - 1;
        let place = PickPlace { cube: node.cube, layer: node.layer, part: block.part, index };
        let point = stream.pick(&front, place).recv().unwrap().unwrap();
        assert_eq!(point.positions.point(0), packed.unpack(node.cube));
        assert_eq!(point.column("Classification").unwrap().as_f64(0) as u32, packed.value);
        assert!(point.attributes.len() > 3 && point.scans.len() == 1);
    }
}
