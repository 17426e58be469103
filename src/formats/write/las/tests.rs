//! Files read back by another program's reader (the `las` crate) and by our own.

use crate::formats::file::SourceFile;
use crate::formats::las::LasSource;
use crate::formats::las::layout::record_layout;
use crate::formats::las::tables::PointFormat;
use crate::formats::write::{CreateOptions, CreationDate, LasTarget, OutputFormat, OutputPlan, create};
use crate::formats::{FormatError, PointSource};
use crate::lattice::{Lattice, LatticePoint, SourceGrid, SourceMap};
use crate::points::{Attribute, Batch, Column, Crs, LasFacts, Positions, RawVlr, RecordLayout, ScalarType, Scaling};
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

fn vlr(extended: bool, user_id: &str, record_id: u16, data: Vec<u8>) -> RawVlr {
    RawVlr { extended, ..super::header::vlr(user_id, record_id, "about it", data) }
}

/// A descriptor of an extra byte of data type `code`.
fn descriptor(code: u8, options: u8, name: &str) -> [u8; 192] {
    let mut raw = [0; 192];
    (raw[2], raw[3]) = (code, options);
    raw[4..4 + name.len()].copy_from_slice(name.as_bytes());
    raw
}

/// A file of this version and format with three described extra bytes, one of them an array, and three bytes that nothing describes.
fn facts(version: (u8, u8), point_format: u8) -> LasFacts {
    let extra = [descriptor(4, 0, "height"), descriptor(21, 0, "triple"), descriptor(9, 0, "Intensity")].concat();
    let mut vlrs = vec![vlr(false, "mine", 7, vec![1, 2, 3]), vlr(false, "LASF_Spec", 4, extra)];
    vlrs.push(vlr(false, "laszip encoded", 22_204, vec![9; 40]));
    vlrs.push(vlr(false, "copc", 1, vec![9; 160]));
    if version.1 >= 4 {
        vlrs.push(vlr(true, "copc", 1000, vec![9; 32]));
        vlrs.push(vlr(true, "also mine", 8, vec![4; 70_000]));
        vlrs.push(vlr(true, "LASF_Spec", 65_535, vec![0; 100]));
    }
    LasFacts {
        version,
        point_format,
        scale: [0.01, 0.01, 0.02],
        offset: [500_000.0, 5_000_000.0, -10.0],
        global_encoding: 1 | 2 | if version.1 >= 4 { 16 } else { 0 },
        file_source_id: 77,
        guid: *b"0123456789abcdef",
        system_identifier: super::header::padded("a scanner"),
        generating_software: super::header::padded("someone else"),
        vlrs,
        undescribed_bytes: 3,
    }
}

/// Records as a batch, by the layout that readers use.
fn batch_of(records: &[u8], layout: &RecordLayout, map: &SourceMap) -> Batch {
    let rows = || records.chunks_exact(layout.stride());
    let axis = |row: &[u8], axis: usize| {
        let x = i32::from_le_bytes(row[4 * axis..4 * axis + 4].try_into().unwrap());
        map.to_lattice(axis, x).unwrap()
    };
    let mut batch = Batch::empty(layout.attributes.clone());
    batch.positions = rows().map(|r| LatticePoint([axis(r, 0), axis(r, 1), axis(r, 2)])).collect::<Positions>();
    for (i, column) in batch.columns.iter_mut().enumerate() {
        layout.extract(i, rows().map(|r| &r[12..]), column);
    }
    batch
}

fn write(path: &Path, plan: &OutputPlan, batches: &[Batch]) -> Result<Vec<String>, FormatError> {
    let format = OutputFormat::of_extension(path.extension().unwrap().to_str().unwrap()).unwrap();
    let date = Some(CreationDate { day_of_year: 42, year: 2025 });
    let options = CreateOptions { creation_date: date, ..CreateOptions::default() };
    let mut writer = create(path, format, plan, &options)?;
    for batch in batches {
        writer.write(batch)?;
    }
    writer.finish()
}

