//! Read connections of one snapshot, all on its generation.
//!
//! A read transaction that is held keeps SQLite's log from being reused, so the transactions are renewed often: a new
//! one is opened on a spare connection, its generation is compared, and only then the old one is closed. From the moment
//! that a newer generation is found the old transactions are kept until the snapshot is dropped.

use super::error::{RowError, StoreError};
use super::place::{FilePlace, Place, lock};
use super::rows::load_generation;
use rusqlite::Connection;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

/// A transaction is renewed when it is older than this. Well below the time for which the writer waits for readers
/// when it wants the log reused.
const RENEW_AFTER: Duration = Duration::from_millis(100);

/// The most connections of one snapshot.
const MOST: usize = 8;

/// The connections of a snapshot of a store in a file.
#[derive(Debug)]
pub(super) struct Lanes {
    place: Arc<Place>,
    generation: u64,
    renews: bool,
    state: Mutex<State>,
    returned: Condvar,
    /// Taken while a renewal is going on.
    spare: Mutex<Option<Connection>>,
    /// A newer generation was seen.
    overtaken: AtomicBool,
}

#[derive(Debug, Default)]
struct State {
    idle: Vec<Lane>,
    open: usize,
}

/// A connection in a read transaction on the snapshot's generation.
#[derive(Debug)]
struct Lane {
    connection: Connection,
    since: Instant,
}

fn file(place: &Place) -> Option<&FilePlace> {
    match place {
        Place::File(file) => Some(file),
        Place::Memory(_) => None,
    }
}

/// Begins a read transaction and reads the generation that it sees.
fn begin(connection: &Connection) -> Result<u64, RowError> {
    connection.execute_batch("BEGIN")?;
    load_generation(connection)
}

/// Ends a read transaction.
fn end(connection: &Connection) {
    // One that can't be ended ends with its connection.
    let _ = connection.execute_batch("ROLLBACK");
}

impl Lanes {
    /// With one connection, which is in a read transaction that sees `generation`. Of generation 0 there is nothing to read but
    /// bookmarks and what `verify` looks at, so no transaction is held, which would keep a first filling of the store waiting.
    pub fn new(place: Arc<Place>, connection: Connection, generation: u64, renews: bool) -> Arc<Self> {
        let renews = renews && generation > 0;
        if generation == 0 {
            end(&connection);
        }
        let lane = Lane { connection, since: Instant::now() };
        let lanes = Arc::new(Self {
            place,
            generation,
            renews,
            state: Mutex::new(State { idle: vec![lane], open: 1 }),
            returned: Condvar::new(),
            spare: Mutex::new(None),
            overtaken: AtomicBool::new(false),
        });
        if renews {
            let weak = Arc::downgrade(&lanes);
            // Without the thread an idle snapshot would only make the log grow: not worth failing for.
            let _ = std::thread::Builder::new().name("esker-renew".into()).spawn(move || keep_renewing(&weak));
        }
        lanes
    }

    /// Runs `read` on a connection that sees the snapshot's generation.
    pub fn with<R>(&self, read: impl FnOnce(&Connection) -> Result<R, RowError>) -> Result<R, StoreError> {
        self.with_lane(false, read)
    }

    /// The same, for what changes without a new generation: reads what is there now, as long as that is the newest one.
    pub fn with_renewed<R>(&self, read: impl FnOnce(&Connection) -> Result<R, RowError>) -> Result<R, StoreError> {
        self.with_lane(self.renews, read)
    }

    fn with_lane<R>(
        &self,
        renewed: bool,
        read: impl FnOnce(&Connection) -> Result<R, RowError>,
    ) -> Result<R, StoreError> {
        let mut guard = Guard { lanes: self, lane: Some(self.take()?) };
        let Some(lane) = guard.lane.as_mut() else { return Err(StoreError::Busy { path: self.place.path().into() }) };
        if renewed {
            self.renew(lane);
        }
        let result = match self.generation {
            // What the snapshot knows itself is not asked for; of anything else all that is read is of one generation at least.
            0 => begin(&lane.connection).and_then(|_| {
                let result = read(&lane.connection);
                end(&lane.connection);
                result
            }),
            _ => read(&lane.connection),
        };
        let result = result.map_err(|e| self.place.error(e));
        // Before what was read is believed, or its error.
        if let Some(file) = file(&self.place) {
            file.check_untouched()?;
        }
        if self.renews && lane.since.elapsed() > RENEW_AFTER {
            self.renew(lane);
        }
        result
    }

