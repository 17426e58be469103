//! PLY and CSV, byte by byte, and what all writers have in common.

use super::*;
use crate::lattice::{Lattice, LatticePoint};
use crate::points::{Column, Positions, ScalarType, Scaling};
use std::fs;

fn plan(attributes: Vec<Attribute>) -> OutputPlan {
    OutputPlan {
        lattice: Lattice::uniform(0.001).unwrap(),
        attributes: attributes.into(),
        crs: None,
        las: LasTarget::Merged { scale: [0.001; 3], offset: [0.0; 3] },
    }
}

fn batch(plan: &OutputPlan, worlds: &[[f64; 3]], columns: Vec<Column>) -> Batch {
    let positions: Positions = worlds.iter().map(|w| plan.lattice.lattice_from_world(*w).unwrap()).collect();
    Batch { attributes: Arc::clone(&plan.attributes), positions, scans: Vec::new(), columns }
}

/// What a file of this form holds after these batches, and the notes.
fn written(format: OutputFormat, plan: &OutputPlan, batches: &[Batch]) -> Result<(Vec<u8>, Vec<String>), FormatError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out");
    let mut writer = create(&path, format, plan, &CreateOptions::default())?;
    for batch in batches {
        writer.write(batch)?;
    }
    let notes = writer.finish()?;
    Ok((fs::read(&path).unwrap(), notes))
}

const WORLDS: [[f64; 3]; 3] = [[500_000.125, -0.001, 0.0], [1.0, -2.5, 1e6], [0.1, 0.2, 0.3]];

#[test]
fn csv_has_exact_coordinates_and_real_values() {
    let mut height = Attribute::new("height, m", ScalarType::I16);
    height.scaling = Some(Scaling { scale: 0.1, offset: 0.0 });
    height.no_data = Some([0xFF; 8]);
    let plan = plan(vec![Attribute::new("Intensity", ScalarType::U16), height, Attribute::new("f", ScalarType::F32)]);
    let columns =
        vec![Column::U16(vec![0, 1, 65_535]), Column::I16(vec![3, -1, -7]), Column::F32(vec![0.1, -0.0, 1e30])];
    let (bytes, notes) = written(OutputFormat::Csv, &plan, &[batch(&plan, &WORLDS, columns)]).unwrap();
    let expected = "X,Y,Z,Intensity,\"height, m\",f\n\
                    500000.125,-0.001,0,0,0.3,0.1\n\
                    1,-2.5,1000000,1,,-0\n\
                    0.1,0.2,0.3,65535,-0.7,1e30\n";
    assert_eq!(String::from_utf8(bytes).unwrap(), expected);
    assert!(notes[0].contains("height"));
}

#[test]
fn csv_has_every_name_once() {
    // Two scans whose intensities have different types gave a CSV file two columns of one name.
    let plan = plan(["Intensity", "Intensity", "X"].map(|name| Attribute::new(name, ScalarType::U8)).into());
    let (bytes, notes) = written(OutputFormat::Csv, &plan, &[]).unwrap();
    assert_eq!(String::from_utf8(bytes).unwrap(), "X,Y,Z,Intensity,Intensity.2,X.2\n");
    assert_eq!(notes, ["Intensity (u8) is column Intensity.2", "X (u8) is column X.2"]);
}

#[test]
fn an_array_has_every_name_once() {
    // Both were `a_b`, and NumPy could not read the file.
    let plan = plan(["a\tb", "a\nb"].map(|name| Attribute::new(name, ScalarType::U8)).to_vec());
    let values = batch(&plan, &[[1.0, 2.0, 3.0]], (1..=2).map(|i| Column::U8(vec![i])).collect());
    let (bytes, notes) = written(OutputFormat::Npy, &plan, &[values]).unwrap();
    let head = String::from_utf8_lossy(&bytes);
    assert!(head.contains("('a_b', '|u1'), ('a_b.2', '|u1')"), "{head}");
    assert_eq!(notes.len(), 1);
}

