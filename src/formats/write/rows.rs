//! From columns to rows: every attribute is put at its place in fixed-size records, column by column.

use crate::points::{Column, angle_steps};
use std::ops::Range;

/// How the values of a column become bytes of a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Put {
    /// Little-endian, as they are.
    Whole,
    /// A `u8`, shifted into a byte that others share.
    Bits {
        /// Left shift.
        shift: u8,
        /// The values that fit.
        mask: u8,
    },
    /// An `i8` of degrees, added to an `i16` in steps of 0.006 degrees: the nearest one.
    Degrees,
    /// A `u8` colour, added to a `u16` times 257.
    Color,
    /// Any number, less `low` and times `factor`, as the nearest number of the type; NaN as 0.
    Scaled {
        /// What becomes 0.
        low: f64,
        /// Steps of 1.
        factor: f64,
        /// What the field holds.
        to: Target,
    },
}

/// A field that takes numbers of any type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Target {
    /// Bits of a byte that others share.
    Bits {
        /// Left shift.
        shift: u8,
        /// The greatest that fits.
        mask: u8,
    },
    /// A byte.
    U8,
    /// Two bytes.
    U16,
    /// Two bytes, with a sign.
    I16,
    /// A double, which is not rounded.
    F64,
}

/// A column's place in a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Slot {
    /// Which column of the batch.
    pub column: usize,
    /// First byte, from the start of the record.
    pub offset: usize,
    /// How.
    pub put: Put,
}

/// A value that its place cannot hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TooLarge {
    /// The value.
    pub value: u8,
    /// The largest that fits.
    pub largest: u8,
}

/// Puts values `range` of `column` into `rows`, of `stride` bytes each and zero where nothing has been put yet.
///
/// # Panics
///
/// If the column is too short, its type does not fit `put`, or the slot reaches beyond the rows: mistakes of a plan.
pub(super) fn put(
    slot: Slot,
    column: &Column,
    range: Range<usize>,
    rows: &mut [u8],
    stride: usize,
) -> Result<(), TooLarge> {
    let at = slot.offset;
    macro_rules! whole {
        ($values:expr) => {
            for (row, value) in rows.chunks_exact_mut(stride).zip(&$values[range]) {
                let bytes = value.to_le_bytes();
                row[at..at + bytes.len()].copy_from_slice(&bytes);
            }
        };
    }
    match (slot.put, column) {
        (Put::Bits { shift, mask }, Column::U8(values)) => {
            let values = &values[range];
            let all = values.iter().fold(0, |all, value| all | value);
            if all & !mask != 0 {
                let value = values.iter().copied().find(|v| v & !mask != 0).unwrap_or(all);
                return Err(TooLarge { value, largest: mask });
            }
            // Most flags are set nowhere.
            if all != 0 {
                for (row, value) in rows.chunks_exact_mut(stride).zip(values) {
                    row[at] |= value << shift;
                }
            }
        }
        (Put::Degrees, Column::I8(values)) => {
            for (row, &degrees) in rows.chunks_exact_mut(stride).zip(&values[range]) {
                let steps = angle_steps(degrees);
                add(&mut row[at..at + 2], steps.cast_unsigned());
            }
        }
        (Put::Color, Column::U8(values)) => {
            for (row, &value) in rows.chunks_exact_mut(stride).zip(&values[range]) {
                add(&mut row[at..at + 2], u16::from(value) * 257);
            }
        }
        (Put::Scaled { low, factor, to }, column) => {
            for (row, i) in rows.chunks_exact_mut(stride).zip(range) {
                let value = (column.as_f64(i) - low) * factor;
                add_number(&mut row[at..], value, to);
            }
        }
        (Put::Whole, Column::U8(v)) => whole!(v),
        (Put::Whole, Column::I8(v)) => whole!(v),
        (Put::Whole, Column::U16(v)) => whole!(v),
        (Put::Whole, Column::I16(v)) => whole!(v),
        (Put::Whole, Column::U32(v)) => whole!(v),
        (Put::Whole, Column::I32(v)) => whole!(v),
        (Put::Whole, Column::U64(v)) => whole!(v),
        (Put::Whole, Column::I64(v)) => whole!(v),
        (Put::Whole, Column::F32(v)) => whole!(v),
        (Put::Whole, Column::F64(v)) => whole!(v),
        (put, column) => panic!("{put:?} of a column of {}", column.ty().word()),
    }
    Ok(())
}

/// Adds to a field. Beyond the field's ends, and of NaN, the conversions give the nearest number and 0.
fn add_number(bytes: &mut [u8], value: f64, to: Target) {
    match to {
        Target::Bits { shift, mask } => bytes[0] |= (value.round() as u8).min(mask) << shift,
        Target::U8 => bytes[0] = bytes[0].wrapping_add(value.round() as u8),
        Target::U16 => add(&mut bytes[..2], value.round() as u16),
        Target::I16 => add(&mut bytes[..2], (value.round() as i16).cast_unsigned()),
        Target::F64 => {
            let mut there = [0; 8];
            there.copy_from_slice(&bytes[..8]);
            let sum = f64::from_le_bytes(there) + if value.is_nan() { 0.0 } else { value };
            bytes[..8].copy_from_slice(&sum.to_le_bytes());
        }
    }
}

