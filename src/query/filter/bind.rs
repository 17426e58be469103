//! Names to columns: an expression on the attributes and scans of one store.

use super::FilterError;
use super::parser::{Expression, Literal, Name, Relation};
use super::set::{DecimalSet, ValueSet};
use crate::lattice::{Decimal, Lattice, LatticePoint};
use crate::points::{Real, ScalarType, Scaling, canonical_name, same_name};
use crate::query::error::{did_you_mean, nearest};
use crate::query::kinds::{Kinds, Widening};
use crate::store::model::{Scan, ScanId, Slot, StoredAttribute};

/// What a filter is bound to.
pub(crate) struct Names<'a> {
    pub attributes: &'a [StoredAttribute],
    pub scans: &'a [Scan],
    pub lattice: &'a Lattice,
    /// What the answer makes of kinds that meet in it: a filter sees the same values.
    pub met: &'a Kinds,
}

/// A filter on columns.
#[derive(Clone, Debug)]
pub(super) enum Bound {
    And(Vec<Bound>),
    Or(Vec<Bound>),
    Not(Box<Bound>),
    /// The first value that is not null is in the set of its column.
    Values(Vec<(Source, ValueSet)>),
    /// All of these are null.
    Null(Vec<Source>),
    /// One attribute against another.
    Pair(Vec<Source>, Relation, Vec<Source>),
    /// A coordinate, as a set of lattice indices.
    Axis(usize, ValueSet),
    /// The point is of one of these scans, ascending.
    Scans(Vec<ScanId>),
}

/// One column that a name stands for.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub slot: Slot,
    pub ty: ScalarType,
    /// For comparisons with other attributes.
    pub scaling: Option<Scaling>,
    /// The same, worked out.
    pub real: Real,
    /// What becomes of its integers where they meet those of another kind.
    pub widening: Option<Widening>,
    /// The stored bytes that mean null.
    pub no_data: Option<[u8; 8]>,
    /// The scans that have it, ascending; `None`: all.
    pub scans: Option<Vec<ScanId>>,
}

pub(super) fn bind(text: &str, expression: &Expression, names: &Names) -> Result<Bound, FilterError> {
    let each = |terms: &[Expression]| terms.iter().map(|t| bind(text, t, names)).collect::<Result<Vec<_>, _>>();
    match expression {
        Expression::And(terms) => Ok(Bound::And(each(terms)?)),
        Expression::Or(terms) => Ok(Bound::Or(each(terms)?)),
        Expression::Not(inner) => Ok(Bound::Not(Box::new(bind(text, inner, names)?))),
        Expression::Compare(name, relation, literal, at) if is_scan(name) => {
            let scans = Bound::Scans(vec![scan(text, literal, *at, names)?]);
            match relation {
                Relation::Equal => Ok(scans),
                Relation::NotEqual => Ok(Bound::Not(Box::new(scans))),
                _ => Err(FilterError::new("scans are compared by =, <> or \"in\"", text, name.at)),
            }
        }
        Expression::In(name, values) if is_scan(name) => {
            let scans = values.iter().map(|(literal, at)| scan(text, literal, *at, names));
            let mut scans = scans.collect::<Result<Vec<_>, _>>()?;
            scans.sort_unstable();
            scans.dedup();
            Ok(Bound::Scans(scans))
        }
        Expression::Compare(name, relation, literal, at) => {
            values(text, name, &DecimalSet::of_relation(*relation, number(text, literal, *at)?), names)
        }
        Expression::Between(name, low, high) => values(text, name, &DecimalSet::between(*low, *high), names),
        Expression::In(name, literals) => {
            let numbers = literals.iter().map(|(literal, at)| number(text, literal, *at));
            let numbers = numbers.collect::<Result<Vec<_>, _>>()?;
            values(text, name, &DecimalSet::any_of(numbers.into_iter()), names)
        }
        Expression::IsNull(name) => match axis(name, names) {
            // Every point has coordinates.
            Some(_) => Ok(Bound::Or(Vec::new())),
            None => Ok(Bound::Null(sources(text, name, names)?)),
        },
        Expression::Pair(a, relation, b) if is_scan(a) && b.quoted => {
            let literal = Literal::Text(b.name.clone());
            bind(text, &Expression::Compare(a.clone(), *relation, literal, b.at), names)
        }
        Expression::Pair(a, _, b) if is_scan(a) && !is_scan(b) => {
            let message = format!("names of scans are in quotes: scan = '{}'", b.name);
            Err(FilterError::new(message, text, b.at))
        }
        Expression::Pair(a, relation, b) => {
            if let Some(name) = [a, b].into_iter().find(|name| axis(name, names).is_some()) {
                let attribute = attributes_named(&name.name, names.attributes);
                let quote =
                    if attribute.is_empty() { "" } else { "; the attribute of that name is written in double quotes" };
                let message = format!("a coordinate is compared with numbers, not with another column{quote}");
                return Err(FilterError::new(message, text, name.at));
            }
            Ok(Bound::Pair(sources(text, a, names)?, *relation, sources(text, b, names)?))
        }
    }
}

