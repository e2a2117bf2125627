//! What a board must offer beyond `embedded-hal-async` and `embedded-io-async`.

use core::{
    future::poll_fn,
    task::{Context, Poll},
};

use embedded_hal_async::i2c::I2c;

use crate::sensing::pulse::Pulse;

/// Bytes for one chip, to be sent in one transfer.
// Of whole words, which are copied without a call: a period copies up to 25.
#[repr(align(4))]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Write {
    address: u8,
    length: u8,
    bytes: [u8; Self::MAX],
}

impl Write {
    /// Most bytes, without the address: a register and the four bytes of each of four PWM outputs.
    pub const MAX: usize = 17;

    /// The first `length` of `bytes` for the chip at `address`, 7 bits; all of them where it is more.
    #[must_use]
    pub const fn new(address: u8, bytes: [u8; Self::MAX], length: usize) -> Self {
        let length = if length < Self::MAX { length } else { Self::MAX };
        Self { address, length: length as u8, bytes }
    }

    /// Of the chip, 7 bits.
    #[must_use]
    pub const fn address(&self) -> u8 {
        self.address
    }

    /// What it gets, without its address.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }

    /// Sends it in one transfer.
    ///
    /// # Errors
    /// A failed transfer, as the bus tells it.
    pub async fn send<B: I2c + ?Sized>(&self, bus: &mut B) -> Result<(), B::Error> {
        bus.write(self.address, self.bytes()).await
    }
}

/// An I2C bus that can be freed when a chip holds it.
#[allow(async_fn_in_trait, reason = "single-core executors: futures need not be Send")]
pub trait Bus: I2c {
    /// Clocks SCL nine times with SDA released, sends a STOP and starts the controller afresh (UM10204, 3.1.16).
    async fn recover(&mut self);

    /// Sends `writes` one after the other, until one fails or `stops` says so: it is asked before each, and whenever the task is
    /// woken, and is to have the task woken when its answer changes. The write that is under way then is sent to its end.
    ///
    /// Returns how many were sent, and why the next one was not. A board whose interrupts begin each write when the one before
    /// ends spares the caller's task a wake for each.
    async fn write_all(
        &mut self,
        writes: &[Write],
        stops: impl FnMut(&mut Context<'_>) -> bool,
    ) -> (usize, Result<(), Self::Error>) {
        write_each(self, writes, stops).await
    }
}

/// [`Bus::write_all`] for a controller that does one transfer at a time.
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

/// The quadrature counters: four counts to an encoder line, wrapping at 16 bits.
pub trait Encoders {
    /// The present count of encoder `index`. Numbers the board does not have read 0.
    fn count(&mut self, index: u8) -> u16;

    /// Transitions of encoder `index` since power-up in which both tracks changed, which no shaft does; 0 where a timer
    /// counts, for it cannot tell.
    fn illegal(&mut self, index: u8) -> u32;

    /// The count of encoder `index` at its last index pulse since this was asked before: latched when the level of the switch input
    /// of the same number becomes that of a closed switch. Always `None` where nothing latches.
    fn at_index(&mut self, _index: u8) -> Option<u16> {
        None
    }
}

/// Inputs whose edges come by interrupts above the supervisor, which a storm of them would starve.
pub trait EdgeInputs {
    /// Whether the interrupt of a line is masked by its [`EdgeBudget`](crate::sensing::storm::EdgeBudget), or was until a moment
    /// ago, so that edges are lost. Unmasks lines whose time has come. Called once in a control period.
    fn storm(&mut self) -> bool;
}

/// The echo inputs of range connectors 0 and 1, where something sends pulses of its own.
pub trait PulseInputs {
    /// The newest pulse at echo input `index`. Numbers the board does not have get none.
    fn pulse(&mut self, index: u8) -> Option<Pulse>;
}

/// What the control task takes of the processor.
pub trait ControlCycles {
    /// Cycles in a second; 0 where they are not counted.
    const CYCLES_HZ: u32;

