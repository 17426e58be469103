//! Bytes and nanoseconds a point, attribute by attribute, on real tiles.
//!
//! `cargo bench --bench codec [-- PART_OF_A_NAME_OR_FILE...]`, with `ESKER_DATA` for another folder than `../shared/data`.
//! Points are put into nodes by the sampling rule and each node is cut into two parts, a quarter of its points (the
//! coarser ones) and the rest, so that chunks are as a store has them. Beside it stands what LAZ makes of the same nodes,
//! each a chunk of its own in the order of time, as COPC writers do. One thread; the fastest of three runs.

#![allow(missing_docs)]

use esker::codec::{BlockSize, Blocks, ColumnChunk, Decoder, Encoder, Passes, PositionChunk};
use esker::lattice::{BIAS, Cube, Key, LOW_DIGITS, LatticePoint, SortKey};
use esker::points::{Attribute, Column, Field, FieldKind, PositionKind, Positions, RecordLayout, ScalarType};
use std::collections::BTreeMap;
use std::hint::black_box;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::time::Instant;

type Error = Box<dyn std::error::Error>;

/// Cells of a node's grid are of `2^G` a side.
const G: u8 = 7;
const LEAF: usize = 32_768;
const RUNS: usize = 3;
/// A run takes at least so many.
const MIN_POINTS: usize = 2_000_000;

const TILES: [&str; 16] = [
    "ign_tiles/las_with_several_extra_byte_bloc.laz",
    "ign_tiles/test_data_77050_627755_LA93_IGN69.laz",
    "ign_tiles/test_data_77050_627760_LA93_IGN69.laz",
    "ign_tiles/test_data_77055_627755_LA93_IGN69.laz",
    "ign_tiles/test_data_77055_627760_LA93_IGN69.laz",
    "ign_tiles/test_data_77060_627755_LA93_IGN69.laz",
    "ign_tiles/test_data_77060_627760_LA93_IGN69.laz",
    "pdal_autzen/autzen_trim_7.las",
    "pdal_copc/lone-star.copc.laz",
    "bcts/bcts_1.laz",
    "bcts/bcts_2.laz",
    "spanner_multiplatform/ALS_Clip.laz",
    "spanner_multiplatform/UAS_Clip.laz",
    "spanner_multiplatform/MLS_Clip.laz",
    "lidr/Topography.laz",
    "loadersgl/ellipsoid.copc.laz",
];

fn main() -> Result<(), Error> {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let root = std::env::var_os("ESKER_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    for file in wanted.iter().filter(|w| Path::new(w).is_file()) {
        measure(file, Path::new(file))?;
    }
    for tile in TILES.iter().filter(|t| wanted.is_empty() || wanted.iter().any(|w| t.contains(w))) {
        let path = root.join(tile);
        if path.exists() {
            measure(tile, &path)?;
        } else {
            println!("{tile}: not there");
        }
    }
    Ok(())
}

/// Seconds that this thread has run, or, where the system does not tell, the time.
fn seconds() -> f64 {
    static START: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    let statistics = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let on_cpu = statistics.split(' ').next().and_then(|ns| ns.parse::<f64>().ok());
    on_cpu.map_or_else(|| START.elapsed().as_secs_f64(), |ns| ns / 1e9)
}

/// Level, key, index in the file.
type Point = (i16, Key, usize);

/// The columns of one part and their keys.
struct Part {
    cube: Cube,
    low: Vec<u64>,
    keys: Vec<Key>,
    columns: Vec<Column>,
}

