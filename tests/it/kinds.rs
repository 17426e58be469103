//! One name, several kinds: extra bytes of another scale, offset or no-data value in each scan. What comes out is each
//! point's own value, against a naive reading of the files.

use crate::support::{TinyLas, esker, esker_ok, with_vlr};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// An extra byte of a LAS file, and its stored values.
#[derive(Clone)]
struct Extra {
    name: &'static str,
    /// In the words of the specification: 2 u8, 4 i16, 7 u64, 9 f32.
    code: u8,
    scaling: Option<(f64, f64)>,
    no_data: Option<Vec<u8>>,
    values: Vec<Vec<u8>>,
}

impl Extra {
    fn i16(scaling: Option<(f64, f64)>, no_data: Option<i16>, values: &[i16]) -> Self {
        let values = values.iter().map(|v| v.to_le_bytes().to_vec()).collect();
        let no_data = no_data.map(|v| i64::from(v).to_le_bytes().to_vec());
        Self { name: "height", code: 4, scaling, no_data, values }
    }

    fn f32(no_data: Option<f32>, values: &[f32]) -> Self {
        let values = values.iter().map(|v| v.to_le_bytes().to_vec()).collect();
        Self {
            name: "height",
            code: 9,
            scaling: None,
            no_data: no_data.map(|v| f64::from(v).to_le_bytes().to_vec()),
            values,
        }
    }

    fn u64(no_data: Option<u64>, values: &[u64]) -> Self {
        let values = values.iter().map(|v| v.to_le_bytes().to_vec()).collect();
        Self { name: "stamp", code: 7, scaling: None, no_data: no_data.map(|v| v.to_le_bytes().to_vec()), values }
    }

    /// A LAS file whose points have these values in their order, the first at `x`, the others one to its right.
    fn write(&self, path: &str, x: i32) {
        let mut las = TinyLas::new(0);
        (0..self.values.len()).for_each(|i| las.push([x + 100 * i as i32, 0, 0], 7));
        let plain = las.bytes();
        let mut descriptor = vec![0; 192];
        descriptor[2] = self.code;
        descriptor[4..4 + self.name.len()].copy_from_slice(self.name.as_bytes());
        if let Some(no_data) = &self.no_data {
            descriptor[3] |= 1;
            descriptor[40..48].copy_from_slice(no_data);
        }
        if let Some((scale, offset)) = self.scaling {
            descriptor[3] |= 0b1_1000;
            descriptor[112..120].copy_from_slice(&scale.to_le_bytes());
            descriptor[136..144].copy_from_slice(&offset.to_le_bytes());
        }
        let mut file = with_vlr(&plain[..227], "LASF_Spec", 4, &descriptor);
        file[105..107].copy_from_slice(&(20 + self.values[0].len() as u16).to_le_bytes());
        for (record, value) in plain[227..].chunks(20).zip(&self.values) {
            file.extend(record);
            file.extend(value);
        }
        fs::write(path, file).unwrap();
    }
}

/// Files in a folder of their own.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn at(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    /// A store of these files, made anew, by one command for each of `groups`.
    fn store(&self, name: &str, groups: &[&[&str]]) -> String {
        let store = self.at(name);
        let _ = fs::remove_file(&store);
        for group in groups {
            let files: Vec<String> = group.iter().map(|f| self.at(&format!("{f}.las"))).collect();
            let files: Vec<&str> = files.iter().map(String::as_str).collect();
            esker_ok(&[&["ingest", &store], &files[..]].concat());
        }
        store
    }
}

/// The rows of a query's CSV by X, without X, Y and Z.
fn rows(arguments: &[&str]) -> BTreeMap<String, String> {
    let text = esker_ok(&[&["query"], arguments, &["-o", "-", "--format", "csv"]].concat());
    let row = |line: &str| {
        let words: Vec<&str> = line.splitn(4, ',').collect();
        (words[0].to_owned(), words[3].to_owned())
    };
    text.lines().skip(1).map(row).collect()
}

fn values(arguments: &[&str]) -> Vec<String> {
    rows(arguments).into_values().collect()
}

