//! E57 files made in memory: every type of column, poses, states, damage.

use crate::formats::{FormatError, PointSource, ReadOptions, open_all};
use crate::points::Column;
use e57::{E57Writer, Quaternion, Record, RecordDataType, RecordName, RecordValue, Transform, Translation};
use std::path::Path;

type Rows = Vec<Vec<RecordValue>>;

fn record(name: RecordName, data_type: RecordDataType) -> Record {
    Record { name, data_type }
}

fn unknown(namespace: &str, name: &str) -> RecordName {
    RecordName::Unknown { namespace: namespace.into(), name: name.into() }
}

/// Writes a file of these scans: name, pose, columns, points.
fn write(path: &Path, scans: Vec<(&str, Option<Transform>, Vec<Record>, Rows)>) {
    let mut writer = E57Writer::from_file(path, "file").unwrap();
    for namespace in ["nor", "las", "own"] {
        writer.register_extension(e57::Extension::new(namespace, &format!("http://{namespace}"))).unwrap();
    }
    for (name, pose, prototype, rows) in scans {
        let mut scan = writer.add_pointcloud(name, prototype).unwrap();
        scan.set_name(Some(name.to_owned()));
        if let Some(pose) = pose {
            scan.set_transform(Some(pose));
        }
        rows.into_iter().for_each(|row| scan.add_point(row).unwrap());
        scan.finalize().unwrap();
    }
    writer.finalize().unwrap();
}

/// A page with its checksum made right again, so that damage inside is not found by it.
fn seal(file: &mut [u8]) {
    for page in file.chunks_exact_mut(1024) {
        let sum = crc32c(&page[..1020]);
        page[1020..].copy_from_slice(&sum.to_be_bytes());
    }
}

/// CRC-32C, bit by bit.
fn crc32c(bytes: &[u8]) -> u32 {
    let step = |crc: u32| if crc & 1 == 1 { crc >> 1 ^ 0x82f6_3b78 } else { crc >> 1 };
    !bytes.iter().fold(!0_u32, |crc, &b| (0..8).fold(crc ^ u32::from(b), |crc, _| step(crc)))
}

/// Files of 20 points: of floats with a pose, of integers, of spherical coordinates.
pub fn samples() -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    let pose = Transform {
        rotation: Quaternion { w: 1.0, x: 0.0, y: 0.0, z: 1.0 },
        translation: Translation { x: 1.0, y: 2.0, z: 3.0 },
    };
    let mut floats = xyz();
    floats.push(record(RecordName::Intensity, RecordDataType::F32));
    let float_rows = (0..20).map(|i| {
        let mut row = at(f64::from(i), 1.0, 2.0);
        row.push(RecordValue::Single(i as f32));
        row
    });
    let names =
        [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ, RecordName::CartesianInvalidState];
    let scaled = RecordDataType::ScaledInteger { min: -7, max: 90, scale: 0.01, offset: 5.0 };
    let mut integers: Vec<_> = names.map(|n| record(n, scaled.clone())).to_vec();
    integers[3].data_type = RecordDataType::Integer { min: 0, max: 2 };
    let integer_rows = (0..20).map(|i| {
        let mut row = [i, 2 * i, 3].map(RecordValue::ScaledInteger).to_vec();
        row.push(RecordValue::Integer(i % 3));
        row
    });
    let spherical = vec![Record::SPHERICAL_RANGE_F32, Record::SPHERICAL_AZIMUTH_F32, Record::SPHERICAL_ELEVATION_F32];
    let angles = (0..20).map(|i| [1.0, i as f32, 0.1].map(RecordValue::Single).to_vec());
    let scans = [
        (floats, Some(pose), float_rows.collect()),
        (integers, None, integer_rows.collect()),
        (spherical, None, angles.collect()),
    ];
    let file = |(prototype, pose, rows): (Vec<Record>, Option<Transform>, Rows)| {
        write(&path, vec![("s", pose, prototype, rows)]);
        std::fs::read(&path).unwrap()
    };
    scans.map(file).to_vec()
}

#[test]
fn checksums_are_those_of_the_format() {
    let mut file = samples().remove(0);
    let before = file.clone();
    seal(&mut file);
    assert!(file == before);
}

