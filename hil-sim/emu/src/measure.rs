//! Processor load of the firmware: stack, instructions, and the moments of control periods.
//!
//! All executors run as nested interrupts on the one main stack. The profile separates their stack use at exceptions
//! ([`r4_mcu::Profile`]). Interrupts of one level cannot nest, so an upper bound of the stack is the sum of the deepest
//! use of each level.

use std::collections::BTreeMap;

use r4_maths::statistics::nearest_rank;
use r4_mcu::{CanFrame, CanOutcome, Chip, Moment, Size, StackArea, cpu::Core};

use crate::board::EmuBoard;

/// Function that the control task calls at the beginning of a period.
const PERIOD_BEGINS: &str = "r4_firmware::control::task::period_begins";
/// Interrupts that run the executors, by handler name.
const EXECUTORS: [(&str, &str); 4] = [("SAI1", "supervisor"), ("SAI2", "control"), ("SAI3", "links"), ("SAI4", "usb")];
/// Byte with which the firmware's start-up code fills the stack.
const PAINT: u8 = 0xCC;
/// Exception number of interrupt 0.
const INTERRUPT_0: u16 = 16;
/// Exception numbers of the chip's 150 interrupts (RM0399, table 150).
const INTERRUPTS: std::ops::Range<u16> = INTERRUPT_0..166;

/// Number of the FDCAN controller at the CAN connector.
const FDCAN: u8 = 2;

/// Reason why a measurement is impossible.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MeasureError {
    /// The image is older than the symbol, or was stripped.
    #[error("the firmware has no symbol `{0}`: build it anew with `cargo xtask firmware`")]
    NoSymbol(&'static str),
    /// The core cannot observe addresses.
    #[error("cannot observe the firmware: {0}")]
    Observe(String),
    /// [`EmuBoard::start_measuring`] was not called.
    #[error("no measurement was begun")]
    NotBegun,
}

/// Stack and instructions of one executor, or of the interrupts of one level.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Share {
    /// Name of the executor, or `interrupts` and their level.
    pub who: String,
    /// Priority level 0 to 15, 0 being the most urgent; `None` for the thread.
    pub level: Option<u8>,
    /// Deepest stack use of its handlers, with the exception frame of the interrupted code, bytes.
    pub stack: u32,
    /// Instructions executed, without those of nested interrupts.
    pub instructions: u64,
    /// Number of entries into its handlers.
    pub entries: u64,
}

/// Use of the common main stack.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stack {
    /// Size reserved by the linker, bytes.
    pub reserved: u32,
    /// Deepest use since the start, bytes.
    pub used: u32,
    /// Upper bound, bytes: each level interrupts the one below at its deepest.
    pub bound: u32,
    /// Shares of the executors, the most urgent first.
    pub shares: Vec<Share>,
}

