//! Rows that have been looked through, as a [`PointSource`].

use super::columns::{Kinds, Role, is_rounded};
use super::survey::{Column, Place, Survey};
use super::table::{Cell, Coordinates, Table};
use crate::formats::file::SourceFile;
use crate::formats::names::{Namer, unique};
use crate::formats::{FormatError, Piece, PointSource, SourceInfo, Tally};
use crate::lattice::{Decimal, SourceGrid};
use crate::points::{Attribute, Field, FieldKind, PositionKind, RecordLayout, counted};
use std::collections::HashSet;
use std::sync::Arc;

/// Coordinates with more digits behind the point are floats: a store's quantum is not finer by itself.
const MOST_DECIMALS: u8 = 6;
/// Coordinates with fewer are taken in these steps where they fit: a site of text files is not to have a quantum of metres.
const FEWEST_DECIMALS: u8 = 3;

/// The points of one table of text.
pub struct TextSource {
    pub info: SourceInfo,
    table: Table,
}

/// What is known of rows before their columns are.
pub struct Rows {
    pub file: Arc<SourceFile>,
    pub format: &'static str,
    pub place: Place,
    pub survey: Survey,
    /// Rows that a header announces.
    pub announced: Option<u64>,
}

impl TextSource {
    /// The rows with these columns and types. `floats`: positions are not to be on a grid.
    pub fn new(rows: Rows, roles: &[Role], kinds: &Kinds, floats: bool) -> Self {
        let Rows { file, format, place, survey, announced } = rows;
        let mut warnings = Vec::new();
        let digits = if floats { None } else { Digits::of(&survey, &place) };
        let coordinates = digits.as_ref().and_then(Digits::grid).unwrap_or(Coordinates::World);
        let position = match coordinates {
            Coordinates::World => PositionKind::World,
            Coordinates::Grid { .. } => PositionKind::Grid,
        };
        let start = position.size();
        let mut end = start;
        let mut taken = HashSet::new();
        let named = roles.iter().filter_map(|role| match role {
            Role::Attribute(name) => Some(name.as_str()),
            _ => None,
        });
        let namer = Namer::of(named);
        let mut fields = Vec::new();
        let mut cells = Vec::new();
        for (i, role) in roles.iter().enumerate() {
            let cell = match (role, survey.columns.get(i)) {
                (Role::Axis(axis), _) => Cell::Axis(*axis),
                (Role::Attribute(name), Some(column)) => match kinds.attribute((name, &namer), i, column, format) {
                    Some((canonical, ty)) => {
                        let canonical = unique(canonical, name, ty, &mut taken);
                        let at = end;
                        end += ty.size();
                        if is_rounded(column, ty) {
                            let name = name.escape_default();
                            warnings.push(format!(
                                "column `{name}` has numbers of more digits than a 64-bit float keeps: they are rounded"
                            ));
                        }
                        let field = Field { offset: at - start, kind: FieldKind::Whole };
                        fields.push((Attribute::new(canonical, ty), field));
                        Cell::Value(at, ty)
                    }
                    None => {
                        warnings.extend(not_kept(&file, name, column));
                        Cell::Skip
                    }
                },
                _ => Cell::Skip,
            };
            cells.push(cell);
        }
        if survey.columns.len() > roles.len() {
            warnings.push(format!(
                "rows have {} columns, {} of them are named: the others are not kept",
                survey.columns.len(),
                roles.len()
            ));
        }
        let (most, least) = survey.words;
        if survey.rows > 0 && least < most {
            warnings.push(format!("rows have {least} to {most} columns: what is not there is NaN"));
        }
        let layout = RecordLayout::new(position, end - start, fields);
        let missing = match announced {
            Some(announced) => announced.saturating_sub(survey.rows),
            None => u64::from(survey.cut),
        };
        match announced {
            Some(n) if n > survey.rows => {
                let announced = counted(n, "point");
                warnings.push(format!("the header announces {announced}, the file holds {}", survey.rows));
            }
            Some(n) if n < survey.rows => {
                let announced = counted(n, "point");
                warnings
                    .push(format!("the header announces {announced}, there are {} rows: all are read", survey.rows));
            }
            _ => {}
        }
        if survey.cut {
            warnings.push("the file ends in the middle of a row".to_owned());
        }
        let mut info = SourceInfo::new(file.path(), format, survey.rows, missing, layout);
        info.warnings = warnings;
        if let Coordinates::Grid { decimals, center } = coordinates {
            let exponent = -i32::from(decimals);
            info.grid = Some(SourceGrid {
                scale: [Decimal::new(1, exponent); 3],
                offset: center.map(|c| Decimal::new(c, exponent)),
            });
        }
        info.step = digits.and_then(|d| d.coarser_step()).filter(|_| coordinates == Coordinates::World);
        let axis = |i: usize| survey.columns.get(place.axes[i]).map(|c| (c.min, c.max));
        if let (Some(x), Some(y), Some(z)) = (axis(0), axis(1), axis(2)) {
            let bounds = [x, y, z];
            if bounds.iter().all(|(min, max)| min.is_finite() && max.is_finite()) {
                info.bounds_hint = Some((bounds.map(|b| b.0), bounds.map(|b| b.1)));
            }
        }
        let stride = info.layout.stride();
        let table = Table { file, place, chunks: survey.chunks, cells, coordinates, stride };
        Self { info, table }
    }
}

