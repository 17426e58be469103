//! One attribute of many points: a typed vector.

use super::{Number, ScalarType};

/// The values of one attribute, one per point.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub enum Column {
    U8(Vec<u8>),
    I8(Vec<i8>),
    U16(Vec<u16>),
    I16(Vec<i16>),
    U32(Vec<u32>),
    I32(Vec<i32>),
    U64(Vec<u64>),
    I64(Vec<i64>),
    F32(Vec<f32>),
    F64(Vec<f64>),
}

/// Runs `$body` with `$v` bound to the typed vector of a column.
#[macro_export]
macro_rules! with_column {
    ($column:expr, $v:ident => $body:expr) => {
        match $column {
            $crate::points::Column::U8($v) => $body,
            $crate::points::Column::I8($v) => $body,
            $crate::points::Column::U16($v) => $body,
            $crate::points::Column::I16($v) => $body,
            $crate::points::Column::U32($v) => $body,
            $crate::points::Column::I32($v) => $body,
            $crate::points::Column::U64($v) => $body,
            $crate::points::Column::I64($v) => $body,
            $crate::points::Column::F32($v) => $body,
            $crate::points::Column::F64($v) => $body,
        }
    };
}

impl Column {
    /// An empty column with room for `capacity` values.
    pub fn with_capacity(ty: ScalarType, capacity: usize) -> Self {
        match ty {
            ScalarType::U8 => Self::U8(Vec::with_capacity(capacity)),
            ScalarType::I8 => Self::I8(Vec::with_capacity(capacity)),
            ScalarType::U16 => Self::U16(Vec::with_capacity(capacity)),
            ScalarType::I16 => Self::I16(Vec::with_capacity(capacity)),
            ScalarType::U32 => Self::U32(Vec::with_capacity(capacity)),
            ScalarType::I32 => Self::I32(Vec::with_capacity(capacity)),
            ScalarType::U64 => Self::U64(Vec::with_capacity(capacity)),
            ScalarType::I64 => Self::I64(Vec::with_capacity(capacity)),
            ScalarType::F32 => Self::F32(Vec::with_capacity(capacity)),
            ScalarType::F64 => Self::F64(Vec::with_capacity(capacity)),
        }
    }

    /// `len` zeros: what stands for null where a point's scan lacks the attribute.
    pub fn zeros(ty: ScalarType, len: usize) -> Self {
        let mut column = Self::with_capacity(ty, len);
        column.resize(len);
        column
    }

    /// Cuts the column or fills it up with zeros.
    pub fn resize(&mut self, len: usize) {
        with_column!(self, v => v.resize(len, Default::default()));
    }

    /// Appends the last value `more` times.
    pub fn repeat_last(&mut self, more: usize) {
        with_column!(self, v => if let Some(&last) = v.last() { v.resize(v.len() + more, last) });
    }

    /// Takes all values away and keeps the memory.
    pub fn clear(&mut self) {
        with_column!(self, v => v.clear());
    }

    /// The type of the values.
    pub fn ty(&self) -> ScalarType {
        match self {
            Self::U8(_) => ScalarType::U8,
            Self::I8(_) => ScalarType::I8,
            Self::U16(_) => ScalarType::U16,
            Self::I16(_) => ScalarType::I16,
            Self::U32(_) => ScalarType::U32,
            Self::I32(_) => ScalarType::I32,
            Self::U64(_) => ScalarType::U64,
            Self::I64(_) => ScalarType::I64,
            Self::F32(_) => ScalarType::F32,
            Self::F64(_) => ScalarType::F64,
        }
    }

    /// The number of values.
    pub fn len(&self) -> usize {
        with_column!(self, v => v.len())
    }

    /// Has it no values?
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Value `i` as a float: rounded for 64-bit integers beyond 2^53.
    ///
    /// # Panics
    ///
    /// If `i` is out of range.
    #[allow(clippy::unnecessary_cast)]
    pub fn as_f64(&self, i: usize) -> f64 {
        with_column!(self, v => v[i] as f64)
    }

    /// The bytes of value `i`, little-endian, in the first `ty().size()` places; the rest is zero.
    ///
    /// # Panics
    ///
    /// If `i` is out of range.
    pub fn raw(&self, i: usize) -> [u8; 8] {
        let mut raw = [0; 8];
        with_column!(self, v => {
            let bytes = v[i].to_le_bytes();
            raw[..bytes.len()].copy_from_slice(&bytes);
        });
        raw
    }

    /// Value `i` of a column of integers; `None` if it is one of floats.
    ///
    /// # Panics
    ///
    /// If `i` is out of range.
    pub fn as_integer(&self, i: usize) -> Option<i128> {
        match self.number(i) {
            Number::Unsigned(v) => Some(v.into()),
            Number::Signed(v) => Some(v.into()),
            Number::Float(_) => None,
        }
    }

