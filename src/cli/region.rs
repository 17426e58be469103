//! The options that say where.

use super::output;
use crate::lattice::Lattice;
use crate::query::Region;
use clap::Args;

/// Several options of one kind are united, options of different kinds intersected.
#[derive(Debug, Args)]
#[command(next_help_heading = "Where (several of one kind: in any of them; different kinds: in all of them)")]
pub(super) struct Where {
    /// X0,Y0,X1,Y1 in plan or X0,Y0,Z0,X1,Y1,Z1.
    #[arg(long = "box", value_name = "NUMBERS", allow_hyphen_values = true, value_parser = Region::parse_box)]
    boxes: Vec<Region>,
    /// Take points on the maximum faces of boxes, turned ones included, too.
    #[arg(long)]
    pub closed: bool,
    /// X,Y,Z,R.
    #[arg(long = "sphere", value_name = "NUMBERS", allow_hyphen_values = true, value_parser = Region::parse_sphere)]
    spheres: Vec<Region>,
    /// X,Y,Z,SX,SY,SZ,YAW[,PITCH,ROLL]: a turned box; its centre, its full sides, degrees (yaw is counter-clockwise from above).
    #[arg(long = "obox", value_name = "NUMBERS", allow_hyphen_values = true, value_parser = Region::parse_oriented_box)]
    oriented_boxes: Vec<Region>,
    /// Polygons in the store's coordinates: WKT or GeoJSON, as text or in a file.
    #[arg(long = "polygon", value_name = "WKT|FILE")]
    polygons: Vec<String>,
    /// What a camera sees (a view file) or a clip matrix keeps, at full detail; compare --view.
    #[arg(long = "frustum", value_name = "FILE.json")]
    frusta: Vec<String>,
    /// MIN,MAX: heights from MIN up to, but without, MAX.
    #[arg(long = "z", value_name = "MIN,MAX", allow_hyphen_values = true, value_parser = Region::parse_heights)]
    heights: Vec<Region>,
    /// Shapes joined by and, or, not: 'polygon(plot.wkt) and not (sphere(1,2,3,4) or z(0,2))'.
    #[arg(long, value_name = "EXPR", allow_hyphen_values = true)]
    region: Option<String>,
}

impl Where {
    /// Is no place asked for?
    pub fn is_everything(&self) -> bool {
        let Self { boxes, closed: _, spheres, oriented_boxes, polygons, frusta, heights, region } = self;
        let solids = [boxes, spheres, oriented_boxes, heights].into_iter().all(Vec::is_empty);
        solids && polygons.is_empty() && frusta.is_empty() && region.is_none()
    }

    /// The region that is meant; boxes are half-open unless `--closed` was given.
    pub fn region(&self, lattice: &Lattice) -> anyhow::Result<Region> {
        let inf = f64::INFINITY;
        let each = |texts: &[String], read: &dyn Fn(&str) -> Result<Region, crate::query::QueryError>| {
            let regions = texts.iter().map(|text| read(text)).collect::<Result<Vec<_>, _>>()?;
            Ok::<_, crate::query::QueryError>((!regions.is_empty()).then(|| Region::any(regions)))
        };
        let any = |regions: &[Region]| (!regions.is_empty()).then(|| Region::any(regions.iter().cloned()));
        let kinds = [
            any(&self.boxes),
            any(&self.spheres),
            any(&self.oriented_boxes),
            each(&self.polygons, &|text| Region::parse_polygon(text, [-inf, inf]))?,
            each(&self.frusta, &Region::read_frustum)?,
            any(&self.heights),
            self.region.as_deref().map(Region::parse).transpose()?,
        ];
        let region = Region::all(kinds.into_iter().flatten());
        if self.closed && region.closed_on(lattice) == region {
            output::tell!(
                "esker: --closed has no effect: the region has no box with a maximum face that points lie on"
            );
        }
        Ok(if self.closed { region.closed_on(lattice) } else { region })
    }
}
