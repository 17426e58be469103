//! `esker nearest`: the neighbours of points.

use super::query::{Format, format};
use super::which::{Which, tell_why_nothing, with_attributes};
use super::{Outcome, Usage, output, values};
use crate::export::{Order, plan};
use crate::formats::{CreateOptions, OutputFormat, create, create_standard_output};
use crate::points::{Attribute, Column, ScalarType};
use crate::query::Neighbors;
use crate::store::{Limits, Store};
use anyhow::{Context, bail};
use clap::Args;
use std::path::{Path, PathBuf};

/// Finds the points that are nearest to some places: exactly, without reading more than their surroundings.
///
/// One line for each neighbour: its coordinates, the number of the place (Place, from 0), how far it is from it (Distance,
/// in CRS units), and its attributes. Neighbours of one place come nearest first.
#[derive(Debug, Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:\n  esker nearest site.esker --at 500010,5000020,130 -k 8\n  \
                  esker nearest site.esker --places targets.csv --radius 0.5 -o around.csv\n  \
                  esker nearest site.esker --at 500010,5000020,130 --where 'Classification = 2' --attributes none"
)]
pub(super) struct Arguments {
    /// The store.
    store: PathBuf,
    /// X,Y,Z of a place; may be given several times.
    #[arg(
        long,
        value_name = "X,Y,Z",
        allow_hyphen_values = true,
        required_unless_present = "places",
        value_parser = typed_place
    )]
    at: Vec<[f64; 3]>,
    /// A text file of places: X, Y and Z in each line, separated by semicolons (commas are then decimal), commas or blanks;
    /// what follows them is ignored, as are lines that begin with #. Where a first line names X, Y and Z, these columns
    /// are taken; other names are ignored. `-` is stdin.
    #[arg(long, value_name = "FILE", conflicts_with = "at")]
    places: Option<PathBuf>,
    /// How many neighbours each place gets at most.
    #[arg(short, long = "count", value_name = "N", default_value = "1", value_parser = values::positive_count)]
    k: u64,
    /// Only neighbours at most this far away, in CRS units.
    #[arg(long, value_name = "R", value_parser = values::not_negative)]
    radius: Option<f64>,
    #[command(flatten)]
    which: Which,
    /// Only these attributes, separated by commas; `none` for positions alone.
    #[arg(long, value_name = "A,B", value_delimiter = ',')]
    attributes: Vec<String>,
    /// Where to: a file ending in .csv, .xyz, .ply, .npy or .npz, or - for stdout.
    #[arg(short, long, value_name = "FILE", default_value = "-")]
    output: PathBuf,
    /// The form of the output, if its name doesn't say; CSV on stdout.
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Replace an existing file.
    #[arg(long)]
    force: bool,
    /// What it cost as one JSON object: on stdout, or on stderr where the neighbours go to stdout.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let to_stdout = arguments.output == Path::new("-");
    let form = match arguments.format {
        None if to_stdout => OutputFormat::Csv,
        given => format(&arguments.output, given)?,
    };
    if matches!(form, OutputFormat::Las | OutputFormat::Laz) {
        let form = "LAS files have no place for Place and Distance; write .csv, .xyz, .ply, .npy or .npz";
        return Err(Usage(form.into()).into());
    }
    let places = places(arguments)?;
    let store = Store::open_with(&arguments.store, Limits::default())?;
    let snapshot = store.snapshot()?;
    let region = arguments.which.region(&snapshot)?;
    let query = with_attributes(arguments.which.query(region.clone(), &snapshot)?, &arguments.attributes);
    let k = usize::try_from(arguments.k).unwrap_or(usize::MAX);
    let mut planned = plan(&snapshot, &query.output_form(&snapshot)?, form, false, None)?;
    let query = query.with_scans(planned.meeting.needs_scans());
    let order = Order::of(&query, &snapshot, &planned.plan.attributes, form);
    let (query, watching) = arguments.which.watched(query, false);
    let found = query.nearest(&snapshot, &places, k, arguments.radius)?;
    drop(watching);
    if found.batch.is_empty() {
        tell_why_nothing(&snapshot, &region, &arguments.which.scans)?;
    }
    let statistics = serde_json::to_value(&found.statistics)?;
    let Neighbors { mut batch, distances, ends, .. } = found;
    planned.meeting.apply(&mut batch);
    order.apply(&mut batch);
    let mut of_place = Vec::with_capacity(batch.len());
    for (place, &end) in ends.iter().enumerate() {
        of_place.resize(end, place as u64);
    }
    let own = [("Place", ScalarType::U64), ("Distance", ScalarType::F64)].map(|(name, ty)| Attribute::new(name, ty));
    batch.attributes = own.into_iter().chain(batch.attributes.iter().cloned()).collect();
    batch.columns.splice(0..0, [Column::U64(of_place), Column::F64(distances)]);
    planned.plan.attributes = batch.attributes.clone();
    let options = CreateOptions { force: arguments.force, ..CreateOptions::default() };
    let mut writer = if to_stdout {
        create_standard_output(form, &planned.plan, &options)?
    } else {
        create(&arguments.output, form, &planned.plan, &options)?
    };
    writer.write(&batch)?;
    for note in planned.notes.into_iter().chain(writer.finish()?) {
        output::tell!("esker: {}", output::clean(&note));
    }
    let report = serde_json::json!({ "places": places.len(), "neighbours": batch.len(), "statistics": statistics });
    match (arguments.json, to_stdout) {
        (true, true) => output::tell!("{report}"),
        (true, false) => output::json(&report)?,
        (false, false) => output::line(format_args!(
            "{}: {} of {}",
            arguments.output.display(),
            output::counted(batch.len() as u64, "neighbour"),
            output::counted(places.len() as u64, "place")
        ))?,
        (false, true) => {}
    }
    Ok(Outcome::Done)
}

