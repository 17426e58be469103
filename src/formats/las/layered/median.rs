//! The running median that predicts steps in X and Y.

use std::array;

/// Five values in order, into which each new one is put while the highest or the lowest is dropped: the median of what came
/// lately, as LASzip reckons it.
#[derive(Clone, Copy, Debug)]
pub struct Median {
    values: [i32; 5],
    /// Is the highest dropped next?
    drops_highest: bool,
}

impl Default for Median {
    fn default() -> Self {
        Self { values: [0; 5], drops_highest: true }
    }
}

impl Median {
    pub fn get(&self) -> i32 {
        self.values[2]
    }

    /// Puts a value in; without a branch, since none could be foretold.
    pub fn add(&mut self, value: i32) {
        let first = usize::from(!self.drops_highest);
        let kept: [i32; 4] = array::from_fn(|i| self.values[first + i]);
        let median = self.values[2];
        self.drops_highest = (self.drops_highest & (value < median)) | (!self.drops_highest & (value <= median));
        self.values = array::from_fn(|i| {
            let not_above = if i < 4 { kept[i].min(value) } else { value };
            if i > 0 { not_above.max(kept[i - 1]) } else { not_above }
        });
    }
}
