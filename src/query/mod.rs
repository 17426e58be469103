//! Region, filter, detail; selection; execution.
//!
//! A [`Query`] is *region and filter at detail, giving attributes*, run on a [`Snapshot`](crate::store::Snapshot). Its
//! points come as [`Batch`](crate::points::Batch)es to a sink, in an order that is always the same; with them comes an
//! [`Answer`]: how many, how good, at what cost.

mod answer;
mod block;
mod capacity;
mod cells;
mod detail;
mod error;
mod filter;
mod mask;
mod output;
mod part;
mod pipeline;
mod plan;
mod region;
mod request;
mod run;
mod summary;
#[cfg(test)]
mod tests;
mod ties;
mod view;

pub use answer::{Answer, Statistics};
pub use detail::Detail;
pub use error::QueryError;
pub use filter::{Filter, FilterError};
pub use output::OutputForm;
pub use region::{LatticeRegion, Polygons, Region};
pub use request::{Attributes, Query};
pub use summary::{AttributeSummary, Summary};
pub use view::{SelectedPart, Selection, select_view};
