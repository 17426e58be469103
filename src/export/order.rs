//! Columns in the order in which they were asked for, in files whose readers go by their place: `X,Y,Z,Intensity,Red,...`.

use super::plan::is_las;
use crate::formats::OutputFormat;
use crate::points::{Attribute, Batch, Column};
use crate::query::Query;
use crate::store::Snapshot;
use std::sync::Arc;

/// For each column of the file, which one of the batches it is.
#[derive(Clone, Debug)]
pub struct Order(Vec<usize>);

impl Order {
    /// For batches with these attributes. Where none was named, and in LAS, whose fields have places of their own, the order is
    /// the canonical one.
    pub fn of(query: &Query, snapshot: &Snapshot, attributes: &[Attribute], format: OutputFormat) -> Self {
        let mut order: Vec<usize> = (0..attributes.len()).collect();
        if !is_las(format) {
            let places = query.places_of(attributes, snapshot);
            order.sort_by_key(|&i| places[i]);
        }
        Self(order)
    }

    /// The attributes in this order.
    pub fn attributes(&self, attributes: &[Attribute]) -> Arc<[Attribute]> {
        self.0.iter().map(|&i| attributes[i].clone()).collect()
    }

    /// Brings the columns of a batch into this order.
    pub fn apply(&self, batch: &mut Batch) {
        if self.0.is_sorted() {
            return;
        }
        let mut take = |&i: &usize| std::mem::replace(&mut batch.columns[i], Column::U8(Vec::new()));
        let columns = self.0.iter().map(&mut take).collect();
        batch.columns = columns;
        batch.attributes = self.attributes(&batch.attributes);
    }
}