/// Without the checksums, which find nearly all damage, what is behind them has to stand it.
#[test]
fn sealed_damage_gives_points_or_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    let mut state = 7_u64;
    let mut random = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % n
    };
    let samples = samples();
    for case in 0..600 {
        let mut file = samples[case % samples.len()].clone();
        for _ in 0..1 + case % 4 {
            let at = random(file.len());
            file[at] = [0, 1, 255, b'9', b' ', b'<', file[at] ^ 1 << (case % 8)][random(7)];
        }
        seal(&mut file);
        std::fs::write(&path, &file).unwrap();
        match sources(&path) {
            Ok(all) => all.iter().for_each(|s| drop(records(&**s))),
            Err(error) => assert!(error.to_string().contains("a.e57: "), "{error}"),
        }
    }
}

fn sources(path: &Path) -> Result<Vec<Box<dyn PointSource>>, FormatError> {
    open_all(path, &ReadOptions::default())
}

fn records(source: &dyn PointSource) -> Result<Vec<u8>, FormatError> {
    let mut all = Vec::new();
    for piece in source.pieces(7) {
        let mut sink = |run: &[u8]| {
            all.extend_from_slice(run);
            true
        };
        let tally = source.read(piece, &mut sink)?;
        assert_eq!(tally.read + tally.truncated, piece.records);
    }
    Ok(all)
}

fn positions(source: &dyn PointSource) -> Vec<[f64; 3]> {
    let all = records(source).unwrap();
    let world = |r: &[u8]| std::array::from_fn(|i| f64::from_le_bytes(r[8 * i..8 * i + 8].try_into().unwrap()));
    all.chunks_exact(source.info().layout.stride()).map(world).collect()
}

fn column(source: &dyn PointSource, name: &str) -> Column {
    let layout = &source.info().layout;
    let i = layout.attributes.iter().position(|a| a.name == name).unwrap_or_else(|| panic!("no {name}"));
    let mut column = Column::with_capacity(layout.attributes[i].ty, 0);
    layout.extract(i, records(source).unwrap().chunks_exact(layout.stride()).map(|r| &r[24..]), &mut column);
    column
}

fn xyz() -> Vec<Record> {
    vec![Record::CARTESIAN_X_F64, Record::CARTESIAN_Y_F64, Record::CARTESIAN_Z_F64]
}

fn at(x: f64, y: f64, z: f64) -> Vec<RecordValue> {
    [x, y, z].map(RecordValue::Double).to_vec()
}

