//! Data that a board keeps over a restart, on the model of its flash, with a power cut at every step.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::{
    future::poll_fn,
    pin::pin,
    rc::Rc,
    task::{Context, Poll, Waker},
};

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};
use proptest::prelude::*;
use r4_firmware::storage::{
    Done, Job, SECTORS, Storage, StorageError,
    faults::{HISTORY, History, Recorder, SNAPSHOT_MS, SNAPSHOTS, Trip},
    parameters::{Changes, Loaded, Saved, load, save},
    run,
};
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelKind, FaultSnapshot, MotorSnapshot, Parameter, ParameterKey, Range, Refusal,
    config::{BoardConfig, CanConfig, MAX_MOTORS, MAX_SUPPLIES, SupplyConfig},
};
use r4_sim::{
    Clock, Pace, Simulation,
    flash::{Flash, FlashError, SECTOR_BYTES, Tear, WORD_BYTES},
};

/// Size of small sectors, bytes, which are full after few items, so that every step of every phase can be tested.
const SMALL: usize = 512;

/// Effects of a power cut; five seeds select the bits of a word and the progress of an erase.
const TEARS: [Tear; 9] = [
    Tear::Nothing,
    Tear::Unreadable,
    Tear::FirstHalf,
    Tear::SecondHalf,
    Tear::Bits { seed: 1 },
    Tear::Bits { seed: 2 },
    Tear::Bits { seed: 3 },
    Tear::Bits { seed: 4 },
    Tear::Bits { seed: 5 },
];

/// Runs a future that never waits.
fn now<T>(future: impl Future<Output = T>) -> T {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    loop {
        if let Poll::Ready(done) = future.as_mut().poll(&mut context) {
            return done;
        }
    }
}

/// A board with only `supplies` supplies of 10 to 30 V.
fn board(robot: &str, supplies: u8) -> BoardConfig {
    let supply = |index| SupplyConfig {
        id: ChannelId::new(ChannelKind::Supply, index),
        analog: index,
        volts_per_code: 0.001,
        range_v: Range::new(10.0, 30.0),
        regeneration_v: None,
    };
    let config = BoardConfig {
        robot: robot.try_into().unwrap(),
        control_period_us: 1000,
        link_timeout_ms: 100,
        i2c_hz: 400_000,
        auxiliary_stop: false,
        screen: false,
        air_temperature_c: 20.0,
        osmc_pwm: None,
        dhb_pwm: None,
        servo_pwm: None,
        bldc_dac: None,
        expander: None,
        stepper_bank: None,
        motors: Default::default(),
        bldcs: Default::default(),
        servos: Default::default(),
        steppers: Default::default(),
        relays: Default::default(),
        dacs: Default::default(),
        encoders: Default::default(),
        switches: Default::default(),
        ranges: Default::default(),
        analogs: Default::default(),
        supplies: (0..supplies).map(supply).collect(),
        can: CanConfig::default(),
        sensors: Default::default(),
    };
    assert_eq!(config.validate(), Ok(()));
    config
}

fn of_supply(index: u8, parameter: Parameter) -> ParameterKey {
    ParameterKey { channel: Some(ChannelId::new(ChannelKind::Supply, index)), parameter }
}

const LINK_TIMEOUT: ParameterKey = ParameterKey { channel: None, parameter: Parameter::LinkTimeoutMs };

/// Changes with the number of their save in each of three values.
fn changes(number: u16) -> Changes {
    let built_in = board("bench", 2);
    let mut changes = Changes { robot: Some("Ada".try_into().unwrap()), ..Changes::default() };
    for (key, value) in [
        (LINK_TIMEOUT, f32::from(200 + number)),
        (of_supply(0, Parameter::VoltsMax), 30.0 + f32::from(number) / 64.0),
        (of_supply(1, Parameter::VoltsMin), f32::from(number) / 64.0),
    ] {
        changes.set(&built_in, key, value).unwrap();
    }
    changes
}

fn loaded<const SECTOR: usize>(flash: &mut Flash<SECTOR>) -> Loaded {
    let loaded = now(load(flash, &board("bench", 2)));
    assert_eq!(loaded.config.validate(), Ok(()));
    assert_eq!(loaded.skipped.count, 0);
    loaded
}

