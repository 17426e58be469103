//! The checksum of rows.

use super::CodecError;
use xxhash_rust::xxh3::{Xxh3Default, xxh3_64};

/// XXH3-64 of the bytes of a row, in order: finds accidents, not forgers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Checksum(pub u64);

impl Checksum {
    /// The checksum of the parts joined.
    pub fn of(parts: &[&[u8]]) -> Self {
        if let [one] = parts {
            return Self(xxh3_64(one));
        }
        let mut hash = Xxh3Default::new();
        parts.iter().for_each(|part| hash.update(part));
        Self(hash.digest())
    }

    /// Is this computed checksum the recorded one?
    ///
    /// # Errors
    ///
    /// [`CodecError::Checksum`] if not.
    pub fn check(self, expected: Self) -> Result<(), CodecError> {
        if self == expected { Ok(()) } else { Err(CodecError::Checksum { expected: expected.0, found: self.0 }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_of_the_parts_joined_and_see_every_bit() {
        let bytes: Vec<u8> = (0..2000_u32).map(|i| (i * i) as u8).collect();
        let whole = Checksum::of(&[&bytes]);
        for cut in [0, 1, 239, 240, 241, 1999] {
            assert_eq!(Checksum::of(&[&bytes[..cut], &bytes[cut..]]), whole);
        }
        // XXH3's own published value for no bytes: the file's, not the crate's.
        assert_eq!(Checksum::of(&[]), Checksum(0x2d06_8005_38d3_94c2));
        for bit in (0..bytes.len() * 8).step_by(37) {
            let mut other = bytes.clone();
            other[bit / 8] ^= 1 << (bit % 8);
            let found = Checksum::of(&[&other]);
            let error = CodecError::Checksum { expected: whole.0, found: found.0 };
            assert_eq!(found.check(whole), Err(error));
        }
        assert_eq!(whole.check(whole), Ok(()));
    }
}
