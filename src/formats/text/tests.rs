//! Texts made in memory: every form of rows, blocks with transforms, what is cut and what is bent.

use crate::formats::{FormatError, Piece, PointSource, ReadOptions, open_all, parse_columns};
use crate::points::{Column, PositionKind};
use proptest::prelude::*;

fn try_opened(name: &str, content: &str, columns: Option<&str>) -> Result<Vec<Box<dyn PointSource>>, FormatError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, content).unwrap();
    let columns = columns.map(|c| parse_columns(c).unwrap());
    open_all(&path, &ReadOptions { columns, ..ReadOptions::default() })
}

fn opened(name: &str, content: &str) -> Vec<Box<dyn PointSource>> {
    try_opened(name, content, None).unwrap_or_else(|e| panic!("{e}"))
}

fn refusal(name: &str, content: &str) -> String {
    try_opened(name, content, None).err().map_or_else(|| "opened".to_owned(), |e| e.to_string())
}

fn records(source: &dyn PointSource, target: u64) -> Vec<u8> {
    let mut all = Vec::new();
    for piece in source.pieces(target) {
        let mut sink = |run: &[u8]| {
            all.extend_from_slice(run);
            true
        };
        let tally = source.read(piece, &mut sink).unwrap();
        assert_eq!(tally.read + tally.truncated, piece.records);
    }
    all
}

fn positions(source: &dyn PointSource) -> Vec<[f64; 3]> {
    let layout = &source.info().layout;
    let all = records(source, 10);
    let position = |r: &[u8]| -> [f64; 3] {
        match (layout.position, &source.info().grid) {
            (PositionKind::Grid, Some(grid)) => {
                grid.world(std::array::from_fn(|i| i32::from_le_bytes(r[4 * i..4 * i + 4].try_into().unwrap())))
            }
            _ => std::array::from_fn(|i| f64::from_le_bytes(r[8 * i..8 * i + 8].try_into().unwrap())),
        }
    };
    all.chunks_exact(layout.stride()).map(position).collect()
}

fn column(source: &dyn PointSource, name: &str) -> Column {
    let layout = &source.info().layout;
    let i = layout.attributes.iter().position(|a| a.name == name).unwrap_or_else(|| panic!("no {name}"));
    let mut column = Column::with_capacity(layout.attributes[i].ty, 0);
    let all = records(source, 1000);
    layout.extract(i, all.chunks_exact(layout.stride()).map(|r| &r[layout.position.size()..]), &mut column);
    column
}

fn attributes(source: &dyn PointSource) -> Vec<String> {
    source.info().layout.attributes.iter().map(|a| format!("{} {}", a.name, a.ty.word())).collect()
}

#[test]
fn any_separator_and_any_header_give_the_same_points() {
    let texts = [
        "1.5 2 -3\n4 5 6\n",
        "X Y Z\n1.5 2 -3\n4 5 6",
        "//X,Y,Z\n1.5,2,-3\n4,5,6\n",
        "# made by hand\n# y x z\n2 1.5 -3\n\n5 4 6\n",
        "\u{feff}x;y;z\r\n1,5;2;-3\r\n4;5;6\r\n",
        "\"X\", \"Y\", \"Z\"\n1.5 , 2, -3\n4,5,6\n",
        "Easting\tNorthing\tHeight\n1.5\t2\t-3\n4\t5\t6\n",
        "z y x\n-3 2 1.5\n6 5 4\n",
        // Decimal commas between tabs and blanks; even columns; cells that are empty or hold blanks and commas.
        "1,5\t2\t-3,0\n4\t5\t6\n",
        "1,5 2,0  -3\n4,0 5 6,0\n",
        "1.5 2\t-3\n4 5\t6\n",
        "x\t\ty\t\tz\n1.5\t\t2\t\t-3\n4\t\t5\t\t6\n",
        "Name\tX\tY\tZ\nP 1\t1.5\t2\t-3\n\t4\t5\t6\n",
        "Name,X,Y,Z\nP1,1.5,2,-3\n\"a \"\"b\"\", c\" ,4,5,6\n",
        "Easting (m),Northing (m),Elevation (m)\n1.5,2,-3\n4,5,6\n",
        "POINT_X;POINT_Y;POINT_Z\n1.5;2;-3\n4;5;6\n",
        "ID,E,N,H\nA,1.5,2,-3\nB,4,5,6\n",
        // CloudCompare's, with the count.
        "//X Y Z\n2\n1.5 2 -3\n4 5 6\n",
        "# x y z\nx,y,z\n1.5,2,-3\n4,5,6\n",
    ];
    for text in texts {
        let all = opened("a.xyz", text);
        assert_eq!(all[0].info().records, 2, "{text}");
        assert_eq!(positions(&*all[0]), [[1.5, 2.0, -3.0], [4.0, 5.0, 6.0]], "{text}");
        assert!(attributes(&*all[0]).is_empty(), "{text}");
        assert_eq!(all[0].info().bounds_hint, Some(([1.5, 2.0, -3.0], [4.0, 5.0, 6.0])));
    }
}

