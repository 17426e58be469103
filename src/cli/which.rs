//! Which points of a store: the options that `query`, `nearest` and `density` share.

use super::interrupt::cancelled_by_interrupt;
use super::output;
use super::progress::Mode;
use super::region::Where;
use super::values;
use super::watching::{Reading, Watching};
use crate::geometry::Containment;
use crate::query::{Filter, Query, Region, Watch};
use crate::store::{Snapshot, WorldBounds};
use clap::Args;

#[derive(Debug, Args)]
pub(super) struct Which {
    #[command(flatten)]
    pub place: Where,
    /// Only points for which this is true, such as 'Classification in (2, 9)'.
    #[arg(long = "where", value_name = "EXPR", allow_hyphen_values = true)]
    filter: Option<String>,
    /// Only this scan, by name or id; may be given several times.
    #[arg(long = "scan", value_name = "NAME", value_parser = values::name, allow_hyphen_values = true)]
    pub scans: Vec<String>,
    #[command(flatten)]
    pub reading: Reading,
}

impl Which {
    /// The region that is meant.
    pub fn region(&self, snapshot: &Snapshot) -> anyhow::Result<Region> {
        self.place.region(&snapshot.site().lattice)
    }

    /// The points in `region`, by a query that Ctrl-C ends.
    pub fn query(&self, region: Region, snapshot: &Snapshot) -> anyhow::Result<Query> {
        let mut query = Query::new().region(region).cancel(&cancelled_by_interrupt());
        if let Some(text) = &self.filter {
            query = query.filter(filter(text, snapshot)?);
        }
        if !self.scans.is_empty() {
            query = query.scans(self.scans.iter().cloned());
        }
        if let Some(threads) = self.reading.threads {
            query = query.threads(threads.into());
        }
        Ok(query)
    }

    /// The same query, which shows how far it is until what comes with it is dropped. No bar crosses points that go to
    /// stdout.
    pub fn watched(&self, query: Query, to_stdout: bool) -> (Query, Watching) {
        let mode = if to_stdout && self.reading.progress == Mode::Auto { Mode::None } else { self.reading.progress };
        let watch = Watch::new();
        let query = query.watch(&watch);
        (query, Watching::new(mode, "querying", move || (watch.points(), watch.expected())))
    }
}

/// Says why there may be nothing in an answer: a region beside the site, hidden scans.
pub(super) fn tell_why_nothing(snapshot: &Snapshot, region: &Region, scans: &[String]) -> anyhow::Result<()> {
    let lattice = &snapshot.site().lattice;
    let bounds = snapshot.scans().iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b));
    if let Some(axis) = region.empty_axis() {
        output::tell!(
            "esker: the region has no extent on {}: it holds nothing without its maximum faces; --closed takes these, too",
            ["x", "y", "z"][axis]
        );
    } else if let Some(bounds) = bounds
        && region.on_lattice(lattice)?.classify(&bounds) == Containment::Outside
    {
        let WorldBounds { min, max } = WorldBounds::new(lattice, &bounds);
        output::tell!(
            "esker: the region lies outside the site, whose bounds are {},{},{},{},{},{}",
            min[0],
            min[1],
            min[2],
            max[0],
            max[1],
            max[2]
        );
    }
    let hidden = snapshot.scans().iter().filter(|s| !s.visible).count();
    if hidden > 0 && scans.is_empty() {
        let all = snapshot.scans().len();
        output::tell!("esker: {hidden} of {all} scans are hidden; `esker show` shows them, --scan asks for one");
    }
    Ok(())
}

/// Reads a filter; says where a name means a coordinate and could be meant as an attribute's.
pub(super) fn filter(text: &str, snapshot: &Snapshot) -> anyhow::Result<Filter> {
    let filter = Filter::parse(text)?;
    for words in filter.ambiguities(snapshot) {
        output::tell!("esker: {}", output::clean(&words));
    }
    Ok(filter)
}

/// The attributes of an answer: `none`, some, or all where none is named.
pub(super) fn with_attributes(query: Query, names: &[String]) -> Query {
    match names {
        [] => query,
        [none] if none.eq_ignore_ascii_case("none") => query.positions_only(),
        names => query.attributes(names.iter().map(|n| n.trim().to_owned())),
    }
}
