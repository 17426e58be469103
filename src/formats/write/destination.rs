//! Where a file is written until it is complete: under a temporary name in its own folder, or for the standard output
//! in the system's folder for temporary files.

use crate::formats::FormatError;
use std::ffi::OsStr;
use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Temporary files that exist now, for [`remove_unfinished`].
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn unfinished() -> MutexGuard<'static, Vec<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Deletes the temporary files of all outputs that are not finished: for a program that ends without dropping them,
/// on Ctrl-C say. Their writers then fail to finish.
pub fn remove_unfinished() {
    for path in unfinished().drain(..) {
        // The program is ending: there is nobody to tell, and the file may be gone already.
        let _ = fs::remove_file(path);
    }
}

/// Why a database is left alone: it may be the store that is being read, and its points are nowhere else.
const DATABASE: &str = "is a database, such as a store; delete it first if its name is to be used";

/// Is the file a database, or part of one? No output replaces it.
pub fn is_database(path: &Path) -> bool {
    if belongs_to_database(path) {
        return true;
    }
    // One that is open here is not opened again: closing it would end the locks that this process has on it.
    let mut shared_memory = path.as_os_str().to_owned();
    shared_memory.push("-shm");
    if path.is_file() && Path::new(&shared_memory).exists() {
        return true;
    }
    let mut head = [0; 16];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut head));
    read.is_ok() && &head == b"SQLite format 3\0"
}

/// Is it, or would it be, the log, the journal, the index of the log or the lock of a database? It would be taken for that.
fn belongs_to_database(path: &Path) -> bool {
    let name = path.file_name().and_then(OsStr::to_str).unwrap_or("");
    let owner = ["-wal", "-shm", "-journal", "-lock"].iter().find_map(|suffix| name.strip_suffix(suffix));
    owner.is_some_and(|owner| !owner.is_empty() && is_database(&path.with_file_name(owner)))
}

/// A file without its final name. Dropped before [`Destination::finish`], it is deleted.
#[derive(Debug)]
pub(super) struct Destination {
    /// What messages call it.
    shown: PathBuf,
    /// What messages call it where writing fails: what goes to the standard output lies in another place until then.
    written: PathBuf,
    /// Where it will be; `None` for the standard output.
    path: Option<PathBuf>,
    temporary: PathBuf,
    force: bool,
}

/// May a file be written to `path`, replacing one if `force` is set? Gives where it will lie, by the one name that this place
/// has: two outputs of which that is the same would be one file. Nothing is made.
///
/// # Errors
///
/// As [`OutputFile::create`].
pub fn check_output(path: &Path, force: bool) -> Result<PathBuf, FormatError> {
    let (target, folder) = Destination::checked(path, force)?;
    let folder = fs::canonicalize(&folder).unwrap_or(folder);
    Ok(target.file_name().map_or(target.clone(), |name| folder.join(name)))
}

/// A file of any content: it appears under its name when it is finished, or not at all.
#[derive(Debug)]
pub struct OutputFile {
    destination: Destination,
    out: BufWriter<File>,
}

impl OutputFile {
    /// Begins the file `path`, or one that will replace it if `force` is set.
    ///
    /// # Errors
    ///
    /// [`FormatError::AlreadyThere`] if it is there and is not to be replaced, [`FormatError::Unwritable`] if it is no place
    /// for a file, [`FormatError::Io`] if the system refuses.
    pub fn create(path: &Path, force: bool) -> Result<Self, FormatError> {
        let (destination, file) = Destination::file(path, force)?;
        Ok(Self { destination, out: BufWriter::new(file) })
    }

    /// Appends.
    ///
    /// # Errors
    ///
    /// [`FormatError::Io`] if the disk refuses.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), FormatError> {
        self.out.write_all(bytes).map_err(|e| self.destination.error("writing", e))
    }

    /// Gives the file its name.
    ///
    /// # Errors
    ///
    /// As [`OutputFile::write`].
    pub fn finish(self) -> Result<(), FormatError> {
        let Self { destination, out } = self;
        let file = out.into_inner().map_err(|e| destination.error("writing", e.into_error()))?;
        destination.finish(file)
    }
}

