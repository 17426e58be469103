//! The header of a PLY file: text lines, whatever follows.

use crate::formats::FormatError;
use crate::formats::file::SourceFile;
use crate::formats::las::quoted;
use crate::points::ScalarType;

/// A header longer than this is none.
const LONGEST_HEADER: u64 = 1 << 20;

/// How values are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// As text, separated by white space.
    Ascii,
    /// As bytes, least significant first.
    Little,
    /// As bytes, most significant first.
    Big,
}

/// What a property holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One value.
    Scalar(ScalarType),
    /// A count, then as many values.
    List {
        /// Type of the count.
        count: ScalarType,
        /// Type of the values.
        item: ScalarType,
    },
}

/// A property of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    /// Its name.
    pub name: String,
    /// Its type.
    pub kind: Kind,
}

/// An element: a table of records.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Element {
    /// Its name.
    pub name: String,
    /// Records that the header announces.
    pub count: u64,
    /// Its properties, in order.
    pub properties: Vec<Property>,
}

impl Element {
    /// Bytes of a binary record; `None` if records differ in length.
    pub fn fixed_bytes(&self) -> Option<u64> {
        self.properties
            .iter()
            .map(|p| match p.kind {
                Kind::Scalar(ty) => Some(ty.size() as u64),
                Kind::List { .. } => None,
            })
            .sum()
    }
}

/// A header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// How values are written.
    pub encoding: Encoding,
    /// The elements, in order.
    pub elements: Vec<Element>,
    /// Where the first element's records begin.
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
        // Only where lines end in a lone carriage return, a line feed after `end_header` is data.
        let first = raw.iter().position(|b| matches!(b, b'\n' | b'\r'));
        let lone_returns = first.is_some_and(|i| raw[i] == b'\r' && raw.get(i + 1) != Some(&b'\n'));
        let terminator = if lone_returns { b'\r' } else { b'\n' };
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut offset = 0;
        for (number, line) in raw.split_inclusive(|&b| b == terminator).enumerate() {
            let bad = |expected: &str| {
                let shown = line.trim_ascii();
                file.malformed(offset, expected, quoted(&shown[..shown.len().min(60)]))
            };
            let next = offset + line.len() as u64;
            let Some(text) = line.strip_suffix(&[terminator]).map(String::from_utf8_lossy) else {
                // `end_header` may be the last bytes of a file without data.
                if line.trim_ascii() == b"end_header" {
                    return Self::finish(file, encoding, elements, next);
                }
                return Err(bad("a header line that ends"));
            };
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            match (number, &words[..]) {
                (0, ["ply"]) => {}
                (0, _) => return Err(bad("the word `ply`")),
                (_, [] | ["comment" | "obj_info", ..]) => {}
                (_, ["format", word, ..]) => {
                    encoding = Some(match *word {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::Little,
                        "binary_big_endian" => Encoding::Big,
                        _ => return Err(bad("format ascii, binary_little_endian or binary_big_endian")),
                    });
                }
                (_, ["element", name, count, ..]) => {
                    let count = count.parse().map_err(|_| bad("an element with a count"))?;
                    elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
                }
                (_, ["property", rest @ ..]) => {
                    let property = property(rest).ok_or_else(|| bad("a property with a known type and a name"))?;
                    let element = elements.last_mut().ok_or_else(|| bad("an element before its properties"))?;
                    element.properties.push(property);
                }
                (_, ["end_header"]) => return Self::finish(file, encoding, elements, next),
                _ => return Err(bad("format, comment, obj_info, element, property or end_header")),
            }
            offset = next;
        }
        Err(file.malformed(offset, "the line `end_header`", "the end of the header's room"))
    }

    fn finish(
        file: &SourceFile,
        encoding: Option<Encoding>,
        elements: Vec<Element>,
        data_offset: u64,
    ) -> Result<Self, FormatError> {
        let encoding = encoding.ok_or_else(|| file.malformed(data_offset, "a `format` line in the header", "none"))?;
        Ok(Self { encoding, elements, data_offset })
    }
}

fn property(words: &[&str]) -> Option<Property> {
    let (name, kind) = match words {
        ["list", count, item, name, ..] => {
            let count = scalar(count).filter(|c| !c.is_float())?;
            (name, Kind::List { count, item: scalar(item)? })
        }
        [ty, name, ..] => (name, Kind::Scalar(scalar(ty)?)),
        _ => return None,
    };
    Some(Property { name: (*name).to_owned(), kind })
}

/// Types by the old names, by the sized ones, and by the 64-bit ones that some writers add.
fn scalar(word: &str) -> Option<ScalarType> {
    Some(match word {
        "char" | "int8" => ScalarType::I8,
        "uchar" | "uint8" => ScalarType::U8,
        "short" | "int16" => ScalarType::I16,
        "ushort" | "uint16" => ScalarType::U16,
        "int" | "int32" => ScalarType::I32,
        "uint" | "uint32" => ScalarType::U32,
        "int64" => ScalarType::I64,
        "uint64" => ScalarType::U64,
        "float" | "float32" => ScalarType::F32,
        "double" | "float64" => ScalarType::F64,
        _ => return None,
    })
}