/// Whole records, as the `las` crate reads them.
fn records_of(path: &Path) -> (las::Header, Vec<u8>) {
    let mut reader = las::Reader::from_path(path).unwrap();
    let records = reader.read_all().unwrap().raw_bytes().to_vec();
    (reader.header().clone(), records)
}

/// Records as our own reader gives them.
fn own_records_of(path: &Path) -> (LasSource, Vec<u8>) {
    let source = LasSource::open(SourceFile::open(path).unwrap()).unwrap();
    let mut records = Vec::new();
    for piece in source.pieces(1000) {
        let mut sink = |rows: &[u8]| {
            records.extend_from_slice(rows);
            true
        };
        source.read(piece, &mut sink).unwrap();
    }
    (source, records)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn records_come_back_byte_for_byte_in_every_format(
        seed in any::<u64>(),
        points in prop_oneof![Just(0_usize), Just(1), 2_usize..2000],
        format in 0_u8..=10,
        laz in any::<bool>(),
        newest in any::<bool>(),
    ) {
        let version = match format {
            0 | 1 => (1, if newest { 4 } else { 0 }),
            2 | 3 => (1, if newest { 4 } else { 2 }),
            4 | 5 => (1, if newest { 4 } else { 3 }),
            _ => (1, 4),
        };
        let facts = facts(version, format);
        let layout = record_layout(&facts).unwrap();
        prop_assert_eq!(layout.stride(), PointFormat::new(format).unwrap().record_bytes() + 2 + 3 + 4 + 3);
        let mut state = seed | 1;
        let records: Vec<u8> = (0..points * layout.stride())
            .map(|_| {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                (state >> 32) as u8
            })
            .collect();
        let lattice = Lattice::uniform(0.01).unwrap();
        let map = SourceMap::new(&SourceGrid::from_f64(facts.scale, facts.offset).unwrap(), &lattice).unwrap();
        let batch = batch_of(&records, &layout, &map);
        let plan = OutputPlan {
            lattice,
            attributes: layout.attributes.clone(),
            crs: None,
            las: LasTarget::AsSource(facts.clone()),
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(if laz { "a.laz" } else { "a.las" });
        let half: Vec<u32> = (0..points as u32 / 2).collect();
        let rest: Vec<u32> = (points as u32 / 2..points as u32).collect();
        let notes = write(&path, &plan, &[batch.gathered(&half), batch.gathered(&rest)]).unwrap();
        prop_assert!(notes.iter().any(|n| n.contains("waveform")), "{:?}", notes);

        let (header, read) = records_of(&path);
        prop_assert!(read == records);
        prop_assert_eq!(header.number_of_points(), points as u64);
        let mask = if format < 6 { 7 } else { 15 };
        // For formats 0 to 5 the crate looks at the five legacy counts only.
        for number in 1..=if format < 6 { 5 } else { 15 } {
            let expected = records.chunks(layout.stride()).filter(|r| r[14] & mask == number).count() as u64;
            prop_assert_eq!(header.number_of_points_by_return(number).unwrap_or(0), expected);
        }
        if points > 0 {
            let bounds = header.bounds();
            let xs = || records.chunks(layout.stride()).map(|r| i32::from_le_bytes(r[..4].try_into().unwrap()));
            prop_assert_eq!(bounds.min.x, 0.01 * f64::from(xs().min().unwrap()) + 500_000.0);
            prop_assert_eq!(bounds.max.x, 0.01 * f64::from(xs().max().unwrap()) + 500_000.0);
        }
        prop_assert_eq!(header.file_source_id(), 77);
        let guid = header.guid();
        prop_assert_eq!(guid.as_bytes(), b"0123456789abcdef");
        prop_assert_eq!(header.system_identifier(), "a scanner");
        prop_assert_eq!(header.generating_software(), concat!("esker ", env!("CARGO_PKG_VERSION")));
        let kept: Vec<_> = header.all_vlrs().map(|v| v.user_id.clone()).filter(|u| u != "laszip encoded").collect();
        let expected: &[&str] =
            if version.1 >= 4 { &["mine", "LASF_Spec", "also mine"] } else { &["mine", "LASF_Spec"] };
        prop_assert_eq!(kept, expected);

        let (source, own) = own_records_of(&path);
        prop_assert!(own == records);
        let again = source.info().las.clone().unwrap();
        prop_assert_eq!(again.version, version);
        prop_assert_eq!(again.global_encoding, facts.global_encoding & !2);
        prop_assert_eq!(&source.info().layout, &layout);
    }
}

fn merged(attributes: Vec<Attribute>) -> OutputPlan {
    OutputPlan {
        lattice: Lattice::uniform(0.001).unwrap(),
        attributes: attributes.into(),
        crs: Some(Crs { wkt: Some("PROJCS[\"x\"]".into()), ..Crs::default() }),
        las: LasTarget::Merged { scale: [0.001; 3], offset: [500_000.0, 5_000_000.0, 0.0] },
    }
}

#[test]
fn files_without_a_crs_say_that_it_would_be_wkt() {
    // PDAL refuses files of formats 6 to 10 that don't.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.las");
    let plan = OutputPlan { crs: None, ..merged(vec![]) };
    write(&path, &plan, &[batch(&plan, &WORLDS, vec![])]).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!((bytes[104], u16::from_le_bytes([bytes[6], bytes[7]]) & 16), (6, 16));
    // Keys are no WKT.
    let keys = OutputPlan { crs: Some(Crs { horizontal_epsg: Some(25_832), ..Crs::default() }), ..merged(vec![]) };
    let path = folder.path().join("b.las");
    write(&path, &keys, &[batch(&keys, &WORLDS, vec![])]).unwrap();
    assert_eq!(std::fs::read(&path).unwrap()[6] & 16, 0);
}

fn batch(plan: &OutputPlan, worlds: &[[f64; 3]], columns: Vec<Column>) -> Batch {
    let positions = worlds.iter().map(|w| plan.lattice.lattice_from_world(*w).unwrap()).collect();
    Batch { attributes: Arc::clone(&plan.attributes), positions, scans: Vec::new(), columns }
}

const WORLDS: [[f64; 3]; 2] = [[500_001.234, 4_999_999.001, -3.5], [500_000.0, 5_000_000.001, 8.0]];

#[test]
fn merged_files_hold_every_attribute_in_the_smallest_format() {
    let mut height = Attribute::new("height", ScalarType::I16);
    height.scaling = Some(Scaling { scale: 0.5, offset: 10.0 });
    height.no_data = Some([255; 8]);
    height.description = "above the ground".into();
    let plan = merged(vec![
        Attribute::new("Intensity", ScalarType::F32),
        Attribute::new("Intensity", ScalarType::U16),
        Attribute::new("ReturnNumber", ScalarType::U8),
        Attribute::new("ScanAngleRank", ScalarType::I8),
        Attribute::new("ScanAngleRank", ScalarType::I16),
        height.clone(),
        Attribute::new("height", ScalarType::F64),
        Attribute::new("pair[0]", ScalarType::U8),
        Attribute::new("Red", ScalarType::U16),
        Attribute::new("Red", ScalarType::U8),
    ]);
    let columns = || {
        vec![
            Column::F32(vec![0.25, f32::NAN]),
            Column::U16(vec![9, 10]),
            Column::U8(vec![1, 12]),
            Column::I8(vec![-9, 0]),
            Column::I16(vec![0, 333]),
            Column::I16(vec![-1, 5]),
            Column::F64(vec![1e300, -0.0]),
            Column::U8(vec![255, 3]),
            Column::U16(vec![0, 65_000]),
            Column::U8(vec![200, 0]),
        ]
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.laz");
    let notes = write(&path, &plan, &[batch(&plan, &WORLDS, columns())]).unwrap();
    for word in ["0.006", "times 257", "height.2"] {
        assert!(notes.iter().any(|n| n.contains(word)), "{word}: {notes:?}");
    }
    let mut reader = las::Reader::from_path(&path).unwrap();
    assert!(reader.header().has_wkt_crs());
    assert_eq!(reader.header().version(), las::Version::new(1, 4));
    assert_eq!(reader.header().point_format().to_u8().unwrap(), 7);
    let points: Vec<_> = reader.read_all().unwrap().points().map(Result::unwrap).collect();
    assert_eq!((points[0].intensity, points[1].return_number), (9, 12));
    assert_eq!(points[0].color.unwrap().red, 200 * 257);
    assert_eq!(points[1].color.unwrap().red, 65_000);
    assert!((points[0].scan_angle + 9.0).abs() < 1e-6 && (points[1].scan_angle - 1.998).abs() < 1e-3);
    assert!((points[0].x - 500_001.234).abs() < 1e-6 && (points[0].z + 3.5).abs() < 1e-6);

    let (source, records) = own_records_of(&path);
    let layout = &source.info().layout;
    let names: Vec<_> = layout.attributes.iter().map(|a| (a.name.as_str(), a.ty)).collect();
    for extra in [("extra.Intensity", ScalarType::F32), ("height.2", ScalarType::F64), ("pair[0]", ScalarType::U8)] {
        assert!(names.contains(&extra), "{extra:?}: {names:?}");
    }
    let at = layout.attributes.iter().position(|a| a.name == "height").unwrap();
    assert_eq!(layout.attributes[at], height);
    let mut column = Column::with_capacity(ScalarType::I16, 2);
    layout.extract(at, records.chunks(layout.stride()).map(|r| &r[12..]), &mut column);
    assert_eq!(column, Column::I16(vec![-1, 5]));
}

#[test]
fn formats_6_and_8_are_chosen_where_they_do() {
    let folder = tempfile::tempdir().unwrap();
    for (name, format) in [("Classification", 6), ("Green", 7), ("Infrared", 8)] {
        let ty = if format == 6 { ScalarType::U8 } else { ScalarType::U16 };
        let plan = merged(vec![Attribute::new(name, ty)]);
        let path = folder.path().join(format!("{format}.las"));
        write(&path, &plan, &[batch(&plan, &WORLDS, vec![Column::zeros(ty, 2)])]).unwrap();
        let (header, records) = records_of(&path);
        assert_eq!(header.point_format().to_u8().unwrap(), format);
        assert_eq!(records.len(), 2 * PointFormat::new(format).unwrap().record_bytes());
    }
}

#[test]
fn a_point_without_returns_is_the_only_one_of_its_pulse() {
    let folder = tempfile::tempdir().unwrap();
    let returns = |plan: OutputPlan, column: Column, ending: &str| {
        let path = folder.path().join(format!("{}.{ending}", plan.attributes[0].name));
        write(&path, &plan, &[batch(&plan, &WORLDS, vec![column])]).unwrap();
        let mut reader = las::Reader::from_path(&path).unwrap();
        let first = reader.header().number_of_points_by_return(1);
        let points = reader.read_all().unwrap().points().map(Result::unwrap).collect::<Vec<_>>();
        std::fs::remove_file(path).unwrap();
        (
            first,
            points.iter().map(|p| (p.return_number, p.number_of_returns, p.is_edge_of_flight_line)).collect::<Vec<_>>(),
        )
    };
    let edge = || (vec![Attribute::new("EdgeOfFlightLine", ScalarType::U8)], Column::U8(vec![1, 0]));
    for ending in ["las", "laz"] {
        let (attributes, column) = edge();
        let told = returns(merged(attributes), column, ending);
        assert_eq!(told, (Some(2), vec![(1, 1, true), (1, 1, false)]));
        let (attributes, column) = edge();
        let old = OutputPlan { las: LasTarget::AsSource(facts((1, 2), 1)), ..merged(attributes) };
        assert_eq!(returns(old, column, ending), (Some(2), vec![(1, 1, true), (1, 1, false)]));
        // What is told stays as it is.
        let plan = merged(vec![Attribute::new("NumberOfReturns", ScalarType::U8)]);
        let told = returns(plan, Column::U8(vec![2, 0]), ending);
        assert_eq!((told.0.unwrap_or(0), &told.1[..]), (0, &[(0, 2, false), (0, 0, false)][..]));
    }
}

#[test]
fn what_does_not_fit_is_an_error_and_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.las");
    let plan = merged(vec![Attribute::new("ReturnNumber", ScalarType::U8)]);
    let far = [[500_000.0 + 2_147_483.648, 5_000_000.0, 0.0]];
    let error = write(&path, &plan, &[batch(&plan, &far, vec![Column::U8(vec![1])])]).unwrap_err().to_string();
    assert!(error.contains("--scale") && error.contains("--split-by scan"), "{error}");
    let error = write(&path, &plan, &[batch(&plan, &WORLDS, vec![Column::U8(vec![1, 200])])]).unwrap_err().to_string();
    assert!(error.contains("ReturnNumber 200"), "{error}");
    let error = write(&path, &plan, &[batch(&plan, &WORLDS, vec![Column::I8(vec![1, 2])])]).unwrap_err().to_string();
    assert!(error.contains("other columns"), "{error}");
    let many = CreateOptions { points: Some(1 << 33), ..CreateOptions::default() };
    let old = OutputPlan { las: LasTarget::AsSource(facts((1, 2), 1)), ..plan };
    let error = create(&path, OutputFormat::Las, &old, &many).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("at most 4294967295 points"), "{error}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn headers_of_las_1_5_hold_the_range_of_times() {
    let facts = facts((1, 5), 6);
    let layout = record_layout(&facts).unwrap();
    let plan = OutputPlan {
        lattice: Lattice::uniform(0.01).unwrap(),
        attributes: vec![Attribute::new("GpsTime", ScalarType::F64)].into(),
        crs: None,
        las: LasTarget::AsSource(facts),
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.las");
    let times = Column::F64(vec![7.5, -2.0]);
    write(&path, &plan, &[batch(&plan, &[[0.0; 3]; 2], vec![times])]).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let float = |at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    assert_eq!((&bytes[24..26], u16::from_le_bytes([bytes[94], bytes[95]])), (&[1, 5][..], 393));
    assert_eq!((float(375), float(383)), (7.5, -2.0));
    assert_eq!(own_records_of(&path).1.len(), 2 * layout.stride());
}

/// LAS and LAZ files in the folder of real data.
fn real_files() -> Vec<PathBuf> {
    let root = std::env::var("ESKER_DATA").unwrap_or_else(|_| "../shared/data".into());
    let mut folders = vec![PathBuf::from(root)];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("las") || e.eq_ignore_ascii_case("laz")) {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

#[test]
fn real_files_come_back_record_for_record() {
    let folder = tempfile::tempdir().unwrap();
    let files = real_files();
    let mut compared = 0;
    for path in &files {
        let Ok(source) = SourceFile::open(path).and_then(LasSource::open) else { continue };
        // Others take longer than a test should.
        if source.info().records > 200_000 {
            continue;
        }
        let mut records = Vec::new();
        let whole = source.pieces(50_000).into_iter().all(|piece| {
            let mut sink = |rows: &[u8]| {
                records.extend_from_slice(rows);
                true
            };
            source.read(piece, &mut sink).is_ok()
        });
        let (Some(grid), Some(facts)) = (source.info().grid, source.info().las.clone()) else { continue };
        let Ok(lattice) = Lattice::new(grid.scale, [crate::lattice::Decimal::ZERO; 3]) else { continue };
        let Some(map) = SourceMap::new(&grid, &lattice) else { continue };
        if !whole {
            continue;
        }
        let batch = batch_of(&records, &source.info().layout, &map);
        let plan = OutputPlan {
            lattice,
            attributes: source.info().layout.attributes.clone(),
            crs: source.info().crs.clone(),
            las: LasTarget::AsSource(facts),
        };
        for name in ["a.las", "a.laz"] {
            let out = folder.path().join(name);
            write(&out, &plan, std::slice::from_ref(&batch)).unwrap();
            let (again, own) = own_records_of(&out);
            assert!(own == records, "{}", path.display());
            assert_eq!(again.info().layout, source.info().layout, "{}", path.display());
            std::fs::remove_file(&out).unwrap();
        }
        compared += 1;
    }
    println!("{compared} of {} real files compared", files.len());
    assert!(2 * compared >= files.len());
}
