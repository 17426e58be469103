//! Rasters out: values of squares, as ESRI's text grid or as a table.

use super::destination::Destination;
use super::number::push_f64;
use crate::formats::FormatError;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// What stands for "no value" in a grid.
const NO_DATA: f64 = -9999.0;

/// The form of a raster.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RasterFormat {
    /// ESRI's text grid of the first band: six lines that say where it is, then a line for each row, north first.
    Asc,
    /// A line for each square in which some band has a value other than 0: its centre, then the bands.
    Csv,
}

/// Values of squares: square `(i, j)` is at `j * size[0] + i`, and its low corner at `(first + (i, j)) * side`.
#[derive(Clone, Copy, Debug)]
pub struct Raster<'a> {
    /// The side of a square.
    pub side: f64,
    /// The number of the first square on each axis.
    pub first: [i64; 2],
    /// Squares on each axis.
    pub size: [usize; 2],
    /// Names and values; NaN is none.
    pub bands: &'a [(&'a str, Vec<f64>)],
}

/// Writes a raster to a file, which appears when it is complete, or with `-` to the standard output.
///
/// # Errors
///
/// As [`create`](super::create).
pub fn write_raster(path: &Path, format: RasterFormat, raster: &Raster, force: bool) -> Result<(), FormatError> {
    let (destination, file) =
        if path == Path::new("-") { Destination::standard_output()? } else { Destination::file(path, force)? };
    let mut out = BufWriter::new(file);
    let written = match format {
        RasterFormat::Asc => raster.write_asc(&mut out),
        RasterFormat::Csv => raster.write_csv(&mut out),
    };
    let file = written.and_then(|()| out.into_inner().map_err(std::io::IntoInnerError::into_error));
    let file = file.map_err(|e| destination.error("writing", e))?;
    destination.finish(file)
}

impl Raster<'_> {
    fn write_asc(&self, out: &mut BufWriter<File>) -> std::io::Result<()> {
        let [across, up] = self.size;
        let [x, y] = self.first.map(|first| first as f64 * self.side);
        writeln!(out, "ncols {across}\nnrows {up}\nxllcorner {x}\nyllcorner {y}")?;
        writeln!(out, "cellsize {}\nNODATA_value {NO_DATA}", self.side)?;
        let Some((_, values)) = self.bands.first() else { return Ok(()) };
        let mut line = Vec::new();
        for row in values.chunks(across.max(1)).rev() {
            line.clear();
            for (i, &value) in row.iter().enumerate() {
                if i > 0 {
                    line.push(b' ');
                }
                push_f64(&mut line, if value.is_nan() { NO_DATA } else { value });
            }
            line.push(b'\n');
            out.write_all(&line)?;
        }
        Ok(())
    }

    fn write_csv(&self, out: &mut BufWriter<File>) -> std::io::Result<()> {
        let mut line = b"X,Y".to_vec();
        for (name, _) in self.bands {
            line.push(b',');
            line.extend_from_slice(name.as_bytes());
        }
        line.push(b'\n');
        out.write_all(&line)?;
        let [across, up] = self.size;
        for at in 0..across * up {
            if self.bands.iter().all(|(_, values)| values[at].is_nan() || values[at] == 0.0) {
                continue;
            }
            line.clear();
            for (axis, i) in [at % across, at / across].into_iter().enumerate() {
                if axis > 0 {
                    line.push(b',');
                }
                push_f64(&mut line, ((self.first[axis] + i as i64) as f64 + 0.5) * self.side);
            }
            for (_, values) in self.bands {
                line.push(b',');
                if !values[at].is_nan() {
                    push_f64(&mut line, values[at]);
                }
            }
            line.push(b'\n');
            out.write_all(&line)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_begins_in_the_north_and_a_table_has_the_centres() {
        let folder = tempfile::tempdir().unwrap();
        let bands =
            [("Count", vec![1.0, 0.0, 2.0, 3.0, 0.0, 4.5]), ("Lowest", vec![7.0, f64::NAN, 8.0, 9.0, f64::NAN, 1.0])];
        let written = |bands: &[(&str, Vec<f64>)], format| {
            let path = folder.path().join("a");
            write_raster(&path, format, &Raster { side: 0.5, first: [-2, 10], size: [3, 2], bands }, true).unwrap();
            std::fs::read_to_string(path).unwrap()
        };
        let head = "ncols 3\nnrows 2\nxllcorner -1\nyllcorner 5\ncellsize 0.5\nNODATA_value -9999\n";
        assert_eq!(written(&bands[..1], RasterFormat::Asc), format!("{head}3 0 4.5\n1 0 2\n"));
        assert_eq!(written(&bands[1..], RasterFormat::Asc), format!("{head}9 -9999 1\n7 -9999 8\n"));
        let table = "X,Y,Count,Lowest\n-0.75,5.25,1,7\n0.25,5.25,2,8\n-0.75,5.75,3,9\n0.25,5.75,4.5,1\n";
        assert_eq!(written(&bands, RasterFormat::Csv), table);
    }
}
