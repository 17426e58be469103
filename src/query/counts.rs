//! How many points have each value of an attribute of a byte: classes, returns, flags.

use serde::Serialize;

/// A value and how many points have it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct ValueCount {
    /// The value.
    pub value: u8,
    /// Points.
    pub points: u64,
}

/// The counts of all values; none where they are not counted.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Counts(Option<Box<[u64; 256]>>);

impl Counts {
    pub const NONE: Self = Self(None);

    /// Of some values.
    pub fn of(values: impl Iterator<Item = u8>) -> Self {
        let mut counts = Box::new([0; 256]);
        values.for_each(|value| counts[usize::from(value)] += 1);
        Self(Some(counts))
    }

    pub fn add(&mut self, next: &Self) {
        match (&mut self.0, &next.0) {
            (Some(counts), Some(next)) => counts.iter_mut().zip(&**next).for_each(|(a, b)| *a += b),
            (None, Some(_)) => *self = next.clone(),
            (_, None) => {}
        }
    }

    /// Those that there are, ascending; none if they were not counted.
    pub fn there(&self) -> Vec<ValueCount> {
        let all = self.0.iter().flat_map(|counts| (0..=u8::MAX).zip(**counts));
        all.filter(|(_, points)| *points > 0).map(|(value, points)| ValueCount { value, points }).collect()
    }
}
