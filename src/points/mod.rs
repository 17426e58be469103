//! Points in memory: attributes, columns, batches, and the raw records that an ingest moves around.

mod attribute;
mod batch;
mod column;
mod crs;
mod geokeys;
mod normals;
mod number;
mod provenance;
mod real;
mod record;
mod wkt;

pub use attribute::{Attribute, Identity, ScalarType, Scaling, angle_steps, canonical_name, same_name, wider_type};
pub use batch::{Batch, Positions};
pub use column::Column;
pub use normals::{has_other_normals, normals_in};
pub use number::Number;
pub(crate) use number::counted;
pub use provenance::{Crs, LasFacts, RawVlr};
pub use real::Real;
pub use record::{Field, FieldKind, PositionKind, RecordLayout};
