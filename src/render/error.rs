//! What can go wrong on the way to a picture.

use std::path::PathBuf;
use thiserror::Error;

/// Why there is no picture.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RenderError {
    /// No graphics adapter, not even a software one.
    #[error(
        "no graphics adapter was found; install a Vulkan driver, for example the software one: `apt-get install \
         mesa-vulkan-drivers` (Debian, Ubuntu), `dnf install mesa-vulkan-drivers` (Fedora)"
    )]
    NoAdapter(#[source] wgpu::RequestAdapterError),
    /// None is called so.
    #[error("no graphics adapter has {name:?} in its name (WGPU_ADAPTER_NAME); there are: {known}")]
    UnknownAdapter {
        /// What the environment says.
        name: String,
        /// Those that are there.
        known: String,
    },
    /// The adapter refused or failed.
    #[error("graphics adapter {adapter}: {reason}")]
    Device {
        /// Which one.
        adapter: String,
        /// In its words.
        reason: String,
    },
    /// The image has no pixels, or more on a side than the adapter can draw.
    #[error("an image of {width} x {height} pixels can't be drawn: each side must be from 1 to {limit}")]
    Size {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// The most of either.
        limit: u32,
    },
    /// A node has more or fewer colours than points.
    #[error("node {node} of the scene has {points} points, but {colors} colours")]
    ColorCount {
        /// Its place in the scene.
        node: usize,
        /// How many positions.
        points: usize,
        /// How many colours.
        colors: usize,
    },
    /// A number in the scene or the options can't be drawn with.
    #[error("{name} is {value}; it must be {expected}")]
    Number {
        /// What.
        name: &'static str,
        /// How much.
        value: f64,
        /// What would do.
        expected: &'static str,
    },
    /// No such way to colour.
    #[error("no color mode {0:?}; there are {modes}", modes = super::ColorMode::words())]
    UnknownColor(String),
    /// No such splat.
    #[error("no shape {0:?}; there are round, square and paraboloid")]
    UnknownShape(String),
    /// More than the passes hold.
    #[error("{count} clip boxes; there can be {limit}", limit = super::MAX_CLIPS)]
    TooManyClips {
        /// How many were given.
        count: usize,
    },
    /// The pool is as full as it may be.
    #[error("the graphics pool has {free} free blocks, but {wanted} are wanted")]
    PoolFull {
        /// How many were asked for.
        wanted: usize,
        /// How many there are.
        free: usize,
    },
    /// The points lack what the colour mode shows.
    #[error("color mode {mode} needs the attribute {attribute}, which the points don't have")]
    NoAttribute {
        /// The mode's word.
        mode: &'static str,
        /// What it shows.
        attribute: &'static str,
    },
    /// The file is there already.
    #[error("{} exists already; use --force to replace it", .0.display())]
    Exists(PathBuf),
    /// The file can't be written.
    #[error("can't write {}", path.display())]
    Write {
        /// Which one.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The picture can't be encoded.
    #[error("the picture can't be encoded as PNG")]
    Encode(#[from] png::EncodingError),
}
