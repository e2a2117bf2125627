//! Every fault that can be injected into the board is noticed: it is counted, refused by name, or trips with its own
//! cause; unaffected functions go on.

use crate::emulated::{
    Board, Emu, Setup,
    harness::{MS, ROTARY, US, frame},
};
use r4_mcu::{Chip, Size, peripherals::rcc::Oscillators};
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelKind, Mode, Quality, Request, SafetyState, Sample, ToDevice, ToHost,
};
use r4_sim::{
    i2c::{Disturbance, Span},
    sensors::hc_sr04::HcSr04Fault,
    uart::LineNoise,
    world::BoardChip,
};

/// Returns the newest sample of a channel.
async fn sample(emu: &Emu<'_>, channel: ChannelId) -> Sample {
    let mut telemetry = emu.host.telemetry();
    emu.host.subscribe(channel, 5).await.expect("it has the channel");
    loop {
        let frame = telemetry.next().await.expect("the link is up");
        if let Some(sample) = frame.samples.iter().find(|sample| sample.channel() == channel) {
            emu.host.subscribe(channel, 0).await.expect("subscribed");
            return *sample;
        }
    }
}

/// A transfer without acknowledge, and a line that is held until it is clocked free, are repeated and counted; the
/// motor is not affected.
#[test]
fn a_passing_fault_of_the_bus_is_counted_and_does_not_trip() {
    Setup::osmc_bench().bench(async |emu| {
        emu.run_rotary(0).await;
        let faults =
            [Disturbance::AddressNack, Disturbance::DataNack { byte: 0 }, Disturbance::StuckLow { persistent: false }];
        for (disturbance, phase_us) in faults.into_iter().flat_map(|fault| [(fault, 0), (fault, 637), (fault, 1371)]) {
            let before = emu.host.stats().await.expect("it answers").bus_retries;
            emu.clock.sleep(phase_us * US).await;
            emu.device().inject(disturbance, Span::Transfers { count: 1 });
            emu.sleep_ms(60).await;
            let after = emu.host.stats().await.expect("it answers").bus_retries;
            assert!(after > before, "{disturbance:?} at {phase_us} us was not noticed");
            assert_eq!(emu.safety().await, (SafetyState::Armed, Causes::NONE), "{disturbance:?} at {phase_us} us");
            assert!(emu.device().duty(ROTARY) > 0.5);
        }
    });
}

/// A bit that flips on the wire in a write is acknowledged; only reading back detects it.
#[test]
fn a_flipped_bit_trips_by_reading_back() {
    let (_, misuse) = Setup::osmc_bench().bench_with_misuse(async |emu| {
        emu.run_rotary(0).await;
        let device = emu.device();
        device.record_wire();
        let begin_ns = emu.clock.now_ns();
        // As on the simulated board, there is time for a write right after a line was read back, before the next check.
        let line_read = || {
            let mut reads = device.wire_since(begin_ns).filter(|record| !record.read.is_empty());
            reads.any(|record| record.address == 0x40 && (0x06..0xFE).contains(&record.written[0]))
        };
        device.wait_until(begin_ns, 20 * MS, line_read).await.expect("it looks every 4 ms");
        let flip_ns = emu.clock.now_ns();
        device.inject(Disturbance::BitFlip { byte: 2, mask: 0x08 }, Span::Transfers { count: 1 });
        emu.set(ROTARY, Mode::Duty, 0.81).await.expect("armed");
        // One round of reading back takes 40 ms.
        let written_ns = device.wait_all_off_written(flip_ns, 45 * MS).await;
        assert!(written_ns.is_some_and(|ns| ns <= 45 * MS), "{written_ns:?}");
        assert_eq!(emu.safety().await, (SafetyState::Tripped, Causes::only(Cause::ReadBackMismatch)));
    });
    // The flipped bit may be a duty that the chip reports as misuse; nothing else may be wrong.
    assert!(misuse.len() <= 1, "{misuse:?}");
}

#[test]
fn a_short_of_the_bus_and_a_brown_out_trip_by_their_own_causes() {
    Setup::osmc_bench().bench_with_misuse(async |emu| {
        emu.run_rotary(0).await;
        emu.device().disturb(Disturbance::StuckLow { persistent: true });
        emu.sleep_ms(50).await;
        let (state, causes) = emu.safety().await;
        assert!(state == SafetyState::Tripped && causes.contains(Cause::I2cFault), "{state}: {causes}");
        emu.device().free_bus();
        emu.sleep_ms(150).await;
        emu.host.clear().await.expect("the bus is free");
        emu.run_rotary(0).await;
        assert!(emu.board.world().brown_out(BoardChip::Expander), "the bench has it");
        emu.sleep_ms(60).await;
        assert_eq!(emu.safety().await, (SafetyState::Tripped, Causes::only(Cause::ReadBackMismatch)));
        emu.sleep_ms(150).await;
        emu.host.clear().await.expect("it is set up again");
        emu.run_rotary(0).await;
    });
}

