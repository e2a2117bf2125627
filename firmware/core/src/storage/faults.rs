//! Fault history: trips, each with snapshots of the board before it.
//!
//! [`Recorder`] is a ring in memory that the control loop feeds; a trip freezes it, until the task that owns the flash
//! has copied it. In flash a trip is one item:
//!
//! ```text
//! layout: u8 | FaultInfo | FaultSnapshot, oldest first | FaultSnapshot ...
//! ```
//!
//! With eight motors and four supplies an item has at most 2525 bytes, so that a sector of 128 KiB holds 47 trips: more
//! than [`HISTORY`], so they outlive the erase of the other sector. Two sectors of 10 000 erases then last for 900 000
//! trips.

use embedded_storage_async::nor_flash::NorFlash;
use heapless::{Deque, Vec};
use r4_protocol::{
    Causes, FaultInfo, FaultSnapshot, MotorSnapshot,
    config::{MAX_MOTORS, MAX_SUPPLIES},
};

use super::{
    log::{StorageError, fault_log},
    words::DATA_BYTES,
};

/// Maximum number of trips that a host can read.
pub const HISTORY: u16 = 32;
/// Maximum number of snapshots of one trip.
pub const SNAPSHOTS: usize = 20;
/// Interval between two snapshots, ms: together they cover 200 ms before the trip.
pub const SNAPSHOT_MS: u16 = 10;

/// Layout version that this firmware writes. Trips in another layout are left out of the history.
const LAYOUT: u8 = 1;
/// Maximum size of a [`FaultInfo`], bytes: two `u32`, a `u64`, a `u16` and a `u8`, each seven bits to a byte.
const MAX_INFO: usize = 5 + 5 + 10 + 5 + 1;
/// Maximum size of a [`FaultSnapshot`], bytes: time; motors, each an `i32` in seven bits to a byte and two `f32`;
/// supplies.
const MAX_SNAPSHOT: usize = 3 + 1 + MAX_MOTORS * (5 + 4 + 4) + 1 + MAX_SUPPLIES * 4;
const MAX_ITEM: usize = 1 + MAX_INFO + SNAPSHOTS * MAX_SNAPSHOT;
const BUFFER: usize = MAX_ITEM.next_multiple_of(DATA_BYTES);

/// Trip that has not been written yet.
#[derive(Clone, Debug, PartialEq)]
pub struct Trip {
    /// Time since the board started, µs.
    pub device_us: u64,
    /// All causes seen until now.
    pub causes: Causes,
    /// Snapshots from the oldest to the newest.
    pub snapshots: Vec<FaultSnapshot, SNAPSHOTS>,
}

/// Ring of the latest snapshots, in memory. Takes 2.7 KiB.
#[derive(Clone, Debug, Default)]
pub struct Recorder {
    moments: Deque<Moment, SNAPSHOTS>,
    /// Number of trips that still have to be copied from it.
    frozen: usize,
}

#[derive(Clone, Debug)]
struct Moment {
    device_us: u64,
    /// Snapshot whose time before the trip is not known yet.
    snapshot: FaultSnapshot,
}

impl Recorder {
    /// Creates an empty recorder.
    #[must_use]
    pub const fn new() -> Self {
        Self { moments: Deque::new(), frozen: 0 }
    }

    /// Takes a snapshot of the board; call it every [`SNAPSHOT_MS`]. The oldest of [`SNAPSHOTS`] is dropped. While
    /// frozen nothing is taken.
    pub fn note(
        &mut self,
        device_us: u64,
        motors: impl IntoIterator<Item = MotorSnapshot>,
        supplies_v: impl IntoIterator<Item = f32>,
    ) {
        if self.frozen > 0 {
            return;
        }
        if self.moments.is_full() {
            self.moments.pop_front();
        }
        let motors = motors.into_iter().take(MAX_MOTORS).collect();
        let supplies_v = supplies_v.into_iter().take(MAX_SUPPLIES).collect();
        // There is always room: one was dropped, or the ring is not full.
        let snapshot = FaultSnapshot { before_ms: 0, motors, supplies_v };
        let _ = self.moments.push_back(Moment { device_us, snapshot });
    }

    /// Freezes the snapshots for a trip.
    pub fn freeze(&mut self) {
        self.frozen += 1;
    }

    /// Ends one freeze: the trip has been written, or will not be.
    pub fn thaw(&mut self) {
        self.frozen = self.frozen.saturating_sub(1);
    }

    /// Snapshot number `index`, 0 being the oldest, relative to a trip at `device_us`.
    #[must_use]
    pub fn snapshot(&self, index: usize, device_us: u64) -> Option<FaultSnapshot> {
        let moment = self.moments.get(index)?;
        let before_ms = device_us.saturating_sub(moment.device_us) / 1000;
        Some(FaultSnapshot { before_ms: u16::try_from(before_ms).unwrap_or(u16::MAX), ..moment.snapshot.clone() })
    }
}

