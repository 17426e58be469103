//! Which: expressions over attributes and scans.
//!
//! ```text
//! Classification = 2 and Intensity > 100          GpsTime between 1.5 and 2.5
//! scan in ('north', 'roof')                       not (ReturnNumber = NumberOfReturns)
//! Classification in (2, 6) or Z >= 105.25         height_above_ground is not null
//! raw(height) <> -9999                            "my attribute" < 3 && Red > 10
//! ```
//!
//! Logic is SQL's, with three values: a comparison with null is unknown, and only what is true matches. An attribute is
//! null where the point's scan lacks it and where it holds its no-data value. A comparison with NaN is unknown too, so NaN
//! matches neither a comparison nor its negation; it is not null. Integers of any size are compared exactly; extra bytes
//! of integer type by their scaled value in exact decimals, floats as f64. `X`, `Y`, `Z` are the exact coordinates;
//! an attribute of such a name is written in double quotes.

mod bind;
mod eval;
mod lexer;
mod parser;
mod set;
#[cfg(test)]
mod tests;
mod zones;

use super::block::Block;
use super::kinds::Kinds;
use super::mask::Mask;
use crate::store::Snapshot;
use crate::store::model::Slot;
use bind::Bound;
pub(crate) use bind::{Names, attributes_named};
use std::fmt;
use thiserror::Error;
pub(crate) use zones::Known;

/// What is wrong with a filter, and where: the message ends with the filter and a caret under the place.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub struct FilterError {
    message: String,
    text: String,
    at: usize,
}

impl FilterError {
    pub(super) fn new(message: impl Into<String>, text: &str, at: usize) -> Self {
        Self { message: message.into(), text: text.into(), at }
    }

    /// What is wrong.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// Where, in characters from the start of the filter.
    pub fn at(&self) -> usize {
        self.at
    }
}

impl fmt::Display for FilterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // One character a column, whatever is between them.
        let line: String = self.text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        write!(f, "filter: {}\n  {line}\n  {:>width$}", self.message, "^", width = self.at + 1)
    }
}

/// A filter that can be read; whether its names exist is seen when it meets a store.
///
/// ```
/// use esker::query::Filter;
///
/// let filter = Filter::parse("Classification = 2 and Intensity > 100")?;
/// assert_eq!(filter.to_string(), "Classification = 2 and Intensity > 100");
/// assert_eq!(Filter::parse("Intensity >").unwrap_err().at(), 11);
/// # Ok::<(), esker::query::FilterError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Filter {
    text: String,
    expression: parser::Expression,
}

impl Filter {
    /// Reads a filter.
    ///
    /// # Errors
    ///
    /// [`FilterError`] with the place of the first character that does not fit.
    pub fn parse(text: &str) -> Result<Self, FilterError> {
        Ok(Self { text: text.into(), expression: parser::parse(text)? })
    }

    /// What its names mean where they might mean something else, in words: `x` is the coordinate, though the store has an attribute
    /// that is called so, too; `Class` is the attribute of that name, where some scans have it, not `Classification`.
    pub fn ambiguities(&self, snapshot: &Snapshot) -> Vec<String> {
        let (attributes, scans, lattice) = (snapshot.attributes(), snapshot.scans(), &snapshot.site().lattice);
        bind::ambiguous(&self.expression, &Names { attributes, scans, lattice, met: &Kinds::default() })
    }

    /// Do all its names mean something in this store, and are they compared with what they can be compared with?
    ///
    /// # Errors
    ///
    /// [`FilterError`], as a query with this filter would give.
    pub fn check(&self, snapshot: &Snapshot) -> Result<(), FilterError> {
        let (attributes, scans, lattice) = (snapshot.attributes(), snapshot.scans(), &snapshot.site().lattice);
        self.bind(&Names { attributes, scans, lattice, met: &Kinds::default() }).map(drop)
    }

    /// The filter on the columns of one store.
    pub(crate) fn bind(&self, names: &Names) -> Result<BoundFilter, FilterError> {
        Ok(BoundFilter { bound: bind::bind(&self.text, &self.expression, names)? })
    }
}

impl fmt::Display for Filter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

/// A filter on the columns of one store.
#[derive(Clone, Debug)]
pub(crate) struct BoundFilter {
    bound: Bound,
}

impl BoundFilter {
    /// The attributes that it looks at, ascending.
    pub fn slots(&self) -> Vec<Slot> {
        let mut slots = Vec::new();
        collect(&self.bound, &mut slots);
        slots.sort_unstable();
        slots.dedup();
        slots
    }

    /// Does it look at coordinates?
    pub fn needs_positions(&self) -> bool {
        looks_at_positions(&self.bound)
    }

    /// The points of a block for which it is true.
    pub fn matching(&self, block: &Block) -> Mask {
        eval::matching(&self.bound, block)
    }

    /// Can it be true for a point of which this is known?
    pub fn may_match(&self, known: &Known) -> bool {
        zones::possible(&self.bound, known).0
    }
}

fn collect(bound: &Bound, slots: &mut Vec<Slot>) {
    match bound {
        Bound::And(terms) | Bound::Or(terms) => terms.iter().for_each(|t| collect(t, slots)),
        Bound::Not(inner) => collect(inner, slots),
        Bound::Values(tests) => slots.extend(tests.iter().map(|(s, _)| s.slot)),
        Bound::Null(sources) => slots.extend(sources.iter().map(|s| s.slot)),
        Bound::Pair(a, _, b) => slots.extend(a.iter().chain(b).map(|s| s.slot)),
        Bound::Axis(..) | Bound::Scans(_) => {}
    }
}

fn looks_at_positions(bound: &Bound) -> bool {
    match bound {
        Bound::And(terms) | Bound::Or(terms) => terms.iter().any(looks_at_positions),
        Bound::Not(inner) => looks_at_positions(inner),
        Bound::Axis(..) => true,
        Bound::Values(_) | Bound::Null(_) | Bound::Pair(..) | Bound::Scans(_) => false,
    }
}
