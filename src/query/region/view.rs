//! A frustum from text: a view file, or a clip matrix in JSON.

use super::Region;
use crate::geometry::{Camera, ClipDepth, DMat4};
use crate::query::QueryError;
use serde::Deserialize;

/// `{"clip_from_world": [[16 numbers in four rows]], "depth": "zero_to_one"}`, not checked yet.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ClipFile {
    clip_from_world: [[f64; 4]; 4],
    #[serde(default)]
    depth: Depth,
}

#[derive(Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Depth {
    #[default]
    ZeroToOne,
    MinusOneToOne,
}

impl Region {
    /// A frustum from JSON: a view file, or `{"clip_from_world": [[..], [..], [..], [..]]}` with the matrix in rows, for column
    /// vectors of world coordinates, and `"depth": "minus_one_to_one"` if it is one of OpenGL.
    ///
    /// # Errors
    ///
    /// [`QueryError::Region`] for what is neither.
    pub fn parse_frustum(text: &str) -> Result<Self, QueryError> {
        let refused = |what: String| QueryError::Region(format!("the frustum {what}"));
        let value: serde_json::Value = serde_json::from_str(text).map_err(|e| refused(format!("is no JSON: {e}")))?;
        if value.get("clip_from_world").is_none() {
            let camera: Camera = serde_json::from_value(value).map_err(|e| refused(format!("is no view: {e}")))?;
            return Ok(Self::new_frustum(&camera));
        }
        let file: ClipFile = serde_json::from_value(value).map_err(|e| refused(format!("is no clip matrix: {e}")))?;
        let depth = match file.depth {
            Depth::ZeroToOne => ClipDepth::ZeroToOne,
            Depth::MinusOneToOne => ClipDepth::MinusOneToOne,
        };
        Self::new_clip_matrix(DMat4::from_cols_array_2d(&file.clip_from_world).transpose(), depth)
    }
}
