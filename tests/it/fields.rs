//! LAS's fields under the names and in the types that other programs give them.

use crate::support::{RawLas, esker, esker_ok};
use std::fs;
use std::path::Path;

fn json(arguments: &[&str]) -> serde_json::Value {
    serde_json::from_str(&esker_ok(&[arguments, &["--json"]].concat())).unwrap()
}

fn names(store: &str) -> Vec<String> {
    let info = json(&["info", store]);
    info["attributes"].as_array().unwrap().iter().map(|a| a["name"].as_str().unwrap().to_owned()).collect()
}

/// They were extra bytes, and LAS's own fields 0.
#[test]
fn columns_are_known_by_the_names_that_programs_give_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(at("a.csv"), "X,Y,Z,Class,Return Number,Number Of Returns,Gps Time\n1,2,3,2,1,2,5.5\n4,5,6,6,2,2,6.5\n")
        .unwrap();
    fs::write(at("b.csv"), "X,Y,Z,class,NumReturns,return_num\n1,2,3,2,1,1\n").unwrap();
    let (store, las) = (at("a.esker"), at("a.las"));
    esker_ok(&["ingest", &store, &at("a.csv")]);
    let found = names(&store);
    for name in ["Classification", "ReturnNumber", "NumberOfReturns", "GpsTime"] {
        assert!(found.iter().any(|n| n == name), "{name} in {found:?}");
    }
    esker_ok(&["query", &store, "-o", &las]);
    let records = RawLas::read(Path::new(&las)).unwrap().records;
    let mut fields: Vec<_> = records.iter().map(|r| (r[16], r[14] & 15, r[14] >> 4)).collect();
    fields.sort_unstable();
    assert_eq!(fields, [(2, 1, 2), (6, 2, 2)]);
    let other = at("b.esker");
    esker_ok(&["ingest", &other, &at("b.csv")]);
    let found = names(&other);
    assert!(
        ["Classification", "ReturnNumber", "NumberOfReturns"].iter().all(|n| found.iter().any(|f| f == n)),
        "{found:?}"
    );
}

/// A class that is no byte may be anything.
#[test]
fn which_of_two_meanings_a_name_has_in_a_filter_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let store = at("s.esker");
    fs::write(at("a.csv"), "X,Y,Z,Classification\n1,2,3,2\n").unwrap();
    esker_ok(&["ingest", &store, &at("a.csv")]);
    assert_eq!(esker_ok(&["query", &store, "--where", "Class = 2", "--count"]), "1\n");
    fs::write(at("c.csv"), "X,Y,Z,Class\n7,8,9,0.5\n").unwrap();
    esker_ok(&["ingest", &store, &at("c.csv")]);
    let output = esker(&["query", &store, "--where", "Class = 2", "--count"]);
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(
        told.contains("Class is taken as the attribute Class, which some scans have, not as Classification"),
        "{told}"
    );
}