/// The crystal drifts in the middle of a run, by far more than a real one does: the board's seconds get shorter with
/// it, the driver follows its clock, and the board stays armed. (That a UART loses bytes beyond some per cent is not
/// modelled.)
#[test]
fn a_clock_that_drifts_is_followed() {
    let (_, misuse) = Setup::osmc_bench().bench_with_misuse(async |emu| {
        emu.run_rotary(0).await;
        let exact = Oscillators::default();
        for hse_hz in [16_160_000, 15_840_000] {
            emu.emulated.machine().chip.drift(Oscillators { hse_hz, ..exact });
            emu.sleep_ms(20).await;
            let begin = (emu.clock.now_ns(), emu.host.stats().await.expect("it answers").ticks);
            emu.sleep_ms(500).await;
            let ticks = f64::from(emu.host.stats().await.expect("it answers").ticks - begin.1);
            let expected = (emu.clock.now_ns() - begin.0) as f64 / 1e6 * hse_hz as f64 / 16e6;
            // A drift of 1 % is 5 of 500 ticks: it is detected, with one tick to spare at each end.
            assert!((ticks - expected).abs() < 2.5, "{hse_hz} Hz: {ticks} ticks of {expected}");
            emu.set(ROTARY, Mode::Duty, 0.8).await.expect("fresh by the board's clock");
            assert_eq!(emu.safety().await, (SafetyState::Armed, Causes::NONE), "{hse_hz} Hz");
        }
    });
    // The firmware did nothing wrong: CAN or I2C notices that its clock changed within a frame or a transfer.
    assert!(misuse.iter().all(|misuse| misuse.contains("kernel clock changes within a")), "{misuse:?}");
}

/// Two edges of a shaft merge into one: the interrupts of connector 3 count an impossible transition.
#[test]
fn lost_edges_of_an_encoder_are_counted() {
    let encoder = ChannelId::new(ChannelKind::Encoder, 3);
    Setup::new("every-interface").bench(async |emu| {
        emu.host.arm().await.expect("nothing is wrong");
        emu.set(ChannelId::new(ChannelKind::Osmc, 3), Mode::Speed, 2.0).await.expect("armed");
        emu.sleep_ms(500).await;
        let Sample::Encoder { illegal, position, .. } = sample(emu, encoder).await else { panic!("an encoder") };
        assert_eq!(illegal, 0);
        emu.board.world().pins().encoders[3].lose_edges(1);
        emu.sleep_ms(100).await;
        let Sample::Encoder { illegal, position: later, .. } = sample(emu, encoder).await else { panic!("an encoder") };
        assert_eq!(illegal, 1);
        assert!(later > position, "it goes on counting");
    });
}

/// Echo lines that stay low or high are reported as the sensor's quality, and the one that guards the board stops it.
#[test]
fn a_stuck_echo_is_told_and_stops_the_board() {
    let range = |index| ChannelId::new(ChannelKind::Range, index);
    Setup::new("every-interface").bench(async |emu| {
        for index in 0..4 {
            emu.board.world().range_sensor(index).expect("it has four").set_distance_m(Some(2.0));
        }
        emu.sleep_ms(1000).await;
        emu.host.arm().await.expect("nothing is near");
        let now_ns = emu.clock.now_ns();
        // TIM2 times connector 1, EXTI connector 2.
        for (index, fault) in [(1, HcSr04Fault::StuckHigh), (2, HcSr04Fault::Silent)] {
            emu.board.world().range_sensor(index).expect("it has four").set_fault(now_ns, Some(fault));
        }
        emu.sleep_ms(1000).await;
        for index in [1, 2] {
            let told = sample(emu, range(index)).await;
            let Sample::Reading { quality, .. } = told else { panic!("{told:?}") };
            assert_ne!(quality, Quality::Good, "range{index}: {told:?}");
        }
        assert_eq!(emu.safety().await.0, SafetyState::Armed, "only range0 stops the board");
        let now_ns = emu.clock.now_ns();
        emu.board.world().range_sensor(0).expect("it has four").set_fault(now_ns, Some(HcSr04Fault::Silent));
        emu.sleep_ms(3 * 240 + 100).await;
        assert_eq!(emu.safety().await, (SafetyState::Tripped, Causes::only(Cause::Proximity)));
    });
}

