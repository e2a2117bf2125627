//! Whether flash holds what was built: the exact image, with one bit flipped, cut off, half an older one, and with words that fail
//! their error correction. It never arms then, and says why wherever what is damaged is not what would have to say it.

use rand_pcg::{
    Pcg64,
    rand_core::{Rng, SeedableRng},
};

use crate::emulated::{
    BOOT_MS, Board, Setup,
    harness::{MS, RawHost},
    image,
};
use r4_emu::Image;
use r4_image::{Binary, ImageError, Place, RECORD_AT, RECORD_BYTES, Seal};
use r4_mcu::{Chip, Level, Pin};
use r4_protocol::{
    Cause, Causes, ImageInfo, Refusal, Reply, Request, SCHEMA_HASH, SafetyState, ToDevice, ToHost, VERSION,
};

/// A sector of flash, which is erased as one (RM0399, 4.3.1).
const SECTOR_BYTES: usize = 128 * 1024;
/// Three bad starts in a row lead to hold mode, and each lasts up to half a second: the watchdog's longest period after a reset.
const BAD_STARTS_MS: u64 = 3 * 520;

/// What a board with a damaged image did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Did {
    /// Held its outputs, and said that the image is damaged.
    Said,
    /// Held its outputs, and said that it started badly again and again.
    SaidBadStarts,
    /// No answer: what would have given it is damaged.
    Silent,
}

/// The answer to `request`, if there is one.
async fn answer(host: &mut RawHost, seq: u16, request: Request) -> Option<Result<Reply, Refusal>> {
    host.send(&ToDevice::Request { seq, request }).await;
    host.listen(50).await.into_iter().find_map(|message| match message {
        ToHost::Response { seq: of, result } if of == seq => Some(result),
        _ => None,
    })
}

/// How the chip drives DISABLE of the bridges.
fn disable(board: &Board) -> Level {
    let carrier = r4_boards::load_carrier("r4-carrier").expect("built in");
    let pin = carrier.pin("osmc_dis").expect("it has it").stm32;
    board.machine().chip.gpio().driven(Pin::new(pin.port, pin.number))
}

/// What a board does with these bytes in flash, in `ms` and while it is asked to arm; panics if the bridges are ever let go.
fn with_flash(robot: &str, of: &Image, bytes: &Binary, spoiled: Option<u32>, ms: u64) -> Did {
    let (start, content) = (bytes.start, bytes.bytes.clone());
    let setup = Setup::of(r4_boards::load(robot).expect("built in"), of.clone()).prepared(move |board| {
        let mut machine = board.machine();
        machine.chip.memory().write_slice(start, &content).expect("flash");
        if let Some(address) = spoiled {
            machine.chip.spoil_flash(address);
        }
    });
    let (did, _) = setup.raw(async |host, device, board| {
        device.clock.sleep(ms * MS).await;
        let hello = Request::Hello { version: VERSION, schema: SCHEMA_HASH };
        let did = match answer(host, 1, hello).await {
            Some(Ok(Reply::Hello(info))) => {
                assert_eq!(info.state, SafetyState::Tripped, "{info:?}");
                match info.causes {
                    // What is damaged may be the configuration, too.
                    causes if causes.contains(Cause::DamagedImage) => Did::Said,
                    causes if causes == Causes::only(Cause::RepeatedBadStarts) => Did::SaidBadStarts,
                    causes => panic!("damaged, and says {causes}"),
                }
            }
            _ => Did::Silent,
        };
        for (seq, request) in [(2, Request::Clear), (3, Request::Arm)] {
            let refused = answer(host, seq, request.clone()).await;
            assert!(!matches!(refused, Some(Ok(_))), "{request:?}: {refused:?}");
            if did == Did::Said {
                assert!(matches!(refused, Some(Err(Refusal::CausesPresent { .. }))), "{request:?}: {refused:?}");
            }
        }
        // Driven to off, or floating as in reset, where the carrier's resistor turns them off.
        assert!(!matches!(disable(board), Level::Low), "the bridges are let go");
        host.bad_frames = 0;
        did
    });
    did
}