fn count(store: &str, filter: &str) -> u64 {
    esker_ok(&["query", store, "--where", filter, "--count"]).trim().parse().unwrap()
}

/// Five scans of one place, each at its own hundredths of X.
fn five(folder: &Folder) {
    let raw = [0, 100, 200, 300, 400];
    let kinds =
        [(Some((0.01, 0.0)), None), (Some((0.001, 0.0)), None), (None, Some(100)), (None, Some(200)), (None, None)];
    for (i, (scaling, no_data)) in (1..).zip(kinds) {
        Extra::i16(scaling, no_data, &raw).write(&folder.at(&format!("e{i}.las")), i);
    }
}

const FIVE: [(&str, [&str; 5]); 5] = [
    ("e1", ["0", "1", "2", "3", "4"]),
    ("e2", ["0", "0.1", "0.2", "0.3", "0.4"]),
    ("e3", ["0", "", "200", "300", "400"]),
    ("e4", ["0", "100", "", "300", "400"]),
    ("e5", ["0", "100", "200", "300", "400"]),
];

/// The scale, offset and no-data value of the first scan were taken for those of all others.
#[test]
fn each_scan_keeps_its_own_scale_and_no_data_value_in_any_order() {
    let folder = Folder::new();
    five(&folder);
    let orders: [&[&[&str]]; 4] = [
        &[&["e1", "e2", "e3", "e4", "e5"]],
        &[&["e5", "e4", "e3", "e2", "e1"]],
        &[&["e3"], &["e1", "e5"], &["e2"], &["e4"]],
        &[&["e5"], &["e3"], &["e2"], &["e4"], &["e1"]],
    ];
    let (a, b) = (folder.store("a.esker", &[&["e1", "e4"]]), folder.store("b.esker", &[&["e2", "e3", "e5"]]));
    let mut stores: Vec<String> =
        (0..).zip(orders).map(|(i, order)| folder.store(&format!("{i}.esker"), order)).collect();
    for (name, first, second) in [("ab.esker", &a, &b), ("ba.esker", &b, &a)] {
        esker_ok(&["merge", &folder.at(name), first, second]);
        stores.push(folder.at(name));
    }
    let digest = esker_ok(&["digest", &stores[0]]);
    for store in &stores {
        assert_eq!(esker_ok(&["digest", store]), digest, "{store}");
        esker_ok(&["verify", "--deep", store]);
        let all = rows(&[store, "--attributes", "height"]);
        assert_eq!(all.len(), 25);
        for (i, (scan, expected)) in (1..).zip(FIVE) {
            assert_eq!(values(&[store, "--scan", scan, "--attributes", "height"]), expected, "{store} {scan}");
            // Together they are one column.
            let of_scan = |(x, value): (&String, &String)| x.ends_with(&format!("0{i}")).then(|| value.clone());
            assert_eq!(all.iter().filter_map(of_scan).collect::<Vec<_>>(), expected, "{store} {scan}");
            // As its source was, bit for bit, also where all attributes are written.
            let out = folder.at("one.las");
            esker_ok(&["query", store, "--scan", scan, "-o", &out, "--force"]);
            let (written, source) = (fs::read(&out).unwrap(), fs::read(folder.at(&format!("{scan}.las"))).unwrap());
            let sorted = |bytes: &[u8]| {
                let mut records: Vec<Vec<u8>> = bytes[227 + 54 + 192..].chunks(22).map(<[u8]>::to_vec).collect();
                records.sort();
                records
            };
            assert_eq!(written[227 + 54..][..192], source[227 + 54..][..192], "{store} {scan}");
            assert_eq!(sorted(&written), sorted(&source), "{store} {scan}");
        }
        for (filter, expected) in [
            ("height = 4", 1),
            ("height = 0.3", 1),
            ("height is null", 2),
            ("height = 100", 2),
            ("height > 1", 3 + 3 + 3 + 4),
            ("raw(height) = 100", 5),
            ("raw(height) is null", 0),
            ("height < Intensity", 5 + 5 + 1 + 1 + 1),
        ] {
            assert_eq!(count(store, filter), expected, "{store} {filter}");
        }
    }
}

