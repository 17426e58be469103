//! LAS and LAZ files made in memory: whole, cut, and with headers that lie.

use super::extra::tests::{descriptor, vlr};
use super::samples::{Sample, at};
use crate::formats::{FormatError, Piece, PointSource, ReadOptions, Tally, open};
use crate::points::Column;

/// Writes `content` and opens it, if it can be opened.
fn try_opened(content: &[u8]) -> Result<Box<dyn PointSource>, FormatError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sample.las");
    std::fs::write(&path, content).unwrap();
    open(&path, &ReadOptions::default())
}

fn opened(content: &[u8]) -> Box<dyn PointSource> {
    try_opened(content).unwrap_or_else(|e| panic!("{e}"))
}

fn refusal(content: &[u8]) -> String {
    try_opened(content).err().map_or_else(|| "opened".to_owned(), |e| e.to_string())
}

/// All records, piece by piece.
fn records(source: &dyn PointSource, target: u64) -> Result<(Vec<u8>, Tally), FormatError> {
    let mut all = Vec::new();
    let mut sum = Tally::default();
    for piece in source.pieces(target) {
        let mut sink = |run: &[u8]| {
            all.extend_from_slice(run);
            true
        };
        let tally = source.read(piece, &mut sink)?;
        sum.read += tally.read;
        sum.truncated += tally.truncated;
    }
    Ok((all, sum))
}

fn set(file: &mut [u8], at: usize, bytes: &[u8]) {
    file[at..at + bytes.len()].copy_from_slice(bytes);
}

#[test]
fn every_format_comes_back_byte_for_byte() {
    for format in 0..=10 {
        for extra in [0, 3] {
            for chunk in [None, Some(1000), Some(64)] {
                let sample = Sample { extra, chunk, ..Sample::new(format, 333) };
                let source = opened(&sample.file());
                let info = source.info();
                assert_eq!(info.format, if chunk.is_some() { "laz" } else { "las" });
                assert_eq!((info.records, info.missing), (333, 0));
                assert!(info.warnings.is_empty(), "{:?}", info.warnings);
                assert_eq!(info.layout.stride(), sample.record_bytes());
                assert_eq!(info.las.as_ref().unwrap().undescribed_bytes, extra as u16);
                for target in [1, 100, u64::MAX] {
                    let (read, tally) = records(&*source, target).unwrap();
                    assert_eq!(tally, Tally { read: 333, truncated: 0 });
                    assert!(read == sample.records(), "format {format}, {extra}, {chunk:?}");
                }
            }
        }
    }
}

#[test]
fn pieces_are_whole_chunks_of_about_the_wanted_size() {
    let source = opened(&Sample { chunk: Some(10), ..Sample::new(6, 95) }.file());
    let pieces = |target| source.pieces(target).iter().map(|p| p.records).collect::<Vec<_>>();
    assert_eq!(pieces(1), [10, 10, 10, 10, 10, 10, 10, 10, 10, 5]);
    assert_eq!(pieces(28), [30, 30, 30, 5]);
    assert_eq!(pieces(u64::MAX), [95]);
    let mut read = Vec::new();
    let mut sink = |run: &[u8]| {
        read.extend_from_slice(run);
        true
    };
    source.read(Piece { first: 17, records: 25 }, &mut sink).unwrap();
    let all = Sample::new(6, 95).records();
    assert!(read == all[17 * 30..42 * 30]);
}

#[test]
fn a_sink_that_has_enough_stops_the_reading() {
    for chunk in [None, Some(50)] {
        let source = opened(&Sample { chunk, ..Sample::new(3, 500) }.file());
        let mut runs = 0;
        let mut sink = |_: &[u8]| {
            runs += 1;
            false
        };
        source.read(Piece { first: 0, records: 500 }, &mut sink).unwrap();
        assert_eq!(runs, 1);
    }
}

