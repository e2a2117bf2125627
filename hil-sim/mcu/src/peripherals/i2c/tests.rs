//! Tests with the manual's sequences (RM0399, 50.4.9), the times of all bus events, and misuse.
//!
//! Clock of 100 MHz: SCLL + 1 + 3 = 124 periods and 10 ns of slope low, SCLH + 1 + 3 = 115 periods and 100 ns high:
//! bits of 1250 + 1250 ns. SCLDEL is 10 periods.

use proptest::prelude::*;

use super::registers::*;
use super::*;
use crate::outside::I2cResponse;
use crate::peripherals::bench::{Bench, OnI2c};
use crate::{Peripheral, Size};

const TIMING: u32 = 9 << 20 | 111 << 8 | 120;
const BIT_NS: u64 = 2_500;
const BYTE_NS: u64 = 9 * BIT_NS;
/// Time from START to the end of the address, ns: tHD:STA and nine bits.
const ADDRESS_NS: u64 = 1_250 + BYTE_NS;
/// Time from an acknowledge bit to STOP, ns.
const STOP_NS: u64 = 2_500;

fn bench(number: u8) -> Bench<I2c> {
    let clocks = Clocks {
        i2c123_hz: 100_000_000,
        i2c4_hz: 100_000_000,
        apb1_hz: 100_000_000,
        apb4_hz: 100_000_000,
        ..Clocks::default()
    };
    Bench::new(I2c::new(number).unwrap(), clocks)
}

fn started(number: u8, extra_cr1: u32) -> Bench<I2c> {
    let mut bench = bench(number);
    bench.write(TIMINGR, TIMING);
    bench.write(CR1, cr1::ANFOFF);
    bench.write(CR1, cr1::ANFOFF | cr1::PE | extra_cr1);
    bench
}

/// Returns CR2 for a START to target 0x42.
fn request(nbytes: u32, flags: u32) -> u32 {
    0x42 << 1 | nbytes << cr2::NBYTES_AT | cr2::START | flags
}

/// Waits for a flag as software does, with time advancing from event to event.
fn wait_for(bench: &mut Bench<I2c>, flag: u32) {
    for _ in 0..1000 {
        if bench.read(ISR) & flag != 0 {
            return;
        }
        let next_ns = bench.peripheral.next_event_ns();
        assert_ne!(next_ns, u64::MAX, "ISR is {:#x}, and nothing will happen", bench.read(ISR));
        bench.run_until(next_ns);
    }
    panic!("ISR is {:#x}", bench.read(ISR));
}

#[test]
fn reset_values() {
    let mut bench = bench(1);
    assert_eq!(bench.read(ISR), 1);
    for offset in [CR1, CR2, OAR1, OAR2, TIMINGR, TIMEOUTR, ICR, PECR, RXDR, TXDR] {
        assert_eq!(bench.read(offset), 0);
    }
    assert!(I2c::new(5).is_none());
}

#[test]
fn scl_is_slower_than_its_counters_by_the_synchronisation() {
    // Table 409, 16 MHz, 400 kHz: PRESC 1, SCLL 9, SCLH 3 are 1750 ns; the manual's example adds 750 ns, at least 250
    // ns.
    let mut bench = bench(1);
    bench.clocks.i2c123_hz = 16_000_000;
    bench.write(TIMINGR, 0x1000_0309);
    let period_ns = 1e9 / bench.peripheral.scl_hz();
    assert!((2_000.0..2_500.0).contains(&period_ns), "{period_ns}");
    // A slower kernel clock and a digital filter both change the frequency.
    bench.write(CR1, 2 << cr1::DNF_AT);
    assert!((1e9 / bench.peripheral.scl_hz() - period_ns - 4.0 * 62.5).abs() < 1.0);
}