#[test]
fn an_archive_has_every_name_once() {
    // `a/b` was written as `a_b`, of which there was one.
    let names = ["a/b", "a_b", "a\\b"];
    let plan = plan(names.map(|name| Attribute::new(name, ScalarType::U8)).to_vec());
    let values = batch(&plan, &[[1.0, 2.0, 3.0]], (1..=3).map(|i| Column::U8(vec![i])).collect());
    let (bytes, notes) = written(OutputFormat::Npz, &plan, &[values]).unwrap();
    let archive = zip::ZipArchive::new(std::io::Cursor::new(bytes)).unwrap();
    let mut found: Vec<_> = archive.file_names().map(|name| name.unwrap().into_owned()).collect();
    found.sort_unstable();
    assert_eq!(found, ["X.npy", "Y.npy", "Z.npy", "a_b.2.npy", "a_b.3.npy", "a_b.npy"]);
    assert_eq!(notes.len(), 2);
}

#[test]
fn what_was_packed_for_another_form_is_refused_by_name() {
    let plan = plan(Vec::new());
    let folder = tempfile::tempdir().unwrap();
    let begun = |name: &str, format| create(&folder.path().join(name), format, &plan, &CreateOptions::default());
    let packer = begun("a.las", OutputFormat::Las).unwrap().packer();
    for (name, format) in [("a.csv", OutputFormat::Csv), ("a.ply", OutputFormat::Ply), ("a.npz", OutputFormat::Npz)] {
        let mut writer = begun(name, format).unwrap();
        let error =
            writer.write_packed(packer.pack(batch(&plan, &WORLDS, Vec::new())).unwrap()).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains("packed for another writer"), "{error}");
    }
}

#[test]
fn ply_has_customary_names_and_the_count_of_all_batches() {
    let plan = plan(vec![
        Attribute::new("Red", ScalarType::U8),
        Attribute::new("NormalX", ScalarType::F32),
        Attribute::new("tree id", ScalarType::I64),
        Attribute::new("Red", ScalarType::U16),
    ]);
    let columns = |n: usize| {
        vec![
            Column::U8(vec![200; n]),
            Column::F32(vec![0.5; n]),
            Column::I64(vec![-(1 << 60); n]),
            Column::U16(vec![9; n]),
        ]
    };
    let batches = [batch(&plan, &WORLDS, columns(3)), batch(&plan, &WORLDS[..1], columns(1))];
    let (bytes, notes) = written(OutputFormat::Ply, &plan, &batches).unwrap();
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = std::str::from_utf8(&bytes[..end]).unwrap();
    assert!(header.starts_with("ply\nformat binary_little_endian 1.0\n"), "{header}");
    let lines: Vec<_> = header.lines().map(str::trim_end).collect();
    let properties = [
        "element vertex 4",
        "property double x",
        "property double y",
        "property double z",
        "property uchar red",
        "property float nx",
        "property double tree_id",
        "property ushort red.2",
        "end_header",
    ];
    assert!(lines.ends_with(&properties), "{header}");
    assert!(notes.iter().any(|n| n.contains("red.2")), "{notes:?}");
    let stride = 24 + 1 + 4 + 8 + 2;
    assert_eq!(bytes.len() - end, 4 * stride);
    for (row, world) in bytes[end..].chunks(stride).zip(WORLDS.iter().chain(&WORLDS[..1])) {
        let double = |at: usize| f64::from_le_bytes(row[at..at + 8].try_into().unwrap());
        assert_eq!([double(0), double(8), double(16)], *world);
        assert_eq!((row[24], double(29)), (200, -(2_f64.powi(60))));
        assert_eq!((&row[25..29], &row[37..39]), (&0.5_f32.to_le_bytes()[..], &[9, 0][..]));
    }
}

#[test]
fn ply_refuses_integers_that_it_would_round() {
    let plan = plan(vec![Attribute::new("id", ScalarType::U64)]);
    let column = Column::U64(vec![1, (1 << 53) + 1, 2]);
    let error = written(OutputFormat::Ply, &plan, &[batch(&plan, &WORLDS, vec![column])]).unwrap_err().to_string();
    assert!(error.contains("9007199254740993") && error.contains("LAS"), "{error}");
}

