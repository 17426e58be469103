//! Points of an answer on their way to numpy: decoded batches, copied once, on all threads, into the arrays asked for.

use crate::options::Give;
use crate::waiting::check_process;
use esker::export::Meeting;
use esker::lattice::{BIAS, Lattice};
use esker::points::{Attribute, Batch, Column, Real, ScalarType};
use esker::query::{Query, QueryError};
use esker::store::Snapshot;
use esker::store::model::ScanId;
use esker::with_column;
use numpy::{IntoPyArray, PyArray1, PyReadwriteArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Points whose records are filled field by field before those of the next ones: they stay in a core's cache meanwhile.
const TILE: usize = 1024;

/// What each point of an answer has, and how it is given.
pub struct Form {
    lattice: Lattice,
    attributes: Arc<[Attribute]>,
    /// The scans that have an attribute, ascending; `None`: all.
    having: Vec<Option<Vec<ScanId>>>,
    give: Give,
    fields: Vec<Field>,
    /// What is done where attributes of two kinds meet; nothing to values as they are stored.
    meeting: Option<Meeting>,
}

/// A field of a record, a column of a table.
struct Field {
    name: String,
    source: Source,
    ty: ScalarType,
}

#[derive(Clone, Copy)]
enum Source {
    Axis(usize),
    Scan,
    Attribute(usize),
}

/// Some points of a batch.
pub struct Piece {
    /// The batch.
    pub batch: Arc<Batch>,
    /// Which of its points.
    pub range: Range<usize>,
}

impl Form {
    /// The form of a query's answer.
    pub fn new(query: &Query, snapshot: &Snapshot, give: Give) -> Result<Self, QueryError> {
        let form = query.output_form(snapshot)?;
        let meeting = (!give.raw).then(|| Meeting::of(snapshot, &form));
        let attributes = meeting.as_ref().map_or(&form.attributes, |m| &m.attributes).clone();
        let contributing: Vec<_> = form.scans.iter().filter_map(|&id| snapshot.scan(id)).collect();
        let stored = |a: &Attribute| {
            let stored = snapshot.attributes().iter().find(|s| s.attribute.identity() == a.identity());
            stored.map(|s| s.id)
        };
        let having = attributes.iter().map(|a| {
            let kinds: Vec<_> = match &meeting {
                Some(meeting) => meeting.kinds(a).filter_map(stored).collect(),
                None => stored(a).into_iter().collect(),
            };
            let having = contributing.iter().filter(|s| kinds.iter().any(|kind| s.attributes.contains(kind)));
            let having: Vec<ScanId> = having.map(|s| s.id).collect();
            (!kinds.is_empty() && having.len() < contributing.len()).then_some(having)
        });
        let having = having.collect();
        let fields = fields(&attributes, give);
        Ok(Self { lattice: snapshot.site().lattice.clone(), attributes, having, give, fields, meeting })
    }

    /// The query whose batches this form is given.
    pub fn complete(&self, query: Query) -> Query {
        if self.meeting.as_ref().is_some_and(Meeting::needs_scans) { query.with_scans(true) } else { query }
    }

    /// A whole batch as it is handed on.
    pub fn piece(&self, mut batch: Batch) -> Piece {
        if let Some(meeting) = &self.meeting {
            meeting.apply(&mut batch);
        }
        Piece { range: 0..batch.len(), batch: Arc::new(batch) }
    }

    /// Appends a field's values of the points of `piece`.
    fn append(&self, field: &Field, piece: &Piece, out: &mut Column) {
        let (batch, range) = (&*piece.batch, piece.range.clone());
        match (field.source, out) {
            (Source::Axis(axis), out) => {
                let positions = &batch.positions;
                let indices = &[&positions.x, &positions.y, &positions.z][axis][range];
                match out {
                    Column::F64(out) => self.lattice.extend_world(axis, indices, out),
                    Column::I64(out) => out.extend(indices.iter().map(|&index| index as i64 - BIAS)),
                    _ => {}
                }
            }
            (Source::Scan, Column::U32(out)) => out.extend_from_slice(&batch.scans[range]),
            (Source::Scan, _) => {}
            (Source::Attribute(i), out) => match (self.is_scaled(i), out) {
                (true, Column::F64(out)) => out.extend(Real::values(&self.attributes[i], &batch.columns[i], range)),
                (_, out) => extend_from(out, &batch.columns[i], range),
            },
        }
    }

    /// Fills records of `size` bytes with the points of `piece`.
    fn fill(&self, piece: &Piece, records: &mut [u8], size: usize) {
        let mut offset = 0;
        for field in &self.fields {
            match field.source {
                Source::Scan => {
                    scatter(&piece.batch.scans[piece.range.clone()], u32::to_ne_bytes, records, size, offset);
                }
                Source::Attribute(i) if !self.is_scaled(i) => {
                    let column = &piece.batch.columns[i];
                    with_column!(column, v => {
                        scatter(&v[piece.range.clone()], |v| v.to_ne_bytes(), records, size, offset);
                    });
                }
                _ => {
                    let mut column = Column::with_capacity(field.ty, piece.range.len());
                    self.append(field, piece, &mut column);
                    with_column!(&column, v => scatter(v, |v| v.to_ne_bytes(), records, size, offset));
                }
            }
            offset += field.ty.size();
        }
    }

    /// Are an attribute's values given as real ones, and not as they are stored?
    fn is_scaled(&self, attribute: usize) -> bool {
        self.attributes[attribute].scaling.is_some() && !self.give.raw
    }

    /// Can a value of the field be null?
    fn is_nullable(&self, field: &Field) -> bool {
        let Source::Attribute(i) = field.source else { return false };
        self.having[i].is_some() || self.attributes[i].no_data.is_some()
    }

    /// Which values of a field are null: of a point whose scan lacks the attribute, or the attribute's no-data value.
    /// `None`: none can be.
    fn nulls(&self, field: &Field, pieces: &[Piece]) -> Option<Vec<bool>> {
        let Source::Attribute(i) = field.source else { return None };
        let (having, no_data) = (self.having[i].as_deref(), self.attributes[i].no_data);
        if having.is_none() && no_data.is_none() {
            return None;
        }
        let size = self.attributes[i].ty.size();
        let mut nulls = Vec::with_capacity(points(pieces));
        for Piece { batch, range } in pieces {
            nulls.extend(range.clone().map(|point| {
                let lacks = |having: &[ScanId]| having.binary_search(&batch.scans[point]).is_err();
                having.is_some_and(lacks)
                    || no_data.is_some_and(|no_data| batch.columns[i].raw(point)[..size] == no_data[..size])
            }));
        }
        Some(nulls)
    }
}

fn points(pieces: &[Piece]) -> usize {
    pieces.iter().map(|p| p.range.len()).sum()
}

fn extend_from(out: &mut Column, values: &Column, range: Range<usize>) {
    macro_rules! extend {
        ($($variant:ident),*) => {
            match (out, values) {
                $((Column::$variant(out), Column::$variant(values)) => out.extend_from_slice(&values[range]),)*
                // A field has its attribute's type.
                _ => {}
            }
        };
    }
    extend!(U8, I8, U16, I16, U32, I32, U64, I64, F32, F64);
}

/// Position, scan, attributes. A name that is not the only one of its kind has its type behind it.
fn fields(attributes: &[Attribute], give: Give) -> Vec<Field> {
    let (axes, ty) = if give.lattice { (["X", "Y", "Z"], ScalarType::I64) } else { (["x", "y", "z"], ScalarType::F64) };
    let mut fields: Vec<Field> = (0..3).map(|i| Field { name: axes[i].into(), source: Source::Axis(i), ty }).collect();
    if give.scan {
        fields.push(Field { name: "scan".into(), source: Source::Scan, ty: ScalarType::U32 });
    }
    for (i, a) in attributes.iter().enumerate() {
        let shared =
            fields.iter().any(|f| f.name == a.name) || attributes.iter().filter(|o| o.name == a.name).count() > 1;
        let plain = if shared { format!("{}:{}", a.name, a.ty.word()) } else { a.name.clone() };
        // Stored values of several scalings.
        let taken = |name: &String| fields.iter().any(|f| f.name == *name);
        let numbered = (2..).map(|n: u32| format!("{plain}.{n}"));
        let name = [plain.clone()].into_iter().chain(numbered).find(|n| !taken(n)).unwrap_or_default();
        let ty = if a.scaling.is_some() && !give.raw { ScalarType::F64 } else { a.ty };
        fields.push(Field { name, source: Source::Attribute(i), ty });
    }
    fields
}

/// The points of an answer, or of a batch of one, as they were decoded.
#[pyclass(frozen, module = "esker._esker")]
pub struct Points {
    form: Arc<Form>,
    pieces: Mutex<Vec<Piece>>,
    len: usize,
}

impl Points {
    /// Of these pieces, in their order.
    pub fn new(form: Arc<Form>, pieces: Vec<Piece>) -> Self {
        Self { form, len: points(&pieces), pieces: Mutex::new(pieces) }
    }

    /// Released points are none: the package asks for arrays before it releases them.
    fn pieces(&self) -> MutexGuard<'_, Vec<Piece>> {
        self.pieces.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Points {
    /// Name, numpy type and nullability of each field.
    fn fields(&self) -> Vec<(String, &'static str, bool)> {
        self.form.fields.iter().map(|f| (f.name.clone(), dtype(f.ty), self.form.is_nullable(f))).collect()
    }

    fn __len__(&self) -> usize {
        self.len
    }

    /// An array per field.
    fn columns<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        check_process()?;
        let form = &self.form;
        let columns: Vec<Column> = py.detach(|| {
            let pieces = self.pieces();
            let column = |field: &Field| {
                let mut out = Column::with_capacity(field.ty, points(&pieces));
                pieces.iter().for_each(|piece| form.append(field, piece, &mut out));
                out
            };
            form.fields.par_iter().map(column).collect()
        });
        Ok(columns.into_iter().map(|column| with_column!(column, v => v.into_pyarray(py).into_any())).collect())
    }

    /// Fills the bytes of an array of packed records.
    fn fill(&self, py: Python<'_>, mut records: PyReadwriteArray1<'_, u8>) -> PyResult<()> {
        check_process()?;
        let bytes = records.as_slice_mut()?;
        let form = &self.form;
        let size: usize = form.fields.iter().map(|f| f.ty.size()).sum();
        py.detach(|| {
            let pieces = self.pieces();
            if bytes.len() != size * points(&pieces) {
                return Err(PyValueError::new_err("the array is not as long as the points"));
            }
            let mut rest = bytes;
            let mut targets = Vec::with_capacity(pieces.len());
            for piece in pieces.iter() {
                let (mine, others) = rest.split_at_mut(size * piece.range.len());
                targets.push((piece, mine));
                rest = others;
            }
            targets.into_par_iter().for_each(|(piece, records)| {
                for (tile, records) in records.chunks_mut(size * TILE).enumerate() {
                    let start = piece.range.start + tile * TILE;
                    let range = start..start + records.len() / size;
                    form.fill(&Piece { batch: piece.batch.clone(), range }, records, size);
                }
            });
            Ok(())
        })
    }

    /// Which values are null, for each field that can have nulls.
    fn nulls<'py>(&self, py: Python<'py>) -> PyResult<Vec<Option<Bound<'py, PyArray1<bool>>>>> {
        check_process()?;
        let form = &self.form;
        let nulls: Vec<Option<Vec<bool>>> = py.detach(|| {
            let pieces = self.pieces();
            form.fields.par_iter().map(|field| form.nulls(field, &pieces)).collect()
        });
        Ok(nulls.into_iter().map(|n| n.map(|n| n.into_pyarray(py))).collect())
    }

    /// Forgets the decoded points, once they are in arrays.
    fn release(&self, py: Python<'_>) {
        py.detach(|| drop(std::mem::take(&mut *self.pieces())));
    }
}

/// Writes values into records of `size` bytes, `offset` bytes from the front of each.
fn scatter<T: Copy, const N: usize>(
    values: &[T],
    bytes: impl Fn(T) -> [u8; N],
    records: &mut [u8],
    size: usize,
    offset: usize,
) {
    for (record, &value) in records.chunks_exact_mut(size).zip(values) {
        record[offset..offset + N].copy_from_slice(&bytes(value));
    }
}

/// numpy's word for a type.
fn dtype(ty: ScalarType) -> &'static str {
    match ty {
        ScalarType::U8 => "u1",
        ScalarType::I8 => "i1",
        ScalarType::U16 => "u2",
        ScalarType::I16 => "i2",
        ScalarType::U32 => "u4",
        ScalarType::I32 => "i4",
        ScalarType::U64 => "u8",
        ScalarType::I64 => "i8",
        ScalarType::F32 => "f4",
        ScalarType::F64 => "f8",
    }
}
