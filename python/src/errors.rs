//! The library's errors as the package's exceptions, which are defined in `lib/esker/errors.py`.

use esker::export::ExportError;
use esker::formats::FormatError;
use esker::generate::GenerateError;
use esker::ingest::IngestError;
use esker::query::QueryError;
use esker::store::StoreError;
use pyo3::PyErr;
use std::error::Error;
use std::io::ErrorKind;

mod exceptions {
    //! Imported when the first one is raised.
    pyo3::import_exception!(esker.errors, DamagedError);
    pyo3::import_exception!(esker.errors, DiskFullError);
    pyo3::import_exception!(esker.errors, EskerError);
    pyo3::import_exception!(esker.errors, ExistsError);
    pyo3::import_exception!(esker.errors, FilterError);
    pyo3::import_exception!(esker.errors, FormatError);
    pyo3::import_exception!(esker.errors, InUseError);
    pyo3::import_exception!(esker.errors, IngestError);
    pyo3::import_exception!(esker.errors, NotAStoreError);
    pyo3::import_exception!(esker.errors, NotThereError);
    pyo3::import_exception!(esker.errors, QueryError);
    pyo3::import_exception!(esker.errors, ReadOnlyError);
    pyo3::import_exception!(esker.errors, UnknownNameError);
}

/// An error of the library, of whichever module.
pub enum Failure {
    Store(StoreError),
    Query(QueryError),
    Ingest(IngestError),
    Format(FormatError),
    Generate(GenerateError),
    Export(ExportError),
}

