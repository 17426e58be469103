//! The window: `esker view STORE`.
//!
//! What is shown and what keys and mouse do is state without a window (`model/`, `navigate.rs`, `rig.rs`), tested as such;
//! `panels/` show and change it; `window/` brings events in and pictures out. The
//! [`Stream`](crate::stream::Stream) decides what lies on the adapter, [`Renderer`](crate::render::Renderer) draws it,
//! and `work.rs` does what takes time. The frame's thread waits for none of them.

mod bindings;
mod found;
mod gpu;
mod measure;
mod model;
mod navigate;
mod panels;
pub mod remembered;
mod rig;
mod script;
mod site;
mod window;
mod work;

pub use model::Start;
pub use script::{Step, parse as parse_script};
pub use window::{Options, run};
pub use work::{Exporter, Wanted};

use thiserror::Error;

/// Why there is no window, or no longer.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ViewerError {
    /// There is no display, or it refuses a window.
    #[error("there can be no window: {0}; is there a display? `esker render` needs none")]
    Window(String),
    /// No adapter can draw into the window.
    #[error("{0}")]
    Graphics(String),
    /// The renderer can't be made.
    #[error(transparent)]
    Render(#[from] crate::render::RenderError),
    /// A thread can't be started.
    #[error("no thread can be started")]
    Thread(#[from] std::io::Error),
    /// A script waited in vain, or names what is not there.
    #[error("the script's step {step}: {what}")]
    Script {
        /// Which, from 1.
        step: usize,
        /// What is wrong.
        what: String,
    },
    /// The window was closed, and this was asked for before and was not done.
    #[error("{0}")]
    NotDone(String, #[source] Option<Box<ViewerError>>),
}
