//! I2C controllers: embassy's asynchronous driver, with corrections and a way to free the bus.
//!
//! Deficiencies of embassy-stm32 0.6.0 that are corrected here:
//!
//! - A read without an acknowledge ends only by its timeout there. Here the NACK flag ends every transfer at once.
//! - After a read the next start may be written while the stop is still going out, and overwrite it. Here a transfer
//!   begins when the bus is free. It does not wait for its own stop at its end: that took 780 instructions each, and
//!   the computation between two transfers takes longer than a stop.
//! - Giving a transfer up leaves the controller in the middle of it. Here the controller is switched off and on, which
//!   releases both lines (RM0399, 50.4.6), whenever a transfer fails or is dropped.
//! - Its timing register values overflow their fields with a 120 MHz kernel clock. [`Timing`] computes them from the
//!   formulas of RM0399, 50.4.5 and 50.4.9.

mod board;

use core::{
    future::{Future, poll_fn},
    pin::pin,
    task::Poll,
};

use embassy_futures::select::{Either, select};
use embassy_stm32::{
    i2c::{Config, Error, I2c, Master},
    mode::Async,
    pac::{gpio::vals::Moder, i2c::I2c as Registers},
    time::Hertz,
};
use embassy_time::{Duration, Instant, Timer};
use embedded_hal_async::i2c::{Error as I2cError, ErrorKind, ErrorType, I2c as I2cBus, NoAcknowledgeSource, Operation};
use r4_firmware::platform;
use r4_protocol::message::MAX_RAW;

use crate::pins::Place;
pub(crate) use board::{BoardBus, OnBoard};

/// Half a clock period when a bus is freed by GPIO: 100 kHz, which every chip follows.
const HALF_CLOCK: Duration = Duration::from_micros(5);
/// Number of clocks that end any byte that a chip may be sending (UM10204, 3.1.16).
const CLOCKS: u32 = 9;

/// Timing of a bus, from a kernel clock of 120 MHz.
#[derive(Clone, Copy)]
pub(crate) struct Timing {
    frequency: Hertz,
    /// Value of TIMINGR: PRESC, SCLDEL, SDADEL, SCLH, SCLL.
    register: u32,
    /// Time limit of a transfer, by either driver; the board's bus adds to it by the byte.
    deadline: Duration,
    /// Time limit for the stop of the previous transfer.
    stop: Duration,
}

/// Value of TIMINGR with PRESC, SCLDEL, SDADEL, SCLH and SCLL.
pub(crate) const fn timingr(presc: u32, scldel: u32, sdadel: u32, sclh: u32, scll: u32) -> u32 {
    assert!(presc < 16 && scldel < 16 && sdadel < 16 && sclh < 256 && scll < 256);
    presc << 28 | scldel << 20 | sdadel << 16 | sclh << 8 | scll
}

impl Timing {
    /// Fast mode, 400 kHz in steps of 33.3 ns: low 1.47 us (at least 1.3), high 0.87 us (at least 0.6), and 0.13 us for
    /// the synchronisation of both edges beside their rise; data set up 400 ns before the clock (rise 300 + 100), held
    /// for 267 ns (225 to 307 with the analog filter).
    ///
    /// The deadline of 1 ms is twice the longest transfer of the control loop.
    pub(crate) const FAST: Self = Self {
        frequency: Hertz(400_000),
        register: timingr(3, 11, 8, 25, 43),
        deadline: Duration::from_millis(1),
        stop: Duration::from_micros(50),
    };
    /// Standard mode, 100 kHz in steps of 100 ns: low 5.1 us (at least 4.7), high 4.7 us (at least 4.0), set up 1.3 us
    /// (rise 1000 + 250 ns), held for 0.5 us.
    ///
    /// The longest transfer, 64 bytes out and 64 in, takes 11.9 ms.
    pub(crate) const STANDARD: Self = Self {
        frequency: Hertz(100_000),
        register: timingr(11, 12, 5, 46, 50),
        deadline: Duration::from_millis(25),
        stop: Duration::from_micros(200),
    };

    /// Configuration for embassy's driver. Set `pull_up` where neither the Giga nor the carrier has resistors: too weak
    /// for 400 kHz, but enough to keep an empty connector idle.
    pub(crate) fn config(self, pull_up: bool) -> Config {
        let mut config = Config::default();
        config.frequency = self.frequency;
        // The time counts from beginning to end of a transfer. The driver itself would block the processor while it
        // waits for a free bus; here the bus is free before it begins.
        config.timeout = self.deadline;
        config.scl_pullup = pull_up;
        config.sda_pullup = pull_up;
        config
    }
}

