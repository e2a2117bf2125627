//! Tests on a Giga on its carrier, with the motors' supply off: the chips of the board's bus, the dead-man's handle,
//! encoders turned by hand.
//!
//! Ignored by default, since there may be no carrier: `docs/bring-up.md` describes how to run them. Chips are read and
//! never written to.
#![no_std]
#![no_main]
#![allow(dead_code, unused_imports, unused_macros, reason = "of the firmware's modules each test needs a part")]
#![allow(unfulfilled_lint_expectations, reason = "the modules expect to be used whole")]
#![allow(unexpected_cfgs, reason = "embedded-test asks for `rust_analyzer`")]

#[path = "../src/clocks.rs"]
mod clocks;
mod common;
#[path = "../src/cycles.rs"]
mod cycles;
#[path = "../src/encoders/mod.rs"]
mod encoders;
#[path = "../src/i2c/mod.rs"]
mod i2c;
#[path = "../src/pins.rs"]
mod pins;
#[path = "../src/ranging.rs"]
mod ranging;
#[path = "../src/safety_pins.rs"]
mod safety_pins;
#[path = "../src/steppers/mod.rs"]
mod steppers;
#[path = "../src/watchdog.rs"]
mod watchdog;

use embassy_stm32::{
    bind_interrupts, dma, exti,
    i2c::{ErrorInterruptHandler, EventInterruptHandler},
    interrupt::typelevel,
    peripherals,
};

bind_interrupts!(struct Irqs {
    EXTI9_5 => exti::InterruptHandler<typelevel::EXTI9_5>, encoders::lines::Restore;
    EXTI15_10 => encoders::lines::Edges;
    I2C2_EV => EventInterruptHandler<peripherals::I2C2>;
    I2C2_ER => ErrorInterruptHandler<peripherals::I2C2>;
    DMA1_STREAM0 => dma::InterruptHandler<peripherals::DMA1_CH0>;
    DMA1_STREAM1 => dma::InterruptHandler<peripherals::DMA1_CH1>;
});

#[allow(unsafe_code, reason = "the harness exports each test by its name")]
#[embedded_test::tests(default_timeout = 20)]
mod tests {
    use defmt::{assert, assert_eq, info};
    use embassy_stm32::{
        Peripherals,
        exti::ExtiInput,
        gpio::Pull,
        i2c::I2c,
        interrupt::Priority,
        pac,
        peripherals::{I2C2, TIM2},
        rcc,
    };
    use embassy_time::{Duration, Instant, Timer, with_timeout};
    use embedded_hal_async::i2c::I2c as _;
    use r4_firmware::platform::{Bus as _, Encoders};

    use crate::{
        Irqs, common,
        encoders::{
            self, Counters,
            lines::{self, Lines},
        },
        i2c::{Bus, BusError, Timing, Wiring},
        pins::{self, pin},
    };

    /// Chips by their addresses (boards/r4-carrier.toml, our choice within what the data sheets allow).
    const CHIPS: [(u8, &str); 5] = [
        (0x20, "MCP23017, expander"),
        (0x40, "PCA9685, OSMC bridges"),
        (0x41, "PCA9685, DHB bridges"),
        (0x42, "PCA9685, servos"),
        (DAC, "MCP4728, brushless drives"),
    ];
    const DAC: u8 = 0x60;

    #[init]
    fn init() -> Peripherals {
        common::start().0
    }

    /// Bus as the firmware sets it up. LDAC is low since the start.
    fn bus(p: Peripherals) -> Bus {
        Bus::new(
            I2c::new(
                p.I2C2,
                pin!(p, i2c_board_scl as I2C2_SCL),
                pin!(p, i2c_board_sda as I2C2_SDA),
                p.DMA1_CH0,
                p.DMA1_CH1,
                Irqs,
                Timing::FAST.config(false),
            ),
            Wiring {
                registers: pac::I2C2,
                reset: rcc::enable_and_reset::<I2C2>,
                scl: pins::I2C_BOARD_SCL,
                sda: pins::I2C_BOARD_SDA,
                timing: Timing::FAST,
            },
            None,
        )
    }

    /// Returns true if a chip answers at `address`: reading one byte from any pointer changes nothing in any of the
    /// chips.
    async fn answers(bus: &mut Bus, address: u8) -> bool {
        match bus.read(address, &mut [0]).await {
            Ok(()) => true,
            Err(BusError::NoAcknowledge) => false,
            Err(error) => defmt::panic!("at {:x}: {}", address, error),
        }
    }

    /// All addresses that are not reserved (UM10204, 3.1.12).
    #[test]
    #[ignore]
    async fn every_chip_answers_at_its_address(p: Peripherals) {
        let mut bus = bus(p);
        for address in 0x08..0x78 {
            if answers(&mut bus, address).await {
                let known = CHIPS.iter().find(|(at, _)| *at == address);
                info!("{:x}: {}", address, known.map_or("?", |(_, name)| name));
            }
        }
        for (address, name) in CHIPS {
            assert!(answers(&mut bus, address).await, "no answer at {:x}: {}", address, name);
        }
    }

    /// Register 05h holds the All Call address, and the carrier's file relies on 70h (PCA9685 data sheet, ALLCALLADR:
    /// in the upper seven bits). A different chip at the address is unlikely to return the same.
    #[test]
    #[ignore]
    async fn the_pwm_chips_are_pca9685(p: Peripherals) {
        let mut bus = bus(p);
        for address in [0x40, 0x41, 0x42] {
            let mut register = [0];
            let result = bus.write_read(address, &[0x05], &mut register).await;
            assert_eq!((result, register), (Ok(()), [0x70 << 1]), "at {:x}", address);
        }
    }

