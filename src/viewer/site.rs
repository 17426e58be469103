//! What is known of the store that is looked at: scans, bounds, bookmarks, a sample of its points.

use crate::geometry::{Camera, DVec3, WorldBox};
use crate::lattice::Lattice;
use crate::points::Batch;
use crate::query::{Query, QueryError, flat_attributes, occupied_boxes};
use crate::render::{ColorDepths, ColorMode};
use crate::store::model::ScanId;
use crate::store::{Snapshot, StoreError};
use std::collections::BTreeMap;

/// A scan as the panels show it.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanFacts {
    /// Its number.
    pub id: ScanId,
    /// Its name.
    pub name: String,
    /// How many points it has.
    pub points: u64,
    /// Does the store show it?
    pub visible: bool,
    /// Where the scanner stood, if the scan says so.
    pub station: Option<DVec3>,
    /// Where its points are.
    pub bounds: Option<WorldBox>,
}

/// One generation of the store.
#[derive(Clone, Debug)]
pub struct Site {
    /// Which generation.
    pub generation: u64,
    /// What positions mean.
    pub lattice: Lattice,
    /// By number.
    pub scans: Vec<ScanFacts>,
    /// Of all visible scans.
    pub bounds: Option<WorldBox>,
    /// Boxes that together hold the points of all scans, nearly.
    pub outline: Vec<WorldBox>,
    /// All points.
    pub points: u64,
    /// Names of all attributes.
    pub attributes: Vec<String>,
    /// The unit of lengths.
    pub unit: String,
    /// Named cameras.
    pub bookmarks: Vec<(String, Camera)>,
    /// Some points of everywhere, with what colours look at.
    pub sample: Batch,
    /// How to read recorded colours.
    pub depths: ColorDepths,
}

impl Site {
    /// Reads what is not in the snapshot's head: a few rows, and the sample.
    ///
    /// # Errors
    ///
    /// [`QueryError`] if the store can't be read.
    pub fn read(snapshot: &Snapshot) -> Result<Self, QueryError> {
        let facts = snapshot.site();
        let lattice = facts.lattice.clone();
        let world = |b: crate::lattice::LatticeBox| {
            WorldBox::new(lattice.world_from_lattice(b.min), lattice.world_from_lattice(b.max))
        };
        let scan = |s: &crate::store::model::Scan| ScanFacts {
            id: s.id,
            name: s.name.clone(),
            points: s.stored,
            visible: s.visible,
            station: station(&s.pose),
            bounds: s.bounds.and_then(world),
        };
        let scans: Vec<ScanFacts> = snapshot.scans().iter().map(scan).collect();
        let seen = snapshot.scans().iter().filter(|s| s.visible).filter_map(|s| s.bounds).reduce(|a, b| a.union(&b));
        let bounds = seen.and_then(world);
        let has = |name: &str| snapshot.attributes().iter().any(|a| a.attribute.name == name);
        let wanted = ["Red", "Green", "Blue", "Intensity", "Classification", "ReturnNumber", "GpsTime"];
        let mut sample = Batch::empty(Vec::new().into());
        if bounds.is_some() {
            let flat = flat_attributes(snapshot)?;
            let shows = |name: &&str| has(name) && ColorMode::shows(name, &flat);
            let query = Query::new().coarse_sample().with_scans(true);
            sample = query.attributes(wanted.into_iter().filter(shows)).collect(snapshot)?.0;
        }
        let depths: BTreeMap<u32, Option<u8>> = snapshot.scans().iter().map(|s| (s.id, s.color_depth)).collect();
        Ok(Self {
            generation: facts.generation,
            points: scans.iter().map(|s| s.points).sum(),
            outline: occupied_boxes(snapshot, |_| true)?.into_iter().filter_map(world).collect(),
            scans,
            bounds,
            attributes: snapshot.attributes().iter().map(|a| a.attribute.name.clone()).collect(),
            unit: facts.crs.as_ref().and_then(|c| c.unit_name()).unwrap_or("m").to_owned(),
            bookmarks: bookmarks(snapshot)?,
            sample,
            depths: ColorDepths::of_scans(depths),
            lattice,
        })
    }

    /// Scanner positions, with the names of their scans.
    pub fn stations(&self) -> impl Iterator<Item = (&str, DVec3)> {
        self.scans.iter().filter_map(|s| Some((s.name.as_str(), s.station?)))
    }

    /// Does any scan have the attribute?
    pub fn has(&self, name: &str) -> bool {
        self.attributes.iter().any(|a| a == name)
    }
}

/// The cameras that are kept in the store; what is not a camera is left out.
pub fn bookmarks(snapshot: &Snapshot) -> Result<Vec<(String, Camera)>, StoreError> {
    let read = |(name, json): (String, String)| Some((name, serde_json::from_str(&json).ok()?));
    Ok(snapshot.bookmarks()?.into_iter().filter_map(read).collect())
}

/// Where the scanner stood: the origin of the scan's own frame, if it has one.
fn station(pose: &[f64; 16]) -> Option<DVec3> {
    let identity: [f64; 16] = std::array::from_fn(|i| f64::from(u8::from(i % 5 == 0)));
    let place = DVec3::new(pose[3], pose[7], pose[11]);
    (*pose != identity && place.is_finite()).then_some(place)
}