/// The places, as they were given.
fn places(arguments: &Arguments) -> anyhow::Result<Vec<[f64; 3]>> {
    let Some(path) = &arguments.places else {
        return Ok(arguments.at.clone());
    };
    let text = if path == Path::new("-") {
        std::io::read_to_string(std::io::stdin()).context("reading the places from stdin failed")?
    } else {
        std::fs::read_to_string(path).with_context(|| format!("{}: reading the places failed", path.display()))?
    };
    read_places(&text).with_context(|| path.display().to_string())
}

/// Where X, Y and Z are in a line.
type Columns = [usize; 3];

fn read_places(text: &str) -> anyhow::Result<Vec<[f64; 3]>> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut columns = [0, 1, 2];
    let mut places = Vec::new();
    let lines =
        (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty() && !line.trim_start().starts_with('#'));
    for (i, (number, line)) in lines.enumerate() {
        if i == 0
            && let Some(named) = heading(line)
        {
            columns = named;
            continue;
        }
        places.push(place_in(line, columns).with_context(|| format!("line {number}"))?);
    }
    if places.is_empty() {
        bail!("there are no places in it");
    }
    Ok(places)
}

/// The columns that a line of names tells; `None` if it is no such line, since one of its first words begins as numbers do.
fn heading(line: &str) -> Option<Columns> {
    let words = words(line);
    let numeric = |word: &&str| {
        let digits = word.trim_start_matches(['+', '-', '.', '"']);
        digits.starts_with(|c: char| c.is_ascii_digit()) || word.parse::<f64>().is_ok()
    };
    if words.iter().take(3).any(numeric) || !line.chars().any(char::is_alphabetic) {
        return None;
    }
    let named = |name: &str| words.iter().position(|word| word.trim_matches('"').trim().eq_ignore_ascii_case(name));
    let columns = named("x").zip(named("y")).zip(named("z")).map(|((x, y), z)| [x, y, z]);
    Some(columns.unwrap_or([0, 1, 2]))
}

/// What the semicolons of a line separate; without any what the commas do, and without these what blanks do.
fn words(line: &str) -> Vec<&str> {
    match [';', ','].into_iter().find(|&separator| line.contains(separator)) {
        Some(separator) => line.split(separator).map(str::trim).collect(),
        None => line.split_whitespace().collect(),
    }
}

/// How places are written.
const HOW: &str = "all separated by commas, or by blanks, or by semicolons (commas are then decimal)";

/// A place as an option has it.
fn typed_place(text: &str) -> Result<[f64; 3], String> {
    place(text).map_err(|e| output::one_line(&e))
}

/// The first three numbers of a line.
fn place(text: &str) -> anyhow::Result<[f64; 3]> {
    place_in(text, [0, 1, 2])
}

