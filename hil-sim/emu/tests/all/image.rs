//! Check of the flashed image: intact, with one bit flipped, cut off, half replaced by an older one, and with words
//! that fail their error correction. A damaged image never arms, and reports the damage unless the reporting code
//! itself is damaged.

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
use r4_image::{Binary, CODE_AT, ImageError, Place, RECORD_AT, RECORD_BYTES, Seal};
use r4_mcu::{Chip, Level, Pin};
use r4_protocol::{
    Cause, Causes, ImageInfo, Refusal, Reply, Request, SCHEMA_HASH, SafetyState, ToDevice, ToHost, VERSION,
};

/// Size of a flash sector, the unit of erasure, bytes (RM0399, 4.3.1).
const SECTOR_BYTES: usize = 128 * 1024;
/// Time until hold mode, ms: three bad starts in a row, each up to half a second, the watchdog's longest period after a
/// reset.
const BAD_STARTS_MS: u64 = 3 * 520;

/// Behaviour of a board with a damaged image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Did {
    /// Held its outputs and reported the damaged image.
    Said,
    /// Held its outputs and reported repeated bad starts.
    SaidBadStarts,
    /// No answer: the code that would give it is damaged.
    Silent,
}

/// Sends `request`; returns the answer, if there is one.
async fn answer(host: &mut RawHost, seq: u16, request: Request) -> Option<Result<Reply, Refusal>> {
    host.send(&ToDevice::Request { seq, request }).await;
    host.listen(50).await.into_iter().find_map(|message| match message {
        ToHost::Response { seq: of, result } if of == seq => Some(result),
        _ => None,
    })
}

/// Returns the chip's level at DISABLE of the bridges.
fn disable(board: &Board) -> Level {
    let carrier = r4_boards::load_carrier("r4-carrier").expect("built in");
    let pin = carrier.pin("osmc_dis").expect("it has it").stm32;
    board.machine().chip.gpio().driven(Pin::new(pin.port, pin.number))
}

/// Runs a board with these bytes in flash for `ms` and tries to arm it; panics if the bridges are ever enabled.
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
                    // The damage may be in the configuration, too.
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
        // DISABLE is driven to off, or floats as in reset, where the carrier's resistor disables the bridges.
        assert!(!matches!(disable(board), Level::Low), "the bridges are let go");
        host.bad_frames = 0;
        did
    });
    did
}

fn binary(image: &Image) -> Binary {
    Binary::of(image.elf()).expect("an image")
}

/// The board reports the identity of its image, which is that of the file.
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

/// A hosted image restarts into the bootloader at a request, and a bare one refuses.
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
        // The Arduino bootloader takes this value as a request to stay (mcuboot-arduino-stm32h7, app/main.cpp) and
        // clears it.
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

/// Functions that run neither before the check nor in hold mode: damage in them is always reported.
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
    // Damage in the record itself: its magic number, length, CRC and unused part.
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
    // About a quarter of the image runs at a start or on a link; half would mean that the check itself comes late.
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

/// A power cut leaves the front of a new image, followed by erased flash. Constants and initial values come last;
/// without them a start faults again and again and reaches no answer.
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

/// Half a new image and half an old one, as a power cut in the middle of an update leaves them, sector by sector or
/// within one.
#[test]
fn half_an_update_never_arms() {
    let new = image("osmc-bench", "bare");
    let front = binary(&new);
    // Stands for an older version: all code is one flash word lower. Images for two robots differ in the first sector
    // only, so that half of each could be a whole image.
    let mut back = front.clone();
    back.bytes.drain(CODE_AT..CODE_AT + RECORD_BYTES);
    for (written, erased) in [(1, 1), (2, 2), (3, 3), (1, 2), (2, 3)] {
        // Sectors below `written` are new, those below `erased` empty, the others old.
        let mut mixed = back.clone();
        let (written, erased) = (written * SECTOR_BYTES, erased * SECTOR_BYTES);
        mixed.bytes[..written].copy_from_slice(&front.bytes[..written]);
        mixed.bytes[written..erased].fill(0xFF);
        let did = with_flash("osmc-bench", &new, &mixed, None, BAD_STARTS_MS);
        eprintln!("new to {written:#x}, empty to {erased:#x}: {did:?}");
    }
    // With its first sector erased and not yet written, the bootloader finds no program, and stays.
    let mut erased = binary(&image("osmc-bench", "hosted"));
    erased.bytes[..SECTOR_BYTES].fill(0xFF);
    assert_eq!(Place::of(&erased), Err(ImageError::NoStack { word: u32::MAX }));
}

/// A word that was being programmed at a power cut fails its error correction: that is reported and causes no bus
/// fault.
#[test]
fn a_word_that_fails_its_error_correction_is_said() {
    let image = image("osmc-bench", "bare");
    let whole = binary(&image);
    let address = Setup::of(r4_boards::load("osmc-bench").expect("built in"), image.clone())
        .bench(async |emu| emu.emulated.machine().symbols().address(LATER[0]).expect("the control task is there"));
    let stored = image.segments().iter().find_map(|segment| segment.stored(address & !1)).expect("in flash");
    assert_eq!(with_flash("osmc-bench", &image, &whole, Some(stored), 0), Did::Said);
}