#[test]
fn empty_files_are_valid() {
    let plan = plan(vec![Attribute::new("Intensity", ScalarType::U16)]);
    let none = batch(&plan, &[], vec![Column::U16(Vec::new())]);
    for batches in [&[][..], &[none][..]] {
        assert_eq!(written(OutputFormat::Csv, &plan, batches).unwrap().0, b"X,Y,Z,Intensity\n");
        let ply = written(OutputFormat::Ply, &plan, batches).unwrap().0;
        assert!(String::from_utf8(ply).unwrap().contains("element vertex 0 "));
        for format in [OutputFormat::Las, OutputFormat::Laz] {
            let bytes = written(format, &plan, batches).unwrap().0;
            let reader = ::las::Reader::new(std::io::Cursor::new(bytes)).unwrap();
            assert_eq!(reader.header().number_of_points(), 0);
        }
    }
}

#[test]
fn every_form_is_refused_where_no_file_can_be() {
    let plan = plan(Vec::new());
    let folder = tempfile::tempdir().unwrap();
    let there = folder.path().join("there");
    fs::write(&there, b"mine").unwrap();
    for format in [OutputFormat::Las, OutputFormat::Laz, OutputFormat::Ply, OutputFormat::Csv] {
        let refused = |path: &Path| create(path, format, &plan, &CreateOptions::default()).map(|_| ()).unwrap_err();
        assert!(refused(&there).to_string().contains("--force"));
        assert!(refused(folder.path()).to_string().contains("directory"));
        assert!(refused(&folder.path().join("no/file")).to_string().contains("does not exist"));
        // A folder in which not even root may create files.
        #[cfg(target_os = "linux")]
        assert!(matches!(refused(Path::new("/proc/file")), FormatError::Io { action: "creating", .. }));
    }
    assert_eq!(fs::read(&there).unwrap(), b"mine");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_dropped_writer_leaves_nothing() {
    let plan = plan(Vec::new());
    let folder = tempfile::tempdir().unwrap();
    for format in [OutputFormat::Las, OutputFormat::Laz, OutputFormat::Ply, OutputFormat::Csv] {
        let mut writer = create(&folder.path().join("a"), format, &plan, &CreateOptions::default()).unwrap();
        writer.write(&batch(&plan, &WORLDS, Vec::new())).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        drop(writer);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

#[test]
fn a_writer_that_failed_does_not_finish() {
    let plan = plan(vec![Attribute::new("ReturnNumber", ScalarType::U8)]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.las");
    let mut writer = create(&path, OutputFormat::Las, &plan, &CreateOptions::default()).unwrap();
    assert!(writer.write(&batch(&plan, &WORLDS, vec![Column::U8(vec![1, 77, 1])])).is_err());
    assert!(writer.finish().is_err());
    assert!(!path.exists());
}

#[test]
fn the_far_ends_of_the_lattice_are_written_or_refused() {
    let plan = plan(Vec::new());
    let far = Positions::from_iter([LatticePoint([0; 3]), LatticePoint([(1 << 48) - 1; 3])]);
    let batch = Batch { positions: far, ..batch(&plan, &[], Vec::new()) };
    let csv = String::from_utf8(written(OutputFormat::Csv, &plan, std::slice::from_ref(&batch)).unwrap().0).unwrap();
    let min = plan.lattice.decimal_on_axis(0, 0);
    assert!(csv.contains(&format!("\n{0},{0},{0}\n", min.to_f64())), "{csv}");
    for format in [OutputFormat::Las, OutputFormat::Laz] {
        let error = written(format, &plan, std::slice::from_ref(&batch)).unwrap_err().to_string();
        assert!(error.contains("--scale"), "{error}");
    }
}

#[test]
fn our_own_reader_gives_a_ply_file_back() {
    let mut attributes = vec![
        Attribute::new("Blue", ScalarType::U8),
        Attribute::new("Green", ScalarType::U8),
        Attribute::new("GpsTime", ScalarType::F64),
        Attribute::new("Intensity", ScalarType::U16),
        Attribute::new("NormalZ", ScalarType::F32),
        Attribute::new("Red", ScalarType::U8),
        Attribute::new("quality", ScalarType::I16),
    ];
    attributes.sort_by(|a, b| a.identity().cmp(&b.identity()));
    let plan = plan(attributes);
    let columns = plan.attributes.iter().enumerate().map(|(i, a)| {
        let mut column = Column::zeros(a.ty, 0);
        for j in 0..3 {
            let value = i as u8 * 10 + j;
            let mut one = Column::zeros(a.ty, 1);
            crate::with_column!(&mut one, v => v[0] = value as _);
            column.append(&one);
        }
        column
    });
    let batch = batch(&plan, &WORLDS, columns.collect());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let mut writer = create(&path, OutputFormat::Ply, &plan, &CreateOptions::default()).unwrap();
    writer.write(&batch).unwrap();
    writer.finish().unwrap();

    let source = crate::formats::open(&path, &crate::formats::ReadOptions::default()).unwrap();
    let layout = &source.info().layout;
    assert_eq!(layout.attributes, plan.attributes);
    let mut rows = Vec::new();
    for piece in source.pieces(2) {
        let mut sink = |run: &[u8]| {
            rows.extend_from_slice(run);
            true
        };
        source.read(piece, &mut sink).unwrap();
    }
    for (i, expected) in batch.columns.iter().enumerate() {
        let mut column = Column::zeros(expected.ty(), 0);
        layout.extract(i, rows.chunks(layout.stride()).map(|r| &r[24..]), &mut column);
        assert_eq!(&column, expected, "{}", layout.attributes[i].name);
    }
    assert_eq!(rows[..8], WORLDS[0][0].to_le_bytes());
}

#[test]
fn numpy_arrays_have_a_field_per_attribute_and_the_count_of_all_batches() {
    let mut height = Attribute::new("height", ScalarType::I16);
    height.scaling = Some(Scaling { scale: 0.5, offset: 1.0 });
    height.no_data = Some([0xFF; 8]);
    let plan = plan(vec![Attribute::new("it's", ScalarType::U16), height, Attribute::new("X", ScalarType::U8)]);
    let columns = || vec![Column::U16(vec![0, 1, 65_535]), Column::I16(vec![3, -1, -7]), Column::U8(vec![7, 8, 9])];
    let batches = [batch(&plan, &WORLDS, columns()), batch(&plan, &WORLDS, columns())];
    let (bytes, notes) = written(OutputFormat::Npy, &plan, &batches).unwrap();
    assert_eq!(&bytes[..8], b"\x93NUMPY\x03\x00");
    let end = 12 + u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize;
    assert!(end.is_multiple_of(64) && bytes[end - 1] == b'\n');
    let head = String::from_utf8(bytes[12..end].to_vec()).unwrap();
    let expected = "{'descr': [('X', '<f8'), ('Y', '<f8'), ('Z', '<f8'), ('it\\'s', '<u2'), ('height', '<f8'), ('X.2', '|u1')], \
                    'fortran_order': False, 'shape': (6,), }";
    assert_eq!(head.trim_end(), expected);
    let rows: Vec<&[u8]> = bytes[end..].chunks(35).collect();
    assert_eq!(rows.len(), 6);
    let real = |row: usize, at: usize| f64::from_le_bytes(rows[row][at..at + 8].try_into().unwrap());
    assert_eq!((real(4, 0), real(4, 8), real(4, 16)), (1.0, -2.5, 1e6));
    assert_eq!((real(3, 26), rows[5][24..26].to_vec(), rows[5][34]), (2.5, vec![255, 255], 9));
    assert!(real(1, 26).is_nan() && real(4, 26).is_nan());
    assert!(notes.iter().any(|n| n.contains("X.2")) && notes.iter().any(|n| n.contains("height")), "{notes:?}");

    let (archive, _) = written(OutputFormat::Npz, &plan, &batches).unwrap();
    let mut archive = zip::ZipArchive::new(std::io::Cursor::new(archive)).unwrap();
    let names: Vec<String> = archive.file_names().map(|n| n.unwrap().into_owned()).collect();
    assert_eq!(names, ["X.npy", "Y.npy", "Z.npy", "it's.npy", "height.npy", "X.2.npy"]);
    let mut one = Vec::new();
    std::io::Read::read_to_end(&mut archive.by_name("it's.npy").unwrap(), &mut one).unwrap();
    assert!(
        String::from_utf8_lossy(&one[12..]).starts_with("{'descr': '<u2', 'fortran_order': False, 'shape': (6,), }")
    );
    assert_eq!(&one[one.len() - 12..], [0, 0, 1, 0, 255, 255, 0, 0, 1, 0, 255, 255]);
}
