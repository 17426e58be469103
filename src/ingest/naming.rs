//! Names of scans: what the file calls them, or the file's stem; where two clash, with the file or the folder before it,
//! then with a number.

use std::collections::HashSet;
use std::path::Path;

/// A name longer than this is cut.
const LONGEST: usize = 200;

/// A name for a scan of the file `path` that is not in `taken`, which gets it. `own`: what the file calls it; `number`: its
/// number in the file, counted from one, if that has several.
pub(super) fn unique_name(path: &Path, own: Option<&str>, number: Option<u32>, taken: &mut HashSet<String>) -> String {
    let (base, longer) = natural_names(path, own, number);
    numbered_name(&longer.filter(|_| taken.contains(&base)).unwrap_or(base), taken)
}

/// What a scan is called, and what it is called where that is taken.
pub(super) fn natural_names(path: &Path, own: Option<&str>, number: Option<u32>) -> (String, Option<String>) {
    let stem = stem(path);
    let own = own.map(clean).filter(|n| !n.is_empty());
    // Points that a program had in memory are no file: what they are called is all that there is.
    if let Some(own) = own.as_deref().filter(|own| path == Path::new(own)) {
        return (own.to_owned(), None);
    }
    match (own, number) {
        (Some(own), _) => {
            let longer = format!("{stem}/{own}");
            (own, Some(longer))
        }
        (None, number) => {
            let base = number.map_or_else(|| stem.clone(), |n| format!("{stem}-{n}"));
            let folder = path.parent().and_then(Path::file_name);
            let longer = folder.map(|folder| format!("{}/{base}", folder.to_string_lossy()));
            (base, longer)
        }
    }
}

/// `base`, with a number if it is in `taken` already; `taken` gets it.
pub(super) fn numbered_name(base: &str, taken: &mut HashSet<String>) -> String {
    let mut name = base.to_owned();
    let mut number = 2;
    while !taken.insert(name.clone()) {
        name = format!("{base}-{number}");
        number += 1;
    }
    name
}

/// A file's own name for a scan, fit to be shown and typed.
fn clean(name: &str) -> String {
    let name: String = name.chars().map(|c| if c.is_control() { ' ' } else { c }).take(LONGEST).collect();
    name.trim().to_owned()
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
        let mut name = |p: &str| unique_name(Path::new(p), None, None, &mut taken);
        assert_eq!(name("day1/roof.laz"), "roof");
        assert_eq!(name("day2/roof.laz"), "day2/roof");
        assert_eq!(name("x/day2/roof.las"), "day2/roof-2");
        assert_eq!(name("site.copc.laz"), "site");
    }

    #[test]
    fn scans_of_one_file_have_their_own_names() {
        let mut taken = HashSet::new();
        let mut name = |p: &str, own, number| unique_name(Path::new(p), own, Some(number), &mut taken);
        assert_eq!(name("a/roof.e57", Some("Setup 1"), 1), "Setup 1");
        assert_eq!(name("a/roof.e57", Some("Setup 1"), 2), "roof/Setup 1");
        assert_eq!(name("a/roof.e57", Some("Setup 1"), 3), "roof/Setup 1-2");
        assert_eq!(name("a/roof.e57", None, 4), "roof-4");
        assert_eq!(name("a/roof.ptx", Some(" \n"), 4), "a/roof-4");
    }
}
