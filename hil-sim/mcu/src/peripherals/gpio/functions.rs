//! Alternate functions (DS12930, tables of the alternate functions) of the pins that are brought out on the Arduino
//! Giga R1, and of its debug pins.

use std::sync::LazyLock;

use super::PORTS;
use crate::Pin;

/// Function inside the chip that a pin is connected to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Function {
    /// Timer number and channel.
    Timer(u8, u8),
    /// Timer number and channel, complementary output.
    TimerComplement(u8, u8),
    /// Transmitter of USARTx or UARTx.
    UartTx(u8),
    /// Receiver of USARTx or UARTx.
    UartRx(u8),
    /// Clock line of I2Cx.
    I2cScl(u8),
    /// Data line of I2Cx.
    I2cSda(u8),
    /// Transmit line of FDCANx.
    CanTx(u8),
    /// Receive line of FDCANx.
    CanRx(u8),
    /// Clock SCK of SPIx.
    SpiClock(u8),
    /// Data output MOSI of SPIx.
    SpiMosi(u8),
    /// Data input MISO of SPIx.
    SpiMiso(u8),
    /// Select line NSS of SPIx.
    SpiSelect(u8),
    /// Data line of OTG_FS.
    Usb,
    /// Debug port, JTAG or SWD.
    DebugPort,
}

/// Returns the function of a pin with an alternate function number; `None` if there is none, or none in this table.
#[must_use]
pub fn function_of(pin: Pin, alternate: u8) -> Option<Function> {
    /// Functions by port, number and alternate function.
    static FUNCTIONS: LazyLock<Vec<[[Option<Function>; 16]; 16]>> = LazyLock::new(|| {
        let mut functions = vec![[[None; 16]; 16]; PORTS];
        for (port, number, af, function) in TABLE {
            let pin = Pin::new(port, number);
            functions[usize::from(pin.port)][usize::from(number)][usize::from(af)] = Some(function);
        }
        functions
    });
    *FUNCTIONS.get(usize::from(pin.port))?.get(usize::from(pin.number))?.get(usize::from(alternate))?
}

/// Returns the pins, with their alternate function numbers, that can have a function.
pub fn pins_for(function: Function) -> impl Iterator<Item = (Pin, u8)> {
    TABLE.iter().filter(move |row| row.3 == function).map(|(port, number, af, _)| (Pin::new(*port, *number), *af))
}

use Function::{
    CanRx, CanTx, DebugPort, I2cScl, I2cSda, SpiClock, SpiMiso, SpiMosi, SpiSelect, Timer, TimerComplement, UartRx,
    UartTx, Usb,
};

