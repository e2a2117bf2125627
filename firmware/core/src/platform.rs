//! Hardware interface of a board, beyond `embedded-hal-async` and `embedded-io-async`.

use core::{
    future::poll_fn,
    task::{Context, Poll},
};

use embedded_hal_async::i2c::I2c;

/// Bytes for one chip, to be sent in one transfer.
// Aligned to words, which are copied without a call: a period copies up to 25 writes.
#[repr(align(4))]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Write {
    address: u8,
    length: u8,
    bytes: [u8; Self::MAX],
}

impl Write {
    /// Maximum number of bytes, without the address: a register and the four bytes of each of four PWM outputs.
    pub const MAX: usize = 17;

    /// Creates a write of the first `length` of `bytes`, or all if that is more, to the chip at `address`, 7 bits.
    #[must_use]
    pub const fn new(address: u8, bytes: [u8; Self::MAX], length: usize) -> Self {
        let length = if length < Self::MAX { length } else { Self::MAX };
        Self { address, length: length as u8, bytes }
    }

    /// Address of the chip, 7 bits.
    #[must_use]
    pub const fn address(&self) -> u8 {
        self.address
    }

    /// Bytes to send, without the address.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }

    /// Sends the bytes in one transfer.
    ///
    /// # Errors
    /// The bus's error, for a failed transfer.
    pub async fn send<B: I2c + ?Sized>(&self, bus: &mut B) -> Result<(), B::Error> {
        bus.write(self.address, self.bytes()).await
    }
}

/// I2C bus that can be freed when a chip holds it.
#[allow(async_fn_in_trait, reason = "single-core executors: futures need not be Send")]
pub trait Bus: I2c {
    /// Clocks SCL nine times with SDA released, sends a STOP and starts the controller afresh (UM10204, 3.1.16).
    async fn recover(&mut self);

