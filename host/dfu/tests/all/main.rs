//! Tests of updates of a bootloader's flash, with every failure on the way.

mod board;
mod model;

use model::{Bootloader, FLASH, SECTOR, Wrong};
use proptest::{prop_assert_eq, proptest};
use r4_dfu::{Progress, Status, Step, UpdateError, Updated, UsbError, leave, update};

/// Address of an image behind the Arduino bootloader.
const START: u32 = 0x0804_0000;

/// Makes an image longer than a sector, which is no whole number of blocks.
fn image() -> Vec<u8> {
    (0..SECTOR + 10 * 4096 + 32).map(|byte| (byte % 251) as u8 ^ (byte >> 12) as u8).collect()
}

fn write(bootloader: &mut Bootloader, image: &[u8]) -> Result<Updated, UpdateError> {
    update(bootloader, image, START, &mut |_| {})
}

/// Checks that the image is in its place, and that the other sectors are unchanged.
fn assert_written(bootloader: &Bootloader, image: &[u8]) {
    let (from, before) = ((START - FLASH) as usize, Bootloader::new().flash);
    let erased = from + image.len().next_multiple_of(SECTOR);
    assert!(bootloader.flash[..from] == before[..from], "the bootloader's own sectors");
    assert!(bootloader.flash[from..from + image.len()] == *image, "the image");
    assert!(
        bootloader.flash[from + image.len()..erased].iter().all(|byte| *byte == 0xFF),
        "the rest of its last sector"
    );
    assert!(bootloader.flash[erased..] == before[erased..], "what is behind it");
}

#[test]
fn an_image_is_written_read_back_and_started() {
    let (mut bootloader, image) = (Bootloader::new(), image());
    let mut seen = Vec::new();
    let updated = update(&mut bootloader, &image, START, &mut |progress| seen.push(progress));
    assert_eq!(updated, Ok(Updated { verified: true }));
    assert_written(&bootloader, &image);
    let steps: Vec<_> = seen.iter().map(|progress| progress.step).collect();
    let in_order = [Step::Erase, Step::Write, Step::Verify];
    assert!(steps.is_sorted_by_key(|step| in_order.iter().position(|known| known == step)), "{steps:?}");
    let all = image.len();
    assert!(seen.iter().all(|progress| progress.done <= progress.all && progress.all == all));
    assert_eq!(seen.last(), Some(&Progress { step: Step::Verify, done: all, all }));
    assert_eq!(seen.iter().filter(|progress| progress.step == Step::Erase).count(), 2, "two sectors");
    // Each operation took the time that the bootloader named; asking earlier would have been an error.
    assert!(bootloader.now_ms >= 2 * 900, "{} ms", bootloader.now_ms);
    assert_eq!(bootloader.started, None);
    assert_eq!(leave(&mut bootloader, START), Ok(()));
    assert_eq!(bootloader.started, Some(START));
}

/// Pulls the cable at each transfer: the same command succeeds afterwards.
#[test]
fn the_cable_may_be_pulled_at_any_transfer() {
    let image = image();
    let mut whole = Bootloader::new();
    write(&mut whole, &image).expect("nothing is wrong");
    for at in 0..whole.transfers {
        let mut bootloader = Bootloader::new();
        bootloader.wrong.unplugged_at = Some(at);
        let told = write(&mut bootloader, &image).expect_err("the cable is out");
        let UpdateError::Interrupted { error: UsbError::Gone, done, all, .. } = told else { panic!("{at}: {told}") };
        assert!(done <= all && all == image.len(), "{at}: {told}");
        assert!(told.to_string().contains("same command again"), "{told}");
        bootloader.plug_in();
        assert_eq!(write(&mut bootloader, &image), Ok(Updated { verified: true }), "{at}");
        assert_written(&bootloader, &image);
    }
    eprintln!("{} transfers", whole.transfers);
}

/// Ends the program at each transfer: the bootloader keeps its power and its state.
#[test]
fn the_program_may_be_ended_at_any_transfer() {
    let image = image();
    let mut whole = Bootloader::new();
    write(&mut whole, &image).expect("nothing is wrong");
    for at in 0..whole.transfers {
        let mut bootloader = Bootloader::new();
        bootloader.wrong.host_gone_at = Some(at);
        write(&mut bootloader, &image).expect_err("the program is gone");
        bootloader.next_host();
        assert_eq!(write(&mut bootloader, &image), Ok(Updated { verified: true }), "{at}");
        assert_written(&bootloader, &image);
        assert_eq!(leave(&mut bootloader, START), Ok(()), "{at}");
        assert_eq!(bootloader.started, Some(START));
    }
}

