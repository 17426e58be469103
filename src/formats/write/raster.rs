//! Rasters out: values of squares, as ESRI's text grid or as a table.

use super::destination::Destination;
use super::number::push_f64;
use crate::formats::FormatError;
use crate::lattice::Decimal;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// What stands for "no value" in a grid: the first of -9999, -99999 and so on that is no value there.
fn no_data(values: &[f64]) -> f64 {
    let mut no_data = -9999.0;
    while values.contains(&no_data) {
        no_data = no_data * 10.0 - 9.0;
    }
    no_data
}

/// The form of a raster.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum RasterFormat {
    /// ESRI's text grid of the first band: six lines that say where it is, then a line for each row, north first.
    Asc,
    /// A line for each square that has values: its centre, then the bands.
    Csv,
}

/// Values of some squares of a grid: square `(i, j)` is at `j * size[0] + i`, and its low corner at `(first + (i, j)) * side`,
/// the side being the decimal that it is written as.
#[derive(Clone, Copy, Debug)]
pub struct Raster<'a> {
    /// The side of a square.
    pub side: f64,
    /// The number of the first square on each axis.
    pub first: [i64; 2],
    /// Squares on each axis.
    pub size: [usize; 2],
    /// Where the squares are that have values, ascending.
    pub places: &'a [usize],
    /// Names, and the values of these squares; NaN is none.
    pub bands: &'a [(&'a str, Vec<f64>)],
    /// What a grid says of all others; NaN is none.
    pub empty: f64,
    /// The WKT of the coordinates' CRS.
    pub wkt: Option<&'a str>,
}

/// Writes a raster to a file, which appears when it is complete, or with `-` to the standard output. A grid has its CRS in a
/// file beside it, which ends in `.prj`; without a CRS one that is there is removed, if it may be replaced.
///
/// # Errors
///
/// As [`create`](super::create).
pub fn write_raster(path: &Path, format: RasterFormat, raster: &Raster, force: bool) -> Result<(), FormatError> {
    let (destination, file) =
        if path == Path::new("-") { Destination::standard_output()? } else { Destination::file(path, force)? };
    // Without a CRS there must be no such file either, which would say another one.
    let is_grid = format == RasterFormat::Asc && path != Path::new("-");
    let beside = path.with_extension("prj");
    let needs_place = is_grid && (raster.wkt.is_some() || beside.exists());
    let crs = needs_place.then(|| Destination::file(&beside, force)).transpose()?;
    let mut out = BufWriter::new(file);
    let written = match format {
        RasterFormat::Asc => raster.write_asc(&mut out),
        RasterFormat::Csv => raster.write_csv(&mut out),
    };
    let file = written.and_then(|()| out.into_inner().map_err(std::io::IntoInnerError::into_error));
    let file = file.map_err(|e| destination.error("writing", e))?;
    match (crs, raster.wkt) {
        (Some((place, mut file)), Some(wkt)) => {
            writeln!(file, "{wkt}").map_err(|e| place.error("writing", e))?;
            place.finish(file)?;
        }
        (Some((place, _)), None) => {
            std::fs::remove_file(&beside).map_err(|e| place.error("removing", e))?;
        }
        (None, _) => {}
    }
    destination.finish(file)
}