    /// Has a newer generation been seen?
    pub fn is_overtaken(&self) -> bool {
        self.overtaken.load(Ordering::Relaxed)
    }

    fn take(&self) -> Result<Lane, StoreError> {
        let mut state = lock(&self.state);
        loop {
            if let Some(lane) = state.idle.pop() {
                return Ok(lane);
            }
            if state.open < MOST && (!self.is_overtaken() || state.open == 0) {
                state.open += 1;
                drop(state);
                let another = self.open_another();
                if let Ok(Some(lane)) = another {
                    return Ok(lane);
                }
                state = lock(&self.state);
                state.open -= 1;
                if state.open == 0 {
                    // Nothing is left that could be waited for.
                    another?;
                    return Err(StoreError::Busy { path: self.place.path().into() });
                }
            }
            if state.idle.is_empty() {
                state = self.returned.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        }
    }

    /// One more connection; none if the generation has passed.
    fn open_another(&self) -> Result<Option<Lane>, StoreError> {
        let Some(file) = file(&self.place) else { return Ok(None) };
        let connection = file.connect()?;
        match begin(&connection) {
            Ok(generation) if generation == self.generation => {
                if generation == 0 {
                    end(&connection);
                }
                Ok(Some(Lane { connection, since: Instant::now() }))
            }
            result => {
                file.give_back(connection);
                result.map_err(|e| self.place.error(e))?;
                self.overtaken.store(true, Ordering::Relaxed);
                Ok(None)
            }
        }
    }

    /// Moves a lane to a new transaction if that sees the same generation; else, or if it can't be had, the lane stays
    /// as it is.
    fn renew(&self, lane: &mut Lane) {
        if self.is_overtaken() {
            return;
        }
        let Some(file) = file(&self.place) else { return };
        let Ok(mut spare) = self.spare.try_lock() else { return };
        let Some(fresh) = spare.take().or_else(|| file.connect().ok()) else { return };
        match begin(&fresh) {
            Ok(generation) if generation == self.generation => {
                let old = std::mem::replace(lane, Lane { connection: fresh, since: Instant::now() });
                if old.connection.execute_batch("ROLLBACK").is_ok() {
                    *spare = Some(old.connection);
                }
            }
            Ok(_) => {
                self.overtaken.store(true, Ordering::Relaxed);
                file.give_back(fresh);
            }
            Err(_) => file.give_back(fresh),
        }
    }

    /// Renews the idle lanes that are due.
    fn renew_idle(&self) {
        let now = Instant::now();
        loop {
            let mut guard = {
                let mut state = lock(&self.state);
                let due = state.idle.iter().position(|l| now.saturating_duration_since(l.since) > RENEW_AFTER / 2);
                let Some(due) = due else { return };
                Guard { lanes: self, lane: Some(state.idle.swap_remove(due)) }
            };
            let Some(lane) = guard.lane.as_mut() else { return };
            self.renew(lane);
            if lane.since < now {
                // Overtaken, or the spare is in use elsewhere: later again.
                return;
            }
        }
    }
}

/// Renews until the lanes are gone or overtaken.
fn keep_renewing(lanes: &Weak<Lanes>) {
    loop {
        std::thread::sleep(RENEW_AFTER);
        match lanes.upgrade() {
            Some(lanes) if !lanes.is_overtaken() => lanes.renew_idle(),
            _ => return,
        }
    }
}

/// Gives a lane back, also on a panic.
struct Guard<'a> {
    lanes: &'a Lanes,
    lane: Option<Lane>,
}

impl Drop for Guard<'_> {
    fn drop(&mut self) {
        if let Some(lane) = self.lane.take() {
            lock(&self.lanes.state).idle.push(lane);
            self.lanes.returned.notify_one();
        }
    }
}

impl Drop for Lanes {
    fn drop(&mut self) {
        let Some(file) = file(&self.place) else { return };
        let idle = std::mem::take(&mut lock(&self.state).idle);
        let spare = lock(&self.spare).take();
        idle.into_iter().map(|l| l.connection).chain(spare).for_each(|c| file.give_back(c));
    }
}
