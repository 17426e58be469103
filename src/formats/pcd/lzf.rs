//! LZF, as PCL compresses with it: literal runs, and copies from up to 8 KiB back.

/// What `input` stands for, if that is exactly `size` bytes.
pub fn decompress(input: &[u8], size: usize) -> Option<Vec<u8>> {
    // A copy of three bytes gives at most 264: a size beyond that is a lie, and is not to be allocated.
    if size / 88 > input.len() {
        return None;
    }
    let mut out = Vec::with_capacity(size);
    let mut rest = input;
    while let [control, after @ ..] = rest {
        rest = after;
        let control = usize::from(*control);
        if control < 32 {
            let (run, after) = rest.split_at_checked(control + 1)?;
            out.extend_from_slice(run);
            rest = after;
        } else {
            let mut length = control >> 5;
            if length == 7 {
                let (more, after) = rest.split_first()?;
                length += usize::from(*more);
                rest = after;
            }
            let (low, after) = rest.split_first()?;
            rest = after;
            let back = ((control & 31) << 8) + usize::from(*low) + 1;
            let from = out.len().checked_sub(back)?;
            // It may reach into what it writes: a run repeats.
            for i in from..from + length + 2 {
                let byte = out[i];
                out.push(byte);
            }
        }
        if out.len() > size {
            return None;
        }
    }
    (out.len() == size).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn copies_may_overlap_what_they_write() {
        // "ab", then 9 bytes from 2 back.
        assert_eq!(decompress(&[1, b'a', b'b', 7 << 5, 0, 1], 11).unwrap(), b"abababababa");
        assert_eq!(decompress(&[1, b'a', b'b', 1 << 5, 1], 5).unwrap(), b"ababa");
        // Back before the start, cut, a longer and a shorter size than said.
        for (bytes, size) in
            [(&[1, b'a', b'b', 1 << 5, 2][..], 5), (&[1, b'a'], 2), (&[0, b'a'], 2), (&[1, b'a', b'b'], 1)]
        {
            assert_eq!(decompress(bytes, size), None);
        }
        assert_eq!(decompress(&[0; 8], usize::MAX), None);
    }

    proptest! {
        #[test]
        fn any_bytes_come_to_an_end(bytes in prop::collection::vec(any::<u8>(), 0..200), size in 0_usize..40_000) {
            if let Some(out) = decompress(&bytes, size) {
                prop_assert_eq!(out.len(), size);
            }
        }
    }
}