#[test]
fn write_two_bytes_with_automatic_end() {
    let mut bench = started(1, 0);
    bench.write(CR2, request(2, cr2::AUTOEND));
    assert_ne!(bench.read(ISR) & isr::BUSY, 0);
    assert_ne!(bench.read(CR2) & cr2::START, 0);
    bench.run_until(ADDRESS_NS - 1);
    assert_eq!(bench.read(ISR) & isr::TXIS, 0);
    bench.run_until(ADDRESS_NS);
    assert_eq!(bench.read(CR2) & cr2::START, 0);
    assert_ne!(bench.read(ISR) & isr::TXIS, 0);
    bench.write(TXDR, 0x11);
    assert_ne!(bench.read(ISR) & isr::TXIS, 0, "the first byte is in the shift register");
    bench.write(TXDR, 0x22);
    assert_eq!(bench.read(ISR) & (isr::TXIS | isr::TXE), 0);
    bench.run_until(1_000_000);
    let end_ns = ADDRESS_NS + 2 * BYTE_NS;
    assert_eq!(
        bench.wires.i2c,
        [
            OnI2c::Start { at_ns: ADDRESS_NS, address: 0x42, read: false },
            OnI2c::Write { at_ns: ADDRESS_NS + BYTE_NS, byte: 0x11 },
            OnI2c::Write { at_ns: end_ns, byte: 0x22 },
            OnI2c::Stop { at_ns: end_ns + STOP_NS },
        ]
    );
    assert_eq!(bench.read(ISR), isr::TXE | isr::STOPF);
    bench.write(ICR, isr::STOPF);
    assert_eq!(bench.read(ISR), isr::TXE);
}

#[test]
fn register_read_with_a_repeated_start() {
    let mut bench = started(2, 0);
    bench.wires.i2c_data = [Some(0xA5), Some(0x5A)].into();
    bench.write(CR2, request(1, 0));
    wait_for(&mut bench, isr::TXIS);
    bench.write(TXDR, 7);
    wait_for(&mut bench, isr::TC);
    let low_ns = ADDRESS_NS + BYTE_NS;
    assert_eq!(bench.now_ns, low_ns);
    bench.write(CR2, request(2, cr2::RD_WRN | cr2::AUTOEND));
    assert_eq!(bench.read(ISR) & isr::TC, 0);
    wait_for(&mut bench, isr::RXNE);
    assert_eq!(bench.read(RXDR), 0xA5);
    wait_for(&mut bench, isr::RXNE);
    assert_eq!(bench.read(RXDR), 0x5A);
    wait_for(&mut bench, isr::STOPF);
    // Sequence: SCL low, high for tSU:STA (SCLL), START, tHD:STA (SCLH), then nine bits.
    let again_ns = low_ns + 1_250 + BIT_NS + BYTE_NS;
    assert_eq!(
        bench.wires.i2c[2..],
        [
            OnI2c::Start { at_ns: again_ns, address: 0x42, read: true },
            OnI2c::Read { at_ns: again_ns + BYTE_NS },
            OnI2c::Read { at_ns: again_ns + 2 * BYTE_NS },
            OnI2c::Stop { at_ns: again_ns + 2 * BYTE_NS + STOP_NS },
        ]
    );
}

#[test]
fn scl_is_held_while_a_byte_to_send_is_late() {
    let mut bench = started(1, 0);
    bench.write(CR2, request(1, cr2::AUTOEND));
    bench.run_until(500_000);
    bench.write(TXDR, 1);
    bench.run_until(1_000_000);
    // The byte ends after SCLDEL from the write, then nine high and eight low phases.
    assert_eq!(bench.wires.i2c[1], OnI2c::Write { at_ns: 500_000 + 100 + 9 * 1_250 + 8 * 1_250, byte: 1 });
}

#[test]
fn scl_is_held_while_a_received_byte_is_not_read() {
    let mut bench = started(1, 0);
    bench.write(CR2, request(2, cr2::RD_WRN | cr2::AUTOEND));
    bench.run_until(500_000);
    assert_eq!(bench.wires.i2c.len(), 2, "the second byte's acknowledge bit waits");
    bench.read(RXDR);
    bench.run_until(1_000_000);
    assert_eq!(bench.wires.i2c[2], OnI2c::Read { at_ns: 500_000 + 1_250 });
}

#[test]
fn reload_continues_after_tcr() {
    let mut bench = started(1, cr1::TCIE);
    bench.write(CR2, request(1, cr2::RELOAD));
    wait_for(&mut bench, isr::TXIS);
    bench.write(TXDR, 1);
    wait_for(&mut bench, isr::TCR);
    assert!(bench.irq(31));
    assert_eq!(bench.read(ISR) & isr::TC, 0);
    bench.write(CR2, 0x42 << 1 | 2 << cr2::NBYTES_AT | cr2::AUTOEND);
    assert!(!bench.irq(31));
    for byte in [2, 3] {
        wait_for(&mut bench, isr::TXIS);
        bench.write(TXDR, byte);
    }
    wait_for(&mut bench, isr::STOPF);
    let bytes: Vec<u8> = bench
        .wires
        .i2c
        .iter()
        .filter_map(|event| if let OnI2c::Write { byte, .. } = event { Some(*byte) } else { None })
        .collect();
    assert_eq!(bytes, [1, 2, 3]);
    assert_eq!(bench.take_misuse(), [""; 0]);
}

