//! A bound filter on the columns of a block: masks of what is true and of what is false; the rest is unknown.

use super::bind::{Bound, Source};
use super::parser::Relation;
use super::set::{ValueSet, in_any, scaled};
use crate::points::Column;
use crate::query::block::Block;
use crate::query::mask::Mask;
use std::cmp::Ordering;

/// True, false, or unknown where neither.
struct Truth {
    yes: Mask,
    no: Mask,
}

/// The points for which the filter is true.
pub(super) fn matching(bound: &Bound, block: &Block) -> Mask {
    truth(bound, block).yes
}

fn truth(bound: &Bound, block: &Block) -> Truth {
    let len = block.len;
    match bound {
        Bound::Not(inner) => {
            let Truth { yes, no } = truth(inner, block);
            Truth { yes: no, no: yes }
        }
        Bound::And(terms) => {
            let mut all = Truth { yes: Mask::all(len), no: Mask::none(len) };
            for term in terms {
                let Truth { yes, no } = truth(term, block);
                all.yes.and(&yes);
                all.no.or(&no);
            }
            all
        }
        Bound::Or(terms) => {
            let mut any = Truth { yes: Mask::none(len), no: Mask::all(len) };
            for term in terms {
                let Truth { yes, no } = truth(term, block);
                any.yes.or(&yes);
                any.no.and(&no);
            }
            any
        }
        Bound::Scans(set) => two_valued(block.scans.within(set, len)),
        Bound::Axis(axis, set) => {
            let positions = &block.positions;
            let values = [&positions.x, &positions.y, &positions.z][*axis];
            let intervals = match set {
                ValueSet::Integers(intervals) => intervals.as_slice(),
                ValueSet::Floats { .. } => &[],
            };
            two_valued(within_integers(values, intervals))
        }
        Bound::Null(sources) => {
            let mut null = Mask::all(len);
            sources.iter().for_each(|s| null.and_not(&present(s, block)));
            two_valued(null)
        }
        Bound::Values(tests) => {
            let mut open = Mask::all(len);
            let mut result = Truth { yes: Mask::none(len), no: Mask::none(len) };
            for (source, set) in tests {
                let Some(column) = block.column(source.slot) else { continue };
                let mut here = present(source, block);
                here.and(&open);
                open.and_not(&here);
                let mut inside = within(column, set);
                inside.and(&here);
                let mut outside = here;
                outside.and_not(&inside);
                outside.and_not(&nans(column, source));
                result.yes.or(&inside);
                result.no.or(&outside);
            }
            result
        }
        Bound::Pair(left, relation, right) => {
            let orders: Vec<Option<Ordering>> =
                (0..len).map(|i| compare(value(left, block, i)?, value(right, block, i)?)).collect();
            let holds = |o: Option<Ordering>| o.is_some_and(|o| holds(*relation, o));
            let yes = Mask::where_each(&orders, holds);
            let no = Mask::where_each(&orders, |o| o.is_some() && !holds(o));
            Truth { yes, no }
        }
    }
}

fn two_valued(yes: Mask) -> Truth {
    let mut no = Mask::all(yes.len());
    no.and_not(&yes);
    Truth { yes, no }
}

/// The points that have a value: whose scan has the attribute, and whose stored value is not the one for no data.
fn present(source: &Source, block: &Block) -> Mask {
    let len = block.len;
    let Some(column) = block.column(source.slot) else { return Mask::none(len) };
    let mut mask = match &source.scans {
        None => Mask::all(len),
        Some(scans) => block.scans.within(scans, len),
    };
    if let Some(no_data) = source.no_data {
        mask.and_not(&Mask::where_index(len, |i| column.raw(i) == no_data));
    }
    mask
}

/// The points whose value is NaN.
fn nans(column: &Column, source: &Source) -> Mask {
    match (column, source.scaling) {
        (Column::F32(v), None) => Mask::where_each(v, f32::is_nan),
        (Column::F64(v), None) => Mask::where_each(v, f64::is_nan),
        (_, None) => Mask::none(column.len()),
        (column, scaling) => Mask::where_index(column.len(), |i| scaled(scaling, column.as_f64(i)).is_nan()),
    }
}

/// The points whose stored value is in the set.
fn within(column: &Column, set: &ValueSet) -> Mask {
    match set {
        ValueSet::Integers(intervals) => match column {
            Column::U8(v) => within_bytes(v, |v| v, i128::from, intervals),
            Column::I8(v) => within_bytes(v, |v| v as u8, |b| i128::from(b as i8), intervals),
            Column::U16(v) => within_integers(v, intervals),
            Column::I16(v) => within_integers(v, intervals),
            Column::U32(v) => within_integers(v, intervals),
            Column::I32(v) => within_integers(v, intervals),
            Column::U64(v) => within_integers(v, intervals),
            Column::I64(v) => within_integers(v, intervals),
            Column::F32(_) | Column::F64(_) => Mask::none(column.len()),
        },
        ValueSet::Floats { scaling: None, intervals } => match column {
            Column::F32(v) => within_floats(v, f64::from, intervals),
            Column::F64(v) => within_floats(v, |v| v, intervals),
            other => Mask::where_index(other.len(), |i| in_any(other.as_f64(i), intervals)),
        },
        ValueSet::Floats { scaling, intervals } => {
            Mask::where_index(column.len(), |i| in_any(scaled(*scaling, column.as_f64(i)), intervals))
        }
    }
}