    /// A read gives 24 bytes, of which each first of three has its channel (MCP4728 data sheet, 5.6.11). The EEPROM
    /// holds what the drives get when power comes: check it before they are connected.
    #[test]
    #[ignore]
    async fn the_dac_says_what_it_powers_up_with(p: Peripherals) {
        let mut bytes = [0; 24];
        assert_eq!(bus(p).read(DAC, &mut bytes).await, Ok(()));
        let (outputs, _) = bytes.as_chunks::<6>();
        for (output, bytes) in outputs.iter().enumerate() {
            assert_eq!(usize::from(bytes[0] >> 4 & 0b11), output);
            assert_eq!(usize::from(bytes[3] >> 4 & 0b11), output);
            for (what, upper, lower) in [("now", bytes[1], bytes[2]), ("at power-up", bytes[4], bytes[5])] {
                let reference = if upper & 0x80 == 0 { "supply" } else { "2.048 V" };
                let code = u16::from_be_bytes([upper & 0x0F, lower]);
                info!(
                    "output {} {}: code {} of 4096, reference {}, power-down {}",
                    output,
                    what,
                    code,
                    reference,
                    upper >> 5 & 0b11
                );
            }
        }
    }

    /// Nine clocks and a stop free a bus; idle chips ignore them.
    #[test]
    #[ignore]
    async fn freeing_the_bus_leaves_the_chips_answering(p: Peripherals) {
        let mut bus = bus(p);
        bus.recover().await;
        for (address, name) in CHIPS {
            assert!(answers(&mut bus, address).await, "no answer at {:x}: {}", address, name);
        }
    }

    /// Needs two hands: release, hold, release. The interrupt sees both changes.
    #[test]
    #[ignore]
    #[timeout(60)]
    async fn the_dead_mans_handle_is_seen(p: Peripherals) {
        const PATIENCE: Duration = Duration::from_secs(15);
        let mut line = ExtiInput::new(pin!(p, dmh_sense as EXTI7), p.EXTI7, Pull::Down, Irqs);
        info!("let go of the dead-man's handle");
        assert!(with_timeout(PATIENCE, line.wait_for_low()).await.is_ok(), "it stays held");
        info!("hold it");
        assert!(with_timeout(PATIENCE, line.wait_for_high()).await.is_ok(), "it stays released");
        info!("let go of it");
        assert!(with_timeout(PATIENCE, line.wait_for_low()).await.is_ok(), "it stays held");
    }

    /// Counts to each side from the initial position: a quarter of a turn of the coarsest usual encoder, 100 lines.
    const TURNED: i16 = 100;

    /// Needs one hand: turn forward, then back past the initial position.
    async fn turned_by_hand(p: Peripherals, index: u8) {
        // The handler of the lines also handles the echoes, and reads their clock.
        rcc::enable_and_reset::<TIM2>();
        let lines = Lines::new(
            lines::Pins {
                track_a: pin!(p, enc3_a as EXTI10),
                track_b: pin!(p, enc3_b as EXTI11),
                echo2: pin!(p, us2_echo as EXTI14),
                echo3: pin!(p, us3_echo as EXTI15),
            },
            [true; 3],
            Priority::P1,
        );
        let mut counters = Counters::new(
            encoders::Parts {
                timer0: p.TIM8,
                tracks0: (pin!(p, enc0_a as TIM8_CH1), pin!(p, enc0_b as TIM8_CH2)),
                timer1: p.TIM3,
                tracks1: (pin!(p, enc1_a as TIM3_CH1), pin!(p, enc1_b as TIM3_CH2)),
                timer2: p.TIM1,
                tracks2: (pin!(p, enc2_a as TIM1_CH1), pin!(p, enc2_b as TIM1_CH2)),
            },
            lines,
            [None; 4],
        );
        info!("turn encoder {} by a quarter of a turn or more, then back past where it began", index);
        let start = counters.count(index);
        let (mut least, mut most) = (0, 0);
        let end = Instant::now() + Duration::from_secs(20);
        while (most < TURNED || least > -TURNED) && Instant::now() < end {
            let now = counters.count(index).wrapping_sub(start) as i16;
            if now < least || now > most {
                info!("{}", now);
            }
            (least, most) = (least.min(now), most.max(now));
            Timer::after_millis(10).await;
        }
        assert!(most >= TURNED && least <= -TURNED, "from {} to {} counts", least, most);
        assert_eq!(counters.illegal(index), 0, "both tracks changed at once");
    }

    #[test]
    #[ignore]
    #[timeout(30)]
    async fn encoder_0_counts_both_ways(p: Peripherals) {
        turned_by_hand(p, 0).await;
    }

    #[test]
    #[ignore]
    #[timeout(30)]
    async fn encoder_1_counts_both_ways(p: Peripherals) {
        turned_by_hand(p, 1).await;
    }

    #[test]
    #[ignore]
    #[timeout(30)]
    async fn encoder_2_counts_both_ways(p: Peripherals) {
        turned_by_hand(p, 2).await;
    }

    #[test]
    #[ignore]
    #[timeout(30)]
    async fn encoder_3_counts_both_ways(p: Peripherals) {
        turned_by_hand(p, 3).await;
    }
}