/// Number of the [`changes`] that a board starts with; 0 for none. All three values must be of the same save.
fn start<const SECTOR: usize>(flash: &mut Flash<SECTOR>) -> u16 {
    let loaded = loaded(flash);
    if loaded.changes == Changes::default() {
        assert_eq!(loaded.config, board("bench", 2));
        return 0;
    }
    let number = loaded.config.link_timeout_ms - 200;
    assert_eq!((loaded.saved, loaded.changes), (Saved::Changes, changes(number)));
    assert_eq!(loaded.config.robot, "Ada");
    assert_eq!(loaded.config.supplies[0].range_v.max, 30.0 + f32::from(number) / 64.0);
    number
}

fn keep<const SECTOR: usize>(flash: &mut Flash<SECTOR>, number: u16) -> Result<(), StorageError> {
    now(save(flash, "bench", &changes(number)))
}

/// Runs `work` on copies of `flash` with a power cut at every step and of every kind, and passes each to `after`;
/// finally without a cut.
fn cut_everywhere<const SECTOR: usize>(
    flash: &Flash<SECTOR>,
    tears: &[Tear],
    work: impl Fn(&mut Flash<SECTOR>),
    mut after: impl FnMut(&mut Flash<SECTOR>, bool),
) -> u64 {
    for steps in 0.. {
        for tear in tears {
            let mut flash = flash.clone();
            flash.cut_after(steps, *tear);
            work(&mut flash);
            let has_power = flash.has_power();
            flash.power_up();
            after(&mut flash, has_power);
            assert_eq!(flash.programmed_twice(), [], "{steps} steps, then {tear:?}");
            if has_power {
                return steps;
            }
        }
    }
    unreachable!()
}

#[test]
fn a_save_that_is_cut_leaves_the_old_or_the_new_also_when_the_recovery_is_cut() {
    let mut flash = Flash::<SMALL>::new(SECTORS);
    let mut longest = 0;
    // the first save, saves over a save, into a new sector, and with an erase: four saves fill a sector
    for number in 0..12 {
        let steps = cut_everywhere(
            &flash,
            &TEARS,
            |flash| {
                let _ = keep(flash, number + 1);
            },
            |flash, has_power| {
                let first = start(flash);
                assert!(first == number + 1 || first == number && !has_power, "{first} of {number}");
                assert_eq!(start(flash), first, "stays what it is");
                cut_everywhere(
                    flash,
                    &TEARS[1..6],
                    |flash| {
                        now(load(flash, &board("bench", 2)));
                        let _ = keep(flash, 99);
                    },
                    |flash, has_power| {
                        let second = start(flash);
                        assert!(second == 99 || second == first && !has_power, "{second} after {first}");
                        keep(flash, 100).unwrap();
                        assert_eq!(start(flash), 100);
                    },
                );
            },
        );
        longest = longest.max(steps);
        keep(&mut flash, number + 1).unwrap();
        assert_eq!(start(&mut flash), number + 1);
    }
    // `void`, the erase, the seal, two marks of `sequential-storage`, a header, and two words of item
    assert_eq!(longest, 8, "an erase was among them");
}

#[test]
fn saves_go_on_over_many_erases() {
    let mut flash = Flash::<SMALL>::new(SECTORS);
    for number in 1..500 {
        keep(&mut flash, number).unwrap();
        assert_eq!(start(&mut flash), number);
    }
    assert_eq!(flash.programmed_twice(), []);
}

#[test]
fn a_firmware_update_keeps_what_it_knows_and_says_what_it_does_not() {
    let mut flash = Flash::<SECTOR_BYTES>::new(SECTORS);
    keep(&mut flash, 5).unwrap();
    // the new firmware has one supply less, and a changed board default
    let built_in = BoardConfig { air_temperature_c: 10.0, ..board("bench", 1) };
    let loaded = now(load(&mut flash, &built_in));
    assert_eq!(loaded.saved, Saved::Changes);
    let lost = (of_supply(1, Parameter::VoltsMin), 5.0 / 64.0);
    assert_eq!((loaded.skipped.count, &loaded.skipped.first[..]), (1, &[lost][..]));
    assert_eq!(loaded.changes.values.len(), 2);
    let mut expected = BoardConfig { robot: "Ada".try_into().unwrap(), link_timeout_ms: 205, ..built_in };
    expected.supplies[0].range_v.max = 30.0 + 5.0 / 64.0;
    assert_eq!(loaded.config, expected);
}

