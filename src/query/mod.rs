//! Region, filter, detail; selection; execution.

mod block;
mod error;
mod filter;
mod mask;
mod region;

pub use error::QueryError;
pub use filter::{Filter, FilterError};
pub use region::{LatticeRegion, Region};
