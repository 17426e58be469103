//! From the columns of a scan to the layout of a record, and one point's values into it.

use crate::formats::names::{attribute_name, unique};
use crate::points::{Attribute, Field, FieldKind, PositionKind, RecordLayout, ScalarType, canonical_name};
use e57::{Record, RecordDataType, RecordName, RecordValue};
use std::collections::HashSet;

/// How positions are given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// X, Y, Z.
    Cartesian,
    /// Range, azimuth, elevation.
    Spherical,
}

/// Where a column's value goes.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Target {
    /// A coordinate: X, Y, Z or range, azimuth, elevation.
    Axis(usize),
    /// Other than zero: the point has no position.
    Invalid,
    /// An attribute, at this byte of the record.
    Record(usize, Form),
    /// Nowhere.
    Skip,
}

/// How an attribute's value is written.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    /// As an integer of this type, with this much added.
    Integer(ScalarType, i64),
    /// As it is.
    Float(ScalarType),
    /// `raw * scale + offset` as `f64`.
    Scaled(f64, f64),
}

/// How the points of a scan become records.
#[derive(Debug)]
pub struct Columns {
    pub layout: RecordLayout,
    pub frame: Frame,
    targets: Vec<Target>,
    types: Vec<RecordDataType>,
}

/// A value that its column's limits exclude.
#[derive(Debug)]
pub struct OutOfLimits;

impl Columns {
    /// For the columns of a scan; `None` if it has neither cartesian nor spherical coordinates.
    pub fn new(prototype: &[Record]) -> Option<Self> {
        let place = |name: &RecordName| prototype.iter().position(|r| r.name == *name);
        let all = |names: [RecordName; 3]| Some([place(&names[0])?, place(&names[1])?, place(&names[2])?]);
        let cartesian = all([RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ]);
        let spherical =
            || all([RecordName::SphericalRange, RecordName::SphericalAzimuth, RecordName::SphericalElevation]);
        let (axes, frame) = match cartesian {
            Some(axes) => (axes, Frame::Cartesian),
            None => (spherical()?, Frame::Spherical),
        };
        let state = match frame {
            Frame::Cartesian => RecordName::CartesianInvalidState,
            Frame::Spherical => RecordName::SphericalInvalidState,
        };
        let start = PositionKind::World.size();
        let mut end = start;
        let mut taken = HashSet::new();
        let mut fields = Vec::new();
        let mut targets = Vec::with_capacity(prototype.len());
        for (i, record) in prototype.iter().enumerate() {
            let target = if let Some(axis) = axes.iter().position(|&a| a == i) {
                Target::Axis(axis)
            } else if record.name == state {
                Target::Invalid
            } else if says_nothing(record) {
                Target::Skip
            } else {
                let (name, form) = attribute(record);
                let ty = form.ty();
                let name = unique(name, &own_name(&record.name), ty, &mut taken);
                let at = end;
                end += ty.size();
                fields.push((Attribute::new(name, ty), Field { offset: at - start, kind: FieldKind::Whole }));
                Target::Record(at, form)
            };
            targets.push(target);
        }
        let types = prototype.iter().map(|r| r.data_type.clone()).collect();
        Some(Self { layout: RecordLayout::new(PositionKind::World, end - start, fields), frame, targets, types })
    }

    /// Appends the record of one point.
    pub fn push(&self, values: &[RecordValue], out: &mut Vec<u8>) -> Result<(), OutOfLimits> {
        let start = out.len();
        out.resize(start + self.layout.stride(), 0);
        let record = &mut out[start..];
        let mut position = [0.0; 3];
        let mut valid = true;
        for ((value, target), ty) in values.iter().zip(&self.targets).zip(&self.types) {
            match *target {
                Target::Axis(axis) => position[axis] = number(value, ty),
                // Some writers have floats here.
                Target::Invalid => valid &= number(value, ty) == 0.0,
                Target::Record(at, form) => {
                    let bytes = form.bytes(value).ok_or(OutOfLimits)?;
                    let size = form.ty().size();
                    record[at..at + size].copy_from_slice(&bytes[..size]);
                }
                Target::Skip => {}
            }
        }
        let position = match (valid, self.frame) {
            (false, _) => [f64::NAN; 3],
            (true, Frame::Cartesian) => position,
            (true, Frame::Spherical) => from_spherical(position),
        };
        for (place, value) in record.chunks_exact_mut(8).zip(position) {
            place.copy_from_slice(&value.to_le_bytes());
        }
        Ok(())
    }
}

