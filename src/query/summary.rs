//! Statistics of an answer's attributes: what `query` says when nothing is written.
//!
//! Each batch is summed up on the thread that decoded it; what comes out is joined in the order of the batches, so it is
//! the same on any number of threads.

use super::counts::{Counts, ValueCount};
use super::kinds::{Kinds, Widening, wider};
use super::output::contributing;
use super::plan::Plan;
use super::{Answer, Query, QueryError};
use crate::lattice::{BIAS, Lattice};
use crate::points::{Attribute, Batch, Column, Number, Real, ScalarType, Scaling};
use crate::store::Snapshot;
use crate::store::model::{ScanId, StoredAttribute};
use crate::with_column;
use serde::{Serialize, Serializer};
use std::ops::ControlFlow;
use std::sync::Arc;

/// Least, greatest and mean value of one attribute over the points that have it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct AttributeSummary {
    /// The attribute.
    pub name: String,
    /// `u8`, `f64`, ...; `coordinate` for `X`, `Y`, `Z`.
    #[serde(rename = "type")]
    pub ty: &'static str,
    /// Points with a value: not null, and not NaN.
    pub count: u64,
    /// The least value; an extra byte's is scaled, a whole one exact.
    pub min: Option<Number>,
    /// The greatest value.
    pub max: Option<Number>,
    /// The mean.
    #[serde(serialize_with = "mean_as_json")]
    pub mean: Option<f64>,
    /// How many points have each value, ascending: of attributes of a byte that are no colours and have no scaling; else none.
    pub counts: Vec<ValueCount>,
}

fn mean_as_json<S: Serializer>(mean: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    mean.map(Number::Float).serialize(serializer)
}

impl Query {
    /// The answer without its points, and the statistics of `X`, `Y`, `Z` and the attributes asked for over them.
    ///
    /// # Errors
    ///
    /// As [`Query::run`].
    pub fn summary(&self, snapshot: &Snapshot) -> Result<(Answer, Vec<AttributeSummary>), QueryError> {
        let plan = Plan::new(self, snapshot)?;
        let scans = snapshot.scans();
        let met = Kinds::of(snapshot, &contributing(snapshot, plan.scans.as_deref(), &plan.region));
        let form = Form::new(&plan.lattice, &plan.columns, |column| {
            let having: Vec<_> = scans.iter().filter(|s| s.attributes.contains(&column.id)).map(|s| s.id).collect();
            let widened = having.iter().filter_map(|&scan| Some((scan, met.widening(column.id, scan)?))).collect();
            (widened, (having.len() < scans.len()).then_some(having))
        });
        // Where some scan lacks an attribute, or has another kind, it must be known which scan a point is of.
        let needs_scans = form.attributes.iter().any(|a| a.having.is_some() || !a.widened.is_empty());
        let query = self.clone().with_scans(self.with_scans || needs_scans);
        let form = Arc::new(form);
        let here = form.clone();
        let mut summary = form.empty();
        let answer = query.run_mapped(
            snapshot,
            move |batch| here.of(&batch),
            |one| {
                summary.add(&one);
                ControlFlow::Continue(())
            },
        )?;
        Ok((answer, form.finish(&summary)))
    }
}

/// What is summed up.
struct Form {
    lattice: Lattice,
    attributes: Vec<Summed>,
}

/// An attribute that is summed up.
struct Summed {
    attribute: Attribute,
    /// The scans that have it, ascending; `None`: all.
    having: Option<Vec<ScanId>>,
    /// Those whose values are brought to another kind, as in the answer: ascending.
    widened: Vec<(ScanId, Widening)>,
}

/// The statistics of some points.
struct Summary {
    axes: [Axis; 3],
    columns: Vec<Values>,
}

impl Form {
    fn new(
        lattice: &Lattice,
        attributes: &[StoredAttribute],
        scans: impl Fn(&StoredAttribute) -> (Vec<(ScanId, Widening)>, Option<Vec<ScanId>>),
    ) -> Self {
        let summed = |a: &StoredAttribute| {
            let ((widened, having), attribute) = (scans(a), a.attribute.clone());
            Summed { attribute, having, widened }
        };
        Self { lattice: lattice.clone(), attributes: attributes.iter().map(summed).collect() }
    }

