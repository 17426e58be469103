//! A range of values stretched to 0 to 1.

/// Percentiles are taken over at most about this many values, evenly picked: more change nothing that an eye can see.
const SAMPLE: usize = 1 << 20;

/// Maps a range of values to 0 to 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stretch {
    low: f64,
    high: f64,
}

impl Stretch {
    /// The range given, or the 1st to the 99th percentile of the finite values of all columns, each given as its length
    /// and a function of the row.
    pub fn new<F: Fn(usize) -> f64>(
        range: Option<[f64; 2]>,
        columns: impl Iterator<Item = (usize, F)> + Clone,
    ) -> Self {
        if let Some([low, high]) = range {
            return Self { low, high };
        }
        let total: usize = columns.clone().map(|(len, _)| len).sum();
        let step = total.div_ceil(SAMPLE).max(1);
        let mut sample: Vec<f64> = Vec::with_capacity(total / step + 1);
        // Every step-th row, counted across the columns.
        let mut next = 0;
        for (len, value) in columns {
            sample.extend((next..len).step_by(step).map(value).filter(|v| v.is_finite()));
            next = (next + (len.saturating_sub(next)).div_ceil(step) * step) - len;
        }
        let Some(last) = sample.len().checked_sub(1) else { return Self { low: 0.0, high: 0.0 } };
        let low = *sample.select_nth_unstable_by(last / 100, f64::total_cmp).1;
        let high = *sample.select_nth_unstable_by(last - last / 100, f64::total_cmp).1;
        Self { low, high }
    }

    /// The values at 0 and at 1.
    pub fn ends(&self) -> [f64; 2] {
        [self.low, self.high]
    }

    /// Where `value` is in the range: 0 at or below its lower end, 1 at or above the upper; the middle if the range has
    /// no extent, 0 for NaN.
    pub fn place(&self, value: f64) -> f64 {
        if self.high <= self.low {
            return if value.is_nan() { 0.0 } else { 0.5 };
        }
        // Halved, so that the widest ranges of f64 don't overflow.
        let place = (value / 2.0 - self.low / 2.0) / (self.high / 2.0 - self.low / 2.0);
        if place.is_nan() { 0.0 } else { place.clamp(0.0, 1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: &[f64]) -> Stretch {
        Stretch::new(None, [(values.len(), |i: usize| values[i])].into_iter())
    }

    #[test]
    fn outliers_do_not_stretch_the_range() {
        let mut values: Vec<f64> = (0..1000).map(f64::from).collect();
        values.extend([1e30, -1e30, f64::NAN, f64::INFINITY]);
        let stretch = of(&values);
        assert!((0.0..=20.0).contains(&stretch.low) && (980.0..=1000.0).contains(&stretch.high), "{stretch:?}");
    }

    #[test]
    fn every_value_has_a_place_from_0_to_1() {
        let extremes = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, 0.0];
        for stretch in [of(&[]), of(&[3.0]), of(&[f64::MIN, f64::MAX]), of(&[0.0, 1.0])] {
            for value in extremes {
                assert!((0.0..=1.0).contains(&stretch.place(value)), "{stretch:?} {value}");
            }
        }
        assert_eq!(of(&[2.0, 4.0]).place(3.0), 0.5);
    }

    #[test]
    fn many_columns_are_sampled_evenly() {
        let columns: Vec<Vec<f64>> = (0..3000).map(|c| vec![f64::from(c); 1000]).collect();
        let stretch = Stretch::new(None, columns.iter().map(|c| (c.len(), |i: usize| c[i])));
        assert!((25.0..=35.0).contains(&stretch.low) && (2960.0..=2975.0).contains(&stretch.high), "{stretch:?}");
    }
}
