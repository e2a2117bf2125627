//! Loop-back tests on a bare Giga R1, off its carrier, with wires between its own headers.
//!
//! | wire | tests |
//! | --- | --- |
//! | D1 to D0 | USART1, the host's link |
//! | D18 to D19 | USART2, connector A |
//! | D16 to D17 | UART4, connector B |
//! | DAC0 to A0, DAC1 to A1 | both converters |
//! | D33 to D53 | heartbeat, dead-man's sense |
//!
//! Ignored by default: `docs/bring-up.md` describes how to run them. On a carrier these outputs reach connectors: never
//! run it there.
#![no_std]
#![no_main]
#![allow(dead_code, unused_imports, unused_macros, reason = "of the firmware's modules each test needs a part")]
#![allow(unexpected_cfgs, reason = "embedded-test asks for `rust_analyzer`")]

#[path = "../src/analog.rs"]
mod analog;
#[path = "../src/clocks.rs"]
mod clocks;
mod common;
#[path = "../src/cycles.rs"]
mod cycles;
#[path = "../src/pins.rs"]
mod pins;
#[path = "../src/links/ring.rs"]
mod ring;
#[path = "../src/safety_pins.rs"]
mod safety_pins;
#[path = "../src/links/uart.rs"]
mod uart;
#[path = "../src/watchdog.rs"]
mod watchdog;

use embassy_stm32::{bind_interrupts, dma, exti, interrupt::typelevel, peripherals, usart};

bind_interrupts!(struct Irqs {
    EXTI9_5 => exti::InterruptHandler<typelevel::EXTI9_5>;
    USART1 => usart::InterruptHandler<peripherals::USART1>, uart::OnLine;
    USART2 => usart::InterruptHandler<peripherals::USART2>, uart::OnLine;
    UART4 => usart::InterruptHandler<peripherals::UART4>, uart::OnLine;
    DMA1_STREAM4 => dma::InterruptHandler<peripherals::DMA1_CH4>;
    DMA1_STREAM5 => uart::OnRing;
    DMA1_STREAM6 => dma::InterruptHandler<peripherals::DMA1_CH6>;
    DMA1_STREAM7 => uart::OnRing;
    DMA2_STREAM0 => dma::InterruptHandler<peripherals::DMA2_CH0>;
    DMA2_STREAM1 => uart::OnRing;
    DMA2_STREAM2 => dma::InterruptHandler<peripherals::DMA2_CH2>;
});

#[allow(unsafe_code, reason = "the harness exports each test by its name")]
#[embedded_test::tests(default_timeout = 20)]
mod tests {
    use defmt::{assert, assert_eq, info};
    use embassy_stm32::{
        Peripherals,
        exti::ExtiInput,
        gpio::{Level, Output, Pull, Speed},
        mode::Async,
        peripherals,
        usart::UartTx,
    };
    use embassy_time::{Duration, Instant, Timer, with_timeout};
    use embedded_hal::digital::{InputPin, OutputPin};
    use embedded_hal_async::digital::Wait;
    use embedded_io_async::{Read, Write};
    use r4_firmware::platform::{AnalogInputs, AnalogOutputs};
    use static_cell::ConstStaticCell;

    use crate::{
        Irqs,
        analog::{self, Inputs, Outputs},
        common,
        pins::pin,
        ring::RING,
        safety_pins::Line,
        uart,
    };

    #[init]
    fn init() -> Peripherals {
        common::start().0
    }

    /// Number of bytes: more than the receiver's ring holds, so that it wraps.
    const BYTES: usize = 3 * RING;

    /// Sends and receives at once, in pieces that fit the ring.
    async fn comes_back(mut rx: uart::Receiver, mut tx: UartTx<'static, Async>) {
        let start = Instant::now();
        // Starts the receiver, and checks that the line is idle.
        let mut piece = [0; 64];
        let noise = with_timeout(Duration::from_millis(20), rx.read(&mut piece)).await;
        assert!(noise.is_err(), "something is received while nothing is sent");
        for from in (0..BYTES).step_by(piece.len()) {
            let sent: [u8; 64] = core::array::from_fn(|index| ((from + index) * 7 / 3) as u8);
            assert!(tx.write_all(&sent).await.is_ok());
            let back = with_timeout(Duration::from_millis(50), rx.read_exact(&mut piece)).await;
            assert!(matches!(back, Ok(Ok(()))), "nothing comes back: is the wire there?");
            assert_eq!(piece, sent, "from byte {}", from);
        }
        info!("{} bytes in {} us", BYTES, start.elapsed().as_micros());
    }