    fn empty(&self) -> Summary {
        Summary { axes: [Axis::EMPTY; 3], columns: vec![Values::EMPTY; self.attributes.len()] }
    }

    /// Of a batch; it has its scans if some scan lacks an attribute.
    fn of(&self, batch: &Batch) -> Summary {
        let positions = &batch.positions;
        let axes = [&positions.x, &positions.y, &positions.z].map(|values| Axis::of(values));
        // One of the types is f64 already.
        #[allow(clippy::unnecessary_cast)]
        let column = |(Summed { attribute, having, widened }, column): (&Summed, &Column)| {
            let there = match having.is_none() && attribute.no_data.is_none() {
                true => None,
                false => Some(not_null(attribute, having.as_deref(), column, &batch.scans)),
            };
            let count = there.as_ref().map_or(column.len(), Vec::len);
            let at = |i: usize| there.as_ref().map_or(i, |there| there[i]);
            if !widened.is_empty() {
                let running = Running::of(count, |i| widened_value(widened, column, &batch.scans, at(i)));
                return Values { running, ..Values::EMPTY };
            }
            let running = match &there {
                None => with_column!(column, v => Running::of(count, |i| v[i] as f64)),
                Some(there) => with_column!(column, v => Running::of(count, |i| v[there[i]] as f64)),
            };
            match (attribute.scaling, column) {
                (Some(s), column) => Values { running: running.scaled(s, column.ty().is_float()), ..Values::EMPTY },
                (None, Column::U64(v)) => {
                    Values { running, whole: ends((0..count).map(|i| v[at(i)].into())), ..Values::EMPTY }
                }
                (None, Column::I64(v)) => {
                    Values { running, whole: ends((0..count).map(|i| v[at(i)].into())), ..Values::EMPTY }
                }
                (None, Column::U8(v)) if !COLOURS.contains(&attribute.name.as_str()) => {
                    Values { running, counts: Counts::of((0..count).map(|i| v[at(i)])), ..Values::EMPTY }
                }
                _ => Values { running, ..Values::EMPTY },
            }
        };
        Summary { axes, columns: self.attributes.iter().zip(&batch.columns).map(column).collect() }
    }

    /// X, Y, Z, then the attributes.
    fn finish(&self, summary: &Summary) -> Vec<AttributeSummary> {
        let axes = (0..3).map(|axis| {
            let running = summary.axes[axis].in_world(&self.lattice, axis);
            running.summary(["X", "Y", "Z"][axis], "coordinate")
        });
        // What scans scale in several ways is one attribute to a user.
        let mut joined: Vec<(Attribute, Values)> = Vec::new();
        let columns = || self.attributes.iter().zip(&summary.columns);
        // Of two kinds that meet elsewhere only one may be here.
        let meets = |a: &Attribute, b: &Attribute| a.name == b.name && wider(a).is_some_and(|(ty, _)| ty == b.ty);
        let is_elsewhere = |a: &Attribute, values: &Values| {
            let of_other = |(b, other): (&Summed, &Values)| {
                other.running.count > 0 && (meets(a, &b.attribute) || meets(&b.attribute, a))
            };
            values.running.count == 0 && columns().any(of_other)
        };
        for (Summed { attribute, widened, .. }, values) in columns().filter(|(a, v)| !is_elsewhere(&a.attribute, v)) {
            let wider = wider(attribute).filter(|_| !widened.is_empty());
            let ty = wider.map_or(attribute.ty, |(ty, _)| ty);
            match joined.last_mut() {
                Some((same, all)) if (&same.name, same.ty) == (&attribute.name, ty) => {
                    all.add(values);
                    same.scaling = same.scaling.or(attribute.scaling);
                }
                _ => joined.push((Attribute { ty, ..attribute.clone() }, values.clone())),
            }
        }
        axes.chain(joined.iter().map(|(attribute, values)| values.summary(attribute))).collect()
    }
}

