//! A walk over bytes that come from outside, and the writing of the same numbers.

use super::CodecError;

/// What is left of a chunk.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    pub(super) fn new(rest: &'a [u8]) -> Self {
        Self { rest }
    }

    /// The next `count` bytes.
    pub(super) fn take(&mut self, count: usize, place: &'static str) -> Result<&'a [u8], CodecError> {
        let error = CodecError::Truncated { place, needed: count, found: self.rest.len() };
        let (taken, rest) = self.rest.split_at_checked(count).ok_or(error)?;
        self.rest = rest;
        Ok(taken)
    }

    pub(super) fn u8(&mut self, place: &'static str) -> Result<u8, CodecError> {
        Ok(self.take(1, place)?[0])
    }

    /// A little-endian number of `bytes` bytes, at most 8.
    pub(super) fn uint(&mut self, bytes: usize, place: &'static str) -> Result<u64, CodecError> {
        Ok(self.take(bytes, place)?.iter().rev().fold(0, |v, &b| v << 8 | u64::from(b)))
    }

    /// A number in groups of seven bits, lowest first; the high bit says that more follow.
    pub(super) fn varint(&mut self, place: &'static str) -> Result<u64, CodecError> {
        let mut value = 0;
        for shift in (0..70).step_by(7) {
            let byte = self.u8(place)?;
            let group = u64::from(byte & 0x7f);
            if shift == 63 && byte > 1 {
                break;
            }
            value |= group << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(CodecError::Range { place, found: u64::MAX, limit: u64::MAX })
    }

    /// All that is left.
    pub(super) fn rest(self) -> &'a [u8] {
        self.rest
    }

    /// Nothing may be left.
    pub(super) fn end(self, place: &'static str) -> Result<(), CodecError> {
        match self.rest.len() {
            0 => Ok(()),
            found => Err(CodecError::Length { place, expected: 0, found }),
        }
    }
}

/// The reverse of [`Reader::uint`].
pub(super) fn put_uint(value: u64, bytes: usize, out: &mut Vec<u8>) {
    out.extend_from_slice(&value.to_le_bytes()[..bytes]);
}

/// The reverse of [`Reader::varint`].
pub(super) fn put_varint(mut value: u64, out: &mut Vec<u8>) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_come_back(value: u64, shift in 0_u32..64) {
            let value = value >> shift;
            let mut bytes = Vec::new();
            put_varint(value, &mut bytes);
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(reader.varint("test"), Ok(value));
            prop_assert!(reader.end("test").is_ok());
            prop_assert!(Reader::new(&bytes[..bytes.len() - 1]).varint("test").is_err());
            bytes.clear();
            put_uint(value, 8, &mut bytes);
            prop_assert_eq!(Reader::new(&bytes).uint(8, "test"), Ok(value));
        }
    }

    #[test]
    fn a_varint_beyond_64_bits_is_an_error() {
        assert!(Reader::new(&[0xff; 11]).varint("test").is_err());
        let mut bytes = [0xff; 10];
        bytes[9] = 2;
        assert!(Reader::new(&bytes).varint("test").is_err());
    }
}
