//! What is asked for.

use super::filter::attributes_named;
use super::plan::asked_scans;
use super::{Cancel, Detail, Filter, Policy, QueryError, Region, Watch};
use crate::geometry::Camera;
use crate::points::Attribute;
use crate::store::Snapshot;
use crate::store::model::ScanId;

/// Which attributes an answer has.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Attributes {
    /// All that the contributing scans have.
    #[default]
    All,
    /// Positions alone.
    None,
    /// Those of these names, looked up as in a filter; a name stands for all types and scalings it has.
    Named(Vec<String>),
}

/// *Region and filter at detail, giving attributes.* Without anything said: every point of every visible scan, with all
/// attributes.
///
/// ```
/// use esker::lattice::Lattice;
/// use esker::query::{Detail, Filter, Query, Region};
/// use esker::store::{SiteOptions, Store};
///
/// # let store = Store::in_memory(SiteOptions::new(Lattice::uniform(0.001)?))?;
/// let snapshot = store.snapshot()?;
/// let query = Query::new()
///     .region(Region::new_box([0.0, 0.0, -5.0], [100.0, 50.0, 20.0])?)
///     .filter(Filter::parse("Z between 1.5 and 3 or Z < 0")?)
///     .detail(Detail::MaxError(0.05))
///     .capacity(1_000_000);
/// let mut points = 0;
/// let answer = query.run(&snapshot, |batch| {
///     points += batch.len() as u64;
///     std::ops::ControlFlow::Continue(())
/// })?;
/// assert_eq!(answer.points, points);
/// assert_eq!(answer.error_bound, Some(0.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Query {
    pub(super) region: Region,
    pub(super) filter: Option<Filter>,
    pub(super) scans: Option<Vec<String>>,
    pub(super) detail: Detail,
    pub(super) capacity: Option<u64>,
    pub(super) attributes: Attributes,
    pub(super) with_scans: bool,
    pub(super) view: Option<(Camera, f64)>,
    pub(super) threads: Option<usize>,
    pub(super) cancel: Option<Cancel>,
    pub(super) watch: Option<Watch>,
    pub(super) policy: Policy,
    /// Are all attributes those of the scans that can contribute?
    pub(super) tight: bool,
}

/// More threads than any pool has.
const MOST_THREADS: usize = 1 << 16;

impl Query {
    /// Everything.
    pub fn new() -> Self {
        Self::default()
    }

    /// Only what is inside.
    #[must_use]
    pub fn region(mut self, region: Region) -> Self {
        self.region = region;
        self
    }

    /// Only points for which this is true.
    #[must_use]
    pub fn filter(mut self, filter: Filter) -> Self {
        self.filter = Some(filter);
        self
    }

    /// Is there a filter?
    pub(crate) fn has_filter(&self) -> bool {
        self.filter.is_some()
    }

    /// Only points of these scans, by name or number, also if they are hidden.
    #[must_use]
    pub fn scans<S: Into<String>>(mut self, scans: impl IntoIterator<Item = S>) -> Self {
        self.scans = Some(scans.into_iter().map(Into::into).collect());
        self
    }

    /// The numbers of the scans whose points are asked for, ascending: those named, or all visible ones.
    ///
    /// # Errors
    ///
    /// [`QueryError::UnknownScan`] if the store has no such scan.
    pub fn asked_scans(&self, snapshot: &Snapshot) -> Result<Vec<ScanId>, QueryError> {
        asked_scans(self, snapshot)
    }

    /// How fine.
    #[must_use]
    pub fn detail(mut self, detail: Detail) -> Self {
        self.detail = detail;
        self
    }

    /// The points that ranges of colours, legends and what is there are found by: the coarsest level of what is asked for, or as
    /// much of it as is enough.
    #[must_use]
    pub fn coarse_sample(self) -> Self {
        /// A site that fills a volume has millions in its coarsest level.
        const MOST: u64 = 200_000;
        self.detail(Detail::Level(0)).capacity(MOST)
    }

    /// At most so many points: the first of one fixed sequence, so that answers to larger capacities hold those to
    /// smaller ones.
    #[must_use]
    pub fn capacity(mut self, points: u64) -> Self {
        self.capacity = Some(points);
        self
    }

    /// Only these attributes, looked up as in a filter.
    #[must_use]
    pub fn attributes<S: Into<String>>(mut self, names: impl IntoIterator<Item = S>) -> Self {
        self.attributes = Attributes::Named(names.into_iter().map(Into::into).collect());
        self
    }

    /// Without the attributes that only scans have which can't contribute a point.
    #[must_use]
    pub(crate) fn tight(mut self) -> Self {
        self.tight = true;
        self
    }

    /// This attribute, too.
    #[must_use]
    pub(crate) fn with_attribute(mut self, name: &str) -> Self {
        self.attributes = match self.attributes {
            Attributes::All => Attributes::All,
            Attributes::None => Attributes::Named(vec![name.into()]),
            Attributes::Named(names) => Attributes::Named(names.into_iter().chain([name.into()]).collect()),
        };
        self
    }

    /// Of each of these attributes, of an answer, the place at which it was asked for; the same for all if all are.
    pub(crate) fn places_of(&self, attributes: &[Attribute], snapshot: &Snapshot) -> Vec<usize> {
        let names: &[String] = match &self.attributes {
            Attributes::Named(names) => names,
            Attributes::All | Attributes::None => &[],
        };
        // Names may be synonyms, and several kinds of a name may have become one.
        let meant: Vec<Vec<&str>> = names
            .iter()
            .map(|name| attributes_named(name, snapshot.attributes()).iter().map(|a| &*a.attribute.name).collect())
            .collect();
        let place = |a: &Attribute| meant.iter().position(|names| names.contains(&&*a.name)).unwrap_or(names.len());
        attributes.iter().map(place).collect()
    }

    /// Positions alone.
    #[must_use]
    pub fn positions_only(mut self) -> Self {
        self.attributes = Attributes::None;
        self
    }

    /// Was no attribute left out?
    pub fn asks_for_all_attributes(&self) -> bool {
        self.attributes == Attributes::All
    }

    /// Is every point to carry the id of its scan?
    #[must_use]
    pub fn with_scans(mut self, with_scans: bool) -> Self {
        self.with_scans = with_scans;
        self
    }

    /// Decodes on so many threads of the pool at most (at least one); with one, on the thread that asks. Otherwise on all of
    /// the pool that the thread belongs to.
    #[must_use]
    pub fn threads(mut self, threads: usize) -> Self {
        self.threads = Some(threads.clamp(1, MOST_THREADS));
        self
    }

    /// May be ended by this token.
    #[must_use]
    pub fn cancel(mut self, cancel: &Cancel) -> Self {
        self.cancel = Some(cancel.clone());
        self
    }

    /// Says how far it is.
    #[must_use]
    pub fn watch(mut self, watch: &Watch) -> Self {
        self.watch = Some(watch.clone());
        self
    }

    /// What a camera needs: whole parts of the nodes in its view, coarse to fine, until every node's spacing is at most
    /// `max_error_px` pixels or the capacity is used. With a [`Detail`] as well it goes no finer than that. The points come
    /// near to far.
    #[must_use]
    pub fn view(mut self, camera: Camera, max_error_px: f64) -> Self {
        self.view = Some((camera, max_error_px));
        self
    }

    /// How a view spreads its points; by their error on the screen, if nothing is said.
    #[must_use]
    pub fn policy(mut self, policy: Policy) -> Self {
        self.policy = policy;
        self
    }
}
