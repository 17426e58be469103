//! Which column is what: by a header line, by what the user says, or by their number; and the type of each.

use super::number::MOST_EXACT;
use super::survey::Column;
use crate::formats::names::{Namer, attribute_name, dimension};
use crate::points::ScalarType::{self, F32, F64, I16, I32, I64, U8, U16, U64};

/// What a column is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Role {
    /// x, y or z.
    Axis(usize),
    /// An attribute of this name.
    Attribute(String),
    /// Not to be read.
    Skip,
}

/// Reads the names of `--columns`: `x,y,z,intensity,red,green,blue`, with `-`, `_` or `skip` for a column that is not read.
///
/// # Errors
///
/// In words, if x, y or z is missing or there twice.
pub fn parse_columns(text: &str) -> Result<Vec<String>, String> {
    let names: Vec<String> = text.split(',').map(|n| n.trim().to_owned()).collect();
    if names.iter().any(String::is_empty) {
        return Err("a name is empty; a column that is not to be read is called `-`".to_owned());
    }
    axes(&roles(&names)).ok_or_else(|| "x, y and z are needed, each of them once".to_owned())?;
    Ok(names)
}

/// What columns of these names are.
pub fn roles(names: &[String]) -> Vec<Role> {
    let mut roles: Vec<Role> = names.iter().enumerate().map(|(i, name)| role(name, i)).collect();
    // One letter alone may mean anything; the three together are a colour.
    let letters = [("r", "Red"), ("g", "Green"), ("b", "Blue")];
    let places = letters.map(|(letter, _)| names.iter().position(|n| n.eq_ignore_ascii_case(letter)));
    if let [Some(r), Some(g), Some(b)] = places {
        for (place, (_, name)) in [r, g, b].into_iter().zip(letters) {
            roles[place] = Role::Attribute(name.to_owned());
        }
    }
    // So are east and north, where nothing else is.
    let one_of = |words: &[&str]| names.iter().position(|n| words.contains(&&*bare(n)));
    let has = |roles: &[Role], axis| roles.contains(&Role::Axis(axis));
    let height = one_of(&["h", "alt", "hgt"]);
    if let (Some(e), Some(n), false, false) =
        (one_of(&["e", "ost"]), one_of(&["n", "nord"]), has(&roles, 0), has(&roles, 1))
        && (has(&roles, 2) || height.is_some())
    {
        (roles[e], roles[n]) = (Role::Axis(0), Role::Axis(1));
    }
    // And so are degrees: beside eastings they are attributes.
    if let (Some(lon), Some(lat), false, false) = (one_of(LONGITUDE), one_of(LATITUDE), has(&roles, 0), has(&roles, 1))
    {
        (roles[lon], roles[lat]) = (Role::Axis(0), Role::Axis(1));
    }
    // What may be a height is one, where nothing else is.
    if let (Some(h), true, true, false) = (height, has(&roles, 0), has(&roles, 1), has(&roles, 2)) {
        roles[h] = Role::Axis(2);
    }
    // `x`, `y` and `z` themselves go before words for them: beside `z`, `height` is something else.
    for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
        let of_axis = |i: &usize| roles[*i] == Role::Axis(axis);
        let (exact, others): (Vec<_>, Vec<_>) =
            (0..names.len()).filter(of_axis).partition(|&i| names[i].eq_ignore_ascii_case(letter));
        if exact.len() == 1 {
            others.into_iter().for_each(|i| roles[i] = Role::Attribute(names[i].clone()));
        }
    }
    roles
}

const LONGITUDE: &[&str] = &["longitude", "lon", "lng", "long"];
const LATITUDE: &[&str] = &["latitude", "lat"];

/// A name without its unit, in small letters.
fn bare(name: &str) -> String {
    name.split(['(', '[']).next().unwrap_or(name).trim().to_ascii_lowercase()
}

/// Are x and y degrees, by their names?
pub fn are_degrees(names: &[String]) -> bool {
    let of_axis = |axis, words: &[&str]| {
        let place = roles(names).iter().position(|role| *role == Role::Axis(axis));
        place.is_some_and(|i| words.contains(&&*bare(&names[i])))
    };
    of_axis(0, LONGITUDE) && of_axis(1, LATITUDE)
}

/// What column `i` of this name is.
fn role(name: &str, i: usize) -> Role {
    match name {
        "" => return Role::Attribute(unnamed(i)),
        "-" | "_" => return Role::Skip,
        _ => {}
    }
    let fold = |text: &str| -> String {
        text.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
    };
    // `Easting (m)`, `Z [ft]`; as surveyors write in German, too.
    let word = name.split(['(', '[']).next().unwrap_or(name).replace(['ö', 'Ö'], "oe");
    match &*fold(&word) {
        "x" | "xcoord" | "xcoordinate" | "pointx" | "easting" | "east" | "rechtswert" | "ostwert" => {
            return Role::Axis(0);
        }
        "y" | "ycoord" | "ycoordinate" | "pointy" | "northing" | "north" | "hochwert" | "nordwert" => {
            return Role::Axis(1);
        }
        "z" | "zcoord" | "zcoordinate" | "pointz" | "elevation" | "elev" | "altitude" | "height" | "hoehe" => {
            return Role::Axis(2);
        }
        _ => {}
    }
    match &*fold(name) {
        "skip" => Role::Skip,
        "i" => Role::Attribute("Intensity".into()),
        _ => Role::Attribute(name.to_owned()),
    }
}

