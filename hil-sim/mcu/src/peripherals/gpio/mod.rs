//! GPIO ports A to K (RM0399, 12), as one block from 0x5802_0000 on: port n is at n * 0x400.
//!
//! Each change of the chip's output at a pin is passed to [`Outside::drive`]. A pin with a timer's channel has the
//! level of the timer, once there is one; pins of buses (UART, I2C, CAN, SPI) are reported as not driven, because those
//! models work with bytes and frames instead of levels. Locking of pins (LCKR) is not modelled and ends the run. All 16
//! pins of ports J and K have registers, including those that no package brings out.

mod functions;
#[cfg(test)]
mod tests;

use std::collections::HashMap;

use crate::{
    Context, Level, Outside, Peripheral, Pin, Size, Unmodelled,
    peripherals::access::{merged, part},
};

pub use functions::{Function, function_of, pins_for};

const PORTS: usize = 11;

const MODER: u32 = 0x00;
const OTYPER: u32 = 0x04;
const OSPEEDR: u32 = 0x08;
const PUPDR: u32 = 0x0C;
const IDR: u32 = 0x10;
const ODR: u32 = 0x14;
const BSRR: u32 = 0x18;
const LCKR: u32 = 0x1C;
const AFRL: u32 = 0x20;
const AFRH: u32 = 0x24;

/// Mode of a pin, from MODER.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Digital input without an output.
    Input,
    /// Output driven by ODR.
    Output,
    /// Alternate function: a peripheral uses the pin.
    Alternate,
    /// Analog: connected to analog parts; reads as 0.
    Analog,
}

#[derive(Clone, Copy)]
struct Port {
    mode: u32,
    open_drain: u32,
    speed: u32,
    pull: u32,
    output: u32,
    alternate: [u32; 2],
    /// Last reported output state of each pin.
    told: [Level; 16],
}

impl Port {
    /// Makes a port in its reset state (RM0399, 12.4): analog, except the debug pins on ports A and B.
    fn at_reset(index: usize, told: [Level; 16]) -> Self {
        let (mode, speed, pull) = match index {
            0 => (0xABFF_FFFF, 0x0C00_0000, 0x6400_0000),
            1 => (0xFFFF_FEBF, 0x0000_00C0, 0x0000_0100),
            _ => (u32::MAX, 0, 0),
        };
        Self { mode, open_drain: 0, speed, pull, output: 0, alternate: [0; 2], told }
    }

    fn mode_of(&self, number: u8) -> Mode {
        match self.mode >> (2 * number) & 3 {
            0 => Mode::Input,
            1 => Mode::Output,
            2 => Mode::Alternate,
            _ => Mode::Analog,
        }
    }

    fn pull_of(&self, number: u8) -> Option<bool> {
        match self.pull >> (2 * number) & 3 {
            1 => Some(true),
            2 => Some(false),
            _ => None,
        }
    }

    fn alternate_of(&self, number: u8) -> u8 {
        (self.alternate[usize::from(number / 8)] >> (4 * (number % 8)) & 0xF) as u8
    }

    fn is_open_drain(&self, number: u8) -> bool {
        self.open_drain >> number & 1 != 0
    }
}

/// All GPIO ports of the chip.
pub struct Gpio {
    ports: [Port; PORTS],
    /// Levels that timers output on their channels.
    timers: HashMap<Function, bool>,
}

impl Default for Gpio {
    fn default() -> Self {
        Self::new()
    }
}

impl Gpio {
    /// Makes the ports in their power-on state. The outside world assumes that no pin is driven or pulled;
    /// [`Peripheral::reset`], or the first write to the port, reports the differences.
    #[must_use]
    pub fn new() -> Self {
        let told = [Level::Floating(None); 16];
        Self { ports: std::array::from_fn(|index| Port::at_reset(index, told)), timers: HashMap::new() }
    }

    fn port(&self, pin: Pin) -> &Port {
        &self.ports[usize::from(pin.port)]
    }

    /// Returns the mode of a pin.
    #[must_use]
    pub fn mode(&self, pin: Pin) -> Mode {
        self.port(pin).mode_of(pin.number)
    }

    /// Returns the number of a pin's alternate function; `None` in other modes.
    #[must_use]
    pub fn alternate(&self, pin: Pin) -> Option<u8> {
        let port = self.port(pin);
        (port.mode_of(pin.number) == Mode::Alternate).then(|| port.alternate_of(pin.number))
    }

    /// Returns the present function of a pin; `None` if no peripheral uses it.
    #[must_use]
    pub fn function(&self, pin: Pin) -> Option<Function> {
        function_of(pin, self.alternate(pin)?)
    }

    /// Returns the pins that have a function at present.
    pub fn pins_with(&self, function: Function) -> impl Iterator<Item = Pin> {
        pins_for(function).filter(|(pin, af)| self.alternate(*pin) == Some(*af)).map(|(pin, _)| pin)
    }

    /// Returns true if a pin's output is open-drain.
    #[must_use]
    pub fn is_open_drain(&self, pin: Pin) -> bool {
        self.port(pin).is_open_drain(pin.number)
    }

    /// Returns the chip's own pull resistor at a pin: `Some(true)` up, `Some(false)` down.
    #[must_use]
    pub fn pull(&self, pin: Pin) -> Option<bool> {
        self.port(pin).pull_of(pin.number)
    }

    /// Returns true if a pin's digital input is connected, so that its changes reach EXTI and peripherals: in all modes
    /// but analog.
    #[must_use]
    pub fn has_input(&self, pin: Pin) -> bool {
        self.mode(pin) != Mode::Analog
    }