fn binary(image: &Image) -> Binary {
    Binary::of(image.elf()).expect("an image")
}

/// The board says which image it runs, and that is the file's.
#[test]
fn the_image_that_runs_is_the_file() {
    for (robot, kind) in [("osmc-bench", "bare"), ("osmc-bench", "hosted"), ("every-interface", "bare")] {
        let image = image(robot, kind);
        let Seal { bytes, crc } = Seal::of(&binary(&image)).expect("it was sealed when it was built");
        let setup = Setup::of(r4_boards::load(robot).expect("built in"), image);
        let ((), _) = setup.raw(async |host, _, _| {
            host.hello().await;
            let info = ImageInfo { hosted: kind == "hosted", bytes, crc };
            assert_eq!(host.ask(Request::Image).await, Ok(Reply::Image(info)));
        });
    }
}

/// A hosted image restarts into the bootloader when it is asked to, and a bare one refuses.
#[test]
fn a_hosted_image_restarts_into_the_bootloader() {
    let robot = || r4_boards::load("osmc-bench").expect("built in");
    let ((), _) = Setup::of(robot(), image("osmc-bench", "hosted")).raw(async |host, device, board| {
        host.hello().await;
        assert_eq!(host.ask(Request::Arm).await, Ok(Reply::Done));
        let armed = Refusal::NotWhile { state: SafetyState::Armed };
        assert_eq!(host.ask(Request::Bootloader).await, Err(armed));
        assert_eq!(host.ask(Request::Disarm).await, Ok(Reply::Done));
        assert_eq!(board.machine().chip.backup_register(0), Some(0));
        assert_eq!(host.ask(Request::Bootloader).await, Ok(Reply::Done));
        assert_eq!(host.ask(Request::Arm).await, Err(Refusal::Busy));
        host.bad_frames = 0;
        device.clock.sleep(30 * MS).await;
        // What the Arduino bootloader takes for a request to stay (mcuboot-arduino-stm32h7, app/main.cpp); it clears it.
        assert_eq!(board.machine().chip.backup_register(0), Some(0xDF59));
        host.listen(BOOT_MS).await;
        host.bad_frames = 0;
        assert!(host.hello().await.device_us < 300_000, "it was reset");
    });
    let ((), _) = Setup::osmc_bench().raw(async |host, _, board| {
        host.hello().await;
        assert_eq!(host.ask(Request::Bootloader).await, Err(Refusal::NoBootloader));
        assert_eq!(host.ask(Request::Arm).await, Ok(Reply::Done));
        assert_eq!(board.machine().chip.backup_register(0), Some(0));
    });
}

/// Functions that run neither before the check nor in hold mode: what is wrong in them is always said.
const LATER: [&str; 4] = [
    "r4_firmware::control::task::Control<B,P>::tick::{{closure}}",
    "r4_firmware::control::task::Control<B,P>::initialise::{{closure}}",
    "r4_firmware::screen::draw::draw",
    "r4_firmware::storage::log::Log<F>::push::{{closure}}",
];

#[test]
fn one_flipped_bit_is_said_and_never_arms() {
    const PLACES: usize = 24;
    let image = image("osmc-bench", "bare");
    let whole = binary(&image);
    let flipped = |bit: usize| {
        let mut damaged = whole.clone();
        damaged.bytes[bit / 8] ^= 1 << (bit % 8);
        assert!(Seal::of(&damaged).is_err());
        damaged
    };
    let with = |bit: usize| with_flash("osmc-bench", &image, &flipped(bit), None, 0);
    // In the record itself: its magic number, length, CRC and what is unused.
    for byte in [0, 4, 6, 8, 11, 31] {
        assert_eq!(with(8 * (RECORD_AT + byte)), Did::Said, "byte {byte} of the record");
    }
    let mut draws = Pcg64::seed_from_u64(1);
    let mut dids = Vec::new();
    for _ in 0..PLACES {
        let bit = (draws.next_u64() % (8 * whole.bytes.len() as u64)) as usize;
        let did = with(bit);
        eprintln!("bit {} of {:#010x}: {did:?}", bit % 8, whole.start as usize + bit / 8);
        dids.push(did);
    }
    let said = dids.iter().filter(|did| **did == Did::Said).count();
    // A quarter of the image runs at a start or on a link; half would be a check that is itself late.
    assert!(said * 4 >= PLACES * 3, "{said} of {PLACES} said: {dids:?}");
}

