//! Filters against a naive evaluation of every point, and zone maps against the points that they sum up.

use super::*;
use crate::lattice::{BIAS, Exactness, Lattice, LatticeBox, LatticePoint};
use crate::points::{Attribute, Column, Positions, ScalarType, Scaling};
use crate::query::block::BlockScans;
use crate::query::kinds::Kinds;
use crate::store::model::{Range, Rejected, Scan, StoredAttribute};
use proptest::prelude::*;
use std::sync::Arc;

const CLASS: Slot = 2;
const STAMP: Slot = 3;
const TIME: Slot = 4;
const HEIGHT: Slot = 5;
const ANGLE_8: Slot = 6;
const ANGLE_16: Slot = 7;
const FINE_HEIGHT: Slot = 8;

fn attributes() -> Vec<StoredAttribute> {
    let plain = |id, name: &str, ty| StoredAttribute { id, attribute: Attribute::new(name, ty) };
    let mut height = plain(HEIGHT, "tree_height", ScalarType::I16);
    height.attribute.scaling = Some(Scaling { scale: 0.1, offset: -2.0 });
    height.attribute.no_data = Some([0xf1, 0xd8, 7, 7, 7, 7, 7, 7]);
    // The same name and type in another scan, which has no value that means "no data".
    let mut fine = plain(FINE_HEIGHT, "tree_height", ScalarType::I16);
    fine.attribute.scaling = Some(Scaling { scale: 0.01, offset: 0.0 });
    vec![
        plain(CLASS, "Classification", ScalarType::U8),
        plain(STAMP, "stamp", ScalarType::U64),
        plain(TIME, "GpsTime", ScalarType::F64),
        height,
        plain(ANGLE_8, "ScanAngleRank", ScalarType::I8),
        plain(ANGLE_16, "ScanAngleRank", ScalarType::I16),
        fine,
    ]
}

const NO_HEIGHT: i16 = -9999;

fn scan(id: u32, name: &str, attributes: &[Slot]) -> Scan {
    Scan {
        id,
        name: name.into(),
        source: String::new(),
        source_bytes: 0,
        identity: [0; 32],
        time: 0,
        pose: [0.0; 16],
        read: 0,
        stored: 0,
        rejected: Rejected::default(),
        bounds: None,
        exactness: Exactness::Exact,
        largest_error: 0.0,
        format: "las".into(),
        las: None,
        color_depth: None,
        visible: true,
        attributes: attributes.into(),
        crs: None,
    }
}

fn scans() -> Vec<Scan> {
    vec![
        scan(3, "north", &[CLASS, STAMP, TIME, HEIGHT, ANGLE_8]),
        scan(1, "roof", &[CLASS, TIME, ANGLE_16, FINE_HEIGHT]),
    ]
}

#[derive(Clone, Debug)]
struct Point {
    scan: u32,
    x: u64,
    class: u8,
    stamp: u64,
    time: f64,
    height: i16,
    angle: i8,
}

fn point() -> impl Strategy<Value = Point> {
    let stamps = prop::sample::select(vec![0, 5, (1 << 53) + 1, u64::MAX - 1, u64::MAX]);
    let times = prop::sample::select(vec![f64::NAN, f64::INFINITY, -1.5, 0.0, 0.1, 2.0, 9_007_199_254_740_993.0]);
    let heights = prop_oneof![Just(NO_HEIGHT), -30_i16..60];
    (prop::bool::ANY, 0_u64..9, 0_u8..4, stamps, times, heights, -3_i8..4).prop_map(
        |(north, x, class, stamp, time, height, angle)| {
            let x = x + BIAS as u64;
            // A scan that lacks an attribute has zeros in the column.
            let stamp = if north { stamp } else { 0 };
            Point { scan: if north { 3 } else { 1 }, x, class, stamp, time, height, angle }
        },
    )
}

