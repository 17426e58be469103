//! What can be wrong with a point file.

use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a point file could not be read or written. Messages name the file and, where there is one, the place.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The operating system refused.
    #[error("{path}: {action} failed")]
    Io {
        /// The file.
        path: PathBuf,
        /// `opening`, `reading`, `writing`, ...
        action: &'static str,
        /// The system's word.
        source: std::io::Error,
    },
    /// The file is not what it says, or is damaged.
    #[error("{path}: at byte {offset}: expected {expected}, found {found}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where, in bytes from the start of the file.
        offset: u64,
        /// What should be there.
        expected: String,
        /// What is.
        found: String,
    },
    /// The same of a text, whose places are lines.
    #[error("{path}: line {line}: expected {expected}, found {found}")]
    MalformedLine {
        /// The file.
        path: PathBuf,
        /// Where, from 1.
        line: u64,
        /// What should be there.
        expected: String,
        /// What is.
        found: String,
    },
    /// A valid file that Esker does not read.
    #[error("{path}: {what} is not supported{remedy}")]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// The feature.
        what: String,
        /// Empty, or `; ` and what to do.
        remedy: String,
    },
    /// A crate that decodes the format panicked.
    #[error("{path}: the decoder broke down at byte {offset}: {message}")]
    Decoder {
        /// The file.
        path: PathBuf,
        /// Where the piece begins that was being decoded.
        offset: u64,
        /// The panic's message.
        message: String,
    },
    /// There is a file of this name.
    #[error("{path}: exists already; use --force to replace it")]
    AlreadyThere {
        /// The file.
        path: PathBuf,
    },
    /// A file was to be written where there is no folder.
    #[error("{path}: the folder {folder} does not exist; create it first")]
    NoFolder {
        /// The file.
        path: PathBuf,
        /// What is missing.
        folder: PathBuf,
    },
    /// The answer cannot be written in this form.
    #[error("{path}: {reason}")]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// Why, and what to do.
        reason: String,
    },
}

impl FormatError {
    /// The file.
    pub fn path(&self) -> &Path {
        match self {
            Self::Io { path, .. }
            | Self::Malformed { path, .. }
            | Self::MalformedLine { path, .. }
            | Self::Unsupported { path, .. }
            | Self::Decoder { path, .. }
            | Self::AlreadyThere { path }
            | Self::NoFolder { path, .. }
            | Self::Unwritable { path, .. } => path,
        }
    }

    /// [`FormatError::Unsupported`]; `remedy` is empty or says what to do.
    pub(crate) fn unsupported(path: &Path, what: impl Into<String>, remedy: &str) -> Self {
        let remedy = if remedy.is_empty() { String::new() } else { format!("; {remedy}") };
        Self::Unsupported { path: path.to_owned(), what: what.into(), remedy }
    }
}