/// History of trips in flash. Takes 5 KiB for its buffers.
pub struct History {
    /// Number of trips, including those beyond [`HISTORY`].
    count: u16,
    newest: Option<FaultInfo>,
    /// Number of this start of the board.
    start: u32,
    /// Item of the trip that was read last, and its index and length.
    item: [u8; BUFFER],
    read: Option<(u8, usize)>,
    buffer: [u8; BUFFER],
}

impl History {
    /// Opens the history in flash; whatever that contains, trips can be recorded.
    pub async fn open<F: NorFlash>(flash: &mut F) -> Self {
        let mut history = Self { count: 0, newest: None, start: 0, item: [0; BUFFER], read: None, buffer: [0; BUFFER] };
        history.survey(flash).await;
        // Starts without a trip leave no trace.
        history.start = history.newest.map_or(1, |newest| newest.start.saturating_add(1));
        history
    }

    async fn survey<F: NorFlash>(&mut self, flash: &mut F) {
        (self.count, self.newest, self.read) = (0, None, None);
        let see = |item: &[u8]| {
            if let Some((info, _)) = decode_info(item) {
                self.count = self.count.saturating_add(1);
                // The last one, unless marks in flash have been damaged: no number is used twice.
                self.newest = self.newest.into_iter().chain([info]).max_by_key(|info| info.number);
            }
        };
        // Unreadable contents are erased by the next trip.
        if fault_log(flash).visit(&mut self.buffer, see).await.is_err() {
            self.count = 0;
        }
    }

    /// Number of trips that can be read.
    #[must_use]
    pub fn len(&self) -> u8 {
        self.count.min(HISTORY) as u8
    }

    /// Returns true if there has been no trip.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Writes a trip; the oldest are dropped when there is no more room.
    ///
    /// # Errors
    /// [`StorageError`] for a failed write; the trips before it are still there, unless they were damaged.
    pub async fn record<F: NorFlash>(&mut self, flash: &mut F, trip: &Trip) -> Result<FaultInfo, StorageError> {
        let info = FaultInfo {
            number: self.newest.map_or(1, |newest| newest.number.saturating_add(1)),
            start: self.start,
            device_us: trip.device_us,
            causes: trip.causes,
            snapshots: trip.snapshots.len() as u8,
        };
        self.read = None;
        let length = encode(&info, trip, &mut self.item).ok_or(StorageError::Damaged)?;
        let pushed = fault_log(flash).push(&self.item[..length], &mut self.buffer).await;
        self.survey(flash).await;
        pushed.map(|()| info)
    }

    /// Reads trip number `index`, 0 being the newest; `None` beyond the last.
    ///
    /// # Errors
    /// [`StorageError`] when the flash cannot be read.
    pub async fn fault<F: NorFlash>(&mut self, flash: &mut F, index: u8) -> Result<Option<FaultInfo>, StorageError> {
        let item = self.item(flash, index).await?;
        Ok(item.and_then(decode_info).map(|(info, _)| info))
    }

    /// Reads snapshot number `snapshot` of trip number `index`; 0 is the newest trip and its oldest snapshot. `None`
    /// beyond the last.
    ///
    /// # Errors
    /// [`StorageError`] when the flash cannot be read.
    pub async fn snapshot<F: NorFlash>(
        &mut self,
        flash: &mut F,
        index: u8,
        snapshot: u8,
    ) -> Result<Option<FaultSnapshot>, StorageError> {
        let Some((_, mut rest)) = self.item(flash, index).await?.and_then(decode_info) else { return Ok(None) };
        for _ in 0..snapshot {
            let Ok((_, after)) = postcard::take_from_bytes::<FaultSnapshot>(rest) else { return Ok(None) };
            rest = after;
        }
        Ok(postcard::from_bytes(rest).ok())
    }

    /// Reads through the log, unless this trip was the last one read: a host asks for its snapshots one by one.
    async fn item<F: NorFlash>(&mut self, flash: &mut F, index: u8) -> Result<Option<&[u8]>, StorageError> {
        if index >= self.len() {
            return Ok(None);
        }
        let length = match self.read {
            Some((read, length)) if read == index => length,
            _ => {
                self.read = None;
                let mut before = self.count - 1 - u16::from(index);
                let mut length = 0;
                let see = |item: &[u8]| {
                    if decode_info(item).is_none() {
                        return;
                    }
                    if before == 0 && length == 0 {
                        length = item.len();
                        self.item[..length].copy_from_slice(item);
                    }
                    before = before.saturating_sub(1);
                };
                fault_log(flash).visit(&mut self.buffer, see).await?;
                self.read = Some((index, length));
                length
            }
        };
        Ok(Some(&self.item[..length]))
    }
}