/// Merged files say what their values mean.
#[test]
fn values_of_several_scales_go_through_files_as_real_ones() {
    let folder = Folder::new();
    five(&folder);
    let store = folder.store("s.esker", &[&["e1", "e2", "e3", "e4", "e5"]]);
    let expected = rows(&[&store, "--attributes", "height"]);
    for name in ["all.las", "all.laz", "all.ply"] {
        let output = esker(&["query", &store, "--attributes", "height", "-o", &folder.at(name)]);
        let told = String::from_utf8(output.stderr).unwrap();
        assert!(
            told.contains("height is scaled in different ways: real values (f64), NaN where there is no data"),
            "{told}"
        );
        let again = folder.at("again.esker");
        let _ = fs::remove_file(&again);
        esker_ok(&["ingest", &again, &folder.at(name), "--quantum", "0.01"]);
        // PLY has no word for "no data".
        let found: BTreeMap<_, _> = rows(&[&again, "--attributes", "height"])
            .into_iter()
            .map(|(x, value)| (x, if value == "NaN" { String::new() } else { value }))
            .collect();
        assert_eq!(found, expected, "{name}");
        if name.ends_with(".laz") {
            assert_eq!(count(&again, "height is null"), 2);
        }
    }
    // In f64, 3 times 0.1 is not 0.3, and 7 times 0.01 not 0.07.
    Extra::i16(Some((0.1, 0.0)), None, &[3, -7]).write(&folder.at("tenths.las"), 1);
    Extra::i16(Some((0.01, 0.0)), None, &[3, 7]).write(&folder.at("hundredths.las"), 2);
    let store = folder.store("digits.esker", &[&["tenths", "hundredths"]]);
    assert_eq!(values(&[&store, "--attributes", "height"]), ["0.3", "0.03", "-0.7", "0.07"]);
}

/// Where only "no data" is told in several ways the stored values stay.
#[test]
fn several_no_data_values_become_one_that_is_no_value() {
    let folder = Folder::new();
    five(&folder);
    let store = folder.store("s.esker", &[&["e5", "e3", "e4"]]);
    let out = folder.at("out.las");
    let output = esker(&["query", &store, "--attributes", "height", "-o", &out]);
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(told.contains("height has several no-data values: one for all, -32768 as it is stored"), "{told}");
    let found = String::from_utf8_lossy(&fs::read(&out).unwrap()).matches("height").count();
    assert_eq!(found, 1);
    let again = folder.store("again.esker", &[&["out"]]);
    assert_eq!(rows(&[&again, "--attributes", "height"]), rows(&[&store, "--attributes", "height"]));
    assert_eq!([count(&again, "height is null"), count(&again, "raw(height) = -32768")], [2, 2]);

    // -9999 is a height of one scan, and none of the other; it is free where both mean it so, or one never has it.
    Extra::f32(Some(-9999.0), &[1.5, -9999.0]).write(&folder.at("hollow.las"), 1);
    Extra::f32(None, &[2.5, 3.5]).write(&folder.at("plain.las"), 2);
    Extra::f32(None, &[2.5, -9999.0]).write(&folder.at("deep.las"), 2);
    let free = folder.store("free.esker", &[&["plain", "hollow"]]);
    assert_eq!(values(&[&free, "--attributes", "height"]), ["1.5", "2.5", "", "3.5"]);
    let output = esker(&["query", &free, "--attributes", "height", "-o", &folder.at("free.las")]);
    assert!(String::from_utf8(output.stderr).unwrap().contains("one for all, -9999 as it is stored"));
    let taken = folder.store("taken.esker", &[&["deep", "hollow"]]);
    assert_eq!(values(&[&taken, "--attributes", "height"]), ["1.5", "2.5", "", "-9999"]);
    assert_eq!(count(&taken, "height is null"), 1);
}

