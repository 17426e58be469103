//! What each frame cost, as a table of CSV.

use crate::cli::output;
use crate::formats::{OutputFile, check_output};
use anyhow::ensure;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Where the table goes.
pub(super) enum Table {
    Nowhere,
    /// Line by line.
    StandardOutput,
    /// It appears when all is drawn.
    File(OutputFile),
}

impl Table {
    /// With its head; in none of the places where `pictures` will lie.
    pub fn create(path: Option<&Path>, pictures: &[PathBuf], force: bool) -> anyhow::Result<Self> {
        let mut table = match path {
            None => return Ok(Self::Nowhere),
            Some(path) if path == Path::new("-") => Self::StandardOutput,
            Some(path) => {
                let place = check_output(path, force)?;
                ensure!(
                    !pictures.contains(&place),
                    "{}: is the picture's name, too; give --stats another one",
                    path.display()
                );
                Self::File(OutputFile::create(path, force)?)
            }
        };
        table.line(&format!("{HEAD}\n"))?;
        Ok(table)
    }

    pub fn is_standard_output(&self) -> bool {
        matches!(self, Self::StandardOutput)
    }

    /// Appends a line, with its end.
    pub fn line(&mut self, line: &str) -> anyhow::Result<()> {
        match self {
            Self::Nowhere => {}
            Self::StandardOutput => output::line(line.trim_end())?,
            Self::File(file) => file.write(line.as_bytes())?,
        }
        Ok(())
    }

    pub fn finish(self) -> anyhow::Result<()> {
        match self {
            Self::Nowhere | Self::StandardOutput => Ok(()),
            Self::File(file) => Ok(file.finish()?),
        }
    }
}

/// The head of the table.
const HEAD: &str = "frame,points,nodes,parts_loaded,points_loaded,bytes_read,bytes_uploaded,select_ms,load_ms,\
                               read_core_ms,decode_core_ms,pack_core_ms,upload_ms,draw_ms,error_px,adapter_ms,elapsed_ms";

/// What a frame cost. Times of stages that run on all threads are summed over them (`core`); `load` is what passed from
/// the first of them to the last. `adapter` and `elapsed` count from the start of the command: until the adapter was there,
/// and until the picture was.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FrameStatistics {
    pub points: u64,
    pub nodes: u64,
    pub parts_loaded: u64,
    pub points_loaded: u64,
    pub bytes_read: u64,
    pub bytes_uploaded: u64,
    pub select: Duration,
    pub load: Duration,
    pub read: Duration,
    pub decode: Duration,
    pub pack: Duration,
    pub upload: Duration,
    pub draw: Duration,
    pub error_px: Option<f64>,
    pub adapter: Duration,
    pub elapsed: Duration,
}

impl FrameStatistics {
    /// A line of the table, with its end.
    pub fn line(&self, frame: usize) -> String {
        let counts =
            [self.points, self.nodes, self.parts_loaded, self.points_loaded, self.bytes_read, self.bytes_uploaded];
        let times = [self.select, self.load, self.read, self.decode, self.pack, self.upload, self.draw];
        let mut line = frame.to_string();
        counts.into_iter().for_each(|count| line.push_str(&format!(",{count}")));
        let ms = |time: Duration| format!(",{:.3}", time.as_secs_f64() * 1e3);
        times.into_iter().for_each(|time| line.push_str(&ms(time)));
        line.push_str(&self.error_px.map_or_else(|| ",".into(), |px| format!(",{px:.4}")));
        line + &ms(self.adapter) + &ms(self.elapsed) + "\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_the_columns_of_the_head() {
        for error_px in [None, Some(0.5)] {
            let line = FrameStatistics { points: 7, error_px, ..Default::default() }.line(3);
            assert_eq!(line.matches(',').count(), HEAD.matches(',').count());
            assert!(line.starts_with("3,7,0,") && line.ends_with('\n'), "{line}");
        }
    }
}