#[test]
fn nack_of_the_address_ends_with_stop() {
    let mut bench = started(3, cr1::NACKIE | cr1::STOPIE | cr1::TXDMAEN);
    bench.wires.i2c_answers = [I2cResponse::Nack].into();
    bench.write(CR2, request(5, 0));
    bench.run_until(ADDRESS_NS);
    assert_eq!(bench.read(ISR), isr::NACKF | isr::TXE | isr::BUSY);
    assert!(bench.irq(72) && !bench.dma(74));
    bench.run_until(ADDRESS_NS + STOP_NS);
    assert_eq!(bench.read(ISR), isr::NACKF | isr::STOPF | isr::TXE);
    bench.write(ICR, isr::NACKF | isr::STOPF);
    assert!(!bench.irq(72));
}

#[test]
fn nack_of_a_byte_leaves_the_next_one_in_txdr() {
    let mut bench = started(1, 0);
    bench.wires.i2c_answers = [I2cResponse::Ack, I2cResponse::Nack].into();
    bench.write(CR2, request(3, cr2::AUTOEND));
    wait_for(&mut bench, isr::TXIS);
    bench.write(TXDR, 1);
    bench.write(TXDR, 2);
    wait_for(&mut bench, isr::STOPF);
    assert_eq!(bench.read(ISR), isr::NACKF | isr::STOPF, "TXE is 0");
    bench.write(ISR, isr::TXE); // flush (50.7.7)
    assert_eq!(bench.read(ISR) & isr::TXE, isr::TXE);
    assert_eq!(bench.wires.i2c.len(), 3);
}

#[test]
fn the_next_start_keeps_the_bus_free_time() {
    let mut bench = started(1, 0);
    bench.write(CR2, request(0, cr2::AUTOEND));
    wait_for(&mut bench, isr::STOPF);
    let stop_ns = ADDRESS_NS + STOP_NS;
    assert_eq!(bench.now_ns, stop_ns);
    bench.write(CR2, request(0, cr2::AUTOEND));
    assert_eq!(bench.read(ISR) & isr::BUSY, 0);
    bench.run_until(1_000_000);
    assert_eq!(bench.wires.i2c[2], OnI2c::Start { at_ns: stop_ns + 1_250 + ADDRESS_NS, address: 0x42, read: false });
}

#[test]
fn dma_moves_a_whole_transfer() {
    // I2C4 uses the BDMA, inputs 13 and 14 of DMAMUX2.
    let mut bench = started(4, cr1::TXDMAEN | cr1::RXDMAEN);
    bench.write(CR2, request(3, 0));
    let mut next = 0;
    while bench.read(ISR) & isr::TC == 0 {
        while bench.bdma(14) {
            bench.with(|i2c, context| i2c.write(TXDR, Size::Byte, next, context)).unwrap();
            next += 1;
        }
        let next_ns = bench.peripheral.next_event_ns();
        bench.run_until(next_ns);
    }
    assert_eq!(next, 3, "as many requests as NBYTES");
    assert_eq!(bench.now_ns, ADDRESS_NS + 3 * BYTE_NS, "nothing waited");
    bench.wires.i2c_data = [Some(9)].into();
    bench.write(CR2, request(1, cr2::RD_WRN | cr2::AUTOEND));
    wait_for(&mut bench, isr::RXNE);
    assert!(bench.bdma(13));
    assert_eq!(bench.with(|i2c, context| i2c.read(RXDR, Size::Byte, context)).unwrap(), 9);
    assert!(!bench.bdma(13));
}

