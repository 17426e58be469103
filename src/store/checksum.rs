//! Checksums of rows: XXH3-64 over every column, with its type and length, and over the table's name.

use rusqlite::types::ValueRef;
use std::fmt;
use xxhash_rust::xxh3::Xxh3;

/// An XXH3-64 checksum. Finds accidents, not attacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Checksum(u64);

impl Checksum {
    /// Over the columns of a row of `table`, in the table's order, without the checksum column itself.
    pub(super) fn of_row<'a>(table: &str, values: impl IntoIterator<Item = ValueRef<'a>>) -> Self {
        let mut hash = Xxh3::new();
        let mut put = |tag: u8, bytes: &[u8]| {
            // Type and length first, so that no two rows run into the same bytes.
            let mut head = [tag; 9];
            head[1..].copy_from_slice(&(bytes.len() as u64).to_le_bytes());
            hash.update(&head);
            hash.update(bytes);
        };
        put(b'T', table.as_bytes());
        for value in values {
            match value {
                ValueRef::Null => put(b'n', &[]),
                ValueRef::Integer(v) => put(b'i', &v.to_le_bytes()),
                ValueRef::Real(v) => put(b'r', &v.to_bits().to_le_bytes()),
                ValueRef::Text(v) => put(b't', v),
                ValueRef::Blob(v) => put(b'b', v),
            }
        }
        Self(hash.digest())
    }

    /// As the column holds it.
    pub(super) fn to_sql(self) -> i64 {
        self.0 as i64
    }

    /// From the column.
    pub(super) fn from_sql(value: i64) -> Self {
        Self(value as u64)
    }
}

impl fmt::Display for Checksum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_do_not_run_into_each_other() {
        let sum = |values: &[ValueRef<'_>]| Checksum::of_row("t", values.iter().copied());
        let split = [ValueRef::Blob(b"ab"), ValueRef::Blob(b"c")];
        assert_ne!(sum(&split), sum(&[ValueRef::Blob(b"a"), ValueRef::Blob(b"bc")]));
        assert_ne!(sum(&[ValueRef::Text(b"a")]), sum(&[ValueRef::Blob(b"a")]));
        assert_ne!(sum(&[ValueRef::Null]), sum(&[]));
        assert_ne!(sum(&[]), Checksum::of_row("u", []));
        assert_eq!(sum(&split), Checksum::from_sql(sum(&split).to_sql()));
    }
}