/// Of the least and greatest values that each file has of its own points they differed.
#[test]
fn scans_that_differ_in_the_ends_of_extra_bytes_agree() {
    let folder = Folder::new();
    for (name, x, ends) in [("a", 1, [1_i64, 5]), ("b", 2, [-7, 9])] {
        let path = folder.at(&format!("{name}.las"));
        Extra::i16(Some((0.01, 0.0)), None, &[ends[0] as i16, ends[1] as i16]).write(&path, x);
        let mut file = fs::read(&path).unwrap();
        // Behind the header and the head of the record: options, least and greatest.
        file[227 + 54 + 3] |= 0b110;
        for (at, end) in [64, 88].into_iter().zip(ends) {
            file[227 + 54 + at..][..8].copy_from_slice(&end.to_le_bytes());
        }
        fs::write(path, file).unwrap();
    }
    let store = folder.store("s.esker", &[&["a", "b"]]);
    let described = |arguments: &[&str]| {
        let out = folder.at("out.las");
        let output = esker(&[&["query", &store, "--force", "-o", &out], arguments].concat());
        assert!(output.status.success() && !String::from_utf8_lossy(&output.stderr).contains("differ"), "{output:?}");
        let file = fs::read(&out).unwrap();
        // The form is kept: LAS 1.2, point format 0.
        assert_eq!((file[24..26].to_vec(), file[104]), (fs::read(folder.at("a.las")).unwrap()[24..26].to_vec(), 0));
        let at = file.windows(6).position(|w| w == b"height").unwrap() - 4;
        (file[at + 3], file[at + 64..at + 72].to_vec())
    };
    assert_eq!(described(&["--scan", "b"]), (0b1_1110, (-7_i64).to_le_bytes().to_vec()));
    assert_eq!(described(&[]), (0b1_1000, vec![0; 8]));
}

/// 0, which is stored for them, was a height of 100 metres.
#[test]
fn points_whose_scan_lacks_a_scaled_attribute_have_no_data() {
    let folder = Folder::new();
    let mut las = TinyLas::new(0);
    (0..2).for_each(|i| las.push([2 + 100 * i, 0, 0], 7));
    fs::write(folder.at("bare.las"), las.bytes()).unwrap();
    let scaling = Some((0.05, 100.0));
    for (no_data, told) in [(Some(-9999), "-9999"), (None, "-32768")] {
        Extra::i16(scaling, no_data, &[-2000, 999]).write(&folder.at("tall.las"), 1);
        let store = folder.store("s.esker", &[&["bare", "tall"]]);
        let asked = [&store, "--attributes", "height"];
        assert_eq!(values(&asked), ["0", "", "149.95", ""]);
        assert_eq!([count(&store, "height is null"), count(&store, "height = 149.95")], [2, 1]);
        let out = folder.at("out.las");
        let output = esker(&["query", &store, "--force", "-o", &out]);
        let note = String::from_utf8(output.stderr).unwrap();
        assert!(note.contains("some of the scans have no height: their points have no data there"), "{note}");
        let again = folder.store("again.esker", &[&["out"]]);
        assert_eq!(rows(&[&again, "--attributes", "height"]), rows(&asked));
        assert_eq!(count(&again, &format!("height is null and raw(height) = {told}")), 2);
    }
    // Every stored value is a height: then it is real ones that come out.
    Extra::i16(scaling, None, &[i16::MIN, i16::MAX]).write(&folder.at("tall.las"), 1);
    let store = folder.store("s.esker", &[&["bare", "tall"]]);
    assert_eq!(values(&[&store, "--attributes", "height"]), ["-1538.4", "", "1738.35", ""]);
    // Without a scale it is 0, which is what nothing is elsewhere.
    Extra::i16(None, None, &[5, 6]).write(&folder.at("tall.las"), 1);
    let store = folder.store("s.esker", &[&["bare", "tall"]]);
    assert_eq!(values(&[&store, "--attributes", "height"]), ["5", "0", "6", "0"]);
    assert_eq!(values(&[&store, "--scan", "tall", "--attributes", "height"]), ["5", "6"]);
}