/// Returns the number of the answered request, if the message is an answer.
fn seq_of_answer(message: &ToHost) -> Option<u16> {
    if let ToHost::Response { seq, result: Ok(_) } = message { Some(*seq) } else { None }
}

/// Noise on the host's cable: each frame is taken or counted, and the session goes on.
#[test]
fn frames_damaged_by_noise_are_counted_and_the_session_survives() {
    let (_, misuse) = Setup::osmc_bench().raw(async |host, device, _| {
        let info = host.hello().await;
        let before = host.stats().await;
        device.board.disturb_link(Some(LineNoise::new(2e-4, 2e-4, 1)), None);
        let mut answered = Vec::new();
        for seq in 1000..1300_u16 {
            host.send(&ToDevice::Request { seq, request: Request::Stats }).await;
            answered.extend(host.listen(2).await.iter().filter_map(seq_of_answer));
            if seq % 25 == 0 {
                host.send(&ToDevice::Heartbeat { session: info.session, host_us: 0 }).await;
            }
        }
        device.board.disturb_link(None, None);
        // This frame ends a damaged one that the board's decoder may still hold.
        host.send(&ToDevice::Heartbeat { session: info.session, host_us: 0 }).await;
        host.listen(5).await;
        // An answer shows that the session is the same.
        let lost = host.stats().await.bad_frames - before.bad_frames;
        assert!(answered.is_sorted_by(|one, next| one < next), "answered twice, or late: {answered:?}");
        let answers = answered.len();
        assert!(lost > 0 && answers < 300, "{lost} frames lost, {answers} answers: no noise");
        // Nothing else is lost: each damaged frame is counted, and takes one more with it if its end was damaged.
        assert!(answers + 2 * lost as usize >= 300 && answers + lost as usize <= 312, "{answers} answers, {lost} lost");
        eprintln!("noise: {answers} of 300 answered, {lost} damaged frames counted");
        assert_eq!(host.hello().await.causes, Causes::NONE);
    });
    assert_eq!(misuse, Vec::<String>::new());
}

/// A host sends requests faster than the board can answer: the excess is lost, nothing is executed twice or out of
/// order, and afterwards the board answers normally.
#[test]
fn requests_faster_than_answers_are_lost_and_never_repeated() {
    let (_, misuse) = Setup::osmc_bench().raw(async |host, _, _| {
        host.hello().await;
        // The line is never idle: 23 laps of the receiver's ring buffer, 0.24 s.
        let requests: Vec<u8> =
            (1000..4000_u16).flat_map(|seq| frame(&ToDevice::Request { seq, request: Request::Stats })).collect();
        assert!(requests.len() > 20 * 1024, "{} bytes are few laps", requests.len());
        host.send_bytes(&requests).await;
        let answered: Vec<u16> = host.listen(500).await.iter().filter_map(seq_of_answer).collect();
        eprintln!("{} bytes: {} of 3000 answered", requests.len(), answered.len());
        assert!(answered.is_sorted_by(|one, next| one < next), "answered twice, or out of turn: {answered:?}");
        // The line limits the number: an answer is some 4 times as long as its request.
        assert!((300..2900).contains(&answered.len()), "{} answers", answered.len());
        // The zero byte ends a cut frame that the board's decoder may still hold.
        host.send_bytes(&[0]).await;
        host.stats().await;
    });
    assert_eq!(misuse, Vec::<String>::new());
}

/// Reads bit 7, bus-off, of FDCAN2's protocol status (RM0399, 59.5.15).
fn is_bus_off(board: &Board) -> bool {
    let mut machine = board.machine();
    let now_ns = machine.now_ns();
    machine.chip.read(now_ns, 0x4000_A444, Size::Word).expect("its clock is on") & 1 << 7 != 0
}

/// A CAN node in bus-off recovers by itself, without harm to other functions.
#[test]
fn can_off_the_bus_comes_back() {
    Setup::osmc_bench().bench(async |emu| {
        emu.run_rotary(0).await;
        assert!(!is_bus_off(&emu.emulated));
        emu.emulated.machine().chip.inject_can_bus_off(2);
        assert!(is_bus_off(&emu.emulated));
        // The wait covers the firmware's 50 ms, 129 times 11 recessive bits of 1 µs, and one check by the firmware.
        emu.sleep_ms(60).await;
        assert!(!is_bus_off(&emu.emulated), "it stays off");
        assert_eq!(emu.safety().await, (SafetyState::Armed, Causes::NONE));
        assert!(emu.device().duty(ROTARY) > 0.5);
    });
}
