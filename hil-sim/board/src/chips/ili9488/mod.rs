//! Ilitek ILI9488: controller of a TFT with 320 by 480 pixels, on its four-wire serial interface (DBI type C, option 3).
//! Chapters are those of its datasheet, V100.
//!
//! # Time
//! The model is passive: every byte and every edge of a line carries its time, and an earlier time than one already
//! seen counts as that one. A command without parameters acts with its byte, one with parameters with the last of them,
//! a pixel with its third byte. The glass shows the memory at once.
//!
//! #  Properties of the panel
//! The glass is that of the common 3.5 inch module: its filters are in the order blue, green, red, so MADCTL must have
//! BGR set, and its columns run from right to left. The panel makers' commands (gamma, voltages, frame rates) are only
//! checked for their number of parameters.
//!
//! # Where the datasheet leaves room
//! - A command sent too early is executed, and reported.
//! - Pixels outside the memory are ignored; those beyond the window continue at its beginning.
//! - A pixel format that the serial interface does not support leaves the controller at 18 bits per pixel.
//! - Chip select is not modelled: after a pause the serial interface continues where it stopped.
//!
//! Not modelled: 3 bits per pixel, scrolling, partial and idle mode, tearing line, reading the memory.

mod commands;
mod misuse;
#[cfg(test)]
mod tests;
mod wiring;

use crate::misuse::{Misuse, MisuseKind, MisuseLog};
use commands::*;
pub use misuse::ScreenMisuse;
pub use wiring::{ScreenLine, ScreenSpi, ScreenWiring};

/// Number of columns of the memory and of the glass.
pub const COLUMNS: u16 = 320;
/// Number of pages (rows) of the memory and of the glass.
pub const PAGES: u16 = 480;

/// A picture with rows from the top and three bytes per pixel: red, green, blue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Number of pixels in a row.
    pub width: usize,
    /// Number of rows in the picture.
    pub height: usize,
    /// Pixels row by row: `3 * width * height` bytes.
    pub rgb: Vec<u8>,
}

impl Picture {
    /// Red, green, blue of one pixel.
    ///
    /// # Panics
    /// If the pixel is outside the picture.
    #[must_use]
    pub fn pixel(&self, x: usize, y: usize) -> [u8; 3] {
        assert!(x < self.width && y < self.height, "({x}, {y}) is outside {} by {}", self.width, self.height);
        let at = 3 * (y * self.width + x);
        [self.rgb[at], self.rgb[at + 1], self.rgb[at + 2]]
    }

    /// The picture rotated by a quarter turn anticlockwise: the right side becomes the top.
    #[must_use]
    pub fn turned(&self) -> Self {
        let rgb = (0..self.width)
            .flat_map(|y| (0..self.height).flat_map(move |x| self.pixel(self.width - 1 - y, x)))
            .collect();
        Self { width: self.height, height: self.width, rgb }
    }
}

/// A command whose parameters or pixels are being received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Running {
    command: u8,
    /// Number of bytes it needs.
    needed: usize,
    /// Bytes received, the first four of them.
    taken: [u8; 4],
    sent: usize,
}

/// First and last column or page of a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Span {
    start: u16,
    end: u16,
}

impl Span {
    const fn len(self) -> u32 {
        (self.end as u32 + 1).saturating_sub(self.start as u32)
    }
}

/// Start of a time during which commands are too early.
#[derive(Clone, Copy, Debug)]
struct Wait {
    since_ns: u64,
    /// Command that started it; `None` for the reset line.
    after: Option<u8>,
}

/// The controller with its glass.
#[derive(Clone, Debug)]
pub struct Ili9488 {
    now_ns: u64,
    /// Level of D/CX: high for data, low for commands.
    data: bool,
    reset_low_since_ns: Option<u64>,
    /// Time of the last byte, ns.
    byte_ns: Option<u64>,
    clock_reported: bool,

    memory: Vec<[u8; 3]>,
    asleep: bool,
    on: bool,
    inverted: bool,
    madctl: u8,
    colmod: u8,
    columns: Span,
    pages: Span,

