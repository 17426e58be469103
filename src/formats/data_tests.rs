//! Every real file that the data folder lists, against what its README says of it.

use super::{Piece, PointSource, ReadOptions, SourceInfo, open, open_all};
use crate::points::PositionKind;
use std::path::{Path, PathBuf};

/// The folder of real files, if there is one here.
fn folder() -> Option<PathBuf> {
    let folder = std::env::var_os("ESKER_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    if folder.join("README.md").is_file() {
        return Some(folder);
    }
    println!("skipped: no real files at {}", folder.display());
    None
}

/// What a line of the README says.
struct Line {
    file: String,
    facts: String,
}

impl Line {
    fn parse(line: &str) -> Option<Self> {
        let mut parts = line.strip_prefix("- ")?.split(" | ");
        let file = parts.next()?.to_owned();
        let facts = parts.nth(1)?.to_owned();
        let known = [".las", ".laz", ".ply"].iter().any(|e| file.ends_with(e));
        known.then_some(Self { file, facts })
    }

    /// The number before `word`.
    fn count(&self, word: &str) -> Option<u64> {
        self.facts.split(word).next()?.rsplit([' ', ';']).next()?.parse().ok()
    }

    fn bounds(&self) -> Option<[[f64; 2]; 3]> {
        let axis = |name: &str| {
            let (_, rest) = self.facts.split_once(&format!("{name}["))?;
            let (min, max) = rest.split_once(']')?.0.split_once(',')?;
            Some([min.parse().ok()?, max.parse().ok()?])
        };
        Some([axis(" X")?, axis(" Y")?, axis(" Z")?])
    }
}

/// What reading a whole file gives.
struct Whole {
    info: SourceInfo,
    read: u64,
    bounds: [[f64; 2]; 3],
    own_bounds: [[f64; 2]; 3],
    /// Records that have a position.
    finite: u64,
    /// A number per byte of a record that depends on all records and their order.
    sums: Vec<u64>,
}

fn read_all(path: &Path, target: u64) -> Result<Whole, String> {
    read_source(&*open(path, &ReadOptions::default()).map_err(|e| e.to_string())?, target)
}

fn read_scans(path: &Path) -> Result<Vec<Whole>, String> {
    let sources = open_all(path, &ReadOptions::default()).map_err(|e| e.to_string())?;
    sources.iter().map(|s| read_source(&**s, 1000)).collect()
}

fn read_source(source: &dyn PointSource, target: u64) -> Result<Whole, String> {
    let info = source.info().clone();
    let stride = info.layout.stride();
    let nowhere = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
    let mut whole = Whole { read: 0, bounds: nowhere, own_bounds: nowhere, finite: 0, sums: vec![0; stride], info };
    let mut next = 0;
    for piece in source.pieces(target) {
        assert_eq!(piece.first, next);
        next += piece.records;
        let mut sink = |run: &[u8]| {
            assert!(run.len() <= (1 << 20).max(stride) && run.len().is_multiple_of(stride));
            run.chunks_exact(stride).for_each(|record| whole.add(record));
            true
        };
        let tally = source.read(piece, &mut sink).map_err(|e| e.to_string())?;
        whole.read += tally.read;
        assert_eq!(tally.read + tally.truncated, piece.records, "{}", whole.info.path.display());
    }
    assert_eq!(next, whole.info.records);
    Ok(whole)
}

impl Whole {
    fn add(&mut self, record: &[u8]) {
        self.sums.iter_mut().zip(record).for_each(|(s, b)| *s = s.wrapping_mul(3).wrapping_add((*b).into()));
        let world = self.position(record);
        for (bounds, w) in self.bounds.iter_mut().zip(world) {
            *bounds = [bounds[0].min(w), bounds[1].max(w)];
        }
        // In the scan's own frame, if it has one of its own; a record without a position counts for nothing here.
        let own = self.info.pose.scan_from_world(world);
        self.finite += u64::from(own.iter().all(|v| v.is_finite()));
        for (bounds, w) in self.own_bounds.iter_mut().zip(own) {
            *bounds = [bounds[0].min(w), bounds[1].max(w)];
        }
    }

