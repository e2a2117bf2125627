//! The firmware's log, decoded from the RAM of the emulated chip.

mod debugging;

use std::{cell::RefCell, rc::Rc};

use debugging::Debugged;
use r4_emu::log::{Level, Log, Record};

#[test]
fn the_firmware_says_what_it_is_and_that_its_tasks_run() {
    let mut debugged = Debugged::start();
    let records = Rc::new(RefCell::new(Vec::<Record>::new()));
    let kept = records.clone();
    let control_block = debugged.board.machine().symbols().address("_SEGGER_RTT");
    let log = Log::new(&debugged.image, control_block, move |record| kept.borrow_mut().push(record));
    debugged.board.watch(log.expect("the image has a log"));
    // It has started long before: a watchdog waits for no more than that.
    debugged.run_to_ns(500_000_000);
    let records = records.borrow();
    let first = &records[0];
    assert_eq!(first.level, Some(Level::Info));
    assert!(first.message.starts_with("R4 ") && first.message.contains(" for "), "{first:?}");
    let position = |text: &str| records.iter().position(|record| record.message.contains(text));
    let (clock, tasks) = (position("480 MHz from the crystal"), position("tasks run"));
    assert!(clock.is_some() && tasks > clock, "{records:?}");
    assert!(records.iter().all(|record| record.level < Some(Level::Warn)), "{records:?}");
    // A record is read at most a slice, 10 ms, after its own time stamp, in s, which counts from when the clock runs.
    for record in &records[tasks.expect("it was found")..] {
        let stamp_s: f64 = record.stamp.parse().unwrap_or_else(|_| panic!("{record:?}"));
        let late_s = record.read_ns as f64 * 1e-9 - stamp_s;
        assert!((0.0..0.05).contains(&late_s), "{record:?}");
    }
}
