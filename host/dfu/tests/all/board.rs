//! Tests of the whole procedure: a running board, its bootloader, and the board that runs the new image.

use std::{cell::RefCell, rc::Rc, time::Duration};

use r4_dfu::{Asked, Descriptor, FlashError, Flashed, Machine, Note, Running, Step, UpdateError, Usb, UsbError, flash};

use crate::{
    START, image,
    model::{Bootloader, FLASH},
};

/// Error of a board that refuses, because it is armed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not while the board is armed")]
struct Armed;

/// Bootloader that two owners share: the update, and the test that inspects it.
#[derive(Clone)]
struct Handle(Rc<RefCell<Bootloader>>);

impl Usb for Handle {
    fn descriptor(&self) -> Descriptor {
        self.0.borrow().descriptor()
    }

    fn control_out(&mut self, request: u8, value: u16, data: &[u8]) -> Result<(), UsbError> {
        self.0.borrow_mut().control_out(request, value, data)
    }

    fn control_in(&mut self, request: u8, value: u16, buffer: &mut [u8]) -> Result<usize, UsbError> {
        self.0.borrow_mut().control_in(request, value, buffer)
    }

    fn sleep(&mut self, time: Duration) {
        self.0.borrow_mut().sleep(time);
    }
}

/// Desk with one board on it, and sometimes a person.
struct Desk {
    bootloader: Handle,
    asked: Result<Asked, Armed>,
    /// Time at which the bootloader appears on USB, ms.
    appears_ms: Option<u64>,
    /// Time at which a person presses reset twice, ms.
    person_ms: Option<u64>,
    /// Image that a started board reports; `None` when no board answers.
    runs: Option<fn(&[u8]) -> Running>,
}

/// Makes a record of an image; any checksum serves.
fn record(content: &[u8]) -> Running {
    let crc = content.iter().fold(7_u32, |sum, byte| sum.wrapping_mul(31).wrapping_add(u32::from(*byte)));
    Running { bytes: content.len() as u32, crc }
}

impl Desk {
    fn new(asked: Result<Asked, Armed>) -> Self {
        let bootloader = Handle(Rc::new(RefCell::new(Bootloader::new())));
        Self { bootloader, asked, appears_ms: None, person_ms: None, runs: Some(record) }
    }

    fn now_ms(&self) -> u64 {
        self.bootloader.0.borrow().now_ms
    }

    fn flash(&mut self) -> (Result<Flashed, FlashError<Armed>>, Vec<Note>) {
        let mut notes = Vec::new();
        let wanted = record(&image());
        let flashed = flash(self, &image(), START, wanted, &mut |note| {
            if !matches!(note, Note::Progress(_)) {
                notes.push(note);
            }
        });
        (flashed, notes)
    }
}

impl Machine for Desk {
    type Device = Handle;
    type Error = Armed;

    fn bootloader(&mut self) -> Result<Option<Handle>, Armed> {
        let there = [self.appears_ms, self.person_ms].into_iter().flatten().any(|ms| ms <= self.now_ms());
        Ok(there.then(|| self.bootloader.clone()))
    }

    fn ask(&mut self) -> Result<Asked, Armed> {
        if self.asked == Ok(Asked::Restarts) {
            self.appears_ms = self.appears_ms.map(|after_ms| self.now_ms() + after_ms);
        }
        self.asked.clone()
    }

    fn running(&mut self) -> Option<Running> {
        let bootloader = self.bootloader.0.borrow();
        bootloader.started?;
        let from = (START - FLASH) as usize;
        self.runs.map(|runs| runs(&bootloader.flash[from..from + image().len()]))
    }

    fn now(&self) -> Duration {
        Duration::from_millis(self.now_ms())
    }

    fn sleep(&mut self, time: Duration) {
        self.bootloader.0.borrow_mut().now_ms += time.as_millis() as u64;
    }
}

const ALL_IS_WELL: Flashed = Flashed { verified: true, confirmed: true };

#[test]
fn a_running_board_restarts_into_its_bootloader_and_runs_the_image() {
    let mut desk = Desk::new(Ok(Asked::Restarts));
    // After the request to restart.
    desk.appears_ms = Some(1500);
    assert_eq!(desk.flash(), (Ok(ALL_IS_WELL), vec![Note::Restarts, Note::Starts]));
}

#[test]
fn a_board_that_waits_already_is_not_asked() {
    let mut desk = Desk::new(Err(Armed));
    desk.appears_ms = Some(0);
    assert_eq!(desk.flash(), (Ok(ALL_IS_WELL), vec![Note::Found, Note::Starts]));
}

#[test]
fn a_person_is_told_to_press_reset_and_waited_for() {
    let press = |why: Option<&str>| Note::PressReset { within_s: 60, why: why.map(str::to_owned) };
    for (asked, why) in [(Asked::NoBoard, None), (Asked::Cannot("it is older".into()), Some("it is older"))] {
        let mut desk = Desk::new(Ok(asked.clone()));
        desk.person_ms = Some(40_000);
        assert_eq!(desk.flash(), (Ok(ALL_IS_WELL), vec![press(why), Note::Starts]));
        let mut desk = Desk::new(Ok(asked));
        assert_eq!(desk.flash(), (Err(FlashError::NoBootloader { waited_s: 60 }), vec![press(why)]));
        assert!((60_000..61_000).contains(&desk.now_ms()), "{} ms", desk.now_ms());
    }
    // A board that restarts, and hangs on the way.
    let mut desk = Desk::new(Ok(Asked::Restarts));
    desk.person_ms = Some(30_000);
    let (flashed, notes) = desk.flash();
    assert_eq!((flashed, notes.len()), (Ok(ALL_IS_WELL), 3));
}

#[test]
fn a_refusal_of_the_board_ends_it_before_anything_is_written() {
    let mut desk = Desk::new(Err(Armed));
    assert_eq!(desk.flash(), (Err(FlashError::Machine(Armed)), vec![]));
    assert!(desk.bootloader.0.borrow().flash == Bootloader::new().flash);
}

#[test]
fn an_interrupted_update_is_given_again() {
    let mut desk = Desk::new(Ok(Asked::NoBoard));
    desk.appears_ms = Some(0);
    desk.bootloader.0.borrow_mut().wrong.unplugged_at = Some(60);
    let (flashed, _) = desk.flash();
    let told = flashed.expect_err("the cable is out");
    assert!(matches!(told, FlashError::Update(UpdateError::Interrupted { step: Step::Write, .. })), "{told}");
    desk.bootloader.0.borrow_mut().plug_in();
    assert_eq!(desk.flash().0, Ok(ALL_IS_WELL));
}

#[test]
fn another_image_that_runs_is_an_error_and_none_is_told() {
    let mut desk = Desk::new(Ok(Asked::NoBoard));
    desk.appears_ms = Some(0);
    desk.runs = Some(|_| Running { bytes: 32, crc: 1 });
    let (running, wanted) = (Running { bytes: 32, crc: 1 }, record(&image()));
    assert_eq!(desk.flash().0, Err(FlashError::Other { running, wanted }));

    let silent = |can_upload| {
        let mut desk = Desk::new(Ok(Asked::NoBoard));
        (desk.appears_ms, desk.runs) = (Some(0), None);
        desk.bootloader.0.borrow_mut().can_upload = can_upload;
        desk.flash().0
    };
    assert_eq!(silent(true), Ok(Flashed { verified: true, confirmed: false }));
    assert_eq!(silent(false), Err(FlashError::NotBack { waited_s: 15 }));
}
