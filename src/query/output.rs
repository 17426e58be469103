//! What an answer's batches will look like, before the first of them: for those who write files.

use super::plan::Plan;
use super::{Query, QueryError};
use crate::geometry::Containment;
use crate::points::Attribute;
use crate::store::Snapshot;
use crate::store::model::{Scan, ScanId};
use std::sync::Arc;

/// The form of an answer.
#[derive(Clone, Debug, PartialEq)]
pub struct OutputForm {
    /// The attributes of every batch, in this order.
    pub attributes: Arc<[Attribute]>,
    /// The scans that can contribute, ascending: those asked for whose bounds meet the region, or all that were asked for
    /// if there is none.
    pub scans: Vec<ScanId>,
}

impl Query {
    /// The form of this query's answer; reads the index, but no points.
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn output_form(&self, snapshot: &Snapshot) -> Result<OutputForm, QueryError> {
        let plan = Plan::new(self, snapshot)?;
        let wanted = |id: ScanId| plan.scans.as_ref().is_none_or(|s| s.binary_search(&id).is_ok());
        let asked = || snapshot.scans().iter().filter(|s| wanted(s.id));
        let meets = |s: &&Scan| s.bounds.is_some_and(|b| plan.region.classify(&b) != Containment::Outside);
        let mut scans: Vec<ScanId> = asked().filter(meets).map(|s| s.id).collect();
        if scans.is_empty() {
            scans = asked().map(|s| s.id).collect();
        }
        Ok(OutputForm { attributes: plan.attributes.clone(), scans })
    }
}
