//! MCP4728: four 12-bit voltage outputs with an EEPROM (Microchip DS22187).
//!
//! - At power-up the outputs come from the EEPROM, before any firmware runs; as delivered it selects the internal reference.
//!   [`Mcp4728::init`] puts the safe codes there once.
//! - While the EEPROM is being written, at most 50 ms, the chip ignores every command, a stop included. Only `init`
//!   writes it, so `init` must not be called while outputs may move.
//! - The LDAC pin must be low, or [`Mcp4728::set`] changes no output.
//! - General call 06h takes the outputs back to the EEPROM's codes. It also resets a PCA9685: never send it on this bus.

use embassy_time::{Duration, Instant, Timer};
use embedded_hal_async::i2c::I2c;

use super::{ChipError, compare};
use crate::platform::Write;

/// Outputs of the chip: A, B, C, D.
pub const OUTPUTS: usize = 4;
/// Highest code; the output is the supply times code / 4096 (4.7).
pub const CODE_MAX: u16 = 4095;

/// Multi-write of an input register (5.6.2): `01000`, DAC1, DAC0, then UDAC, which is 0 to change the output at once.
const MULTI_WRITE: u8 = 0b0100_0000;
/// Sequential write (5.6.3) of input registers and EEPROM from A to D, UDAC 0.
const SEQUENTIAL_WRITE: u8 = 0b0101_0000;
/// RDY/BSY in the first byte of every register read (5.6.11): 0 while the EEPROM is being written.
const READY: u8 = 1 << 7;
/// Longest write of the EEPROM (1.0, electrical characteristics).
const EEPROM_WRITE_MAX: Duration = Duration::from_millis(50);
/// Interval between two polls of RDY/BSY.
const POLL: Duration = Duration::from_millis(1);

/// Bytes per output in a read, which always starts at output A (5.6.11).
const BYTES_PER_OUTPUT: usize = 6;
/// Offset within an output's six bytes: the first three are the input register, the others the EEPROM.
#[derive(Clone, Copy)]
enum Half {
    Input = 0,
    Eeprom = 3,
}

/// An MCP4728 at one address, with its supply as reference. Each call borrows the bus.
#[derive(Clone, Copy, Debug)]
pub struct Mcp4728 {
    address: u8,
}

impl Mcp4728 {
    /// Creates a driver of the chip at `address`.
    #[must_use]
    pub const fn new(address: u8) -> Self {
        Self { address }
    }

    /// Sets all outputs to `codes` with the supply as reference, reads back, and stores the codes in the EEPROM if it
    /// holds others.
    ///
    /// Takes 0.9 ms at 400 kHz, and another 50 ms for a write of the EEPROM, which is skipped where possible: its
    /// endurance of 10⁶ writes is not used up by starting the board. Waits for a write of the EEPROM that was begun
    /// before a reset of the processor.
    ///
    /// # Errors
    /// [`ChipError::Bus`] for a failed transfer; [`ChipError::Mismatch`] for a register that does not hold what was
    /// written, with `register` the index among the 24 bytes read, or, as `register` 0, for RDY/BSY low for more than
    /// 50 ms.
    pub async fn init<B: I2c>(&self, bus: &mut B, codes: [u16; OUTPUTS]) -> Result<(), ChipError<B::Error>> {
        self.wait_ready(bus).await?;
        self.force(bus, codes).await?;
        let read = self.read(bus).await?;
        compare_half(&read, Half::Input, &codes)?;
        if compare_half::<B::Error>(&read, Half::Eeprom, &codes).is_ok() {
            return Ok(());
        }
        let mut command = [SEQUENTIAL_WRITE; 1 + 2 * OUTPUTS];
        put_settings(&mut command[1..], &codes);
        bus.write(self.address, &command).await?;
        self.wait_ready(bus).await?;
        let read = self.read(bus).await?;
        compare_half(&read, Half::Input, &codes)?;
        compare_half(&read, Half::Eeprom, &codes)
    }

    /// Sets all outputs to `codes` with the supply as reference, whatever the chip was set to, and reads nothing back:
    /// the part of [`Mcp4728::init`] that changes outputs, 0.3 ms at 400 kHz. A chip that is writing its EEPROM ignores
    /// it.
    ///
    /// # Errors
    /// The bus's error, for a failed transfer.
    pub async fn force<B: I2c>(&self, bus: &mut B, codes: [u16; OUTPUTS]) -> Result<(), B::Error> {
        let mut command = [0; 3 * OUTPUTS];
        for ((bytes, code), output) in command.chunks_exact_mut(3).zip(codes).zip(0..) {
            let [upper, lower] = setting(code);
            bytes.copy_from_slice(&[MULTI_WRITE | output << 1, upper, lower]);
        }
        bus.write(self.address, &command).await
    }

