//! All integration tests in one binary, so that SQLite and wgpu are linked once.

mod answers;
mod bad_input;
mod bad_queries;
mod canonical;
mod changes;
mod combinations;
mod engine;
mod exports;
mod faults;
mod fidelity;
mod fields;
mod floors;
mod growth;
mod histories;
mod json;
mod kinds;
mod labels;
mod memory;
mod order;
mod outofcore;
mod outputs;
#[cfg(feature = "render")]
mod pictures;
mod places;
mod poses;
mod readers;
#[cfg(feature = "stream")]
mod streaming;
mod support;
mod systems;
mod tables;
#[cfg(feature = "viewer")]
mod window;