impl Destination {
    /// A new, empty file that will be `path`, or replace it if `force` is set.
    pub fn file(path: &Path, force: bool) -> Result<(Self, File), FormatError> {
        let (target, folder) = Self::checked(path, force)?;
        remove_left_behind(&folder);
        let (temporary, file) = temporary_file(&folder, path)?;
        Ok((Self { shown: path.into(), written: path.into(), path: Some(target), temporary, force }, file))
    }

    /// Where a file of this name lies, through links, and its folder.
    fn checked(path: &Path, force: bool) -> Result<(PathBuf, PathBuf), FormatError> {
        let refuse = |reason: &str| FormatError::Unwritable { path: path.into(), reason: reason.into() };
        if path.file_name().is_none() {
            return Err(refuse("is a directory; give a file name"));
        }
        // The name alone would be written, and then could not be given.
        if path.as_os_str().as_encoded_bytes().last().is_some_and(|&b| std::path::is_separator(char::from(b))) {
            return Err(refuse("is the name of a folder; give a file name"));
        }
        // Through a link, so that the link stays one.
        let target = match fs::canonicalize(path) {
            Ok(target) => target,
            Err(_) if path.is_symlink() => return Err(refuse("is a link that leads nowhere; remove it first")),
            Err(_) => path.into(),
        };
        if belongs_to_database(&target) {
            return Err(refuse("is the name of a file that belongs to a database, such as a store; give another name"));
        }
        match fs::metadata(&target) {
            Ok(there) if there.is_dir() => return Err(refuse("is a directory; give a file name")),
            Ok(there) if !there.is_file() => {
                return Err(refuse("is not a regular file; `-o -` writes to the standard output"));
            }
            Ok(_) if !force => return Err(FormatError::AlreadyThere { path: path.into() }),
            Ok(_) if is_database(&target) => return Err(refuse(DATABASE)),
            // Its temporary name is not: it would be found when all is written.
            Err(e) if e.kind() == io::ErrorKind::InvalidFilename => {
                return Err(refuse(
                    "is no name that a file can have here: too long, or with characters that are not allowed",
                ));
            }
            _ => {}
        }
        let folder = match target.parent() {
            Some(folder) if folder != OsStr::new("") => folder.to_path_buf(),
            _ => PathBuf::from("."),
        };
        match fs::metadata(&folder) {
            Ok(there) if !there.is_dir() => return Err(refuse("its folder is not a folder")),
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                return Err(FormatError::NoFolder { path: path.into(), folder });
            }
            _ => {}
        }
        Ok((target, folder))
    }

    /// A new, empty file that will be copied to the standard output.
    pub fn standard_output() -> Result<(Self, File), FormatError> {
        let folder = std::env::temp_dir();
        let shown = PathBuf::from(super::STANDARD_OUTPUT);
        let written =
            PathBuf::from(format!("a temporary file in {} (TMPDIR) for the {}", folder.display(), shown.display()));
        let (temporary, file) = temporary_file(&folder, &written)?;
        Ok((Self { shown, written, path: None, temporary, force: false }, file))
    }

    /// A new, empty file beside this one for what is collected meanwhile; it is removed when it is dropped.
    pub fn scratch(&self) -> Result<(Self, File), FormatError> {
        let folder = self.temporary.parent().unwrap_or(Path::new("."));
        let (temporary, file) = temporary_file(folder, &self.written)?;
        let (shown, written) = (self.shown.clone(), self.written.clone());
        Ok((Self { shown, written, path: None, temporary, force: false }, file))
    }

    /// What messages call it.
    pub fn shown(&self) -> &Path {
        &self.shown
    }

    /// The error for a failed `action` on the file as it is now.
    pub fn error(&self, action: &'static str, source: io::Error) -> FormatError {
        FormatError::Io { path: self.written.clone(), action, source }
    }

    /// The error for points that this form cannot hold.
    pub fn unwritable(&self, reason: impl Into<String>) -> FormatError {
        FormatError::Unwritable { path: self.shown.clone(), reason: reason.into() }
    }

    /// Gives the complete `file` its name, or copies it to the standard output. Contents are left to the system's cache:
    /// a power cut right after may lose them.
    pub fn finish(self, mut file: File) -> Result<(), FormatError> {
        let Some(path) = &self.path else {
            file.seek(SeekFrom::Start(0)).map_err(|e| self.error("reading back", e))?;
            let mut out = io::stdout().lock();
            let copied = io::copy(&mut file, &mut out).and_then(|_| io::Write::flush(&mut out));
            return copied.map_err(|source| FormatError::Io { path: self.shown.clone(), action: "writing", source });
        };
        if !self.force && fs::symlink_metadata(path).is_ok() {
            return Err(self.unwritable("was created by someone else meanwhile; use --force to replace it"));
        }
        let renamed = fs::rename(&self.temporary, path).map_err(|e| self.error("renaming the complete file", e));
        // Locked until it has its name: nobody takes it for one that was left behind.
        drop(file);
        renamed
    }
}