fn is_scan(name: &Name) -> bool {
    !name.quoted && !name.raw && name.name.eq_ignore_ascii_case("scan")
}

fn scan(text: &str, literal: &Literal, at: usize, names: &Names) -> Result<ScanId, FilterError> {
    let (found, asked) = match literal {
        Literal::Text(asked) => (names.scans.iter().find(|s| s.name == *asked), asked.clone()),
        Literal::Number(id) => {
            let exact = |s: &&Scan| Decimal::new(s.id.into(), 0) == *id;
            (names.scans.iter().find(exact), id.to_string())
        }
    };
    found.map(|s| s.id).ok_or_else(|| {
        let hint = did_you_mean(&nearest(&asked, names.scans.iter().map(|s| s.name.as_str())));
        FilterError::new(format!("there is no scan \"{asked}\"{hint}"), text, at)
    })
}

fn number(text: &str, literal: &Literal, at: usize) -> Result<Decimal, FilterError> {
    match literal {
        Literal::Number(number) => Ok(*number),
        Literal::Text(_) => {
            Err(FilterError::new("attributes are numbers; only scans are compared with texts", text, at))
        }
    }
}

/// 0, 1, 2 for `X`, `Y`, `Z`, unless it is in quotes and there is an attribute of that name.
fn axis(name: &Name, names: &Names) -> Option<usize> {
    let axis = ["x", "y", "z"].iter().position(|a| name.name.eq_ignore_ascii_case(a))?;
    let is_attribute = name.raw || (name.quoted && !attributes_named(&name.name, names.attributes).is_empty());
    (!is_attribute).then_some(axis)
}

/// What names mean that might mean something else, in words: a coordinate or the attribute that is called so, an attribute or the
/// dimension of LAS that is called so, too.
pub(super) fn ambiguous(expression: &Expression, names: &Names) -> Vec<String> {
    let mut found = Vec::new();
    let mut open = vec![expression];
    while let Some(expression) = open.pop() {
        let written: &[&Name] = match expression {
            Expression::And(terms) | Expression::Or(terms) => {
                open.extend(terms);
                &[]
            }
            Expression::Not(inner) => {
                open.push(inner);
                &[]
            }
            Expression::Compare(name, ..)
            | Expression::Between(name, ..)
            | Expression::In(name, _)
            | Expression::IsNull(name) => &[name],
            Expression::Pair(a, _, b) => &[a, b],
        };
        found.extend(written.iter().filter_map(|name| other_meaning(name, names)));
    }
    found.sort_unstable();
    found.dedup();
    found
}

fn other_meaning(name: &Name, names: &Names) -> Option<String> {
    let name_is = &name.name;
    let attributes = attributes_named(name_is, names.attributes);
    let first = attributes.first()?;
    if axis(name, names).is_some() {
        return Some(format!(
            "{name_is} is taken as the coordinate; the attribute of that name is written \"{name_is}\", in double quotes"
        ));
    }
    let dimension = canonical_name(name_is).filter(|dimension| *dimension != first.attribute.name)?;
    let is_there = names.attributes.iter().any(|a| a.attribute.name == dimension);
    is_there.then(|| {
        format!(
            "{name_is} is taken as the attribute {}, which some scans have, not as {dimension}",
            first.attribute.name
        )
    })
}