impl Raster<'_> {
    /// The nearest `f64` to so many halves of a side.
    fn at(&self, halves: i128) -> f64 {
        let exact = Decimal::from_f64(self.side).and_then(|side| {
            let fives = halves.checked_mul(5)?.checked_mul(side.mantissa())?;
            Some(Decimal::new(fives, side.exponent() - 1))
        });
        exact.map_or(halves as f64 / 2.0 * self.side, Decimal::to_f64)
    }

    /// The centre of the square at `i` on an axis.
    fn centre(&self, axis: usize, i: usize) -> f64 {
        self.at(2 * (i128::from(self.first[axis]) + i as i128) + 1)
    }

    fn write_asc(&self, out: &mut BufWriter<File>) -> std::io::Result<()> {
        let [across, up] = self.size;
        let [x, y] = self.first.map(|first| self.at(2 * i128::from(first)));
        writeln!(out, "ncols {across}\nnrows {up}\nxllcorner {x}\nyllcorner {y}")?;
        let values = self.bands.first().map_or(&[][..], |(_, values)| values);
        let no_data = no_data(values);
        let push = |line: &mut Vec<u8>, value: f64| push_f64(line, if value.is_nan() { no_data } else { value });
        writeln!(out, "cellsize {}\nNODATA_value {no_data}", self.side)?;
        let mut line = Vec::new();
        let mut rest = self.places;
        for row in (0..up).rev() {
            line.clear();
            let before = rest.partition_point(|&place| place < row * across);
            let mut full = rest[before..].iter().zip(values.get(before..).unwrap_or(&[])).peekable();
            rest = &rest[..before];
            for i in 0..across {
                if i > 0 {
                    line.push(b' ');
                }
                let here = full.next_if(|(place, _)| **place == row * across + i);
                push(&mut line, here.map_or(self.empty, |(_, value)| *value));
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
        let across = self.size[0].max(1);
        for (n, place) in self.places.iter().enumerate() {
            line.clear();
            push_f64(&mut line, self.centre(0, place % across));
            line.push(b',');
            push_f64(&mut line, self.centre(1, place / across));
            for (_, values) in self.bands {
                line.push(b',');
                if let Some(&value) = values.get(n).filter(|value| !value.is_nan()) {
                    push_f64(&mut line, value);
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
        let bands = [("Count", vec![1.0, 2.0, 3.0, 4.5]), ("Lowest", vec![7.0, 8.0, 9.0, 1.0])];
        let written = |places: &[usize], bands: &[(&str, Vec<f64>)], empty, format| {
            let path = folder.path().join("a");
            let raster = Raster { side: 0.5, first: [-2, 10], size: [3, 2], places, bands, empty, wkt: None };
            write_raster(&path, format, &raster, true).unwrap();
            std::fs::read_to_string(path).unwrap()
        };
        let head = "ncols 3\nnrows 2\nxllcorner -1\nyllcorner 5\ncellsize 0.5\nNODATA_value -9999\n";
        let (places, asc) = ([0, 2, 3, 5], RasterFormat::Asc);
        assert_eq!(written(&places, &bands[..1], 0.0, asc), format!("{head}3 0 4.5\n1 0 2\n"));
        assert_eq!(written(&places, &bands[1..], f64::NAN, asc), format!("{head}9 -9999 1\n7 -9999 8\n"));
        assert_eq!(written(&[1], &bands[1..], 0.0, asc), format!("{head}0 0 0\n0 7 0\n"));
        let odd = [("Lowest", vec![-9999.0, f64::NAN, -99_999.0, 9.0, 2.0, 1.0])];
        let head = head.replace("-9999\n", "-999999\n");
        let all = [0, 1, 2, 3, 4, 5];
        assert_eq!(written(&all, &odd, 0.0, asc), format!("{head}9 2 1\n-9999 -999999 -99999\n"));
        let table = "X,Y,Count,Lowest\n-0.75,5.25,1,7\n0.25,5.25,2,8\n-0.75,5.75,3,9\n0.25,5.75,4.5,1\n";
        assert_eq!(written(&places, &bands, 0.0, RasterFormat::Csv), table);
    }

    /// Products of floats gave 770519.3999999999.
    #[test]
    fn edges_and_centres_are_the_nearest_floats_to_multiples_of_the_side() {
        let raster = |side, first| {
            let first = [first; 2];
            Raster { side, first, size: [1; 2], places: &[], bands: &[], empty: 0.0, wkt: None }
        };
        for n in (-5000..5000).chain(7_705_000..7_706_000) {
            let text = |tenths: i64| format!("{tenths}e-2").parse::<f64>().unwrap();
            assert_eq!(raster(0.1, n).at(2 * i128::from(n)), text(10 * n));
            assert_eq!(raster(0.1, n).centre(0, 0), text(10 * n + 5));
            assert_eq!(raster(1.1, n).centre(1, 3), text(110 * (n + 3) + 55));
        }
        assert_eq!(raster(0.7, 0).at(2 * 1_100_742), 770_519.4);
    }
}