#[test]
fn every_kind_of_column_keeps_its_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    let integer = |min, max| RecordDataType::Integer { min, max };
    let scaled = |scale, offset| RecordDataType::ScaledInteger { min: -100, max: 100, scale, offset };
    let mut prototype = xyz();
    let more = [
        (RecordName::Intensity, RecordDataType::F32),
        (RecordName::ColorRed, RecordDataType::U8),
        (RecordName::ColorGreen, RecordDataType::U8),
        (RecordName::ColorBlue, RecordDataType::U8),
        (RecordName::IsColorInvalid, integer(0, 1)),
        (RecordName::IsIntensityInvalid, integer(0, 1)),
        (RecordName::RowIndex, integer(0, 1000)),
        (RecordName::ColumnIndex, integer(-5, 70_000)),
        (RecordName::ReturnIndex, integer(0, 4)),
        (RecordName::ReturnCount, integer(0, 5)),
        (RecordName::TimeStamp, RecordDataType::F64),
        (unknown("nor", "normalX"), RecordDataType::F32),
        (unknown("las", "pointSourceId"), integer(0, 65535)),
        (unknown("own", "heat"), scaled(0.5, 20.0)),
        (unknown("own", "plain"), scaled(1.0, 0.0)),
    ];
    prototype.extend(more.map(|(name, ty)| record(name, ty)));
    let rows: Rows = (0..500_i64)
        .map(|i| {
            use RecordValue::{Double, Integer, ScaledInteger, Single};
            let mut row = at(i as f64, -0.5 * i as f64, 3.0);
            row.extend([Single(i as f32 / 8.0), Integer(i % 256), Integer(7), Integer(255 - i % 256), Integer(i % 2)]);
            row.extend([
                Integer(0),
                Integer(2 * i),
                Integer(i - 5),
                Integer(i % 5),
                Integer(5),
                Double(i as f64 * 0.1),
            ]);
            row.extend([Single(-1.0), Integer(60_000 + i), ScaledInteger(i % 100 - 50), ScaledInteger(-(i % 100))]);
            row
        })
        .collect();
    write(&path, vec![("one", None, prototype, rows)]);
    let all = sources(&path).unwrap();
    let source = &*all[0];
    let info = source.info();
    assert_eq!((all.len(), info.records, info.missing, info.index), (1, 500, 0, 0));
    assert_eq!(info.scan_name.as_deref(), Some("one"));
    assert_eq!(info.bounds_hint, Some(([0.0, -249.5, 3.0], [499.0, 0.0, 3.0])));
    assert_eq!(positions(source)[9], [9.0, -4.5, 3.0]);
    type Expected = (&'static str, &'static str, fn(usize) -> f64);
    let expected: [Expected; 15] = [
        ("Blue", "u8", |i| (255 - i % 256) as f64),
        ("Green", "u8", |_| 7.0),
        ("Intensity", "f32", |i| i as f64 / 8.0),
        ("NormalX", "f32", |_| -1.0),
        ("NumberOfReturns", "u8", |_| 5.0),
        ("PointSourceId", "u16", |i| (60_000 + i) as f64),
        ("Red", "u8", |i| (i % 256) as f64),
        ("ReturnNumber", "u8", |i| (i % 5 + 1) as f64),
        ("columnIndex", "i32", |i| i as f64 - 5.0),
        ("isColorInvalid", "u8", |i| (i % 2) as f64),
        ("isIntensityInvalid", "u8", |_| 0.0),
        ("own:heat", "f64", |i| (i % 100) as f64 * 0.5 - 5.0),
        ("own:plain", "i8", |i| -((i % 100) as f64)),
        ("rowIndex", "u16", |i| 2.0 * i as f64),
        ("timeStamp", "f64", |i| i as f64 * 0.1),
    ];
    let found: Vec<_> = info.layout.attributes.iter().map(|a| (&*a.name, a.ty.word())).collect();
    assert_eq!(found, expected.iter().map(|e| (e.0, e.1)).collect::<Vec<_>>());
    for (name, _, value) in &expected {
        let column = column(source, name);
        assert!((0..500).all(|i| column.as_f64(i) == value(i)), "{name}");
    }
}

#[test]
fn each_scan_has_its_name_and_its_pose() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let pose = Transform {
        rotation: Quaternion { w: half, x: 0.0, y: 0.0, z: half },
        translation: Translation { x: 4e5, y: 5e6, z: 100.0 },
    };
    let scan = |name, pose| (name, pose, xyz(), vec![at(1.0, 2.0, 3.0), at(0.0, 0.0, 0.0)]);
    write(&path, vec![scan("north", Some(pose)), scan("south", None)]);
    let all = sources(&path).unwrap();
    let names: Vec<_> = all.iter().map(|s| (s.info().scan_name.clone().unwrap(), s.info().index)).collect();
    assert_eq!(names, [("north".to_owned(), 0), ("south".to_owned(), 1)]);
    let placed = positions(&*all[0]);
    assert!((0..3).all(|i| (placed[0][i] - [4e5 - 2.0, 5e6 + 1.0, 103.0][i]).abs() < 1e-9), "{placed:?}");
    assert_eq!(placed[1], [4e5, 5e6, 100.0]);
    assert_eq!(all[0].info().pose.scanner(), [4e5, 5e6, 100.0]);
    let (min, max) = all[0].info().bounds_hint.unwrap();
    assert!((0..3).all(|i| placed.iter().all(|p| min[i] - 1e-9 <= p[i] && p[i] <= max[i] + 1e-9)));
    assert_eq!(positions(&*all[1])[0], [1.0, 2.0, 3.0]);
}