impl From<ExportError> for Failure {
    fn from(error: ExportError) -> Self {
        Self::Export(error)
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

impl From<QueryError> for Failure {
    fn from(error: QueryError) -> Self {
        Self::Query(error)
    }
}

impl From<IngestError> for Failure {
    fn from(error: IngestError) -> Self {
        Self::Ingest(error)
    }
}

impl From<FormatError> for Failure {
    fn from(error: FormatError) -> Self {
        Self::Format(error)
    }
}

impl From<GenerateError> for Failure {
    fn from(error: GenerateError) -> Self {
        Self::Generate(error)
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Store(e) => of_store(&e),
            Failure::Query(e) => of_query(&e),
            Failure::Ingest(e) => of_ingest(&e),
            Failure::Format(e) => of_format(&e),
            Failure::Generate(GenerateError::Format(e)) => of_format(&e),
            Failure::Export(e) => of_export(&e),
            Failure::Generate(e) => exceptions::EskerError::new_err(message(&e)),
        }
    }
}

/// A query that cannot be: what the package's caller gave makes none.
pub fn bad_query(message: impl Into<String>) -> PyErr {
    exceptions::QueryError::new_err(message.into())
}

/// An ingest that cannot be.
pub fn bad_ingest(message: impl Into<String>) -> PyErr {
    exceptions::IngestError::new_err(message.into())
}

/// Anything else that the caller did wrong.
pub fn misuse(message: impl Into<String>) -> PyErr {
    exceptions::EskerError::new_err(message.into())
}

/// A file that is there and is to stay.
pub fn exists(message: impl Into<String>) -> PyErr {
    exceptions::ExistsError::new_err(message.into())
}

fn of_store(error: &StoreError) -> PyErr {
    let message = message(error);
    match error {
        StoreError::NotThere { .. } => exceptions::NotThereError::new_err(message),
        StoreError::Directory { .. } | StoreError::NotAStore { .. } | StoreError::Newer { .. } => {
            exceptions::NotAStoreError::new_err(message)
        }
        StoreError::AlreadyThere { .. } => exceptions::ExistsError::new_err(message),
        StoreError::InUse { .. } | StoreError::Busy { .. } => exceptions::InUseError::new_err(message),
        StoreError::Damaged { .. } => exceptions::DamagedError::new_err(message),
        StoreError::Full { .. } => exceptions::DiskFullError::new_err(message),
        StoreError::ReadOnly { .. } | StoreError::ReadOnlyFolder { .. } => exceptions::ReadOnlyError::new_err(message),
        _ => exceptions::EskerError::new_err(message),
    }
}

fn of_query(error: &QueryError) -> PyErr {
    match error {
        QueryError::Store(e) => of_store(e),
        QueryError::Filter(e) => exceptions::FilterError::new_err((e.to_string(), e.at())),
        QueryError::UnknownAttribute { .. } | QueryError::UnknownScan { .. } | QueryError::Coordinate { .. } => {
            exceptions::UnknownNameError::new_err(message(error))
        }
        QueryError::Inconsistent { .. } => exceptions::DamagedError::new_err(message(error)),
        _ => exceptions::QueryError::new_err(message(error)),
    }
}

fn of_ingest(error: &IngestError) -> PyErr {
    match error {
        IngestError::Store(e) => of_store(e),
        IngestError::Format(e) => of_format(e),
        IngestError::NoScan { .. } => exceptions::UnknownNameError::new_err(message(error)),
        IngestError::NoBookmark { .. } => exceptions::UnknownNameError::new_err(message(error)),
        IngestError::BookmarkTaken(_) => exceptions::ExistsError::new_err(message(error)),
        IngestError::OutputThere(_) => exceptions::ExistsError::new_err(message(error)),
        IngestError::DiskFull { .. } => exceptions::DiskFullError::new_err(message(error)),
        _ => exceptions::IngestError::new_err(message(error)),
    }
}

fn of_format(error: &FormatError) -> PyErr {
    match error {
        FormatError::Io { source, action, .. } => {
            let message = message(error);
            let is_read = matches!(*action, "opening" | "reading");
            match source.kind() {
                ErrorKind::NotFound => exceptions::NotThereError::new_err(message),
                ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => {
                    exceptions::DiskFullError::new_err(message)
                }
                ErrorKind::ReadOnlyFilesystem => exceptions::ReadOnlyError::new_err(message),
                ErrorKind::PermissionDenied if !is_read => exceptions::ReadOnlyError::new_err(message),
                _ => exceptions::FormatError::new_err(message),
            }
        }
        FormatError::NoFolder { .. } => exceptions::NotThereError::new_err(message(error)),
        FormatError::AlreadyThere { path } => {
            exists(format!("{}: exists already; give another name, or force=True to replace it", path.display()))
        }
        _ => exceptions::FormatError::new_err(message(error)),
    }
}

fn of_export(error: &ExportError) -> PyErr {
    match error {
        ExportError::Query(e) => of_query(e),
        ExportError::Format(e) => of_format(e),
        ExportError::NoScan(_) => exceptions::DamagedError::new_err(message(error)),
        ExportError::Ending { .. } | ExportError::TooWide { .. } => exceptions::FormatError::new_err(message(error)),
        _ => exceptions::QueryError::new_err(message(error)),
    }
}

/// What the library's messages call by the command line's names, and what it is called here.
const WORDS: &[(&str, &str)] = &[
    ("--recursive looks", "recursive=True looks"),
    ("or --ignore-crs to take", "or give ignore_crs=True to take"),
    ("--quantum, --phase and --lattice apply", "quantum, phase and lattice apply"),
    ("a coarser --quantum", "a coarser quantum"),
    ("--force puts it in", "force=True puts it in"),
    ("--name names one scan", "name names one scan"),
    ("or give --wait", "or give wait=True"),
    ("`esker scans` lists them", "store.scans lists them"),
    ("run `esker verify`", "call store.verify()"),
    ("use --force to replace it", "force=True replaces it"),
];

/// The error and its causes, without saying anything twice, in this package's words.
fn message(error: &dyn Error) -> String {
    let full = full_message(error);
    WORDS.iter().fold(full, |message, (word, here)| message.replace(word, here))
}

fn full_message(error: &dyn Error) -> String {
    let mut message = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let text = error.to_string();
        if !message.contains(&text) {
            message = format!("{message}: {text}");
        }
        cause = error.source();
    }
    message
}
