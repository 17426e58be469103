//! A file that is read by position: no shared cursor, so that threads read pieces at once.

use super::FormatError;
use super::handles::Handle;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A file that was opened, and its size.
#[derive(Debug)]
pub(super) struct SourceFile {
    path: PathBuf,
    handle: Handle,
    bytes: u64,
}

impl SourceFile {
    /// Opens `path` for reading.
    pub fn open(path: &Path) -> Result<Self, FormatError> {
        let failed = |source| FormatError::Io { path: path.to_owned(), action: "opening", source };
        let (handle, bytes) = Handle::open(path).map_err(failed)?;
        Ok(Self { path: path.to_owned(), handle, bytes })
    }

    /// Its path, as it was given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its size when it was opened.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Fills `buffer` from `offset` on as far as the file goes; gives the number of bytes read.
    pub fn read_up_to(&self, buffer: &mut [u8], offset: u64) -> Result<usize, FormatError> {
        let failed = |source| FormatError::Io { path: self.path.clone(), action: "reading", source };
        let file = self.handle.get(&self.path).map_err(failed)?;
        let mut done = 0;
        while done < buffer.len() {
            match read_at(&file, &mut buffer[done..], offset.saturating_add(done as u64)) {
                Ok(0) => break,
                Ok(n) => done += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(source) => return Err(failed(source)),
            }
        }
        Ok(done)
    }

    /// What one call of the system gives from `offset` on.
    fn read_some(&self, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
        read_at(&*self.handle.get(&self.path)?, buffer, offset)
    }

    /// The `len` bytes at `offset`, or as many as the file has; never allocates more than it has.
    pub fn read_vec(&self, offset: u64, len: u64) -> Result<Vec<u8>, FormatError> {
        let len = len.min(self.bytes.saturating_sub(offset));
        let mut buffer = vec![0; usize::try_from(len).unwrap_or(usize::MAX)];
        let read = self.read_up_to(&mut buffer, offset)?;
        buffer.truncate(read);
        Ok(buffer)
    }

    /// [`FormatError::Malformed`] at `offset` of this file.
    pub fn malformed(&self, offset: u64, expected: impl Into<String>, found: impl Into<String>) -> FormatError {
        FormatError::Malformed { path: self.path.clone(), offset, expected: expected.into(), found: found.into() }
    }

    /// [`FormatError::MalformedLine`] for the line that holds the byte `offset` of this file.
    pub fn malformed_line(&self, offset: u64, expected: impl Into<String>, found: impl Into<String>) -> FormatError {
        let (expected, found) = (expected.into(), found.into());
        match self.line_at(offset) {
            Ok(line) => FormatError::MalformedLine { path: self.path.clone(), line, expected, found },
            Err(error) => error,
        }
    }

    /// The number of the line that holds the byte `offset`, from 1. Reads all that comes before.
    pub fn line_at(&self, offset: u64) -> Result<u64, FormatError> {
        let mut buffer = vec![0; 1 << 16];
        let (mut at, mut line) = (0, 1);
        while at < offset {
            let rest = usize::try_from(offset - at).unwrap_or(usize::MAX).min(buffer.len());
            let read = self.read_up_to(&mut buffer[..rest], at)?;
            if read == 0 {
                break;
            }
            line += buffer[..read].iter().filter(|&&b| b == b'\n').count() as u64;
            at += read as u64;
        }
        Ok(line)
    }

    /// [`FormatError::Unsupported`] for this file; `remedy` is empty or says what to do.
    pub fn unsupported(&self, what: impl Into<String>, remedy: &str) -> FormatError {
        FormatError::unsupported(&self.path, what, remedy)
    }

    /// A sequential reader of the bytes `offset .. end`.
    pub fn reader(&self, offset: u64, end: u64) -> Window<'_> {
        Window { file: self, position: offset, end: end.min(self.bytes) }
    }
}

#[cfg(unix)]
fn read_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, buffer, offset)
}

#[cfg(windows)]
fn read_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_read(file, buffer, offset)
}

/// Part of a file as [`io::Read`], with a position of its own.
#[derive(Debug)]
pub(super) struct Window<'a> {
    file: &'a SourceFile,
    position: u64,
    end: u64,
}

impl io::Read for Window<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let room = usize::try_from(self.end.saturating_sub(self.position)).unwrap_or(usize::MAX);
        let len = buffer.len().min(room);
        let read = self.file.read_some(&mut buffer[..len], self.position)?;
        self.position += read as u64;
        Ok(read)
    }
}

/// A whole file as [`io::Read`] and [`io::Seek`], read ahead: a seek to what is there already costs nothing.
#[derive(Debug)]
pub(super) struct Buffered {
    file: Arc<SourceFile>,
    position: u64,
    buffer: Vec<u8>,
    /// Byte of the file at the start of the buffer.
    base: u64,
    filled: usize,
}

impl Buffered {
    /// From the start of `file`, with a buffer of `bytes`.
    pub fn new(file: Arc<SourceFile>, bytes: usize) -> Self {
        Self { file, position: 0, buffer: vec![0; bytes], base: 0, filled: 0 }
    }
}

impl io::Read for Buffered {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let inside = self.position.checked_sub(self.base).filter(|&at| at < self.filled as u64);
        let at = match inside {
            Some(at) => at as usize,
            None => {
                self.base = self.position;
                self.filled = 0;
                self.filled = self.file.read_some(&mut self.buffer, self.position)?;
                0
            }
        };
        let len = out.len().min(self.filled - at);
        out[..len].copy_from_slice(&self.buffer[at..at + len]);
        self.position += len as u64;
        Ok(len)
    }
}

impl io::Seek for Buffered {
    fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
        let place = match to {
            io::SeekFrom::Start(place) => Some(place),
            io::SeekFrom::End(by) => self.file.bytes.checked_add_signed(by),
            io::SeekFrom::Current(by) => self.position.checked_add_signed(by),
        };
        self.position = place.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.position)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Seek};

    #[test]
    fn reads_stop_at_the_end_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f");
        std::fs::write(&path, b"0123456789").unwrap();
        let file = SourceFile::open(&path).unwrap();
        assert_eq!(file.read_vec(8, u64::MAX).unwrap(), b"89");
        assert_eq!(file.read_vec(11, 5).unwrap(), b"");
        assert_eq!(file.read_vec(u64::MAX, 5).unwrap(), b"");
        let mut text = String::new();
        file.reader(2, 5).read_to_string(&mut text).unwrap();
        assert_eq!(text, "234");
    }

    #[test]
    fn a_buffered_file_reads_where_it_was_sent() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f");
        std::fs::write(&path, b"0123456789").unwrap();
        let mut file = Buffered::new(Arc::new(SourceFile::open(&path).unwrap()), 4);
        let mut three = [0; 3];
        for (to, expected) in
            [(io::SeekFrom::Start(5), b"567"), (io::SeekFrom::Current(-6), b"234"), (io::SeekFrom::End(-3), b"789")]
        {
            file.seek(to).unwrap();
            file.read_exact(&mut three).unwrap();
            assert_eq!(&three, expected);
        }
        assert!(file.read_exact(&mut three).is_err());
        assert!(file.seek(io::SeekFrom::Current(-11)).is_err());
    }
}