/// Encodes a trip into `item` and returns the number of bytes; `None` if it does not fit.
fn encode(info: &FaultInfo, trip: &Trip, item: &mut [u8]) -> Option<usize> {
    let (layout, rest) = item.split_first_mut()?;
    *layout = LAYOUT;
    let mut used = 1 + postcard::to_slice(info, rest).ok()?.len();
    for snapshot in &trip.snapshots {
        used += postcard::to_slice(snapshot, item.get_mut(used..)?).ok()?.len();
    }
    Some(used)
}

/// Decodes the trip, and returns the snapshots' bytes that follow it; `None` for another layout.
fn decode_info(item: &[u8]) -> Option<(FaultInfo, &[u8])> {
    let (layout, rest) = item.split_first()?;
    if *layout == LAYOUT { postcard::take_from_bytes(rest).ok() } else { None }
}

#[cfg(test)]
mod tests {
    use r4_protocol::Cause;

    use super::*;

    #[test]
    fn the_recorder_keeps_the_last_moments_and_counts_back_from_the_trip() {
        let mut recorder = Recorder::default();
        let step_us = u64::from(SNAPSHOT_MS) * 1000;
        for step in 0..25 {
            let motor = MotorSnapshot { position: step, speed: 0.5, duty: -0.25 };
            recorder.note(step as u64 * step_us, [motor], [24.0, 5.0]);
        }
        recorder.freeze();
        // Later snapshots belong to another trip.
        recorder.note(25 * step_us, [], []);
        let tripped_us = 24 * step_us + 3_000;
        assert_eq!(recorder.snapshot(SNAPSHOTS, tripped_us), None);
        for (index, step) in (0..SNAPSHOTS).zip(5..) {
            let snapshot = recorder.snapshot(index, tripped_us).expect("noted");
            assert_eq!(snapshot.motors[0].position, step);
            assert_eq!(i32::from(snapshot.before_ms), (24 - step) * i32::from(SNAPSHOT_MS) + 3);
            assert_eq!(snapshot.supplies_v, [24.0, 5.0]);
        }
        recorder.thaw();
        recorder.note(26 * step_us, [], []);
        assert!(recorder.snapshot(SNAPSHOTS - 1, tripped_us).is_some_and(|newest| newest.motors.is_empty()));
    }

    #[test]
    fn more_motors_than_there_can_be_are_left_out() {
        let mut recorder = Recorder::default();
        recorder.note(0, [MotorSnapshot::default(); MAX_MOTORS + 1], [0.0; MAX_SUPPLIES + 1]);
        let snapshot = recorder.snapshot(0, u64::MAX).expect("noted");
        assert_eq!((snapshot.motors.len(), snapshot.supplies_v.len()), (MAX_MOTORS, MAX_SUPPLIES));
        assert_eq!(snapshot.before_ms, u16::MAX);
    }

    #[test]
    fn the_largest_trip_fits() {
        let motor = MotorSnapshot { position: i32::MIN, speed: f32::MAX, duty: -1.0 };
        let motors = Vec::from_slice(&[motor; MAX_MOTORS]).expect("fits");
        let supplies_v = Vec::from_slice(&[f32::MAX; MAX_SUPPLIES]).expect("fits");
        let snapshot = FaultSnapshot { before_ms: u16::MAX, motors, supplies_v };
        let snapshots = core::iter::repeat_n(snapshot, SNAPSHOTS).collect();
        let trip = Trip { device_us: u64::MAX, causes: Causes::from_bits(u32::MAX), snapshots };
        let info = FaultInfo {
            number: u32::MAX,
            start: u32::MAX,
            device_us: u64::MAX,
            causes: trip.causes,
            snapshots: SNAPSHOTS as u8,
        };
        assert_eq!(encode(&info, &trip, &mut [0; BUFFER]), Some(MAX_ITEM));
    }

    /// Bytes of layout 1 in flash. They must never change: a new layout gets a new number.
    #[test]
    fn layout_1_stays_what_it_is() {
        let motors = Vec::from_slice(&[MotorSnapshot { position: -2, speed: 1.0, duty: 0.5 }]).expect("fits");
        let snapshot = FaultSnapshot { before_ms: 10, motors, supplies_v: Vec::from_slice(&[24.0]).expect("fits") };
        let snapshots = Vec::from_slice(&[snapshot]).expect("fits");
        let trip = Trip { device_us: 300, causes: Causes::only(Cause::Stalled), snapshots };
        let info = FaultInfo { number: 7, start: 3, device_us: 300, causes: trip.causes, snapshots: 1 };
        let mut item = [0; BUFFER];
        let length = encode(&info, &trip, &mut item).expect("fits");
        let expected = b"\x01\x07\x03\xAC\x02\x80\x04\x01\x0A\x01\x03\0\0\x80\x3F\0\0\0\x3F\x01\0\0\xC0\x41";
        assert_eq!(&item[..length], expected);
        assert_eq!(decode_info(expected).map(|(info, _)| info), Some(info));
    }
}