fn values(text: &str, name: &Name, set: &DecimalSet, names: &Names) -> Result<Bound, FilterError> {
    if let Some(axis) = axis(name, names) {
        let zero = names.lattice.decimal_on_axis(axis, LatticePoint::default().0[axis]);
        let quantum = names.lattice.quantum()[axis];
        let set = set.on_integers(quantum, zero).ok_or_else(|| {
            FilterError::new("this number has too many digits to be compared with a coordinate", text, name.at)
        })?;
        return Ok(Bound::Axis(axis, set));
    }
    let tests = sources(text, name, names)?.into_iter().map(|source| {
        let exact = || {
            let (scale, offset) = match source.scaling {
                None => (Decimal::new(1, 0), Decimal::ZERO),
                Some(s) => (Decimal::from_f64(s.scale)?, Decimal::from_f64(s.offset)?),
            };
            let set = set.on_integers(scale, offset)?;
            Some(source.widening.map_or_else(|| set.clone(), |widening| set.before(widening, source.ty)))
        };
        let exact = if source.ty.is_float() { None } else { exact() };
        let set = exact.unwrap_or_else(|| set.on_floats(source.scaling));
        (source, set)
    });
    Ok(Bound::Values(tests.collect()))
}

/// The columns that a name stands for: those of exactly this name, else of the same name but for case and underscores,
/// else those of the LAS dimension that is also called so. There may be several, of different types and scalings.
fn sources(text: &str, name: &Name, names: &Names) -> Result<Vec<Source>, FilterError> {
    let found = attributes_named(&name.name, names.attributes);
    if found.is_empty() {
        let all = names.attributes.iter().map(|a| a.attribute.name.as_str()).chain(["scan", "X", "Y", "Z"]);
        let message = format!("there is no attribute \"{}\"{}", name.name, did_you_mean(&nearest(&name.name, all)));
        let hint = if is_scan(name) { "scans are compared by =, <> or \"in\"".into() } else { message };
        return Err(FilterError::new(hint, text, name.at));
    }
    let mut sources = Vec::new();
    for StoredAttribute { id, attribute } in found {
        let mut having: Vec<ScanId> = names.scans.iter().filter(|s| s.attributes.contains(id)).map(|s| s.id).collect();
        having.sort_unstable();
        let (scaling, no_data) = if name.raw { (None, None) } else { (attribute.scaling, attribute.no_data_bytes()) };
        let mut source = |scans: Vec<ScanId>, widening| {
            let scans = (scans.len() < names.scans.len()).then_some(scans);
            let real = Real::new(scaling);
            sources.push(Source { slot: *id, ty: attribute.ty, scaling, real, widening, no_data, scans });
        };
        let is_widened = |&scan: &ScanId| !name.raw && names.met.widening(*id, scan).is_some();
        let (widened, plain): (Vec<ScanId>, Vec<ScanId>) = having.into_iter().partition(is_widened);
        if let Some(&first) = widened.first() {
            source(widened.clone(), names.met.widening(*id, first));
        }
        if widened.is_empty() || !plain.is_empty() {
            source(plain, None);
        }
    }
    Ok(sources)
}

/// The attributes that a user means by `name`; several if types or scalings differ. `NAME:TYPE` means those of one type, unless an
/// attribute is called so.
pub(crate) fn attributes_named<'a>(name: &str, attributes: &'a [StoredAttribute]) -> Vec<&'a StoredAttribute> {
    let found = of_any_type(name, attributes);
    let typed = || name.rsplit_once(':').and_then(|(name, word)| Some((name, ScalarType::from_word(word)?)));
    match typed() {
        Some((name, ty)) if found.is_empty() => {
            of_any_type(name, attributes).into_iter().filter(|a| a.attribute.ty == ty).collect()
        }
        _ => found,
    }
}

fn of_any_type<'a>(name: &str, attributes: &'a [StoredAttribute]) -> Vec<&'a StoredAttribute> {
    let with = |test: &dyn Fn(&str) -> bool| -> Vec<&'a StoredAttribute> {
        attributes.iter().filter(|a| test(&a.attribute.name)).collect()
    };
    let exact = with(&|n| n == name);
    if !exact.is_empty() {
        return exact;
    }
    let same = with(&|n| same_name(n, name));
    if !same.is_empty() {
        return same;
    }
    canonical_name(name).map_or_else(Vec::new, |canonical| with(&|n| n == canonical))
}