/// Which columns are x, y and z; `None` unless each of them is there, once.
pub fn axes(roles: &[Role]) -> Option<[usize; 3]> {
    let mut found = [None; 3];
    for (i, role) in roles.iter().enumerate() {
        if let Role::Axis(axis) = role {
            if found[*axis].is_some() {
                return None;
            }
            found[*axis] = Some(i);
        }
    }
    Some([found[0]?, found[1]?, found[2]?])
}

/// Two columns that are both x, both y or both z: their numbers from 1, and which.
pub fn twice(roles: &[Role]) -> Option<(usize, usize, &'static str)> {
    let second = |i: &usize| matches!(roles[*i], Role::Axis(_)) && roles[..*i].contains(&roles[*i]);
    let b = (0..roles.len()).find(second)?;
    let Role::Axis(axis) = roles[b] else { return None };
    let a = roles.iter().position(|role| *role == roles[b])?;
    Some((a + 1, b + 1, ["x", "y", "z"][axis]))
}

/// What the columns of rows without names are, after x, y and z.
pub fn guess(columns: &[Column]) -> Vec<Role> {
    let byte = |i: usize| columns[i].within(0.0, 255.0);
    let color = |i: usize| columns[i].within(0.0, 65535.0);
    let unit = |i: usize| columns[i].numbers > 0 && -1.0 <= columns[i].min && columns[i].max <= 1.0;
    let constant = |i: usize| columns[i].min == columns[i].max;
    let rest: &[&str] = match columns.len() {
        4 => &["Intensity"],
        6 if (3..6).all(byte) || (3..6).all(color) => &["Red", "Green", "Blue"],
        6 if (3..6).all(unit) => &["NormalX", "NormalY", "NormalZ"],
        7 if (3..7).all(byte) && constant(6) => &["Red", "Green", "Blue", "Alpha"],
        7 if (4..7).all(color) => &["Intensity", "Red", "Green", "Blue"],
        _ => &[],
    };
    named(columns.len(), rest)
}

/// x, y, z, then these names, then numbers.
pub fn named(columns: usize, rest: &[&str]) -> Vec<Role> {
    let name = |i: usize| match (i, rest.get(i.wrapping_sub(3))) {
        (0..3, _) => Role::Axis(i),
        (_, Some(name)) => Role::Attribute((*name).to_owned()),
        (_, None) => Role::Attribute(unnamed(i)),
    };
    (0..columns).map(name).collect()
}

/// The name of column `i` where it has none.
fn unnamed(i: usize) -> String {
    format!("column{}", i + 1)
}

/// What the type of each column follows from: its values in all blocks of a file, and those of the other parts of a colour or
/// a normal. An attribute that has another type in every scan is many.
pub struct Kinds(Vec<Column>);

impl Kinds {
    /// Of columns with these roles, in one or several blocks.
    pub fn of<'c>(roles: &[Role], blocks: impl IntoIterator<Item = &'c [Column]>) -> Self {
        let mut kinds = vec![Column::default(); roles.len()];
        for block in blocks {
            for (kind, column) in kinds.iter_mut().zip(block).filter(|(_, c)| is_kept(c)) {
                kind.merge(column.clone());
            }
        }
        for part in [is_color, is_normal] {
            let of_part = |role: &Role| matches!(role, Role::Attribute(name) if part(name));
            let mut whole = Column::default();
            let parts = || roles.iter().enumerate().filter(|(_, role)| of_part(role)).map(|(i, _)| i);
            parts().filter(|&i| is_kept(&kinds[i])).for_each(|i| whole.merge(kinds[i].clone()));
            parts().for_each(|i| kinds[i] = whole.clone());
        }
        Self(kinds)
    }

    /// The name and the type of the attribute that the file calls `name`, in column `i`; `None` if that holds text, or nothing.
    pub fn attribute(
        &self,
        (name, namer): (&str, &Namer),
        i: usize,
        column: &Column,
        format: &str,
    ) -> Option<(String, ScalarType)> {
        let kind = self.0.get(i).filter(|_| is_kept(column))?;
        let (canonical, ty) = attribute(name, namer, kind);
        let ty = match format {
            // A scanner's intensity is a fraction, or a number around zero, as a rule of its format, not of its digits.
            "ptx" if canonical == "Intensity" => F32,
            "pts" if canonical == "Intensity" && kind.absent == 0 && kind.within(-2048.0, 2047.0) => I16,
            _ => ty,
        };
        Some((canonical, ty))
    }
}