    fn position(&self, record: &[u8]) -> [f64; 3] {
        match (&self.info.las, self.info.layout.position) {
            (Some(las), PositionKind::Grid) => std::array::from_fn(|i| {
                let x = i32::from_le_bytes(record[4 * i..4 * i + 4].try_into().unwrap());
                f64::from(x) * las.scale[i] + las.offset[i]
            }),
            (None, PositionKind::Grid) => {
                let x = std::array::from_fn(|i| i32::from_le_bytes(record[4 * i..4 * i + 4].try_into().unwrap()));
                self.info.grid.unwrap().world(x)
            }
            _ => std::array::from_fn(|i| f64::from_le_bytes(record[8 * i..8 * i + 8].try_into().unwrap())),
        }
    }
}

/// Files that can't be read, and what the error says.
const REFUSED: &[(&str, &str)] = &[
    ("pdal_pcd_ply/no_vertex.ply", "at byte 33: expected an element `vertex`"),
    ("pdal_pcd_ply/sized_dims.ply", "at byte 145: expected scalar properties x, y and z"),
    ("pdal_pcd_ply/unsized_dims.ply", "at byte 142: expected scalar properties x, y and z"),
    ("trimesh_ply_xyz/ply_empty_header.ply", "at byte 32: expected an element `vertex`"),
];

/// Files with points far outside the bounds of their header.
const LYING_BOUNDS: &[&str] = &["odd_las/spurious.las"];

#[test]
fn real_files_hold_what_their_list_says() {
    let Some(folder) = folder() else { return };
    let list = std::fs::read_to_string(folder.join("README.md")).unwrap();
    let mut checked = 0;
    for line in list.lines().filter_map(Line::parse) {
        let name = &*line.file;
        let result = read_all(&folder.join(name), 60_000);
        if let Some((_, message)) = REFUSED.iter().find(|(refused, _)| *refused == name) {
            let error = result.err().unwrap_or_default();
            assert!(error.contains(message), "{name}: {error}");
            continue;
        }
        let whole = result.unwrap_or_else(|e| panic!("{name}: {e}"));
        checked += 1;
        if let Some(count) = line.count(" pts").or(line.count(" vertex(")) {
            assert_eq!(whole.read + whole.info.missing, count, "{name}");
            assert_eq!(whole.info.missing > 0, name.ends_with("no-points.las") && count > 0, "{name}");
        }
        // The list has the header's bounds for LAS, those of the points for PLY.
        let slack = |i: usize| whole.info.las.as_ref().map_or(1e-9, |l| l.scale[i]);
        for (i, expected) in line.bounds().into_iter().flatten().enumerate() {
            let near = |a: f64, b: f64| (a - b).abs() <= 1e-8 * a.abs().max(1.0);
            if let Some((min, max)) = whole.info.bounds_hint {
                assert!(near(min[i], expected[0]) && near(max[i], expected[1]), "{name}");
            }
            if whole.read > 0 && !LYING_BOUNDS.contains(&name) {
                for (found, expected) in whole.bounds[i].iter().zip(expected) {
                    let difference = (found - expected).abs();
                    assert!(difference <= slack(i) + 1e-8 * expected.abs(), "{name}: {:?}", whole.bounds);
                }
            }
        }
    }
    assert!(checked > 90, "{checked}");
}

/// E57, PTX, PTS, PCD and text files that can't be read, and what the error says.
const REFUSED_SCANS: &[(&str, &str)] = &[
    ("cryinc_e57/corrupt_crc.e57", "with the right checksum (CRC), found another checksum"),
    ("cryinc_e57/empty.e57", "expected a scan in the file, found none"),
    ("pdal_pcd_ply/missingheader.pcd", "at byte 0: expected a PCD header"),
];

/// Records, those of them with a position, records that are missing.
type Counts = (u64, u64, u64);

/// Scans that the list gives no counts of: records, those of them with a position, records that are missing.
const COUNTED: &[(&str, &[Counts])] = &[
    ("loadersgl/ripple.ptx", &[(10_201, 10_201, 44_492_015)]),
    ("pdal_pts_ptx/1.2-with-color.ptx", &[(1065, 1065, 0)]),
    ("pdal_pts_ptx/complex-transform.ptx", &[(12, 4, 0)]),
    ("pdal_pts_ptx/multiple-and-transform.ptx", &[(4, 4, 0), (4, 4, 0)]),
    ("pdal_pts_ptx/no-color.ptx", &[(15, 15, 0)]),
];

/// One scan as a line of the list has it: points, columns, bounds in its own frame.
type Listed = (u64, Vec<String>, Option<[[f64; 2]; 3]>);

