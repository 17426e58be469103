//! Least squares of a few unknowns.

/// Sums of a fit `y = rates . x` over samples.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::codec) struct Fit {
    /// Sums of products of `x`: xx, xy, xz, yy, yz, zz.
    products: [f64; 6],
    /// Sums of products with `y`.
    with: [f64; 3],
    /// Sums of `x` and `y`, for fits that have a constant.
    sums: [f64; 4],
    count: f64,
}

impl Fit {
    #[inline]
    pub(in crate::codec) fn add(&mut self, x: [f64; 3], y: f64) {
        let [a, b, c] = x;
        for (sum, product) in self.products.iter_mut().zip([a * a, a * b, a * c, b * b, b * c, c * c]) {
            *sum += product;
        }
        for (sum, x) in self.with.iter_mut().zip(x) {
            *sum += x * y;
        }
        for (sum, value) in self.sums.iter_mut().zip([a, b, c, y]) {
            *sum += value;
        }
        self.count += 1.0;
    }

    /// The rates of `y = rates . x`.
    pub(in crate::codec) fn through_origin(&self) -> [f64; 3] {
        solve(self.products, self.with)
    }

    /// The constant of `y = rates . x + constant`.
    pub(in crate::codec) fn constant(&self, rates: [f64; 3]) -> f64 {
        let [a, b, c, y] = self.sums;
        (y - a * rates[0] - b * rates[1] - c * rates[2]) / self.count.max(1.0)
    }

    /// The rates of `y = rates . x + constant`.
    pub(in crate::codec) fn with_constant(&self) -> [f64; 3] {
        let [a, b, c, y] = self.sums.map(|sum| sum / self.count.max(1.0));
        let [sa, sb, sc, _] = self.sums;
        let centre = [sa * a, sa * b, sa * c, sb * b, sb * c, sc * c];
        let products = std::array::from_fn(|i| self.products[i] - centre[i]);
        solve(products, [self.with[0] - sa * y, self.with[1] - sb * y, self.with[2] - sc * y])
    }
}

/// Solves a symmetric system; what the samples leave open becomes small, and what is not finite zero.
fn solve(products: [f64; 6], with: [f64; 3]) -> [f64; 3] {
    let [aa, ab, ac, bb, bc, cc] = products;
    let ridge = RIDGE * (aa + bb + cc) + f64::MIN_POSITIVE;
    let mut rows = [[aa + ridge, ab, ac, with[0]], [ab, bb + ridge, bc, with[1]], [ac, bc, cc + ridge, with[2]]];
    // The matrix is positive definite, so no pivot is needed.
    for i in 0..3 {
        for r in i + 1..3 {
            let factor = rows[r][i] / rows[i][i];
            for c in i..4 {
                rows[r][c] -= factor * rows[i][c];
            }
        }
    }
    let mut rates = [0.0; 3];
    for i in (0..3).rev() {
        let known: f64 = (i + 1..3).map(|c| rows[i][c] * rates[c]).sum();
        rates[i] = (rows[i][3] - known) / rows[i][i];
    }
    rates.map(|rate| if rate.is_finite() { rate } else { 0.0 })
}

/// How much of the samples' spread counts against large rates.
const RIDGE: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn planes_are_found(
            rates in prop::array::uniform3(-10.0_f64..10.0),
            constant in -1e3_f64..1e3,
            xs in prop::collection::vec(prop::array::uniform3(-100.0_f64..100.0), 30..60),
        ) {
            let (mut through, mut with): (Fit, Fit) = Default::default();
            for x in &xs {
                let y: f64 = (0..3).map(|i| x[i] * rates[i]).sum();
                through.add(*x, y);
                with.add(*x, y + constant);
            }
            for found in [through.through_origin(), with.with_constant()] {
                for (found, rate) in found.into_iter().zip(rates) {
                    prop_assert!((found - rate).abs() < 1e-2, "{found} {rate}");
                }
            }
        }
    }

    #[test]
    fn nothing_gives_nothing() {
        assert_eq!(Fit::default().through_origin(), [0.0; 3]);
        assert_eq!(Fit::default().with_constant(), [0.0; 3]);
    }
}