/// Does it hold numbers of more digits than its type gives back?
pub fn is_rounded(column: &Column, ty: ScalarType) -> bool {
    ty.is_float() && column.rounded
}

/// Does it hold numbers, and nothing else?
fn is_kept(column: &Column) -> bool {
    column.text.is_none() && column.numbers > 0
}

fn is_color(name: &str) -> bool {
    matches!(dimension(name), Some("Red" | "Green" | "Blue"))
}

fn is_normal(name: &str) -> bool {
    matches!(&*attribute_name(name, F32), "NormalX" | "NormalY" | "NormalZ")
}

fn attribute(name: &str, namer: &Namer, column: &Column) -> (String, ScalarType) {
    let ty = customary(name, column).unwrap_or_else(|| general(column));
    if is_color(name) && !matches!(ty, U8 | U16) {
        // Fractions are no LAS colour.
        return (name.to_ascii_lowercase(), ty);
    }
    (namer.name(name, ty), ty)
}

/// The type that a LAS dimension has, if it has one and the values fit.
fn customary(name: &str, column: &Column) -> Option<ScalarType> {
    // An integer of more digits than an f64 has stays one, whatever it is called.
    if column.plain && column.absent == 0 && column.min.abs().max(column.max.abs()) >= MOST_EXACT as f64 {
        return None;
    }
    if is_normal(name) {
        return Some(float(column));
    }
    let types: &[ScalarType] = match dimension(name)? {
        "GpsTime" => return Some(F64),
        "Red" | "Green" | "Blue" | "Infrared" => &[U8, U16],
        "Intensity" => &[U16, I16],
        "PointSourceId" => &[U16],
        "ReturnNumber" | "NumberOfReturns" | "ScanDirectionFlag" | "EdgeOfFlightLine" | "Classification"
        | "Synthetic" | "KeyPoint" | "Withheld" | "Overlap" | "ScanChannel" | "UserData" => &[U8],
        _ => return None,
    };
    let fits = |ty: &&ScalarType| {
        let (min, max) = range(**ty);
        column.absent == 0 && column.decimal && column.within(min, max)
    };
    // `255.0` is no colour of another type than `255`, but `0.5` is.
    types.iter().find(fits).copied()
}

/// The smallest type that keeps every number as it is written.
fn general(column: &Column) -> ScalarType {
    if column.plain && column.absent == 0 {
        // Those that are not wide have 60 bits.
        if let Some((min, max)) = column.wide {
            let signed = i128::from(i64::MIN) <= min && max <= i128::from(i64::MAX);
            let unsigned = column.min >= 0.0 && 0 <= min && max <= i128::from(u64::MAX);
            return if signed {
                I64
            } else if unsigned {
                U64
            } else {
                F64
            };
        }
        let fits = |ty: &ScalarType| range(*ty).0 <= column.min && column.max <= range(*ty).1;
        return [I32, I64].into_iter().find(fits).unwrap_or(F64);
    }
    float(column)
}

/// Six digits come back from an f32, whatever they are; an f64 keeps fifteen.
fn float(column: &Column) -> ScalarType {
    let short = column.decimal && column.largest_mantissa < 1_000_000 && column.decimals <= 30;
    if short { F32 } else { F64 }
}

/// The limits of an integer type; 64 bits as far as they are certain.
fn range(ty: ScalarType) -> (f64, f64) {
    match ty {
        U8 => (0.0, 255.0),
        U16 => (0.0, 65535.0),
        I16 => (-32768.0, 32767.0),
        I32 => (-2_147_483_648.0, 2_147_483_647.0),
        _ => (-9.2e18, 9.2e18),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_named_once_each() {
        assert_eq!(parse_columns("x, y,z,-,Intensity").unwrap(), ["x", "y", "z", "-", "Intensity"]);
        assert_eq!(roles(&parse_columns("R,G,B,Easting,Northing,Z").unwrap())[3], Role::Axis(0));
        // German names and degrees; the latter not beside eastings, where they were taken for a second x.
        let axes_of = |names: &str| {
            let names: Vec<String> = names.split(';').map(str::to_owned).collect();
            axes(&roles(&names))
        };
        assert_eq!(axes_of("Nr;Rechtswert;Hochwert;Höhe"), Some([1, 2, 3]));
        assert_eq!(axes_of("Latitude (deg);lon;height"), Some([1, 0, 2]));
        assert_eq!(axes_of("lat;lon;easting;northing;height"), Some([2, 3, 4]));
        assert_eq!(axes_of("lat;lon;x;y;z"), Some([2, 3, 4]));
        for bad in ["x,y", "x,y,z,x", "x,y,,z", ""] {
            assert!(parse_columns(bad).is_err(), "{bad}");
        }
    }
}