    /// Sends `writes` one after the other, until one fails or `stops` returns true. `stops` is called before each write
    /// and whenever the task is woken, and must have the task woken when its result changes. A write under way is then
    /// completed.
    ///
    /// Returns the number of writes sent, and the error of the next one, if any. A board whose interrupts begin each
    /// write when the one before ends spares the caller's task a wake for each.
    async fn write_all(
        &mut self,
        writes: &[Write],
        stops: impl FnMut(&mut Context<'_>) -> bool,
    ) -> (usize, Result<(), Self::Error>) {
        write_each(self, writes, stops).await
    }
}

/// Implements [`Bus::write_all`] for a controller that does one transfer at a time.
///
/// # Errors
/// The bus's error of the first write that failed.
pub async fn write_each<B: I2c + ?Sized>(
    bus: &mut B,
    writes: &[Write],
    mut stops: impl FnMut(&mut Context<'_>) -> bool,
) -> (usize, Result<(), B::Error>) {
    for (sent, write) in writes.iter().enumerate() {
        if poll_fn(|context| Poll::Ready(stops(context))).await {
            return (sent, Ok(()));
        }
        if let Err(error) = write.send(bus).await {
            return (sent, Err(error));
        }
    }
    (writes.len(), Ok(()))
}

impl<B: Bus> Bus for &mut B {
    async fn recover(&mut self) {
        (**self).recover().await;
    }

    async fn write_all(
        &mut self,
        writes: &[Write],
        stops: impl FnMut(&mut Context<'_>) -> bool,
    ) -> (usize, Result<(), Self::Error>) {
        (**self).write_all(writes, stops).await
    }
}

/// Quadrature counters: four counts per encoder line, wrapping at 16 bits.
pub trait Encoders {
    /// Present count of encoder `index`; 0 for an encoder that the board does not have.
    fn count(&mut self, index: u8) -> u16;

    /// Number of transitions of encoder `index` since power-up in which both tracks changed, which no shaft does; 0
    /// where a timer counts, because it cannot detect them.
    fn illegal(&mut self, index: u8) -> u32;

    /// Count of encoder `index` at its last index pulse since the last call: latched when the level of the switch input
    /// of the same number becomes that of a closed switch. `None` without a new pulse, and always where nothing
    /// latches.
    fn at_index(&mut self, _index: u8) -> Option<u16> {
        None
    }
}

/// Inputs whose edges come by interrupts above the supervisor, which a storm of them would starve.
pub trait EdgeInputs {
    /// Returns true while the interrupt of a line is masked by its [`EdgeBudget`](crate::sensing::storm::EdgeBudget),
    /// or was until a moment ago, so that edges are lost. Unmasks lines whose time has come. Called once in a control
    /// period.
    fn storm(&mut self) -> bool;
}

/// Newest pulse on a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulse {
    /// Width of the high level, tenths of a µs.
    pub high: u32,
    /// Time from the previous rising edge to the pulse's own, tenths of a µs.
    pub period: u32,
    /// Time since its rising edge, µs.
    pub age_us: u32,
}

/// Echo inputs of range connectors 0 and 1, used for devices that send pulses on their own.
pub trait PulseInputs {
    /// Newest pulse at echo input `index`; `None` without one, or for an input that the board does not have.
    fn pulse(&mut self, index: u8) -> Option<Pulse>;
}

/// Processor time of the control task.
pub trait ControlCycles {
    /// Cycles per second; 0 where they are not counted.
    const CYCLES_HZ: u32;

    /// Cycles of the control task until it was last entered, with those of the interrupts meanwhile; wrapping.
    fn control_cycles(&mut self) -> u32;
}

/// Switch inputs beside the encoders.
pub trait SwitchInputs {
    /// Level of switch input `index`. Inputs are pulled up; one that the board does not have reads high.
    fn is_high(&mut self, index: u8) -> bool;
}

/// Analog outputs of the processor itself.
pub trait AnalogOutputs {
    /// Sets output `index` to a share of the reference, 0..=4095 of 4096. An output that the board does not have is
    /// ignored.
    fn set(&mut self, index: u8, code: u16);
}

/// Divided analog inputs, sampled by hardware at least once per control period.
pub trait AnalogInputs {
    /// Latest code of input `index`, 0..=65535 for 0 V to the reference; 0 for an input that the board does not have.
    fn code(&mut self, index: u8) -> u16;
}

/// Words that survive every reset of the processor, but not the loss of its power: one for each motor, by
/// [`MAX_MOTORS`](r4_protocol::config::MAX_MOTORS).
pub trait KeptWords {
    /// Word last kept at `index`, by this or another firmware; arbitrary after a loss of power, and 0 beyond the last.
    fn kept(&mut self, index: usize) -> u32;
    /// Stores `word` atomically; ignored beyond the last index.
    fn keep(&mut self, index: usize, word: u32);
}

/// Event on the lines of one stepper driver, with its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepEvent {
    /// Tick of the steppers' clock, wrapping.
    pub at: u32,
    /// Action at that tick.
    pub action: StepAction,
}

/// Action on the lines of one stepper driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepAction {
    /// One pulse: active from the event's tick for [`Steppers::PULSE_TICKS`].
    Pulse,
    /// Turn of the direction line: `true` for positive.
    Direction(bool),
}

/// Step/direction drivers: a clock, a queue of events for each axis, one enable for all.
///
/// Events carry the tick at which they happen, so that the control loop's delay moves no edge. A queue holds the events
/// of 2.5 control periods at the highest rate. Axes that the board does not have are ignored and read 0.
///
/// A possible implementation has a timer for each axis that runs through in PWM mode: its compare output is the pulse,
/// and its update interrupt, one for each event, loads the ticks to the next as the reload value, both preloaded. Gaps
/// beyond the reload register are divided into stretches without a pulse, also on an idle axis: the sum of all
/// stretches is the clock. The timers start together and run from one source, so that the sum is the same for all.
pub trait Steppers {
    /// Frequency of the clock that all axes share, Hz.
    const TICK_HZ: u32;
    /// Length of a pulse, ticks.
    const PULSE_TICKS: u32;
    /// Longest delay of a direction line after its tick, because an interrupt writes it. Pulses are exact.
    const DIRECTION_LATENCY_TICKS: u32;