    running: Option<Running>,
    /// Last command, finished or not.
    last_command: Option<u8>,
    /// Number of pixels since RAMWR.
    pixels: u32,
    /// True once the running write has exceeded its window, so that it is reported once.
    reported: bool,
    pixel: [u8; 3],
    pixel_bytes: usize,
    reply: Vec<u8>,

    /// Waiting time after a reset, SLPOUT or SLPIN.
    settle: Option<Wait>,
    /// Waiting time before SLPIN or SLPOUT: after the other one, or after a reset in the awake state.
    sleep: Option<Wait>,
    bytes: u64,
    misuse: MisuseLog,
}

impl Default for Ili9488 {
    fn default() -> Self {
        Self::new()
    }
}

impl Ili9488 {
    /// A controller powered up at time 0, asleep, with noise in its memory.
    #[must_use]
    pub fn new() -> Self {
        // any pattern that a program would not draw by accident
        let noise = |n: usize| [0x54, 0xA8, 0xFC].map(|part: u8| part.wrapping_mul((n % 61) as u8) & 0xFC);
        Self {
            now_ns: 0,
            data: false,
            reset_low_since_ns: None,
            byte_ns: None,
            clock_reported: false,
            memory: (0..usize::from(COLUMNS) * usize::from(PAGES)).map(noise).collect(),
            asleep: true,
            on: false,
            inverted: false,
            madctl: 0,
            colmod: FORMAT_18,
            columns: Span { start: 0, end: COLUMNS - 1 },
            pages: Span { start: 0, end: PAGES - 1 },
            running: None,
            last_command: None,
            pixels: 0,
            reported: false,
            pixel: [0; 3],
            pixel_bytes: 0,
            reply: Vec::new(),
            settle: None,
            sleep: None,
            bytes: 0,
            misuse: MisuseLog::new(),
        }
    }

    /// Sets the level of D/CX: low for commands, high for data.
    pub const fn set_data(&mut self, high: bool) {
        self.data = high;
    }

    /// Sets the level of the reset line; low resets.
    pub fn set_reset(&mut self, at_ns: u64, high: bool) {
        self.advance(at_ns);
        match (high, self.reset_low_since_ns) {
            (false, None) => self.reset_low_since_ns = Some(self.now_ns),
            (true, Some(since_ns)) => {
                self.reset_low_since_ns = None;
                let low_ns = self.now_ns - since_ns;
                if low_ns < RESET_LOW_NS {
                    self.report(ScreenMisuse::ResetTooShort { low_ns, needed_ns: RESET_LOW_NS });
                }
                if low_ns > RESET_FILTERED_NS {
                    self.reset(None);
                }
            }
            _ => {}
        }
    }

    /// Takes one byte, most significant bit first, that ends at `at_ns`, and returns the level of SDO meanwhile.
    ///
    /// The reply to a read command starts after one clock without data (4.2.3), so the bytes on the wire are those of
    /// the reply, shifted by one bit.
    pub fn transfer(&mut self, at_ns: u64, byte: u8) -> u8 {
        self.advance(at_ns);
        self.bytes += 1;
        if let Some(last_ns) = self.byte_ns.replace(self.now_ns) {
            let byte_ns = self.now_ns - last_ns;
            if byte_ns < BYTE_NS && !self.clock_reported {
                self.clock_reported = true;
                self.report(ScreenMisuse::ClockTooFast { byte_ns, needed_ns: BYTE_NS });
            }
        }
        if self.reset_low_since_ns.is_some() {
            return 0;
        }
        if !self.reply.is_empty() {
            return self.reply.remove(0);
        }
        if self.data {
            self.take_data(byte)
        } else {
            self.take_command(byte)
        }
        0
    }

    /// Number of bytes received since power-up.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// True while the display is on and awake.
    #[must_use]
    pub const fn is_on(&self) -> bool {
        self.on && !self.asleep
    }