fn block(points: &[Point]) -> Block {
    let each = |f: &dyn Fn(&Point) -> u64| points.iter().map(f).collect::<Vec<_>>();
    let one = points.iter().all(|p| p.scan == points[0].scan);
    let ids: Vec<u32> = points.iter().map(|p| p.scan).collect();
    Block {
        len: points.len(),
        positions: Arc::new(Positions { x: each(&|p| p.x), y: each(&|_| 0), z: each(&|_| 0) }),
        scans: if one { BlockScans::One(ids[0]) } else { BlockScans::Each(ids) },
        columns: [
            (CLASS, Some(Column::U8(points.iter().map(|p| p.class).collect()))),
            (STAMP, Some(Column::U64(each(&|p| p.stamp)))),
            (TIME, Some(Column::F64(points.iter().map(|p| p.time).collect()))),
            (HEIGHT, Some(Column::I16(points.iter().map(|p| if p.scan == 3 { p.height } else { 0 }).collect()))),
            (ANGLE_8, Some(Column::I8(points.iter().map(|p| if p.scan == 3 { p.angle } else { 0 }).collect()))),
            (
                ANGLE_16,
                Some(Column::I16(points.iter().map(|p| if p.scan == 1 { p.angle.into() } else { 0 }).collect())),
            ),
            (FINE_HEIGHT, Some(Column::I16(points.iter().map(|p| if p.scan == 1 { p.height } else { 0 }).collect()))),
        ]
        .map(|(slot, column)| (slot, column.map(Arc::new)))
        .to_vec(),
    }
}

fn bind_text(text: &str) -> Result<BoundFilter, FilterError> {
    let (attributes, scans, lattice) = (attributes(), scans(), Lattice::uniform(0.25).unwrap());
    let met = Kinds::of_scans(&attributes, scans.iter());
    Filter::parse(text)?.bind(&Names { attributes: &attributes, scans: &scans, lattice: &lattice, met: &met })
}

/// In hundredths.
fn real_height(p: &Point) -> Option<i32> {
    match p.scan {
        3 => (p.height != NO_HEIGHT).then_some(10 * i32::from(p.height) - 200),
        _ => Some(p.height.into()),
    }
}

/// Whole degrees meet steps of 0.006 degrees, and are such.
fn steps(p: &Point) -> i16 {
    if p.scan == 3 { (f64::from(p.angle) / 0.006).round() as i16 } else { p.angle.into() }
}

type Naive = fn(&Point) -> Option<bool>;

/// Simple predicates with what they mean: `None` is unknown.
const PREDICATES: &[(&str, Naive)] = &[
    ("Classification = 2", |p| Some(p.class == 2)),
    ("CLASS <> 2", |p| Some(p.class != 2)),
    ("classification in (0, 3.0, 7)", |p| Some(p.class == 0 || p.class == 3)),
    ("Classification between 0.5 and 2", |p| Some(p.class == 1 || p.class == 2)),
    ("Classification > -1", |_| Some(true)),
    ("256 <= Classification", |_| Some(false)),
    ("stamp = 18446744073709551615", |p| (p.scan == 3).then_some(p.stamp == u64::MAX)),
    ("stamp > 9007199254740992", |p| (p.scan == 3).then_some(p.stamp > 1 << 53)),
    ("stamp < 9007199254740992.5", |p| (p.scan == 3).then_some(p.stamp <= 1 << 53)),
    ("stamp is null", |p| Some(p.scan != 3)),
    ("tree_height = Classification", |p| real_height(p).map(|h| h == 100 * i32::from(p.class))),
    ("Classification <= tree_height", |p| real_height(p).map(|h| 100 * i32::from(p.class) <= h)),
    ("stamp > gps_time", |p| {
        if p.scan != 3 || p.time.is_nan() {
            None
        } else {
            Some(p.time < 1e18 && i128::from(p.stamp) > p.time.floor() as i128)
        }
    }),
    ("gps_time > 0.1", |p| (!p.time.is_nan()).then_some(p.time > 0.1)),
    ("GpsTime != 2", |p| (!p.time.is_nan()).then_some(p.time != 2.0)),
    ("GpsTime is not null", |_| Some(true)),
    ("treeheight = 0.3", |p| real_height(p).map(|h| h == 30)),
    ("tree_height >= 0.35", |p| real_height(p).map(|h| h >= 35)),
    ("tree_height in (0.3, -1.9)", |p| real_height(p).map(|h| h == 30 || h == -190)),
    ("tree_height is null", |p| Some(real_height(p).is_none())),
    ("raw(tree_height) = -9999", |p| Some(p.height == NO_HEIGHT)),
    ("scan_angle > 0", |p| Some(steps(p) > 0)),
    ("ScanAngleRank = -2", |p| Some(steps(p) == -2)),
    ("ScanAngleRank between -167 and 333", |p| Some((-167..=333).contains(&steps(p)))),
    ("raw(ScanAngleRank) = -2", |p| Some(p.angle == -2)),
    ("ScanAngleRank > Classification", |p| Some(steps(p) > p.class.into())),
    ("ScanAngleRank:i16 > 1", |p| (p.scan == 1).then_some(p.angle > 1)),
    ("\"scan_angle:i8\" > 0", |p| (p.scan == 3).then_some(p.angle > 0)),
    ("raw(tree_height:i16) = 3", |p| Some(p.height == 3)),
    ("ScanAngleRank:i8 is null", |p| Some(p.scan == 1)),
    ("scan = 'north'", |p| Some(p.scan == 3)),
    ("scan <> \"north\"", |p| Some(p.scan != 3)),
    ("scan in ('north', 1)", |_| Some(true)),
    ("X < 0.5", |p| Some(p.x < BIAS as u64 + 2)),
    ("x = 1.25", |p| Some(p.x == BIAS as u64 + 5)),
    ("x in (0.3)", |_| Some(false)),
];