#[test]
fn numbers_that_would_not_be_valid_are_left_out_and_the_rest_is_not() {
    let mut flash = Flash::<SECTOR_BYTES>::new(SECTORS);
    let values = [
        // above the built-in maximum: valid only after the next change
        (of_supply(0, Parameter::VoltsMin), 35.0),
        (of_supply(0, Parameter::VoltsMax), 45.0),
        (LINK_TIMEOUT, f32::NAN),
        (of_supply(1, Parameter::VoltsMax), 25.0),
    ];
    let changes = Changes { robot: None, values: values.into_iter().collect() };
    now(save(&mut flash, "bench", &changes)).unwrap();
    let loaded = now(load(&mut flash, &board("bench", 2)));
    let mut expected = board("bench", 2);
    expected.supplies[0].range_v = Range::new(35.0, 45.0);
    expected.supplies[1].range_v.max = 25.0;
    assert_eq!(loaded.config, expected);
    assert_eq!(loaded.changes.values, [values[0], values[1], values[3]]);
    assert_eq!((loaded.skipped.count, loaded.skipped.first[0].0), (1, LINK_TIMEOUT));
}

#[test]
fn changes_for_another_robot_are_not_used_and_stay() {
    let mut flash = Flash::<SECTOR_BYTES>::new(SECTORS);
    assert_eq!(loaded(&mut flash).saved, Saved::Nothing);
    keep(&mut flash, 5).unwrap();
    let other = board("rover", 2);
    let loaded = now(load(&mut flash, &other));
    assert_eq!((loaded.saved, &loaded.config), (Saved::OtherRobot("bench".try_into().unwrap()), &other));
    assert_eq!(start(&mut flash), 5);
    // an empty set of changes is a save too
    now(save(&mut flash, "bench", &Changes::default())).unwrap();
    assert_eq!(start(&mut flash), 0);
}

#[test]
fn what_is_as_built_in_is_no_change() {
    let built_in = board("bench", 2);
    let mut changes = Changes::default();
    changes.set(&built_in, LINK_TIMEOUT, 250.0).unwrap();
    changes.set(&built_in, LINK_TIMEOUT, 300.0).unwrap();
    assert_eq!(changes.values, [(LINK_TIMEOUT, 300.0)]);
    changes.set(&built_in, LINK_TIMEOUT, 100.0).unwrap();
    assert_eq!(changes, Changes::default());
}

/// A trip with its number in every field, of `motors` motors and `snapshots` snapshots.
fn trip(number: u32, motors: usize, snapshots: usize) -> Trip {
    let mut recorder = Recorder::default();
    let end_us = u64::from(number) * 1_000_000;
    for before in (1..=snapshots as u64).rev() {
        // a position of the largest encoded size
        let motor =
            MotorSnapshot { position: i32::MIN + number as i32, speed: number as f32, duty: 1.0 / number as f32 };
        let at_us = end_us - before * u64::from(SNAPSHOT_MS) * 1000;
        recorder.note(at_us, vec![motor; motors], vec![number as f32; motors.min(MAX_SUPPLIES)]);
    }
    Trip {
        device_us: end_us,
        causes: Causes::only(Cause::ALL[number as usize % Cause::ALL.len()]),
        snapshots: (0..snapshots).map(|index| recorder.snapshot(index, end_us).expect("noted")).collect(),
    }
}

/// Hands a trip over as the control loop does.
fn hand_over(storage: &Storage<NoopRawMutex>, trip: &Trip) {
    for FaultSnapshot { before_ms, motors, supplies_v } in trip.snapshots.clone() {
        storage.note(trip.device_us - u64::from(before_ms) * 1000, motors, supplies_v);
    }
    storage.trip(trip.device_us, trip.causes);
}

fn large(number: u32) -> Trip {
    trip(number, MAX_MOTORS, SNAPSHOTS)
}

fn small(number: u32) -> Trip {
    trip(number, 1, 1)
}

/// Numbers of the trips in the history, newest first; each must equal that of `trip`.
fn trips<const SECTOR: usize>(flash: &mut Flash<SECTOR>, trip: fn(u32) -> Trip) -> Vec<u32> {
    let mut history = now(History::open(flash));
    let (mut trips, mut numbers) = (Vec::new(), Vec::new());
    for index in 0..history.len() {
        let info = now(history.fault(flash, index)).unwrap().unwrap();
        let which = (info.device_us / 1_000_000) as u32;
        let expected = trip(which);
        assert_eq!((info.causes, usize::from(info.snapshots)), (expected.causes, expected.snapshots.len()));
        for (snapshot, expected) in (0..).zip(&expected.snapshots) {
            assert_eq!(now(history.snapshot(flash, index, snapshot)).unwrap().as_ref(), Some(expected));
        }
        assert_eq!(now(history.snapshot(flash, index, info.snapshots)), Ok(None));
        trips.push(which);
        numbers.push(info.number);
    }
    assert_eq!(now(history.fault(flash, history.len())), Ok(None));
    assert!(numbers.is_sorted_by(|newer, older| newer > older), "{numbers:?}");
    trips
}