#[test]
fn a_flipped_bit_in_what_runs_later_is_always_said() {
    let image = image("osmc-bench", "bare");
    let whole = binary(&image);
    let setup = Setup::of(r4_boards::load("osmc-bench").expect("built in"), image.clone());
    let places: Vec<_> = setup.bench(async |emu| {
        let machine = emu.emulated.machine();
        LATER.map(|name| machine.symbols().address(name).map(|address| (name, address))).into_iter().flatten().collect()
    });
    assert_eq!(places.len(), LATER.len(), "the image has other functions by now: {places:?}");
    for (name, address) in places {
        let stored = image.segments().iter().find_map(|segment| segment.stored(address & !1)).expect("in flash");
        let mut damaged = whole.clone();
        damaged.bytes[(stored - whole.start) as usize + 2] ^= 0x10;
        assert_eq!(with_flash("osmc-bench", &image, &damaged, None, 0), Did::Said, "{name}");
    }
}

/// A power cut leaves the front of a new image and behind it erased flash. Constants and initial values are last, without which a
/// start comes to no answer: it faults again and again.
#[test]
fn a_cut_image_never_arms() {
    let image = image("osmc-bench", "bare");
    let whole = binary(&image);
    let last = whole.bytes.len() - RECORD_BYTES;
    let mut cuts: Vec<_> = (SECTOR_BYTES..last).step_by(SECTOR_BYTES).collect();
    cuts.extend([last, last - 1024]);
    for cut in cuts {
        let mut damaged = whole.clone();
        damaged.bytes[cut..].fill(0xFF);
        let did = with_flash("osmc-bench", &image, &damaged, None, BAD_STARTS_MS);
        eprintln!("cut at {cut}: {did:?}");
    }
}

/// Half a new image and half an old one: what a power cut in the middle of an update leaves, sector by sector or within one.
#[test]
fn half_an_update_never_arms() {
    let (new, old) = (image("osmc-bench", "bare"), image("every-interface", "bare"));
    let (front, back) = (binary(&new), binary(&old));
    for (written, erased) in [(1, 1), (2, 2), (3, 3), (1, 2), (2, 3)] {
        // Sectors up to `written` are new, those up to `erased` empty, the others old.
        let mut mixed = back.clone();
        let (written, erased) = (written * SECTOR_BYTES, erased * SECTOR_BYTES);
        mixed.bytes[..written].copy_from_slice(&front.bytes[..written]);
        mixed.bytes[written..erased].fill(0xFF);
        let did = with_flash("osmc-bench", &old, &mixed, None, BAD_STARTS_MS);
        eprintln!("new to {written:#x}, empty to {erased:#x}: {did:?}");
    }
    // With its first sector erased and nothing written yet, the bootloader finds no program, and stays.
    let mut erased = binary(&image("osmc-bench", "hosted"));
    erased.bytes[..SECTOR_BYTES].fill(0xFF);
    assert_eq!(Place::of(&erased), Err(ImageError::NoStack { word: u32::MAX }));
}

/// A word that was being programmed when the power went fails its error correction: that is no bus fault, and is said.
#[test]
fn a_word_that_fails_its_error_correction_is_said() {
    let image = image("osmc-bench", "bare");
    let whole = binary(&image);
    let address = Setup::of(r4_boards::load("osmc-bench").expect("built in"), image.clone())
        .bench(async |emu| emu.emulated.machine().symbols().address(LATER[0]).expect("the control task is there"));
    let stored = image.segments().iter().find_map(|segment| segment.stored(address & !1)).expect("in flash");
    assert_eq!(with_flash("osmc-bench", &image, &whole, Some(stored), 0), Did::Said);
}