/// An f64 would not hold them.
#[test]
fn integers_of_many_digits_are_not_joined() {
    let folder = Folder::new();
    let all = [0, 5, u64::MAX - 1, u64::MAX];
    Extra::u64(Some(5), &all).write(&folder.at("a.las"), 1);
    Extra::u64(None, &all).write(&folder.at("b.las"), 2);
    let store = folder.store("s.esker", &[&["b", "a"]]);
    let text = esker_ok(&["query", &store, "--attributes", "stamp", "-o", "-", "--format", "csv"]);
    assert!(text.starts_with("X,Y,Z,stamp,stamp.2\n"), "{text}");
    let max = u64::MAX.to_string();
    let b = rows(&[&store, "--attributes", "stamp"]).into_iter().filter(|(x, _)| x.ends_with("02"));
    let b: Vec<String> = b.map(|(_, v)| v).collect();
    assert_eq!(b, ["0,".to_owned(), "5,".into(), format!("{},", u64::MAX - 1), format!("{max},")]);
    assert_eq!(values(&[&store, "--scan", "a", "--attributes", "stamp"])[1], "");
    // Small ones are.
    Extra::u64(Some(5), &[0, 5, 255]).write(&folder.at("a.las"), 1);
    Extra::u64(None, &[0, 5, u64::MAX]).write(&folder.at("b.las"), 2);
    let store = folder.store("s.esker", &[&["b", "a"]]);
    let found = rows(&[&store, "--attributes", "stamp"]);
    assert_eq!(found.len(), 6);
}

/// The metadata of a scan that was removed went on to be that of the others.
#[test]
fn what_no_scan_has_any_more_is_forgotten() {
    let folder = Folder::new();
    five(&folder);
    let heights = |store: &str| -> Vec<serde_json::Value> {
        let info: serde_json::Value = serde_json::from_str(&esker_ok(&["info", "--json", store])).unwrap();
        let all = info["attributes"].as_array().unwrap().iter();
        all.filter(|a| a["name"] == "height").cloned().collect()
    };
    let store = folder.store("s.esker", &[&["e1", "e2"]]);
    assert_eq!(heights(&store).len(), 2);
    esker_ok(&["remove", &store, "e1"]);
    let found = heights(&store);
    assert_eq!(found.len(), 1);
    assert_eq!(found[0]["scaling"], serde_json::json!({ "scale": 0.001, "offset": 0.0 }));
    assert_eq!(values(&[&store, "--attributes", "height"]), FIVE[1].1);
    esker_ok(&["replace", &store, "e2", &folder.at("e3.las")]);
    let found = heights(&store);
    assert_eq!((found.len(), found[0]["no_data"].as_f64()), (1, Some(100.0)));
    // As if they had never been there.
    assert_eq!(esker_ok(&["digest", &store]), esker_ok(&["digest", &folder.store("t.esker", &[&["e3"]])]));
    esker_ok(&["ingest", &store, &folder.at("e5.las"), &folder.at("e1.las")]);
    esker_ok(&["verify", "--deep", &store]);
    esker_ok(&["compact", &store]);
    assert_eq!(values(&[&store, "--scan", "e5", "--attributes", "height"]), FIVE[4].1);
    assert!(Path::new(&store).exists());
}

/// Stores whose points differ in nothing but what they mean had one digest.
#[test]
fn the_digest_tells_what_values_mean() {
    let folder = Folder::new();
    let kinds = [(None, None), (Some((0.01, 0.0)), None), (Some((0.01, 1.0)), None), (None, Some(0)), (None, Some(7))];
    let mut digests = std::collections::BTreeSet::new();
    for (scaling, no_data) in kinds {
        Extra::i16(scaling, no_data, &[0, 7, 9]).write(&folder.at("a.las"), 0);
        let digest = esker_ok(&["digest", &folder.store("a.esker", &[&["a"]])]);
        // The first hash is of the points alone, whose scans may be any.
        digests.insert(digest.split_whitespace().find(|w| w.len() == 64).unwrap().to_owned());
    }
    assert_eq!(digests.len(), kinds.len());
}