    #[test]
    #[ignore]
    async fn the_hosts_uart_comes_back(p: Peripherals) {
        let tx =
            UartTx::new(p.USART1, pin!(p, uart_dbg_tx as USART1_TX), p.DMA1_CH4, Irqs, uart::config(uart::HOST_BAUD));
        let tx = tx.expect("a baud rate that can be made");
        let rx = uart::receive::<peripherals::USART1>(&tx, pin!(p, uart_dbg_rx as USART1_RX), p.DMA1_CH5);
        comes_back(rx, tx).await;
    }

    #[test]
    #[ignore]
    async fn uart_a_comes_back(p: Peripherals) {
        let tx = UartTx::new(
            p.USART2,
            pin!(p, uart_a_tx as USART2_TX),
            p.DMA1_CH6,
            Irqs,
            uart::config(uart::CONNECTOR_BAUD),
        );
        let tx = tx.expect("a baud rate that can be made");
        let rx = uart::receive::<peripherals::USART2>(&tx, pin!(p, uart_a_rx as USART2_RX), p.DMA1_CH7);
        comes_back(rx, tx).await;
    }

    #[test]
    #[ignore]
    async fn uart_b_comes_back(p: Peripherals) {
        let tx =
            UartTx::new(p.UART4, pin!(p, uart_b_tx as UART4_TX), p.DMA2_CH0, Irqs, uart::config(uart::CONNECTOR_BAUD));
        let tx = tx.expect("a baud rate that can be made");
        let rx = uart::receive::<peripherals::UART4>(&tx, pin!(p, uart_b_rx as UART4_RX), p.DMA2_CH1);
        comes_back(rx, tx).await;
    }

    /// Uses different voltages on the two outputs, so that a swapped pair is seen, and not nearer to the supplies than
    /// 0.2 V, where the buffers of the outputs end (data sheet, DAC characteristics).
    #[test]
    #[ignore]
    async fn voltages_come_back(p: Peripherals) {
        static CODES: ConstStaticCell<[u16; analog::INPUTS]> = ConstStaticCell::new([0; analog::INPUTS]);
        let inputs = Inputs::new(
            p.ADC1,
            analog::Pins {
                input0: pin!(p, ain0 as ADC1_INP4),
                input1: pin!(p, ain1 as ADC1_INP8),
                input2: pin!(p, ain2 as ADC1_INP9),
                input3: pin!(p, ain3 as ADC1_INP5),
                input4: pin!(p, ain4 as ADC1_INP13),
                input5: pin!(p, ain5 as ADC1_INP12),
            },
            p.DMA2_CH2,
            Irqs,
            CODES.take(),
        );
        let Ok(mut inputs) = inputs else { defmt::panic!("the converter does not start") };
        let mut outputs = Outputs::new(p.DAC1, pin!(p, dac_l as DAC1_OUT1), pin!(p, dac_r as DAC1_OUT2));
        for (left, right) in [(256, 3840), (1024, 3072), (2048, 1536), (3072, 1024), (3840, 256)] {
            outputs.set(0, left);
            outputs.set(1, right);
            // Two rounds of all inputs take at most 2 ms; the outputs settle in microseconds.
            Timer::after_millis(5).await;
            for (input, sent) in [(0, left), (1, right)] {
                // Outputs have 12 bits, inputs 16.
                let (read, expected) = (inputs.code(input), sent * 16);
                info!("input {}: {} for {}", input, read, expected);
                // A tolerance of 2 % of the range: both converters' errors together are below 1 % (data sheet, total
                // unadjusted errors).
                assert!(read.abs_diff(expected) < 1311, "input {}: {} instead of {}", input, read, expected);
            }
        }
        outputs.set(0, 0);
        outputs.set(1, 0);
    }

    /// The supervisor's input line and its interrupt, driven by a slow output that rests low.
    #[test]
    #[ignore]
    async fn the_dead_mans_line_wakes_on_both_edges(p: Peripherals) {
        const AT_ONCE: Duration = Duration::from_millis(1);
        let mut heartbeat = Output::new(pin!(p, heartbeat_out), Level::Low, Speed::Low);
        let mut line = Line::Watched(ExtiInput::new(pin!(p, dmh_sense as EXTI7), p.EXTI7, Pull::Down, Irqs));
        for round in 0..100 {
            assert_eq!(line.is_low(), Ok(true), "round {}", round);
            let rise = async {
                Timer::after_micros(100).await;
                let _ = OutputPin::set_high(&mut heartbeat);
            };
            let (_, seen) = embassy_futures::join::join(rise, with_timeout(AT_ONCE, line.wait_for_high())).await;
            assert!(seen.is_ok(), "held is not seen: is the wire there?");
            let fall = async {
                Timer::after_micros(100).await;
                let _ = OutputPin::set_low(&mut heartbeat);
            };
            let (_, seen) = embassy_futures::join::join(fall, with_timeout(AT_ONCE, line.wait_for_low())).await;
            assert!(seen.is_ok(), "released is not seen");
        }
    }
}