    /// Reports a pin used by an analog peripheral that is not in analog mode.
    pub fn check_analog(&self, pin: Pin, user: &'static str, context: &mut Context<'_>) {
        if self.has_input(pin) {
            context.misuse("GPIO", format!("{pin} is used by {user} and is not in analog mode (RM0399, 12.3.12)"));
        }
    }

    /// Sets the level of a timer's channel from `at_ns` on, `None` if its output is off, on all pins that have it.
    pub fn timer_output(&mut self, function: Function, level: Option<bool>, at_ns: u64, outside: &mut dyn Outside) {
        match level {
            Some(level) => self.timers.insert(function, level),
            None => self.timers.remove(&function),
        };
        let pins: Vec<Pin> = self.pins_with(function).collect();
        for pin in pins {
            self.tell(pin, at_ns, outside);
        }
    }

    /// Returns the output state of a pin.
    #[must_use]
    pub fn driven(&self, pin: Pin) -> Level {
        let port = self.port(pin);
        let high = match port.mode_of(pin.number) {
            // Analog mode disconnects the pull resistors (12.3.12).
            Mode::Analog => return Level::Floating(None),
            Mode::Input => None,
            Mode::Output => Some(port.output >> pin.number & 1 != 0),
            Mode::Alternate => self.function(pin).and_then(|function| self.timers.get(&function).copied()),
        };
        match high {
            Some(false) => Level::Low,
            Some(true) if !port.is_open_drain(pin.number) => Level::High,
            _ => Level::Floating(port.pull_of(pin.number)),
        }
    }

    /// Returns the level at a pin, as its inputs see it: IDR, EXTI, and the peripheral that uses it.
    pub fn level(&self, pin: Pin, now_ns: u64, outside: &mut dyn Outside) -> bool {
        match self.driven(pin) {
            Level::Low => false,
            Level::High => true,
            // In analog mode the input buffer is off and reads 0.
            Level::Floating(_) if self.mode(pin) == Mode::Analog => false,
            Level::Floating(pull) => outside.level(now_ns, pin, pull),
        }
    }

    fn tell(&mut self, pin: Pin, at_ns: u64, outside: &mut dyn Outside) {
        let level = self.driven(pin);
        let told = &mut self.ports[usize::from(pin.port)].told[usize::from(pin.number)];
        if *told != level {
            *told = level;
            outside.drive(at_ns, pin, level);
        }
    }

    fn tell_pins(&mut self, port: usize, pins: u32, context: &mut Context<'_>) {
        for number in (0..16).filter(|number| pins >> number & 1 != 0) {
            self.tell(Pin { port: port as u8, number }, context.now_ns, context.outside);
        }
    }

    fn split(offset: u32) -> Result<(usize, u32), Unmodelled> {
        let port = (offset / 0x400) as usize;
        let register = (offset % 0x400) & !3;
        if port < PORTS && register <= AFRH { Ok((port, register)) } else { Err(Unmodelled::register("GPIO", offset)) }
    }

    fn input(&self, port: usize, context: &mut Context<'_>) -> u32 {
        let level = |number: u8| self.level(Pin { port: port as u8, number }, context.now_ns, context.outside);
        (0..16).map(level).enumerate().fold(0, |word, (number, high)| word | u32::from(high) << number)
    }
}

impl Peripheral for Gpio {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        let (index, register) = Self::split(offset)?;
        let port = &self.ports[index];
        let value = match register {
            MODER => port.mode,
            OTYPER => port.open_drain,
            OSPEEDR => port.speed,
            PUPDR => port.pull,
            IDR => self.input(index, context),
            ODR => port.output,
            BSRR | LCKR => 0,
            AFRL => port.alternate[0],
            _ => port.alternate[1],
        };
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let (index, register) = Self::split(offset)?;
        let port = &mut self.ports[index];
        let before = port.output;
        let into = |word: u32| merged(word, offset, size, value);
        match register {
            MODER => port.mode = into(port.mode),
            OTYPER => port.open_drain = into(port.open_drain) & 0xFFFF,
            OSPEEDR => port.speed = into(port.speed),
            PUPDR => {
                port.pull = into(port.pull);
                let both = port.pull & port.pull >> 1 & 0x5555_5555;
                if both != 0 {
                    let number = both.trailing_zeros() / 2;
                    let pin = Pin { port: index as u8, number: number as u8 };
                    context.misuse("GPIO", format!("{pin}: PUPDR = 3 is reserved (RM0399, 12.4.4)"));
                }
            }
            IDR => {}
            ODR => port.output = into(port.output) & 0xFFFF,
            BSRR => {
                // If both bits are set, setting has priority (12.4.7).
                let bits = into(0);
                port.output = port.output & !(bits >> 16) | bits & 0xFFFF;
            }
            LCKR => return Err(Unmodelled { peripheral: "GPIO", what: "locked pins (LCKR)".into() }),
            AFRL => port.alternate[0] = into(port.alternate[0]),
            _ => port.alternate[1] = into(port.alternate[1]),
        }
        let pins = match register {
            ODR | BSRR => before ^ port.output,
            _ => 0xFFFF,
        };
        self.tell_pins(index, pins, context);
        Ok(())
    }

    /// Resets all ports, with the chip.
    fn reset(&mut self, context: &mut Context<'_>) {
        self.timers.clear();
        for index in 0..PORTS {
            self.reset_port(index, context);
        }
    }
}

impl Gpio {
    /// Resets one port, as RCC does; 0 is port A.
    pub fn reset_port(&mut self, index: usize, context: &mut Context<'_>) {
        self.ports[index] = Port::at_reset(index, self.ports[index].told);
        self.tell_pins(index, 0xFFFF, context);
    }
}