/// Bytes have few values: a table decides.
fn within_bytes<T: Copy>(
    values: &[T],
    byte: impl Fn(T) -> u8,
    stored: impl Fn(u8) -> i128,
    intervals: &[(i128, i128)],
) -> Mask {
    let table: [bool; 256] = std::array::from_fn(|b| {
        let stored = stored(b as u8);
        in_any(stored, intervals)
    });
    Mask::where_each(values, |v| table[usize::from(byte(v))])
}

fn within_integers<T>(values: &[T], intervals: &[(i128, i128)]) -> Mask
where
    T: Copy + Ord + TryFrom<i128> + Bounds,
{
    // Cut to the type's own range: then the comparisons are the machine's.
    let cut = |&(low, high): &(i128, i128)| {
        let low = if low <= T::LEAST { T::try_from(T::LEAST) } else { T::try_from(low) };
        let high = if high >= T::GREATEST { T::try_from(T::GREATEST) } else { T::try_from(high) };
        Some((low.ok()?, high.ok()?))
    };
    let intervals: Vec<(T, T)> = intervals.iter().filter_map(cut).collect();
    match intervals.as_slice() {
        [] => Mask::none(values.len()),
        &[(low, high)] => Mask::where_each(values, |v| low <= v && v <= high),
        many => Mask::where_each(values, |v| in_any(v, many)),
    }
}

/// The range of an integer type.
trait Bounds {
    const LEAST: i128;
    const GREATEST: i128;
}

macro_rules! bounds {
    ($($t:ty),*) => {
        $(impl Bounds for $t {
            const LEAST: i128 = <$t>::MIN as i128;
            const GREATEST: i128 = <$t>::MAX as i128;
        })*
    };
}
bounds!(u16, i16, u32, i32, u64, i64);

fn within_floats<T: Copy>(values: &[T], value: impl Fn(T) -> f64, intervals: &[(f64, f64)]) -> Mask {
    match intervals {
        &[(low, high)] => Mask::where_each(values, |v| {
            let v = value(v);
            low <= v && v <= high
        }),
        many => Mask::where_each(values, |v| in_any(value(v), many)),
    }
}

/// A value for comparison with another attribute's.
#[derive(Clone, Copy)]
enum Value {
    Integer(i128),
    Float(f64),
}

/// The first value of point `i` that is not null.
fn value(sources: &[Source], block: &Block, i: usize) -> Option<Value> {
    sources.iter().find_map(|source| {
        let column = block.column(source.slot)?;
        let has = source.scans.as_ref().is_none_or(|s| s.binary_search(&block.scans.of(i)).is_ok());
        if !has || source.no_data.is_some_and(|n| column.raw(i) == n) {
            return None;
        }
        if let (Some(widening), Some(stored)) = (source.widening, column.as_integer(i)) {
            return Some(Value::Integer(widening.of(stored)));
        }
        Some(match (source.scaling, column) {
            (Some(_), column) => Value::Float(source.real.value(column, i)),
            (None, Column::F32(v)) => Value::Float(v[i].into()),
            (None, Column::F64(v)) => Value::Float(v[i]),
            (None, Column::U8(v)) => Value::Integer(v[i].into()),
            (None, Column::I8(v)) => Value::Integer(v[i].into()),
            (None, Column::U16(v)) => Value::Integer(v[i].into()),
            (None, Column::I16(v)) => Value::Integer(v[i].into()),
            (None, Column::U32(v)) => Value::Integer(v[i].into()),
            (None, Column::I32(v)) => Value::Integer(v[i].into()),
            (None, Column::U64(v)) => Value::Integer(v[i].into()),
            (None, Column::I64(v)) => Value::Integer(v[i].into()),
        })
    })
}

/// Exact, also between a 64-bit integer and a float.
fn compare(a: Value, b: Value) -> Option<Ordering> {
    match (a, b) {
        (Value::Integer(a), Value::Integer(b)) => Some(a.cmp(&b)),
        (Value::Float(a), Value::Float(b)) => a.partial_cmp(&b),
        (Value::Integer(a), Value::Float(b)) => integer_to_float(a, b),
        (Value::Float(a), Value::Integer(b)) => integer_to_float(b, a).map(Ordering::reverse),
    }
}

/// Integers here have at most 65 bits.
fn integer_to_float(a: i128, b: f64) -> Option<Ordering> {
    if b.is_nan() {
        None
    } else if b.abs() >= 1e30 {
        Some(if b > 0.0 { Ordering::Less } else { Ordering::Greater })
    } else {
        let whole = b.floor();
        Some(a.cmp(&(whole as i128)).then(if b > whole { Ordering::Less } else { Ordering::Equal }))
    }
}

fn holds(relation: Relation, order: Ordering) -> bool {
    match relation {
        Relation::Equal => order.is_eq(),
        Relation::NotEqual => order.is_ne(),
        Relation::Less => order.is_lt(),
        Relation::LessOrEqual => order.is_le(),
        Relation::Greater => order.is_gt(),
        Relation::GreaterOrEqual => order.is_ge(),
    }
}