/// Filters saw 18 degrees where the answer gives 3000 steps, and 200 where it gives 51,400.
#[test]
fn filters_see_what_the_answer_gives_where_kinds_meet() {
    let folder = Folder::new();
    let degrees = |name: &str, x: i32, angles: &[i8]| {
        let mut las = TinyLas::new(0);
        (0..angles.len()).for_each(|i| las.push([x + 100 * i as i32, 0, 0], 7));
        let mut bytes = las.bytes();
        angles.iter().enumerate().for_each(|(i, angle)| bytes[227 + 20 * i + 16] = angle.cast_unsigned());
        fs::write(folder.at(name), bytes).unwrap();
    };
    degrees("degrees.las", 1, &[-90, -18, 0, 18, 30]);
    degrees("b.las", 2, &[-2, 18, 31]);
    let other = folder.store("b.esker", &[&["b"]]);
    // As LAS 1.4 has it.
    esker_ok(&["query", &other, "--attributes", "ScanAngleRank", "-o", &folder.at("steps.las")]);
    let angles = folder.store("angles.esker", &[&["degrees", "steps"]]);

    fs::write(folder.at("eight.csv"), "x,y,z,red,green,blue\n0.01,0,0,1,2,3\n1.01,0,0,200,255,0\n").unwrap();
    fs::write(folder.at("sixteen.csv"), "x,y,z,red,green,blue\n0.02,0,0,257,2,3\n1.02,0,0,300,65535,0\n").unwrap();
    let colors = folder.at("colors.esker");
    esker_ok(&["ingest", &colors, &folder.at("eight.csv"), &folder.at("sixteen.csv")]);

    // Eight bits in fields of sixteen.
    let deep = |name: &str, x: i32, values: &[u16]| {
        let mut las = TinyLas::new(2);
        (0..values.len()).for_each(|i| las.push([x + 100 * i as i32, 0, 0], 7));
        let mut bytes = las.bytes();
        for (i, value) in values.iter().enumerate() {
            (0..3).for_each(|c| bytes[227 + 26 * i + 20 + 2 * c..][..2].copy_from_slice(&value.to_le_bytes()));
        }
        fs::write(folder.at(name), bytes).unwrap();
    };
    deep("low.las", 1, &[0, 1, 200, 255]);
    deep("high.las", 2, &[1, 257, 51_400, 65_535]);
    let fields = folder.store("fields.esker", &[&["low", "high"]]);

    let check = |store: &str, name: &str, region: &[&str], numbers: &[f64], several: bool| {
        let given = rows(&[&[store, "--attributes", name], region].concat());
        let given: Vec<f64> = given.values().map(|v| v.parse().unwrap()).collect();
        for number in numbers {
            for (relation, holds) in
                [("=", f64::eq as fn(&f64, &f64) -> bool), ("<", f64::lt), (">=", f64::ge), ("<>", f64::ne)]
            {
                let filter = format!("{name} {relation} {number}");
                let expected = given.iter().filter(|v| holds(v, number)).count();
                let found = values(&[&[store, "--attributes", name, "--where", &filter], region].concat());
                assert_eq!(found.len(), expected, "{store} {region:?} {filter}: {given:?}");
                if several {
                    continue;
                }
                let pair = format!("{name} {relation} Intensity");
                let expected = given.iter().filter(|v| holds(v, &7.0)).count();
                let found = values(&[&[store, "--attributes", name, "--where", &pair], region].concat());
                assert_eq!(found.len(), expected, "{store} {region:?} {pair}: {given:?}");
            }
        }
        given
    };
    let steps = [-3000.0, 0.0, 18.0, 20.0, 2999.5, 3000.0, 5000.0, 5167.0];
    assert_eq!(check(&angles, "ScanAngleRank", &[], &steps, false).len(), 8);
    // What is told of a region is what it gives: here degrees alone.
    let left = ["--box", "4,-1,9,1"];
    assert_eq!(check(&angles, "ScanAngleRank", &left, &[18.0, 30.0, 5000.0], false), [30.0]);
    assert_eq!(count(&angles, "raw(ScanAngleRank) = 18"), 1);
    let told = |store: &str, name: &str, more: &[&str]| {
        let text = esker_ok(&[&["query", store, "--json", "--attributes", name], more].concat());
        let answer: serde_json::Value = serde_json::from_str(&text).unwrap();
        let has_points = |a: &&serde_json::Value| a["name"] == name && a["count"] != 0;
        let all = answer["attributes"].as_array().unwrap().iter().filter(has_points);
        let numbers = |a: &serde_json::Value| ["count", "min", "max", "mean"].map(|key| a[key].as_f64().unwrap());
        all.map(|a| (a["type"].as_str().unwrap().to_owned(), numbers(a))).collect::<Vec<_>>()
    };
    // Degrees and steps were two rows, of 8 and of 16 bits.
    let given: Vec<f64> =
        values(&[&angles, "--attributes", "ScanAngleRank"]).iter().map(|v| v.parse().unwrap()).collect();
    let ends = [given.iter().copied().fold(f64::MAX, f64::min), given.iter().copied().fold(f64::MIN, f64::max)];
    let mean = given.iter().sum::<f64>() / 8.0;
    let all = told(&angles, "ScanAngleRank", &[]);
    assert!(
        matches!(&all[..], [(ty, [8.0, low, high, m])] if ty == "i16" && [*low, *high] == ends && (m - mean).abs() < 1e-9),
        "{all:?}"
    );
    assert_eq!(told(&angles, "ScanAngleRank", &left), [("i8".to_owned(), [1.0, 30.0, 30.0, 30.0])]);
    let red = [4.0, 257.0, 51_400.0, (257.0 + 257.0 + 51_400.0 + 300.0) / 4.0];
    assert_eq!(told(&colors, "Red", &[]), [("u16".to_owned(), red)]);
    // 0, 1, 200, 255 times 257, and 1, 257, 51,400, 65,535 as they are.
    let green = [8.0, 0.0, 65_535.0, (456.0 * 257.0 + 1.0 + 257.0 + 51_400.0 + 65_535.0) / 8.0];
    assert_eq!(told(&fields, "Green", &[]), [("u16".to_owned(), green)]);
    // A file of a scan has its own values, which are not those that were compared.
    let split = |filter: &str| {
        let arguments =
            ["query", &fields, "--split-by", "scan", "-o", &folder.at("split.csv"), "--force", "--where", filter];
        String::from_utf8(esker(&arguments).stderr).unwrap()
    };
    assert!(split("Green > 2000").contains("its scan's own values"), "{}", split("Green > 2000"));
    let levels = [1.0, 200.0, 256.0, 257.0, 300.0, 51_400.0, 65_535.0];
    assert_eq!(check(&colors, "Red", &[], &levels, true), [257.0, 257.0, 51_400.0, 300.0]);
    assert_eq!(check(&fields, "Green", &[], &levels, false).len(), 8);
    assert_eq!([count(&fields, "Green = 51400"), count(&fields, "raw(Green) = 200")], [2, 1]);
}

