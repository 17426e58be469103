//! `--split-by`: one pass over the answer, a file per scan or per class.

use super::{Arguments, SplitBy, output_of};
use crate::cli::output;
use crate::cli::output_plan::deepen;
use crate::formats::{OutputFormat, PointWriter};
use crate::points::{Batch, Column};
use crate::query::{Answer, Query};
use crate::store::Snapshot;
use anyhow::{Context, bail};
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Open files at a time; more classes than there can be.
const MOST_FILES: usize = 1024;

/// A file that is being written.
struct Part {
    path: PathBuf,
    writer: Box<dyn PointWriter>,
    points: u64,
    /// Which columns of the answer it has.
    columns: Vec<usize>,
    output: super::Output,
}

/// Writes the answer to files named after `path`; gives their names and counts, and the whole answer.
pub(super) fn split(
    arguments: &Arguments,
    snapshot: &Snapshot,
    query: &Query,
    path: &Path,
    format: OutputFormat,
    by: SplitBy,
) -> anyhow::Result<(Vec<(PathBuf, u64)>, Answer)> {
    let form = query.output_form(snapshot)?;
    let class = form.attributes.iter().position(|a| a.name == "Classification");
    if by == SplitBy::Class && class.is_none() {
        bail!("the points have no Classification to split by");
    }
    let mut parts: BTreeMap<u64, Part> = BTreeMap::new();
    let mut failure = None;
    let whole = query.clone().with_scans(true);
    let answer = whole.run(snapshot, |batch| {
        let keys: Vec<u64> = match (by, class.map(|c| &batch.columns[c])) {
            (SplitBy::Class, Some(column)) => (0..batch.len()).map(|i| column.as_f64(i) as u64).collect(),
            _ => batch.scans.iter().map(|&s| s.into()).collect(),
        };
        let mut indices: BTreeMap<u64, Vec<u32>> = BTreeMap::new();
        keys.iter().enumerate().for_each(|(i, &key)| indices.entry(key).or_default().push(i as u32));
        for (key, indices) in indices {
            let written = part(arguments, snapshot, query, path, format, by, key, &mut parts)
                .and_then(|part| part.write(&batch.gathered(&indices)));
            if let Err(error) = written {
                failure = Some(error);
                return ControlFlow::Break(());
            }
        }
        ControlFlow::Continue(())
    })?;
    if let Some(error) = failure {
        return Err(error);
    }
    let mut files = Vec::new();
    for (_, Part { path, writer, points, .. }) in parts {
        for note in writer.finish()? {
            eprintln!("esker: {}", output::clean(&note));
        }
        files.push((path, points));
    }
    Ok((files, answer))
}

/// The file of a key, begun if it is not there.
#[allow(clippy::too_many_arguments)]
fn part<'p>(
    arguments: &Arguments,
    snapshot: &Snapshot,
    query: &Query,
    path: &Path,
    format: OutputFormat,
    by: SplitBy,
    key: u64,
    parts: &'p mut BTreeMap<u64, Part>,
) -> anyhow::Result<&'p mut Part> {
    if !parts.contains_key(&key) {
        if parts.len() >= MOST_FILES {
            bail!("--split-by would write more than {MOST_FILES} files");
        }
        let (name, one) = match by {
            SplitBy::Class => (format!("class{key}"), query.clone()),
            SplitBy::Scan => {
                let id = u32::try_from(key).ok().and_then(|id| snapshot.scan(id)).context("a point of no scan")?;
                let fit = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
                (id.name.chars().map(fit).collect(), query.clone().scans([id.id.to_string()]))
            }
        };
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let ending = path.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
        let mut file = path.with_file_name(format!("{stem}_{name}{ending}"));
        // Names that differ only in what a file name cannot have.
        if parts.values().any(|p| p.path == file) {
            file = path.with_file_name(format!("{stem}_{name}_{key}{ending}"));
        }
        let (output, writer) = output_of(arguments, snapshot, &one, &file, format)?;
        let all = query.output_form(snapshot)?.attributes;
        let columns = output.attributes.iter().filter_map(|a| all.iter().position(|b| a.identity() == b.identity()));
        let columns = columns.collect();
        parts.insert(key, Part { path: file, writer, points: 0, columns, output });
    }
    parts.get_mut(&key).context("a file that was just begun")
}

impl Part {
    fn write(&mut self, batch: &Batch) -> anyhow::Result<()> {
        let columns: Vec<Column> = self.columns.iter().map(|&c| batch.columns[c].clone()).collect();
        let mut own = Batch {
            attributes: self.output.attributes.clone(),
            positions: batch.positions.clone(),
            scans: batch.scans.clone(),
            columns,
        };
        deepen(&mut own, &self.output.planned);
        if let Some(frame) = &self.output.frame {
            frame.apply(&mut own)?;
        }
        self.points += own.len() as u64;
        Ok(self.writer.write(&own)?)
    }
}