/// CloudCompare writes all scalars as floats, and a cell without a value makes floats of a column.
#[test]
fn whole_numbers_in_other_types_are_in_the_fields_of_las_too() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n\
                  property float scalar_Classification\nproperty float scalar_Return_Number\n\
                  property float scalar_Number_Of_Returns\nproperty double scalar_Gps_Time\n\
                  property float scalar_Point_Source_ID\nproperty float scalar_User_Data\n\
                  property float scalar_Scan_Angle_Rank\nproperty float scalar_Intensity\nend_header\n";
    fs::write(at("a.ply"), format!("{header}1 2 3 2 1 3 5.5 700 9 -12.5 40000\n4 5 6 6 3 3 6.5 701 8 30 4\n")).unwrap();
    let (store, las) = (at("a.esker"), at("a.las"));
    esker_ok(&["ingest", &store, &at("a.ply")]);
    let output = esker(&["query", &store, "-o", &las]);
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(told.contains("Classification is f32 here: LAS's own field has it as the nearest whole number"), "{told}");
    let records = RawLas::read(Path::new(&las)).unwrap().records;
    let word = |r: &[u8], i: usize| u16::from_le_bytes([r[i], r[i + 1]]);
    let time = |r: &[u8]| f64::from_le_bytes(r[22..30].try_into().unwrap());
    let mut fields: Vec<_> = records
        .iter()
        .map(|r| {
            (r[16], r[14] & 15, r[14] >> 4, r[17], word(r, 18) as i16, word(r, 20), word(r, 12), time(r).to_string())
        })
        .collect();
    fields.sort();
    assert_eq!(
        fields,
        [(2, 1, 3, 9, -2083, 700, 40_000, "5.5".to_owned()), (6, 3, 3, 8, 5000, 701, 4, "6.5".to_owned())]
    );
    // Beside a scan that has them as LAS does, each has its own.
    fs::write(at("b.csv"), "x,y,z,Classification,Intensity\n7,8,9,5,77\n").unwrap();
    esker_ok(&["ingest", &store, &at("b.csv")]);
    esker_ok(&["query", &store, "-o", &las, "--force"]);
    let records = RawLas::read(Path::new(&las)).unwrap().records;
    let mut fields: Vec<_> = records.iter().map(|r| (r[16], word(r, 12))).collect();
    fields.sort_unstable();
    assert_eq!(fields, [(2, 40_000), (5, 77), (6, 4)]);
    // What does not fit is not bent.
    fs::write(at("c.csv"), "x,y,z,Classification\n1,2,3,300\n1,2,4,\n").unwrap();
    let wide = at("c.esker");
    esker_ok(&["ingest", &wide, &at("c.csv")]);
    let output = esker(&["query", &wide, "-o", &at("c.las")]);
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(told.contains("which LAS's own field can't hold: that is 0"), "{told}");
}

#[test]
fn headers_with_units_and_short_words_name_coordinates() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let headers = ["E [m];N [m];H [m]", "E(m);N(m);h(m)", "lon;lat;alt", "lng;lat;height", "Ost;Nord;Höhe", "X;Y;H"];
    for (i, header) in headers.into_iter().enumerate() {
        let (file, store) = (at(&format!("{i}.csv")), at(&format!("{i}.esker")));
        fs::write(&file, format!("{header}\n11.5;48.25;500.5\n")).unwrap();
        esker_ok(&["ingest", &store, &file]);
        assert_eq!(esker_ok(&["query", &store, "-o", "-", "--format", "xyz"]), "11.5 48.25 500.5\n", "{header}");
    }
    // Beside x, y and z such words are other things.
    fs::write(at("z.csv"), "x,y,z,h\n1,2,3,4\n").unwrap();
    esker_ok(&["ingest", &at("z.esker"), &at("z.csv")]);
    assert!(names(&at("z.esker")).contains(&"h".to_owned()));
}

#[test]
fn columns_of_degrees_have_more_digits_than_metres() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(
        at("deg.csv"),
        "longitude,latitude,height\n11.57549012,48.13743256,519.25\n11.57549345,48.13743999,519.5\n",
    )
    .unwrap();
    let report = json(&["ingest", &at("deg.esker"), &at("deg.csv")]);
    assert_eq!(report["scans"][0]["positions"], "exact", "{report}");
    // Columns of metres are none of degrees, whatever they are called.
    fs::write(at("m.csv"), "lon,lat,z\n689990.5,5330000.25,500\n689991,5330001,501\n").unwrap();
    let report = json(&["ingest", &at("m.esker"), &at("m.csv")]);
    assert!(!report["notes"].to_string().contains("degrees"), "{report}");
}

