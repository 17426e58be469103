//! Which columns are encoded after which others, since what is alike in them is then stored once. Part of the format
//! (`docs/format.md`, chunk): a reader of a column reads those that it follows too.

use super::model::{Slot, StoredAttribute};
use crate::points::{Attribute, ScalarType};

/// A column and those that it follows, in order; all of one type.
const FOLLOWERS: [(&str, &[&str]); 3] =
    [("Green", &["Red"]), ("Blue", &["Red", "Green"]), ("NumberOfReturns", &["ReturnNumber"])];

/// The columns that a column follows, in order. In a part it follows those before the first that the part does not have.
pub(super) fn leaders(attributes: &[StoredAttribute], slot: Slot) -> impl Iterator<Item = Slot> + '_ {
    let own = attributes.binary_search_by_key(&slot, |a| a.id).ok().map(|i| &attributes[i].attribute);
    let own = own.filter(|own| may_lead(own));
    let named = own.and_then(|own| FOLLOWERS.iter().find(|(name, _)| *name == own.name).map(|f| (own.ty, f.1)));
    let (ty, names) = named.unwrap_or((ScalarType::U8, &[]));
    names.iter().map_while(move |name| {
        let is_leader = |a: &Attribute| a.name == *name && a.ty == ty && may_lead(a);
        attributes.iter().find(|a| is_leader(&a.attribute)).map(|leader| leader.id)
    })
}

/// There is at most one such attribute of a name and a type, so that it is plain which one another follows.
fn may_lead(attribute: &Attribute) -> bool {
    matches!(attribute.ty, ScalarType::U8 | ScalarType::U16)
        && attribute.scaling.is_none()
        && attribute.no_data.is_none()
}

/// Do others follow this one?
pub(super) fn leads(attributes: &[StoredAttribute], slot: Slot) -> bool {
    let own = attributes.binary_search_by_key(&slot, |a| a.id).ok().map(|i| &attributes[i].attribute);
    own.is_some_and(|own| may_lead(own) && FOLLOWERS.iter().any(|(_, leaders)| leaders.contains(&&*own.name)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::Scaling;

    #[test]
    fn columns_follow_those_of_their_own_type() {
        let all = [
            ("Blue", ScalarType::U16),
            ("Green", ScalarType::U16),
            ("Green", ScalarType::U8),
            ("Red", ScalarType::U16),
            ("NumberOfReturns", ScalarType::U8),
            ("ReturnNumber", ScalarType::U8),
            ("ReturnNumber", ScalarType::F64),
        ];
        let attributes: Vec<_> = (2..)
            .zip(all)
            .map(|(id, (name, ty))| StoredAttribute { id, attribute: Attribute::new(name, ty) })
            .collect();
        let of = |slot| leaders(&attributes, slot).collect::<Vec<_>>();
        assert_eq!([of(2), of(3), of(4), of(5), of(6)], [vec![5, 3], vec![5], vec![], vec![], vec![7]]);
        assert_eq!(
            [1, 2, 3, 5, 7, 8, 9].map(|slot| leads(&attributes, slot)),
            [false, false, true, true, true, false, false]
        );
    }

    /// Of two leaders the one that other columns were encoded after could be removed.
    #[test]
    fn no_column_follows_one_that_is_scaled_or_has_no_data() {
        let mut red = Attribute::new("Red", ScalarType::U16);
        red.scaling = Some(Scaling { scale: 2.0, offset: 0.0 });
        let mut hollow = Attribute::new("Red", ScalarType::U16);
        hollow.no_data = Some([0; 8]);
        let (green, plain) = (Attribute::new("Green", ScalarType::U16), Attribute::new("Red", ScalarType::U16));
        let all = [red, hollow, green, plain];
        let attributes: Vec<_> = (2..).zip(all).map(|(id, attribute)| StoredAttribute { id, attribute }).collect();
        assert_eq!(leaders(&attributes, 4).collect::<Vec<_>>(), [5]);
        assert_eq!([2, 3, 5].map(|slot| leads(&attributes, slot)), [false, false, true]);
        assert_eq!(leaders(&attributes[..3], 4).count(), 0);
    }
}
