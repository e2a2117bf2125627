//! The task that owns the flash, and the requests of other tasks to it.

use core::{
    cell::RefCell,
    sync::atomic::{AtomicU32, Ordering},
};

use embassy_futures::select::{Either, select};
use embassy_sync::{
    blocking_mutex::{Mutex as Locked, raw::RawMutex},
    channel::Channel,
    mutex::Mutex,
    signal::Signal,
};
use embassy_time::{Duration, with_timeout};
use embedded_storage_async::nor_flash::NorFlash;
use heapless::Vec;
use r4_protocol::{Causes, FaultInfo, FaultSnapshot, MotorSnapshot, Refusal};

use super::{
    faults::{History, Recorder, Trip},
    parameters::{self, Changes},
};

/// Number of trips that can wait to be written.
const WAITING: usize = 2;

/// Longest wait for an answer: a damaged log is erased and restarted, which takes the STM32H747 up to 2 s per sector,
/// and a trip may have to be written first, at the same cost.
const PATIENCE: Duration = Duration::from_secs(10);

/// Job that a link requests.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "there is no heap, and one job at a time")]
pub enum Job {
    /// Save these changes, all or none. Empty changes restore the built-in values.
    ///
    /// May erase a sector. The caller must ensure that the board is disarmed.
    Save(Changes),
    /// Read a trip, 0 being the newest.
    Fault {
        /// Index of the trip.
        index: u8,
    },
    /// Read a snapshot of the board before a trip.
    Snapshot {
        /// Index of the trip, 0 being the newest.
        index: u8,
        /// Index of its snapshot, 0 being the oldest.
        snapshot: u8,
    },
}

/// Result of a [`Job`].
#[derive(Clone, Debug, PartialEq)]
pub enum Done {
    /// Result of a [`Job::Save`].
    Saved,
    /// Result of a [`Job::Fault`].
    Fault(FaultInfo),
    /// Result of a [`Job::Snapshot`].
    Snapshot(FaultSnapshot),
}

/// State that the task which owns the flash shares with the others. Takes 4.5 KiB.
pub struct Storage<M: RawMutex> {
    /// Lock for the job under way, and the number of the latest one: a late answer to an abandoned job has an older
    /// number.
    turn: Mutex<M, u32>,
    job: Signal<M, (u32, Job)>,
    done: Signal<M, (u32, Result<Done, Refusal>)>,
    moments: Locked<M, RefCell<Recorder>>,
    /// Times, µs, and causes of trips that are waiting to be written.
    trips: Channel<M, (u64, Causes), WAITING>,
    lost: AtomicU32,
}

impl<M: RawMutex> Storage<M> {
    /// Creates the state without any job.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            turn: Mutex::new(0),
            job: Signal::new(),
            done: Signal::new(),
            moments: Locked::new(RefCell::new(Recorder::new())),
            trips: Channel::new(),
            lost: AtomicU32::new(0),
        }
    }

    /// Carries out `job`, after those requested before.
    ///
    /// # Errors
    /// [`Refusal::NoSuchFault`] for an index beyond the last; [`Refusal::StorageFailed`] for a failure of the flash, or
    /// when [`run`] does not answer in time: a save may then still succeed.
    pub async fn request(&self, job: Job) -> Result<Done, Refusal> {
        let work = async {
            let mut turn = self.turn.lock().await;
            *turn = turn.wrapping_add(1);
            self.job.signal((*turn, job));
            loop {
                let (number, result) = self.done.wait().await;
                if number == *turn {
                    return result;
                }
            }
        };
        with_timeout(PATIENCE, work).await.unwrap_or(Err(Refusal::StorageFailed))
    }

    /// Takes a snapshot of the board: see [`Recorder::note`].
    pub fn note(
        &self,
        device_us: u64,
        motors: impl IntoIterator<Item = MotorSnapshot>,
        supplies_v: impl IntoIterator<Item = f32>,
    ) {
        self.with_moments(|moments| moments.note(device_us, motors, supplies_v));
    }

    /// Queues a trip at `device_us` to be written with the snapshots before it; never waits. Without room the trip is
    /// counted as lost.
    pub fn trip(&self, device_us: u64, causes: Causes) {
        // [`run`] copies the snapshots: copying all of them at once takes more than a control period's share of the
        // processor.
        self.with_moments(Recorder::freeze);
        if self.trips.try_send((device_us, causes)).is_err() {
            self.with_moments(Recorder::thaw);
            self.count_lost();
        }
    }

    fn with_moments<T>(&self, f: impl FnOnce(&mut Recorder) -> T) -> T {
        self.moments.lock(|moments| f(&mut moments.borrow_mut()))
    }

    /// Assembles the trip with its frozen snapshots, one at a time, and ends the freeze.
    fn made(&self, device_us: u64, causes: Causes) -> Trip {
        let snapshot = |index| self.with_moments(|moments| moments.snapshot(index, device_us));
        let mut trip = Trip { device_us, causes, snapshots: Vec::new() };
        while let Some(snapshot) = snapshot(trip.snapshots.len()) {
            if trip.snapshots.push(snapshot).is_err() {
                break;
            }
        }
        self.with_moments(Recorder::thaw);
        trip
    }

    /// Number of trips since the start of the board that could not be written.
    #[must_use]
    pub fn lost(&self) -> u32 {
        self.lost.load(Ordering::Relaxed)
    }

    fn count_lost(&self) {
        self.lost.fetch_add(1, Ordering::Relaxed);
    }
}

impl<M: RawMutex> Default for Storage<M> {
    fn default() -> Self {
        Self::new()
    }
}

/// Owns `flash`: writes trips, and carries out the requests of `storage`. `built_in_robot` is the name of the robot
/// that the firmware was built for. Must have a lower priority than every other task. Its state takes 18 KiB.
pub async fn run<M: RawMutex, F: NorFlash>(storage: &Storage<M>, mut flash: F, built_in_robot: &str) -> ! {
    let mut history = History::open(&mut flash).await;
    loop {
        match select(storage.trips.receive(), storage.job.wait()).await {
            Either::First((device_us, causes)) => {
                let trip = storage.made(device_us, causes);
                if history.record(&mut flash, &trip).await.is_err() {
                    storage.count_lost();
                }
            }
            Either::Second((number, job)) => {
                let result = serve(&mut history, &mut flash, built_in_robot, job).await;
                storage.done.signal((number, result));
            }
        }
    }
}

async fn serve<F: NorFlash>(
    history: &mut History,
    flash: &mut F,
    built_in_robot: &str,
    job: Job,
) -> Result<Done, Refusal> {
    let found = match job {
        Job::Save(changes) => parameters::save(flash, built_in_robot, &changes).await.map(|()| Some(Done::Saved)),
        Job::Fault { index } => history.fault(flash, index).await.map(|fault| fault.map(Done::Fault)),
        Job::Snapshot { index, snapshot } => {
            history.snapshot(flash, index, snapshot).await.map(|snapshot| snapshot.map(Done::Snapshot))
        }
    };
    found.map_err(|_| Refusal::StorageFailed)?.ok_or(Refusal::NoSuchFault)
}