/// A scan without a point in the file changed its form and brought its columns along.
#[test]
fn a_las_file_has_room_for_what_its_points_have() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (store, las) = (at("s.esker"), at("out.las"));
    esker_ok(&["generate", "terrain", "--points", "2000", "-o", &at("a.las")]);
    esker_ok(&["ingest", &store, &at("a.las")]);
    let head = |options: &[&str]| {
        let output = esker(&[&["query", &store, "-o", &las, "--force"], options].concat());
        assert!(output.status.success(), "{output:?}");
        let header = RawLas::read(Path::new(&las)).unwrap().header;
        let told = String::from_utf8(output.stderr).unwrap();
        (header.point_data_record_format, header.point_data_record_length, told)
    };
    let alone = head(&[]);
    assert_eq!(alone.2, "");
    fs::write(at("b.csv"), "x,y,z,quality,depth\n689990,5330000,500,0.5,7\n689991,5330001,500,0.25,8\n").unwrap();
    esker_ok(&["ingest", &store, &at("b.csv")]);
    assert!(head(&[]).2.contains("quality"), "the points of both need room");
    // These have no class, or lie elsewhere, or are of another scan.
    for options in [&["--where", "Classification >= 0"][..], &["--where", "GpsTime > 0 and Z < 1e6"], &["--scan", "a"]]
    {
        assert_eq!(head(options), alone, "{options:?}");
    }
    // Whoever may have a point in the file has room: here only they do.
    let (_, length, _) = head(&["--where", "quality > 0.3 or Classification > 200"]);
    assert!(length > 30 && RawLas::read(Path::new(&las)).unwrap().records.len() == 1, "{length}");
    // Where kinds of a colour meet the filter compares what all together have, and that is what goes out.
    let colours = at("c.esker");
    let ply = |name: &str, columns: &str, row: &str| {
        let head = "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\n";
        let colour = "property ushort red\nproperty ushort green\nproperty ushort blue\n";
        fs::write(at(name), format!("{head}{colour}{columns}end_header\n{row}\n")).unwrap();
    };
    ply("eight.ply", "property uchar quality\n", "1 2 3 200 0 0 1");
    ply("sixteen.ply", "", "4 5 6 300 0 0");
    esker_ok(&["ingest", &colours, &at("eight.ply"), &at("sixteen.ply")]);
    let both = ["query", &colours, "--where", "quality = 1 and Red = 51400", "-o", &las, "--force"];
    esker_ok(&both);
    let record = &RawLas::read(Path::new(&las)).unwrap().records[0];
    assert_eq!(u16::from_le_bytes([record[30], record[31]]), 51_400);
    // Other forms have the same columns everywhere.
    let rows =
        esker_ok(&["query", &store, "--where", "Classification >= 0", "--capacity", "1", "-o", "-", "--format", "csv"]);
    assert!(rows.lines().next().unwrap().contains("quality"), "{rows}");
}

#[test]
fn values_of_a_byte_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let store = at("s.esker");
    // More than one node has.
    let rows: String =
        (0..80_000).map(|i| format!("{i},{},0,{},{}\n", i % 7, [2, 2, 5, 255][i % 4], i % 256)).collect();
    fs::write(at("a.csv"), format!("x,y,z,Classification,Red\n{rows}")).unwrap();
    fs::write(at("b.csv"), "x,y,z\n1,2,3\n").unwrap();
    esker_ok(&["ingest", &store, &at("a.csv"), &at("b.csv")]);
    let counted = |options: &[&str]| {
        let all = json(&[&["query", &store], options].concat());
        let found = all["attributes"].as_array().unwrap().iter().find(|a| a["name"] == "Classification").unwrap();
        let pair = |c: &serde_json::Value| (c["value"].as_u64().unwrap(), c["points"].as_u64().unwrap());
        found["counts"].as_array().unwrap().iter().map(pair).collect::<Vec<_>>()
    };
    assert_eq!(counted(&[]), [(2, 40_000), (5, 20_000), (255, 20_000)], "a point without a class is none of class 0");
    assert_eq!(counted(&["--where", "x < 4", "--threads", "1"]), [(2, 2), (5, 1), (255, 1)]);
    assert_eq!(counted(&["--where", "Classification = 7"]), []);
    assert!(
        esker_ok(&["query", &store]).contains("Classification                   2: 40,000  5: 20,000  255: 20,000\n")
    );
}

fn las_of(folder: &Path, file: &str, text: &str, read: impl Fn(&[u8]) -> u16) -> (Vec<u16>, String) {
    let at = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    fs::write(at(file), text).unwrap();
    let (store, las) = (at(&format!("{file}.esker")), at(&format!("{file}.las")));
    esker_ok(&["ingest", &store, &at(file)]);
    let output = esker(&["query", &store, "-o", &las]);
    assert!(output.status.success(), "{output:?}");
    let mut values: Vec<_> = RawLas::read(Path::new(&las)).unwrap().records.iter().map(|r| read(r)).collect();
    values.sort_unstable();
    (values, String::from_utf8(output.stderr).unwrap())
}