#[test]
fn a_stuck_target_never_ends_and_pe_lets_go() {
    for stuck in [0, 1] {
        let mut bench = started(1, cr1::ERRIE);
        bench.wires.i2c_answers = [I2cResponse::Ack, I2cResponse::Stuck].into_iter().skip(1 - stuck).collect();
        bench.write(CR2, request(1, cr2::AUTOEND));
        bench.run_until(ADDRESS_NS);
        if stuck == 1 {
            bench.write(TXDR, 1);
        }
        bench.run_until(1_000_000_000);
        assert_eq!(bench.peripheral.next_event_ns(), u64::MAX);
        assert_eq!(bench.read(ISR) & (isr::BUSY | isr::STOPF), isr::BUSY);
        bench.wires.i2c_lines = (true, false);
        bench.write(CR1, cr1::ANFOFF);
        assert_eq!(bench.read(CR1) & cr1::PE, 0);
        bench.write(CR1, cr1::ANFOFF | cr1::PE);
        assert_eq!(bench.read(CR2) & cr2::START, 0);
        assert_eq!(bench.read(ISR), isr::TXE | isr::BUSY, "SDA is still low");
        bench.wires.i2c_lines = (true, true);
        assert_eq!(bench.read(ISR), isr::TXE);
        assert_eq!(bench.take_misuse(), [""; 0]);
    }
}

#[test]
fn a_stuck_read_never_ends() {
    let mut bench = started(1, 0);
    bench.wires.i2c_data = [None].into();
    bench.write(CR2, request(1, cr2::RD_WRN | cr2::AUTOEND));
    bench.run_until(1_000_000_000);
    assert_eq!(bench.read(ISR), isr::TXE | isr::BUSY);
}

#[test]
fn a_low_scl_times_out() {
    let mut bench = started(1, cr1::ERRIE);
    bench.wires.i2c_answers = [I2cResponse::Stuck].into();
    bench.write(TIMEOUTR, timeoutr::TIMOUTEN | 99); // 100 * 2048 periods of 10 ns
    bench.write(CR2, request(1, cr2::AUTOEND));
    bench.run_until(ADDRESS_NS + 2_048_000 - 1);
    assert!(!bench.irq(32));
    bench.run_until(ADDRESS_NS + 2_048_000);
    assert!(bench.irq(32));
    assert_ne!(bench.read(ISR) & isr::TIMEOUT, 0);
    bench.write(ICR, isr::TIMEOUT);
    assert!(!bench.irq(32));
}

#[test]
fn start_waits_for_held_lines() {
    let mut bench = started(1, 0);
    bench.wires.i2c_lines = (true, false);
    assert_ne!(bench.read(ISR) & isr::BUSY, 0);
    bench.write(CR2, request(0, cr2::AUTOEND));
    bench.run_until(100_000);
    assert_ne!(bench.read(CR2) & cr2::START, 0);
    assert_eq!(bench.wires.i2c, []);
    bench.wires.i2c_lines = (true, true);
    bench.run_until(200_000);
    assert_eq!(bench.wires.i2c.len(), 2);
}