impl<C: Core + 'static> EmuBoard<C> {
    /// Starts the measurement; call it right after power-up, before the first instruction.
    ///
    /// # Errors
    /// [`MeasureError::NoSymbol`] or [`MeasureError::Observe`].
    pub fn start_measuring(&self) -> Result<(), MeasureError> {
        let mut machine = self.machine();
        let symbol = |name| machine.symbols().address(name).ok_or(MeasureError::NoSymbol(name));
        let stack = StackArea { end: symbol("_stack_end")?, start: symbol("_stack_start")?, paint: PAINT };
        let mark = symbol(PERIOD_BEGINS)?;
        machine.observe(&[mark]).map_err(|error| MeasureError::Observe(error.to_string()))?;
        machine.start_profile(stack, Some(mark));
        Ok(())
    }

    /// Puts a classic frame with a standard identifier on the CAN connector; it ends at `at_ns`.
    pub fn can_receive(&self, at_ns: u64, identifier: u16, data: Vec<u8>) {
        let id = identifier.into();
        let frame = CanFrame { id, extended: false, remote: false, fd: false, bit_rate_switch: false, data };
        self.machine().chip.can_receive(FDCAN, at_ns, frame);
    }

    /// Puts a CAN FD frame on the CAN connector, its data at the rate of the data phase if `bit_rate_switch`.
    pub fn can_receive_fd(&self, at_ns: u64, identifier: u16, bit_rate_switch: bool, data: Vec<u8>) {
        let id = identifier.into();
        let frame = CanFrame { id, extended: false, remote: false, fd: true, bit_rate_switch, data };
        self.machine().chip.can_receive(FDCAN, at_ns, frame);
    }

    /// Takes the frames that the board has sent on the CAN connector since the last call; only the newest 1024 are
    /// kept.
    #[must_use]
    pub fn take_can_frames(&self) -> Vec<CanFrame> {
        self.machine().chip.outside().take_can_frames()
    }

    /// Sets the outcome of frames that the board sends on the CAN connector from now on; initially they are
    /// acknowledged.
    pub fn set_can_outcome(&self, outcome: CanOutcome) {
        self.machine().chip.outside().set_can_outcome(outcome);
    }

    /// Starts or ends a short that holds the CAN bus dominant.
    pub fn hold_can_dominant(&self, held: bool) {
        self.machine().chip.hold_can_dominant(FDCAN, held);
    }

    /// Returns the end of the frame that the board is sending on the CAN connector, ns; `None` if it sends none.
    #[must_use]
    pub fn can_sends_until_ns(&self) -> Option<u64> {
        self.machine().chip.can_sends_until_ns(FDCAN)
    }

    /// Returns the number of frames that the board has sent on the CAN connector with a standard identifier.
    #[must_use]
    pub fn can_sent(&self, identifier: u16) -> u64 {
        self.machine().chip.outside().can_sent(identifier)
    }

    /// Returns the bit rate of the CAN connector's controller, bit/s, from its registers and clock.
    #[must_use]
    pub fn can_bit_rate(&self) -> f64 {
        self.machine().chip.can_bit_rates(FDCAN).0
    }

    /// Returns the bit rate of the CAN FD data phase, bit/s.
    #[must_use]
    pub fn can_data_bit_rate(&self) -> f64 {
        self.machine().chip.can_bit_rates(FDCAN).1
    }

    /// Sends the board off the bus now, as 32 failed frames would.
    pub fn inject_can_bus_off(&self) {
        self.machine().chip.inject_can_bus_off(FDCAN);
    }

    /// Takes the beginnings of control periods since the last call.
    ///
    /// # Errors
    /// [`MeasureError::NotBegun`] before [`EmuBoard::start_measuring`].
    pub fn take_periods(&self) -> Result<Vec<Moment>, MeasureError> {
        Ok(self.machine().profile().ok_or(MeasureError::NotBegun)?.take_moments())
    }

    /// Returns stack use and instructions since the start of the measurement.
    ///
    /// # Errors
    /// [`MeasureError::NotBegun`] or [`MeasureError::NoSymbol`].
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
        // The thread gets the last key, because every exception interrupts it.
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

/// Quantiles of a distribution.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// Median: half of the values are at most this.
    pub median: f64,
    /// Quantile 0.999 of the values.
    pub p999: f64,
    /// Largest of the values.
    pub max: f64,
}

impl Spread {
    /// Computes the quantiles of `values`; zeros without values.
    #[must_use]
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let rank = |share| nearest_rank(&values, share).unwrap_or_default();
        Self { median: rank(0.5), p999: rank(0.999), max: rank(1.0) }
    }
}

/// Distribution of the instructions of the control executor per period.
#[must_use]
pub fn instructions(periods: &[Moment]) -> Spread {
    Spread::of(periods.windows(2).map(|two| (two[1].instructions - two[0].instructions) as f64).collect())
}

/// Distribution of the absolute deviation of the control periods from `period_us`, µs.
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
