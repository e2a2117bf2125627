//! Tests on a bare Giga R1, with nothing at its headers: clocks, reset cause, lights, inputs, pull-ups, flash.
//!
//! `docs/bring-up.md` describes how to run them. Only the lines that hold bridges off, the lights and DAC_LDAC_N are
//! driven.
#![no_std]
#![no_main]
#![allow(dead_code, unused_imports, unused_macros, reason = "of the firmware's modules each test needs a part")]
#![allow(unexpected_cfgs, reason = "embedded-test asks for `rust_analyzer`")]

#[path = "../src/bus_faults.rs"]
mod bus_faults;
#[path = "../src/clocks.rs"]
mod clocks;
mod common;
#[path = "../src/cycles.rs"]
mod cycles;
#[path = "../src/flash.rs"]
mod flash;
#[path = "../src/pins.rs"]
mod pins;
#[path = "../src/reset.rs"]
mod reset;
#[path = "../src/safety_pins.rs"]
mod safety_pins;
#[path = "../src/watchdog.rs"]
mod watchdog;

#[allow(unsafe_code, reason = "the harness exports each test by its name")]
#[embedded_test::tests(default_timeout = 20)]
mod tests {
    use cortex_m::peripheral::DWT;
    use defmt::{assert, assert_eq, info};
    use embassy_stm32::{
        Peripherals,
        gpio::{Flex, Input, Pull},
        pac::{PWR, RCC, TIM16, rcc::vals::Lsedrv},
    };
    use embassy_time::{Duration, Instant, Timer};
    use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};

    use crate::{
        clocks::Source,
        common,
        flash::{Bank2, FlashError},
        pins::{self, pin},
        reset::{self, Kind, Record, Start},
    };

    /// Nominal frequency of the processor, Hz.
    const CORE_HZ: u64 = 480_000_000;

    struct Board {
        peripherals: Peripherals,
        source: Source,
        /// Start information, read before anything else, as in the firmware.
        start: Start,
    }

    #[init]
    fn init() -> Board {
        let start = Start::take();
        let (peripherals, source) = common::start();
        Board { peripherals, source, start }
    }

    /// Number of processor cycles while `wait` runs. The counter wraps after 8.9 s.
    fn cycles(wait: impl FnOnce()) -> u64 {
        if let Some(mut core) = cortex_m::Peripherals::take() {
            core.DCB.enable_trace();
            DWT::unlock();
            core.DWT.enable_cycle_counter();
        }
        let start = DWT::cycle_count();
        wait();
        DWT::cycle_count().wrapping_sub(start).into()
    }

    /// Without the crystal the clocks come from an oscillator that is 1 % off, and USB and CAN are out of their
    /// tolerance.
    #[test]
    fn the_crystal_starts(board: Board) {
        assert_eq!(board.source, Source::Crystal);
    }

    /// The ratio of the processor's clock to that of TIM5, which keeps the time, shows the dividers, whatever the
    /// crystal.
    #[test]
    fn the_processor_runs_480_cycles_in_a_microsecond(_board: Board) {
        let wait = || embassy_time::block_for(Duration::from_millis(100));
        let counted = cycles(wait);
        info!("{} cycles in 100 ms", counted);
        // The time is read once at either end, each below 10 us: two ticks of the time and the duration of a read.
        let expected = CORE_HZ / 10;
        assert!(counted.abs_diff(expected) < 20 * CORE_HZ / 1_000_000, "{} instead of {}", counted, expected);
    }

    /// The second crystal of the board drives the only clock that is independent of the first. TIM16 gets its edges
    /// (RM0399, TIM16_TISEL), and half a second of them is counted in cycles.
    #[test]
    fn both_crystals_agree(_board: Board) {
        const EDGES: u32 = 16_384;
        RCC.apb4enr().modify(|w| w.set_rtcapben(true));
        PWR.cr1().modify(|w| w.set_dbp(true));
        while !PWR.cr1().read().dbp() {}
        RCC.bdcr().modify(|w| w.set_lsedrv(Lsedrv::HIGH));
        RCC.bdcr().modify(|w| w.set_lseon(true));
        // The start takes at most 2 s (data sheet, LSE start-up time); twice that is allowed.
        let end = Instant::now() + Duration::from_secs(4);
        while !RCC.bdcr().read().lserdy() {
            assert!(Instant::now() < end, "the 32.768 kHz crystal does not start");
        }
        RCC.apb2enr().modify(|w| w.set_tim16en(true));
        let _ = RCC.apb2enr().read();
        TIM16.tisel().modify(|w| w.set_tisel(0, 2));
        TIM16.ccmr_input(0).modify(|w| w.0 = 0b01);
        TIM16.ccer().modify(|w| w.set_cce(0, true));
        TIM16.cr1().modify(|w| w.set_cen(true));
        let edge = || {
            // Edges are 30.5 us apart.
            let end = Instant::now() + Duration::from_millis(1);
            while !TIM16.sr().read().ccif(0) {
                assert!(Instant::now() < end, "no edge");
            }
            // Reading the capture clears its flag.
            let _ = TIM16.ccr(0).read();
        };
        edge();
        let counted = cycles(|| (0..EDGES).for_each(|_| edge()));
        RCC.bdcr().modify(|w| w.set_lseon(false));
        info!("{} cycles in half a second of the small crystal", counted);
        // Both crystals are accurate to about 30 ppm; 200 leave room for temperature, and still detect an internal
        // oscillator.
        let expected = CORE_HZ / 2;
        assert!(counted.abs_diff(expected) < expected / 5000, "{} instead of {}", counted, expected);
    }

    /// The harness resets before each test, by the pin or by software; neither is a watchdog.
    #[test]
    fn the_reset_cause_can_be_read_and_is_cleared(board: Board) {
        const PIN: u32 = 1 << 22;
        const SOFTWARE: u32 = 1 << 24;
        const WATCHDOGS: u32 = 0b1111 << 26;
        info!("{}", board.start);
        if env!("R4_IMAGE_KIND") == "bare" {
            assert!(board.start.flags & (PIN | SOFTWARE) != 0, "{:x}", board.start.flags);
        }
        assert_eq!(board.start.flags & WATCHDOGS, 0);
        assert_eq!(Start::take().flags, 0, "the first look cleared it");
    }

    /// The record of a panic is in registers of the backup domain, which is write-protected after a reset.
    #[test]
    fn a_record_of_a_bad_end_is_kept_once(_board: Board) {
        let record = Record { kind: Kind::Fault, pc: 0x0800_1234, lr: 0x0800_5679, detail: 0x8200, more: 0x4000_0000 };
        reset::leave(&record);
        assert_eq!(Start::take().record, Some(record));
        assert_eq!(Start::take().record, None);
    }

    /// Watch the lights: red, green, blue, each for half a second. The level is read back from the pin.
    #[test]
    async fn the_lights_follow_their_lines(_board: Board) {
        for light in [pins::LED_R, pins::LED_G, pins::LED_B] {
            light.set(false);
            Timer::after_millis(500).await;
            assert!(!light.is_high(), "on");
            light.set(true);
            Timer::after_millis(1).await;
            assert!(light.is_high(), "off");
        }
    }

    /// The lines that turn bridges off keep their levels: nothing else drives them.
    #[test]
    fn the_stop_lines_are_held(_board: Board) {
        cortex_m::asm::delay(480_000);
        assert!(pins::OSMC_DIS.is_high());
        assert!(pins::PCA_OE_N.is_high());
    }

    /// Returns the level of an open line with the given pull; with the firmware's it reads as released.
    async fn follows(line: &mut Flex<'_>, pull: Pull) -> bool {
        line.set_as_input(pull);
        // Time constant of 40 kohm and about 100 pF: 4 us.
        Timer::after_millis(1).await;
        line.is_high()
    }

    #[test]
    async fn open_stop_inputs_read_as_released(board: Board) {
        let p = board.peripherals;
        let mut dead_man = Flex::new(pin!(p, dmh_sense));
        assert!(follows(&mut dead_man, Pull::Up).await, "D53 is held low: take everything off the header");
        assert!(!follows(&mut dead_man, Pull::Down).await, "the dead-man's handle reads as held while it is open");
        let mut stop = Flex::new(pin!(p, estop_in));
        assert!(follows(&mut stop, Pull::Up).await, "D31 is held low: take everything off the header");
        assert!(!follows(&mut stop, Pull::Down).await, "the auxiliary stop reads as not pressed while it is open");
    }

    #[test]
    async fn open_switches_read_high(board: Board) {
        let p = board.peripherals;
        let switches = [
            Input::new(pin!(p, enc0_sw), Pull::Up),
            Input::new(pin!(p, enc1_sw), Pull::Up),
            Input::new(pin!(p, enc2_sw), Pull::Up),
            Input::new(pin!(p, enc3_sw), Pull::Up),
        ];
        Timer::after_millis(1).await;
        for (index, switch) in switches.iter().enumerate() {
            assert!(switch.is_high(), "switch {}", index);
        }
    }

    /// The Giga has the resistors of the board's bus (D20, D21) and of connector B (SDA1, SCL1).
    #[test]
    async fn two_buses_have_pull_ups(board: Board) {
        let p = board.peripherals;
        let lines = [
            Input::new(pin!(p, i2c_board_sda), Pull::Down),
            Input::new(pin!(p, i2c_board_scl), Pull::Down),
            Input::new(pin!(p, i2c_ext2_sda), Pull::Down),
            Input::new(pin!(p, i2c_ext2_scl), Pull::Down),
        ];
        Timer::after_millis(1).await;
        // The pull-down of 40 kohm in the processor is overridden by a few kohm of the board.
        for (index, line) in lines.iter().enumerate() {
            assert!(line.is_high(), "line {}", index);
        }
    }

    const SECTOR: u32 = Bank2::ERASE_SIZE as u32;
    /// Size of a log: parameters are in the first two sectors, trips in the others (`r4_firmware::storage`).
    const LOG: u32 = 2 * SECTOR;

    async fn is_empty(flash: &mut Bank2, from: u32, to: u32) -> Result<bool, FlashError> {
        let mut bytes = [0; 1024];
        for at in (from..to).step_by(bytes.len()) {
            flash.read(at, &mut bytes).await?;
            if bytes.iter().any(|byte| *byte != 0xFF) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Uses the last sector of a log that is completely empty, and leaves it empty: stored data are not touched.
    #[test]
    #[timeout(60)]
    async fn flash_is_written_read_and_erased(board: Board) -> Result<(), &'static str> {
        let failed = |error: FlashError| {
            defmt::error!("{}", error);
            "the flash driver failed"
        };
        let mut flash = Bank2::new(board.peripherals.FLASH);
        let mut scratch = None;
        for log in [LOG, 0] {
            if is_empty(&mut flash, log, log + LOG).await.map_err(failed)? {
                scratch = Some(log + SECTOR);
                break;
            }
        }
        let Some(sector) = scratch else {
            return Err("not run: the board keeps parameters and trips, no sector is free");
        };
        info!("sector at {:x}", sector);
        let mut written = [0_u8; 96];
        written.iter_mut().zip(1..).for_each(|(byte, index)| *byte = index);
        let at = sector + SECTOR - 128;
        flash.write(at, &written).await.map_err(failed)?;
        let mut read = [0; 96];
        flash.read(at, &mut read).await.map_err(failed)?;
        assert_eq!(read, written);
        // Before the first and behind the last word.
        assert!(is_empty(&mut flash, sector, sector + SECTOR - 1024).await.map_err(failed)?);
        flash.read(at + 96, &mut read[..32]).await.map_err(failed)?;
        assert_eq!(read[..32], [0xFF; 32]);
        assert_eq!(flash.write(at + 1, &written[..32]).await, Err(FlashError::NotAligned));

        let start = Instant::now();
        flash.erase(sector, sector + SECTOR).await.map_err(failed)?;
        info!("erased in {} ms", start.elapsed().as_millis());
        assert!(is_empty(&mut flash, sector, sector + SECTOR).await.map_err(failed)?);
        Ok(())
    }
}
