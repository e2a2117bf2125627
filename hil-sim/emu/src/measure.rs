//! What the firmware costs the processor: stack, instructions, the moments of control periods.
//!
//! All executors run on the one main stack, as interrupts that nest. What each takes of it is told apart at exceptions
//! ([`r4_mcu::Profile`]); interrupts of one level cannot nest in each other, so that the most that can ever be taken
//! at once is the sum of the deepest of each level.

use std::collections::BTreeMap;

use r4_mcu::{CanFrame, CanOutcome, Chip, Moment, Size, StackArea, cpu::Core};

use crate::board::EmuBoard;

/// Where the control task notes that a period begins.
const PERIOD_BEGINS: &str = "r4_firmware::control::task::period_begins";
/// Interrupts that executors use as their own, by the handlers' names.
const EXECUTORS: [(&str, &str); 4] = [("SAI1", "supervisor"), ("SAI2", "control"), ("SAI3", "links"), ("SAI4", "usb")];
/// Every byte of the stack that the firmware's start-up code paints.
const PAINT: u8 = 0xCC;
/// The first exception that is an interrupt.
const INTERRUPT_0: u16 = 16;
/// The chip has 150 (RM0399, table 150).
const INTERRUPTS: std::ops::Range<u16> = INTERRUPT_0..166;

/// The controller of the CAN connector.
const FDCAN: u8 = 2;

/// Why nothing can be measured.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MeasureError {
    /// The image is of before it had this, or was stripped.
    #[error("the firmware has no symbol `{0}`: build it anew with `cargo xtask firmware`")]
    NoSymbol(&'static str),
    /// The core cannot observe.
    #[error("cannot observe the firmware: {0}")]
    Observe(String),
    /// Nobody began.
    #[error("no measurement was begun")]
    NotBegun,
}

/// What one executor, or the interrupts of one level, took.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Share {
    /// Executor's name, or `interrupts` and their level.
    pub who: String,
    /// Of 16 levels, 0 the most urgent; `None` for the thread.
    pub level: Option<u8>,
    /// The deepest of its handlers, with the frame of what it interrupts, bytes.
    pub stack: u32,
    /// Executed by them, without those of what interrupted them.
    pub instructions: u64,
    /// Times they were entered.
    pub entries: u64,
}

/// The stack that all share.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stack {
    /// Bytes that the linker keeps for it.
    pub reserved: u32,
    /// Bytes that were written, at most, at one time.
    pub used: u32,
    /// Bytes if ever each level interrupted the one below at its deepest.
    pub bound: u32,
    /// By executor, the most urgent first.
    pub shares: Vec<Share>,
}