#[test]
fn columns_are_what_the_bits_say() {
    let mut file = Sample { extra: 2, ..Sample::new(6, 1) }.file();
    let start = file.len() - 32;
    set(&mut file, start + 12 + 2, &[0b0101_0011, 0b1010_1001, 200, 7, 0x34, 0xff]);
    set(&mut file, start + 30, &[9, 8]);
    let source = opened(&file);
    let layout = &source.info().layout;
    let (read, _) = records(&*source, 1).unwrap();
    let value = |name: &str| {
        let i = layout.attributes.iter().position(|a| a.name == name).unwrap_or_else(|| panic!("no {name}"));
        let mut column = Column::with_capacity(layout.attributes[i].ty, 1);
        layout.extract(i, std::iter::once(&read[12..]), &mut column);
        column.as_f64(0)
    };
    let expected = [
        ("ReturnNumber", 3.0),
        ("NumberOfReturns", 5.0),
        ("Synthetic", 1.0),
        ("KeyPoint", 0.0),
        ("Withheld", 0.0),
        ("Overlap", 1.0),
        ("ScanChannel", 2.0),
        ("ScanDirectionFlag", 0.0),
        ("EdgeOfFlightLine", 1.0),
        ("Classification", 200.0),
        ("UserData", 7.0),
        ("ScanAngleRank", -204.0),
        ("ExtraBytes[0]", 9.0),
        ("ExtraBytes[1]", 8.0),
    ];
    for (name, number) in expected {
        assert_eq!(value(name), number, "{name}");
    }
}

#[test]
fn extra_bytes_are_described_by_all_their_records() {
    let (a, b) = (vlr(&[descriptor(3, 0, "a")]).data, vlr(&[descriptor(9, 0, "b"), descriptor(6, 0, "c")]).data);
    let spec = &b"LASF_Spec"[..];
    let mut sample = Sample { extra: 10, vlrs: vec![(spec, 4, a)], ..Sample::new(7, 5) };
    sample.evlrs = vec![(spec, 4, b)];
    let source = opened(&sample.file());
    let las = source.info().las.as_ref().unwrap();
    assert_eq!((las.undescribed_bytes, las.vlrs.len(), las.vlrs[1].extended), (0, 2, true));
    assert!(source.info().layout.attributes.iter().any(|a| a.name == "c"));
    // With one byte less, `c` does not fit: its bytes are kept without its name.
    sample.extra = 9;
    let source = opened(&sample.file());
    let names: Vec<_> = source.info().layout.attributes.iter().map(|a| &*a.name).collect();
    assert!(names.contains(&"b") && names.contains(&"ExtraBytes[2]") && !names.contains(&"c"), "{names:?}");
    assert!(source.info().warnings[0].contains("describes more than the 9 bytes"));
}

#[test]
fn a_cut_file_gives_its_whole_records() {
    let sample = Sample::new(3, 100);
    let mut file = sample.file();
    file.truncate(file.len() - 34 * 40 - 5);
    let source = opened(&file);
    assert_eq!((source.info().records, source.info().missing), (59, 41));
    assert!(source.info().warnings[0].contains("announces 100 records, the file holds 59"));
    assert!(records(&*source, 10).unwrap().0 == sample.records()[..59 * 34]);
    file.truncate(300);
    assert!(opened(&file).info().records == 2);
    for length in 5..227 {
        assert!(refusal(&file[..length]).contains("found the end of the file"));
    }
}

#[test]
fn a_cut_laz_file_gives_what_can_be_decoded() {
    // Layered chunks say how long they are; others are decoded until the data end.
    for (format, whole) in [(6, true), (1, false)] {
        let sample = Sample { chunk: Some(100), ..Sample::new(format, 1000) };
        let mut file = sample.file();
        file.truncate(file.len() * 6 / 10);
        let source = opened(&file);
        let info = source.info();
        assert!(info.warnings.iter().any(|w| w.contains("the chunk table is missing or damaged")));
        let (read, tally) = records(&*source, 1).unwrap();
        assert!(tally.read > 300 && tally.read < 900);
        assert_eq!(tally.read + tally.truncated + info.missing, 1000);
        assert_eq!(tally.truncated == 0, whole);
        assert!(!whole || tally.read % 100 == 0);
        assert!(read[..] == sample.records()[..read.len()]);
    }
}