#[derive(Clone, Debug)]
enum Tree {
    Leaf(usize),
    Not(Box<Tree>),
    And(Box<Tree>, Box<Tree>),
    Or(Box<Tree>, Box<Tree>),
}

fn tree() -> impl Strategy<Value = Tree> {
    (0..PREDICATES.len()).prop_map(Tree::Leaf).prop_recursive(4, 12, 2, |inner| {
        let two = || (inner.clone(), inner.clone());
        prop_oneof![
            inner.clone().prop_map(|t| Tree::Not(t.into())),
            two().prop_map(|(a, b)| Tree::And(a.into(), b.into())),
            two().prop_map(|(a, b)| Tree::Or(a.into(), b.into())),
        ]
    })
}

fn text(tree: &Tree) -> String {
    match tree {
        Tree::Leaf(i) => PREDICATES[*i].0.into(),
        Tree::Not(a) => format!("not ({})", text(a)),
        Tree::And(a, b) => format!("({}) and ({})", text(a), text(b)),
        Tree::Or(a, b) => format!("({}) || ({})", text(a), text(b)),
    }
}

fn naive(tree: &Tree, p: &Point) -> Option<bool> {
    match tree {
        Tree::Leaf(i) => PREDICATES[*i].1(p),
        Tree::Not(a) => naive(a, p).map(|v| !v),
        Tree::And(a, b) => match (naive(a, p), naive(b, p)) {
            (Some(false), _) | (_, Some(false)) => Some(false),
            (Some(true), Some(true)) => Some(true),
            _ => None,
        },
        Tree::Or(a, b) => match (naive(a, p), naive(b, p)) {
            (Some(true), _) | (_, Some(true)) => Some(true),
            (Some(false), Some(false)) => Some(false),
            _ => None,
        },
    }
}

/// The zone map of these points.
fn ranges(points: &[Point]) -> Vec<(Slot, Range)> {
    let north: Vec<&Point> = points.iter().filter(|p| p.scan == 3).collect();
    let roof: Vec<&Point> = points.iter().filter(|p| p.scan == 1).collect();
    let mut ranges = Vec::new();
    fn span<T: Copy + PartialOrd>(mut values: impl Iterator<Item = T>) -> Option<(T, T)> {
        let first = values.next()?;
        Some(values.fold((first, first), |(a, b), v| (if v < a { v } else { a }, if v > b { v } else { b })))
    }
    let signed = |v: Option<(i64, i64)>| v.map(|(a, b)| Range::Signed(a, b));
    let unsigned = |v: Option<(u64, u64)>| v.map(|(a, b)| Range::Unsigned(a, b));
    let times = span(points.iter().map(|p| p.time).filter(|t| !t.is_nan()));
    let all = [
        (CLASS, unsigned(span(points.iter().map(|p| p.class.into())))),
        (STAMP, unsigned(span(north.iter().map(|p| p.stamp)))),
        (TIME, Some(times.map_or(Range::OnlyNan, |(a, b)| Range::Float(a, b)))),
        (HEIGHT, signed(span(north.iter().map(|p| p.height.into())))),
        (ANGLE_8, signed(span(north.iter().map(|p| p.angle.into())))),
        (ANGLE_16, signed(span(roof.iter().map(|p| p.angle.into())))),
        (FINE_HEIGHT, signed(span(roof.iter().map(|p| p.height.into())))),
    ];
    ranges.extend(all.into_iter().filter_map(|(slot, range)| Some((slot, range?))));
    ranges
}

