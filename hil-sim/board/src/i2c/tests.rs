//! Tests of the bus, with targets that record their traffic.

use super::*;
use crate::misuse::MisuseKind;
use proptest::prelude::*;

/// Target that acknowledges one address and `takes` bytes, and records starts, bytes and stops with their times.
#[derive(Default)]
struct Target {
    address: u8,
    takes: usize,
    gives: u8,
    taken: Vec<(u64, u8)>,
    starts: Vec<(u64, bool)>,
    stops: Vec<u64>,
}

impl I2cChip for Target {
    fn acknowledges(&self, address: u8, _read: bool) -> bool {
        address == self.address
    }
    fn start(&mut self, at_ns: u64, _address: u8, read: bool) {
        self.starts.push((at_ns, read));
    }
    fn write(&mut self, at_ns: u64, byte: u8) -> bool {
        self.taken.push((at_ns, byte));
        self.taken.len() <= self.takes
    }
    fn read(&mut self, _at_ns: u64) -> u8 {
        self.gives
    }
    fn stop(&mut self, at_ns: u64) {
        self.stops.push(at_ns);
    }
}

fn target(address: u8) -> Rc<RefCell<Target>> {
    Rc::new(RefCell::new(Target { address, takes: 1000, gives: 0xA5, ..Target::default() }))
}

fn bus_with(target: &Rc<RefCell<Target>>) -> I2cBus {
    let mut bus = I2cBus::new(400_000);
    bus.attach(target.clone());
    bus
}

// 400 kHz: clock 2500 ns, byte 22500 ns; hold START 600; tLOW 1300 and set-up STOP 600
const BYTE_NS: u64 = 22_500;
const START_NS: u64 = 600;
const STOP_NS: u64 = 1_900;

#[test]
fn every_byte_has_the_time_of_its_ninth_clock() {
    let chip = target(0x40);
    let mut bus = bus_with(&chip);
    let done = bus.execute(1_000, 0x40, &mut [Operation::Write(&[6, 7])]).unwrap();
    let end_ns = 1_000 + START_NS + 3 * BYTE_NS + STOP_NS;
    assert_eq!(done, Done { start_ns: 1_000, end_ns });
    let chip = chip.borrow();
    assert_eq!(chip.starts, [(1_000 + START_NS + BYTE_NS, false)]);
    assert_eq!(chip.taken, [(1_000 + START_NS + 2 * BYTE_NS, 6), (1_000 + START_NS + 3 * BYTE_NS, 7)]);
    assert_eq!(chip.stops, [end_ns]);
}

