//! Raw records: the fixed-size rows in which points travel from a source to the tree.
//!
//! A source's records are kept byte for byte (a LAS record without its coordinates, say) and turned into columns only
//! when a node is encoded: column by column over records that lie together.

use super::{Attribute, Column, ScalarType};
use std::sync::Arc;

/// How a record begins: its position, in the source's terms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PositionKind {
    /// Three little-endian `i32` on the source's grid.
    Grid,
    /// Three little-endian `f64` in world coordinates.
    World,
    /// Three little-endian `u64` lattice indices.
    Lattice,
}

impl PositionKind {
    /// Bytes of a position.
    pub fn size(self) -> usize {
        match self {
            Self::Grid => 12,
            Self::World | Self::Lattice => 24,
        }
    }
}

/// Where in a record an attribute is. Offsets count from the end of the position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// First byte.
    pub offset: usize,
    /// How to read it.
    pub kind: FieldKind,
}

/// How a field is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldKind {
    /// A little-endian value of the attribute's type.
    Whole,
    /// `byte >> shift & mask`, for an attribute of type `u8`.
    Bits {
        /// Right shift.
        shift: u8,
        /// Mask after the shift.
        mask: u8,
    },
}

/// How the records of one source are laid out: a position, then `payload` bytes that hold the attributes.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordLayout {
    /// How a record begins.
    pub position: PositionKind,
    /// Bytes after the position.
    pub payload: usize,
    /// The attributes, in canonical order; no two have one name and one type.
    pub attributes: Arc<[Attribute]>,
    /// Where each attribute is.
    pub fields: Vec<Field>,
}

impl RecordLayout {
    /// A layout with its attributes brought into canonical order.
    ///
    /// # Panics
    ///
    /// If a field reaches beyond the payload, or bits are asked for from an attribute that is not `u8`, or two
    /// attributes are the same: a mistake in a reader, not in data.
    pub fn new(position: PositionKind, payload: usize, mut fields: Vec<(Attribute, Field)>) -> Self {
        fields.sort_by(|a, b| a.0.identity().cmp(&b.0.identity()));
        for (attribute, field) in &fields {
            let size = match field.kind {
                FieldKind::Whole => attribute.ty.size(),
                FieldKind::Bits { .. } => 1,
            };
            assert!(field.offset + size <= payload, "{} reaches beyond the record", attribute.name);
            let bits = matches!(field.kind, FieldKind::Bits { .. });
            assert!(!bits || attribute.ty == ScalarType::U8, "{} is not u8", attribute.name);
        }
        let same = |a: &Attribute, b: &Attribute| (&a.name, a.ty) == (&b.name, b.ty);
        assert!(fields.windows(2).all(|w| !same(&w[0].0, &w[1].0)), "two attributes are the same");
        let (attributes, fields): (Vec<_>, Vec<_>) = fields.into_iter().unzip();
        Self { position, payload, attributes: attributes.into(), fields }
    }

    /// Bytes of a whole record.
    pub fn stride(&self) -> usize {
        self.position.size() + self.payload
    }

    /// Appends to `column` the values of attribute `index` from payloads, given as an iterator of slices of
    /// [`RecordLayout::payload`] bytes each.
    ///
    /// # Panics
    ///
    /// If the column has another type than the attribute, or a slice is too short.
    pub fn extract<'a>(&self, index: usize, payloads: impl Iterator<Item = &'a [u8]>, column: &mut Column) {
        let Field { offset, kind } = self.fields[index];
        macro_rules! whole {
            ($v:expr, $t:ty) => {
                $v.extend(payloads.map(|p| {
                    let mut bytes = [0; size_of::<$t>()];
                    bytes.copy_from_slice(&p[offset..offset + size_of::<$t>()]);
                    <$t>::from_le_bytes(bytes)
                }))
            };
        }
        match (kind, column) {
            (FieldKind::Bits { shift, mask }, Column::U8(v)) => v.extend(payloads.map(|p| p[offset] >> shift & mask)),
            (FieldKind::Whole, Column::U8(v)) => v.extend(payloads.map(|p| p[offset])),
            (FieldKind::Whole, Column::I8(v)) => v.extend(payloads.map(|p| p[offset] as i8)),
            (FieldKind::Whole, Column::U16(v)) => whole!(v, u16),
            (FieldKind::Whole, Column::I16(v)) => whole!(v, i16),
            (FieldKind::Whole, Column::U32(v)) => whole!(v, u32),
            (FieldKind::Whole, Column::I32(v)) => whole!(v, i32),
            (FieldKind::Whole, Column::U64(v)) => whole!(v, u64),
            (FieldKind::Whole, Column::I64(v)) => whole!(v, i64),
            (FieldKind::Whole, Column::F32(v)) => whole!(v, f32),
            (FieldKind::Whole, Column::F64(v)) => whole!(v, f64),
            (FieldKind::Bits { .. }, column) => {
                panic!("bits of a column of {}", column.ty().word())
            }
        }
    }

    /// Does attribute `index` differ among payloads that differ in the bits set in `varying`, byte by byte?
    ///
    /// # Panics
    ///
    /// If `varying` is shorter than a payload.
    pub fn varies(&self, index: usize, varying: &[u8]) -> bool {
        let Field { offset, kind } = self.fields[index];
        match kind {
            FieldKind::Whole => varying[offset..offset + self.attributes[index].ty.size()].iter().any(|&b| b != 0),
            FieldKind::Bits { shift, mask } => varying[offset] >> shift & mask != 0,
        }
    }

    /// Appends the canonical record bytes of one payload: every attribute in canonical order, little-endian.
    /// What breaks ties between equal keys, and what the digest hashes.
    pub fn canonical_bytes(&self, payload: &[u8], out: &mut Vec<u8>) {
        for (attribute, field) in self.attributes.iter().zip(&self.fields) {
            match field.kind {
                FieldKind::Whole => out.extend_from_slice(&payload[field.offset..field.offset + attribute.ty.size()]),
                FieldKind::Bits { shift, mask } => out.push(payload[field.offset] >> shift & mask),
            }
        }
    }

    /// The layout in which a record is its canonical bytes, after a position of this kind.
    pub fn canonical(position: PositionKind, attributes: impl IntoIterator<Item = Attribute>) -> Self {
        let mut attributes: Vec<_> = attributes.into_iter().collect();
        attributes.sort_by(|a, b| a.identity().cmp(&b.identity()));
        let mut offset = 0;
        let fields = attributes
            .into_iter()
            .map(|a| {
                let field = Field { offset, kind: FieldKind::Whole };
                offset += a.ty.size();
                (a, field)
            })
            .collect();
        Self::new(position, offset, fields)
    }
}
