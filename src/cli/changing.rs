//! The options of all commands that change a store.

use super::progress::Mode;
use super::values;
use crate::ingest::Resources;
use clap::Args;

#[derive(Debug, Args)]
pub(super) struct Changing {
    /// Memory to use at most, such as 512MiB or 4GiB (default: a quarter of the machine's).
    #[arg(long, value_name = "SIZE", value_parser = values::memory)]
    pub memory: Option<u64>,
    /// Threads (default: one per core, or for each 32 MiB of memory if these are fewer).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Wait while another process is writing to the store, instead of failing.
    #[arg(long)]
    pub wait: bool,
    /// How to show progress on stderr.
    #[arg(long, value_enum, default_value_t = Mode::Auto)]
    pub progress: Mode,
}

impl Changing {
    pub fn resources(&self) -> Resources {
        Resources { memory_bytes: self.memory, threads: self.threads.map(usize::from), wait: self.wait }
    }
}