    /// Changes the outputs from `written` (`None`: unknown) to `codes`, each at the end of its two bytes.
    ///
    /// A fast write (5.6.1), from A to the last output that changes: 70, 115, 160 or 205 µs at 400 kHz; no transfer
    /// when nothing changes. It leaves reference, gain and EEPROM alone. A flipped bit can turn it into a command that
    /// changes the first two, which [`Mcp4728::verify`] finds, but no single flipped bit turns it into a write of the
    /// EEPROM.
    ///
    /// # Errors
    /// The bus's error, for a failed transfer; each output then has its old or its new code.
    pub async fn set<B: I2c>(
        &self,
        bus: &mut B,
        codes: [u16; OUTPUTS],
        written: Option<[u16; OUTPUTS]>,
    ) -> Result<(), B::Error> {
        match self.change(codes, written) {
            Some(write) => write.send(bus).await,
            None => Ok(()),
        }
    }

    /// Returns the write of [`Mcp4728::set`]; `None` when nothing changes.
    #[must_use]
    pub fn change(&self, codes: [u16; OUTPUTS], written: Option<[u16; OUTPUTS]>) -> Option<Write> {
        let changes = |output: &usize| written.is_none_or(|written| written[*output] != codes[*output]);
        let last = (0..OUTPUTS).rev().find(changes)?;
        let mut command = [0; Write::MAX];
        put_settings(&mut command, &codes);
        Some(Write::new(self.address, command, 2 * (last + 1)))
    }

    /// Reads back as many outputs as `codes` has, from A on, and compares; also checks that the chip takes commands.
    ///
    /// Takes 93, 228, 363 or 498 µs at 400 kHz: a read always starts at output A.
    ///
    /// # Errors
    /// [`ChipError::Bus`] for a failed transfer; [`ChipError::Mismatch`] for a register that does not hold what was
    /// written, or, as `register` 0, for a chip that is writing its EEPROM.
    pub async fn verify<B: I2c>(&self, bus: &mut B, codes: &[u16]) -> Result<(), ChipError<B::Error>> {
        let codes = &codes[..codes.len().min(OUTPUTS)];
        let Some(others) = codes.len().checked_sub(1) else { return Ok(()) };
        let mut read = [0; BYTES_PER_OUTPUT * OUTPUTS];
        let read = &mut read[..BYTES_PER_OUTPUT * others + 3];
        bus.read(self.address, read).await?;
        compare(0, [READY], [read[0] & READY])?;
        compare_half(read, Half::Input, codes)
    }

    /// Reads input registers and EEPROM of all outputs (figure 5-15).
    async fn read<B: I2c>(&self, bus: &mut B) -> Result<[u8; BYTES_PER_OUTPUT * OUTPUTS], B::Error> {
        let mut read = [0; BYTES_PER_OUTPUT * OUTPUTS];
        bus.read(self.address, &mut read).await?;
        Ok(read)
    }

    /// Waits until RDY/BSY says that no write of the EEPROM is under way, at most [`EEPROM_WRITE_MAX`].
    async fn wait_ready<B: I2c>(&self, bus: &mut B) -> Result<(), ChipError<B::Error>> {
        let give_up = Instant::now() + EEPROM_WRITE_MAX;
        loop {
            let last = Instant::now() >= give_up;
            let mut status = [0];
            bus.read(self.address, &mut status).await?;
            let ready = compare(0, [READY], [status[0] & READY]);
            if ready.is_ok() || last {
                return ready;
            }
            Timer::after(POLL).await;
        }
    }
}

/// Two bytes of a setting: VREF 0 (the supply), PD 00 (powered), gain 0 (1), then the code. They are also those of a
/// fast write.
fn setting(code: u16) -> [u8; 2] {
    code.min(CODE_MAX).to_be_bytes()
}

fn put_settings(bytes: &mut [u8], codes: &[u16]) {
    for (bytes, code) in bytes.chunks_exact_mut(2).zip(codes) {
        bytes.copy_from_slice(&setting(*code));
    }
}

/// Compares one half (input register or EEPROM) of each output in `read` with its code.
fn compare_half<E>(read: &[u8], half: Half, codes: &[u16]) -> Result<(), ChipError<E>> {
    let outputs = read.chunks(BYTES_PER_OUTPUT).zip((0..).step_by(BYTES_PER_OUTPUT));
    outputs.zip(codes).try_for_each(|((bytes, first), code)| {
        let position = half as usize + 1;
        compare(first + position as u8, setting(*code), [bytes[position], bytes[position + 1]])
    })
}

#[cfg(test)]
mod tests {
    extern crate std;