    /// Value `i`, exactly.
    ///
    /// # Panics
    ///
    /// If `i` is out of range.
    pub fn number(&self, i: usize) -> Number {
        match self {
            Self::U8(v) => Number::Unsigned(v[i].into()),
            Self::U16(v) => Number::Unsigned(v[i].into()),
            Self::U32(v) => Number::Unsigned(v[i].into()),
            Self::U64(v) => Number::Unsigned(v[i]),
            Self::I8(v) => Number::Signed(v[i].into()),
            Self::I16(v) => Number::Signed(v[i].into()),
            Self::I32(v) => Number::Signed(v[i].into()),
            Self::I64(v) => Number::Signed(v[i]),
            Self::F32(v) => Number::Float(v[i].into()),
            Self::F64(v) => Number::Float(v[i]),
        }
    }

    /// Appends a value by its bytes, as [`Column::raw`] gives them.
    pub fn push_raw(&mut self, raw: [u8; 8]) {
        let [a, b, c, d, ..] = raw;
        match self {
            Self::U8(v) => v.push(a),
            Self::I8(v) => v.push(i8::from_le_bytes([a])),
            Self::U16(v) => v.push(u16::from_le_bytes([a, b])),
            Self::I16(v) => v.push(i16::from_le_bytes([a, b])),
            Self::U32(v) => v.push(u32::from_le_bytes([a, b, c, d])),
            Self::I32(v) => v.push(i32::from_le_bytes([a, b, c, d])),
            Self::F32(v) => v.push(f32::from_le_bytes([a, b, c, d])),
            Self::U64(v) => v.push(u64::from_le_bytes(raw)),
            Self::I64(v) => v.push(i64::from_le_bytes(raw)),
            Self::F64(v) => v.push(f64::from_le_bytes(raw)),
        }
    }

    /// Appends value `i` of `other`, which must have the same type.
    ///
    /// # Panics
    ///
    /// If the types differ or `i` is out of range.
    pub fn push_from(&mut self, other: &Self, i: usize) {
        match (self, other) {
            (Self::U8(a), Self::U8(b)) => a.push(b[i]),
            (Self::I8(a), Self::I8(b)) => a.push(b[i]),
            (Self::U16(a), Self::U16(b)) => a.push(b[i]),
            (Self::I16(a), Self::I16(b)) => a.push(b[i]),
            (Self::U32(a), Self::U32(b)) => a.push(b[i]),
            (Self::I32(a), Self::I32(b)) => a.push(b[i]),
            (Self::U64(a), Self::U64(b)) => a.push(b[i]),
            (Self::I64(a), Self::I64(b)) => a.push(b[i]),
            (Self::F32(a), Self::F32(b)) => a.push(b[i]),
            (Self::F64(a), Self::F64(b)) => a.push(b[i]),
            (a, b) => panic!("a column of {} cannot take a value of {}", a.ty().word(), b.ty().word()),
        }
    }

    /// Appends the values of `other` at `indices`.
    ///
    /// # Panics
    ///
    /// If the types differ or an index is out of range.
    pub fn extend_gathered(&mut self, other: &Self, indices: &[u32]) {
        macro_rules! gather {
            ($($variant:ident),*) => {
                match (self, other) {
                    $((Self::$variant(a), Self::$variant(b)) => a.extend(indices.iter().map(|&i| b[i as usize])),)*
                    (a, b) => panic!("a column of {} cannot take values of {}", a.ty().word(), b.ty().word()),
                }
            };
        }
        gather!(U8, I8, U16, I16, U32, I32, U64, I64, F32, F64);
    }

    /// Of the values from `start` on keeps those at `indices`, which ascend and count from there.
    ///
    /// # Panics
    ///
    /// If an index is out of range or not below those after it.
    pub fn keep_after(&mut self, start: usize, indices: &[u32]) {
        with_column!(self, values => {
            let after = &mut values[start..];
            for (to, &from) in indices.iter().enumerate() {
                after[to] = after[from as usize];
            }
            values.truncate(start + indices.len());
        });
    }

    /// Appends all values of `other`.
    ///
    /// # Panics
    ///
    /// If the types differ.
    pub fn append(&mut self, other: &Self) {
        macro_rules! append {
            ($($variant:ident),*) => {
                match (self, other) {
                    $((Self::$variant(a), Self::$variant(b)) => a.extend_from_slice(b),)*
                    (a, b) => panic!("a column of {} cannot take values of {}", a.ty().word(), b.ty().word()),
                }
            };
        }
        append!(U8, I8, U16, I16, U32, I32, U64, I64, F32, F64);
    }
}
