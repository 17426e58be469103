//! How a node's own points lie: bounds, mean, moments, radius, spacing. Functions of the set of points and its order by
//! key alone: sums are of integers, and samples are taken by rank.

use super::model::Shape;
use crate::lattice::{Cube, Key, LOW_DIGITS, LatticeBox, LatticePoint, PRIORITY_MASK, SortKey};

/// Points whose nearest neighbour is looked for.
const SAMPLE: usize = 256;

/// Neighbours in key order on each side that are looked at.
const WINDOW: usize = 16;

/// Coordinates relative to a cube's low corner, by axis; kept between nodes.
#[derive(Debug, Default)]
pub(super) struct Relative {
    /// Of cubes of exponent at most 21.
    narrow: [Vec<u32>; 3],
    /// Of any other.
    wide: [Vec<u64>; 3],
}

impl Relative {
    /// Of the points with these keys, which are inside `cube`.
    pub fn fill<K: SortKey>(&mut self, cube: Cube, keys: &[K]) {
        self.narrow.iter_mut().for_each(Vec::clear);
        self.wide.iter_mut().for_each(Vec::clear);
        if cube.k() <= LOW_DIGITS {
            // One axis after the other, so that the compiler takes several keys at a time.
            let inside = cube.side() - 1;
            let flip = PRIORITY_MASK & inside;
            for (axis, column) in self.narrow.iter_mut().enumerate() {
                column.extend(keys.iter().map(|key| ((compact(key.halves().1 >> axis) & inside) ^ flip) as u32));
            }
        } else {
            let low = cube.low().0;
            for key in keys {
                let (high, rest) = key.halves();
                let point = Key { high, low: rest }.point().0;
                self.wide.iter_mut().enumerate().for_each(|(i, column)| column.push(point[i].wrapping_sub(low[i])));
            }
        }
    }

    fn is_narrow(&self) -> bool {
        self.wide[0].is_empty()
    }

    fn len(&self) -> usize {
        self.narrow[0].len() + self.wide[0].len()
    }

    /// Tight bounds.
    pub fn bounds(&self, cube: Cube) -> Option<LatticeBox> {
        let low = cube.low().0;
        let mut bounds = LatticeBox::of(LatticePoint::default());
        for axis in 0..3 {
            let (least, greatest) = if self.is_narrow() {
                let (least, greatest) = extremes(&self.narrow[axis], u32::MAX)?;
                (u64::from(least), u64::from(greatest))
            } else {
                extremes(&self.wide[axis], u64::MAX)?
            };
            bounds.min.0[axis] = low[axis].saturating_add(least);
            bounds.max.0[axis] = low[axis].saturating_add(greatest);
        }
        Some(bounds)
    }

    /// Everything but the colour.
    pub fn shape(&self) -> Shape {
        let n = self.len();
        if n == 0 {
            return Shape::default();
        }
        let Sums { one, two } = self.sums();
        let count = n as f64;
        let mean = one.map(|s| s as f64 / count);
        // Exactly about the nearest lattice point to the mean, so that nothing cancels; the rest, below half a step, in
        // floats.
        let n = n as i128;
        let center = one.map(|s| (2 * s + n).div_euclid(2 * n));
        let rest: [f64; 3] = std::array::from_fn(|i| (one[i] - n * center[i]) as f64 / count);
        let mut moments = [0.0; 6];
        for (m, (i, j)) in PAIRS.into_iter().enumerate() {
            let about = two[m] - center[i] * one[j] - center[j] * one[i] + n * center[i] * center[j];
            moments[m] = about as f64 / count - rest[i] * rest[j];
        }
        Shape { spacing: self.spacing(), mean, moments, radius: self.radius(mean), color: None }
    }

