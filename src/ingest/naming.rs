//! Names of scans: the file's stem; where two clash, with the folder before it, then with a number.

use std::collections::HashSet;
use std::path::Path;

/// A name for the scan read from `path` that is not in `taken`, which gets it.
pub(super) fn unique_name(path: &Path, taken: &mut HashSet<String>) -> String {
    let stem = stem(path);
    let with_folder = path
        .parent()
        .and_then(Path::file_name)
        .map(|folder| format!("{}/{stem}", folder.to_string_lossy()))
        .filter(|_| taken.contains(&stem));
    unique_scan_name(&with_folder.unwrap_or(stem), taken)
}

/// `base`, with a number if it is in `taken` already; `taken` gets it.
pub(super) fn unique_scan_name(base: &str, taken: &mut HashSet<String>) -> String {
    let mut name = base.to_owned();
    let mut number = 2;
    while !taken.insert(name.clone()) {
        name = format!("{base}-{number}");
        number += 1;
    }
    name
}

/// The file name without its ending; `.copc.laz` is one ending.
fn stem(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    match stem.strip_suffix(".copc") {
        Some(short) if !short.is_empty() => short.to_owned(),
        _ => stem,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_never_clash() {
        let mut taken = HashSet::new();
        let mut name = |p: &str| unique_name(Path::new(p), &mut taken);
        assert_eq!(name("day1/roof.laz"), "roof");
        assert_eq!(name("day2/roof.laz"), "day2/roof");
        assert_eq!(name("x/day2/roof.las"), "day2/roof-2");
        assert_eq!(name("site.copc.laz"), "site");
    }
}