/// The field had the sum of both.
#[test]
fn two_columns_of_one_scan_are_not_added_up() {
    let folder = tempfile::tempdir().unwrap();
    let word = |i: usize| move |r: &[u8]| u16::from_le_bytes([r[i], r[i + 1]]);
    let head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n";
    let intensities = format!(
        "{head}property ushort intensity\nproperty float scalar_Intensity\nend_header\n0 0 0 1000 1000\n1 0 0 40000 40000\n"
    );
    assert_eq!(las_of(folder.path(), "i.ply", &intensities, word(12)).0, [1000, 40_000]);
    let class = |r: &[u8]| u16::from(r[16]);
    let classes =
        format!("{head}property uchar class\nproperty float scalar_Classification\nend_header\n0 0 0 2 2\n1 0 0 6 6\n");
    assert_eq!(las_of(folder.path(), "c.ply", &classes, class).0, [2, 6]);
    let both = "x,y,z,Class,Classification\n1,2,3,2,2.5\n4,5,6,6,6.5\n";
    assert_eq!(las_of(folder.path(), "c.csv", both, class).0, [3, 7], "the one that is called so, to the nearest");
}

/// They had the middle of the others' range.
#[test]
fn points_without_an_intensity_have_none_beside_others() {
    let folder = tempfile::tempdir().unwrap();
    let word = |i: usize| move |r: &[u8]| u16::from_le_bytes([r[i], r[i + 1]]);
    let pts = "3\n1 2 3 -2000\n1 2 4 0\n1 2 5 2000\n";
    let (all, _) = las_of(folder.path(), "a.pts", pts, word(12));
    assert_eq!(all, [0, 32_768, 65_535]);
    let store = folder.path().join("a.pts.esker").to_str().unwrap().to_owned();
    let more = folder.path().join("b.xyz").to_str().unwrap().to_owned();
    fs::write(&more, "7 8 9\n").unwrap();
    esker_ok(&["ingest", &store, &more]);
    let las = folder.path().join("both.las").to_str().unwrap().to_owned();
    let output = esker(&["query", &store, "-o", &las]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("can't hold"), "{output:?}");
    let records = RawLas::read(Path::new(&las)).unwrap().records;
    assert!(records.iter().all(|r| word(12)(r) == 0));
}

/// No file was written.
#[test]
fn more_returns_than_the_field_counts_are_in_an_extra_byte() {
    let folder = tempfile::tempdir().unwrap();
    let many = "x,y,z,NumReturns,ReturnNumber\n1,2,3,31,1\n1,2,4,3,2\n";
    let (returns, told) = las_of(folder.path(), "n.csv", many, |r| u16::from(r[14] >> 4));
    assert!(returns == [0, 0] && told.contains("NumberOfReturns"), "{told}");
    // Those of another scan that has them as LAS does stay where they are.
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let store = at("m.esker");
    let head = "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\n";
    fs::write(at("f.ply"), format!("{head}property float scalar_NumberOfReturns\nend_header\n7 8 9 31\n")).unwrap();
    fs::write(at("u.csv"), "x,y,z,NumberOfReturns,ReturnNumber\n1,2,3,3,2\n").unwrap();
    esker_ok(&["ingest", &store, &at("f.ply"), &at("u.csv")]);
    esker_ok(&["query", &store, "-o", &at("m.las")]);
    let mut found: Vec<_> =
        RawLas::read(Path::new(&at("m.las"))).unwrap().records.iter().map(|r| (r[14] & 15, r[14] >> 4)).collect();
    found.sort_unstable();
    assert_eq!(found, [(0, 0), (2, 3)]);
}

/// `class` became the class, and the class something else.
#[test]
fn an_exact_name_goes_before_a_synonym_in_any_order() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for (i, (columns, row)) in
        [("class,Classification", "7,2"), ("Classification,class", "2,7")].into_iter().enumerate()
    {
        let (file, store) = (at(&format!("{i}.csv")), at(&format!("{i}.esker")));
        fs::write(&file, format!("x,y,z,{columns}\n1,2,3,{row}\n")).unwrap();
        esker_ok(&["ingest", &store, &file]);
        let found = names(&store);
        assert!(found.contains(&"Classification".into()) && found.contains(&"class".into()), "{found:?}");
        assert_eq!(esker_ok(&["query", &store, "--where", "Classification = 2 and \"class\" = 7", "--count"]), "1\n");
    }
}
