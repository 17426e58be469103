//! What must be on the graphics adapter for a camera that moves, without a window and without wgpu.
//!
//! A [`Stream`] follows the newest camera. It asks a [`Source`] what the camera wants, loads what is missing, most urgent
//! first, fills blocks of a [`PointPool`](gpu::PointPool), and hands out draw lists: the frame draws the newest one and
//! never waits for anything. A draw list is always a *closed cut*: every node's ancestors are in it. So a region whose
//! finer points are still on their way is shown by coarser ones, which stand in for them, and there is never a hole.
//!
//! - **Double buffer.** The pool has room for two lists of the allowed points: the one that is drawn and the one that is
//!   wanted. A list that somebody holds keeps its blocks; what is wanted keeps its blocks; the rest is a cache, of which
//!   what was of use least lately goes first (`residency.rs`). A part is uploaded once while it stays.
//! - **Swaps.** A new list is handed out as soon as everything wanted is there, and every
//!   [`SWAP_INTERVAL`] while something is loading. When what is shown changes (other scans, another paint, a new
//!   generation) the old list stays until the new one is complete, or for [`SETTLE_TIME`] at most; an empty
//!   one is replaced at once, by a coarse one that then stays in the same way.
//! - **Superseding.** Only the newest camera counts: one selection runs at a time, and the queue of loads is made anew by
//!   each. What was being decoded for an older one and is not wanted any more is dropped before it is uploaded.
//! - **Threads.** One task, on tokio, decides everything (`driver/`); selecting and decoding run on rayon's threads
//!   (`store_source.rs`). The frame's thread exchanges a camera and a list with the task, through locks that are held for
//!   as long as it takes to copy a pointer.

mod cut;
mod driver;
pub mod gpu;
mod handle;
mod motion;
mod priority;
mod residency;
mod settings;
mod source;
mod spacing;
mod store_source;

pub use driver::{PREFETCH_AHEAD, SETTLE_TIME, SWAP_INTERVAL};
pub use handle::{Front, PickPlace, Status, Stream};
pub use settings::{Limits, ScanChoice, Shown};
pub use source::{Content, Loaded, Pending, Selected, Source, StreamError, View};
pub use spacing::{Densities, set_spacings};
pub use store_source::{StoreContent, StoreSource};
