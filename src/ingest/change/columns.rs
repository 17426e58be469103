//! Points from many blocks to the columns of a part.

use super::point::{Block, Point};
use crate::points::Column;
use crate::store::PointColumns;
use crate::store::model::Slot;
use std::collections::HashMap;

/// The points of a node, and in which blocks they lie.
pub(super) struct Scattered<'p, 'a> {
    points: &'p [Point<'a>],
    blocks: Vec<&'a Block>,
    /// The number of each point's block.
    numbers: Vec<u32>,
    /// All columns that any of the blocks has, ascending.
    slots: Vec<Slot>,
}

impl<'p, 'a> Scattered<'p, 'a> {
    pub fn new(points: &'p [Point<'a>]) -> Self {
        let mut blocks: Vec<&'a Block> = Vec::new();
        let mut known: HashMap<*const Block, u32> = HashMap::new();
        let mut last: Option<(*const Block, u32)> = None;
        let number = |point: &Point<'a>| {
            let at = std::ptr::from_ref(point.block);
            if let Some((block, number)) = last
                && block == at
            {
                return number;
            }
            let number = *known.entry(at).or_insert_with(|| {
                blocks.push(point.block);
                blocks.len() as u32 - 1
            });
            last = Some((at, number));
            number
        };
        let numbers = points.iter().map(number).collect();
        let mut slots: Vec<Slot> = blocks.iter().flat_map(|block| block.columns.iter().map(|c| c.0)).collect();
        slots.sort_unstable();
        slots.dedup();
        Self { points, blocks, numbers, slots }
    }

    /// The columns of the points with these indices, in that order.
    pub fn columns(&self, picked: &[u32], scan: impl Fn(&Point<'_>) -> u32) -> PointColumns {
        let scans = picked.iter().map(|&i| scan(&self.points[i as usize])).collect();
        // Once for all columns, and close together: which block, and where in it.
        let at: Vec<(u32, u32)> =
            picked.iter().map(|&i| (self.numbers[i as usize], self.points[i as usize].at)).collect();
        let columns = self.slots.iter().filter_map(|&slot| Some((slot, self.column(slot, &at)?))).collect();
        PointColumns { scans, columns }
    }

    fn column(&self, slot: Slot, at: &[(u32, u32)]) -> Option<Column> {
        let found: Vec<Option<&Column>> = self.blocks.iter().map(|block| block.column(slot)).collect();
        macro_rules! gathered {
            ($($variant:ident),*) => {
                match found.iter().flatten().next()? {
                    $(Column::$variant(_) => {
                        // A slot has one type; a block without it has nulls, which are zeros.
                        let values = |column: &Option<&'a Column>| match column {
                            Some(Column::$variant(values)) => values.as_slice(),
                            _ => &[],
                        };
                        let of_block: Vec<&[_]> = found.iter().map(values).collect();
                        let value = |&(block, at): &(u32, u32)| {
                            of_block[block as usize].get(at as usize).copied().unwrap_or_default()
                        };
                        Column::$variant(at.iter().map(value).collect())
                    })*
                }
            };
        }
        Some(gathered!(U8, I8, U16, I16, U32, I32, U64, I64, F32, F64))
    }
}
