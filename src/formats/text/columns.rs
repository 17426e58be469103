//! Which column is what: by a header line, by what the user says, or by their number; and the type of each.

use super::survey::Column;
use crate::formats::names::attribute_name;
use crate::points::ScalarType::{self, F32, F64, I16, I32, I64, U8, U16};
use crate::points::canonical_name;

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
    let mut roles: Vec<Role> = names.iter().map(|name| role(name)).collect();
    // One letter alone may mean anything; the three together are a colour.
    let letters = [("r", "Red"), ("g", "Green"), ("b", "Blue")];
    let places = letters.map(|(letter, _)| names.iter().position(|n| n.eq_ignore_ascii_case(letter)));
    if let [Some(r), Some(g), Some(b)] = places {
        for (place, (_, name)) in [r, g, b].into_iter().zip(letters) {
            roles[place] = Role::Attribute(name.to_owned());
        }
    }
    roles
}

fn role(name: &str) -> Role {
    let folded: String = name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect();
    match &*folded {
        "x" | "easting" | "east" => Role::Axis(0),
        "y" | "northing" | "north" => Role::Axis(1),
        "z" | "elevation" | "height" => Role::Axis(2),
        "" | "skip" => Role::Skip,
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
        (_, None) => Role::Attribute(format!("column{}", i + 1)),
    };
    (0..columns).map(name).collect()
}

/// The name and the type of an attribute that the file calls `name`; `None` for a column that holds text, or nothing.
pub fn attribute(name: &str, column: &Column) -> Option<(String, ScalarType)> {
    if column.text.is_some() || column.numbers == 0 {
        return None;
    }
    let ty = customary(name, column).unwrap_or_else(|| general(column));
    let color = matches!(canonical_name(name), Some("Red" | "Green" | "Blue"));
    if color && !matches!(ty, U8 | U16) {
        // Fractions are no LAS colour.
        return Some((name.to_ascii_lowercase(), ty));
    }
    Some((attribute_name(name, ty), ty))
}

/// The type that a LAS dimension has, if it has one and the values fit.
fn customary(name: &str, column: &Column) -> Option<ScalarType> {
    let types: &[ScalarType] = match canonical_name(name)? {
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
    // Six digits come back from an f32, whatever they are; an f64 keeps fifteen.
    let short = column.decimal && column.largest_mantissa < 1_000_000 && column.decimals <= 30;
    if column.plain && column.absent == 0 && column.decimal {
        let fits = |ty: &ScalarType| range(*ty).0 <= column.min && column.max <= range(*ty).1;
        return [I32, I64].into_iter().find(fits).unwrap_or(F64);
    }
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
        for bad in ["x,y", "x,y,z,x", "x,y,,z", ""] {
            assert!(parse_columns(bad).is_err(), "{bad}");
        }
    }
}