    fn sums(&self) -> Sums {
        if !self.is_narrow() {
            let wide = |v: u64| i128::from(v);
            let axes = &self.wide;
            return Sums {
                one: std::array::from_fn(|i| axes[i].iter().map(|&v| wide(v)).sum()),
                two: PAIRS.map(|(i, j)| axes[i].iter().zip(&axes[j]).map(|(&a, &b)| wide(a) * wide(b)).sum()),
            };
        }
        // Coordinates are below 2^21: 2^22 of their products fit 64 bits.
        const RUN: usize = 1 << 22;
        let sum = |v: &[u32]| i128::from(v.iter().map(|&v| u64::from(v)).sum::<u64>());
        let product = |(a, b): (&[u32], &[u32])| {
            i128::from(a.iter().zip(b).map(|(&a, &b)| u64::from(a) * u64::from(b)).sum::<u64>())
        };
        let axes = &self.narrow;
        Sums {
            one: std::array::from_fn(|i| axes[i].chunks(RUN).map(sum).sum()),
            two: PAIRS.map(|(i, j)| axes[i].chunks(RUN).zip(axes[j].chunks(RUN)).map(product).sum()),
        }
    }

    fn point(&self, i: usize) -> [f64; 3] {
        // Below 2^48: exact, and signed conversions are cheaper.
        if self.is_narrow() {
            std::array::from_fn(|axis| f64::from(self.narrow[axis][i] as i32))
        } else {
            std::array::from_fn(|axis| self.wide[axis][i] as i64 as f64)
        }
    }

    /// The largest distance from `mean`, rounded up.
    fn radius(&self, mean: [f64; 3]) -> f64 {
        let largest = if self.is_narrow() {
            // In lanes, since a maximum of floats that waits for the one before it is slow.
            const LANES: usize = 8;
            let mut largest = [0.0_f64; LANES];
            let [x, y, z] = self.narrow.each_ref().map(|axis| axis.chunks(LANES));
            for ((x, y), z) in x.zip(y).zip(z) {
                for (largest, ((&x, &y), &z)) in largest.iter_mut().zip(x.iter().zip(y).zip(z)) {
                    let square = square([x, y, z].map(|v| f64::from(v as i32)), mean);
                    *largest = if square > *largest { square } else { *largest };
                }
            }
            largest.into_iter().fold(0.0, f64::max)
        } else {
            (0..self.len()).map(|i| square(self.point(i), mean)).fold(0.0, f64::max)
        };
        largest.sqrt() * (1.0 + 4.0 * f64::EPSILON)
    }

    /// The mean distance to the nearest neighbour, over a sample that is even in key order, each against its neighbours
    /// in that order; 0 for a single point.
    fn spacing(&self) -> f64 {
        let n = self.len();
        if n < 2 {
            return 0.0;
        }
        let samples = n.min(SAMPLE);
        let nearest = |i: usize| {
            let here = self.point(i);
            let around = i.saturating_sub(WINDOW)..(i + WINDOW + 1).min(n);
            around.filter(|&j| j != i).map(|j| square(here, self.point(j))).fold(f64::INFINITY, f64::min).sqrt()
        };
        (0..samples).map(|s| nearest(s * n / samples)).sum::<f64>() / samples as f64
    }
}

/// The least and the greatest; `most` is the type's greatest value.
fn extremes<T: Copy + Ord + Default>(values: &[T], most: T) -> Option<(T, T)> {
    let both = values.iter().fold((most, T::default()), |(low, high), &v| (low.min(v), high.max(v)));
    (!values.is_empty()).then_some(both)
}

/// Sums over points of coordinates, and of products of coordinates.
struct Sums {
    one: [i128; 3],
    two: [i128; 6],
}

/// The axes of the six moments.
const PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

fn square(a: [f64; 3], b: [f64; 3]) -> f64 {
    let [x, y, z] = std::array::from_fn(|i| (a[i] - b[i]) * (a[i] - b[i]));
    x + y + z
}