    use core::{
        cell::{Cell, RefCell},
        convert::Infallible,
    };
    use std::{rc::Rc, vec, vec::Vec};

    use embassy_futures::block_on;
    use embedded_hal::i2c::{ErrorType, Operation};

    use super::*;
    use crate::testing::Tasks;

    const ADDRESS: u8 = 0x60;
    const CODES: [u16; OUTPUTS] = [0, 1, 0xABC, CODE_MAX];

    /// Bytes read from a chip: for each output the input register, then the EEPROM (figure 5-15).
    type Image = [u8; 24];

    /// Sets RDY/BSY and power-on-reset, then the output's number and the address, in each first byte: none of these was
    /// written.
    fn image(input: [u16; OUTPUTS], eeprom: [u16; OUTPUTS]) -> Image {
        let mut image = [0; 24];
        for (place, code) in input.into_iter().zip(eeprom).flat_map(|(input, eeprom)| [input, eeprom]).enumerate() {
            let [upper, lower] = code.to_be_bytes();
            image[3 * place..][..3].copy_from_slice(&[0xC0 | (place as u8 / 2) << 4, upper, lower]);
        }
        image
    }

    /// Fake chip whose contents the test sets; it records the writes.
    #[derive(Clone)]
    struct Chip {
        shows: Rc<Cell<Image>>,
        /// Moment from which on RDY/BSY is high.
        ready_at: Rc<Cell<Instant>>,
        /// Contents after a write of the EEPROM, and the duration of that write.
        written: Image,
        takes: Duration,
        writes: Rc<RefCell<Vec<Vec<u8>>>>,
        reads: Rc<RefCell<Vec<usize>>>,
    }

    impl Chip {
        fn new(shows: Image) -> Self {
            Self {
                shows: Rc::new(Cell::new(shows)),
                ready_at: Rc::new(Cell::new(Instant::MIN)),
                written: shows,
                takes: Duration::MIN,
                writes: Rc::default(),
                reads: Rc::default(),
            }
        }
    }

    impl ErrorType for Chip {
        type Error = Infallible;
    }