impl Drop for Destination {
    fn drop(&mut self) {
        // After `finish` there is nothing under this name; otherwise the file is unfinished and nobody's.
        let _ = fs::remove_file(&self.temporary);
        unfinished().retain(|p| *p != self.temporary);
    }
}

/// Is it the name of a temporary file? Anything else is a user's.
fn is_temporary(name: &OsStr) -> bool {
    let numbers = name.to_str().and_then(|name| name.strip_prefix(".esker-")?.strip_suffix(".tmp")?.split_once('-'));
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    numbers.is_some_and(|(process, number)| is_number(process) && is_number(number))
}

/// Removes what processes that were ended hard have left in a folder: files that nobody holds locked.
fn remove_left_behind(folder: &Path) {
    // What can't be read or removed does no harm.
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten().filter(|entry| is_temporary(&entry.file_name())) {
        let path = entry.path();
        if entry.file_type().is_ok_and(|kind| kind.is_file())
            && let Ok(file) = File::open(&path)
            && file.try_lock().is_ok()
        {
            let _ = fs::remove_file(&path);
        }
    }
}

/// A new file in `folder` that no other process has; it is locked, which says that it is somebody's.
fn temporary_file(folder: &Path, shown: &Path) -> Result<(PathBuf, File), FormatError> {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    loop {
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = folder.join(format!(".esker-{}-{number}.tmp", std::process::id()));
        // Registered first, so that there is no moment in which it exists unregistered.
        unfinished().push(path.clone());
        let opened = File::options().read(true).write(true).create_new(true).open(&path);
        match opened {
            // A file system without locks has no others that would look for them.
            Ok(file) if !matches!(file.try_lock(), Err(TryLockError::WouldBlock)) && path.exists() => {
                return Ok((path, file));
            }
            // Taken for one that was left behind, between its making and its locking.
            Ok(_) => unfinished().retain(|p| *p != path),
            Err(source) => {
                unfinished().retain(|p| *p != path);
                // A process of the same number, ended hard, may have left one.
                if source.kind() != io::ErrorKind::AlreadyExists {
                    return Err(FormatError::Io { path: shown.into(), action: "creating", source });
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_left_behind_is_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let (writing, _file) = Destination::file(&at("a.las"), false).unwrap();
        let users = [".esker-notes.tmp", ".esker-1-2.tmp.txt", "esker-1-2.tmp", ".esker-1-.tmp", ".esker-1-2-3.tmp"];
        users.iter().for_each(|name| fs::write(at(name), b"mine").unwrap());
        fs::write(at(".esker-12345678-0.tmp"), b"half a file").unwrap();
        fs::create_dir(at(".esker-1-1.tmp")).unwrap();
        drop(Destination::file(&at("b.las"), false).unwrap());
        assert!(!at(".esker-12345678-0.tmp").exists() && at(".esker-1-1.tmp").exists());
        assert!(users.iter().all(|name| at(name).exists()) && writing.temporary.exists());
    }

    fn reason(result: Result<(Destination, File), FormatError>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn a_file_appears_when_it_is_finished_and_not_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.las");
        let (destination, mut file) = Destination::file(&path, false).unwrap();
        file.write_all(b"whole").unwrap();
        assert!(!path.exists());
        destination.finish(file).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn an_unfinished_file_leaves_nothing_and_the_old_one_untouched() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.las");
        fs::write(&path, b"old").unwrap();
        let (destination, mut file) = Destination::file(&path, true).unwrap();
        file.write_all(b"half").unwrap();
        drop((destination, file));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn an_existing_file_needs_force() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.las");
        fs::write(&path, b"old").unwrap();
        assert!(reason(Destination::file(&path, false)).contains("--force"));
        let (destination, mut file) = Destination::file(&path, true).unwrap();
        file.write_all(b"new").unwrap();
        destination.finish(file).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
    }

    #[test]
    fn a_file_that_appears_meanwhile_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.las");
        let (destination, file) = Destination::file(&path, false).unwrap();
        fs::write(&path, b"theirs").unwrap();
        assert!(destination.finish(file).unwrap_err().to_string().contains("--force"));
        assert_eq!(fs::read(&path).unwrap(), b"theirs");
    }

    #[test]
    fn places_that_hold_no_file_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert!(reason(Destination::file(folder.path(), true)).contains("is a directory"));
        assert!(reason(Destination::file(Path::new("/"), true)).contains("is a directory"));
        assert!(reason(Destination::file(&folder.path().join("a.las/"), true)).contains("is the name of a folder"));
        assert!(reason(Destination::file(&folder.path().join("no/a.las"), true)).contains("does not exist"));
        let file = folder.path().join("file");
        fs::write(&file, b"").unwrap();
        assert!(Destination::file(&file.join("a.las"), true).is_err());
        #[cfg(unix)]
        assert!(reason(Destination::file(Path::new("/dev/null"), true)).contains("not a regular file"));
    }

    #[test]
    fn files_that_belong_to_a_store_are_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(path("a.esker"), b"SQLite format 3\0 and more").unwrap();
        fs::write(path("a.esker-wal"), b"its log").unwrap();
        // Those that are not there would be taken for the store's own, too.
        for name in ["a.esker-wal", "a.esker-shm", "a.esker-journal", "a.esker-lock"] {
            assert!(reason(Destination::file(&path(name), true)).contains("belongs to a database"), "{name}");
            assert!(is_database(&path(name)), "{name}");
        }
        fs::write(path("b"), b"no database").unwrap();
        for name in ["b-wal", "c.esker-wal", "-wal"] {
            Destination::file(&path(name), true).unwrap();
        }
    }

    #[test]
    fn a_place_is_known_by_one_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("below")).unwrap();
        let place = |name: &str| check_output(&path(name), true).unwrap();
        assert_eq!(place("a.csv"), place("below/../a.csv"));
        assert!(place("a.csv") != place("below/a.csv") && place("a.csv") != place("b.csv"));
        fs::write(path("a.csv"), b"old").unwrap();
        assert_eq!(place("a.csv"), place("below/../a.csv"));
        assert!(matches!(check_output(&path("a.csv"), false), Err(FormatError::AlreadyThere { .. })));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_that_leads_nowhere_is_refused_at_once() {
        // It was found when all was written: somebody else was said to have created it.
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("a.las");
        std::os::unix::fs::symlink(folder.path().join("nowhere"), &link).unwrap();
        for force in [false, true] {
            assert!(reason(Destination::file(&link, force)).contains("leads nowhere"));
        }
        assert!(link.is_symlink());
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        fs::write(&real, b"old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        let (destination, mut file) = Destination::file(&link, true).unwrap();
        file.write_all(b"new").unwrap();
        destination.finish(file).unwrap();
        assert_eq!(fs::read(&real).unwrap(), b"new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    }
}