/// Bits of a point; zero if all columns are constant.
pub fn point_bits(prototype: &[Record]) -> u64 {
    prototype.iter().map(|r| u64::from(bits(&r.data_type))).sum()
}

fn bits(ty: &RecordDataType) -> u32 {
    match ty {
        RecordDataType::Single { .. } => 32,
        RecordDataType::Double { .. } => 64,
        RecordDataType::ScaledInteger { min, max, .. } | RecordDataType::Integer { min, max } => {
            max.abs_diff(*min).checked_ilog2().map_or(0, |b| b + 1)
        }
    }
}

fn from_spherical([range, azimuth, elevation]: [f64; 3]) -> [f64; 3] {
    let plan = range * elevation.cos();
    [plan * azimuth.cos(), plan * azimuth.sin(), range * elevation.sin()]
}

fn number(value: &RecordValue, ty: &RecordDataType) -> f64 {
    match (value, ty) {
        (RecordValue::Single(v), _) => f64::from(*v),
        (RecordValue::Double(v), _) => *v,
        (RecordValue::ScaledInteger(v), RecordDataType::ScaledInteger { scale, offset, .. }) => {
            *v as f64 * scale + offset
        }
        (RecordValue::ScaledInteger(v) | RecordValue::Integer(v), _) => *v as f64,
    }
}

/// A flag that can have no other value than "valid".
fn says_nothing(record: &Record) -> bool {
    use RecordName::{
        CartesianInvalidState, IsColorInvalid, IsIntensityInvalid, IsTimeStampInvalid, SphericalInvalidState,
    };
    let flag = matches!(
        record.name,
        IsColorInvalid | IsIntensityInvalid | IsTimeStampInvalid | CartesianInvalidState | SphericalInvalidState
    );
    flag && matches!(record.data_type, RecordDataType::Integer { min: 0, max: 0 })
}

/// The name as the file has it.
fn own_name(name: &RecordName) -> String {
    let word = match name {
        RecordName::CartesianX => "cartesianX",
        RecordName::CartesianY => "cartesianY",
        RecordName::CartesianZ => "cartesianZ",
        RecordName::CartesianInvalidState => "cartesianInvalidState",
        RecordName::SphericalRange => "sphericalRange",
        RecordName::SphericalAzimuth => "sphericalAzimuth",
        RecordName::SphericalElevation => "sphericalElevation",
        RecordName::SphericalInvalidState => "sphericalInvalidState",
        RecordName::Intensity => "intensity",
        RecordName::IsIntensityInvalid => "isIntensityInvalid",
        RecordName::ColorRed => "colorRed",
        RecordName::ColorGreen => "colorGreen",
        RecordName::ColorBlue => "colorBlue",
        RecordName::IsColorInvalid => "isColorInvalid",
        RecordName::RowIndex => "rowIndex",
        RecordName::ColumnIndex => "columnIndex",
        RecordName::ReturnCount => "returnCount",
        RecordName::ReturnIndex => "returnIndex",
        RecordName::TimeStamp => "timeStamp",
        RecordName::IsTimeStampInvalid => "isTimeStampInvalid",
        RecordName::Unknown { namespace, name } if namespace.is_empty() => name,
        RecordName::Unknown { namespace, name } => return format!("{namespace}:{name}"),
    };
    word.to_owned()
}