impl Summary {
    fn add(&mut self, next: &Self) {
        self.axes.iter_mut().zip(&next.axes).for_each(|(a, b)| a.add(b));
        self.columns.iter_mut().zip(&next.columns).for_each(|(a, b)| a.add(b));
    }
}

/// An integer that some scans' points have in another kind, as the answer has it.
fn widened_value(widened: &[(ScanId, Widening)], column: &Column, scans: &[ScanId], i: usize) -> f64 {
    let widening = scans.get(i).and_then(|scan| widened.iter().find(|(widened, _)| widened == scan));
    let number = column.number(i);
    match (widening, number) {
        (Some((_, widening)), Number::Unsigned(stored)) => widening.of(stored.into()) as f64,
        (Some((_, widening)), Number::Signed(stored)) => widening.of(stored.into()) as f64,
        _ => number.to_f64(),
    }
}

/// The points that have a value.
fn not_null(attribute: &Attribute, having: Option<&[ScanId]>, column: &Column, scans: &[ScanId]) -> Vec<usize> {
    let no_data = attribute.no_data.map(|mut bytes| {
        bytes[attribute.ty.size()..].fill(0);
        bytes
    });
    let lacking = |having: &[ScanId], i: usize| scans.get(i).is_some_and(|scan| having.binary_search(scan).is_err());
    let is_null = |i: usize| having.is_some_and(|h| lacking(h, i)) || no_data.is_some_and(|n| column.raw(i) == n);
    (0..column.len()).filter(|&i| !is_null(i)).collect()
}

/// Lattice indices along an axis: their sum is exact.
#[derive(Clone, Copy, Debug)]
struct Axis {
    count: u64,
    min: u64,
    max: u64,
    /// Of the steps from the middle of the lattice.
    sum: i128,
}

impl Axis {
    const EMPTY: Self = Self { count: 0, min: u64::MAX, max: 0, sum: 0 };

    fn of(indices: &[u64]) -> Self {
        let mut axis = Self::EMPTY;
        // 2^12 steps of 49 bits.
        for run in indices.chunks(1 << 12) {
            let (mut min, mut max, mut sum) = (u64::MAX, 0, 0_i64);
            for &index in run {
                min = min.min(index);
                max = max.max(index);
                sum += index as i64 - BIAS;
            }
            axis.add(&Self { count: run.len() as u64, min, max, sum: sum.into() });
        }
        axis
    }

    fn add(&mut self, next: &Self) {
        self.count += next.count;
        self.min = self.min.min(next.min);
        self.max = self.max.max(next.max);
        self.sum += next.sum;
    }

    fn in_world(&self, lattice: &Lattice, axis: usize) -> Running {
        if self.count == 0 {
            return Running::EMPTY;
        }
        let count = i128::from(self.count);
        let (whole, rest) = (self.sum.div_euclid(count), self.sum.rem_euclid(count));
        let of_rest = rest as f64 / self.count as f64 * lattice.quantum_f64()[axis];
        let mean = lattice.world_on_axis(axis, (whole + i128::from(BIAS)) as u64) + of_rest;
        let [min, max] = [self.min, self.max].map(|index| lattice.world_on_axis(axis, index));
        Running { count: self.count, min, max, mean }
    }
}

/// The least and the greatest.
fn ends(values: impl Iterator<Item = i128>) -> Option<[i128; 2]> {
    values.fold(None, |ends, v| Some(ends.map_or([v, v], |[a, b]: [i128; 2]| [a.min(v), b.max(v)])))
}

/// Their 256 values say nothing one by one.
const COLOURS: [&str; 4] = ["Red", "Green", "Blue", "Infrared"];

/// The values of an attribute.
#[derive(Clone, Debug, PartialEq)]
struct Values {
    running: Running,
    /// The ends of values that are whole and may have more digits than an f64.
    whole: Option<[i128; 2]>,
    counts: Counts,
}