#[test]
fn counts_that_lie_are_seen() {
    let whole = Sample::new(6, 50);
    let with = |at: usize, bytes: &[u8]| {
        let mut file = whole.file();
        set(&mut file, at, bytes);
        let source = opened(&file);
        (source.info().records, source.info().missing, source.info().warnings.join("; "))
    };
    let (records, missing, warning) = with(at::LEGACY_POINTS, &40_u32.to_le_bytes());
    assert_eq!((records, missing), (50, 0));
    assert!(warning.contains("announces 50 records, and 40 in its legacy field"));
    assert_eq!(with(at::POINTS, &u64::MAX.to_le_bytes()).0, 50);
    assert_eq!(with(at::POINTS, &u64::MAX.to_le_bytes()).1, u64::MAX - 50);
    let (records, missing, warning) = with(at::POINTS, &0_u64.to_le_bytes());
    assert_eq!((records, missing), (0, 0));
    assert!(warning.contains("announces 0 records, the file has room for 50"));
    assert!(with(at::VLRS, &9_u32.to_le_bytes()).2.contains("announces 9 variable length records, 0 of them"));
    let mut evlr = u64::MAX.to_le_bytes().to_vec();
    evlr.extend(3_u32.to_le_bytes());
    assert!(with(at::EVLR_OFFSET, &evlr).2.contains("announces 3 extended variable length records, 0 of them"));
    // Both counts there, only the legacy one possible.
    let mut file = whole.file();
    set(&mut file, at::POINTS, &9999_u64.to_le_bytes());
    set(&mut file, at::LEGACY_POINTS, &50_u32.to_le_bytes());
    assert_eq!((opened(&file).info().records, opened(&file).info().missing), (50, 0));
}

#[test]
fn records_after_the_points_are_no_points() {
    let mut sample = Sample::new(6, 50);
    sample.evlrs = vec![(b"LASF_Spec", 65535, vec![1; 300]), (b"mine", 7, vec![2; 20])];
    let mut file = sample.file();
    set(&mut file, at::POINTS, &60_u64.to_le_bytes());
    let source = opened(&file);
    assert_eq!((source.info().records, source.info().missing), (50, 10));
    assert!(source.info().warnings[0].contains("waveform packets are not kept"));
    let vlrs = &source.info().las.as_ref().unwrap().vlrs;
    assert_eq!((vlrs.len(), vlrs[0].record_id, vlrs[0].data.len()), (1, 7, 20));
}

#[test]
fn laz_counts_that_lie_are_seen() {
    for format in [1, 6] {
        let sample = Sample { minor: 4, chunk: Some(10), ..Sample::new(format, 95) };
        let with = |points: u64| {
            let mut file = sample.file();
            set(&mut file, at::LEGACY_POINTS, &0_u32.to_le_bytes());
            set(&mut file, at::POINTS, &points.to_le_bytes());
            opened(&file)
        };
        let fewer = with(42);
        assert_eq!((fewer.info().records, fewer.info().missing), (42, 0));
        assert!(records(&*fewer, 1).unwrap().0 == sample.records()[..42 * sample.record_bytes()]);
        let more = with(1000);
        // How much the last chunk holds, only a layered one says.
        assert_eq!(more.info().records, if format == 6 { 95 } else { 100 });
        assert_eq!(more.info().records + more.info().missing, 1000);
        if format == 6 {
            assert!(fewer.info().warnings[0].contains("the chunks hold 95"));
            assert!(records(&*more, 1).unwrap().0 == sample.records());
        } else {
            assert!(records(&*more, 1).is_err());
        }
        assert_eq!(with(0).info().records, 0);
    }
}

#[test]
fn damaged_chunks_are_errors_with_their_place() {
    let sample = Sample { chunk: Some(100), ..Sample::new(6, 100) };
    let mut file = sample.file();
    let start = u32::from_le_bytes(file[at::POINTS_OFFSET..][..4].try_into().unwrap()) as usize;
    // The size of the first layer: four gigabytes.
    set(&mut file, start + 8 + 30 + 4, &[255; 4]);
    let error = records(&*opened(&file), 1).unwrap_err().to_string();
    assert!(error.contains(&format!("at byte {}: expected a chunk of 100 records", start + 8)), "{error}");
}

