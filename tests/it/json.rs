//! `docs/json.md` against what the program prints.

use crate::support::{esker, esker_ok};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;

/// The fields of each section, and whether they may be missing or null.
fn documented() -> BTreeMap<String, BTreeMap<String, String>> {
    let text = include_str!("../../docs/json.md");
    let section = |section: &str| {
        let (title, rest) = section.split_once('\n').unwrap();
        let row = |line: &str| {
            let mut cells = line.strip_prefix("| `")?.split(" | ");
            Some((cells.next()?.strip_suffix('`')?.to_owned(), cells.next()?.to_owned()))
        };
        (title.trim_matches('`').to_owned(), rest.lines().filter_map(row).collect())
    };
    text.split("\n## ").skip(1).map(section).collect()
}

/// The paths in a value, each with the type of what is there.
fn paths(value: &Value, at: &str, found: &mut BTreeSet<(String, &'static str)>) {
    let kind = match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(n) if n.is_u64() || n.is_i64() => "integer",
        Value::Number(_) => "number",
        Value::String(_) => "text",
        Value::Array(_) | Value::Object(_) => "object",
    };
    match value {
        Value::Array(all) => all.iter().for_each(|one| paths(one, &format!("{at}[]"), found)),
        _ if !at.is_empty() => {
            found.insert((at.to_owned(), kind));
        }
        _ => {}
    }
    if let Value::Object(fields) = value {
        let dot = if at.is_empty() { "" } else { "." };
        fields.iter().for_each(|(name, value)| paths(value, &format!("{at}{dot}{name}"), found));
    }
}

/// May a field that is documented so be of this kind?
fn is_of(documented: &str, kind: &str) -> bool {
    match kind {
        "null" => documented.contains("or null"),
        // A whole float has no point; a number that is infinite is a text.
        "integer" => documented.starts_with("integer") || documented.starts_with("number"),
        "text" => documented.starts_with("text") || documented.starts_with("number"),
        kind => documented.starts_with(kind),
    }
}

