//! Bytes of the packed columns: little-endian integers, varints, checked on the way back.

use crate::lattice::{LatticeBox, LatticePoint};

/// Appends numbers.
#[derive(Debug, Default)]
pub(in crate::store) struct Put(pub Vec<u8>);

impl Put {
    pub fn u8(&mut self, v: u8) {
        self.0.push(v);
    }

    pub fn u16(&mut self, v: u16) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }

    pub fn u64(&mut self, v: u64) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }

    pub fn f64(&mut self, v: f64) {
        self.u64(v.to_bits());
    }

    /// LEB128: seven bits a byte, low ones first, high bit set on all but the last.
    pub fn varint(&mut self, mut v: u64) {
        while v >= 0x80 {
            self.0.push(v as u8 | 0x80);
            v >>= 7;
        }
        self.0.push(v as u8);
    }

    /// Two corners of three indices of six bytes.
    pub fn lattice_box(&mut self, b: &LatticeBox) {
        for v in b.min.0.into_iter().chain(b.max.0) {
            self.0.extend_from_slice(&v.to_le_bytes()[..6]);
        }
    }
}

/// Takes numbers from the front of bytes; what is missing or not canonical is a message.
#[derive(Debug)]
pub(in crate::store) struct Take<'a>(pub &'a [u8]);

/// A message that says what is wrong.
pub(in crate::store) type Taken<T> = Result<T, String>;

impl<'a> Take<'a> {
    pub fn bytes(&mut self, n: usize) -> Taken<&'a [u8]> {
        let (head, rest) = self.0.split_at_checked(n).ok_or("ends too early")?;
        self.0 = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Taken<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk().ok_or("ends too early")?;
        self.0 = rest;
        Ok(*head)
    }

    pub fn u8(&mut self) -> Taken<u8> {
        self.array::<1>().map(|[b]| b)
    }

    pub fn u16(&mut self) -> Taken<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub fn u64(&mut self) -> Taken<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub fn f64(&mut self) -> Taken<f64> {
        self.u64().map(f64::from_bits)
    }

    pub fn varint(&mut self) -> Taken<u64> {
        let mut v = 0_u64;
        for shift in (0..64).step_by(7) {
            let b = self.u8()?;
            let bits = u64::from(b & 0x7f);
            if shift == 63 && bits > 1 {
                return Err("a number is too large".into());
            }
            v |= bits << shift;
            if b & 0x80 == 0 {
                // One spelling per number.
                return if b == 0 && shift > 0 { Err("a number is padded".into()) } else { Ok(v) };
            }
        }
        Err("a number is too long".into())
    }

    /// A varint that fits `T`.
    pub fn small<T: TryFrom<u64>>(&mut self) -> Taken<T> {
        let v = self.varint()?;
        T::try_from(v).map_err(|_| format!("a number is too large: {v}"))
    }

    /// A count of things of at least `least_bytes` each: no more than fit what is left.
    pub fn count(&mut self, least_bytes: usize) -> Taken<usize> {
        let n: usize = self.small()?;
        if n.checked_mul(least_bytes).is_some_and(|b| b <= self.0.len()) {
            Ok(n)
        } else {
            Err(format!("a count is too large: {n}"))
        }
    }

    pub fn lattice_box(&mut self) -> Taken<LatticeBox> {
        let mut corner = || -> Taken<LatticePoint> {
            let mut point = LatticePoint::default();
            for v in &mut point.0 {
                let mut bytes = [0; 8];
                bytes[..6].copy_from_slice(&self.array::<6>()?);
                *v = u64::from_le_bytes(bytes);
            }
            Ok(point)
        };
        let (min, max) = (corner()?, corner()?);
        if (0..3).all(|i| min.0[i] <= max.0[i]) {
            Ok(LatticeBox { min, max })
        } else {
            Err("a box is inside out".into())
        }
    }

    pub fn end(&self) -> Taken<()> {
        if self.0.is_empty() { Ok(()) } else { Err(format!("{} bytes too many", self.0.len())) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn varints_come_back_and_have_one_spelling(v in any::<u64>(), shift in 0_u32..64, noise in prop::collection::vec(any::<u8>(), 0..12)) {
            let v = v >> shift;
            let mut put = Put::default();
            put.varint(v);
            let mut take = Take(&put.0);
            prop_assert_eq!(take.varint(), Ok(v));
            prop_assert!(take.end().is_ok());
            let mut take = Take(&noise);
            if let Ok(v) = take.varint() {
                let mut put = Put::default();
                put.varint(v);
                prop_assert_eq!(&noise[..noise.len() - take.0.len()], &put.0[..]);
            }
        }
    }
}