impl<C: Core + 'static> EmuBoard<C> {
    /// Begins to measure: when the board has just been powered and has executed nothing.
    ///
    /// # Errors
    /// When the image does not have what this needs.
    pub fn start_measuring(&self) -> Result<(), MeasureError> {
        let mut machine = self.machine();
        let symbol = |name| machine.symbols().address(name).ok_or(MeasureError::NoSymbol(name));
        let stack = StackArea { end: symbol("_stack_end")?, start: symbol("_stack_start")?, paint: PAINT };
        let mark = symbol(PERIOD_BEGINS)?;
        machine.observe(&[mark]).map_err(|error| MeasureError::Observe(error.to_string()))?;
        machine.start_profile(stack, Some(mark));
        Ok(())
    }

    /// A classic frame on the CAN connector, with a standard identifier, that ends at `at_ns`.
    pub fn can_receive(&self, at_ns: u64, identifier: u16, data: Vec<u8>) {
        let id = identifier.into();
        let frame = CanFrame { id, extended: false, remote: false, fd: false, bit_rate_switch: false, data };
        self.machine().chip.can_receive(FDCAN, at_ns, frame);
    }

    /// The same as a frame of CAN FD, its data at the rate of the data phase where `bit_rate_switch`.
    pub fn can_receive_fd(&self, at_ns: u64, identifier: u16, bit_rate_switch: bool, data: Vec<u8>) {
        let id = identifier.into();
        let frame = CanFrame { id, extended: false, remote: false, fd: true, bit_rate_switch, data };
        self.machine().chip.can_receive(FDCAN, at_ns, frame);
    }

    /// The frames that the board has sent on the CAN connector since this was last asked; the newest 1024.
    #[must_use]
    pub fn take_can_frames(&self) -> Vec<CanFrame> {
        self.machine().chip.outside().take_can_frames()
    }

    /// What becomes of frames that the board sends on the CAN connector from now on; at first somebody acknowledges them.
    pub fn set_can_outcome(&self, outcome: CanOutcome) {
        self.machine().chip.outside().set_can_outcome(outcome);
    }

    /// The CAN bus is held dominant from now on, or no longer.
    pub fn hold_can_dominant(&self, held: bool) {
        self.machine().chip.hold_can_dominant(FDCAN, held);
    }

    /// The end of the frame that the board is sending on the CAN connector.
    #[must_use]
    pub fn can_sends_until_ns(&self) -> Option<u64> {
        self.machine().chip.can_sends_until_ns(FDCAN)
    }

    /// Frames that the board has sent on the CAN connector with a standard identifier.
    #[must_use]
    pub fn can_sent(&self, identifier: u16) -> u64 {
        self.machine().chip.outside().can_sent(identifier)
    }

    /// Bit rate of the CAN connector's controller, bit/s, from its registers and clock.
    #[must_use]
    pub fn can_bit_rate(&self) -> f64 {
        self.machine().chip.can_bit_rates(FDCAN).0
    }

    /// That of the data phase of CAN FD.
    #[must_use]
    pub fn can_data_bit_rate(&self) -> f64 {
        self.machine().chip.can_bit_rates(FDCAN).1
    }

    /// The board goes off the bus now, as after 32 frames that somebody destroyed.
    pub fn inject_can_bus_off(&self) {
        self.machine().chip.inject_can_bus_off(FDCAN);
    }

    /// Control periods that began since this was last asked.
    ///
    /// # Errors
    /// [`MeasureError::NotBegun`].
    pub fn take_periods(&self) -> Result<Vec<Moment>, MeasureError> {
        Ok(self.machine().profile().ok_or(MeasureError::NotBegun)?.take_moments())
    }

    /// What was taken of the stack, and executed, since the beginning.
    ///
    /// # Errors
    /// When that cannot be told.
    pub fn stack(&self) -> Result<Stack, MeasureError> {
        let mut machine = self.machine();
        let profile = machine.profile().ok_or(MeasureError::NotBegun)?.clone();
        let symbols = machine.symbols();
        let symbol = |name| symbols.address(name).ok_or(MeasureError::NoSymbol(name));
        let (end, start) = (symbol("_stack_end")?, symbol("_stack_start")?);
        let memory = machine.chip.memory();
        let deepest = profile.deepest();
        let table = machine.processor().vector_table();
        let mut owners = BTreeMap::new();
        for exception in INTERRUPTS {
            let Some(vector) = memory.read(table + 4 * u32::from(exception), Size::Word) else { continue };
            let owner = EXECUTORS.iter().find(|(handler, _)| symbols.address(handler) == Some(vector & !1));
            owners.extend(owner.map(|(_, who)| (exception, *who)));
        }
        // The thread is interrupted by all.
        let mut shares: BTreeMap<(u8, String), Share> = BTreeMap::new();
        for exception in profile.active() {
            let level = machine.processor().exceptions.priority_field(exception) >> 4;
            let (level, who) = match (exception, owners.get(&exception)) {
                (0, _) => (None, "thread".to_owned()),
                (_, Some(who)) => (Some(level), (*who).to_owned()),
                (..INTERRUPT_0, None) => (Some(level), format!("exception {exception}")),
                (_, None) => (Some(level), format!("interrupts of level {level}")),
            };
            let key = (level.unwrap_or(u8::MAX), who.clone());
            let share = shares.entry(key).or_insert(Share { who, level, stack: 0, instructions: 0, entries: 0 });
            share.stack = share.stack.max(profile.depth(exception));
            share.instructions += profile.instructions(exception);
            share.entries += profile.entries(exception);
        }
        let shares: Vec<_> = shares.into_values().collect();
        let mut deepest_of: BTreeMap<Option<u8>, u32> = BTreeMap::new();
        for share in &shares {
            let deepest = deepest_of.entry(share.level).or_default();
            *deepest = share.stack.max(*deepest);
        }
        Ok(Stack { reserved: start - end, used: deepest, bound: deepest_of.values().sum(), shares })
    }
}

/// A distribution.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// Half are not above.
    pub median: f64,
    /// 99.9 % are not above.
    pub p999: f64,
    /// None is above.
    pub max: f64,
}

impl Spread {
    /// Of these values; of none, zeros.
    #[must_use]
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let Some(last) = values.len().checked_sub(1) else { return Self::default() };
        // The nearest rank: the first that at least this share is not above.
        let rank = |share: f64| values[((share * values.len() as f64).ceil() as usize).clamp(1, last + 1) - 1];
        Self { median: rank(0.5), p999: rank(0.999), max: values[last] }
    }
}

/// Instructions of the control executor from one period's beginning to the next.
#[must_use]
pub fn instructions(periods: &[Moment]) -> Spread {
    Spread::of(periods.windows(2).map(|two| (two[1].instructions - two[0].instructions) as f64).collect())
}

/// How much longer or shorter than `period_us` it was from one period's beginning to the next, µs.
#[must_use]
pub fn jitter_us(periods: &[Moment], period_us: u32) -> Spread {
    let deviation = |two: &[Moment]| ((two[1].at_ns - two[0].at_ns) as f64 * 1e-3 - f64::from(period_us)).abs();
    Spread::of(periods.windows(2).map(deviation).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_told_by_its_ranks() {
        let thousand = (1..=1000).map(f64::from).rev().collect();
        assert_eq!(Spread::of(thousand), Spread { median: 500.0, p999: 999.0, max: 1000.0 });
        assert_eq!(Spread::of(vec![3.0]), Spread { median: 3.0, p999: 3.0, max: 3.0 });
        assert_eq!(Spread::of(Vec::new()), Spread::default());
    }

    #[test]
    fn jitter_is_what_a_period_lasts_more_or_less() {
        let moment = |at_ns, instructions| Moment { at_ns, exception: 107, instructions };
        let periods = [moment(0, 100), moment(1_004_000, 350), moment(2_000_000, 500)];
        assert_eq!(jitter_us(&periods, 1000).max, 4.0);
        assert_eq!(instructions(&periods), Spread { median: 150.0, p999: 250.0, max: 250.0 });
    }
}