impl Values {
    const EMPTY: Self = Self { running: Running::EMPTY, whole: None, counts: Counts::NONE };

    fn add(&mut self, next: &Self) {
        self.running.add(&next.running);
        self.whole = ends(self.whole.into_iter().chain(next.whole).flatten());
        self.counts.add(&next.counts);
    }

    fn summary(&self, attribute: &Attribute) -> AttributeSummary {
        let counts = self.counts.there();
        let summary = AttributeSummary { counts, ..self.running.summary(&attribute.name, attribute.ty.word()) };
        if attribute.scaling.is_some() || attribute.ty.is_float() {
            return summary;
        }
        let signed = matches!(attribute.ty, ScalarType::I8 | ScalarType::I16 | ScalarType::I32 | ScalarType::I64);
        let number = |v: i128| if signed { Number::Signed(v as i64) } else { Number::Unsigned(v as u64) };
        let short = |v: Option<Number>| v.map(|v| v.to_f64() as i128);
        let (min, max) = (short(summary.min), short(summary.max));
        let [min, max] = self.whole.map_or([min, max], |ends| ends.map(Some)).map(|v| v.map(number));
        AttributeSummary { min, max, ..summary }
    }
}

/// A mean that neither overflows nor loses small numbers after many.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Running {
    count: u64,
    min: f64,
    max: f64,
    mean: f64,
}

impl Running {
    const EMPTY: Self = Self { count: 0, min: f64::INFINITY, max: f64::NEG_INFINITY, mean: 0.0 };

    /// Of so many values, those that are NaN left out.
    fn of(values: usize, value: impl Fn(usize) -> f64) -> Self {
        /// Values whose plain sum is taken, if it is finite.
        const RUN: usize = 1 << 10;
        let mut all = Self::EMPTY;
        for first in (0..values).step_by(RUN) {
            let (mut count, mut min, mut max, mut sum) = (0_u32, f64::INFINITY, f64::NEG_INFINITY, 0.0);
            let run = first..values.min(first + RUN);
            for value in run.clone().map(&value) {
                // NaN is neither below nor above, and adds nothing.
                count += u32::from(!value.is_nan());
                min = min.min(value);
                max = max.max(value);
                sum += if value.is_nan() { 0.0 } else { value };
            }
            let count = u64::from(count);
            if sum.is_finite() {
                all.add(&Self { count, min, max, mean: sum / count.max(1) as f64 });
            } else {
                let one = |value: f64| Self { count: 1, min: value, max: value, mean: value };
                run.map(&value).filter(|v| !v.is_nan()).for_each(|value| all.add(&one(value)));
            }
        }
        all
    }

    fn add(&mut self, next: &Self) {
        if next.count == 0 {
            return;
        }
        self.count += next.count;
        self.min = self.min.min(next.min);
        self.max = self.max.max(next.max);
        // Halves, so that a difference of the greatest numbers is one.
        let half = next.mean / 2.0 - self.mean / 2.0;
        self.mean += half * (next.count as f64 / self.count as f64) * 2.0;
    }

    fn scaled(self, scaling: Scaling, is_float: bool) -> Self {
        if self.count == 0 {
            return Self::EMPTY;
        }
        let real = Real::new(Some(scaling));
        let end = |v: f64| if is_float { real.of_float(v) } else { real.of_integer(v as i128) };
        let (a, b) = (end(self.min), end(self.max));
        Self { min: a.min(b), max: a.max(b), mean: real.of_float(self.mean), ..self }
    }