#[test]
fn arbitration_loss_and_bus_error() {
    for (flag, inject) in [
        (isr::ARLO, I2c::inject_arbitration_loss as fn(&mut I2c, &mut Context<'_>)),
        (isr::BERR, I2c::inject_bus_error),
    ] {
        let mut bench = started(1, cr1::ERRIE);
        bench.with(inject);
        assert!(!bench.irq(32), "not without a transfer");
        bench.write(CR2, request(1, cr2::AUTOEND));
        bench.run_until(10_000);
        bench.with(inject);
        assert!(bench.irq(32));
        assert_eq!(bench.read(ISR), flag | isr::TXE);
        assert_eq!(bench.read(CR2) & cr2::START, 0);
        bench.write(ICR, flag);
        bench.run_until(1_000_000);
        assert_eq!(bench.wires.i2c, []);
    }
}

#[test]
fn stop_ends_the_transfer_after_the_byte() {
    let mut bench = started(1, 0);
    bench.write(CR2, request(3, 0));
    wait_for(&mut bench, isr::TXIS);
    bench.write(TXDR, 1);
    bench.write(CR2, cr2::STOP);
    bench.run_until(1_000_000);
    assert_eq!(
        bench.wires.i2c[1..],
        [OnI2c::Write { at_ns: ADDRESS_NS + BYTE_NS, byte: 1 }, OnI2c::Stop { at_ns: ADDRESS_NS + BYTE_NS + STOP_NS },]
    );
    assert_eq!(bench.read(CR2) & cr2::STOP, 0);
}

#[test]
fn misuse_is_reported() {
    let mut bench = started(1, 0);
    bench.write(TIMINGR, 0);
    assert_eq!(bench.read(TIMINGR), TIMING);
    bench.write(CR1, cr1::PE);
    bench.write(CR2, request(1, 0));
    bench.write(CR2, request(2, 0));
    bench.write(TXDR, 1);
    bench.write(TXDR, 2);
    bench.write(CR1, cr1::ANFOFF);
    bench.write(CR2, request(1, 0));
    bench.now_ns += 20; // two clocks of 100 MHz
    bench.write(CR1, cr1::ANFOFF | cr1::PE);
    bench.write(CR2, cr2::STOP);
    let misuse = bench.take_misuse();
    assert_eq!(misuse.len(), 7, "{misuse:#?}");
    bench.write(CR1, cr1::ANFOFF);
    bench.now_ns += 30;
    bench.write(CR1, cr1::ANFOFF | cr1::PE);
    assert_eq!(bench.take_misuse(), [""; 0], "three clocks are enough");
}

#[test]
fn what_is_not_modelled_is_refused() {
    let mut bench = started(1, 0);
    assert!(bench.try_write(OAR1, 0x8042).is_err());
    assert!(bench.try_write(CR1, 1 << 23).is_err()); // PECEN
    assert!(bench.try_write(CR2, cr2::ADD10 | cr2::START).is_err());
    assert!(bench.try_write(TIMEOUTR, timeoutr::TEXTEN).is_err());
    assert!(bench.try_write(0x2C, 0).is_err());
    assert!(bench.with(|i2c, context| i2c.read(ISR, Size::Byte, context)).is_err());
}

#[test]
fn reset_is_as_new() {
    let mut bench = started(1, cr1::TXIE);
    bench.write(CR2, request(1, 0));
    wait_for(&mut bench, isr::TXIS);
    assert!(bench.irq(31));
    bench.with(|i2c, context| i2c.reset(context));
    assert!(!bench.irq(31));
    assert_eq!(bench.read(ISR), isr::TXE);
    assert_eq!(bench.peripheral.next_event_ns(), u64::MAX);
}

proptest! {
    /// A transfer ends for any answers of the target, with STOP as the last event on the bus, and all bytes in order.
    #[test]
    fn a_transfer_ends(nbytes in 0..20_u32, read: bool, nack_at in 0..25_usize, late_ns in prop::collection::vec(0..50_000_u64, 1..5)) {
        let mut bench = started(1, 0);
        let acks = std::iter::repeat_n(I2cResponse::Ack, nack_at);
        bench.wires.i2c_answers = acks.chain([I2cResponse::Nack]).collect();
        bench.write(CR2, request(nbytes, cr2::AUTOEND | if read { cr2::RD_WRN } else { 0 }));
        let mut count = 0;
        while bench.read(ISR) & isr::STOPF == 0 {
            let flags = bench.read(ISR);
            if flags & (isr::TXIS | isr::RXNE) != 0 {
                let until_ns = bench.now_ns + late_ns[count as usize % late_ns.len()];
                bench.run_until(until_ns);
            }
            if flags & isr::TXIS != 0 {
                // While software was late, the previous byte may have been refused.
                if bench.read(ISR) & isr::TXIS != 0 {
                    bench.write(TXDR, count);
                    count += 1;
                }
            } else if flags & isr::RXNE != 0 {
                bench.read(RXDR);
                count += 1;
            } else {
                let next_ns = bench.peripheral.next_event_ns();
                prop_assert!(next_ns < u64::MAX);
                bench.run_until(next_ns);
            }
        }
        let answered = nack_at.min(if read { 1 } else { nbytes as usize + 1 });
        let refused = nack_at < if read { 1 } else { nbytes as usize + 1 };
        prop_assert_eq!(bench.read(ISR) & isr::NACKF != 0, refused);
        let stopped = matches!(bench.wires.i2c.last(), Some(OnI2c::Stop { .. }));
        prop_assert!(stopped);
        let written: Vec<u8> =
            bench.wires.i2c.iter().filter_map(|event| if let OnI2c::Write { byte, .. } = event { Some(*byte) } else { None }).collect();
        // The address is the first answer; a refused byte is on the bus too.
        let expected = if read { 0 } else { answered + usize::from(refused) - 1 };
        prop_assert_eq!(written, (0..expected as u8).collect::<Vec<u8>>());
        if read && !refused {
            let reads = bench.wires.i2c.iter().filter(|event| matches!(event, OnI2c::Read { .. })).count();
            prop_assert_eq!(reads, nbytes as usize);
        }
    }
}