#[test]
fn a_file_that_is_cut_while_it_is_read_says_where_it_ends() {
    // The chunk was said to be other than expected, with the same numbers twice.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.laz");
    let file = Sample { chunk: Some(100), ..Sample::new(6, 100) }.file();
    let start = u64::from(u32::from_le_bytes(file[at::POINTS_OFFSET..][..4].try_into().unwrap())) + 8;
    std::fs::write(&path, file).unwrap();
    let source = crate::formats::open(&path, &ReadOptions::default()).unwrap();
    std::fs::File::options().write(true).open(&path).unwrap().set_len(start + 50).unwrap();
    let error = records(&*source, 1).unwrap_err().to_string();
    assert!(error.ends_with("found the end of the file after 50 bytes"), "{error}");
}

#[test]
fn headers_that_make_no_sense_are_refused_with_their_place() {
    let with = |at: usize, bytes: &[u8]| {
        let mut file = Sample::new(6, 5).file();
        set(&mut file, at, bytes);
        refusal(&file)
    };
    // Scales that no lattice has were refused without the file's name, with hundreds of digits.
    for scale in [0.0, -1.0, f64::NAN, f64::INFINITY, 5e-324, 1e300] {
        assert!(with(at::SCALE, &scale.to_le_bytes()).contains("at byte 131: expected positive scale factors"));
    }
    assert!(with(155, &f64::NAN.to_le_bytes()).contains("at byte 155"));
    assert!(with(24, &[2, 0]).contains("LAS version 2.0 is not supported; versions 1.0 to 1.5 are"));
    assert!(with(104, &[11]).contains("point format 11 is not supported"));
    assert!(with(104, &[6 | 0x80]).contains("expected a `laszip encoded` record"));
    assert!(with(at::RECORD_BYTES, &[29, 0]).contains("at byte 105: expected records of at least 30 bytes"));
    assert!(with(at::RECORD_BYTES, &[0, 0]).contains("at byte 105"));
    assert!(with(at::POINTS_OFFSET, &[10, 0, 0, 0]).contains("at byte 96: expected an offset to points beyond"));
    assert!(with(at::POINTS_OFFSET, &[0, 0, 0, 1]).contains("at byte 96: expected an offset to points within"));
    assert!(with(94, &[200, 0]).contains("at byte 94: expected a header of at least 375 bytes"));
}

#[test]
fn compressions_that_are_not_decoded_are_refused() {
    let mut file = Sample { chunk: Some(10), ..Sample::new(6, 5) }.file();
    let vlr = 375 + 54;
    let mut with = |at: usize, value: u8| {
        let before = std::mem::replace(&mut file[vlr + at], value);
        let refusal = refusal(&file);
        file[vlr + at] = before;
        refusal
    };
    assert!(with(0, 0).contains("LAZ compressor 0"));
    assert!(with(0, 9).contains("9 is not valid"));
    assert!(with(34, 11).contains("a LAZ file of items [RGB14] for point format 6"));
    assert!(with(38, 5).contains("LAZ item Point14 of version 5 is not supported; decompress it to LAS first"));
}

#[test]
fn empty_files_have_no_pieces() {
    for chunk in [None, Some(10)] {
        let source = opened(&Sample { chunk, ..Sample::new(6, 0) }.file());
        assert_eq!((source.info().records, source.info().missing), (0, 0));
        assert!(source.pieces(10).is_empty());
        assert_eq!(source.read(Piece { first: 3, records: 9 }, &mut |_| true).unwrap(), Tally::default());
    }
}

#[test]
fn the_crs_comes_from_text_in_either_place() {
    let wkt = b"GEOGCS[\"WGS 84\",AUTHORITY[\"EPSG\",\"4326\"]]\0".to_vec();
    let projection = &b"LASF_Projection"[..];
    let mut before = Sample { vlrs: vec![(projection, 2112, wkt.clone())], ..Sample::new(6, 1) };
    let mut file = before.file();
    file[at::ENCODING] |= 16;
    before.vlrs.clear();
    before.evlrs = vec![(projection, 2112, wkt)];
    for file in [file, before.file()] {
        let source = opened(&file);
        let crs = source.info().crs.as_ref().unwrap();
        assert_eq!((crs.horizontal_epsg, crs.unit_name()), (Some(4326), Some("degree")));
    }
}
