//! Who a scan is: its source's bytes, its place in the file, its pose, how it was read.

use crate::formats::FormatError;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// BLAKE3 of a file's bytes. `cancelled` is asked now and then; true gives `None`.
pub(super) fn content_hash(path: &Path, cancelled: &dyn Fn() -> bool) -> Result<Option<[u8; 32]>, FormatError> {
    let io = |action| move |source| FormatError::Io { path: path.to_owned(), action, source };
    let mut file = File::open(path).map_err(io("opening"))?;
    let mut hasher = blake3::Hasher::new();
    let mut buffer = vec![0; 1 << 20];
    loop {
        if cancelled() {
            return Ok(None);
        }
        match file.read(&mut buffer).map_err(io("reading"))? {
            0 => return Ok(Some(*hasher.finalize().as_bytes())),
            n => hasher.update(&buffer[..n]),
        };
    }
}

/// The identity of one scan: content, index in the file, pose, reader options.
pub(super) fn scan_identity(content: &[u8; 32], index: u32, pose: &[f64; 16], options: &str) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"esker scan 1");
    hasher.update(content);
    hasher.update(&index.to_le_bytes());
    for value in pose {
        hasher.update(&value.to_bits().to_le_bytes());
    }
    hasher.update(options.as_bytes());
    *hasher.finalize().as_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    #[test]
    fn everything_that_changes_a_scan_changes_its_identity() {
        let pose = Pose::IDENTITY.to_matrix();
        let moved = Pose::from_quaternion([1e-9, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]).unwrap().to_matrix();
        let all = [
            scan_identity(&[0; 32], 0, &pose, ""),
            scan_identity(&[1; 32], 0, &pose, ""),
            scan_identity(&[0; 32], 1, &pose, ""),
            scan_identity(&[0; 32], 0, &moved, ""),
            scan_identity(&[0; 32], 0, &pose, "columns x,y,z"),
        ];
        let different: std::collections::HashSet<_> = all.iter().collect();
        assert_eq!(different.len(), all.len());
    }
}