#[test]
fn spherical_points_and_invalid_ones() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    let prototype = vec![
        Record::SPHERICAL_RANGE_F64,
        Record::SPHERICAL_AZIMUTH_F64,
        Record::SPHERICAL_ELEVATION_F64,
        Record::SPHERICAL_INVALID_STATE,
    ];
    let right = std::f64::consts::FRAC_PI_2;
    let row = |r: f64, a: f64, e: f64, state| {
        let mut row = at(r, a, e);
        row.push(RecordValue::Integer(state));
        row
    };
    let rows = vec![row(2.0, right, 0.0, 0), row(3.0, 0.0, right, 0), row(1.0, 0.0, 0.0, 1), row(1.0, 0.0, 0.0, 2)];
    write(&path, vec![("s", None, prototype, rows)]);
    let all = sources(&path).unwrap();
    let p = positions(&*all[0]);
    assert!((p[0][1] - 2.0).abs() < 1e-15 && p[0][0].abs() < 1e-15);
    assert!((p[1][2] - 3.0).abs() < 1e-15);
    // A direction, or nothing at all, is no position; the state of the others says nothing.
    assert!(p[2..].iter().flatten().all(|v| v.is_nan()));
    assert!(all[0].info().layout.attributes.is_empty());
}

#[test]
fn a_wrong_checksum_is_named_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    write(&path, vec![("s", None, xyz(), (0..1000).map(|i| at(f64::from(i), 0.0, 0.0)).collect())]);
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[10_000] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let all = sources(&path).unwrap();
    let error = records(&*all[0]).unwrap_err().to_string();
    assert!(
        error.contains("at byte 9216: expected a page of the points of scan 1 with the right checksum (CRC)"),
        "{error}"
    );
}

#[test]
fn points_without_bits_and_lying_counts_come_to_an_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    let constant = RecordDataType::Integer { min: 3, max: 4 };
    let names = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
    let prototype = names.map(|n| record(n, constant.clone())).to_vec();
    write(&path, vec![("s", None, prototype, vec![vec![RecordValue::Integer(3); 3]; 5])]);
    let whole = std::fs::read(&path).unwrap();
    let replaced = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let mut file = whole.clone();
        let places: Vec<_> = (0..file.len() - from.len()).filter(|&i| file[i..].starts_with(from.as_bytes())).collect();
        assert!(!places.is_empty());
        places.into_iter().for_each(|i| file[i..i + to.len()].copy_from_slice(to.as_bytes()));
        seal(&mut file);
        std::fs::write(&path, file).unwrap();
    };
    replaced("maximum=\"4\"", "maximum=\"3\"");
    let error = sources(&path).err().unwrap().to_string();
    assert!(error.contains("expected a column that is not constant of scan 1"), "{error}");
    // More points than there are: an error, not an endless search.
    replaced("recordCount=\"5\"", "recordCount=\"9\"");
    assert!(records(&*sources(&path).unwrap()[0]).is_err());
}

/// All but WKT was dropped without a word, and a scan of another zone went into the store.
#[test]
fn the_crs_is_known_in_every_form_that_programs_write() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.e57");
    let names = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
    let with = |text: Option<&str>, ty: RecordDataType, value: RecordValue| {
        let mut writer = E57Writer::from_file(&path, "file").unwrap();
        writer.set_coordinate_metadata(text.map(str::to_owned));
        let mut scan = writer.add_pointcloud("s", names.clone().map(|n| record(n, ty.clone())).to_vec()).unwrap();
        scan.add_point(vec![value; 3]).unwrap();
        scan.finalize().unwrap();
        writer.finalize().unwrap();
        sources(&path).unwrap().remove(0).info().clone()
    };
    let double = |text| with(text, RecordDataType::F64, RecordValue::Double(1.0));
    let wkt = r#"PROJCS["ETRS89 / UTM zone 33N",UNIT["metre",1],AUTHORITY["EPSG","25833"]]"#;
    for text in [wkt, "EPSG:25833", " epsg:25833\n", "urn:ogc:def:crs:EPSG::25833", "25833"] {
        let info = double(Some(text));
        assert_eq!(info.crs.unwrap().horizontal_epsg, Some(25833), "{text}");
        assert!(info.warnings.is_empty(), "{text}: {:?}", info.warnings);
    }
    let info = double(Some("+proj=utm +zone=33 +units=us-ft"));
    assert_eq!(info.crs, None);
    assert!(info.warnings[0].contains("its CRS is not understood ('+proj=utm"), "{:?}", info.warnings);
    let info = double(None);
    assert!(info.crs.is_none() && info.warnings.is_empty() && !info.is_single);
    // Floats of 32 bits are known as such.
    assert!(with(None, RecordDataType::F32, RecordValue::Single(1.0)).is_single);
}