/// Hardware of a controller below embassy.
#[derive(Clone, Copy)]
pub(crate) struct Wiring {
    /// Registers of the controller.
    pub(crate) registers: Registers,
    /// Function that resets the controller and enables its clock.
    pub(crate) reset: fn(),
    /// Pin of the clock line.
    pub(crate) scl: Place,
    /// Pin of the data line.
    pub(crate) sda: Place,
    /// Timing of the bus.
    pub(crate) timing: Timing,
}

impl Wiring {
    /// Writes the timing, which embassy's driver computes wrongly.
    fn start(&self) {
        self.registers.cr1().modify(|w| w.set_pe(false));
        self.registers.timingr().write(|w| w.0 = self.timing.register);
        self.registers.cr1().modify(|w| w.set_pe(true));
    }

    /// Releases both lines and discards the transfer. PE must stay off for three cycles of its clock; reading it back
    /// takes longer.
    fn forget(&self) {
        self.registers.cr1().modify(|w| w.set_pe(false));
        let _ = (0..3).all(|_| self.registers.cr1().read().pe());
        self.registers.cr1().modify(|w| w.set_pe(true));
    }

    /// Sends clocks until no chip holds a line, and ends with a stop.
    async fn free(&self) {
        let lines = ByHand::take(*self);
        let Wiring { scl, sda, .. } = *self;
        for _ in 0..CLOCKS {
            scl.set(false);
            Timer::after(HALF_CLOCK).await;
            scl.set(true);
            Timer::after(HALF_CLOCK).await;
        }
        // Stop condition: data rises while the clock is high.
        scl.set(false);
        Timer::after(HALF_CLOCK).await;
        sda.set(false);
        Timer::after(HALF_CLOCK).await;
        scl.set(true);
        Timer::after(HALF_CLOCK).await;
        sda.set(true);
        Timer::after(HALF_CLOCK).await;
        drop(lines);
    }

    /// Waits for the end of a stop, which is microseconds away, or past; false if the line is held.
    fn is_free(&self) -> bool {
        let mut until = None;
        while self.registers.isr().read().busy() {
            let now = Instant::now();
            if now > *until.get_or_insert(now + self.timing.stop) {
                return false;
            }
        }
        self.registers.icr().write(|w| w.set_stopcf(true));
        true
    }
}

/// Guard of a transfer that leaves the controller idle in any case: a transfer that is given up is discarded. Must be
/// dropped after embassy's future, which ends its DMA first.
struct Transfer<'w> {
    wiring: &'w Wiring,
    ended: bool,
}

impl<'w> Transfer<'w> {
    /// Waits for a free bus.
    ///
    /// # Errors
    /// [`BusError::Held`] if a line is held.
    fn begin(wiring: &'w Wiring) -> Result<Self, BusError> {
        if wiring.is_free() { Ok(Self { wiring, ended: false }) } else { Err(BusError::Held) }
    }

    /// Carries out the transfer. A deadline of its own would cost each poll another timer: embassy's is that of
    /// [`Timing::config`].
    async fn wait(&self, transfer: impl Future<Output = Result<(), Error>>) -> Result<(), BusError> {
        let registers = self.wiring.registers;
        // embassy's handler wakes this task on a NACK; the flag is checked first, before embassy clears it.
        let refused = poll_fn(|_| if registers.isr().read().nackf() { Poll::Ready(()) } else { Poll::Pending });
        match select(refused, transfer).await {
            Either::First(()) => Err(BusError::NoAcknowledge),
            Either::Second(done) => done.map_err(BusError::from),
        }
    }

    /// Ends the transfer and returns its result. After a success the stop is still going out.
    fn end(mut self, result: Result<(), BusError>) -> Result<(), BusError> {
        match result {
            Ok(()) => {
                self.ended = true;
                Ok(())
            }
            Err(BusError::NoAcknowledge) => {
                // The controller sends the stop by itself (RM0399, 50.4.9); if it were cut off, a chip would take it
                // for part of a byte.
                let _ = self.wiring.is_free();
                Err(BusError::NoAcknowledge)
            }
            Err(error) => Err(error),
        }
    }
}

impl Drop for Transfer<'_> {
    fn drop(&mut self) {
        if !self.ended {
            self.wiring.forget();
        }
    }
}

/// Carries out a transfer of embassy's driver. A macro, so that its future of 150 bytes stays in place: passed between
/// functions it was copied five times, which took a fifteenth of all instructions.
macro_rules! guarded {
    ($wiring:expr, $transfer:expr) => {{
        let guard = Transfer::begin($wiring)?;
        let result = guard.wait(pin!($transfer)).await;
        guard.end(result)
    }};
}

/// Error of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub(crate) enum BusError {
    /// No chip acknowledged the address, or a chip refused a byte.
    NoAcknowledge,
    /// No end in time: a line is held.
    Held,
    /// A START or STOP edge at an illegal place.
    Bus,
    /// Arbitration lost: another master, or a line that does not follow.
    Arbitration,
    /// The controller was not served in time.
    Overrun,
    /// Too many bytes for the buffers, or none.
    BadLength,
}