fn measure(tile: &str, path: &Path) -> Result<(), Error> {
    let mut reader = las::Reader::from_path(path)?;
    let header = reader.header().clone();
    let data = reader.read_all()?;
    let layout = layout(header.point_format());
    let record = data.record_len();
    let mut points: Vec<(Key, usize)> = Vec::new();
    for (i, ((x, y), z)) in data.x_raw().zip(data.y_raw()).zip(data.z_raw()).enumerate() {
        let index = |c: i32| (BIAS + i64::from(c)) as u64;
        points.push((Key::of(LatticePoint([index(x), index(y), index(z)])), i));
    }
    points.sort_unstable();
    let payload = |i: usize| &data.raw_bytes()[i * record + 12..(i + 1) * record];

    let mut nodes = Vec::new();
    let (first, last) = (points[0].0.point(), points[points.len() - 1].0.point());
    let root = points
        .iter()
        .fold(Cube::spanning(first, last, 0), |cube, (key, _)| Cube::spanning(cube.low(), key.point(), cube.k()));
    let mut before: Option<Key> = None;
    let leveled: Vec<Point> = points
        .iter()
        .map(|&(key, i)| {
            let digit = before.map_or(i16::from(root.k()), |b| i16::from(key.differing_digit(b)));
            before = Some(key);
            // The level at which the point is the first of its cell.
            ((i16::from(root.k()) - digit - i16::from(G)).max(0), key, i)
        })
        .collect();
    split(root, 0, leveled, &mut nodes);

    let mut laz_bytes = 0;
    let mut parts = Vec::new();
    for (cube, mut node) in nodes {
        laz_bytes += laz_size(&header, node.iter().map(|p| &data.raw_bytes()[p.2 * record..(p.2 + 1) * record]))?;
        let mut levels: Vec<_> = node.iter().map(|p| p.0).collect();
        levels.sort_unstable();
        let quarter = levels[levels.len() / 4];
        let coarse = node.extract_if(.., |p| levels.len() >= 8192 && p.0 <= quarter).collect::<Vec<_>>();
        for part in [coarse, node].into_iter().filter(|p| !p.is_empty()) {
            let keys: Vec<_> = part.iter().map(|p| p.1).collect();
            let columns = (0..layout.attributes.len())
                .map(|a| {
                    let mut column = Column::with_capacity(layout.attributes[a].ty, part.len());
                    layout.extract(a, part.iter().map(|p| payload(p.2)), &mut column);
                    column
                })
                .collect();
            parts.push(Part { cube, low: keys.iter().map(|k| k.low).collect(), keys, columns });
        }
    }
    report(tile, path, points.len(), &layout.attributes, &parts, laz_bytes)
}

/// The nodes of the canonical tree.
fn split(cube: Cube, level: i16, points: Vec<Point>, nodes: &mut Vec<(Cube, Vec<Point>)>) {
    if points.is_empty() {
        return;
    }
    if points.len() <= LEAF || cube.k() <= G {
        nodes.push((cube, points));
        return;
    }
    let mut children: [Vec<_>; 8] = Default::default();
    let mut own = Vec::new();
    for point in points {
        if point.0 <= level {
            own.push(point);
        } else {
            children[usize::from(cube.octant_of(point.1.point()))].push(point);
        }
    }
    if !own.is_empty() {
        nodes.push((cube, own));
    }
    for (octant, points) in (0..8).zip(children) {
        if let Some(child) = cube.child(octant) {
            split(child, level + 1, points, nodes);
        }
    }
}

/// Bytes of a LAZ chunk of these records, in the order of time where there is one.
fn laz_size<'a>(header: &las::Header, records: impl Iterator<Item = &'a [u8]>) -> Result<usize, Error> {
    let format = *header.point_format();
    let time = if format.is_extended { 22 } else { 20 };
    let mut records: Vec<_> = records.collect();
    if format.has_gps_time {
        records.sort_by_key(|r| u64::from_le_bytes(r[time..time + 8].try_into().unwrap_or_default()));
    }
    let mut builder = las::Builder::from((1, 4));
    builder.point_format = format;
    builder.point_format.is_compressed = true;
    builder.transforms = *header.transforms();
    let size = |records: &[&[u8]]| -> Result<usize, Error> {
        let mut writer = las::Writer::new(Cursor::new(Vec::new()), builder.clone().into_header()?)?;
        let data = las::PointDataBuilder::new()
            .with_format(*writer.header().point_format())
            .with_transforms(*header.transforms());
        writer.write_points(&data.build_from_bytes(records.concat())?)?;
        Ok(writer.into_inner()?.into_inner().len())
    };
    // Without the file's head.
    Ok(size(&records)? - size(&[])?)
}

/// The attributes that one is encoded after, as a store has it.
fn leaders(attributes: &[Attribute], a: usize) -> Vec<usize> {
    let names: &[&str] = match &*attributes[a].name {
        "Green" => &["Red"],
        "Blue" => &["Red", "Green"],
        "NumberOfReturns" => &["ReturnNumber"],
        _ => &[],
    };
    names.iter().filter_map(|name| attributes.iter().position(|a| a.name == *name)).collect()
}