fn record<const SECTOR: usize>(flash: &mut Flash<SECTOR>, trip: &Trip) -> Result<(), StorageError> {
    now(async { History::open(flash).await.record(flash, trip).await }).map(drop)
}

#[test]
fn a_trip_that_is_cut_is_there_or_not_and_no_older_one_is_lost() {
    let mut flash = Flash::<SMALL>::new(SECTORS);
    // the first trip, trips after others, into a new sector, and with an erase: four trips fill a sector
    for number in 1..13 {
        let before = trips(&mut flash, small);
        let mut full = flash.clone();
        record(&mut full, &small(number)).unwrap();
        let after = trips(&mut full, small);
        assert_eq!(after[0], number);
        // at least a whole sector of the earlier ones remains
        assert!(after.len() >= before.len().min(4), "{before:?} to {after:?}");
        cut_everywhere(
            &flash,
            &TEARS,
            |flash| {
                let _ = record(flash, &small(number));
            },
            |flash, has_power| {
                let first = trips(flash, small);
                let without = first == before || first[..] == after[1..];
                assert!(first == after || without && !has_power, "{before:?} to {first:?}");
                let kept = after.len() - 1;
                cut_everywhere(
                    flash,
                    &TEARS[1..6],
                    |flash| {
                        let _ = record(flash, &small(99));
                    },
                    |flash, has_power| {
                        let mut second = trips(flash, small);
                        if second.first() == Some(&99) {
                            second.remove(0);
                        } else {
                            assert!(!has_power);
                        }
                        // older ones are dropped only by the sector, and the sector before remains
                        assert!(first.starts_with(&second), "{first:?} to {second:?}");
                        assert!(second.len() >= kept.min(4).min(first.len()), "{first:?} to {second:?}");
                    },
                );
            },
        );
        flash = full;
    }
}

#[test]
fn the_last_trips_are_kept_over_erases_and_power_cuts() {
    let last = |number: u32| -> Vec<u32> { (1..=number).rev().take(HISTORY.into()).collect() };
    let mut flash = Flash::<SECTOR_BYTES>::new(SECTORS);
    let mut erased_at = None;
    for number in 1..=100 {
        let before = flash.clone();
        record(&mut flash, &large(number)).unwrap();
        // a header and 83 words of item; the first trip in the second sector, which is new, has an erase too
        let erases = number > 49 && flash.steps() - before.steps() > 84;
        if erases {
            erased_at.get_or_insert(number);
        }
        // each has 160 motors and 80 supplies: all of them are checked only sometimes
        if erases || [1, 32, 33, 48, 100].contains(&number) {
            assert_eq!(trips(&mut flash, large), last(number));
        }
        if erases || number == 33 {
            let tears = [Tear::Unreadable, Tear::Bits { seed: number.into() }];
            cut_everywhere(
                &before,
                &tears,
                |flash| {
                    let _ = record(flash, &large(number));
                },
                |flash, has_power| {
                    let mut history = now(History::open(flash));
                    let newest = now(history.fault(flash, 0)).unwrap().unwrap();
                    let oldest = now(history.fault(flash, HISTORY as u8 - 1)).unwrap().unwrap();
                    assert!(newest.number == number || newest.number == number - 1 && !has_power);
                    assert_eq!(newest.number - oldest.number, u32::from(HISTORY) - 1);
                },
            );
        }
    }
    // two sectors of 48 trips each
    assert_eq!(erased_at, Some(97));
    assert_eq!(flash.programmed_twice(), []);
}

#[test]
fn trips_are_counted_over_starts() {
    let mut flash = Flash::<SECTOR_BYTES>::new(SECTORS);
    let mut recorded = Vec::new();
    // two trips in a start, none in the next, one in the last
    for trips in [2, 0, 1] {
        let mut history = now(History::open(&mut flash));
        for _ in 0..trips {
            let info = now(history.record(&mut flash, &small(1))).unwrap();
            assert_eq!(now(history.fault(&mut flash, 0)), Ok(Some(info)));
            recorded.push((info.number, info.start));
        }
    }
    assert_eq!(recorded, [(1, 1), (2, 1), (3, 2)]);
}