    /// Cycles that the control task took until it was last entered, with those of the interrupts that came meanwhile; wrapping.
    fn control_cycles(&mut self) -> u32;
}

/// The switches beside the encoders.
pub trait SwitchInputs {
    /// The level of switch input `index`. Inputs are pulled up; numbers the board does not have read high.
    fn is_high(&mut self, index: u8) -> bool;
}

/// The processor's own analog outputs.
pub trait AnalogOutputs {
    /// Sets output `index` to a share of the reference, 0..=4095 of 4096. Numbers the board does not have do nothing.
    fn set(&mut self, index: u8, code: u16);
}

/// The divided analog inputs, sampled by hardware at least once per control period.
pub trait AnalogInputs {
    /// The latest code of input `index`, 0..=65535 for 0 V to the reference. Numbers the board does not have read 0.
    fn code(&mut self, index: u8) -> u16;
}

/// Words that outlive every reset of the processor, though not the loss of its power: one for each motor, by
/// [`MAX_MOTORS`](r4_protocol::config::MAX_MOTORS).
pub trait KeptWords {
    /// What was kept at `index` last, by whichever firmware; anything after the loss of power. Numbers there are not read 0.
    fn kept(&mut self, index: usize) -> u32;
    /// Keeps `word`, in one piece. Numbers there are not do nothing.
    fn keep(&mut self, index: usize, word: u32);
}

/// What one stepper driver's lines do, and when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepEvent {
    /// Tick of the steppers' clock, wrapping.
    pub at: u32,
    /// What happens then.
    pub action: StepAction,
}

/// What one stepper driver's lines do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepAction {
    /// One pulse: active from the event's tick for [`Steppers::PULSE_TICKS`].
    Pulse,
    /// The direction line turns: `true` for positive.
    Direction(bool),
}

/// The step/direction drivers: a clock, a queue of events for each axis, one enable for all.
///
/// Events carry the tick at which they happen, so that how late the control loop runs moves no edge. A queue holds the
/// events of 2.5 control periods at the highest rate. Numbers of axes the board does not have do nothing and read 0.
///
/// With a timer for each axis that runs through in PWM mode, its compare output is the pulse and its update interrupt, one
/// for each event, loads the ticks to the next as the reload value, both preloaded. Gaps beyond the reload register are
/// cut into stretches without a pulse, an idle axis too: the sum of all stretches is the clock. The timers start together
/// and run from one source, so that the sum is the same for all.
pub trait Steppers {
    /// Ticks in a second of the clock that all axes share.
    const TICK_HZ: u32;
    /// How long a pulse is active.
    const PULSE_TICKS: u32;
    /// A direction line turns at its tick or at most this much later: an interrupt writes it. Pulses are exact.
    const DIRECTION_LATENCY_TICKS: u32;

    /// The present tick, wrapping.
    fn now(&mut self) -> u32;
    /// Sets the level of the enable line that all share.
    fn enable(&mut self, high: bool);
    /// Appends events, which are in order of time and in the future; returns how many found room, counted from the first.
    fn queue(&mut self, axis: u8, events: &[StepEvent]) -> usize;
    /// All axes have been told the events of a period: hardware that is set up for them is set up now.
    fn queued(&mut self) {}
    /// Events not yet carried out.
    fn pending(&mut self, axis: u8) -> u32;
    /// Pulses made with the direction line positive less those with it negative, since power-up, wrapping.
    fn position(&mut self, axis: u8) -> i32;
    /// Drops what is queued, at once and for good: when this returns, [`Steppers::position`] is final. A pulse that has
    /// begun is completed and counted. The direction line stays as it is.
    fn stop(&mut self, axis: u8);
}

/// Everything of the processor that the control loop uses, in one.
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

/// The ultrasonic range sensors: trigger outputs, and echo inputs captured by hardware with a resolution of 1 µs.
pub trait Ranging {
    /// Drives the trigger of sensor `index`. Numbers the board does not have do nothing.
    fn trigger(&mut self, index: u8, high: bool);

    /// Forgets the edges captured at the echo of sensor `index`.
    fn clear(&mut self, index: u8);

    /// The echo of sensor `index` since the last [`Ranging::clear`]. Numbers the board does not have are idle.
    fn echo(&mut self, index: u8) -> EchoState;
}

/// An echo input since its capture was cleared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EchoState {
    /// Low, and no whole pulse was captured: one whose beginning was cleared does not count.
    Idle,
    /// High, also when it has been since before the capture was cleared.
    High {
        /// For how long, as far as that was captured.
        since_us: u32,
    },
    /// A whole pulse was captured: the first.
    Done {
        /// Its length.
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

    /// Three writes to registers 1 to 3, up to the one that a stop or a failure comes before; by the bus and by who borrows it.
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
