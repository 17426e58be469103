//! Which attributes are the surface's normal: a direction, which turns with the frame that it is given in.

use super::{Attribute, ScalarType};

/// The attributes of a normal.
const NAMES: [&str; 3] = ["NormalX", "NormalY", "NormalZ"];

/// The places of `NormalX`, `NormalY` and `NormalZ` in a list, if all three are there as floats of one type, without scaling
/// and no-data value.
pub fn normals_in(attributes: &[Attribute]) -> Option<[usize; 3]> {
    [ScalarType::F32, ScalarType::F64].into_iter().find_map(|ty| {
        let plain = |a: &Attribute| a.ty == ty && a.scaling.is_none() && a.no_data.is_none();
        let [x, y, z] = NAMES.map(|name| attributes.iter().position(|a| a.name == name && plain(a)));
        Some([x?, y?, z?])
    })
}

/// Are there normals of another kind, which can't be turned?
pub fn has_other_normals(attributes: &[Attribute]) -> bool {
    normals_in(attributes).is_none() && attributes.iter().any(|a| NAMES.contains(&&*a.name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_are_three_floats_of_one_type() {
        let of = |types: [ScalarType; 3]| {
            let normal = |(name, ty): (&str, ScalarType)| Attribute::new(name, ty);
            let mut all: Vec<_> = NAMES.into_iter().zip(types).map(normal).collect();
            all.insert(1, Attribute::new("Intensity", ScalarType::U16));
            all
        };
        use ScalarType::{F32, F64, I8};
        assert_eq!(normals_in(&of([F32; 3])), Some([0, 2, 3]));
        assert_eq!(normals_in(&of([F64; 3])), Some([0, 2, 3]));
        for other in [[I8; 3], [F32, F32, F64]] {
            assert_eq!(normals_in(&of(other)), None);
            assert!(has_other_normals(&of(other)));
        }
        assert!(!has_other_normals(&of([F32; 3])) && !has_other_normals(&[]));
    }
}