#[test]
fn columns_without_names_are_known_by_their_values() {
    let cases: [(&str, &[&str]); 8] = [
        ("1 2 3 4\n", &["Intensity u16"]),
        ("1 2 3 -4\n", &["Intensity i16"]),
        ("1 2 3 0.25\n", &["Intensity f32"]),
        ("1 2 3 4 5 6\n", &["Blue u8", "Green u8", "Red u8"]),
        ("1 2 3 4 5 600\n", &["Blue u16", "Green u16", "Red u16"]),
        ("1 2 3 0.1 -1 0\n", &["NormalX f32", "NormalY f32", "NormalZ f32"]),
        ("1 2 3 -9 255 0 0\n1 2 3 9 0 0 1\n", &["Blue u8", "Green u8", "Intensity i16", "Red u8"]),
        ("1 2 3 117.0 73.0 49.0 255.0\n1 2 3 1.0 2.0 3.0 255.0\n", &["Alpha f32", "Blue u8", "Green u8", "Red u8"]),
    ];
    for (text, expected) in cases {
        let all = opened("a.txt", text);
        assert_eq!(attributes(&*all[0]), expected, "{text}");
        assert!(all[0].info().warnings[0].contains("the columns have no names and are taken as x,y,z,"));
    }
}

#[test]
fn types_are_the_smallest_that_keep_what_is_written() {
    let text = "x,y,z,Classification,GpsTime,a,b,c,d,label,empty,PointSourceId,Red\n\
                1,2,3,2,0,1,0.123456,0.1234567,1e5,oak,,7,300\n4,5,6,300,1,-70000,2,3,,elm,,70000,0.5\n";
    let all = opened("a.csv", text);
    let found = attributes(&*all[0]);
    // Words and empty columns are not kept; what does not fit a LAS dimension is of another type.
    let expected =
        ["Classification i32", "GpsTime f64", "PointSourceId i32", "a i32", "b f32", "c f64", "d f64", "red f32"];
    assert_eq!(found, expected);
    assert_eq!(column(&*all[0], "b"), Column::F32(vec![0.123_456, 2.0]));
    assert!(matches!(column(&*all[0], "d"), Column::F64(v) if v[0] == 1e5 && v[1].is_nan()));
    let warnings = all[0].info().warnings.join("; ");
    assert!(warnings.contains("column `label` is not kept: it holds words (`oak` in line 2)"), "{warnings}");
    assert!(warnings.contains("column `empty` is not kept: it holds no number"), "{warnings}");
}

#[test]
fn whole_numbers_keep_all_their_digits() {
    let all = opened(
        "a.csv",
        "x,y,z,a,b,c\n1,2,3,18446744073709551615,-5,1\n1,2,3,7,9007199254740993,99999999999999999999\n",
    );
    assert_eq!(attributes(&*all[0]), ["a u64", "b i64", "c f64"]);
    assert_eq!(column(&*all[0], "a"), Column::U64(vec![u64::MAX, 7]));
    assert_eq!(column(&*all[0], "b"), Column::I64(vec![-5, 9_007_199_254_740_993]));
    // Nineteen digits were rounded to an f64's sixteen.
    let all = opened("a.csv", "x,y,z,a\n1,2,3,9223372036854775807\n1,2,3,-9223372036854775808\n");
    assert_eq!(column(&*all[0], "a"), Column::I64(vec![i64::MAX, i64::MIN]));
}