/// For any content of the flash the board starts, and keeps what is saved then.
fn survives<const SECTOR: usize>(mut flash: Flash<SECTOR>) -> Result<(), TestCaseError> {
    let loaded = now(load(&mut flash, &board("bench", 2)));
    prop_assert_eq!(loaded.config.validate(), Ok(()));
    let mut history = now(History::open(&mut flash));
    for index in 0..history.len() {
        let info = now(history.fault(&mut flash, index));
        prop_assert!(info.is_ok());
        // a missing snapshot is reported as such
        let _ = now(history.snapshot(&mut flash, index, 0));
    }
    prop_assert_eq!(keep(&mut flash, 7), Ok(()));
    prop_assert_eq!(start(&mut flash), 7);
    prop_assert_eq!(record(&mut flash, &small(7)), Ok(()));
    let newest = now(async { History::open(&mut flash).await.fault(&mut flash, 0).await });
    prop_assert_eq!(newest.map(|fault| fault.map(|fault| fault.device_us)), Ok(Some(7_000_000)));
    prop_assert_eq!(flash.programmed_twice(), &[]);
    Ok(())
}

#[test]
fn flash_of_something_else_is_reported_and_taken() {
    let mut flash = Flash::<SECTOR_BYTES>::new(SECTORS);
    flash.overwrite(0, &vec![0xA5; SECTORS * SECTOR_BYTES]);
    let loaded = loaded(&mut flash);
    assert_eq!((loaded.saved, loaded.config), (Saved::Damaged, board("bench", 2)));
    survives(flash).unwrap();
}

proptest! {
    #[test]
    fn random_flash_is_taken(bytes in prop::collection::vec(any::<u8>(), SECTORS * SMALL)) {
        let mut flash = Flash::<SMALL>::new(SECTORS);
        flash.overwrite(0, &bytes);
        survives(flash)?;
    }

    #[test]
    fn words_that_went_bad_are_survived(
        saves in 0u16..10,
        bad in prop::collection::vec((0..SECTORS * SMALL / WORD_BYTES, any::<[u8; WORD_BYTES]>(), 0..3), 1..40),
    ) {
        let mut flash = Flash::<SMALL>::new(SECTORS);
        for number in 1..=saves {
            keep(&mut flash, number).unwrap();
            record(&mut flash, &small(number.into())).unwrap();
        }
        let mut content = flash.to_bytes();
        for (word, bytes, how) in bad {
            let word = &mut content[word * (1 + WORD_BYTES)..][..1 + WORD_BYTES];
            match how {
                0 => word[0] = 0,
                1 => word[1..].copy_from_slice(&bytes),
                _ => word.fill(0xFF),
            }
            // a word of all ones reads as blank, as does an erased one
            word[0] = word[0].min(1);
        }
        survives(Flash::<SMALL>::from_bytes(&content).unwrap())?;
    }
}

#[test]
fn a_flash_comes_back_from_its_bytes() {
    let mut flash = Flash::<SMALL>::new(SECTORS);
    keep(&mut flash, 3).unwrap();
    flash.cut_after(2, Tear::Unreadable);
    keep(&mut flash, 4).unwrap_err();
    let mut again = Flash::<SMALL>::from_bytes(&flash.to_bytes()).unwrap();
    assert_eq!(again.to_bytes(), flash.to_bytes());
    assert_eq!(start(&mut again), 3);
    assert!(Flash::<SMALL>::from_bytes(&flash.to_bytes()[1..]).is_none());
}

#[test]
fn the_model_refuses_what_the_chip_refuses_and_spoils_what_it_spoils() {
    let mut flash = Flash::<SMALL>::new(2);
    let word = [0x5A; WORD_BYTES];
    assert_eq!(now(flash.write(1, &word)), Err(FlashError::NotAligned));
    assert_eq!(now(flash.write(0, &word[1..])), Err(FlashError::NotAligned));
    assert_eq!(now(flash.write(2 * SMALL as u32, &word)), Err(FlashError::OutOfBounds));
    assert_eq!(now(flash.erase(0, 32)), Err(FlashError::NotAligned));
    assert_eq!(now(flash.write(64, &word)), Ok(()));
    let mut read = [0; 2];
    now(flash.read(95, &mut read)).unwrap();
    assert_eq!(read, [0x5A, 0xFF]);
    // the same content once more: its correction bits are wrong all the same
    assert_eq!(now(flash.write(64, &word)), Ok(()));
    assert_eq!(flash.programmed_twice(), [64]);
    assert_eq!(now(flash.read(95, &mut read)), Err(FlashError::Unreadable { address: 64 }));
    now(flash.erase(0, SMALL as u32)).unwrap();
    now(flash.read(95, &mut read)).unwrap();
    assert_eq!(read, [0xFF; 2]);
}