/// What an attribute is called, and how its values are written.
fn attribute(record: &Record) -> (String, Form) {
    let form = Form::of(&record.data_type);
    let own = own_name(&record.name);
    let ty = form.ty();
    let small = matches!(record.data_type, RecordDataType::Integer { min: 0.., max: ..=254 });
    let name = match &record.name {
        RecordName::Intensity => "Intensity".to_owned(),
        RecordName::ColorRed => colour(own, "Red", ty),
        RecordName::ColorGreen => colour(own, "Green", ty),
        RecordName::ColorBlue => colour(own, "Blue", ty),
        // LAS counts returns from one, E57 from zero.
        RecordName::ReturnIndex if small => return ("ReturnNumber".to_owned(), Form::Integer(ScalarType::U8, 1)),
        RecordName::ReturnCount if small => "NumberOfReturns".to_owned(),
        // The extensions for LAS's fields and for normals, and columns without a namespace.
        RecordName::Unknown { namespace, name } if matches!(&**namespace, "las" | "nor") => {
            canonical_name(name).map_or(own, str::to_owned)
        }
        RecordName::Unknown { namespace, name } if namespace.is_empty() => attribute_name(name, ty),
        _ => own,
    };
    (name, form)
}

/// Colours of other types than LAS's are no LAS colours.
fn colour(own: String, canonical: &str, ty: ScalarType) -> String {
    if matches!(ty, ScalarType::U8 | ScalarType::U16) { canonical.to_owned() } else { own }
}

impl Form {
    fn of(ty: &RecordDataType) -> Self {
        match *ty {
            RecordDataType::Single { .. } => Self::Float(ScalarType::F32),
            RecordDataType::Double { .. } => Self::Float(ScalarType::F64),
            RecordDataType::ScaledInteger { scale, offset, .. } if scale != 1.0 || offset != 0.0 => {
                Self::Scaled(scale, offset)
            }
            RecordDataType::ScaledInteger { min, max, .. } | RecordDataType::Integer { min, max } => {
                Self::Integer(smallest(min, max), 0)
            }
        }
    }

    fn ty(self) -> ScalarType {
        match self {
            Self::Integer(ty, _) | Self::Float(ty) => ty,
            Self::Scaled(..) => ScalarType::F64,
        }
    }

    /// The value, little-endian; `None` for an integer that its type can't hold.
    fn bytes(self, value: &RecordValue) -> Option<[u8; 8]> {
        let mut bytes = [0; 8];
        match (self, value) {
            (Self::Integer(ty, add), RecordValue::Integer(v) | RecordValue::ScaledInteger(v)) => {
                let v = v.checked_add(add)?;
                let (min, max) = range(ty);
                if !(min..=max).contains(&v) {
                    return None;
                }
                bytes = v.to_le_bytes();
            }
            (Self::Float(_), RecordValue::Single(v)) => bytes[..4].copy_from_slice(&v.to_le_bytes()),
            (Self::Float(_), RecordValue::Double(v)) => bytes = v.to_le_bytes(),
            (Self::Scaled(scale, offset), RecordValue::ScaledInteger(v)) => {
                bytes = (*v as f64 * scale + offset).to_le_bytes();
            }
            // The crate gives values of the column's own type.
            _ => return None,
        }
        Some(bytes)
    }
}

/// The smallest type for a column with these limits.
fn smallest(min: i64, max: i64) -> ScalarType {
    use ScalarType::{I8, I16, I32, I64, U8, U16, U32};
    let fits = |ty: &ScalarType| range(*ty).0 <= min && max <= range(*ty).1;
    [U8, I8, U16, I16, U32, I32].into_iter().find(fits).unwrap_or(I64)
}

/// The limits of an integer type, as far as an `i64` goes.
fn range(ty: ScalarType) -> (i64, i64) {
    match ty {
        ScalarType::U8 => (0, u8::MAX.into()),
        ScalarType::I8 => (i8::MIN.into(), i8::MAX.into()),
        ScalarType::U16 => (0, u16::MAX.into()),
        ScalarType::I16 => (i16::MIN.into(), i16::MAX.into()),
        ScalarType::U32 => (0, u32::MAX.into()),
        ScalarType::I32 => (i32::MIN.into(), i32::MAX.into()),
        _ => (i64::MIN, i64::MAX),
    }
}