    impl I2c for Chip {
        async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), Infallible> {
            assert_eq!((address, operations.len()), (ADDRESS, 1));
            match &mut operations[0] {
                Operation::Write(bytes) => {
                    self.writes.borrow_mut().push(bytes.to_vec());
                    if bytes[0] & 0xF8 == 0x50 {
                        self.shows.set(self.written);
                        self.ready_at.set(Instant::now() + self.takes);
                    }
                }
                Operation::Read(bytes) => {
                    let mut shows = self.shows.get();
                    if Instant::now() < self.ready_at.get() {
                        shows[0] &= 0x7F;
                    }
                    bytes.copy_from_slice(&shows[..bytes.len()]);
                    self.reads.borrow_mut().push(bytes.len());
                }
            }
            Ok(())
        }
    }

    /// Multi-writes (figure 5-8): `01000`, output, UDAC 0, then the supply as reference, powered, gain 1, and the code.
    const FORCED: [u8; 12] = [0x40, 0, 0, 0x42, 0, 1, 0x44, 0x0A, 0xBC, 0x46, 0x0F, 0xFF];
    /// A sequential write from output A (figure 5-9).
    const STORED: [u8; 9] = [0x50, 0, 0, 0, 1, 0x0A, 0xBC, 0x0F, 0xFF];

    #[test]
    fn the_eeprom_is_written_only_when_it_holds_something_else() {
        for (eeprom, expected) in [(CODES, vec![FORCED.to_vec()]), ([7; 4], vec![FORCED.to_vec(), STORED.to_vec()])] {
            let mut chip = Chip { written: image(CODES, CODES), ..Chip::new(image(CODES, eeprom)) };
            assert_eq!(block_on(Mcp4728::new(ADDRESS).init(&mut chip, CODES)), Ok(()));
            assert_eq!(*chip.writes.borrow(), expected);
        }
        // Codes above the chip's range are limited to the highest.
        let mut chip = Chip::new(image([CODE_MAX; 4], [CODE_MAX; 4]));
        assert_eq!(block_on(Mcp4728::new(ADDRESS).init(&mut chip, [u16::MAX; 4])), Ok(()));
    }

    /// Every single bit that a chip may show wrong after the set-up is found: in an input register at once and after
    /// the write of the EEPROM, in the EEPROM only after that write. The first byte of each three is no setting.
    #[test]
    fn a_chip_that_does_not_hold_what_was_written_is_found() {
        let good = image(CODES, CODES);
        for (place, bit) in (0..24).flat_map(|place| (0..8).map(move |bit| (place, 1 << bit))) {
            let mut wrong = good;
            wrong[place] ^= bit;
            let (written, read) = (good[place], wrong[place]);
            let mismatch = Err(ChipError::Mismatch { register: place as u8, written, read });
            let is_setting = place % 3 != 0;
            let busy = place == 0 && bit == 0x80;
            for (before, after) in [(wrong, wrong), (image(CODES, [7; 4]), wrong)] {
                let mut chip = Chip { written: after, ..Chip::new(before) };
                let expected = if is_setting { mismatch } else { Ok(()) };
                // A chip that is never ready is covered by another test.
                if !busy {
                    assert_eq!(block_on(Mcp4728::new(ADDRESS).init(&mut chip, CODES)), expected, "{place} {bit:#x}");
                }
            }
            for outputs in 0..=OUTPUTS {
                let mut chip = Chip::new(wrong);
                let result = block_on(Mcp4728::new(ADDRESS).verify(&mut chip, &CODES[..outputs]));
                // Compared are the input registers of those outputs, and RDY/BSY of the first.
                let expected = match () {
                    () if outputs > 0 && busy => Err(ChipError::Mismatch { register: 0, written: 0x80, read: 0 }),
                    () if is_setting && place % 6 < 3 && place / 6 < outputs => mismatch,
                    () => Ok(()),
                };
                assert_eq!(result, expected, "{outputs} outputs, {place} {bit:#x}");
            }
        }
    }

    #[test]
    fn as_much_is_read_back_as_is_compared() {
        for (outputs, length) in [(1, 3), (2, 9), (3, 15), (4, 21), (5, 21)] {
            let mut chip = Chip::new(image(CODES, CODES));
            let codes: Vec<_> = CODES.into_iter().chain([0]).take(outputs).collect();
            assert_eq!(block_on(Mcp4728::new(ADDRESS).verify(&mut chip, &codes)), Ok(()));
            assert_eq!(*chip.reads.borrow(), [length]);
        }
    }

    /// For every set of outputs that change, the write ends with the last of them.
    #[test]
    fn a_change_is_sent_up_to_the_last_output_that_differs() {
        let chip = Mcp4728::new(ADDRESS);
        let bytes = [0, 0, 0, 1, 0x0A, 0xBC, 0x0F, 0xFF];
        for differs in 0..16u32 {
            let before = core::array::from_fn(|output| CODES[output] ^ (differs >> output & 1) as u16);
            let length = (0..4).filter(|output| differs >> output & 1 != 0).max().map(|last| 2 * (last + 1));
            let change = chip.change(CODES, Some(before));
            assert_eq!(change.as_ref().map(Write::bytes), length.map(|length| &bytes[..length]));
            let mut bus = Chip::new(image(CODES, CODES));
            assert_eq!(block_on(chip.set(&mut bus, CODES, Some(before))), Ok(()));
            assert_eq!(*bus.writes.borrow(), change.iter().map(|write| write.bytes().to_vec()).collect::<Vec<_>>());
        }
        assert_eq!(chip.change(CODES, None).as_ref().map(Write::bytes), Some(&bytes[..]));
        assert_eq!(chip.change(CODES, None).map(|write| write.address()), Some(ADDRESS));
    }

    /// Both a write of the EEPROM from before a reset and the chip's own are waited for, at most 50 ms each.
    #[test]
    fn a_write_of_the_eeprom_is_waited_for() {
        let ms = Duration::from_millis;
        let done = |before: Duration, takes: Duration| {
            let chip = Chip { takes, written: image(CODES, CODES), ..Chip::new(image(CODES, [7; 4])) };
            let begin = Instant::now();
            chip.ready_at.set(begin + before);
            let (result, mut bus) = (Rc::new(Cell::new(None)), chip.clone());
            let (tell, mut tasks) = (result.clone(), Tasks::default());
            tasks.spawn(async move {
                let done = Mcp4728::new(ADDRESS).init(&mut bus, CODES).await;
                tell.set(Some((done, begin.elapsed())));
                core::future::pending::<()>().await;
            });
            tasks.advance(ms(200));
            (result.get().expect("done"), chip.writes.borrow().len())
        };
        let busy = Err(ChipError::Mismatch { register: 0, written: 0x80, read: 0 });
        assert_eq!(done(ms(0), ms(0)), ((Ok(()), ms(0)), 2));
        assert_eq!(done(ms(30), ms(40)), ((Ok(()), ms(70)), 2));
        assert_eq!(done(ms(50), ms(50)), ((Ok(()), ms(100)), 2));
        assert_eq!(done(ms(50) + Duration::from_micros(1), ms(0)), ((busy, ms(50)), 0));
        assert_eq!(done(ms(0), ms(51)), ((busy, ms(50)), 2));
    }
}
