//! Tests of instruction set and chip together, with nothing at the pins.

#![allow(clippy::unwrap_used, reason = "failing is a test's way to speak")]

mod faults;
mod flash;
mod options;
mod polling;
mod protection;

use r4_mcu::cpu::{Core, Register};
use r4_mcu::peripherals::{flash::PlainCells, rcc::Oscillators};
use r4_mcu::soc::Soc;
use r4_mcu::{CanFrame, CanOutcome, Chip, Edge, I2cResponse, Level, Machine, Outside, Pin, ResetCause, Settings, Size};
use r4_thumb::ThumbCore;

/// Addresses of the vector table, the handlers and the program, all in bank 1.
const TABLE: u32 = 0x0800_0000;
const HANDLERS: u32 = 0x0800_1000;
const CODE: u32 = 0x0800_2000;
const STACK: u32 = 0x2000_8000;
/// Machine code of `b .`, an endless loop.
const FOR_EVER: u16 = 0xE7FE;

/// Environment without any wiring.
struct Nothing;

impl Outside for Nothing {
    fn drive(&mut self, _: u64, _: Pin, _: Level) {}
    fn poll(&mut self, _: u64, _: &mut Vec<Edge>) {}
    fn next_poll_ns(&mut self, _: u64, _: &[Pin]) -> u64 {
        u64::MAX
    }
    fn level(&mut self, _: u64, _: Pin, pull: Option<bool>) -> bool {
        pull.unwrap_or(false)
    }
    fn volts(&mut self, _: u64, _: Pin) -> f64 {
        0.0
    }
    fn set_volts(&mut self, _: u64, _: Pin, _: f64) {}
    fn i2c_start(&mut self, _: u8, _: u64, _: u8, _: bool) -> I2cResponse {
        I2cResponse::Nack
    }
    fn i2c_write(&mut self, _: u8, _: u64, _: u8) -> I2cResponse {
        I2cResponse::Nack
    }
    fn i2c_read(&mut self, _: u8, _: u64) -> Option<u8> {
        None
    }
    fn i2c_stop(&mut self, _: u8, _: u64) {}
    fn i2c_lines(&mut self, _: u8, _: u64) -> (bool, bool) {
        (true, true)
    }
    fn uart_sent(&mut self, _: u8, _: u64, _: u8) {}
    fn can_sent(&mut self, _: u8, _: u64, _: &CanFrame) -> CanOutcome {
        CanOutcome::NotAcknowledged
    }
}

type Board = Machine<ThumbCore, Soc<Nothing, PlainCells>>;

/// Returns the address of an exception's handler, which loops.
fn handler(exception: u16) -> u32 {
    HANDLERS + 0x20 * u32::from(exception)
}

/// Makes a chip after power-on, about to execute `code`; every handler loops.
fn board(code: &[u16]) -> Board {
    board_with(code, Settings::default())
}

fn board_with(code: &[u16], settings: Settings) -> Board {
    let soc = Soc::new(Nothing, Oscillators::default(), PlainCells::new());
    let mut board = Machine::new(ThumbCore::new(), soc, settings).unwrap();
    write(&board, TABLE, &halves(&[STACK, CODE | 1]));
    for exception in 2..100 {
        write(&board, TABLE + 4 * u32::from(exception), &halves(&[handler(exception) | 1]));
        write(&board, handler(exception), &[FOR_EVER]);
    }
    write(&board, CODE, code);
    board.reset(ResetCause::PowerOn).unwrap();
    board
}

fn halves(words: &[u32]) -> Vec<u16> {
    words.iter().flat_map(|word| [*word as u16, (*word >> 16) as u16]).collect()
}

fn write(board: &Board, address: u32, code: &[u16]) {
    let bytes: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
    board.chip.memory().write_slice(address, &bytes).unwrap();
}

fn set(board: &mut Board, values: &[(u8, u32)]) {
    values.iter().for_each(|(register, value)| board.core.set(Register::R(*register), *value));
}

fn r(board: &Board, register: u8) -> u32 {
    board.core.get(Register::R(register))
}

fn pc(board: &Board) -> u32 {
    board.core.get(Register::Pc)
}

/// Returns the number of the active exception.
fn exception(board: &Board) -> u16 {
    (board.core.get(Register::Xpsr) & 0x1FF) as u16
}

/// Runs for `ns`, through resets and any other stops.
fn run_for(board: &mut Board, ns: u64) {
    let until_ns = board.now_ns() + ns;
    while board.now_ns() < until_ns {
        board.run_until(until_ns).unwrap();
    }
}

fn peek(board: &mut Board, address: u32) -> u32 {
    board.bus_read(address, Size::Word).unwrap()
}
