//! The steps of the order of detail (OCTREE section 7).

use crate::lattice::BITS;
use std::cmp::Ordering;

/// A step of the order of detail: the points of one win and one group of ranks. Steps order coarse to fine.
///
/// As an end it says: all points with a larger win, and those of this win up to this group, are there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Step {
    /// Exponent of the largest cell that the step's points win; -1 for repeated positions.
    pub win: i8,
    /// 1, 2, 3 for ranks {1}, {2-4}, {5-7}: the bound improves exactly where a group ends.
    pub group: u8,
}

impl Step {
    /// How many different steps there are.
    pub const COUNT: usize = 3 * (BITS as usize + 2);

    /// The step of a point of this win and group, as a number in the order of detail, below [`Step::COUNT`].
    #[inline]
    pub(super) fn number(win: i8, group: u8) -> usize {
        let win = win.clamp(-1, BITS as i8);
        (BITS as i8 - win) as usize * 3 + usize::from(group.clamp(1, 3) - 1)
    }

    /// The step with this number.
    pub(super) fn of_number(number: usize) -> Self {
        let number = number.min(Self::COUNT - 1);
        Self { win: BITS as i8 - (number / 3) as i8, group: (number % 3) as u8 + 1 }
    }

    /// The step's place in the order of detail, from 0.
    pub fn ordinal(self) -> u8 {
        Self::number(self.win, self.group) as u8
    }

    /// The step with this place; beyond the last the last.
    pub fn of_ordinal(ordinal: u8) -> Self {
        Self::of_number(usize::from(ordinal))
    }

    /// The last rank of the step's group: with it, `j` = 1, 4 or 7 points of each parent cell are there beside its winner.
    pub fn last_rank(self) -> u8 {
        match self.group {
            0 => 0,
            1 => 1,
            2 => 4,
            _ => 7,
        }
    }

    /// The last rank of the group before: 0, 1 or 4.
    pub fn rank_before(self) -> u8 {
        Self { group: self.group.saturating_sub(1), ..self }.last_rank()
    }
}

impl Ord for Step {
    fn cmp(&self, other: &Self) -> Ordering {
        other.win.cmp(&self.win).then(self.group.cmp(&other.group))
    }
}

impl PartialOrd for Step {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