impl I2cError for BusError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::NoAcknowledge => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown),
            Self::Held | Self::BadLength => ErrorKind::Other,
            Self::Bus => ErrorKind::Bus,
            Self::Arbitration => ErrorKind::ArbitrationLoss,
            Self::Overrun => ErrorKind::Overrun,
        }
    }
}

impl From<Error> for BusError {
    fn from(error: Error) -> Self {
        match error {
            Error::Nack => Self::NoAcknowledge,
            Error::Timeout => Self::Held,
            Error::Arbitration => Self::Arbitration,
            Error::Overrun => Self::Overrun,
            Error::Bus | Error::Crc => Self::Bus,
            Error::ZeroLengthTransfer => Self::BadLength,
        }
    }
}

/// Buffers that DMA reaches, for controllers whose DMA does not reach the tasks' memory: one transfer of the
/// passthrough in each direction.
pub(crate) struct Bounce {
    out: [u8; MAX_RAW],
    back: [u8; MAX_RAW],
}

impl Bounce {
    /// Creates the empty buffers.
    pub(crate) const fn new() -> Self {
        Self { out: [0; MAX_RAW], back: [0; MAX_RAW] }
    }
}

/// Driver of a connector's bus.
pub(crate) struct Bus {
    driver: I2c<'static, Async, Master>,
    wiring: Wiring,
    bounce: Option<&'static mut Bounce>,
}

impl Bus {
    /// Creates the driver. `driver` must be that of the `wiring`'s controller. With `bounce` every byte goes through
    /// it.
    pub(crate) fn new(
        driver: I2c<'static, Async, Master>,
        wiring: Wiring,
        bounce: Option<&'static mut Bounce>,
    ) -> Self {
        wiring.start();
        Self { driver, wiring, bounce }
    }
}

impl ErrorType for Bus {
    type Error = BusError;
}

impl I2cBus for Bus {
    async fn read(&mut self, address: u8, read: &mut [u8]) -> Result<(), BusError> {
        let Some(bounce) = &mut self.bounce else {
            return guarded!(&self.wiring, self.driver.read(address, read));
        };
        let back = bounce.back.get_mut(..read.len()).ok_or(BusError::BadLength)?;
        guarded!(&self.wiring, self.driver.read(address, back))?;
        read.copy_from_slice(back);
        Ok(())
    }

    async fn write(&mut self, address: u8, write: &[u8]) -> Result<(), BusError> {
        let Some(bounce) = &mut self.bounce else {
            return guarded!(&self.wiring, self.driver.write(address, write));
        };
        let out = bounce.out.get_mut(..write.len()).ok_or(BusError::BadLength)?;
        out.copy_from_slice(write);
        guarded!(&self.wiring, self.driver.write(address, out))
    }

    async fn write_read(&mut self, address: u8, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let Some(bounce) = &mut self.bounce else {
            return guarded!(&self.wiring, self.driver.write_read(address, write, read));
        };
        let Bounce { out, back } = bounce;
        let out = out.get_mut(..write.len()).ok_or(BusError::BadLength)?;
        let back = back.get_mut(..read.len()).ok_or(BusError::BadLength)?;
        out.copy_from_slice(write);
        guarded!(&self.wiring, self.driver.write_read(address, out, back))?;
        read.copy_from_slice(back);
        Ok(())
    }

    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), BusError> {
        match operations {
            [Operation::Write(write)] => self.write(address, write).await,
            [Operation::Read(read)] => self.read(address, read).await,
            [Operation::Write(write), Operation::Read(read)] => self.write_read(address, write, read).await,
            // The firmware uses no other shapes.
            _ if self.bounce.is_some() => Err(BusError::BadLength),
            _ => guarded!(&self.wiring, self.driver.transaction(address, operations)),
        }
    }
}

/// Guard of the lines while they are driven by GPIO. Dropping it, at any moment, returns them to the controller.
struct ByHand(Wiring);

impl ByHand {
    /// Takes both lines, which are open-drain already, for the controller.
    fn take(wiring: Wiring) -> Self {
        wiring.registers.cr1().modify(|w| w.set_pe(false));
        let lines = Self(wiring);
        lines.mode(Moder::OUTPUT);
        lines
    }

    fn mode(&self, mode: Moder) {
        for line in [self.0.scl, self.0.sda] {
            line.set(true);
            // Other tasks change their pins of the same port, some in interrupts.
            critical_section::with(|_| {
                line.registers().moder().modify(|w| w.set_moder(usize::from(line.number), mode));
            });
        }
    }
}

impl Drop for ByHand {
    fn drop(&mut self) {
        self.mode(Moder::ALTERNATE);
        (self.0.reset)();
        self.0.start();
    }
}

impl platform::Bus for Bus {
    async fn recover(&mut self) {
        self.wiring.free().await;
    }
}
