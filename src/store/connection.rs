//! How SQLite is opened: flags, pragmas, schema, and the checks that the file is a store of ours.

use super::error::{RowError, StoreError};
use super::files::{beside, has_journal, uri, wal_bytes};
use super::interrupt::{is_busy, patiently};
use super::rows::{SiteRow, load_site};
use super::untouched::Untouched;
use rusqlite::config::DbConfig;
use rusqlite::{Connection, ErrorCode, OpenFlags};
use std::path::Path;
use std::time::Duration;

/// `Eskr`: SQLite's field for what kind of file this is.
pub const APPLICATION_ID: i32 = 0x4573_6b72;

/// The schema's versions: the i-th script leads from version i to i + 1.
const MIGRATIONS: &[&str] = &[include_str!("../../migrations/0001.sql")];

/// Chosen by the overhead measured on real chunks (docs/format.md).
const PAGE_BYTES: u32 = 2048;

/// How long SQLite waits for a lock of another process.
pub(super) const PATIENCE: Duration = Duration::from_secs(5);

/// How often it is tried to leave the log: readers of this process may just be closing.
const TRIES_ALONE: usize = 5;

/// How often a log that seems to be another file's is looked at, while what is there changes.
const LOOKS: usize = 20;

/// How long between tries and looks.
const TRY_AGAIN: Duration = Duration::from_millis(10);

/// How long a first filling waits for a reader. Readers stay for moments; more than that, and hours of work would be lost.
pub(super) const PATIENCE_WITHOUT_LOG: Duration = Duration::from_secs(60);

/// What a connection is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    /// Reading; may repair after a crash where the place can be written.
    Read,
    /// Reading a medium that nobody can write.
    Immutable,
    /// Writing.
    Write,
}

/// Opens the file, without looking at what it holds.
fn open_raw(path: &Path, purpose: Purpose) -> Result<Connection, RowError> {
    let connection = connect(path, purpose)?;
    prepare(&connection, purpose)?;
    Ok(connection)
}

fn connect(path: &Path, purpose: Purpose) -> Result<Connection, RowError> {
    let parameters = match purpose {
        Purpose::Read | Purpose::Write => "mode=rw",
        Purpose::Immutable => "mode=ro&immutable=1",
    };
    let flags = match purpose {
        Purpose::Read | Purpose::Write => OpenFlags::SQLITE_OPEN_READ_WRITE,
        Purpose::Immutable => OpenFlags::SQLITE_OPEN_READ_ONLY,
    } | OpenFlags::SQLITE_OPEN_URI
        | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    Ok(Connection::open_with_flags(uri(path, parameters), flags)?)
}

fn prepare(connection: &Connection, purpose: Purpose) -> Result<(), RowError> {
    connection.busy_timeout(PATIENCE)?;
    connection.set_prepared_statement_cache_capacity(64);
    // A schema that was tampered with must not run anything of its own.
    connection.pragma_update(None, "trusted_schema", false)?;
    // Cells are checked as pages are read: damage is found before it is followed.
    connection.pragma_update(None, "cell_size_check", true)?;
    connection.pragma_update(None, "mmap_size", 0)?;
    match purpose {
        Purpose::Write => {
            connection.pragma_update(None, "cache_size", -16 * 1024)?;
            connection.pragma_update(None, "wal_autocheckpoint", 0)?;
        }
        Purpose::Read | Purpose::Immutable => {
            connection.pragma_update(None, "cache_size", -8 * 1024)?;
            connection.pragma_update(None, "query_only", true)?;
        }
    }
    Ok(())
}

/// Leaves the log for a rollback journal, if nobody else has the file open; says if it did.
///
/// Pages are then written when a transaction ends and not before, so readers that come later wait no longer than that.
pub(super) fn leave_log(connection: &Connection) -> Result<bool, RowError> {
    for _ in 0..TRIES_ALONE {
        let mode = connection.query_row("PRAGMA journal_mode = DELETE", [], |row| row.get::<_, String>(0));
        match mode {
            Ok(mode) if mode == "delete" => {
                connection.pragma_update(None, "cache_spill", false)?;
                connection.busy_timeout(PATIENCE_WITHOUT_LOG)?;
                return Ok(true);
            }
            // Not as long as there is another connection.
            Ok(_) => {}
            Err(e) if is_busy(&e) => {}
            Err(e) => return Err(e.into()),
        }
        std::thread::sleep(TRY_AGAIN);
    }
    Ok(false)
}

