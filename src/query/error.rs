//! What can be wrong with a query.

use super::filter::FilterError;
use crate::store::StoreError;
use thiserror::Error;

/// Why a query could not be answered.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum QueryError {
    /// The region's numbers make no region.
    #[error("{0}")]
    Region(String),
    /// The words that say how a view spreads its points mean nothing.
    #[error("{0}")]
    Policy(String),
    /// The filter cannot be read, or names what the store does not have.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// The detail's numbers make no sense.
    #[error("{what} is {value}; it must be {expected}")]
    Detail {
        /// `spacing`, `max error`, ...
        what: &'static str,
        /// What was given.
        value: f64,
        /// What would do.
        expected: &'static str,
    },
    /// It was ended ([`Cancel`](super::Cancel)).
    #[error("the query was cancelled")]
    Cancelled,
    /// Things that do not go together.
    #[error("{0}")]
    Combination(&'static str),
    /// The store has no attribute of this name.
    #[error("there is no attribute \"{name}\"{}", did_you_mean(.nearest))]
    UnknownAttribute {
        /// What was asked for.
        name: String,
        /// The nearest name that there is.
        nearest: Option<String>,
    },
    /// A coordinate among the attributes.
    #[error("{name} is no attribute but a coordinate, and those always come; leave it out")]
    Coordinate {
        /// What was asked for.
        name: String,
    },
    /// The store has no scan of this name.
    #[error("there is no scan \"{name}\"{}", did_you_mean(.nearest))]
    UnknownScan {
        /// What was asked for.
        name: String,
        /// The nearest name that there is.
        nearest: Option<String>,
    },
    /// The store could not be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A row of the store contradicts another.
    #[error("node {node}: expected {expected}, found {found}; run `esker verify`")]
    Inconsistent {
        /// The node's name, level-x-y-z.
        node: String,
        /// What should be there.
        expected: String,
        /// What is.
        found: String,
    },
}

/// `; did you mean "X"?`, or nothing.
pub(super) fn did_you_mean(nearest: &Option<String>) -> String {
    nearest.as_ref().map_or_else(String::new, |n| format!("; did you mean \"{n}\"?"))
}

/// The candidate that is fewest edits away from `name`, case and underscores aside, if it is near enough to be meant.
pub(super) fn nearest<'a>(name: &str, candidates: impl Iterator<Item = &'a str>) -> Option<String> {
    let fold = |s: &str| -> Vec<char> { s.chars().filter(|c| *c != '_').flat_map(char::to_lowercase).collect() };
    let asked = fold(name);
    let ranked = candidates.map(|c| (edits(&asked, &fold(c)), c)).min_by_key(|&(edits, _)| edits);
    ranked.filter(|&(edits, c)| edits <= 1 + asked.len().max(c.chars().count()) / 3).map(|(_, c)| c.to_owned())
}

/// The Levenshtein distance.
fn edits(a: &[char], b: &[char]) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.iter().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(ca != cb);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_name_is_suggested_only_if_it_is_near() {
        let names = ["Intensity", "Classification", "GpsTime", "Red"];
        let near = |n| nearest(n, names.into_iter());
        assert_eq!(near("intensty").as_deref(), Some("Intensity"));
        assert_eq!(near("gps_tme").as_deref(), Some("GpsTime"));
        assert_eq!(near("Classifications").as_deref(), Some("Classification"));
        assert_eq!(near("temperature"), None);
        assert_eq!(nearest("x", std::iter::empty()), None);
    }
}