#[rustfmt::skip]
const TABLE: [(char, u8, u8, Function); 190] = [
    ('A', 0, 1, Timer(2, 1)),
    ('A', 0, 2, Timer(5, 1)),
    ('A', 0, 8, UartTx(4)),
    ('A', 1, 1, Timer(2, 2)),
    ('A', 1, 2, Timer(5, 2)),
    ('A', 1, 4, TimerComplement(15, 1)),
    ('A', 1, 8, UartRx(4)),
    ('A', 2, 1, Timer(2, 3)),
    ('A', 2, 2, Timer(5, 3)),
    ('A', 2, 4, Timer(15, 1)),
    ('A', 2, 7, UartTx(2)),
    ('A', 3, 1, Timer(2, 4)),
    ('A', 3, 2, Timer(5, 4)),
    ('A', 3, 4, Timer(15, 2)),
    ('A', 3, 7, UartRx(2)),
    ('A', 4, 5, SpiSelect(1)),
    ('A', 4, 6, SpiSelect(3)),
    ('A', 4, 8, SpiSelect(6)),
    ('A', 5, 1, Timer(2, 1)),
    ('A', 5, 3, TimerComplement(8, 1)),
    ('A', 5, 5, SpiClock(1)),
    ('A', 5, 8, SpiClock(6)),
    ('A', 6, 2, Timer(3, 1)),
    ('A', 6, 5, SpiMiso(1)),
    ('A', 6, 8, SpiMiso(6)),
    ('A', 6, 9, Timer(13, 1)),
    ('A', 7, 1, TimerComplement(1, 1)),
    ('A', 7, 2, Timer(3, 2)),
    ('A', 7, 3, TimerComplement(8, 1)),
    ('A', 7, 5, SpiMosi(1)),
    ('A', 7, 8, SpiMosi(6)),
    ('A', 7, 9, Timer(14, 1)),
    ('A', 9, 1, Timer(1, 2)),
    ('A', 9, 5, SpiClock(2)),
    ('A', 9, 7, UartTx(1)),
    ('A', 11, 1, Timer(1, 4)),
    ('A', 11, 5, SpiSelect(2)),
    ('A', 11, 6, UartRx(4)),
    ('A', 11, 9, CanRx(1)),
    ('A', 11, 10, Usb),
    ('A', 12, 5, SpiClock(2)),
    ('A', 12, 6, UartTx(4)),
    ('A', 12, 9, CanTx(1)),
    ('A', 12, 10, Usb),
    ('A', 13, 0, DebugPort),
    ('A', 14, 0, DebugPort),
    ('A', 15, 0, DebugPort),
    ('B', 0, 1, TimerComplement(1, 2)),
    ('B', 0, 2, Timer(3, 3)),
    ('B', 0, 3, TimerComplement(8, 2)),
    ('B', 1, 1, TimerComplement(1, 3)),
    ('B', 1, 2, Timer(3, 4)),
    ('B', 1, 3, TimerComplement(8, 3)),
    ('B', 2, 7, SpiMosi(3)),
    ('B', 3, 0, DebugPort),
    ('B', 3, 1, Timer(2, 2)),
    ('B', 3, 5, SpiClock(1)),
    ('B', 4, 0, DebugPort),
    ('B', 4, 2, Timer(3, 1)),
    ('B', 4, 5, SpiMiso(1)),
    ('B', 4, 6, SpiMiso(3)),
    ('B', 4, 7, SpiSelect(2)),
    ('B', 4, 8, SpiMiso(6)),
    ('B', 4, 11, UartTx(7)),
    ('B', 5, 2, Timer(3, 2)),
    ('B', 5, 5, SpiMosi(1)),
    ('B', 5, 9, CanRx(2)),
    ('B', 5, 14, UartRx(5)),
    ('B', 6, 1, TimerComplement(16, 1)),
    ('B', 6, 2, Timer(4, 1)),
    ('B', 6, 4, I2cScl(1)),
    ('B', 6, 6, I2cScl(4)),
    ('B', 6, 7, UartTx(1)),
    ('B', 6, 9, CanTx(2)),
    ('B', 6, 14, UartTx(5)),
    ('B', 7, 1, TimerComplement(17, 1)),
    ('B', 7, 2, Timer(4, 2)),
    ('B', 7, 4, I2cSda(1)),
    ('B', 7, 6, I2cSda(4)),
    ('B', 7, 7, UartRx(1)),
    ('B', 8, 1, Timer(16, 1)),
    ('B', 8, 2, Timer(4, 3)),
    ('B', 8, 4, I2cScl(1)),
    ('B', 8, 6, I2cScl(4)),
    ('B', 8, 8, UartRx(4)),
    ('B', 8, 9, CanRx(1)),
    ('B', 9, 1, Timer(17, 1)),
    ('B', 9, 2, Timer(4, 4)),
    ('B', 9, 4, I2cSda(1)),
    ('B', 9, 5, SpiSelect(2)),
    ('B', 9, 6, I2cSda(4)),
    ('B', 9, 8, UartTx(4)),
    ('B', 9, 9, CanTx(1)),
    ('B', 11, 1, Timer(2, 4)),
    ('B', 11, 4, I2cSda(2)),
    ('B', 11, 7, UartRx(3)),
    ('B', 12, 5, SpiSelect(2)),
    ('B', 12, 9, CanRx(2)),
    ('B', 12, 14, UartRx(5)),
    ('B', 13, 1, TimerComplement(1, 1)),
    ('B', 13, 5, SpiClock(2)),
    ('B', 13, 9, CanTx(2)),
    ('B', 13, 14, UartTx(5)),
    ('B', 14, 1, TimerComplement(1, 2)),
    ('B', 14, 2, Timer(12, 1)),
    ('B', 14, 3, TimerComplement(8, 2)),
    ('B', 14, 4, UartTx(1)),
    ('B', 14, 5, SpiMiso(2)),
    ('B', 15, 1, TimerComplement(1, 3)),
    ('B', 15, 2, Timer(12, 2)),
    ('B', 15, 3, TimerComplement(8, 3)),
    ('B', 15, 4, UartRx(1)),
    ('B', 15, 5, SpiMosi(2)),
    ('C', 1, 5, SpiMosi(2)),
    ('C', 2, 5, SpiMiso(2)),
    ('C', 3, 5, SpiMosi(2)),
    ('C', 6, 2, Timer(3, 1)),
    ('C', 6, 3, Timer(8, 1)),
    ('C', 6, 7, UartTx(6)),
    ('C', 7, 2, Timer(3, 2)),
    ('C', 7, 3, Timer(8, 2)),
    ('C', 7, 7, UartRx(6)),
    ('D', 3, 5, SpiClock(2)),
    ('D', 5, 7, UartTx(2)),
    ('D', 6, 5, SpiMosi(3)),
    ('D', 6, 7, UartRx(2)),
    ('D', 7, 5, SpiMosi(1)),
    ('D', 13, 2, Timer(4, 2)),
    ('D', 13, 4, I2cSda(4)),
    ('E', 4, 4, TimerComplement(15, 1)),
    ('E', 4, 5, SpiSelect(4)),
    ('E', 5, 4, Timer(15, 1)),
    ('E', 5, 5, SpiMiso(4)),
    ('E', 6, 4, Timer(15, 2)),
    ('E', 6, 5, SpiMosi(4)),
    ('G', 9, 5, SpiMiso(1)),
    ('G', 10, 5, SpiSelect(1)),
    ('G', 11, 5, SpiClock(1)),
    ('G', 12, 5, SpiMiso(6)),
    ('G', 13, 5, SpiClock(6)),
    ('G', 14, 5, SpiMosi(6)),
    ('G', 14, 7, UartTx(6)),
    ('H', 4, 4, I2cScl(2)),
    ('H', 6, 2, Timer(12, 1)),
    ('H', 6, 5, SpiClock(5)),
    ('H', 8, 4, I2cSda(3)),
    ('H', 9, 2, Timer(12, 2)),
    ('H', 10, 2, Timer(5, 1)),
    ('H', 11, 2, Timer(5, 2)),
    ('H', 11, 4, I2cScl(4)),
    ('H', 12, 2, Timer(5, 3)),
    ('H', 12, 4, I2cSda(4)),
    ('H', 13, 3, TimerComplement(8, 1)),
    ('H', 13, 8, UartTx(4)),
    ('H', 13, 9, CanTx(1)),
    ('H', 14, 3, TimerComplement(8, 2)),
    ('H', 14, 8, UartRx(4)),
    ('H', 14, 9, CanRx(1)),
    ('H', 15, 3, TimerComplement(8, 3)),
    ('I', 0, 2, Timer(5, 4)),
    ('I', 0, 5, SpiSelect(2)),
    ('I', 1, 5, SpiClock(2)),
    ('I', 2, 3, Timer(8, 4)),
    ('I', 2, 5, SpiMiso(2)),
    ('I', 3, 5, SpiMosi(2)),
    ('I', 5, 3, Timer(8, 1)),
    ('I', 6, 3, Timer(8, 2)),
    ('I', 7, 3, Timer(8, 3)),
    ('I', 9, 8, UartRx(4)),
    ('I', 9, 9, CanRx(1)),
    ('J', 6, 3, Timer(8, 2)),
    ('J', 7, 3, TimerComplement(8, 2)),
    ('J', 8, 1, TimerComplement(1, 3)),
    ('J', 8, 3, Timer(8, 1)),
    ('J', 8, 8, UartTx(8)),
    ('J', 9, 1, Timer(1, 3)),
    ('J', 9, 3, TimerComplement(8, 1)),
    ('J', 9, 8, UartRx(8)),
    ('J', 10, 1, TimerComplement(1, 2)),
    ('J', 10, 3, Timer(8, 2)),
    ('J', 10, 5, SpiMosi(5)),
    ('J', 11, 1, Timer(1, 2)),
    ('J', 11, 3, TimerComplement(8, 2)),
    ('J', 11, 5, SpiMiso(5)),
    ('K', 0, 1, TimerComplement(1, 1)),
    ('K', 0, 3, Timer(8, 3)),
    ('K', 0, 5, SpiClock(5)),
    ('K', 1, 1, Timer(1, 1)),
    ('K', 1, 3, TimerComplement(8, 3)),
    ('K', 1, 5, SpiSelect(5)),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_pin_has_two_functions_at_one_number() {
        for (index, row) in TABLE.iter().enumerate() {
            assert!(TABLE[..index].iter().all(|other| (other.0, other.1, other.2) != (row.0, row.1, row.2)), "{row:?}");
        }
    }

    #[test]
    fn a_wrong_number_is_another_function_or_none() {
        // Expected functions of DS12930, port J and port H: PJ8 is TIM1_CH3N, TIM8_CH1, UART8_TX; PH6 is TIM12_CH1,
        // SPI5_SCK.
        let pin = Pin::new('J', 8);
        assert_eq!(
            [1, 2, 3, 8].map(|af| function_of(pin, af)),
            [Some(TimerComplement(1, 3)), None, Some(Timer(8, 1)), Some(UartTx(8))]
        );
        assert_eq!(function_of(Pin::new('H', 6), 2), Some(Timer(12, 1)));
        assert_eq!(function_of(Pin::new('H', 6), 9), None);
        assert!(pins_for(I2cSda(2)).any(|pair| pair == (Pin::new('B', 11), 4)));
    }

    /// Parses a function's name in data sheets; `None` for those that no test needs.
    fn named(signal: &str) -> Option<Function> {
        let (peripheral, line) = signal.rsplit_once('_')?;
        let number = peripheral.trim_start_matches(|letter: char| !letter.is_ascii_digit());
        let kind = peripheral.strip_suffix(number)?;
        let number = number.parse().ok();
        Some(match (kind, line, number) {
            ("TIM", channel, Some(timer)) => Timer(timer, channel.strip_prefix("CH")?.parse().ok()?),
            ("USART" | "UART", "TX", Some(port)) => UartTx(port),
            ("USART" | "UART", "RX", Some(port)) => UartRx(port),
            ("FDCAN", "TX", Some(bus)) => CanTx(bus),
            ("FDCAN", "RX", Some(bus)) => CanRx(bus),
            ("SPI", "SCK", Some(bus)) => SpiClock(bus),
            ("SPI", "MOSI", Some(bus)) => SpiMosi(bus),
            ("SPI", "MISO", Some(bus)) => SpiMiso(bus),
            ("USB_OTG_FS", "DM" | "DP", None) => Usb,
            // The digit search stops at the 2 of I2C.
            ("I", "SCL", None) => I2cScl(peripheral.strip_prefix("I2C")?.parse().ok()?),
            ("I", "SDA", None) => I2cSda(peripheral.strip_prefix("I2C")?.parse().ok()?),
            _ => return None,
        })
    }

    /// Reads the pins of the R4 carrier from its file: pin, signal, alternate function.
    fn carrier() -> Vec<(Pin, String, u8)> {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../boards/r4-carrier.toml");
        let text = std::fs::read_to_string(path).unwrap();
        let field = |line: &str, name: &str| {
            let (_, rest) = line.split_once(&format!("{name} = "))?;
            let end = rest.find([',', ' ', '}'])?;
            Some(rest[..end].trim_matches('"').to_owned())
        };
        let pin = |line: &str| {
            let (pin, signal, af) = (field(line, "stm32")?, field(line, "signal")?, field(line, "af")?);
            let port = pin.chars().nth(1)?;
            Some((Pin::new(port, pin[2..].parse().ok()?), signal, af.parse().ok()?))
        };
        text.lines().filter_map(pin).collect()
    }

    #[test]
    fn the_carrier_s_pins_have_the_functions_that_its_file_wants() {
        let pins = carrier();
        // Numbers of pins: timers have six for encoders, four for steppers, two for echoes; buses have I2C six, CAN
        // two, UART six, USB two, SPI three.
        assert_eq!(pins.len(), 31);
        for (pin, signal, af) in pins {
            let function = named(&signal);
            assert!(function.is_some(), "{signal}");
            assert_eq!(function_of(pin, af), function, "{pin} {signal}");
        }
    }
}