/// Back to the log; waits for readers, unless `stop` says so.
pub(super) fn enter_log(connection: &Connection, stop: &dyn Fn() -> bool) -> Result<(), RowError> {
    const ENTER: &str = "PRAGMA journal_mode = WAL";
    patiently(connection, PATIENCE_WITHOUT_LOG, stop, ENTER)?;
    let mode: String = connection.query_row(ENTER, [], |row| row.get(0))?;
    connection.pragma_update(None, "cache_spill", true)?;
    connection.busy_timeout(PATIENCE)?;
    if mode == "wal" { Ok(()) } else { Err(RowError::Inconsistent("the file can't go back to its log".into())) }
}

/// Why a store was not opened.
pub(super) enum Refused {
    /// The place does not let SQLite do what it needs: no file can be made beside the store.
    Place,
    /// There is no room for what SQLite needs beside the store.
    Full,
    /// Anything else.
    Store(StoreError),
}

impl Refused {
    /// With the path of the store.
    pub fn at(self, path: &Path) -> StoreError {
        match self {
            Self::Place => StoreError::ReadOnly { path: path.to_path_buf() },
            Self::Full => StoreError::Full { path: path.to_path_buf() },
            Self::Store(e) => e,
        }
    }

    fn of(error: RowError, path: &Path) -> Self {
        match error {
            RowError::Sqlite(rusqlite::Error::SqliteFailure(e, _))
                if matches!(e.code, ErrorCode::CannotOpen | ErrorCode::ReadOnly) =>
            {
                Self::Place
            }
            e => match e.at(path) {
                StoreError::Full { .. } => Self::Full,
                e => Self::Store(e),
            },
        }
    }
}

/// Opens a store and checks that it is one of a known version.
pub(super) fn open(path: &Path, purpose: Purpose) -> Result<Connection, Refused> {
    let opened = try_open(path, purpose);
    if matches!(opened, Err(Refused::Full)) && wal_bytes(path) == 0 {
        remove_index(path);
    }
    opened
}

fn try_open(path: &Path, purpose: Purpose) -> Result<Connection, Refused> {
    let refused = |e: RowError| Refused::of(e, path);
    if purpose != Purpose::Immutable && has_journal(path) {
        check_journal(path).map_err(Refused::Store)?;
    }
    let connection = open_raw(path, purpose).map_err(refused)?;
    check_kind(&connection, path)?;
    if purpose == Purpose::Write {
        let mode: String =
            connection.query_row("PRAGMA journal_mode = WAL", [], |row| row.get(0)).map_err(|e| refused(e.into()))?;
        if mode != "wal" {
            return Err(Refused::Place);
        }
        migrate(&connection).map_err(refused)?;
    }
    Ok(connection)
}

/// Opens a store for reading, as usual or as a medium that nobody can write, whichever works; of the latter with what must
/// stay as it is.
pub(super) fn open_for_reading(path: &Path) -> Result<(Connection, Option<Untouched>), StoreError> {
    let path_buf = || path.to_path_buf();
    let facts = std::fs::metadata(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory => StoreError::NotThere { path: path_buf() },
        _ => StoreError::Io { path: path_buf(), action: "looking at the store", source },
    })?;
    if facts.is_dir() {
        return Err(StoreError::Directory { path: path_buf() });
    }
    if facts.len() == 0 {
        return Err(StoreError::NotAStore { path: path_buf(), found: "the file is empty".into() });
    }
    let had_wal = wal_bytes(path) > 0;
    if had_wal {
        check_wal(path)?;
    }
    // Beside a file that this user may not write SQLite would leave a log and its index, which then the owner may not write.
    let is_anothers = !had_wal && !has_journal(path) && !beside(path, "-shm").exists() && may_not_write(path);
    let opened = if is_anothers { Err(Refused::Place) } else { open(path, Purpose::Read) };
    if matches!(opened, Err(Refused::Place)) {
        check_readable(path)?;
    }
    match opened {
        // No shared memory can be made beside it.
        Err(Refused::Place) if had_wal || has_journal(path) => Err(StoreError::NeedsRecovery { path: path_buf() }),
        Err(Refused::Full) if had_wal || has_journal(path) => Err(StoreError::Full { path: path_buf() }),
        Err(Refused::Place | Refused::Full) => {
            let untouched = Untouched::of(path)?;
            let connection = open(path, Purpose::Immutable).map_err(|e| e.at(path))?;
            untouched.check(path)?;
            Ok((connection, Some(untouched)))
        }
        Err(e) => Err(e.at(path)),
        Ok(connection) => Ok((connection, None)),
    }
}

