//! The names that attributes have in a file, each once.

use crate::points::Attribute;
use std::collections::HashSet;

/// The names of `attributes` beside `axes`: each as `plain` gives it, with a number where it is taken, as it is by an attribute
/// of the same name and another type. Of those that were changed, `notes` tells that they are a `what` of another name.
pub(super) fn distinct(
    attributes: &[Attribute],
    axes: [&str; 3],
    plain: impl Fn(&Attribute) -> String,
    what: &str,
    notes: &mut Vec<String>,
) -> Vec<String> {
    let mut taken: HashSet<String> = axes.map(String::from).into();
    let name = |attribute: &Attribute| {
        let plain = Some(plain(attribute)).filter(|p| !p.is_empty()).unwrap_or_else(|| "unnamed".to_owned());
        let numbered = (2..).map(|n: u64| format!("{plain}.{n}"));
        let mut free = [plain.clone()].into_iter().chain(numbered).filter(|n| taken.insert(n.clone()));
        let name = free.next().unwrap_or_default();
        if name != plain || attribute.name.is_empty() {
            notes.push(format!("{} ({}) is {what} {name}", attribute.name, attribute.ty.word()));
        }
        name
    };
    attributes.iter().map(name).collect()
}
