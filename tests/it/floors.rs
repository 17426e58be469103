//! The floors of ARCHITECTURE.md: which module may use which, and which outside library belongs to which module.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Module, then what it may use of the crate besides itself.
const FLOORS: &[(&str, &[&str])] = &[
    ("geometry", &[]),
    ("lattice", &["geometry"]),
    ("processor", &[]),
    ("points", &["lattice", "geometry"]),
    ("codec", &["points", "lattice", "geometry"]),
    ("octree", &["points", "lattice", "geometry"]),
    ("store", &["codec", "octree", "points", "lattice", "geometry"]),
    ("formats", &["points", "lattice", "geometry"]),
    ("generate", &["formats", "points", "lattice", "geometry"]),
    ("ingest", &["store", "formats", "codec", "octree", "points", "lattice", "geometry"]),
    ("query", &["store", "codec", "octree", "points", "lattice", "geometry"]),
    ("export", &["query", "store", "formats", "codec", "octree", "points", "lattice", "geometry"]),
    ("stream", &["query", "store", "codec", "octree", "points", "lattice", "geometry"]),
    ("render", &["stream", "points", "lattice", "geometry"]),
    ("viewer", &["render", "stream", "query", "store", "codec", "octree", "points", "lattice", "geometry"]),
    (
        "cli",
        &[
            "geometry", "lattice", "points", "codec", "octree", "store", "formats", "generate", "ingest", "query",
            "export", "render", "stream", "viewer",
        ],
    ),
];

/// Outside library, then the modules that may import it.
const OWNERS: &[(&str, &[&str])] = &[
    ("rusqlite", &["store"]),
    ("quick_cache", &["store"]),
    ("zstd", &["codec"]),
    ("tokio", &["stream"]),
    // The window's surface is the viewer's; it is drawn by `render`.
    ("wgpu", &["render", "viewer"]),
    ("egui", &["viewer"]),
    ("egui_wgpu", &["viewer"]),
    ("egui_winit", &["viewer"]),
    ("winit", &["viewer"]),
    ("las", &["formats"]),
    ("laz", &["formats"]),
    ("wide", &["formats"]),
    ("e57", &["formats"]),
    ("geojson", &["query"]),
    ("zip", &["formats"]),
    ("png", &["render"]),
    ("clap", &["cli"]),
    ("anyhow", &["cli"]),
    ("indicatif", &["cli"]),
    ("ctrlc", &["cli"]),
    ("nix", &["cli"]),
];

fn sources() -> Vec<(PathBuf, String)> {
    fn walk(folder: &Path, found: &mut Vec<(PathBuf, String)>) {
        let mut entries: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
        entries.sort();
        for path in entries {
            if path.is_dir() {
                walk(&path, found);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                found.push((path, text));
            }
        }
    }
    let mut found = Vec::new();
    walk(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut found);
    found
}

/// `src/query/region.rs` is in `query`; `src/lib.rs` and `src/main.rs` are in none.
fn module_of(path: &Path) -> Option<String> {
    let inside = path.strip_prefix(Path::new(env!("CARGO_MANIFEST_DIR")).join("src")).unwrap();
    let first = inside.components().next()?.as_os_str().to_str()?;
    let name = first.strip_suffix(".rs").unwrap_or(first);
    (name != "lib" && name != "main").then(|| name.to_owned())
}

/// Identifiers that follow `prefix` in the code of `text`, comments left out.
fn after<'t>(text: &'t str, prefix: &str) -> Vec<&'t str> {
    let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
    code.flat_map(|line| line.match_indices(prefix).map(move |(i, _)| &line[i + prefix.len()..]))
        .map(|rest| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or(""))
        .filter(|name| name.chars().next().is_some_and(|c| c.is_lowercase()))
        .collect()
}

/// `use crate::{a::X, b::Y}` would hide from [`after`]; such a group is written as one `use` each.
#[test]
fn every_module_uses_only_the_floors_below() {
    let floors: BTreeMap<_, _> = FLOORS.iter().copied().collect();
    let macros = ["with_column"];
    let mut wrong = Vec::new();
    for (path, text) in sources() {
        let Some(module) = module_of(&path) else { continue };
        let Some(allowed) = floors.get(module.as_str()) else {
            wrong.push(format!("{}: module `{module}` has no floor", path.display()));
            continue;
        };
        if text.contains("use crate::{") {
            wrong.push(format!("{}: write one `use crate::` a module", path.display()));
        }
        for used in after(&text, "crate::") {
            if used != module && !allowed.contains(&used) && !macros.contains(&used) {
                wrong.push(format!("{}: `{module}` may not use `{used}`", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_outside_library_has_one_home() {
    let mut wrong = Vec::new();
    for (path, text) in sources() {
        let Some(module) = module_of(&path) else { continue };
        if path.file_stem().is_some_and(|s| s.to_string_lossy().ends_with("tests")) {
            continue;
        }
        let code = text.split("#[cfg(test)]\nmod tests").next().unwrap_or("");
        for (library, owners) in OWNERS {
            let prefix = format!("{library}::");
            let used = code.lines().filter(|line| !line.trim_start().starts_with("//")).any(|line| {
                line.match_indices(&prefix).any(|(i, _)| {
                    let before = line[..i].chars().next_back();
                    before.is_none_or(|c| !c.is_alphanumeric() && c != '_' && c != ':')
                        && !line[..i].ends_with("self::")
                })
            });
            if used && !owners.contains(&module.as_str()) && !(*library == "las" && module == "points") {
                wrong.push(format!("{}: `{library}` belongs to {owners:?}", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