fn follow<'a>(
    attributes: &[Attribute],
    a: usize,
    blocks: Blocks,
    bytes: &'a [u8],
    bytes_of: &dyn Fn(usize) -> &'a [u8],
) -> Result<ColumnChunk<'a>, Error> {
    let chunk = ColumnChunk::parse(bytes, attributes[a].ty, blocks)?;
    let leaders = leaders(attributes, a);
    leaders
        .into_iter()
        .try_fold(chunk, |chunk, l| Ok(chunk.after(follow(attributes, l, blocks, bytes_of(l), bytes_of)?)))
}

fn report(
    tile: &str,
    path: &Path,
    count: usize,
    attributes: &[Attribute],
    parts: &[Part],
    laz_bytes: usize,
) -> Result<(), Error> {
    let per_point = |n: f64| n / count as f64;
    let (mut encoder, mut decoder) = (Encoder::new(), Decoder::new());
    let mut rows: BTreeMap<usize, (Vec<Vec<u8>>, f64, f64)> = BTreeMap::new();
    let times = attributes.iter().position(|a| a.name == "GpsTime");
    let mut passes = Vec::new();
    for part in parts {
        passes.push(match times {
            Some(a) => encoder.times(&part.columns[a], part.cube, &part.keys, &mut Vec::new())?,
            None => Passes::default(),
        });
    }
    // Those that others follow come before them.
    let mut order: Vec<usize> = (0..=attributes.len()).collect();
    order.sort_by_key(|column| column.checked_sub(1).map_or(0, |a| leaders(attributes, a).len()));
    for column in order {
        let (mut chunks, mut encode, mut decode) = (Vec::new(), f64::MAX, f64::MAX);
        // The system counts in steps of some milliseconds.
        let repeats = (MIN_POINTS / count).max(1);
        for _ in 0..RUNS {
            let mut chunk = Vec::new();
            let start = seconds();
            for i in (0..repeats).flat_map(|_| 0..parts.len()) {
                let part = &parts[i];
                chunk.clear();
                let known = &passes[i];
                match column.checked_sub(1) {
                    None if part.cube.k() <= LOW_DIGITS => {
                        encoder.positions_with(part.cube, &part.low, known, &mut chunk)?;
                    }
                    None => encoder.positions_with(part.cube, &part.keys, known, &mut chunk)?,
                    Some(a) if attributes[a].name == "GpsTime" => {
                        encoder.times(&part.columns[a], part.cube, &part.keys, &mut chunk)?;
                    }
                    Some(a) => {
                        let leaders: Vec<_> = leaders(attributes, a).iter().map(|l| &part.columns[*l]).collect();
                        encoder.column_after(&part.columns[a], known, &leaders, &mut chunk)?;
                    }
                }
                if chunks.len() < parts.len() {
                    chunks.push(chunk.clone());
                }
            }
            encode = encode.min((seconds() - start) / repeats as f64);
            let start = seconds();
            // One buffer for all, as a query has it.
            let mut positions = Positions::default();
            let mut values = column.checked_sub(1).map(|a| Column::zeros(attributes[a].ty, 0));
            for i in (0..repeats).flat_map(|_| 0..parts.len()) {
                let (part, chunk) = (&parts[i], &chunks[i]);
                let blocks = Blocks::new(part.keys.len(), BlockSize::LARGEST);
                if let (Some(values), Some(a)) = (&mut values, column.checked_sub(1)) {
                    values.resize(0);
                    let positions = &rows.get(&0).ok_or("positions come first")?.0[i];
                    let positions = PositionChunk::parse(positions, part.cube, blocks)?;
                    // Those that it follows are decoded too, as by a reader who wants this one alone.
                    let bytes = |l: usize| rows.get(&(l + 1)).map_or(&chunk[..], |row| &row.0[i]);
                    follow(attributes, a, blocks, chunk, &bytes)?.at(&positions).decode(&mut decoder, values)?;
                } else {
                    [&mut positions.x, &mut positions.y, &mut positions.z].into_iter().for_each(Vec::clear);
                    PositionChunk::parse(chunk, part.cube, blocks)?.decode(&mut decoder, &mut positions)?;
                }
                black_box((&positions, &values));
            }
            decode = decode.min((seconds() - start) / repeats as f64);
        }
        rows.insert(column, (chunks, encode, decode));
    }
    let file = path.metadata()?.len() as f64;
    println!("\n{tile}: {count} points, {} parts; file {:.3} B/point", parts.len(), per_point(file));
    println!("{:28} {:>9} {:>12} {:>12}", "", "B/point", "encode ns", "decode ns");
    let (mut bytes, mut encode, mut decode) = (0.0, 0.0, 0.0);
    let mut rgb = 0.0;
    for (column, (chunks, e, d)) in &rows {
        let size: f64 = chunks.iter().map(|c| c.len() as f64).sum();
        let name = column.checked_sub(1).map_or("positions", |a| &attributes[a].name);
        (bytes, encode, decode) = (bytes + size, encode + e, decode + d);
        if ["positions", "Red", "Green", "Blue"].contains(&name) {
            rgb += d;
        }
        let [size, e, d] = [size, e * 1e9, d * 1e9].map(per_point);
        if size > 0.005 || e > 1.0 {
            println!("{name:28} {size:9.3} {e:12.1} {d:12.1}");
        }
    }
    let [bytes, encode, decode, rgb] = [bytes, encode * 1e9, decode * 1e9, rgb * 1e9].map(per_point);
    println!("{:28} {bytes:9.3} {encode:12.1} {decode:12.1}   positions and RGB {rgb:.1} ns", "all");
    let laz = per_point(laz_bytes as f64);
    println!("{:28} {laz:9.3}   of that {:.3}", "LAZ of the same nodes", bytes / laz);
    Ok(())
}

