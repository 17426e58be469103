//! In which coordinate reference system a site is, by what its inputs say.

use super::IngestError;
use crate::points::Crs;
use std::path::PathBuf;

/// What an input says of its coordinates.
#[derive(Clone, Debug)]
pub(super) struct Said {
    pub path: PathBuf,
    /// The file, and which of its scans.
    pub label: String,
    pub crs: Option<Crs>,
    /// World bounds, where they are known before it is read.
    pub bounds: Option<([f64; 3], [f64; 3])>,
}

/// Compares the CRS of inputs with the site's; returns the site's CRS afterwards and what to tell.
pub(super) fn agree_on_crs(
    site: Option<Crs>,
    inputs: &[Said],
    ignore: bool,
) -> Result<(Option<Crs>, Vec<String>), IngestError> {
    let mut notes = Vec::new();
    let mut site = site.filter(|c| !c.is_empty());
    let mut of: Option<PathBuf> = None;
    for said in inputs {
        let Some(crs) = &said.crs else { continue };
        let path = &said.path;
        match &site {
            None => {
                site = Some(crs.clone());
                of = Some(path.clone());
            }
            Some(expected) => match expected.same_as(crs) {
                // What says in which system heights are, too, says more, whichever comes first.
                Some(true) if expected.vertical_epsg.is_none() && crs.vertical_epsg.is_some() => {
                    site = Some(crs.clone());
                    of = Some(path.clone());
                }
                Some(true) => {}
                Some(false) if ignore => notes.push(format!(
                    "{}: its CRS is {}, the site's is {}; its coordinates are taken as they are (--ignore-crs)",
                    path.display(),
                    crs.describe_beside(expected),
                    expected.describe_beside(crs)
                )),
                Some(false) => {
                    return Err(IngestError::OtherCrs {
                        path: path.clone(),
                        expected: expected.describe_beside(crs),
                        found: crs.describe_beside(expected),
                    });
                }
                None => notes.push(format!(
                    "{}: can't tell whether its CRS ({}) is the site's ({}); its coordinates are taken as they are",
                    path.display(),
                    crs.describe(),
                    expected.describe()
                )),
            },
        }
    }
    let far = |said: &&Said| {
        let is_geographic = said.crs.as_ref().or(site.as_ref()).is_some_and(Crs::is_geographic);
        let bounds = said.bounds.filter(|_| is_geographic);
        bounds.is_some_and(|(min, max)| (0..2).any(|axis| min[axis].abs().max(max[axis].abs()) > 360.0))
    };
    for said in inputs.iter().filter(far) {
        let (min, max) = said.bounds.unwrap_or_default();
        let crs = said.crs.as_ref().or(site.as_ref()).map(Crs::describe).unwrap_or_default();
        notes.push(format!(
            "{}: its CRS ({crs}) is in degrees, but its coordinates lie between {},{} and {},{}; --crs says what they are",
            said.path.display(),
            min[0],
            min[1],
            max[0],
            max[1]
        ));
    }
    let without: Vec<&str> = inputs.iter().filter(|s| s.crs.is_none()).map(|s| s.label.as_str()).collect();
    if let (Some(crs), Some(first)) = (&site, without.first()) {
        let from = of.map(|p| format!(" of {}", p.display())).unwrap_or_default();
        let which = match without.len() {
            1 => format!("{first} names no CRS and takes"),
            2 => format!("{first} and {} name no CRS and take", without[1]),
            n => format!("{first} and {} other inputs name no CRS and take", n - 1),
        };
        notes.push(format!("{which} the site's, {}{from}", crs.describe()));
    }
    Ok((site, notes))
}
