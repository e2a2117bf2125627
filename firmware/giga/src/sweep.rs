//! Safe sweep: writes the safe state to every output chip right after a reset, and repeatedly in hold mode.
//!
//! The chips on the board's I2C bus keep their state over a reset of the processor: relays stay closed, brushless
//! drives keep their voltage, servos their pulses. So they are written first of all, from the internal oscillator that
//! the processor starts with, before the crystal, the flash or any converter could fail or delay this. The writes come
//! from [`r4_firmware::outputs::sweep`] and the usual chip drivers; only the bus driver differs: it waits in loops,
//! with a limit in cycles for each, and needs no interrupt, no DMA and no timer.
//!
//! The bus is clocked by HSI, which the I2C controllers can take directly, so that its timing is the same before the
//! clock tree is set up and after. It must not be used beside [`crate::i2c::BoardBus`].

use embassy_futures::block_on;
use embassy_stm32::pac::{
    I2C2, RCC,
    gpio::vals::{Moder, Ospeedr, Ot, Pupdr},
    i2c::{
        regs::{Icr, Isr},
        vals::{Addmode, Autoend, Dir},
    },
    rcc::vals::{I2c1235sel, Sw},
};
use embedded_hal_async::i2c::{ErrorType, I2c, Operation};
use r4_firmware::{
    outputs::{self, OutputFault},
    platform,
};
use r4_protocol::config::BoardConfig;

use crate::{
    analog,
    cycles::{self, Deadline},
    i2c::{BusError, timingr},
    pins::{I2C_BOARD_SCL as SCL, I2C_BOARD_SDA as SDA, Place, pin},
};

/// Timing of 400 kHz from 64 MHz in steps of 31.25 ns, by the formulas of RM0399, 50.4.5 and 50.4.9: low 1.47 us (at
/// least 1.3), high 0.88 us (at least 0.6), data set up 406 ns before the clock (rise 300 + 100), held for 250 ns (225
/// to 307).
const TIMING: u32 = timingr(1, 12, 8, 27, 46);
/// Time limit of a transfer: twice the longest, which is 13 bytes to the DAC in 0.31 ms.
const TRANSFER_US: u32 = 600;
/// Half a clock period when a bus is freed by GPIO: 100 kHz, which every chip follows.
const HALF_CLOCK_US: u32 = 5;
/// Number of clocks that end any byte that a chip may be sending (UM10204, 3.1.16).
const CLOCKS: u32 = 9;
/// Time limit for the internal oscillator, which starts in 2 us, and takes over within a few cycles (data sheet).
const OSCILLATOR_US: u32 = 100;

/// Switches the processor to its internal oscillator, in case a bootloader has left it on a PLL.
///
/// The clock tree is set up from there later; code that counts cycles relies on it until then.
pub(crate) fn run_from_the_internal_oscillator() {
    let patience = Deadline::after_us(OSCILLATOR_US, cycles::RUNNING_MHZ);
    RCC.cr().modify(|w| w.set_hsion(true));
    while !RCC.cr().read().hsirdy() && !patience.has_passed() {}
    RCC.cfgr().modify(|w| w.set_sw(Sw::HSI));
    while RCC.cfgr().read().sws() != Sw::HSI && !patience.has_passed() {}
}

/// Driver of the safe sweep, with the board's bus.
pub(crate) struct Sweeper {
    bus: Polled,
}

impl Sweeper {
    /// Takes the board's I2C controller, on a processor that runs at `mhz`.
    pub(crate) fn new(mhz: u32) -> Self {
        Self { bus: Polled::start(mhz) }
    }

    /// Writes the safe state of `config` to every output; see [`outputs::sweep`].
    pub(crate) fn sweep(&mut self, config: &BoardConfig) -> Result<(), OutputFault> {
        if !self.bus.is_free() {
            self.bus.free();
        }
        outputs::rest_dacs(config, &mut analog::Outputs::start());
        // The future never waits for anything but the loops below.
        block_on(outputs::sweep(&mut self.bus, config))
    }
}

/// Leaves the controller off, as after a reset, and clocked as embassy expects it.
impl Drop for Sweeper {
    fn drop(&mut self) {
        I2C2.cr1().modify(|w| w.set_pe(false));
        RCC.d2ccip2r().modify(|w| w.set_i2c1235sel(I2c1235sel::PCLK1));
    }
}

/// I2C2 by its registers, without interrupts.
struct Polled {
    mhz: u32,
}

impl Polled {
    fn start(mhz: u32) -> Self {
        RCC.d2ccip2r().modify(|w| w.set_i2c1235sel(I2c1235sel::HSI));
        RCC.apb1lenr().modify(|w| w.set_i2c2en(true));
        RCC.apb1lrstr().modify(|w| w.set_i2c2rst(true));
        RCC.apb1lrstr().modify(|w| w.set_i2c2rst(false));
        for (line, function) in [(SCL, pin!(af i2c_board_scl as I2C2_SCL)), (SDA, pin!(af i2c_board_sda as I2C2_SDA))] {
            let (registers, number) = (line.registers(), usize::from(line.number));
            line.set(true);
            registers.otyper().modify(|w| w.set_ot(number, Ot::OPEN_DRAIN));
            registers.pupdr().modify(|w| w.set_pupdr(number, Pupdr::FLOATING));
            registers.ospeedr().modify(|w| w.set_ospeedr(number, Ospeedr::MEDIUM_SPEED));
            registers.afr(number / 8).modify(|w| w.set_afr(number % 8, function));
            registers.moder().modify(|w| w.set_moder(number, Moder::ALTERNATE));
        }
        I2C2.timingr().write(|w| w.0 = TIMING);
        I2C2.cr1().modify(|w| w.set_pe(true));
        Self { mhz }
    }

