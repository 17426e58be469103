//! Text files opened: where the rows are, what the columns are called.

use super::columns::{Kinds, Role, are_degrees, axes, guess, named, roles, twice};
use super::lines::Lines;
use super::number::parse;
use super::sections::{Section, pts, ptx};
use super::shape::{HEAD_BYTES, is_count, names, row, row_at};
use super::source::{Rows, TextSource};
use super::survey::{Column, Place, first_row, survey};
use super::words::{Separator, is_comment};
use crate::formats::file::SourceFile;
use crate::formats::las::quoted;
use crate::formats::{FormatError, PointSource};
use std::collections::HashMap;
use std::sync::Arc;

type Sources = Result<Vec<Box<dyn PointSource>>, FormatError>;

/// Opens rows with or without a line of names; `columns` are the user's names.
///
/// # Errors
///
/// [`FormatError::Malformed`] for a row without coordinates, or names without x, y and z; [`FormatError::Unsupported`] for
/// texts in UTF-16 or with lone carriage returns.
pub fn open_rows(file: SourceFile, columns: Option<&[String]>) -> Sources {
    let file = Arc::new(file);
    let start = text_start(&file)?;
    let mut lines = Lines::new(&file, start, file.bytes());
    let mut header: Option<Vec<String>> = None;
    let mut begin = start;
    let (mut separator, mut comma) = (Separator::Blank, false);
    let mut announced = None;
    while let Some(line) = lines.next()? {
        let (bytes, offset) = (line.bytes, line.offset);
        if bytes.trim_ascii().is_empty() {
            continue;
        }
        let own = names(bytes).filter(|n| axes(&roles(n)).is_some());
        if is_comment(bytes) {
            // The last remark that names x, y and z is the header.
            header = own.or(header);
            continue;
        }
        // Where names say what is what, coordinates need not come first.
        let place = columns.or(header.as_deref()).and_then(|names| axes(&roles(names)));
        let numbers = place.map_or_else(|| row(bytes), |place| row_at(bytes, place));
        if let Some((found, decimal)) = numbers {
            (separator, comma, begin) = (found, decimal, offset);
            break;
        }
        // Below the names there may be how many rows there are.
        if (header.is_some() || columns.is_some()) && announced.is_none() && is_count(bytes) {
            announced = parse(bytes.trim_ascii(), false).map(|n| n.value as u64);
            begin = lines.offset();
            continue;
        }
        let named_axes = own.is_some() || columns.is_some();
        if header.is_some() && own.is_none() || !named_axes {
            let shown = quoted(&bytes.trim_ascii()[..bytes.trim_ascii().len().min(60)]);
            let expected = match names(bytes).and_then(|names| twice(&roles(&names))) {
                Some((a, b, axis)) => format!(
                    "names of which one is {axis}: columns {a} and {b} both are (--columns names them otherwise, `-` leaves one out)"
                ),
                None => "a row of numbers, or a line that names x, y and z (--columns names them otherwise)".to_owned(),
            };
            return Err(file.malformed_line(offset, expected, shown));
        }
        header = own.or_else(|| names(bytes)).or(Some(Vec::new()));
        begin = lines.offset();
    }
    let mut options = String::new();
    let chosen: Option<Vec<Role>> = match (columns, &header) {
        (Some(columns), _) => {
            options = format!("columns {}", columns.join(","));
            Some(roles(columns))
        }
        (None, Some(header)) => Some(roles(header)),
        (None, None) => None,
    };
    let place = Place {
        start: begin,
        end: file.bytes(),
        separator,
        comma,
        axes: chosen.as_deref().and_then(axes).unwrap_or([0, 1, 2]),
        zero_is_nothing: false,
    };
    let survey = survey(&file, &place)?;
    let roles = chosen.clone().unwrap_or_else(|| guess(&survey.columns));
    let guessed = (chosen.is_none() && roles.len() > 3).then(|| understood(&roles));
    let named = chosen.as_ref().map_or(0, Vec::len);
    let lacking = (survey.rows > 0 && named > survey.columns.len()).then(|| {
        format!(
            "{named} columns are named, rows have {}: names with blanks in them? --columns names them",
            survey.columns.len()
        )
    });
    let commas = (comma && separator != Separator::Byte(b';')).then(|| "commas are taken as decimal points".to_owned());
    // Whatever a column of metres is called.
    let is_small =
        |axis: usize| survey.columns.get(place.axes[axis]).is_some_and(|c| c.min >= -360.0 && c.max <= 360.0);
    let degrees = is_small(0) && is_small(1) && columns.or(header.as_deref()).is_some_and(are_degrees);
    let kinds = Kinds::of(&roles, [survey.columns.as_slice()]);
    let rows = Rows { file, format: "text", place, survey, announced };
    let mut source = TextSource::new(rows, &roles, &kinds, false);
    source.info.options = options;
    source.info.degrees = degrees;
    source.info.warnings.extend([guessed, lacking, commas].into_iter().flatten());
    Ok(vec![Box::new(source)])
}