#[test]
fn planned_durations() {
    let [a, b, c] = [[0_u8; 3], [0; 3], [0; 3]];
    let mut buffer = [0_u8; 4];
    // rate, operations, expected duration: clocks, START and repeated START, STOP
    let cases: [(u32, &[Operation<'_>], u64); 6] = [
        (400_000, &[], 0),
        (400_000, &[Operation::Write(&[])], START_NS + BYTE_NS + STOP_NS),
        (400_000, &[Operation::Write(&a)], START_NS + 4 * BYTE_NS + STOP_NS),
        // joined: no second START
        (
            400_000,
            &[Operation::Write(&a), Operation::Write(&b), Operation::Write(&c)],
            START_NS + 10 * BYTE_NS + STOP_NS,
        ),
        (
            400_000,
            &[Operation::Write(&a), Operation::Read(&mut buffer)],
            START_NS + 4 * BYTE_NS + (1_300 + 600 + START_NS) + 5 * BYTE_NS + STOP_NS,
        ),
        // clock of 10 us; tLOW is half a clock there
        (100_000, &[Operation::Write(&a)], 4_000 + 36 * 10_000 + 5_000 + 4_000),
    ];
    for (rate_hz, operations, expected_ns) in cases {
        assert_eq!(I2cBus::new(rate_hz).planned_duration_ns(operations), expected_ns, "{operations:?}");
    }
}

#[test]
fn the_bus_is_free_after_t_buf() {
    for (rate_hz, bus_free_ns) in [(100_000, 4_700), (400_000, 1_300), (1_000_000, 500)] {
        let chip = target(0x40);
        let mut bus = I2cBus::new(rate_hz);
        bus.attach(chip);
        let first = bus.execute(0, 0x40, &mut [Operation::Write(&[1])]).unwrap();
        let second = bus.execute(first.start_ns + 1, 0x40, &mut [Operation::Write(&[1])]).unwrap();
        assert_eq!(second.start_ns, first.end_ns + bus_free_ns);
        assert_eq!(bus.statistics().busy_ns, second.end_ns + bus_free_ns);
    }
}

#[test]
fn stops_at_the_first_byte_not_acknowledged() {
    let chip = target(0x40);
    chip.borrow_mut().takes = 2;
    let mut bus = bus_with(&chip);
    let fault = bus.execute(0, 0x40, &mut [Operation::Write(&[1, 2]), Operation::Write(&[3, 4])]).unwrap_err();
    let end_ns = START_NS + 4 * BYTE_NS + STOP_NS;
    assert_eq!(fault, Fault::DataNack { address: 0x40, byte: 2, end_ns });
    assert_eq!(chip.borrow().stops, [end_ns]);
    let fault = bus.execute(end_ns, 0x41, &mut [Operation::Write(&[1])]).unwrap_err();
    assert!(matches!(fault, Fault::AddressNack { address: 0x41, read: false, .. }));
    assert_eq!(bus.statistics().nacks, 2);
    assert_eq!(bus.statistics().bytes, 5);
}

#[test]
fn chips_at_one_address_share_it() {
    let (first, second) = (target(0x70), target(0x70));
    (first.borrow_mut().gives, second.borrow_mut().gives) = (0xF0, 0x3C);
    first.borrow_mut().takes = 0;
    let mut bus = bus_with(&first);
    bus.attach(second.clone());
    let mut buffer = [0];
    bus.execute(0, 0x70, &mut [Operation::Write(&[9]), Operation::Read(&mut buffer)]).unwrap();
    assert_eq!(buffer, [0x30]);
    assert_eq!(bus.misuse().first()[0].kind, MisuseKind::SeveralReaders { address: 0x70, chips: 2 });
    for chip in [first, second] {
        assert_eq!(chip.borrow().taken.len(), 1);
        assert_eq!(chip.borrow().starts.len(), 2);
        assert_eq!(chip.borrow().stops.len(), 1);
    }
}

#[test]
fn injected_faults() {
    let chip = target(0x40);
    let mut bus = bus_with(&chip);
    bus.set_trace(8);
    let next = |count| Span::Transfers { count };
    let inject = |bus: &mut I2cBus, disturbance, span| bus.inject(Injection { disturbance, span, address: None });

    inject(&mut bus, Disturbance::AddressNack, next(2));
    for _ in 0..2 {
        let fault = bus.execute(0, 0x40, &mut [Operation::Write(&[1])]).unwrap_err();
        assert!(matches!(fault, Fault::AddressNack { .. }));
    }
    assert!(chip.borrow().starts.is_empty());

    inject(&mut bus, Disturbance::DataNack { byte: 1 }, next(1));
    let fault = bus.execute(0, 0x40, &mut [Operation::Write(&[1, 2, 3])]).unwrap_err();
    assert!(matches!(fault, Fault::DataNack { byte: 1, .. }));
    assert_eq!(chip.borrow().taken.len(), 1);

    let flip = Disturbance::BitFlip { byte: 1, mask: 0x81 };
    inject(&mut bus, flip, Span::Time { from_ns: 1_000_000, until_ns: 2_000_000 });
    let mut buffer = [0; 2];
    bus.execute(1_000_000, 0x40, &mut [Operation::Write(&[1]), Operation::Read(&mut buffer)]).unwrap();
    assert_eq!(buffer, [0xA5 ^ 0x81, 0xA5]);
    bus.execute(2_000_000, 0x40, &mut [Operation::Write(&[1, 2])]).unwrap();

    let records: Vec<_> = bus.trace().collect();
    assert_eq!(records.len(), 5);
    assert_eq!(records[3].written, [1]);
    assert_eq!(records[3].read, [0x24, 0xA5]);
    assert_eq!((records[4].start_ns, &records[4].written), (2_000_000, &vec![1, 2]));
}

#[test]
fn a_stuck_bus_needs_nine_clocks() {
    let chip = target(0x40);
    let mut bus = bus_with(&chip);
    let disturbance = Disturbance::StuckLow { persistent: false };
    // within the second data byte
    let from_ns = START_NS + 2 * BYTE_NS + 1;
    bus.inject(Injection { disturbance, span: Span::Time { from_ns, until_ns: u64::MAX }, address: None });
    let fault = bus.execute(0, 0x40, &mut [Operation::Write(&[1, 2, 3])]).unwrap_err();
    assert_eq!(fault, Fault::StuckLow { since_ns: from_ns });
    assert_eq!(fault.end_ns(), None);
    assert_eq!(chip.borrow().taken.len(), 1);
    assert!(matches!(bus.execute(5_000_000, 0x20, &mut [Operation::Write(&[1])]), Err(Fault::StuckLow { .. })));
    let recovery = bus.recover(10_000_000);
    assert_eq!(recovery, Recovery { end_ns: 10_000_000 + BYTE_NS + STOP_NS, released: true });
    bus.execute(10_000_000, 0x40, &mut [Operation::Write(&[1])]).unwrap();
    assert_eq!(bus.statistics().stuck, 2);
}

#[test]
fn a_shorted_bus_stays_stuck() {
    let mut bus = bus_with(&target(0x40));
    let disturbance = Disturbance::StuckLow { persistent: true };
    bus.inject(Injection { disturbance, span: Span::Transfers { count: 1 }, address: None });
    for at_ns in [0, 1_000_000] {
        assert!(matches!(bus.execute(at_ns, 0x40, &mut [Operation::Write(&[1])]), Err(Fault::StuckLow { .. })));
        assert!(!bus.recover(at_ns).released);
    }
    bus.clear_injections();
    bus.execute(2_000_000, 0x40, &mut [Operation::Write(&[1])]).unwrap();
}

#[test]
fn an_empty_read_is_reported() {
    let mut bus = bus_with(&target(0x40));
    bus.execute(0, 0x40, &mut [Operation::Read(&mut [])]).unwrap();
    assert_eq!(bus.misuse().first()[0].kind, MisuseKind::EmptyRead { address: 0x40 });
}

/// Runs operations byte by byte with the bus's own timing, equivalent to [`I2cBus::execute`].
fn byte_by_byte(
    bus: &mut I2cBus,
    start_ns: u64,
    address: u8,
    operations: &mut [Operation<'_>],
) -> Result<u64, Response> {
    let timing = bus.timing;
    let mut at_ns = start_ns;
    let mut reading = None;
    let mut go = || {
        for operation in &mut *operations {
            let read = matches!(operation, Operation::Read(_));
            if reading != Some(read) {
                at_ns +=
                    if reading.is_some() { timing.restart_ns() } else { 0 } + timing.hold_start_ns + timing.byte_ns();
                reading = Some(read);
                match bus.start(at_ns, address, read) {
                    Response::Ack => {}
                    other => return Err(other),
                }
            }
            match operation {
                Operation::Write(bytes) => {
                    for &byte in *bytes {
                        at_ns += timing.byte_ns();
                        match bus.write(at_ns, byte) {
                            Response::Ack => {}
                            other => return Err(other),
                        }
                    }
                }
                Operation::Read(buffer) => {
                    for byte in &mut **buffer {
                        at_ns += timing.byte_ns();
                        *byte = bus.read(at_ns).ok_or(Response::Stuck)?;
                    }
                }
            }
        }
        Ok(())
    };
    let outcome = go();
    at_ns += timing.stop_ns();
    bus.stop(at_ns);
    outcome.map(|()| at_ns)
}

#[test]
fn byte_by_byte_every_byte_has_the_time_it_is_told() {
    let chip = target(0x40);
    let mut bus = bus_with(&chip);
    bus.set_trace(1);
    assert_eq!(bus.start(50_000, 0x40, false), Response::Ack);
    assert_eq!(bus.write(100_000, 6), Response::Ack);
    assert_eq!(bus.start(200_000, 0x40, true), Response::Ack);
    assert_eq!(bus.read(300_000), Some(0xA5));
    bus.stop(400_000);
    assert_eq!(chip.borrow().starts, [(50_000, false), (200_000, true)]);
    assert_eq!(chip.borrow().taken, [(100_000, 6)]);
    assert_eq!(chip.borrow().stops, [400_000]);
    let record = bus.trace().next().cloned();
    let start_ns = 50_000 - START_NS - BYTE_NS;
    let expected =
        WireRecord { start_ns, end_ns: 400_000, address: 0x40, written: vec![6], read: vec![0xA5], fault: None };
    assert_eq!(record, Some(expected));
    // tBUF of 1.3 us
    let busy_ns = 400_000 + 1_300 - start_ns;
    assert_eq!(*bus.statistics(), Statistics { transfers: 1, bytes: 4, nacks: 0, stuck: 0, busy_ns });
    // outside a transaction
    assert_eq!((bus.write(500_000, 1), bus.read(500_000)), (Response::Nack, Some(0xFF)));
}

#[test]
fn nine_clocks_by_hand_free_a_bus_that_sticks_in_a_byte() {
    for persistent in [false, true] {
        let chip = target(0x40);
        let mut bus = bus_with(&chip);
        assert_eq!(bus.start(50_000, 0x40, false), Response::Ack);
        let span = Span::Time { from_ns: 60_000, until_ns: u64::MAX };
        // during the transaction
        bus.inject(Injection { disturbance: Disturbance::StuckLow { persistent }, span, address: None });
        assert!(bus.lines_are_free(59_999) && !bus.lines_are_free(60_000));
        assert_eq!(bus.write(72_500, 1), Response::Stuck);
        assert_eq!(bus.statistics().stuck, 1);
        assert_eq!(bus.start(100_000, 0x40, false), Response::Stuck);
        for clock in 1..=9 {
            assert!(!bus.lines_are_free(200_000 + clock * 10_000));
            bus.clock_pulse(200_000 + clock * 10_000);
        }
        assert_eq!(bus.lines_are_free(290_000), !persistent);
        bus.stop(300_000);
        let response = bus.start(400_000, 0x40, false);
        assert_eq!(response, if persistent { Response::Stuck } else { Response::Ack });
    }
}

#[test]
fn a_controller_that_is_reset_starts_again_in_the_middle() {
    let chip = target(0x40);
    let mut bus = bus_with(&chip);
    assert_eq!(bus.start(50_000, 0x40, false), Response::Ack);
    assert_eq!(bus.write(100_000, 1), Response::Ack);
    // no STOP
    assert_eq!(bus.start(200_000, 0x40, false), Response::Ack);
    bus.stop(300_000);
    assert_eq!(chip.borrow().starts.len(), 2);
    assert_eq!(chip.borrow().stops, [300_000]);
}

fn any_injection() -> impl Strategy<Value = Injection> {
    let disturbance = prop_oneof![
        Just(Disturbance::AddressNack),
        (0..6_usize).prop_map(|byte| Disturbance::DataNack { byte }),
        (0..6_usize, any::<u8>()).prop_map(|(byte, mask)| Disturbance::BitFlip { byte, mask }),
        any::<bool>().prop_map(|persistent| Disturbance::StuckLow { persistent }),
    ];
    let span = prop_oneof![
        (0..2_000_000_u64, 0..2_000_000_u64).prop_map(|(from_ns, until_ns)| Span::Time { from_ns, until_ns }),
        (0..3_u32).prop_map(|count| Span::Transfers { count }),
    ];
    let address = prop_oneof![Just(None), Just(Some(0x40)), Just(Some(0x41))];
    (disturbance, span, address).prop_map(|(disturbance, span, address)| Injection { disturbance, span, address })
}

proptest! {
    #[test]
    fn both_ways_into_the_bus_are_the_same(
        injections in prop::collection::vec(any_injection(), 0..4),
        transfers in prop::collection::vec(
            (
                0..300_000_u64,
                prop::sample::select(&[0x40_u8, 0x41][..]),
                prop::collection::vec((any::<bool>(), prop::collection::vec(any::<u8>(), 0..4)), 1..4),
            ),
            1..6,
        ),
        takes in 0..20_usize,
    ) {
        let chips = [target(0x40), target(0x40)];
        let mut buses = [bus_with(&chips[0]), bus_with(&chips[1])];
        for (chip, bus) in chips.iter().zip(&mut buses) {
            chip.borrow_mut().takes = takes;
            bus.set_trace(16);
            injections.iter().for_each(|injection| bus.inject(*injection));
        }
        let mut asked_ns = 0;
        for (after_ns, address, operations) in transfers {
            asked_ns += after_ns;
            let start_ns = buses[0].earliest_start_ns(asked_ns);
            let mut data = [operations.clone(), operations];
            let mut ends = Vec::new();
            for (way, data) in data.iter_mut().enumerate() {
                let mut list: Vec<_> = data
                    .iter_mut()
                    .map(|(read, bytes)| if *read { Operation::Read(bytes) } else { Operation::Write(bytes) })
                    .collect();
                ends.push(if way == 0 {
                    buses[0].execute(asked_ns, address, &mut list).map(|done| done.end_ns).map_err(|fault| match fault {
                        Fault::AddressNack { .. } | Fault::DataNack { .. } => Response::Nack,
                        Fault::StuckLow { .. } => Response::Stuck,
                    })
                } else {
                    byte_by_byte(&mut buses[1], start_ns, address, &mut list)
                });
            }
            if ends[0] == Err(Response::Stuck) {
                // a bus that sticks between the last byte and STOP is only detected after it
                prop_assert!(matches!(ends[1], Ok(_) | Err(Response::Stuck)));
            } else {
                prop_assert_eq!(ends[0], ends[1]);
            }
            prop_assert_eq!(&data[0], &data[1]);
        }
        prop_assert_eq!(buses[0].statistics(), buses[1].statistics());
        prop_assert_eq!(buses[0].trace().collect::<Vec<_>>(), buses[1].trace().collect::<Vec<_>>());
        let seen = chips.map(|chip| {
            let chip = chip.borrow();
            (chip.taken.clone(), chip.starts.clone(), chip.stops.clone())
        });
        prop_assert_eq!(&seen[0], &seen[1]);
        let kinds = buses.map(|bus| bus.misuse().first().iter().map(|misuse| misuse.kind).collect::<Vec<_>>());
        prop_assert_eq!(&kinds[0], &kinds[1]);
    }

    #[test]
    fn executes_in_the_planned_time(
        rate_hz in 1_000u32..2_000_000,
        start_ns in 0u64..1_000_000_000,
        operations in prop::collection::vec((any::<bool>(), prop::collection::vec(any::<u8>(), 0..9)), 1..6),
    ) {
        let chip = target(0x40);
        let mut bus = I2cBus::new(rate_hz);
        bus.attach(chip);
        let mut buffers = operations.clone();
        let mut list: Vec<_> = buffers
            .iter_mut()
            .map(|(read, bytes)| if *read { Operation::Read(bytes) } else { Operation::Write(bytes) })
            .collect();
        let planned_ns = bus.planned_duration_ns(&list);
        let done = bus.execute(start_ns, 0x40, &mut list).unwrap();
        prop_assert_eq!(done.end_ns - done.start_ns, planned_ns);
    }
}
