//! Firmware log, decoded from the RAM of the emulated chip and from its link.

use std::{cell::RefCell, rc::Rc};

use crate::debugging::Debugged;
use crate::emulated::{Setup, harness::ROTARY};
use r4_emu::log::{Decoder, Level, Log, Record};
use r4_image::Binary;
use r4_protocol::log::fingerprint;

#[test]
fn the_firmware_says_what_it_is_and_that_its_tasks_run() {
    let mut debugged = Debugged::start();
    let records = Rc::new(RefCell::new(Vec::<Record>::new()));
    let kept = records.clone();
    let control_block = debugged.board.machine().symbols().address("_SEGGER_RTT");
    let log = Log::new(&debugged.image, control_block, move |record| kept.borrow_mut().push(record));
    debugged.board.watch(log.expect("the image has a log"));
    // The run is much longer than a start, which the watchdog limits.
    debugged.run_to_ns(500_000_000);
    let records = records.borrow();
    let first = &records[0];
    assert_eq!(first.level, Some(Level::Info));
    assert!(first.message.starts_with("R4 ") && first.message.contains(" for "), "{first:?}");
    let position = |text: &str| records.iter().position(|record| record.message.contains(text));
    let (clock, tasks) = (position("480 MHz from the crystal"), position("tasks run"));
    assert!(clock.is_some() && tasks > clock, "{records:?}");
    // A chip as delivered has no brown-out reset; the image warns of that.
    let expected = |message: &str| message.contains("no brown-out reset");
    assert!(records.iter().all(|record| record.level < Some(Level::Warn) || expected(&record.message)), "{records:?}");
    // A record is read at most one slice, 10 ms, after its own time stamp, in s, which counts from when the clock runs.
    for record in &records[tasks.expect("it was found")..] {
        let stamp_s: f64 = record.stamp.parse().unwrap_or_else(|_| panic!("{record:?}"));
        let late_s = record.read_ns as f64 * 1e-9 - stamp_s;
        assert!((0.0..0.05).contains(&late_s), "{record:?}");
    }
}

/// The log over the link, in a session with all other traffic: none of that comes later or less often.
#[test]
fn the_log_comes_over_the_link_behind_everything_else() {
    let setup = Setup::osmc_bench();
    let mut decoder = Decoder::new(setup.image().elf()).expect("the image has a log");
    setup.bench(async |emu| {
        let channels: Vec<_> = emu.host.channels().iter().map(|channel| channel.id).collect();
        for channel in channels {
            emu.host.subscribe(channel, 5).await.expect("there is room");
        }
        let mut telemetry = emu.host.samples(ROTARY, 1).await.expect("there is room");
        let before = emu.host.stats().await.expect("it answers");
        let (info, mut log) = emu.host.log().await.expect("the image has one");
        let binary = Binary::of(setup.image().elf()).expect("an image");
        assert_eq!(info.image, fingerprint(binary.bytes.first_chunk().expect("a vector table")));
        emu.host.stop().await.expect("anyone may");
        emu.sleep_ms(300).await;
        let after = emu.host.stats().await.expect("it answers");

        let (mut records, mut behind) = (Vec::new(), 0);
        while let Some(chunk) = log.try_next() {
            assert_eq!(chunk.position, behind, "nothing is lost of a log that is shorter than what the board keeps");
            behind += chunk.bytes.len() as u32;
            decoder.push(&chunk.bytes, emu.clock.now_ns(), |record| records.push(record));
        }
        let said = |text: &str| records.iter().any(|record| record.message.contains(text));
        assert!(said("R4 ") && said("tasks run") && said("trip 1: host stop"), "{records:#?}");

        assert_eq!(after.late_ticks, before.late_ticks);
        assert_eq!(after.telemetry_dropped, before.telemetry_dropped);
        let mut last_us = None;
        while let Some(sample) = telemetry.try_next() {
            let step_us = last_us.replace(sample.device_us).map_or(1000, |last| sample.device_us - last);
            // A frame may wait for the one on the line, 200 bytes at 1 Mbaud; then two in a row have the same reading.
            assert!(step_us <= 3000, "{step_us} us between two samples");
        }
    });
}