/// Has this user no permission to write the file? It is not opened to see: closed, it would lose the locks that this process has
/// on it.
fn may_not_write(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use rustix::fs::{Access, AtFlags, CWD, accessat};
        accessat(CWD, path, Access::WRITE_OK, AtFlags::EACCESS) == Err(rustix::io::Errno::ACCESS)
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        false
    }
}

/// Can the file be opened at all? If not, it is no matter of writing.
fn check_readable(path: &Path) -> Result<(), StoreError> {
    // By SQLite first: a file that is opened and closed beside it loses the locks that this process has on it.
    if connect(path, Purpose::Immutable).is_ok() {
        return Ok(());
    }
    let failed = |source| StoreError::Io { path: path.to_path_buf(), action: "reading the store", source };
    std::fs::File::open(path).map(drop).map_err(failed)
}

/// Removes the beginning of an index of the log, which SQLite leaves where there is no room for all of it.
fn remove_index(path: &Path) {
    let alone = || {
        let connection = connect(path, Purpose::Read)?;
        connection.busy_timeout(Duration::ZERO)?;
        // Then SQLite needs no index, and takes the file for itself as soon as it reads it.
        connection.pragma_update(None, "locking_mode", "EXCLUSIVE")?;
        load_site(&connection).map(|_| connection)
    };
    // Whoever has an index open has the file locked too: it is removed from under nobody. What can't be removed does no harm.
    if let Ok(_alone) = alone() {
        let _ = std::fs::remove_file(beside(path, "-shm"));
    }
}

/// A log that is not of this file, in this state, must not be taken for its own: SQLite would apply it without a word.
///
/// Reads the site's row once without the log and once with it, and applies nothing.
fn check_wal(path: &Path) -> Result<(), StoreError> {
    let site = |purpose| {
        let connection = connect(path, purpose)?;
        // First of all: what comes next may fail on what the log says.
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
        prepare(&connection, purpose)?;
        load_site(&connection)
    };
    let mut before = None;
    for _ in 0..LOOKS {
        let with = match site(Purpose::Read) {
            Ok(row) => Some(row),
            Err(e) if e.is_damage() => None,
            Err(_) => return Ok(()),
        };
        // While a checkpoint is running this view may be torn: then there is a live writer, and the log is its own.
        let Ok(without) = site(Purpose::Immutable) else { return Ok(()) };
        let is_own = |with: &SiteRow| with.store_id == without.store_id && with.log.can_follow(without.log);
        if with.as_ref().is_some_and(is_own) {
            return Ok(());
        }
        // Between the looks a live writer may have begun one log after the other, but not the same ones again.
        let found = Some((with, without));
        if found == before {
            return Err(StoreError::ForeignWal { path: path.to_path_buf() });
        }
        before = found;
        std::thread::sleep(TRY_AGAIN);
    }
    Ok(())
}

/// A journal that a deleted store left must not be taken for this one's: SQLite would undo what it says. There is one only
/// before the first commit of a store, which may just be happening.
fn check_journal(path: &Path) -> Result<(), StoreError> {
    match open_raw(path, Purpose::Immutable).and_then(|c| load_site(&c)) {
        Ok(row) if row.site.generation > 0 && has_journal(path) => {
            Err(StoreError::ForeignJournal { path: path.to_path_buf() })
        }
        _ => Ok(()),
    }
}

/// Is there nothing in the database, as when its making was cut off?
fn is_blank(connection: &Connection) -> Result<bool, RowError> {
    let number = |sql: &str| connection.query_row(sql, [], |row| row.get::<_, i64>(0));
    let tables = number("SELECT count(*) FROM sqlite_schema")?;
    Ok(tables == 0 && number("PRAGMA user_version")? == 0 && number("PRAGMA application_id")? == 0)
}