/// The scans of a line on an E57 file.
fn listed_e57(facts: &str) -> Vec<Listed> {
    let scan = |text: &str| {
        let line = Line { file: String::new(), facts: text.to_owned() };
        let columns = text.split_once('(')?.1.split_once(')')?.0.split(',').map(str::to_owned).collect();
        Some((line.count(" pts (")?, columns, line.bounds()))
    };
    let scans = facts.split_once("scan(s): ").map_or("", |(_, scans)| scans);
    scans.split(" | ").filter_map(scan).collect()
}

#[test]
fn real_scans_hold_what_their_list_says() {
    let Some(folder) = folder() else { return };
    let list = std::fs::read_to_string(folder.join("README.md")).unwrap();
    let endings = [".e57", ".ptx", ".pts", ".pcd", ".xyz", ".txt"];
    let mut checked = 0;
    for line in list.lines().filter_map(|l| l.strip_prefix("- ")) {
        let name = line.split(" | ").next().unwrap();
        if !endings.iter().any(|e| name.ends_with(e)) {
            continue;
        }
        let facts = line.split_once(" B | ").unwrap().1.split(" | licence").next().unwrap();
        checked += 1;
        let result = read_scans(&folder.join(name));
        if let Some((_, message)) = REFUSED_SCANS.iter().find(|(refused, _)| *refused == name) {
            let error = result.err().unwrap_or_default();
            assert!(error.contains(message), "{name}: {error}");
            continue;
        }
        let scans = result.unwrap_or_else(|e| panic!("{name}: {e}"));
        let near = |found: [[f64; 2]; 3], expected: [[f64; 2]; 3]| {
            let pairs = found.into_iter().flatten().zip(expected.into_iter().flatten());
            pairs.into_iter().all(|(a, b)| (a - b).abs() <= 2e-9 * b.abs().max(1.0))
        };
        if facts.starts_with("E57") {
            let listed = listed_e57(facts);
            assert_eq!(listed.len(), scans.len(), "{name}");
            for (whole, (points, columns, bounds)) in scans.iter().zip(listed) {
                assert_eq!((whole.read, whole.info.missing), (points, 0), "{name}");
                let states = columns.iter().filter(|c| c.ends_with("InvalidState")).count();
                assert_eq!(whole.info.layout.attributes.len(), columns.len() - 3 - states, "{name}: {columns:?}");
                if let (Some(bounds), true) = (bounds, whole.finite == whole.read) {
                    assert!(near(whole.own_bounds, bounds), "{name}: {:?} {bounds:?}", whole.own_bounds);
                }
            }
            continue;
        }
        if let Some((_, expected)) = COUNTED.iter().find(|(counted, _)| *counted == name) {
            let found: Vec<_> = scans.iter().map(|w| (w.read, w.finite, w.info.missing)).collect();
            assert_eq!(found, *expected, "{name}");
            continue;
        }
        let line = Line { file: name.to_owned(), facts: facts.replace("['", "").replace("']", "") };
        let count = line.count(" numeric rows").or(line.count(" pts ("));
        assert_eq!(Some(scans[0].read), count, "{name}");
        assert_eq!((scans.len(), scans[0].finite, scans[0].info.missing), (1, scans[0].read, 0), "{name}");
        if let Some(bounds) = line.bounds() {
            assert!(near(scans[0].bounds, bounds), "{name}: {:?} {bounds:?}", scans[0].bounds);
        }
    }
    assert!(checked >= 40, "{checked}");
}

#[test]
fn posed_blocks_stand_where_their_transforms_say() {
    let Some(folder) = folder() else { return };
    // The first block is the second one, 600 km away and half as high: its transform brings it there.
    let scans = read_scans(&folder.join("pdal_pts_ptx/multiple-and-transform.ptx")).unwrap();
    for (a, b) in scans[0].bounds.iter().flatten().zip(scans[1].bounds.iter().flatten()) {
        assert!((a - b).abs() < 1e-9, "{a} {b}");
    }
    assert!(scans[0].info.warnings[0].contains("stretches axes by different factors"));
    // Row vectors: p R + t, with numbers of the file.
    let scans = read_scans(&folder.join("pdal_pts_ptx/complex-transform.ptx")).unwrap();
    let x = -0.005_63 * 0.999_979 + 0.645_218 * 0.003_613 - 0.440_506 * 0.005_359 - 3.028_748;
    assert!(scans[0].bounds[0].iter().any(|b| (b - x).abs() < 1e-4), "{:?}", scans[0].bounds);
    assert_eq!(scans[0].info.pose.scanner(), [-3.028_748, -3.819_741, -1.384_333]);
}