fn not_kept(file: &SourceFile, name: &str, column: &Column) -> Option<String> {
    let shown = |text: &str| text.escape_default().to_string();
    match &column.text {
        Some((at, word)) => {
            let place = file.line_at(*at).map_or_else(|_| String::new(), |line| format!(" in line {line}"));
            Some(format!("column `{}` is not kept: it holds words (`{}`{place})", shown(name), shown(word)))
        }
        None if column.absent > 0 => Some(format!("column `{}` is not kept: it holds no number", shown(name))),
        None => None,
    }
}

/// Coordinates that are all decimals of few digits behind the point.
struct Digits<'a> {
    axes: [&'a Column; 3],
    /// The most that one of them has.
    needed: u8,
}

impl<'a> Digits<'a> {
    fn of(survey: &'a Survey, place: &Place) -> Option<Self> {
        if survey.nothing > 0 || survey.rows == 0 {
            return None;
        }
        let axes = place.axes.map(|i| survey.columns.get(i));
        let axes = [axes[0]?, axes[1]?, axes[2]?];
        let needed = axes.iter().map(|c| c.decimals).max()?;
        let few = needed <= MOST_DECIMALS && axes.iter().all(|c| c.decimal && c.absent == 0);
        few.then_some(Self { axes, needed })
    }

    /// The grid on which all of them lie.
    fn grid(&self) -> Option<Coordinates> {
        let all = [self.needed.max(FEWEST_DECIMALS), self.needed];
        all.into_iter().find_map(|decimals| Some(Coordinates::Grid { decimals, center: self.center(decimals)? }))
    }

    /// Where 32 bits do not hold all digits, the finest step that they hold: so a store is not finer than what LAS can
    /// take out of it, nor coarser than that asks for.
    fn coarser_step(&self) -> Option<Decimal> {
        let fits = |decimals: &u8| self.center(*decimals).is_some();
        let decimals = (FEWEST_DECIMALS..self.needed).rev().find(fits)?;
        Some(Decimal::new(1, -i32::from(decimals)))
    }

    /// A place in the middle from which 32 bits of steps of so many decimals reach all of them, in such steps.
    fn center(&self, decimals: u8) -> Option<[i128; 3]> {
        let unit = 10_f64.powi(decimals.into());
        let mut center = [0; 3];
        for (center, column) in center.iter_mut().zip(self.axes) {
            // A whole number of units in the middle.
            let middle = (column.min / 2.0 + column.max / 2.0).round();
            let reach = (column.max - middle).max(middle - column.min) * unit;
            if !(reach < f64::from(i32::MAX) - 16.0 && middle.abs() < 1e15) {
                return None;
            }
            *center = middle as i128 * 10_i128.pow(decimals.into());
        }
        Some(center)
    }
}

impl PointSource for TextSource {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn warn(&mut self, warning: String) {
        self.info.warnings.push(warning);
    }

    fn pieces(&self, target_records: u64) -> Vec<Piece> {
        self.table.pieces(target_records)
    }

    fn read(&self, piece: Piece, sink: &mut dyn FnMut(&[u8]) -> bool) -> Result<Tally, FormatError> {
        let first = piece.first.min(self.info.records);
        let records = piece.records.min(self.info.records - first);
        if records == 0 {
            return Ok(Tally::default());
        }
        self.table.read(Piece { first, records }, sink)
    }
}