/// Stalls each transfer: the error says so, and the next try clears it.
#[test]
fn any_transfer_may_be_stalled() {
    let image = image();
    let mut whole = Bootloader::new();
    write(&mut whole, &image).expect("nothing is wrong");
    let mut refused = 0;
    for at in 0..whole.transfers {
        let mut bootloader = Bootloader::new();
        bootloader.wrong.stalls_at = Some(at);
        match write(&mut bootloader, &image) {
            // Requests that only bring the bootloader to idle may be stalled.
            Ok(updated) => assert!(updated.verified),
            Err(UpdateError::Refused { status, .. }) => {
                assert_eq!(status, Status::ErrStalledpkt, "{at}");
                refused += 1;
            }
            Err(UpdateError::Interrupted { error, .. }) => assert_eq!(error, UsbError::Stalled, "{at}"),
            Err(other) => panic!("{at}: {other}"),
        }
        bootloader.next_host();
        assert_eq!(write(&mut bootloader, &image), Ok(Updated { verified: true }), "{at}");
    }
    assert!(refused * 2 > whole.transfers, "{refused} of {}", whole.transfers);
}

#[test]
fn what_the_bootloader_refuses_is_said_with_its_status() {
    let mut bootloader = Bootloader::new();
    let second = START + SECTOR as u32;
    bootloader.wrong.refuses_from = Some(second);
    let told = write(&mut bootloader, &image()).expect_err("it is outside");
    assert_eq!(told, UpdateError::Refused { step: Step::Erase, address: second, status: Status::ErrAddress });
    assert!(told.to_string().contains("0x08060000"), "{told}");
    bootloader.next_host();
    assert_eq!(write(&mut bootloader, &image()), Ok(Updated { verified: true }));
}

#[test]
fn a_worn_byte_is_found_by_reading_back() {
    let image = image();
    let (at, _) = image.iter().enumerate().rfind(|(_, byte)| *byte & 0x10 != 0).expect("one has the bit");
    let address = START + at as u32;
    let mut bootloader = Bootloader::new();
    bootloader.wrong = Wrong { worn: Some(address), ..Wrong::default() };
    assert_eq!(write(&mut bootloader, &image), Err(UpdateError::Differs { address }));
}

/// The Arduino bootloader reports a block as programmed when it is only queued.
#[test]
fn a_bootloader_that_programs_behind_its_answers_is_read_again() {
    let (mut bootloader, image) = (Bootloader::new(), image());
    bootloader.behind_ms = Some(700);
    assert_eq!(write(&mut bootloader, &image), Ok(Updated { verified: true }));
    assert_written(&bootloader, &image);
}

#[test]
fn without_upload_it_is_written_and_not_read_back() {
    let (mut bootloader, image) = (Bootloader::new(), image());
    bootloader.can_upload = false;
    assert_eq!(write(&mut bootloader, &image), Ok(Updated { verified: false }));
    assert_written(&bootloader, &image);
    assert_eq!(leave(&mut bootloader, START), Ok(()));
}

/// The image is refused before anything is erased.
#[test]
fn another_memory_is_refused_before_it_is_touched() {
    for (memory, start, bytes, told) in [
        ("@Internal Flash  2MB   /0x08000000/01*128Ka,07*128Kg", START, 7 * SECTOR, "no whole sectors"),
        ("@Internal Flash  2MB   /0x08000000/01*128Ka,07*128Kg", START + 32, 64, "no whole sectors"),
        ("@Ext RAW  Flash 16MB   /0x90000000/4096*4Kg", START, 64, "no whole sectors"),
        ("@Ext File Flash  0MB   /0x00000000/0*4Kg", START, 64, "no whole sectors"),
        ("Some other device", START, 64, "not DfuSe"),
        ("", START, 64, "not DfuSe"),
        ("@Flash/0x08000000/7*", START, 64, "not DfuSe"),
    ] {
        let mut bootloader = Bootloader::new();
        bootloader.memory = memory.into();
        let refused = update(&mut bootloader, &vec![1; bytes], start, &mut |_| {}).expect_err(memory).to_string();
        assert!(refused.contains(told), "{memory}: {refused}");
        assert!(bootloader.transfers == 0 && bootloader.flash == Bootloader::new().flash, "{memory}");
    }
}

proptest! {
    /// Writes images of any length, with any size of block.
    #[test]
    fn images_of_any_length_are_written(words in 1_usize..10_000, transfer_bytes in 64_u16..8192, at in 0_usize..400) {
        let image: Vec<u8> = (0..32 * words).map(|byte| (byte % 253) as u8).collect();
        let mut bootloader = Bootloader::new();
        bootloader.transfer_bytes = transfer_bytes;
        bootloader.wrong.unplugged_at = Some(at);
        if write(&mut bootloader, &image).is_err() {
            bootloader.plug_in();
            prop_assert_eq!(write(&mut bootloader, &image), Ok(Updated { verified: true }));
        }
        assert_written(&bootloader, &image);
    }
}
