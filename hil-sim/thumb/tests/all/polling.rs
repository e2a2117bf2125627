//! Skipping of loops that poll a register, which must not change any result.

use std::time::Instant;

use super::*;

const MS: u64 = 1_000_000;
const RCC: u32 = 0x5802_4400;
const USART1: u32 = 0x4001_1000;
const SYSTICK_HANDLER: u16 = 15;

fn with(leave_out_polling: bool, code: &[u16], values: &[(u8, u32)]) -> Board {
    let mut board = board_with(code, Settings { leave_out_polling, ..Settings::default() });
    // SysTick every 100 µs at 64 MHz: adds r7,#1; bx lr
    write(&board, handler(SYSTICK_HANDLER), &[0x3701, 0x4770]);
    set(&mut board, values);
    board
}

/// Returns the complete state that a program can observe.
fn state(board: &mut Board) -> (u64, u64, Vec<u32>, Vec<u32>) {
    let all = (0..13).map(|register| r(board, register)).chain([pc(board), board.core.get(Register::Xpsr)]).collect();
    let stack = (0..32).map(|word| board.chip.memory().read(STACK - 128 + 4 * word, Size::Word).unwrap()).collect();
    (board.now_ns(), board.instructions(), all, stack)
}

/// Program start: str r5,[r4] (RVR); str r6,[r4,#-4] (CTRL): SysTick at 0xE000_E014.
const TICKS: [u16; 3] = [0x6025, 0xF844, 0x6C04];
const TICK: [(u8, u32); 3] = [(4, 0xE000_E014), (5, 6_399), (6, 0b111)];

/// ldr r1,[r0]; orr r1,r1,#0x10000; str r1,[r0] (HSEON); wait: ldr r1,[r0]; lsls r2,r1,#14; bpl wait; adds r3,#1; b .
const WAITS_FOR_HSE: [u16; 9] = [0x6801, 0xF441, 0x3180, 0x6001, 0x6801, 0x038A, 0xD5FC, 0x3301, 0xE7FE];

/// str r1,[r0] (BRR); str r2,[r0,#-12] (CR1: UE, TE); next: wait: ldr r1,[r0,#16] (ISR); lsls r1,r1,#24 (TXE); bpl wait;
/// str r3,[r0,#28] (TDR); adds r3,#1; cmp r3,r8; bne next; b .
const SENDS: [u16; 11] = [0x6001, 0xF840, 0x2C0C, 0x6901, 0x0609, 0xD5FC, 0x61C3, 0x3301, 0x4543, 0xD1F8, 0xE7FE];

/// Makes a program with str r6,[r7] (RCC_APB2ENR), then [`SENDS`], and its registers.
fn sends() -> (Vec<u16>, Vec<(u8, u32)>) {
    let mut code = vec![0x603E];
    code.extend(SENDS);
    let values = vec![(0, USART1 + 12), (1, 555), (2, 0b1001), (3, 0), (6, 1 << 4), (7, RCC + 0xF0), (8, 40)];
    (code, values)
}

#[test]
fn the_state_is_the_same_at_every_moment_with_and_without() {
    let mut waits = TICKS.to_vec();
    waits.extend(WAITS_FOR_HSE);
    let hse = (waits, [&[(0, RCC)][..], &TICK].concat());
    for (code, values) in [hse, sends()] {
        let mut boards = [true, false].map(|leave_out| with(leave_out, &code, &values));
        // The runs are cut at different times, too.
        for step_ns in [1_000, 7_777, 100_001, MS, 3 * MS, 20] {
            let states = boards.each_mut().map(|board| {
                let until_ns = board.now_ns() + step_ns;
                board.run_until(until_ns).unwrap();
                state(board)
            });
            assert_eq!(states[0], states[1], "{step_ns}");
        }
        let [left_out, executed] = boards.map(|board| r(&board, 3));
        assert_eq!(left_out, executed);
        assert!(left_out > 0, "it got through its loop");
    }
}

#[test]
fn waiting_costs_little() {
    let (code, values) = sends();
    let took = [true, false].map(|leave_out| {
        let mut board = with(leave_out, &code, &values);
        let accesses = |board: &mut Board| board.chip.activity().peripherals().map(|(_, all, _)| all).sum::<u64>();
        let began = Instant::now();
        board.run_until(5 * MS).unwrap();
        (accesses(&mut board), began.elapsed())
    });
    eprintln!("5 ms of a blocking UART: {took:?} with and without");
    // Polls are counted, not timed: 5 ms are 57 characters of 86.7 µs; each loop polls some 30 times.
    assert!(took[0].0 * 20 < took[1].0, "{took:?}");
}