#[test]
fn every_field_is_documented_and_every_documented_field_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (store, other, copy) = (at("s.esker"), at("o.esker"), at("c.esker"));
    esker_ok(&["generate", "site", "--points", "3000", "--scans", "2", "-o", &at("scans")]);
    fs::write(at("far.csv"), "x,y,z,v\n689990,5330000,500,1\nnan,0,0,2\n").unwrap();
    fs::write(at("bad.las"), "LASF, and nothing else").unwrap();
    let (scan_1, scan_2) = (at("scans/site_1.las"), at("scans/site_2.las"));
    let docs = documented();
    let answer: BTreeMap<String, String> = docs["An answer"].clone();
    // The paths that were there, and whether one was not null.
    let mut seen: BTreeMap<&str, BTreeMap<String, bool>> = BTreeMap::new();
    let mut check = |section: &'static str, arguments: &[&str], from_stderr: bool| {
        let output = esker(arguments);
        let text = String::from_utf8(if from_stderr { output.stderr } else { output.stdout }).unwrap();
        let text = if from_stderr { text.lines().find(|l| l.starts_with('{')).unwrap_or_default() } else { &text };
        let value: Value = serde_json::from_str(text).unwrap_or_else(|e| panic!("{arguments:?}: {e} in {text}"));
        let mut found = BTreeSet::new();
        paths(&value, "", &mut found);
        let seen = seen.entry(section).or_default();
        for (path, kind) in found {
            let of_answer = path.strip_prefix("answer.").unwrap_or(&path);
            let known = docs[section].get(&path).or_else(|| answer.get(of_answer));
            let known = known.unwrap_or_else(|| panic!("`{path}` of {arguments:?} is not documented"));
            assert!(is_of(known, kind), "`{path}` of {arguments:?} is {kind}, and documented as {known}");
            *seen.entry(path).or_default() |= kind != "null";
        }
    };
    let ingest = "ingest --json";
    check(ingest, &["ingest", &store, &scan_1, &at("far.csv"), &at("bad.las"), "--keep-going", "--json"], false);
    check(ingest, &["ingest", &store, &scan_1, &at("far.csv"), "--json"], false);
    check("replace --json", &["replace", &store, "site_1", &scan_2, "--name", "site_2", "--json"], false);
    check("hide --json", &["hide", &store, "site_2", "--json"], false);
    check("scans --json", &["scans", &store, "--json"], false);
    check("rename --json", &["rename", &store, "site_2", "south", "--json"], false);
    check("set-crs --json", &["set-crs", &store, "EPSG:32632", "--json"], false);
    esker_ok(&["rename", &store, "south", "site_2"]);
    check("show --json", &["show", &store, "site_2", "--json"], false);
    fs::write(
        at("view.json"),
        r#"{"eye":[1,2,9],"target":[1,2,3],"up":[0,1,0],"projection":"perspective","fov_y_deg":60,"near":1,"far":90}"#,
    )
    .unwrap();
    check("bookmark NAME --json", &["bookmark", &store, "door", "--view", &at("view.json"), "--json"], false);
    check("bookmark --json", &["bookmark", &store, "--json"], false);
    check("info --json", &["info", &store, "--json"], false);
    check("digest --json", &["digest", &store, "--json"], false);
    check("verify --json", &["verify", &store, "--json"], false);
    check("query --json", &["query", &store, "--json"], false);
    check("query --json", &["query", &store, "--json", "--capacity", "0"], false);
    check("query -o FILE --json", &["query", &store, "--box", "0,0,1,1", "-o", &at("a.las"), "--json"], false);
    check("query -o - --json", &["query", &store, "-o", "-", "--format", "csv", "--json"], true);
    let split = "query --split-by WHAT -o FILE --json";
    check(split, &["query", &store, "--split-by", "class", "-o", &at("class.csv"), "--json"], false);
    check(split, &["query", &store, "--split-by", "scan", "-o", &at("scan.csv"), "--json"], false);
    check("query --explain --json", &["query", &store, "--explain", "--capacity", "100", "--json"], false);
    check("nearest --json", &["nearest", &store, "--at", "689990,5330000,500", "--json"], true);
    check("density --json", &["density", &store, "--side", "5", "--json"], false);
    check("remove --json", &["remove", &store, "far", "--json"], false);
    check("compact --json", &["compact", &store, "--json"], false);
    esker_ok(&["ingest", &other, &scan_1, "--lattice", &store]);
    check("merge --json", &["merge", &copy, &store, &other, "--json"], false);
    // What is not optional is there, if what it is in is.
    for (section, seen) in &seen {
        for (path, kind) in &docs[*section] {
            let within = path.rsplit_once('.').map(|(parent, _)| parent.to_owned());
            let is_in = within.as_ref().is_none_or(|parent| seen.get(parent) == Some(&true));
            let may_be_empty = path.ends_with("[]");
            assert!(
                seen.contains_key(path) || !is_in || may_be_empty || kind.contains("optional"),
                "`{path}` of `{section}` is not there"
            );
        }
    }
    let missing: Vec<_> = docs.keys().filter(|s| s.ends_with("--json") && !seen.contains_key(s.as_str())).collect();
    assert_eq!(missing, [] as [&String; 0]);
}

#[test]
fn commands_that_take_long_say_how_far_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let store = at("s.esker");
    esker_ok(&["generate", "terrain", "--points", "3000", "-o", &at("t.las")]);
    esker_ok(&["ingest", &store, &at("t.las")]);
    let (stages, csv) = (["reading", "verifying", "querying"], at("out.csv"));
    let commands: [(&str, &[&str]); 7] = [
        (stages[0], &["digest", &store]),
        (stages[1], &["verify", &store]),
        (stages[2], &["query", &store, "--count"]),
        (stages[2], &["query", &store, "-o", &csv, "--where", "Intensity > 0"]),
        (stages[2], &["query", &store, "-o", "-", "--format", "csv", "--level", "1"]),
        (stages[2], &["nearest", &store, "--at", "0,0,0"]),
        (stages[2], &["density", &store, "--side", "10"]),
    ];
    for (stage, command) in commands {
        let _ = fs::remove_file(&csv);
        let told = esker(&[command, &["--progress", "json", "--threads", "2"]].concat());
        assert_eq!(told.status.code(), Some(0), "{command:?}");
        let lines = String::from_utf8(told.stderr).unwrap();
        let first: Value = serde_json::from_str(lines.lines().find(|l| l.starts_with("{\"points\"")).unwrap()).unwrap();
        assert_eq!((&first["stage"], &first["points"]), (&stage.into(), &0.into()), "{command:?}");
        assert!(first["total"].is_u64() || first["total"].is_null(), "{command:?}: {first}");
        // Nothing of it where nobody asked.
        let _ = fs::remove_file(&csv);
        let quiet = esker(command);
        assert_eq!(quiet.stdout, told.stdout, "{command:?}");
        assert!(quiet.stderr.is_empty(), "{command:?}");
    }
}