#[test]
fn the_parts_of_a_colour_have_one_type() {
    // Blue alone is whole: it was a colour of eight bits beside two fractions.
    let all = opened("a.txt", "X Y Z R G B nx ny nz\n1 2 3 0.5 0.25 1 0 0 1\n4 5 6 1 0 0 0.6 0.8 0\n");
    assert_eq!(attributes(&*all[0]), ["NormalX f32", "NormalY f32", "NormalZ f32", "blue f32", "green f32", "red f32"]);
}

#[test]
fn names_that_do_not_fit_the_rows_are_told() {
    let warnings = |text: &str| opened("a.txt", text)[0].info().warnings.join(";");
    assert!(warnings("//X Y Z C2C distances\n1 2 3 4\n").contains("5 columns are named, rows have 4"));
    assert_eq!(warnings("X\tY\tZ\tC2C distances\n1\t2\t3\t4\n"), "");
    assert_eq!(warnings("1,5 2 3\n"), "commas are taken as decimal points");
    // Also where no name says that it is text.
    assert_eq!(opened("a", "//X Y Z\n2\n1 2 3\n4 5 6\n")[0].info().records, 2);
    let missing = |text: &str| opened("a.asc", text)[0].info().missing;
    assert_eq!(missing("//X Y Z\n3\n1 2 3\n4 5 6\n"), 1);
    // A cell that is empty, and not the end of a column.
    let all = opened("a.txt", "x\ty\tz\ta\tb\n1\t2\t3\t\t5\n4\t5\t6\t7\t8\n");
    assert_eq!(column(&*all[0], "b"), Column::I32(vec![5, 8]));
    // Names in Latin-1.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    std::fs::write(&path, b"x,y,z,h\xf6he 2\n1,2,3,4\n").unwrap();
    assert_eq!(attributes(&*open_all(&path, &ReadOptions::default()).unwrap()[0]), ["h\u{f6}he 2 i32"]);
}

#[test]
fn two_quotes_in_a_quoted_name_are_one() {
    // Both were kept, and each was doubled when the name was written.
    let all = opened("a.csv", "x,y,z,\"a \"\"b\"\" c\",\"\"\"d\"\"\",\"e,\"\"f\",g\"\"h\n1,2,3,4,5,6,7\n");
    let names = attributes(&*all[0]);
    assert_eq!(names, ["\"d\" i32", "a \"b\" c i32", "e,\"f i32", "g\"\"h i32"]);
}