fn place_in(line: &str, columns: Columns) -> anyhow::Result<[f64; 3]> {
    let words = words(line);
    let mut place = [0.0; 3];
    for (value, column) in place.iter_mut().zip(columns) {
        let word = *words.get(column).with_context(|| format!("X, Y and Z are wanted, {HOW}"))?;
        // Between semicolons.
        let decimal = word.replace(',', ".");
        let number = decimal.parse().ok().filter(|v: &f64| v.is_finite());
        *value = number.with_context(|| match word.contains(char::is_whitespace) {
            true => format!("'{word}' is no number; X, Y and Z are wanted, {HOW}"),
            false => format!("'{word}' is no number"),
        })?;
    }
    Ok(place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_read_as_programs_write_them() {
        let read = |text: &str| read_places(text).map_err(|e| output::one_line(&e));
        let expected = Ok(vec![[1.0, -2.5, 3e2], [4.0, 5.0, 6.0]]);
        assert_eq!(read("X,Y,Z,Class\n1,-2.5,3e2,7\n\n# no place\n4,5,6,8\n"), expected);
        assert_eq!(read("1 -2.5 3e2\n4\t5\t6"), expected);
        assert_eq!(read("1; -2.5; 3e2\r\n4; 5; 6\r\n"), expected);
        assert_eq!(read("1,2,3\n1,2\n"), Err(format!("line 2: X, Y and Z are wanted, {HOW}")));
        assert_eq!(read("1,2,3\n1,2,nan\n"), Err("line 2: 'nan' is no number".into()));
        assert_eq!(read("x y z\n"), Err("there are no places in it".into()));
    }

    /// `1,2,3O` was taken for names.
    #[test]
    fn a_first_line_with_a_number_is_no_heading() {
        let read = |text: &str| read_places(text).map_err(|e| output::one_line(&e));
        for (first, word) in
            [("1,2,3O", "3O"), ("one,2,3", "one"), ("1,2,nan", "nan"), ("nan nan nan", "nan"), ("1O;2O;3O", "1O")]
        {
            assert_eq!(read(&format!("{first}\n4,5,6\n")), Err(format!("line 1: '{word}' is no number")));
        }
        assert_eq!(read("\u{feff}1,2,3\n4,5,6\n"), Ok(vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
    }

    #[test]
    fn columns_that_are_named_are_taken() {
        let read = |text: &str| read_places(text).map_err(|e| output::one_line(&e));
        assert_eq!(read("id,x,y,z\n7,1,2,3\ntree 8,4,5,6\n"), Ok(vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]));
        assert_eq!(read("\u{feff}\"Z\"; X; Y\n3;1;2\n"), Ok(vec![[1.0, 2.0, 3.0]]));
        assert_eq!(read("id x y z\n7\t1 2 3\n"), Ok(vec![[1.0, 2.0, 3.0]]));
        assert_eq!(read("easting,northing,height\n1,2,3\n"), Ok(vec![[1.0, 2.0, 3.0]]));
        assert_eq!(read("id,x,y,z\n7,1,2\n"), Err(format!("line 2: X, Y and Z are wanted, {HOW}")));
    }

    #[test]
    fn separators_that_are_mixed_are_told_with_what_is_accepted() {
        let read = |text: &str| read_places(text).map_err(|e| output::one_line(&e));
        for (line, word) in [("1,2 3", "2 3"), ("1,2,3 note", "3 note")] {
            let told = read(&format!("7,8,9\n{line}\n")).unwrap_err();
            assert_eq!(told, format!("line 2: '{word}' is no number; X, Y and Z are wanted, {HOW}"));
        }
    }

    /// `1,5;2,5;3,5` was read as 1, 5, 2.
    #[test]
    fn decimal_commas_are_read_or_refused() {
        let read = |text: &str| read_places(text).map_err(|e| output::one_line(&e));
        assert_eq!(read("1,5;-2,5; 3,5;a, b\n"), Ok(vec![[1.5, -2.5, 3.5]]));
        for line in ["1,5 2,5 3,5", "1,5\t2,5\t3,5", "1 2,5 3,5", "1 2 3,5", "1,5 2 3"] {
            assert!(read(line).is_err_and(|e| e.contains("semicolons")), "{line}");
        }
        assert!(read("1,,2,3").is_err() && read("1,2;3").is_err());
    }
}