/// Opens a PTS file: every block is a source.
///
/// # Errors
///
/// As [`open_rows`].
pub fn open_pts(file: SourceFile, columns: Option<&[String]>) -> Sources {
    let file = Arc::new(file);
    let sections = pts(&file, text_start(&file)?)?;
    blocks(&file, "pts", &sections, columns)
}

/// Opens a PTX file: every block is a source, with the pose that its transform says.
///
/// # Errors
///
/// As [`open_rows`]; [`FormatError::Malformed`] for a block's header that is cut or has no transform.
pub fn open_ptx(file: SourceFile, columns: Option<&[String]>) -> Sources {
    let file = Arc::new(file);
    let sections = ptx(&file, text_start(&file)?)?;
    if sections.is_empty() {
        return Err(file.malformed_line(0, "a block of points", "none"));
    }
    blocks(&file, "ptx", &sections, columns)
}

fn blocks(file: &Arc<SourceFile>, format: &'static str, sections: &[Section], columns: Option<&[String]>) -> Sources {
    let chosen = columns.map(roles);
    let mut looked = Vec::with_capacity(sections.len());
    for section in sections {
        let place = Place {
            start: section.start,
            end: section.end,
            separator: first_row(file, section.start, section.end)?.unwrap_or(Separator::Blank),
            comma: false,
            axes: chosen.as_deref().and_then(axes).unwrap_or([0, 1, 2]),
            zero_is_nothing: format == "ptx",
        };
        looked.push((section, place, survey(file, &place)?));
    }
    let mut sources: Vec<Box<dyn PointSource>> = Vec::new();
    // Blocks with as many columns have the same types.
    let all: Vec<Vec<Column>> = looked.iter().map(|(_, _, survey)| survey.columns.clone()).collect();
    let mut known = HashMap::new();
    for (index, (section, place, survey)) in (0..).zip(looked) {
        let (kinds, roles) = known.entry(survey.columns.len()).or_insert_with_key(|&width| {
            let roles = chosen.clone().unwrap_or_else(|| block_columns(width));
            let alike = all.iter().map(Vec::as_slice).filter(|columns| columns.len() == width);
            (Kinds::of(&roles, alike), roles)
        });
        let nothing = survey.nothing;
        let rows = Rows { file: file.clone(), format, place, survey, announced: section.announced };
        let mut source = TextSource::new(rows, roles, kinds, !section.pose.is_identity());
        source.info.index = index;
        source.info.pose = section.pose;
        if let Some(columns) = columns {
            source.info.options = format!("columns {}", columns.join(","));
        }
        if nothing > 0 {
            source.info.warnings.push(format!("rows of zeros, where nothing came back: {nothing}"));
        }
        if let Err(error) = section.pose.rigid_scale() {
            source.info.warnings.push(format!("the transform of block {} is applied as it stands: {error}", index + 1));
        }
        sources.push(Box::new(source));
    }
    Ok(sources)
}

/// The columns of a row of a block: x, y, z, then intensity or a colour or both.
fn block_columns(columns: usize) -> Vec<Role> {
    let rest: &[&str] = match columns {
        4 => &["Intensity"],
        6 => &["Red", "Green", "Blue"],
        7 => &["Intensity", "Red", "Green", "Blue"],
        _ => &[],
    };
    named(columns, rest)
}

fn understood(roles: &[Role]) -> String {
    let name = |role: &Role| match role {
        Role::Axis(axis) => ["x", "y", "z"][*axis].to_owned(),
        Role::Attribute(name) => name.clone(),
        Role::Skip => "-".to_owned(),
    };
    let names: Vec<_> = roles.iter().map(name).collect();
    format!("the columns have no names and are taken as {}; --columns names them otherwise", names.join(","))
}

/// Where the text begins: behind a byte order mark.
fn text_start(file: &SourceFile) -> Result<u64, FormatError> {
    let head = file.read_vec(0, HEAD_BYTES)?;
    if head.starts_with(b"\xff\xfe") || head.starts_with(b"\xfe\xff") {
        return Err(file.unsupported("text in UTF-16", "write it as UTF-8"));
    }
    let lone = head.iter().zip(head.iter().skip(1)).any(|(a, b)| *a == b'\r' && *b != b'\n');
    if lone {
        return Err(file.unsupported("text whose lines end in a carriage return alone", "end them with a line feed"));
    }
    Ok(if head.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 })
}