/// The attributes of a LAS record behind its coordinates.
fn layout(format: &las::point::Format) -> RecordLayout {
    let mut fields = Vec::new();
    let mut add = |name: &str, ty, offset: usize, kind| {
        fields.push((Attribute::new(name, ty), Field { offset: offset - 12, kind }));
    };
    let bits = |shift, mask| FieldKind::Bits { shift, mask };
    use FieldKind::Whole;
    use ScalarType::{F64, I8, I16, U8, U16};
    add("Intensity", U16, 12, Whole);
    let mut end;
    if format.is_extended {
        add("ReturnNumber", U8, 14, bits(0, 15));
        add("NumberOfReturns", U8, 14, bits(4, 15));
        for (shift, name) in ["Synthetic", "KeyPoint", "Withheld", "Overlap"].iter().enumerate() {
            add(name, U8, 15, bits(shift as u8, 1));
        }
        add("ScanChannel", U8, 15, bits(4, 3));
        add("ScanDirectionFlag", U8, 15, bits(6, 1));
        add("EdgeOfFlightLine", U8, 15, bits(7, 1));
        add("Classification", U8, 16, Whole);
        add("UserData", U8, 17, Whole);
        add("ScanAngleRank", I16, 18, Whole);
        add("PointSourceId", U16, 20, Whole);
        add("GpsTime", F64, 22, Whole);
        end = 30;
    } else {
        add("ReturnNumber", U8, 14, bits(0, 7));
        add("NumberOfReturns", U8, 14, bits(3, 7));
        add("ScanDirectionFlag", U8, 14, bits(6, 1));
        add("EdgeOfFlightLine", U8, 14, bits(7, 1));
        add("Classification", U8, 15, bits(0, 31));
        for (shift, name) in ["Synthetic", "KeyPoint", "Withheld"].iter().enumerate() {
            add(name, U8, 15, bits(shift as u8 + 5, 1));
        }
        add("ScanAngleRank", I8, 16, Whole);
        add("UserData", U8, 17, Whole);
        add("PointSourceId", U16, 18, Whole);
        end = 20;
        if format.has_gps_time {
            add("GpsTime", F64, end, Whole);
            end += 8;
        }
    }
    if format.has_color {
        for name in ["Red", "Green", "Blue"] {
            add(name, U16, end, Whole);
            end += 2;
        }
    }
    if format.has_nir {
        add("Infrared", U16, end, Whole);
        end += 2;
    }
    for i in 0..usize::from(format.extra_bytes) {
        add(&format!("extra {i:2}"), U8, end + i, Whole);
    }
    let end = end + usize::from(format.extra_bytes);
    RecordLayout::new(PositionKind::Grid, end - 12, fields)
}