/// Whoever wrote them had rounded them to half a metre, and all that was said was how exactly that is stored.
#[test]
fn floats_of_32_bits_that_are_far_coarser_than_the_store_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let told = |name: &str, ty: &str, bytes: Vec<u8>| {
        let properties = ["x", "y", "z"].map(|axis| format!("property {ty} {axis}\n")).concat();
        let head = format!("ply\nformat binary_little_endian 1.0\nelement vertex 2\n{properties}end_header\n");
        fs::write(at(name), [head.into_bytes(), bytes].concat()).unwrap();
        let output = esker(&["ingest", &at(&format!("{name}.esker")), &at(name)]);
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let utm = [[500_000.0_f64, 5_400_040.5, 1.0], [500_001.0, 5_400_044.0, 2.0]];
    let singles = |points: [[f64; 3]; 2]| points.iter().flatten().flat_map(|&v| (v as f32).to_le_bytes()).collect();
    let warning = told("far.ply", "float", singles(utm));
    assert!(warning.contains("its coordinates are 32-bit floats, up to 0.5 apart here"), "{warning}");
    assert!(!told("near.ply", "float", singles([[0.5, 1.5, 2.0], [12.0, 30.0, 1.0]])).contains("32-bit"));
    let doubles = utm.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    assert!(!told("double.ply", "double", doubles).contains("32-bit"));
}