/// Runs `test` with the task on a flash whose steps take time.
fn with_task(test: impl AsyncFnOnce(Rc<Storage<NoopRawMutex>>, Clock)) {
    let mut simulation = Simulation::new(Pace::Free);
    let clock = simulation.clock();
    let storage = Rc::new(Storage::new());
    let flash = Flash::<SECTOR_BYTES>::new(SECTORS).with_clock(clock.clone());
    let task = storage.clone();
    simulation.spawn(async move {
        run(&task, flash, "bench").await;
    });
    simulation.block_on(test(storage, clock)).unwrap();
}

#[test]
fn the_task_does_what_it_is_asked() {
    with_task(async |storage, clock| {
        assert_eq!(storage.request(Job::Fault { index: 0 }).await, Err(Refusal::NoSuchFault));
        assert_eq!(storage.request(Job::Save(changes(1))).await, Ok(Done::Saved));
        // a new flash is erased first: 1 s; then the seal, a mark, a header and two words of item: 0.1 ms each
        assert_eq!(clock.now_ns(), 1_000_000_000 + 5 * 100_000);
        hand_over(&storage, &small(1));
        // with the same snapshots: the first trip has not copied them yet
        hand_over(&storage, &small(2));
        let Ok(Done::Fault(info)) = storage.request(Job::Fault { index: 0 }).await else { panic!("no trip") };
        assert_eq!((info.number, info.device_us, info.snapshots), (2, 2_000_000, 1));
        let snapshot = storage.request(Job::Snapshot { index: 1, snapshot: 0 }).await;
        assert_eq!(snapshot, Ok(Done::Snapshot(small(1).snapshots[0].clone())));
        assert_eq!(storage.request(Job::Snapshot { index: 1, snapshot: 1 }).await, Err(Refusal::NoSuchFault));
        assert_eq!(storage.lost(), 0);
    });
}

#[test]
fn trips_that_find_no_room_are_counted() {
    with_task(async |storage, clock| {
        // the test blocks the task; two trips can wait
        (1..=5).for_each(|number| hand_over(&storage, &small(number)));
        assert_eq!(storage.lost(), 3);
        clock.sleep(3_000_000_000).await;
        let Ok(Done::Fault(info)) = storage.request(Job::Fault { index: 0 }).await else { panic!("no trip") };
        assert_eq!(info.device_us, 2_000_000);
    });
}

#[test]
fn an_answer_that_nobody_waited_for_is_not_taken_for_the_next() {
    with_task(async |storage, clock| {
        {
            // requested, and dropped while the flash is being erased
            let mut save = pin!(storage.request(Job::Save(changes(1))));
            let mut wait = pin!(clock.sleep(1_000_000));
            poll_fn(|context| {
                assert!(save.as_mut().poll(context).is_pending());
                wait.as_mut().poll(context)
            })
            .await;
        }
        assert_eq!(storage.request(Job::Fault { index: 0 }).await, Err(Refusal::NoSuchFault));
    });
}

#[test]
fn a_task_that_does_not_run_is_not_waited_for_for_ever() {
    let mut simulation = Simulation::new(Pace::Free);
    let clock = simulation.clock();
    let storage = Storage::<NoopRawMutex>::new();
    let asked = simulation.block_on(storage.request(Job::Save(changes(1)))).unwrap();
    assert_eq!(asked, Err(Refusal::StorageFailed));
    assert_eq!(clock.now_ns(), 10_000_000_000);
}

#[test]
fn flash_that_fails_is_told() {
    let mut flash = Flash::<SMALL>::new(SECTORS);
    keep(&mut flash, 1).unwrap();
    flash.cut_after(1, Tear::Unreadable);
    assert_eq!(keep(&mut flash, 2), Err(StorageError::Flash));
    assert_eq!(record(&mut flash, &small(1)), Err(StorageError::Flash));
    flash.power_up();
    assert_eq!(start(&mut flash), 1);
}