    fn summary(&self, name: &str, ty: &'static str) -> AttributeSummary {
        let some = |v: f64| (self.count > 0 && !v.is_nan()).then_some(v);
        let (min, max) = (some(self.min).map(Number::Float), some(self.max).map(Number::Float));
        // The mean of infinite values is theirs, in whatever order they came; of both signs there is none.
        let infinite: f64 = [self.min, self.max].into_iter().filter(|v| v.is_infinite()).sum();
        let mean = some(if infinite == 0.0 { self.mean } else { infinite });
        AttributeSummary { name: name.into(), ty, count: self.count, min, max, mean, counts: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::LatticePoint;
    use crate::points::{Positions, ScalarType, Scaling};
    use proptest::prelude::*;

    #[test]
    fn nulls_and_nan_are_left_out() {
        let mut height = Attribute::new("height", ScalarType::I16);
        height.scaling = Some(Scaling { scale: 0.5, offset: 1.0 });
        height.no_data = Some((-1_i16).to_le_bytes().into_iter().chain([9; 6]).collect::<Vec<_>>().try_into().unwrap());
        let attributes = [height, Attribute::new("time", ScalarType::F64)];
        let stored: Vec<_> =
            (2..).zip(attributes.clone()).map(|(id, attribute)| StoredAttribute { id, attribute }).collect();
        let lattice = Lattice::uniform(0.25).unwrap();
        let form = Form::new(&lattice, &stored, |a| (Vec::new(), (a.id == 2).then(|| vec![7])));
        let positions: Positions = (0..4).map(|i| LatticePoint([BIAS as u64 + i; 3])).collect();
        let columns = vec![Column::I16(vec![4, -1, 8, 100]), Column::F64(vec![1.0, f64::NAN, 3.0, 8.0])];
        let mut summary = form.empty();
        summary.add(&form.of(&Batch { attributes: attributes.into(), positions, scans: vec![7, 7, 7, 5], columns }));
        let found = form.finish(&summary);
        let short = |v: Option<Number>| v.map(Number::to_f64);
        let numbers = |i: usize| (found[i].count, short(found[i].min), short(found[i].max), found[i].mean);
        assert_eq!(numbers(0), (4, Some(0.0), Some(0.75), Some(0.375)));
        assert_eq!(numbers(3), (2, Some(3.0), Some(5.0), Some(4.0)));
        assert_eq!(numbers(4), (3, Some(1.0), Some(8.0), Some(4.0)));
        assert_eq!(found[3].ty, "i16");
        let none = form.finish(&form.empty());
        assert_eq!((none[0].count, none[0].mean), (0, None));
    }

    /// A region that had only points of one kind told of both, of one of them with no values.
    #[test]
    fn a_kind_of_a_colour_that_is_not_here_is_not_told() {
        let kinds = [ScalarType::U8, ScalarType::U16];
        let attributes = kinds.map(|ty| Attribute::new("Red", ty));
        let stored: Vec<_> =
            (2..).zip(attributes.clone()).map(|(id, attribute)| StoredAttribute { id, attribute }).collect();
        // Scan 5 has the first, scan 7 the second.
        let form = Form::new(&Lattice::uniform(0.25).unwrap(), &stored, |a| {
            (Vec::new(), Some(vec![if a.id == 2 { 5 } else { 7 }]))
        });
        for (here, scan) in kinds.into_iter().zip([5, 7]) {
            let positions = [LatticePoint([BIAS as u64; 3])].into_iter().collect();
            let columns = vec![Column::U8(vec![20]), Column::U16(vec![3000])];
            let batch = Batch { attributes: attributes.clone().into(), positions, scans: vec![scan], columns };
            let mut summary = form.empty();
            summary.add(&form.of(&batch));
            let told: Vec<_> = form.finish(&summary)[3..].iter().map(|s| (s.ty, s.count)).collect();
            assert_eq!(told, [(here.word(), 1)]);
        }
        assert_eq!(form.finish(&form.empty()).len(), 5, "of neither is anything known");
    }

    #[test]
    fn whole_numbers_keep_all_their_digits() {
        // They went through f64: 2^53 + 1 was told as 2^53.
        let mut there = Attribute::new("id", ScalarType::U64);
        there.no_data = Some(7_u64.to_le_bytes());
        let attributes = [there, Attribute::new("signed", ScalarType::I64), Attribute::new("small", ScalarType::I8)];
        let stored: Vec<_> =
            (2..).zip(attributes.clone()).map(|(id, attribute)| StoredAttribute { id, attribute }).collect();
        let form = Form::new(&Lattice::uniform(0.25).unwrap(), &stored, |_| (Vec::new(), None));
        let mut summary = form.empty();
        for [id, signed, small] in [[(1 << 53) + 1, i64::MIN + 1, -3], [7, i64::MAX, 100], [1 << 60, 0, 0]] {
            let positions = [LatticePoint([BIAS as u64; 3])].into_iter().collect();
            let columns = vec![Column::U64(vec![id as u64]), Column::I64(vec![signed]), Column::I8(vec![small as i8])];
            summary.add(&form.of(&Batch { attributes: attributes.clone().into(), positions, scans: vec![], columns }));
        }
        let text = |s: &AttributeSummary| format!("{} {}", s.min.unwrap(), s.max.unwrap());
        let found: Vec<_> = form.finish(&summary)[3..].iter().map(text).collect();
        let all = ["9007199254740993 1152921504606846976", "-9223372036854775807 9223372036854775807", "-3 100"];
        assert_eq!(found, all);
    }

    #[test]
    fn sums_that_overflow_have_their_mean_all_the_same() {
        let of = |values: &[f64]| Running::of(values.len(), |i| values[i]);
        let large = of(&[f64::MAX; 5000]);
        assert_eq!((large.count, large.mean, large.max), (5000, f64::MAX, f64::MAX));
        let mut both = large;
        both.add(&of(&[-f64::MAX; 5000]));
        assert!(both.mean.abs() < f64::MAX * 1e-12, "{both:?}");
        // Infinite values are told as such, and of both signs have no mean.
        let up = f64::INFINITY;
        for (values, [min, max], mean) in [
            ([1.0, up, 3.0], [1.0, up], Some(up)),
            ([-up, 2.0, f64::NAN], [-up, 2.0], Some(-up)),
            ([up, 0.0, -up], [-up, up], None),
        ] {
            let told = of(&values).summary("a", "f64");
            assert_eq!((told.min, told.max), (Some(Number::Float(min)), Some(Number::Float(max))));
            assert_eq!(told.mean, mean, "{values:?}");
        }
        assert_eq!(of(&[f64::NAN; 9]), Running::EMPTY);
    }

    proptest! {
        #[test]
        fn however_they_are_cut_the_statistics_are_those_of_all_values(
            values in prop::collection::vec(prop_oneof![Just(f64::NAN), -1e6..1e6], 0..5000), cut in 0.0..1.0,
        ) {
            let of = |values: &[f64]| Running::of(values.len(), |i| values[i]);
            let (head, tail) = values.split_at((values.len() as f64 * cut) as usize);
            let mut joined = of(head);
            joined.add(&of(tail));
            let numbers: Vec<f64> = values.iter().copied().filter(|v| !v.is_nan()).collect();
            prop_assert_eq!(joined.count, numbers.len() as u64);
            prop_assert_eq!(joined.min, numbers.iter().copied().fold(f64::INFINITY, f64::min));
            prop_assert_eq!(joined.max, numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max));
            let mean = numbers.iter().sum::<f64>() / numbers.len().max(1) as f64;
            prop_assert!((joined.mean - mean).abs() <= 1e-9, "{} and {}", joined.mean, mean);
        }

        #[test]
        fn means_of_positions_are_exact_at_both_ends_of_the_lattice(
            indices in prop::collection::vec(prop_oneof![0..50_u64, (1 << 48) - 50..1_u64 << 48], 1..5000),
        ) {
            let axis = Axis::of(&indices).in_world(&Lattice::uniform(1.0).unwrap(), 0);
            let sum: i128 = indices.iter().map(|&i| i128::from(i) - i128::from(BIAS)).sum();
            let mean = sum as f64 / indices.len() as f64;
            prop_assert!((axis.mean - mean).abs() <= mean.abs() * 1e-15, "{} and {}", axis.mean, mean);
        }
    }
}
