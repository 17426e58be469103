//! What a frame cost, as a line of CSV.

use std::fmt::Write;
use std::time::Duration;

/// The head of the table.
pub(super) const HEAD: &str = "frame,points,nodes,parts_loaded,points_loaded,bytes_read,bytes_uploaded,select_ms,load_ms,\
                               read_core_ms,decode_core_ms,pack_core_ms,upload_ms,draw_ms,error_px";

/// What a frame cost. Times of stages that run on all threads are summed over them (`core`); `load` is what passed from
/// the first of them to the last.
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
}

impl FrameStatistics {
    /// A line of the table, with its end.
    pub fn line(&self, frame: usize) -> String {
        let counts =
            [self.points, self.nodes, self.parts_loaded, self.points_loaded, self.bytes_read, self.bytes_uploaded];
        let times = [self.select, self.load, self.read, self.decode, self.pack, self.upload, self.draw];
        let mut line = frame.to_string();
        counts.into_iter().for_each(|count| line.push_str(&format!(",{count}")));
        for time in times {
            // Writing to a String can't fail.
            let _ = write!(line, ",{:.3}", time.as_secs_f64() * 1e3);
        }
        let _ = match self.error_px {
            Some(px) => writeln!(line, ",{px:.4}"),
            None => writeln!(line, ","),
        };
        line
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