/// Gathers every third bit of the low 63 bits of `v`.
#[inline]
fn compact(v: u64) -> u64 {
    let mut x = v & 0x1249_2492_4924_9249;
    x = (x | x >> 2) & 0x10c3_0c30_c30c_30c3;
    x = (x | x >> 4) & 0x100f_00f0_0f00_f00f;
    x = (x | x >> 8) & 0x001f_0000_ff00_00ff;
    x = (x | x >> 16) & 0x001f_0000_0000_ffff;
    (x | x >> 32) & 0x1f_ffff
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points() -> impl Strategy<Value = (Cube, Vec<LatticePoint>)> {
        (
            prop::array::uniform3(0_u64..1 << 48),
            0_u8..=48,
            prop::collection::vec(prop::array::uniform3(any::<u64>()), 1..60),
        )
            .prop_map(|(corner, k, points)| {
                let cube = Cube::containing(LatticePoint(corner), k);
                let inside =
                    |p: [u64; 3]| LatticePoint(std::array::from_fn(|i| cube.low().0[i] | p[i] & (cube.side() - 1)));
                let mut points: Vec<_> = points.into_iter().map(inside).collect();
                points.sort_by_key(|p| Key::of(*p));
                (cube, points)
            })
    }

    proptest! {
        #[test]
        fn shapes_are_those_of_the_naive_sums((cube, points) in points()) {
            let mut relative = Relative::default();
            let keys: Vec<_> = points.iter().map(|p| Key::of(*p)).collect();
            relative.fill(cube, &keys);
            let low = cube.low().0;
            for (i, p) in points.iter().enumerate() {
                prop_assert_eq!(relative.point(i), [0, 1, 2].map(|a| (p.0[a] - low[a]) as f64));
            }
            let naive = points.iter().fold(LatticeBox::of(points[0]), |b, p| b.with(*p));
            prop_assert_eq!(relative.bounds(cube), Some(naive));
            let shape = relative.shape();
            if cube.k() <= LOW_DIGITS {
                let low_keys: Vec<_> = points.iter().map(|p| p.low_key()).collect();
                let mut other = Relative::default();
                other.fill(cube, &low_keys);
                prop_assert_eq!(other.shape(), shape);
                let wide = relative.narrow.each_ref().map(|axis| axis.iter().map(|&v| v.into()).collect());
                let other = Relative { wide, ..Relative::default() };
                prop_assert_eq!(relative.sums().two, other.sums().two);
                prop_assert_eq!((other.shape(), other.bounds(cube)), (shape, relative.bounds(cube)));
            }
            let side = cube.side() as f64;
            let n = points.len() as f64;
            for (a, found) in shape.mean.into_iter().enumerate() {
                let mean = points.iter().map(|p| (p.0[a] - low[a]) as f64).sum::<f64>() / n;
                prop_assert!((mean - found).abs() <= side * 1e-12);
            }
            for (m, (i, j)) in PAIRS.into_iter().enumerate() {
                let about = |p: &LatticePoint, a: usize| (p.0[a] - low[a]) as f64 - shape.mean[a];
                let naive = points.iter().map(|p| about(p, i) * about(p, j)).sum::<f64>() / n;
                prop_assert!((naive - shape.moments[m]).abs() <= side * side * 1e-12, "{naive} {:?}", shape.moments);
            }
            for i in 0..points.len() {
                prop_assert!(square(relative.point(i), shape.mean).sqrt() <= shape.radius);
            }
        }
    }

    #[test]
    fn spacing_of_a_regular_grid_is_its_step() {
        let cube = Cube::containing(LatticePoint([0; 3]), 7);
        let mut keys: Vec<_> = (0..32 * 32_u64).map(|i| LatticePoint([i % 32 * 4, i / 32 * 4, 5]).low_key()).collect();
        keys.sort_unstable();
        let mut relative = Relative::default();
        relative.fill(cube, &keys);
        let spacing = relative.shape().spacing;
        assert!((4.0..4.2).contains(&spacing), "{spacing}");
        relative.fill(cube, &keys[..1]);
        assert_eq!(relative.shape().spacing, 0.0);
    }
}