#[test]
fn no_column_is_left_out_for_its_name() {
    // Those whose names have no Latin letter and no digit were, without a word.
    let all = opened("a.csv", "x,y,z,\u{6e29}\u{5ea6},?,,\u{e9}\n1,2,3,4,5,6,7\n");
    assert_eq!(attributes(&*all[0]), ["? i32", "column6 i32", "\u{e9} i32", "\u{6e29}\u{5ea6} i32"]);
    let all = opened("a.csv", ",x,y,z\n0,1,2,3\n1,4,5,6\n");
    assert_eq!(positions(&*all[0]), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert_eq!(attributes(&*all[0]), ["column1 i32"]);
    assert_eq!(attributes(&*try_opened("a.txt", "1 2 3 4 5 6\n", Some("-,x,y,z,_,Skip")).unwrap()[0]), [] as [&str; 0]);
}

#[test]
fn the_user_says_what_columns_are() {
    let content = "7 1 2 3 0.5 9\n8 4 5 6 0.6 9\n";
    let all = try_opened("a.txt", content, Some("-,x,y,z,reflectance")).unwrap();
    assert_eq!(positions(&*all[0]), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert_eq!(attributes(&*all[0]), ["reflectance f32"]);
    assert_eq!(all[0].info().options, "columns -,x,y,z,reflectance");
    assert!(all[0].info().warnings[0].contains("rows have 6 columns, 5 of them are named"));
    // Also where there are other names, and words before the coordinates.
    let all = try_opened("a.csv", "id,e,n,h\np1,1,2,3\np2,4,5,6\n", Some("-,x,y,z")).unwrap();
    assert_eq!(positions(&*all[0])[1], [4.0, 5.0, 6.0]);
}

#[test]
fn coordinates_with_few_digits_lie_on_their_own_grid() {
    let grid = |text: &str| opened("a.xyz", text)[0].info().grid.map(|g| g.scale[0].to_string());
    assert_eq!(grid("1 2 3\n").as_deref(), Some("0.001"));
    assert_eq!(grid("1.25 2 3.123400\n").as_deref(), Some("0.0001"));
    assert_eq!(grid("665187.522077 5648349.895035 241.767693\n").as_deref(), Some("0.000001"));
    // Where a millimetre does not fit 32 bits, the digits as they are.
    assert_eq!(grid("0 0 0\n9000000 1 1\n").as_deref(), Some("1"));
    for floats in ["1.1234567 2 3\n", "1e0 2 3\n", "nan 2 3\n1 2 3\n", "1 2 3\n90000000000 0 0.5\n"] {
        assert_eq!(grid(floats), None, "{floats}");
    }
}

#[test]
fn digits_that_32_bits_do_not_hold_are_a_step_as_fine_as_they_hold() {
    // Six digits over five kilometres were rounded to a millimetre.
    let step = |text: &str| {
        let all = opened("a.xyz", text);
        let info = all[0].info();
        (info.grid.is_some(), info.step.map(|step| step.to_string()))
    };
    let wide = |width: u32| format!("690000.123456 5330000.5 500\n{}.654321 5330000.5 500\n", 690_000 + width);
    assert_eq!(step(&wide(4_200)), (true, None));
    assert_eq!(step(&wide(5_000)), (false, Some("0.00001".to_owned())));
    assert_eq!(step(&wide(400_000)), (false, Some("0.0001".to_owned())));
    assert_eq!(step(&wide(4_000_000)), (false, Some("0.001".to_owned())));
    assert_eq!(step(&wide(8_000_000)), (false, None));
    assert_eq!(step("0 0 0\n9000000 1 1\n"), (true, None));
    assert_eq!(step("1e0 2 3\n"), (false, None));
}

#[test]
fn blocks_of_pts_are_sources() {
    let all = opened("a.pts", "2\n1 2 3 -100 1 2 3\n4 5 6 200 4 5 6\n1\n7 8 9\n0\n");
    assert_eq!(all.len(), 3);
    assert_eq!(attributes(&*all[0]), ["Blue u8", "Green u8", "Intensity i16", "Red u8"]);
    assert_eq!(positions(&*all[1]), [[7.0, 8.0, 9.0]]);
    assert_eq!(all.iter().map(|s| (s.info().index, s.info().records)).collect::<Vec<_>>(), [(0, 2), (1, 1), (2, 0)]);
    // More rows than announced are rows; fewer are missing; none announced is fine.
    let info = |text: &str| {
        let all = opened("a.pts", text);
        (all[0].info().records, all[0].info().missing, all[0].info().warnings.join(";"))
    };
    let (records, missing, warnings) = info("1\n1 2 3\n4 5 6\n");
    assert!((records, missing) == (2, 0) && warnings.contains("announces 1 point, there are 2 rows: all are read"));
    let (records, missing, warnings) = info("5\n1 2 3\n4 5 6\n");
    assert!((records, missing) == (2, 3) && warnings.contains("announces 5 points, the file holds 2"));
    assert_eq!(info("1 2 3 4 5 6 7\n"), (1, 0, String::new()));
}

#[test]
fn blocks_of_a_file_have_the_same_types() {
    // An intensity was u16 in a block that happened to have none below zero: two attributes of one name.
    let types = |text: &str| opened("a.pts", text).iter().map(|s| attributes(&**s).join(" ")).collect::<Vec<_>>();
    assert_eq!(types("1\n1 2 3 -9\n1\n1 2 3 9\n"), ["Intensity i16"; 2]);
    assert_eq!(types("1\n1 2 3 9\n"), ["Intensity i16"]);
    assert_eq!(types("1\n1 2 3 9\n1\n1 2 3 9999\n"), ["Intensity u16"; 2]);
    assert_eq!(types("1\n1 2 3 0.5\n1\n1 2 3 1\n"), ["Intensity f32"; 2]);
    assert_eq!(types("1\n1 2 3 9 9 9\n1\n1 2 3 9 9 999\n"), ["Blue u16 Green u16 Red u16"; 2]);
}

const PTX: &str = "2\n2\n100 200 300\n1 0 0\n0 1 0\n0 0 1\n0 1 0 0\n-1 0 0 0\n0 0 1 0\n100 200 300 1\n\
                   1 2 3 0.5 10 20 30\n0 0 0 0.500000 0 0 0\n4 5 6 0.25 1 2 3\n7 8 9 1 0 0 0\n";

#[test]
fn blocks_of_ptx_are_placed_by_their_transforms() {
    let second = PTX.replace("0 1 0 0\n-1 0 0 0", "1 0 0 0\n0 1 0 0").replace("100 200 300", "0 0 0");
    let all = opened("a.ptx", &(PTX.to_owned() + &second));
    assert_eq!(all.len(), 2);
    let placed = positions(&*all[0]);
    // Row vectors: (1, 2, 3) goes to (-2, 1, 3) by these rows.
    assert_eq!(placed[0], [98.0, 201.0, 303.0]);
    assert!(placed[1].iter().all(|v| v.is_nan()));
    assert_eq!(all[0].info().pose.scanner(), [100.0, 200.0, 300.0]);
    assert!(all[0].info().warnings[0].contains("rows of zeros, where nothing came back: 1"));
    assert_eq!(attributes(&*all[0]), ["Blue u8", "Green u8", "Intensity f32", "Red u8"]);
    assert_eq!(column(&*all[0], "Intensity"), Column::F32(vec![0.5, 0.5, 0.25, 1.0]));
    assert_eq!(positions(&*all[1])[3], [7.0, 8.0, 9.0]);
    assert!(positions(&*all[1])[1][0].is_nan());
}

#[test]
fn bad_blocks_are_refused_with_their_place() {
    let cases = [
        (
            PTX.replace("0 0 1 0\n", "0 0 0 0\n"),
            "line 1: expected a block with a transform, found the matrix is singular",
        ),
        (PTX.replace("4 5 6 0.25", "4 x 6 0.25"), "line 13: expected a row of numbers with x, y and z, found `x`"),
        (PTX.to_owned() + "7\n", "expected the columns and the rows of a block, a line each, found one number"),
        (PTX.to_owned() + "7\n7\n1 2 3\n", "expected the transform of a block, found the end of the file"),
        (PTX.to_owned() + "7\n7\n1 2 3 4\n", "expected 3 numbers of a block's header, found `1 2 3 4`"),
    ];
    for (text, expected) in cases {
        let error = refusal("a.ptx", &text);
        assert!(error.contains(expected), "{error}");
    }
    assert!(refusal("a.xyz", "1 2 3\n4 5\n6 7 8\n").contains("line 2: expected a row of numbers with x, y and z"));
    assert!(refusal("a.csv", "a,b,c\n1,2,3\n").contains("line 1: expected a row of numbers, or a line that names"));
    assert!(refusal("a.txt", &format!("1 2 3\n{}", "4".repeat(200_000))).contains("and no end of it"));
}

/// Programs mark them in four ways. A row whose first word is missing begins with a semicolon, too, where these separate.
#[test]
fn remarks_are_no_rows_and_rows_are_no_remarks() {
    for mark in ["#", "//", "%", ";"] {
        let text = format!("{mark} made by hand\n{mark} x y z Intensity\n1 2 3 7\n {mark} 9 9 9 9\n4 5 6 8\n");
        let all = opened("a.txt", &text);
        assert_eq!(column(&*all[0], "Intensity"), Column::U16(vec![7, 8]), "{mark}");
        assert_eq!(positions(&*all[0]), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{mark}");
    }
    let all = opened("a.csv", "name;x;y;z\n;1;2;3\n7;4;5;6\n;7;8;9\n");
    assert_eq!(positions(&*all[0]), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]);
    let all = opened("a.csv", ";x;y;z\n;1;2;3\n");
    assert_eq!(positions(&*all[0]), [[1.0, 2.0, 3.0]]);
    // In pieces, too, remarks between rows are not counted.
    let rows: String = (0..60_000).map(|i| format!("{i} 0 0\n% {i} 1 1\n")).collect();
    let all = opened("a.xyz", &rows);
    assert_eq!((all[0].info().records, positions(&*all[0]).len()), (60_000, 60_000));
}

#[test]
fn a_file_that_ends_in_a_row_gives_the_rows_before() {
    for (text, rows) in [("1 2 3\n4 5", 1), ("1 2 3\n4 5 6\n7", 2), ("1 2 3 4\n4 5 6", 1), ("1 2 3\n4 5 -", 1)] {
        let all = opened("a.xyz", text);
        let info = all[0].info();
        assert_eq!((info.records, info.missing), (rows, 1), "{text}");
        assert!(info.warnings.iter().any(|w| w.contains("in the middle of a row")));
        assert_eq!(positions(&*all[0]).len() as u64, rows);
    }
    assert_eq!(opened("a.xyz", "1 2 3\n4 5 6")[0].info().records, 2);
}

#[test]
fn a_row_that_is_cut_takes_no_column_with_it() {
    for text in ["1 2 3 10\n4 5 6 -20\n7 8 9 -", "1 2 3 10\n4 5 6 -20\n7 8 9", "1 2 3 10\n4 5 6 -20\n7 8 - 3"] {
        let all = opened("a.xyz", text);
        let info = all[0].info();
        assert_eq!((info.records, info.missing), (2, 1), "{text}");
        assert_eq!(attributes(&*all[0]), ["Intensity i16"], "{text}");
        assert_eq!(column(&*all[0], "Intensity"), Column::I16(vec![10, -20]));
        assert!(info.warnings.contains(&"the file ends in the middle of a row".to_owned()), "{text}");
        assert!(!info.warnings.iter().any(|w| w.contains("not kept")), "{text}");
    }
    // Whole rows: of words, and with a word that is no start of a number.
    let all = opened("a.csv", "x,y,z,a\n1,2,3,-\n4,5,6,-");
    assert_eq!((all[0].info().records, all[0].info().missing), (2, 0));
    let all = opened("a.csv", "x,y,z,a\n1,2,3,4\n4,5,6,oak");
    assert_eq!((all[0].info().records, all[0].info().missing), (2, 0));
}

#[test]
fn integers_stay_exact_whatever_they_are_called() {
    let all =
        opened("a.csv", "x,y,z,GpsTime,nx\n1,2,3,1609459200123456789,9007199254740993\n1,2,4,1609459200123456790,1\n");
    assert_eq!(column(&*all[0], "GpsTime"), Column::I64(vec![1_609_459_200_123_456_789, 1_609_459_200_123_456_790]));
    assert_eq!(attributes(&*all[0]), ["GpsTime i64", "NormalX i64"]);
    assert!(all[0].info().warnings.is_empty());
    let all = opened("a.csv", "x,y,z,GpsTime\n1,2,3,1609459200\n1,2,4,1609459201\n");
    assert_eq!(attributes(&*all[0]), ["GpsTime f64"]);
    // With a cell missing there is no integer that says so.
    let all = opened("a.csv", "x,y,z,a\n1,2,3,9007199254740993\n1,2,4,\n");
    assert_eq!(
        all[0].info().warnings,
        ["column `a` has numbers of more digits than a 64-bit float keeps: they are rounded"]
    );
    // 17 digits that a program wrote so that they come back are kept; more digits are not, behind a point or not.
    for (number, rounded) in [
        ("0.30000000000000004", false),
        ("1.12345678901234567", true),
        ("-123456.78901234567890123", true),
        ("12345678901234567890.5", true),
        ("9007199254740993.0", true),
        ("9007199254740992.0", false),
        ("1.7976931348623157e308", false),
        ("1.79769313486231574e308", true),
        ("0.000000000000000000000000000000125", false),
        ("500000000000000000000000.00", false),
    ] {
        let all = opened("a.csv", &format!("x,y,z,a\n1,2,3,{number}\n1,2,3,0.5\n"));
        assert_eq!(all[0].info().warnings.len(), usize::from(rounded), "{number} {:?}", all[0].info().warnings);
    }
}

#[test]
fn letters_of_axes_go_before_words_for_them() {
    let all = opened("a.csv", "x,y,z,height,easting\n1,2,3,4,5\n");
    assert_eq!(positions(&*all[0]), [[1.0, 2.0, 3.0]]);
    assert_eq!(attributes(&*all[0]), ["easting i32", "height i32"]);
    let all = opened("a.csv", "easting,northing,height,z\n1,2,3,4\n");
    assert_eq!(positions(&*all[0]), [[1.0, 2.0, 4.0]]);
}

#[test]
fn rows_that_lack_words_have_nan_there() {
    let all = opened("a.txt", "1 2 3 4 5\n1 2 3\n1 2 3 6 7\n");
    assert!(matches!(column(&*all[0], "column4"), Column::F32(v) if v[0] == 4.0 && v[1].is_nan() && v[2] == 6.0));
    assert!(all[0].info().warnings.iter().any(|w| w.contains("rows have 3 to 5 columns")));
    // Also where whole numbers are customary: zero would be a class.
    let all = opened("a.csv", "x,y,z,Classification\n1,2,3,2\n4,5,6,\n");
    assert!(matches!(column(&*all[0], "Classification"), Column::F32(v) if v[0] == 2.0 && v[1].is_nan()));
}

/// Large enough for several chunks: 200,000 rows.
#[test]
fn pieces_are_the_rows_in_order_whatever_their_size() {
    let text: String = (0..200_000).map(|i| format!("{i} {} 0.5 {}\n", i % 7, i % 50_000)).collect();
    let all = opened("a.xyz", &text);
    let source = &*all[0];
    let one = records(source, u64::MAX);
    assert_eq!(one.len() / source.info().layout.stride(), 200_000);
    assert!(source.pieces(50_000).len() > 2);
    assert!(records(source, 1) == one);
    let mut part = Vec::new();
    let mut sink = |run: &[u8]| {
        part.extend_from_slice(run);
        true
    };
    source.read(Piece { first: 123_456, records: 11 }, &mut sink).unwrap();
    let stride = source.info().layout.stride();
    assert!(part == one[123_456 * stride..123_467 * stride]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// A line-by-line reading by the standard library is the judge.
    #[test]
    fn rows_are_what_a_naive_reading_gives(
        rows in prop::collection::vec((-1e6_f64..1e6, -1e3_f64..1e3, any::<i32>(), 0_usize..9), 1..50),
        separator in prop::sample::select(vec![" ", "\t", ",", " , ", "   "]),
    ) {
        let text: String = rows
            .iter()
            .map(|(x, y, z, d)| format!("{x:.d$}{separator}{y:.d$}{separator}{z}{separator}{}\n", x / 3.0))
            .collect();
        let all = opened("a.txt", &text);
        let found = positions(&*all[0]);
        let extra = column(&*all[0], "Intensity");
        prop_assert_eq!(found.len(), rows.len());
        for (i, line) in text.lines().enumerate() {
            let words: Vec<f64> = line.split([' ', '\t', ',']).filter(|w| !w.is_empty()).map(|w| w.parse().unwrap()).collect();
            prop_assert!((0..3).all(|a| (found[i][a] - words[a]).abs() <= 1e-9 * words[a].abs().max(1.0)), "{}", line);
            prop_assert_eq!(extra.as_f64(i), words[3]);
        }
    }
}
