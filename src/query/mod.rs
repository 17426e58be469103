//! Region, filter, detail; selection; execution.
//!
//! A [`Query`] is *region and filter at detail, giving attributes*, run on a [`Snapshot`](crate::store::Snapshot). Its
//! points come as [`Batch`](crate::points::Batch)es to a sink, in an order that is always the same; with them comes an
//! [`Answer`]: how many, how good, at what cost.

mod answer;
mod batches;
mod block;
mod cancel;
mod capacity;
mod cells;
mod counts;
mod density;
mod detail;
mod error;
mod explain;
mod explain_text;
mod extent;
mod filter;
mod gaps;
pub(crate) mod kinds;
mod looked;
mod mask;
mod near;
mod nearest;
mod neighbors;
mod output;
mod part;
mod pieces;
mod plan;
mod policy;
mod radius;
mod region;
mod request;
mod rounds;
mod run;
mod seen;
mod strays;
mod stream;
mod summary;
mod take;
mod task;
#[cfg(test)]
mod tests;
mod thin;
mod ties;
mod view;
mod view_parts;
mod watch;

pub use answer::{Answer, Statistics};
pub use batches::Batches;
pub use cancel::Cancel;
pub use counts::ValueCount;
pub use density::{Density, DensitySquare};
pub use detail::Detail;
pub use error::QueryError;
pub use explain::{ExplainedNode, Explanation, Verdict};
pub use extent::{flat_attributes, occupied_boxes};
pub use filter::{Filter, FilterError};
pub use nearest::Neighbors;
pub use output::OutputForm;
pub use policy::{CubeDistance, DistancePolicy, Policy};
pub use region::{LatticeRegion, Polygons, Region};
pub use request::{Attributes, Query};
pub use summary::AttributeSummary;
pub use view::{SelectedPart, Selection, select_view};
pub use view_parts::{PartId, PartPoints, Take, ViewParts, Wanted, WantedNode, WantedPart};
pub use watch::Watch;