proptest! {
    #[test]
    fn filters_match_what_three_valued_logic_says(points in prop::collection::vec(point(), 1..90), tree in tree()) {
        let filter = bind_text(&text(&tree)).unwrap();
        let mask = filter.matching(&block(&points));
        for (i, p) in points.iter().enumerate() {
            prop_assert_eq!(mask.contains(i), naive(&tree, p) == Some(true), "{} of {:?}", text(&tree), p);
        }
    }

    #[test]
    fn zone_maps_never_hide_a_match(points in prop::collection::vec(point(), 1..4), tree in tree()) {
        let filter = bind_text(&text(&tree)).unwrap();
        let mut scans: Vec<u32> = points.iter().map(|p| p.scan).collect();
        scans.sort_unstable();
        scans.dedup();
        let corner = |p: &Point| LatticePoint([p.x, 0, 0]);
        let bounds = points.iter().fold(LatticeBox::of(corner(&points[0])), |b, p| b.with(corner(p)));
        let known = Known { ranges: &ranges(&points), scans: &scans, bounds: &bounds };
        if points.iter().any(|p| naive(&tree, p) == Some(true)) {
            prop_assert!(filter.may_match(&known), "{}", text(&tree));
        }
    }
}

#[test]
fn zone_maps_do_exclude() {
    let one = Point { scan: 1, x: BIAS as u64, class: 2, stamp: 0, time: 1.0, height: 0, angle: 0 };
    let bounds = LatticeBox::of(LatticePoint([one.x, 0, 0]));
    let known = Known { ranges: &ranges(&[one]), scans: &[1], bounds: &bounds };
    let may = |text: &str| bind_text(text).unwrap().may_match(&known);
    for never in ["class = 3", "class <> 2", "not class = 2", "stamp > 0", "scan = 'north'", "X > 0", "gps_time > 1"] {
        assert!(!may(never), "{never}");
    }
    assert!(may("class = 2 and gps_time = 1 and scan = 'roof' and X = 0"));
}

#[test]
fn unknown_names_are_pointed_at_with_the_nearest_one() {
    let error = |text: &str| bind_text(text).expect_err(text);
    let wrong = error("GpsTime > 1 and intensity > 2");
    assert_eq!(wrong.at(), 16);
    assert!(error("clasification = 2").message().contains("\"Classification\""));
    let shown = error("Classification = 2 and stmp = 1").to_string();
    assert!(shown.ends_with("  Classification = 2 and stmp = 1\n                         ^"), "{shown}");
    assert!(error("scan = 'nort'").message().contains("\"north\""));
    assert_eq!(error("scan in ('north', 'south')").at(), 18);
    assert!(error("scan > 'north'").message().contains("in"));
    assert!(error("class = 'ground'").message().contains("numbers"));
    assert!(error("scan is null").message().contains("scans"));
}

#[test]
fn coordinates_keep_their_names_and_attributes_called_so_are_quoted() {
    // An extra byte called x took the coordinate's place.
    let (scans, lattice) = (scans(), Lattice::uniform(0.25).unwrap());
    let mut attributes = attributes();
    attributes.push(StoredAttribute { id: 9, attribute: Attribute::new("x", ScalarType::U8) });
    let met = Kinds::default();
    let names = Names { attributes: &attributes, scans: &scans, lattice: &lattice, met: &met };
    let slots = |text: &str| {
        let filter = Filter::parse(text).unwrap().bind(&names).unwrap();
        (filter.slots(), filter.needs_positions())
    };
    assert_eq!(slots("x > 1 or X in (2, 3)"), (vec![], true));
    for attribute in ["\"x\" > 1", "`X` between 1 and 2", "raw(x) = 1", "\"x\" is null", "\"x\" = class"] {
        assert!(slots(attribute).0.contains(&9) && !slots(attribute).1, "{attribute}");
    }
    // In quotes it is the coordinate where no attribute has its name.
    assert_eq!(slots("\"y\" > 1"), (vec![], true));
    let told = |text: &str| {
        let all = bind::ambiguous(&Filter::parse(text).unwrap().expression, &names);
        all.iter().map(|words| words.split(' ').next().unwrap()).collect::<Vec<_>>().join(",")
    };
    assert_eq!(told("not (x > 1 and class = 2) or X < 7"), "X,x");
    assert_eq!(told("\"x\" > 1 and y > 1 and raw(x) = 1"), "");
    let compared = Filter::parse("x > class").unwrap().bind(&names).unwrap_err();
    assert!(compared.message().contains("double quotes") && compared.at() == 0, "{compared}");
    let compared = Filter::parse("class = y").unwrap().bind(&names).unwrap_err();
    assert!(compared.message().contains("coordinate") && !compared.message().contains("quotes"), "{compared}");
}