/// One of two columns has a value at each point, the other zero, where scans of two kinds are merged.
fn add(bytes: &mut [u8], value: u16) {
    let there = u16::from_le_bytes([bytes[0], bytes[1]]);
    bytes.copy_from_slice(&there.wrapping_add(value).to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::ScalarType;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rows_hold_the_bytes_of_each_value(
            bytes in prop::collection::vec(any::<u8>(), 8 * 40),
            stride in 8_usize..20,
            at in 0_usize..12,
        ) {
            prop_assume!(at + 8 <= stride);
            for ty in ScalarType::ALL {
                let mut column = Column::with_capacity(ty, 40);
                for b in bytes.chunks_exact(8) {
                    match &mut column {
                        Column::U8(v) => v.push(b[0]),
                        Column::I8(v) => v.push(b[0] as i8),
                        Column::U16(v) => v.push(u16::from_le_bytes([b[0], b[1]])),
                        Column::I16(v) => v.push(i16::from_le_bytes([b[0], b[1]])),
                        Column::U32(v) => v.push(u32::from_le_bytes(b[..4].try_into().unwrap())),
                        Column::I32(v) => v.push(i32::from_le_bytes(b[..4].try_into().unwrap())),
                        Column::U64(v) => v.push(u64::from_le_bytes(b.try_into().unwrap())),
                        Column::I64(v) => v.push(i64::from_le_bytes(b.try_into().unwrap())),
                        Column::F32(v) => v.push(f32::from_le_bytes(b[..4].try_into().unwrap())),
                        Column::F64(v) => v.push(f64::from_le_bytes(b.try_into().unwrap())),
                    }
                }
                let mut rows = vec![0; stride * 20];
                let slot = Slot { column: 0, offset: at, put: Put::Whole };
                put(slot, &column, 10..30, &mut rows, stride).unwrap();
                for (i, row) in rows.chunks_exact(stride).enumerate() {
                    prop_assert_eq!(&row[at..at + ty.size()], &column.raw(10 + i)[..ty.size()]);
                    prop_assert!(row[..at].iter().chain(&row[at + ty.size()..]).all(|&b| b == 0));
                }
            }
        }
    }

    #[test]
    fn bits_share_a_byte_and_never_wrap() {
        let mut rows = [0; 3];
        let slot = |shift, mask| Slot { column: 0, offset: 0, put: Put::Bits { shift, mask } };
        put(slot(0, 15), &Column::U8(vec![1, 15, 3]), 0..3, &mut rows, 1).unwrap();
        put(slot(4, 7), &Column::U8(vec![7, 0, 2]), 0..3, &mut rows, 1).unwrap();
        assert_eq!(rows, [0x71, 0x0F, 0x23]);
        let refused = put(slot(0, 15), &Column::U8(vec![1, 200, 3]), 0..3, &mut rows, 1);
        assert_eq!(refused, Err(TooLarge { value: 200, largest: 15 }));
    }

    #[test]
    fn scaled_numbers_are_the_nearest_in_16_bits() {
        let mut rows = [0; 12];
        let put_in = |to| Slot { column: 0, offset: 0, put: Put::Scaled { low: -1.0, factor: 100.0, to } };
        let slot = put_in(Target::U16);
        let values = Column::F32(vec![-1.0, -5.0, 0.004, f32::NAN, 1e9, f32::INFINITY]);
        put(slot, &values, 0..6, &mut rows, 2).unwrap();
        let found: Vec<_> = rows.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect();
        assert_eq!(found, [0, 0, 100, 0, u16::MAX, u16::MAX]);
        let bits = Put::Scaled { low: 0.0, factor: 1.0, to: Target::Bits { shift: 4, mask: 15 } };
        let mut rows = [1; 6];
        put(Slot { column: 0, offset: 0, put: bits }, &values, 0..6, &mut rows, 1).unwrap();
        assert_eq!(rows, [1, 1, 1, 1, 0xF1, 0xF1]);
        let mut rows = [0; 12];
        put(put_in(Target::I16), &Column::F32(vec![-3.0, -1e9]), 0..2, &mut rows[..4], 2).unwrap();
        assert_eq!(rows[..4], [0x38, 0xFF, 0x00, 0x80]);
    }

    #[test]
    fn merged_kinds_of_a_field_add_up_to_the_one_that_is_there() {
        let slot = |put| Slot { column: 0, offset: 0, put };
        let mut rows = [0; 4];
        put(slot(Put::Whole), &Column::I16(vec![-1000, 0]), 0..2, &mut rows, 2).unwrap();
        put(slot(Put::Degrees), &Column::I8(vec![0, -9]), 0..2, &mut rows, 2).unwrap();
        assert_eq!(rows, [0x18, 0xFC, 0x24, 0xFA]);
        let mut rows = [0; 4];
        put(slot(Put::Color), &Column::U8(vec![0, 200]), 0..2, &mut rows, 2).unwrap();
        put(slot(Put::Color), &Column::U8(vec![255, 0]), 0..2, &mut rows, 2).unwrap();
        assert_eq!(rows, [0xFF, 0xFF, 200, 200]);
    }
}
