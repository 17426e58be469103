//! Arrays of numpy as a scan.

use crate::errors::misuse;
use esker::formats::PointTable;
use esker::points::Column;
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;

/// The values of a contiguous array of one of the ten types.
fn column(name: &str, array: &Bound<'_, PyAny>) -> PyResult<Column> {
    macro_rules! first_that_fits {
        ($($kind:ident $t:ty),*) => {
            $(if let Ok(values) = array.extract::<PyReadonlyArray1<'_, $t>>() {
                return Ok(Column::$kind(values.as_slice()?.to_vec()));
            })*
        };
    }
    first_that_fits!(U8 u8, I8 i8, U16 u16, I16 i16, U32 u32, I32 i32, U64 u64, I64 i64, F32 f32, F64 f64);
    Err(misuse(format!("{name} is no array of whole or real numbers")))
}

/// The table: three axes of `float64` first, then attributes.
pub fn table(name: String, columns: &[(String, Bound<'_, PyAny>)]) -> PyResult<PointTable> {
    let [x, y, z, attributes @ ..] = columns else {
        return Err(misuse("points need x, y and z"));
    };
    let axis = |(name, array): &(String, Bound<'_, PyAny>)| match column(name, array)? {
        Column::F64(values) => Ok(values),
        _ => Err(misuse(format!("{name} is not float64"))),
    };
    let mut table = PointTable::new(name, axis(x)?, axis(y)?, axis(z)?).map_err(|e| misuse(e.to_string()))?;
    for (name, array) in attributes {
        table.add(name, column(name, array)?).map_err(|e| misuse(e.to_string()))?;
    }
    Ok(table)
}