#[test]
fn real_files_name_their_systems() {
    let Some(folder) = folder() else { return };
    let expected = [
        ("bcts/bcts_1.laz", Some(3005), Some(5713), Some("metre")),
        ("ign_tiles/test_data_77050_627755_LA93_IGN69.laz", Some(2154), None, Some("metre")),
        ("lasrs/autzen.copc.laz", Some(2992), Some(6360), Some("foot")),
        ("spanner_multiplatform/ALS_Clip.laz", Some(6341), Some(5703), Some("metre")),
        ("pdal_las/test1_4.las", Some(2903), None, Some("US survey foot")),
        ("pdal_las/epsg_4326.las", Some(4326), None, Some("degree")),
        ("odd_las/no-points.las", Some(4269), None, Some("degree")),
        ("odd_las/bad-geotiff-keys.las", Some(32617), None, Some("metre")),
        // Private codes and broken texts are no codes.
        ("ign_tiles/test_pdalfail_0643_6319_LA93_IGN69.laz", None, None, None),
        ("pdal_copc/lone-star.copc.laz", None, None, Some("metre")),
    ];
    for (name, horizontal, vertical, unit) in expected {
        let source = open(&folder.join(name), &ReadOptions::default()).unwrap();
        let crs = source.info().crs.clone().unwrap_or_default();
        assert_eq!((crs.horizontal_epsg, crs.vertical_epsg, crs.unit_name()), (horizontal, vertical, unit), "{name}");
        assert_eq!(crs.is_geographic(), unit == Some("degree"), "{name}");
        assert_eq!(
            crs.same_as(&crs),
            if crs.wkt.is_some() || horizontal.is_some() || !crs.geotiff.is_empty() { Some(true) } else { None }
        );
    }
}

#[test]
fn the_same_points_are_the_same_bytes_in_las_and_laz() {
    let Some(folder) = folder() else { return };
    let formats = ["4-1.3", "5-1.3", "6-1.4", "7-v4-1.4", "8-1.4", "9-1.4", "9-1.5", "10-1.4", "10-1.5"];
    let mut pairs: Vec<_> = formats
        .iter()
        .map(|f| (format!("pdrf_permutations/pdrf{f}.las"), format!("pdrf_permutations/pdrf{f}.laz")))
        .collect();
    let simple = ["pdal_las/simple.laz", "pdal_las/simple-laszip-compressor-version-1.2r0.laz"];
    let padded = "odd_las/laszip-generated_with2bytespadding.laz";
    pairs.extend(simple.into_iter().chain([padded]).map(|l| ("pdal_las/simple.las".to_owned(), l.to_owned())));
    for (las, laz) in pairs {
        let read = |name: &str| read_all(&folder.join(name), 100).unwrap_or_else(|e| panic!("{name}: {e}"));
        let (las, laz) = (read(&las), read(&laz));
        assert_eq!(las.info.layout, laz.info.layout);
        assert_eq!((las.read, las.sums), (laz.read, laz.sums), "{}", laz.info.path.display());
    }
}

#[test]
fn pieces_of_any_size_are_the_same_records() {
    let Some(folder) = folder() else { return };
    for name in ["bcts/bcts_1.laz", "laspy_testdata/simple_with_page.copc.laz", "loadersgl/ripple_bin.ply"] {
        let one = read_all(&folder.join(name), u64::MAX).unwrap();
        for target in [0, 1, 777, 100_000] {
            let several = read_all(&folder.join(name), target.max(one.read / 500)).unwrap();
            assert_eq!((one.read, &one.sums), (several.read, &several.sums), "{name}");
        }
        // Pieces that no chunk begins or ends with.
        let source = open(&folder.join(name), &ReadOptions::default()).unwrap();
        let mut all = Vec::new();
        let half = one.read / 2 + 1;
        for piece in [Piece { first: 0, records: half }, Piece { first: half, records: u64::MAX }] {
            let mut sink = |run: &[u8]| {
                all.extend_from_slice(run);
                true
            };
            source.read(piece, &mut sink).unwrap();
        }
        let (bounds, own_bounds) = (one.bounds, one.own_bounds);
        let sums = vec![0; one.sums.len()];
        let mut whole = Whole { info: one.info.clone(), read: 0, bounds, own_bounds, finite: 0, sums };
        all.chunks_exact(whole.sums.len()).for_each(|r| whole.add(r));
        assert_eq!(all.len() / whole.sums.len(), one.read as usize);
        assert_eq!(whole.sums, one.sums);
    }
}