    /// Present tick of the clock, wrapping.
    fn now(&mut self) -> u32;
    /// Sets the level of the enable line that all axes share.
    fn enable(&mut self, high: bool);
    /// Appends events, which are in order of time and in the future; returns how many found room, counted from the first.
    fn queue(&mut self, axis: u8, events: &[StepEvent]) -> usize;
    /// Called when the events of a period have been queued for all axes, for hardware that is then set up.
    fn queued(&mut self) {}
    /// Number of events not yet carried out.
    fn pending(&mut self, axis: u8) -> u32;
    /// Pulses made with the direction line positive minus those with it negative, since power-up, wrapping.
    fn position(&mut self, axis: u8) -> i32;
    /// Drops the queue, immediately and permanently: when this returns, [`Steppers::position`] is final. A pulse that
    /// has begun is completed and counted. The direction line stays as it is.
    fn stop(&mut self, axis: u8);
}

/// All peripherals of the processor that the control loop uses.
pub trait Peripherals:
    Encoders + EdgeInputs + PulseInputs + AnalogInputs + SwitchInputs + AnalogOutputs + Steppers + KeptWords + ControlCycles
{
}

impl<P> Peripherals for P where
    P: Encoders
        + EdgeInputs
        + PulseInputs
        + AnalogInputs
        + SwitchInputs
        + AnalogOutputs
        + Steppers
        + KeptWords
        + ControlCycles
{
}

/// Ultrasonic range sensors: trigger outputs, and echo inputs captured by hardware with a resolution of 1 µs.
pub trait Ranging {
    /// Drives the trigger of sensor `index`. A sensor that the board does not have is ignored.
    fn trigger(&mut self, index: u8, high: bool);

    /// Clears the edges captured at the echo of sensor `index`.
    fn clear(&mut self, index: u8);

    /// State of the echo of sensor `index` since the last [`Ranging::clear`]; idle for a sensor that the board does not
    /// have.
    fn echo(&mut self, index: u8) -> EchoState;
}

/// State of an echo input since its capture was cleared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EchoState {
    /// Low, and no complete pulse was captured: one whose beginning was cleared does not count.
    Idle,
    /// High, also if since before the capture was cleared.
    High {
        /// Duration so far, as far as it was captured.
        since_us: u32,
    },
    /// A complete pulse was captured: the first.
    Done {
        /// Width of the pulse, µs.
        width_us: u32,
    },
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use embassy_futures::block_on;

    use super::*;
    use crate::testing::Registers;

    const CHIP: u8 = 0x20;

    /// Three writes to registers 1 to 3 are sent until a stop or a failure, by the bus and by a borrowed one.
    #[test]
    fn writes_are_sent_until_a_stop_or_a_failure() {
        fn check<B: Bus>(mut bus: B, registers: &Registers) {
            let writes: Vec<_> = (1..=3)
                .map(|register| {
                    let mut bytes = [0; Write::MAX];
                    bytes[..2].copy_from_slice(&[register, 0x50 + register]);
                    Write::new(CHIP, bytes, 2)
                })
                .collect();
            let held = || [1, 2, 3].map(|register| registers.get(CHIP, register));
            for stopped_before in 0..=3 {
                (1..=3).for_each(|register| registers.set(CHIP, register, 0));
                let mut asked = 0;
                let stops = |_: &mut Context<'_>| {
                    asked += 1;
                    asked > stopped_before
                };
                let (sent, result) = block_on(bus.write_all(&writes, stops));
                assert_eq!((sent, result.is_ok()), (stopped_before, true));
                assert_eq!(held(), [1, 2, 3].map(|register| if register <= sent { 0x50 + register as u8 } else { 0 }));
            }
            registers.fail(1);
            let (sent, result) = block_on(bus.write_all(&writes, |_| false));
            assert_eq!((sent, result.is_err()), (0, true));
            let before = registers.recoveries();
            block_on(bus.recover());
            assert_eq!(registers.recoveries(), before + 1);
        }
        let registers = Registers::default();
        check(registers.clone(), &registers);
        check(&mut registers.clone(), &registers);
    }
}