    fn deadline(&self, us: u32) -> Deadline {
        Deadline::after_us(us, self.mhz)
    }

    /// Returns true if no chip holds a line.
    fn is_free(&self) -> bool {
        SCL.is_high() && SDA.is_high()
    }

    /// Releases both lines and discards the transfer. PE must stay off for three cycles of its clock; reading it back
    /// takes longer.
    fn forget(&self) {
        I2C2.cr1().modify(|w| w.set_pe(false));
        let _ = (0..3).all(|_| I2C2.cr1().read().pe());
        I2C2.cr1().modify(|w| w.set_pe(true));
    }

    /// Sends clocks until the chip that holds SDA releases it, and ends with a STOP.
    ///
    /// No further clock is sent: a chip in the middle of a byte that it receives would take the rest of it as ones.
    fn free(&self) {
        let wait = || self.deadline(HALF_CLOCK_US).wait();
        I2C2.cr1().modify(|w| w.set_pe(false));
        let mode = |mode| {
            for line in [SCL, SDA] {
                line.set(true);
                line.registers().moder().modify(|w| w.set_moder(usize::from(line.number), mode));
            }
        };
        let pulse = |line: Place| {
            line.set(false);
            wait();
            line.set(true);
            wait();
        };
        mode(Moder::OUTPUT);
        wait();
        for _ in 0..CLOCKS {
            if SDA.is_high() {
                break;
            }
            pulse(SCL);
        }
        // A START and a STOP: data falls and rises while the clock is high.
        pulse(SDA);
        mode(Moder::ALTERNATE);
        I2C2.cr1().modify(|w| w.set_pe(true));
    }

    /// Waits for a flag, an error, or the deadline.
    fn until(&self, ready: fn(&Isr) -> bool, deadline: Deadline) -> Result<(), BusError> {
        loop {
            let flags = I2C2.isr().read();
            match () {
                // The controller sends the stop by itself (RM0399, 50.4.9); if it were cut off, a chip would take it
                // for part of a byte.
                () if flags.nackf() => {
                    while !I2C2.isr().read().stopf() && !deadline.has_passed() {}
                    return Err(BusError::NoAcknowledge);
                }
                () if flags.berr() => return Err(BusError::Bus),
                () if flags.arlo() => return Err(BusError::Arbitration),
                () if ready(&flags) => return Ok(()),
                () if deadline.has_passed() => return Err(BusError::Held),
                () => {}
            }
        }
    }

    fn address(&self, address: u8, dir: Dir, bytes: usize, end: Autoend) {
        I2C2.cr2().write(|w| {
            w.set_sadd(u16::from(address) << 1);
            w.set_add10(Addmode::BIT7);
            w.set_dir(dir);
            w.set_nbytes(bytes as u8);
            w.set_autoend(end);
            w.set_start(true);
        });
    }

    fn carry_out(&self, address: u8, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if !self.is_free() {
            return Err(BusError::Held);
        }
        let deadline = self.deadline(TRANSFER_US);
        I2C2.icr().write_value(Icr(u32::MAX));
        if !write.is_empty() {
            let end = if read.is_empty() { Autoend::AUTOMATIC } else { Autoend::SOFTWARE };
            self.address(address, Dir::WRITE, write.len(), end);
            for byte in write {
                self.until(Isr::txis, deadline)?;
                I2C2.txdr().write(|w| w.set_txdata(*byte));
            }
        }
        if !read.is_empty() {
            if !write.is_empty() {
                self.until(Isr::tc, deadline)?;
            }
            self.address(address, Dir::READ, read.len(), Autoend::AUTOMATIC);
            for byte in read {
                self.until(Isr::rxne, deadline)?;
                *byte = I2C2.rxdr().read().rxdata();
            }
        }
        self.until(Isr::stopf, deadline)
    }

    fn transfer(&self, address: u8, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if usize::from(u8::MAX) < write.len().max(read.len()) {
            return Err(BusError::BadLength);
        }
        let result = self.carry_out(address, write, read);
        if result.is_err() {
            self.forget();
        }
        result
    }
}

impl ErrorType for Polled {
    type Error = BusError;
}

impl I2c for Polled {
    async fn read(&mut self, address: u8, read: &mut [u8]) -> Result<(), BusError> {
        self.transfer(address, &[], read)
    }

    async fn write(&mut self, address: u8, write: &[u8]) -> Result<(), BusError> {
        self.transfer(address, write, &mut [])
    }

    async fn write_read(&mut self, address: u8, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        self.transfer(address, write, read)
    }

    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), BusError> {
        match operations {
            [Operation::Write(write)] => self.transfer(address, write, &mut []),
            [Operation::Read(read)] => self.transfer(address, &[], read),
            [Operation::Write(write), Operation::Read(read)] => self.transfer(address, write, read),
            // The firmware uses no other shapes.
            _ => Err(BusError::BadLength),
        }
    }
}

impl platform::Bus for Polled {
    async fn recover(&mut self) {
        self.free();
    }
}
