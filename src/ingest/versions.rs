//! Does an input look like another version of a scan that the store has?

use super::sources::{Source, Stored};
use crate::lattice::Lattice;
use crate::store::model::Scan;
use std::collections::HashMap;
use std::path::Path;

/// The stored scans, by what a version of theirs would be known by.
pub(super) struct Versions<'a> {
    lattice: Option<&'a Lattice>,
    by_path: HashMap<&'a Path, Vec<&'a Scan>>,
    by_name: HashMap<&'a str, &'a Scan>,
}

impl<'a> Versions<'a> {
    pub fn of(stored: Stored<'a>) -> Self {
        let mut by_path: HashMap<&Path, Vec<&Scan>> = HashMap::new();
        for scan in stored.scans {
            by_path.entry(Path::new(&scan.source)).or_default().push(scan);
        }
        let by_name = stored.scans.iter().map(|s| (s.name.as_str(), s)).collect();
        Self { lattice: stored.lattice, by_path, by_name }
    }

    /// The stored scan that a source, whose content is new, may be another version of: from the same path, or of its name and in
    /// its place.
    pub fn of_source(&self, source: &Source) -> Option<&'a Scan> {
        if self.by_name.is_empty() {
            return None;
        }
        let (name, longer) = source.names();
        let is_named = |scan: &&Scan| scan.name == name || longer.as_ref().is_some_and(|longer| scan.name == *longer);
        let info = source.reader.info();
        let path = std::path::absolute(&info.path).unwrap_or_else(|_| info.path.clone());
        let of_path = self.by_path.get(path.as_path()).map(Vec::as_slice).unwrap_or_default();
        let is_alone = info.scan_name.is_none() && !source.is_of_several();
        let same = if is_alone { of_path.first().copied() } else { of_path.iter().copied().find(is_named) };
        same.or_else(|| {
            let named = [Some(&name), longer.as_ref()].into_iter().flatten();
            named.filter_map(|name| self.by_name.get(name.as_str()).copied()).find(|scan| {
                self.is_in_its_place(source, scan).unwrap_or_else(|| {
                    // Names that files give to their scans say more than those of the files.
                    info.scan_name.is_some() && info.path.file_name() == Path::new(&scan.source).file_name()
                })
            })
        })
    }

    /// Do both lie in one place, seen from above? None if that isn't known.
    fn is_in_its_place(&self, source: &Source, scan: &Scan) -> Option<bool> {
        let (low, high) = source.reader.info().bounds_hint?;
        let (lattice, bounds) = (self.lattice?, scan.bounds?);
        let (min, max) = (lattice.world_from_lattice(bounds.min), lattice.world_from_lattice(bounds.max));
        Some((0..2).all(|axis| {
            let common = high[axis].min(max[axis]) - low[axis].max(min[axis]);
            let smaller = (high[axis] - low[axis]).min(max[axis] - min[axis]);
            common >= 0.0 && common >= 0.5 * smaller
        }))
    }
}
