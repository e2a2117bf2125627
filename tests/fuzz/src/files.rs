//! Targets of the files that the program reads.

use std::{
    io::{self, Write},
    os::unix::fs::PermissionsExt,
};

use embassy_futures::block_on;
use r4_boards::Robot;
use r4_firmware::storage::{
    SECTORS,
    faults::History,
    parameters::{self, Changes, Saved},
};
use r4_identify::data::{Mapping, Options, read_bytes};
use r4_links::Key;
use r4_log::Log;
use r4_plants::{Drive, Plant, PlantSpec};
use r4_sim::{
    Pace, SimBoard, Simulation,
    flash::{Flash, WORD_BYTES},
};
use tempfile::NamedTempFile;

use crate::board::osmc_bench;

/// Target: reads a log. An accepted one can be viewed in every way.
pub fn log(bytes: &[u8]) -> bool {
    let Ok(log) = Log::from_bytes(bytes) else { return false };
    let _ = (log.signals(), log.coverage(), log.duration_s(), log.time_span_s());
    log.write_csv(io::sink()).expect("a sink takes it");
    let _ = r4_log::compare(&log, &log, 0.0);
    true
}

/// Target: reads a recording for `r4 identify`, which is a CSV of this project or of another, or a log. Accepted values
/// are finite, in order of time.
///
/// # Panics
/// An accepted recording breaks this rule.
pub fn recording(bytes: &[u8]) -> bool {
    let untimed = bytes.len() % 2 == 1;
    let mapped = |input: &str, output: &str| Options {
        roles: vec![Mapping::driving("input", input), Mapping::measured("output", output)],
        untimed,
        ..Options::default()
    };
    let mut taken = false;
    for options in [
        mapped("duty", "pos_rad"),
        Options { split: vec!["run".into()], counts_per_turn: Some(1326.0), ..mapped("u", "enc") },
        mapped("osmc0.setpoint", "osmc0.position"),
    ] {
        for name in ["a.csv", "a.mcap"] {
            let Ok(recorded) = read_bytes(name, bytes, &options) else { continue };
            taken = true;
            assert_eq!(recorded.runs.len(), recorded.groups.len());
            for run in &recorded.runs {
                assert!(run.time_s.windows(2).all(|pair| pair[0] < pair[1]), "time goes on");
                for signal in run.signals.values() {
                    assert_eq!(signal.values.len(), run.time_s.len());
                }
            }
            recorded.notes.iter().for_each(|note| drop(note.to_string()));
        }
    }
    taken
}

/// Sector size, bytes: just large enough for what is saved.
const SMALL: usize = 512;

/// Target: loads the flash of a simulated board. Whatever it holds, the configuration is valid, and values saved
/// afterwards are kept.
///
/// # Panics
/// One of these is not so.
pub fn flash(bytes: &[u8]) -> bool {
    let config = &osmc_bench().config;
    // The input as a file, whatever its length.
    if let Some(mut flash) = Flash::<SMALL>::from_bytes(bytes) {
        assert_eq!(block_on(parameters::load(&mut flash, config)).config.validate(), Ok(()));
        let _ = block_on(History::open(&mut flash));
    }
    // The input as the beginning of a file that has the length of a flash.
    let blank = Flash::<SMALL>::new(SECTORS).to_bytes();
    let mut content: Vec<u8> = bytes.iter().copied().chain(blank.iter().copied().skip(bytes.len())).collect();
    content.truncate(blank.len());
    content.iter_mut().step_by(1 + WORD_BYTES).for_each(|readable| *readable &= 1);
    let mut flash = Flash::<SMALL>::from_bytes(&content).expect("whole sectors");
    let loaded = block_on(parameters::load(&mut flash, config));
    assert_eq!(loaded.config.validate(), Ok(()));
    let mut history = block_on(History::open(&mut flash));
    for index in 0..=history.len() {
        let _ = block_on(history.fault(&mut flash, index));
        for snapshot in [0, 1, 255] {
            let _ = block_on(history.snapshot(&mut flash, index, snapshot));
        }
    }
    let changes = Changes { robot: Some("Ada".try_into().expect("short")), ..Changes::default() };
    block_on(parameters::save(&mut flash, &config.robot, &changes)).expect("the flash is sound");
    let again = block_on(parameters::load(&mut flash, config));
    assert_eq!((again.saved, again.changes), (Saved::Changes, changes));
    loaded.saved == Saved::Changes || !history.is_empty()
}

/// Target: reads a robot. An accepted one is a board that starts.
///
/// # Panics
/// The board does not start.
pub fn robot(bytes: &[u8]) -> bool {
    let file = toml(bytes);
    let Ok(robot) = r4_boards::load(name(&file)) else { return false };
    assert_eq!(robot.config.validate(), Ok(()));
    starts(&robot);
    true
}

fn starts(robot: &Robot) {
    let mut simulation = Simulation::new(Pace::Free);
    // Limits of the simulator alone are an error and no panic.
    let Ok(_board) = SimBoard::start(&mut simulation, robot, 1) else { return };
    let clock = simulation.clock();
    simulation.block_on(clock.sleep(5_000_000)).expect("time goes on");
}

/// Target: reads a carrier's file.
pub fn carrier(bytes: &[u8]) -> bool {
    let file = toml(bytes);
    r4_boards::load_carrier(name(&file)).is_ok()
}

/// Target: reads a plant. An accepted one is read the same when it is written again, and its motion is finite.
///
/// # Panics
/// An accepted plant breaks one of these rules.
pub fn plant(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let Ok(spec) = PlantSpec::from_toml("plant.toml", text) else { return false };
    let again = PlantSpec::from_toml("plant.toml", &spec.to_toml()).expect("what is written is read");
    assert_eq!(again.to_toml(), spec.to_toml());
    let mut plant = Plant::new(&spec, 1);
    for duty in [0.0, 1.0, -1.0, 0.3] {
        for _ in 0..5 {
            plant.advance(Drive::with_brake(duty), 24.0, 1e-3);
            let (position, speed) = (plant.position(), plant.speed());
            assert!(position.is_finite() && speed.is_finite(), "at {position}, {speed} a second");
        }
    }
    true
}

/// Target: reads a shared key.
pub fn key(bytes: &[u8]) -> bool {
    let file = toml(bytes);
    let only_ours = std::fs::Permissions::from_mode(0o600);
    std::fs::set_permissions(file.path(), only_ours).expect("our own file");
    Key::read(file.path()).is_ok()
}

/// Writes the bytes to a temporary file.
fn toml(bytes: &[u8]) -> NamedTempFile {
    let mut file = tempfile::Builder::new().prefix("r4-fuzz").suffix(".toml").tempfile().expect("a temporary file");
    file.write_all(bytes).expect("room for it");
    file
}

fn name(file: &NamedTempFile) -> &str {
    file.path().to_str().expect("a plain path")
}
