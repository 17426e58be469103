//! The extension module `esker._esker`: what cannot be said in Python. Its only caller is the package `esker` beside it
//! (`lib/esker`), which has the documented interface; so arguments come here complete and in one form.

mod batches;
mod changes;
mod errors;
mod export;
mod options;
mod points;
mod reader;
mod table;
mod waiting;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// `esker._esker`.
#[pyo3::pymodule(gil_used = false)]
mod _esker {
    /// The version of the package.
    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
    #[pymodule_export]
    use super::batches::Batches;
    #[pymodule_export]
    use super::changes::{
        compact, digest, generate, ingest, ingest_table, keep_bookmark, merge, remove, remove_bookmark, rename,
        replace, set_crs, set_visible,
    };
    #[pymodule_export]
    use super::export::export;
    #[pymodule_export]
    use super::points::Points;
    #[pymodule_export]
    use super::reader::{Reader, same_attribute};
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(_module: &Bound<'_, PyModule>) -> PyResult<()> {
        let lacks = esker::processor::lacks();
        lacks.map_or(Ok(()), |lacks| Err(pyo3::exceptions::PyImportError::new_err(lacks)))
    }
}
