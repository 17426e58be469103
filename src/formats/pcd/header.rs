//! The header of a PCD file: lines of a word and what belongs to it, the last of them DATA.

use crate::formats::FormatError;
use crate::formats::file::SourceFile;
use crate::formats::las::quoted;
use crate::geometry::Pose;
use crate::points::ScalarType;

/// A header longer than this is none.
const LONGEST_HEADER: u64 = 1 << 18;
/// Values of a point at most.
const MOST_VALUES: u64 = 1 << 16;

/// How points are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    Ascii,
    Binary,
    Compressed,
}

/// A field of a point.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PcdField {
    pub name: String,
    pub ty: ScalarType,
    /// Values next to each other.
    pub count: u64,
}

/// A header.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    pub fields: Vec<PcdField>,
    pub points: u64,
    pub viewpoint: Pose,
    pub encoding: Encoding,
    /// Where the points begin.
    pub data_offset: u64,
}

impl Header {
    /// Reads the header of `file`.
    ///
    /// # Errors
    ///
    /// [`FormatError::Malformed`] with the byte where the bad line begins.
    pub(in crate::formats) fn read(file: &SourceFile) -> Result<Self, FormatError> {
        let raw = file.read_vec(0, LONGEST_HEADER)?;
        let (mut names, mut sizes, mut types, mut counts) = (vec![], vec![], vec![], vec![]);
        let (mut width, mut height, mut points) = (None, None, None);
        let mut viewpoint = Pose::IDENTITY;
        let mut offset = 0;
        for line in raw.split_inclusive(|&b| b == b'\n') {
            let bad = |expected: &str| {
                let shown = line.trim_ascii();
                file.malformed(offset, expected, quoted(&shown[..shown.len().min(60)]))
            };
            let text = String::from_utf8_lossy(line);
            let mut words = text.split_ascii_whitespace();
            let key = words.next().unwrap_or("").to_ascii_uppercase();
            let rest: Vec<&str> = words.collect();
            let number = || match rest[..] {
                [one] => one.parse::<u64>().map_err(|_| bad("a number")),
                _ => Err(bad("one number")),
            };
            match &*key {
                _ if key.is_empty() || key.starts_with('#') => {}
                "VERSION" => {}
                "FIELDS" | "COLUMNS" => names = rest.iter().map(|n| (*n).to_owned()).collect(),
                "SIZE" => sizes = rest.iter().map(|n| (*n).to_owned()).collect(),
                "TYPE" => types = rest.iter().map(|n| n.to_ascii_uppercase()).collect(),
                "COUNT" => {
                    let parsed: Result<Vec<u64>, _> = rest.iter().map(|n| n.parse()).collect();
                    counts = parsed.map_err(|_| bad("a count of each field"))?;
                }
                "WIDTH" => width = Some(number()?),
                "HEIGHT" => height = Some(number()?),
                "POINTS" => points = Some(number()?),
                "VIEWPOINT" => {
                    let parsed: Result<Vec<f64>, _> = rest.iter().map(|n| n.parse()).collect();
                    let v: [f64; 7] = parsed
                        .ok()
                        .and_then(|v| v.try_into().ok())
                        .ok_or_else(|| bad("a viewpoint of seven numbers: tx ty tz qw qx qy qz"))?;
                    viewpoint = Pose::from_quaternion([v[0], v[1], v[2]], [v[3], v[4], v[5], v[6]])
                        .map_err(|e| bad(&format!("a viewpoint that is a pose ({e})")))?;
                }
                "DATA" => {
                    let encoding = match rest.first().map(|w| w.to_ascii_lowercase()).as_deref() {
                        Some("ascii") => Encoding::Ascii,
                        Some("binary") => Encoding::Binary,
                        Some("binary_compressed") => Encoding::Compressed,
                        _ => return Err(bad("DATA ascii, binary or binary_compressed")),
                    };
                    let fields = fields(&names, &sizes, &types, &counts)
                        .ok_or_else(|| bad("FIELDS, SIZE, TYPE and COUNT before it that agree"))?;
                    let grid = width.and_then(|w: u64| w.checked_mul(height.unwrap_or(1)));
                    let points = points.or(grid).ok_or_else(|| bad("POINTS, or WIDTH and HEIGHT, before it"))?;
                    let data_offset = offset + line.len() as u64;
                    return Ok(Self { fields, points, viewpoint, encoding, data_offset });
                }
                _ => return Err(bad("a line of a PCD header")),
            }
            offset += line.len() as u64;
        }
        Err(file.malformed(offset, "a DATA line", "the end of the header"))
    }

    /// Bytes of a binary point.
    pub fn point_bytes(&self) -> u64 {
        self.fields.iter().map(|f| f.count * f.ty.size() as u64).sum()
    }
}

fn fields(names: &[String], sizes: &[String], types: &[String], counts: &[u64]) -> Option<Vec<PcdField>> {
    let agree = !names.is_empty() && sizes.len() == names.len() && types.len() == names.len();
    if !agree || !(counts.is_empty() || counts.len() == names.len()) {
        return None;
    }
    let field = |i: usize| {
        let ty = match (&*types[i], &*sizes[i]) {
            ("F", "4") => ScalarType::F32,
            ("F", "8") => ScalarType::F64,
            ("I", "1") => ScalarType::I8,
            ("I", "2") => ScalarType::I16,
            ("I", "4") => ScalarType::I32,
            ("I", "8") => ScalarType::I64,
            ("U", "1") => ScalarType::U8,
            ("U", "2") => ScalarType::U16,
            ("U", "4") => ScalarType::U32,
            ("U", "8") => ScalarType::U64,
            _ => return None,
        };
        Some(PcdField { name: names[i].clone(), ty, count: counts.get(i).copied().unwrap_or(1) })
    };
    let fields = (0..names.len()).map(field).collect::<Option<Vec<_>>>()?;
    let values = fields.iter().try_fold(0_u64, |sum, f| sum.checked_add(f.count))?;
    (1..=MOST_VALUES).contains(&values).then_some(fields)
}