    /// Picture on the glass, upright; black while it is off or asleep.
    #[must_use]
    pub fn picture(&self) -> Picture {
        let (width, height) = (usize::from(COLUMNS), usize::from(PAGES));
        let rgb = (0..width * height)
            .flat_map(|at| {
                if !self.is_on() {
                    return [0; 3];
                }
                let (page, column) = (at / width, width - 1 - at % width);
                let [first, second, third] = self.memory[page * width + column].map(widened);
                // filters in the order blue, green, red: without BGR the first byte of a pixel reaches the blue one
                let shown = if self.madctl & BGR == 0 { [third, second, first] } else { [first, second, third] };
                if self.inverted { shown.map(|part| !part) } else { shown }
            })
            .collect();
        Picture { width, height, rgb }
    }

    /// Violations of the datasheet so far.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    fn advance(&mut self, at_ns: u64) {
        self.now_ns = self.now_ns.max(at_ns);
    }

    #[cold]
    fn report(&mut self, what: ScreenMisuse) {
        let kind = MisuseKind::Screen(what);
        self.misuse.report(Misuse { time_ns: self.now_ns, chip: "ILI9488", address: 0, kind });
    }

    /// Resets by the command `by`, or by the reset line if `None`.
    fn reset(&mut self, by: Option<u8>) {
        let wait = Wait { since_ns: self.now_ns, after: by };
        // a reset in sleep takes 5 ms; out of the awake state, 120 ms until the next SLPOUT
        self.sleep = if self.asleep { self.sleep } else { Some(wait) };
        self.settle = Some(wait);
        (self.asleep, self.on, self.inverted) = (true, false, false);
        (self.madctl, self.colmod) = (0, FORMAT_18);
        self.columns = Span { start: 0, end: COLUMNS - 1 };
        self.pages = Span { start: 0, end: PAGES - 1 };
        (self.running, self.last_command) = (None, None);
        self.reply.clear();
    }

    fn take_command(&mut self, command: u8) {
        self.end_command();
        self.check_time(command);
        self.last_command = Some(command);
        match command {
            NOP | NORON => {}
            SWRESET => self.reset(Some(SWRESET)),
            SLPIN | SLPOUT => {
                let wait = Wait { since_ns: self.now_ns, after: Some(command) };
                if self.asleep != (command == SLPIN) {
                    self.sleep = Some(wait);
                }
                self.settle = Some(wait);
                self.asleep = command == SLPIN;
            }
            INVOFF => self.inverted = false,
            INVON => self.inverted = true,
            DISPOFF => self.on = false,
            DISPON => self.on = true,
            CASET | PASET => self.expect(command, 4),
            MADCTL | COLMOD => self.expect(command, 1),
            RAMWR | RAMWRC => {
                if command == RAMWR {
                    self.pixels = 0;
                }
                (self.pixel_bytes, self.reported) = (0, false);
                if self.asleep {
                    self.report(ScreenMisuse::PixelsWhileAsleep);
                }
                self.expect(command, usize::MAX);
            }
            // manufacturer, version, driver: written by the panel's maker, 0 as delivered; then the driver's own
            RDDID => self.answer(&[0x00, 0x00, 0x00]),
            RDID4 => self.answer(&[0x00, 0x94, 0x88]),
            RDDPM => {
                let bits = [(0x80, true), (0x10, !self.asleep), (0x08, true), (0x04, self.on)];
                let mode = bits.into_iter().filter(|(_, set)| *set).map(|(bit, _)| bit).sum();
                self.answer_byte(mode);
            }
            RDDMADCTL => self.answer_byte(self.madctl),
            RDDCOLMOD => self.answer_byte(self.colmod),
            _ => match PANEL.into_iter().find(|(known, _)| *known == command) {
                Some((_, needed)) => self.expect(command, needed),
                None => self.report(ScreenMisuse::UnknownCommand { command }),
            },
        }
    }

    /// Ends the running command, and reports if it was incomplete.
    fn end_command(&mut self) {
        let Some(running) = self.running.take() else { return };
        match running.command {
            RAMWR | RAMWRC if self.pixel_bytes > 0 => self.report(ScreenMisuse::PixelIncomplete),
            RAMWR | RAMWRC => {}
            command => {
                self.report(ScreenMisuse::ParametersMissing { command, sent: running.sent, needed: running.needed });
            }
        }
    }

    fn check_time(&mut self, command: u8) {
        let changes_sleep = matches!(command, SLPIN | SLPOUT);
        let waits = [(self.settle, SETTLE_NS), (self.sleep.filter(|_| changes_sleep), SLEEP_NS)];
        // only the longer waiting time is reported
        let early = waits.into_iter().rev().find_map(|(wait, needed_ns)| {
            let Wait { since_ns, after } = wait?;
            let waited_ns = self.now_ns - since_ns;
            (waited_ns < needed_ns).then_some(ScreenMisuse::CommandTooEarly { command, after, waited_ns, needed_ns })
        });
        if let Some(early) = early {
            self.report(early);
        }
    }

    const fn expect(&mut self, command: u8, needed: usize) {
        self.running = Some(Running { command, needed, taken: [0; 4], sent: 0 });
    }

    /// Replies with one byte directly after the command (4.2.3: only longer replies have the idle clock).
    fn answer_byte(&mut self, byte: u8) {
        self.reply = vec![byte];
    }

    fn answer(&mut self, bytes: &[u8]) {
        let before = core::iter::once(0).chain(bytes.iter().copied());
        let after = bytes.iter().copied().chain([0]);
        self.reply = before.zip(after).map(|(before, byte)| before << 7 | byte >> 1).collect();
    }

    fn take_data(&mut self, byte: u8) {
        let Some(mut running) = self.running else {
            return self.report(ScreenMisuse::UnexpectedData { command: self.last_command });
        };
        if matches!(running.command, RAMWR | RAMWRC) {
            return self.take_pixel_byte(byte);
        }
        if let Some(place) = running.taken.get_mut(running.sent) {
            *place = byte;
        }
        running.sent += 1;
        self.running = (running.sent < running.needed).then_some(running);
        if self.running.is_none() {
            self.carry_out(running.command, running.taken);
        }
    }

    fn carry_out(&mut self, command: u8, [a, b, c, d]: [u8; 4]) {
        match command {
            MADCTL => self.madctl = a,
            COLMOD if a & FORMAT_MCU == FORMAT_18 & FORMAT_MCU => self.colmod = a,
            COLMOD => self.report(ScreenMisuse::PixelFormat { value: a }),
            CASET | PASET => {
                let (start, end) = (u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]));
                let pages = (command == PASET) != (self.madctl & MV != 0);
                let size = if pages { PAGES } else { COLUMNS };
                if start > end || end >= size {
                    self.report(ScreenMisuse::WindowOutside { start, end, size });
                }
                *(if command == CASET { &mut self.columns } else { &mut self.pages }) = Span { start, end };
            }
            _ => {}
        }
    }

    fn take_pixel_byte(&mut self, byte: u8) {
        self.pixel[self.pixel_bytes] = byte & 0xFC;
        self.pixel_bytes = (self.pixel_bytes + 1) % 3;
        if self.pixel_bytes != 0 {
            return;
        }
        let window = self.columns.len() * self.pages.len();
        if window == 0 {
            return;
        }
        if self.pixels >= window && !self.reported {
            self.reported = true;
            self.report(ScreenMisuse::PixelsBeyondWindow { window });
        }
        let at = self.pixels % window;
        self.pixels = self.pixels.wrapping_add(1);
        let x = u32::from(self.columns.start) + at % self.columns.len();
        let y = u32::from(self.pages.start) + at / self.columns.len();
        let (column, page) = if self.madctl & MV == 0 { (x, y) } else { (y, x) };
        let (columns, pages) = (u32::from(COLUMNS), u32::from(PAGES));
        if column >= columns || page >= pages {
            return;
        }
        let column = if self.madctl & MX == 0 { column } else { columns - 1 - column };
        let page = if self.madctl & MY == 0 { page } else { pages - 1 - page };
        self.memory[(page * columns + column) as usize] = self.pixel;
    }
}

/// Six bits in the upper part of a byte, expanded to eight.
const fn widened(part: u8) -> u8 {
    part | part >> 6
}