/// Is this file what remains of a store whose making was cut off: nothing at all?
pub(super) fn is_unfinished(path: &Path) -> bool {
    match std::fs::metadata(path) {
        Ok(facts) if facts.is_file() && facts.len() == 0 => true,
        // What was cut off has no log, and never had a commit. Looked at without its log and its journal first: those of
        // another store, applied by opening it, would destroy a whole one.
        Ok(facts) if facts.is_file() => {
            let committed = |c: Connection| load_site(&c).map(|row| row.site.generation > 0);
            if wal_bytes(path) > 0 || open_raw(path, Purpose::Immutable).and_then(committed).unwrap_or(false) {
                return false;
            }
            // Opening it rolls back what was half done.
            open_raw(path, Purpose::Read).and_then(|c| is_blank(&c)).unwrap_or(false)
        }
        _ => false,
    }
}

/// Is it a store, of a version that this program knows?
fn check_kind(connection: &Connection, path: &Path) -> Result<(), Refused> {
    let pragma = |name: &str| {
        let value = connection.query_row(&format!("PRAGMA {name}"), [], |row| row.get::<_, i64>(0));
        value.map_err(|e| Refused::of(e.into(), path))
    };
    let kind = pragma("application_id")?;
    if kind == 0 && is_blank(connection).unwrap_or(false) {
        let found = "it is empty, since its making was cut off; the command that makes it can be given again".into();
        return Err(Refused::Store(StoreError::NotAStore { path: path.to_path_buf(), found }));
    }
    if kind != i64::from(APPLICATION_ID) {
        let found = "it is an SQLite database of another program".into();
        return Err(Refused::Store(StoreError::NotAStore { path: path.to_path_buf(), found }));
    }
    let found = pragma("user_version")?;
    let known = MIGRATIONS.len() as i64;
    match found {
        v if (1..=known).contains(&v) => Ok(()),
        v if v > known => Err(Refused::Store(StoreError::Newer { path: path.to_path_buf(), found, known })),
        _ => Err(Refused::of(RowError::damage("SQLite", "header", format!("the version is {found}")), path)),
    }
}

/// Brings the schema to the newest version, one transaction a step.
fn migrate(connection: &Connection) -> Result<(), RowError> {
    let version: i64 = connection.query_row("PRAGMA user_version", [], |row| row.get(0))?;
    for (i, script) in MIGRATIONS.iter().enumerate().skip(usize::try_from(version).unwrap_or(0)) {
        let transaction = connection.unchecked_transaction()?;
        transaction.execute_batch(script)?;
        transaction.pragma_update(None, "user_version", i as i64 + 1)?;
        transaction.commit()?;
    }
    Ok(())
}

/// Makes the empty database at `path`, an empty file, or in memory; `fill` writes the first rows in the same
/// transaction as the schema.
pub(super) fn create(
    path: Option<&Path>,
    fill: impl FnOnce(&Connection) -> Result<(), RowError>,
) -> Result<Connection, RowError> {
    let connection = match path {
        Some(path) => open_raw(path, Purpose::Write)?,
        None => {
            let connection = Connection::open_in_memory()?;
            prepare(&connection, Purpose::Write)?;
            connection
        }
    };
    connection.pragma_update(None, "page_size", PAGE_BYTES)?;
    connection.pragma_update(None, "auto_vacuum", "INCREMENTAL")?;
    connection.pragma_update(None, "synchronous", "FULL")?;
    // Everything at once and under a rollback journal: a crash leaves an empty file or a whole store.
    let transaction = connection.unchecked_transaction()?;
    for script in MIGRATIONS {
        transaction.execute_batch(script)?;
    }
    fill(&transaction)?;
    transaction.pragma_update(None, "user_version", MIGRATIONS.len() as i64)?;
    transaction.pragma_update(None, "application_id", APPLICATION_ID)?;
    transaction.commit()?;
    if path.is_some() {
        connection.query_row("PRAGMA journal_mode = WAL", [], |row| row.get::<_, String>(0))?;
    }
    Ok(connection)
}
