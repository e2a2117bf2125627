//! Tests of [`State::apply`] in full, and of the requests of the tasks to [`Shared`] at its limits.

use core::task::Context;

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_time::{Duration, Instant};
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelKind, HotWinding, ImageInfo, Mode, Quality, Refusal, SafetyState, Setpoint,
    Winding,
    config::{
        ANALOG_INPUTS, DAC_OUTPUTS, ENCODERS, FeedForward, MAX_BLDCS, MAX_MOTORS, MAX_RELAYS, MAX_SENSORS, MAX_SERVOS,
        MAX_SUPPLIES, PidGains, Place, RANGE_SENSORS, STEPPERS, SWITCHES, Tuning,
    },
};

use super::{
    slots::{CHANNELS, OUTPUTS, command_slot, slot},
    *,
};
use crate::{
    safety::{Event, Safety},
    sensing::range::RangeReading,
    testing::{Board, board, robot},
};

const LINK: u8 = 1;
const MS: Duration = Duration::from_millis(1);
const US: Duration = Duration::from_micros(1);
const DUTY: Setpoint = Setpoint { mode: Mode::Duty, value: 0.25 };
const MOTOR: Place = Place::Motor(0);

fn every_interface() -> Board {
    board(robot("every-interface"), ResetCause::Normal)
}

fn armed() -> Board {
    let board = every_interface();
    assert_eq!(board.request(Event::Arm), Ok(()));
    board
}

/// Sets of causes: none, each alone, and each with the next.
fn some_causes() -> impl Iterator<Item = Causes> + Clone {
    let pairs = (0..Cause::ALL.len())
        .map(|first| Causes::only(Cause::ALL[first]).union(Causes::only(Cause::ALL[(first + 1) % Cause::ALL.len()])));
    [Causes::NONE].into_iter().chain(Cause::ALL.map(Causes::only)).chain(pairs)
}

/// Checks the additions of [`State::apply`] to the pure machine, for every state, event, set of one or two present
/// causes, with and without arming held back and a host.
#[test]
fn every_event_in_every_state_keeps_the_books() {
    let board = every_interface();
    let tripped = some_causes().filter(|causes| !causes.is_empty()).map(|causes| Safety::Tripped { causes });
    let states = [Safety::Disarmed, Safety::Armed].into_iter().chain(tripped);
    let trips = Cause::ALL.map(|cause| Event::Trip(Causes::only(cause)));
    let events = [Event::Tick, Event::Arm, Event::Disarm, Event::Clear].into_iter().chain(trips);
    for before in states {
        for (event, present) in events.clone().flat_map(|event| some_causes().map(move |present| (event, present))) {
            for (arming_held, heard_of) in [(0, false), (1, false), (0, true), (2, true)] {
                board.with(|s| {
                    s.supervision.set_up(before, present, arming_held);
                    s.sessions.set_heard_of_any(heard_of);
                    s.commands.put(MOTOR, DUTY, u16::MAX, 0);
                    s.commands.lease(MOTOR, Mode::Duty, Instant::now());
                    let (changed, result) = s.apply(event);
                    let told = format_args!("{before:?} {event:?} {present:?} {arming_held} {heard_of}");

                    let would_arm = before == Safety::Disarmed && event == Event::Arm && present.is_empty();
                    let (after, answer) = if would_arm && arming_held > 0 {
                        (before, Err(Refusal::Busy))
                    } else {
                        before.next(event, present)
                    };
                    assert_eq!((s.supervision.state(), result), (after, answer), "{told}");
                    // Only a state with other outputs counts as a change; an additional cause does not.
                    assert_eq!(changed, after.state() != before.state(), "{told}");
                    // Only an arming invalidates earlier commands.
                    let armed = changed && after == Safety::Armed;
                    assert_eq!(s.supervision.view().epoch, if armed { 0 } else { u16::MAX }, "{told}");
                    assert_eq!(s.commands.commanded().has(MOTOR), !armed, "{told}");
                    assert_eq!(s.commands.has_leases(), !armed, "{told}");
                    // A trip counts once, and not before a host could have armed the board.
                    let trips = changed && after.state() == SafetyState::Tripped && heard_of;
                    assert_eq!(s.supervision.trips(), 7 + u32::from(trips), "{told}");
                    // The causes of the last trip outlive it, and grow while it lasts.
                    assert_eq!(s.supervision.trip_causes(), after.causes(), "{told}");
                });
            }
        }
    }
}

#[test]
fn the_causes_of_the_last_trip_outlive_it() {
    let board = armed();
    board.trip(Cause::Stalled);
    board.trip(Cause::HostStop);
    assert_eq!(board.request(Event::Clear), Ok(()));
    assert_eq!(board.safety().causes, Causes::NONE);
    assert_eq!(board.trip_causes(), Causes::only(Cause::Stalled).union(Causes::only(Cause::HostStop)));
}

#[test]
fn trips_are_counted_from_the_first_host_on() {
    let board = every_interface();
    board.trip(Cause::HostStop);
    assert_eq!(board.trips(), 0);
    assert_eq!(board.request(Event::Clear), Ok(()));
    board.as_host().open_session(LINK, Instant::now()).expect("nobody else is here");
    board.trip(Cause::HostStop);
    board.trip(Cause::Stalled);
    assert_eq!(board.trips(), 1);
    // A hang of the firmware is recorded with or without a host.
    let hung = crate::testing::board(robot("osmc-bench"), ResetCause::Watchdog);
    assert_eq!((hung.trips(), hung.trip_causes()), (1, Causes::only(Cause::WatchdogReset)));
}

/// Causes of the processor's own detectors are present until they are cleared.
#[test]
fn a_cause_of_the_processor_trips_and_stays() {
    let board = armed();
    board.set_processor_cause(Cause::ClockFault, false);
    board.as_supervisor().supervise(Causes::NONE, Instant::now());
    assert_eq!(board.safety().state, SafetyState::Armed);
    board.set_processor_cause(Cause::ClockFault, true);
    let causes = Causes::only(Cause::ClockFault);
    assert_eq!((board.safety().state, board.safety().causes), (SafetyState::Tripped, causes));
    board.as_supervisor().supervise(Causes::NONE, Instant::now());
    assert_eq!(board.request(Event::Clear), Err(Refusal::CausesPresent { causes }));
    board.set_processor_cause(Cause::ClockFault, false);
    board.as_supervisor().supervise(Causes::NONE, Instant::now());
    assert_eq!(board.request(Event::Clear), Ok(()));
}

/// A write under way checks whether to go on: the signal is consumed only when there is nothing to do.
#[test]
fn a_change_of_state_is_seen_and_its_signal_left() {
    let board = armed();
    let mut context = Context::from_waker(core::task::Waker::noop());
    let view = board.safety();
    assert!(board.make_safe.signaled(), "it was armed");
    assert!(!board.as_control().has_changed(view, &mut context));
    assert!(!board.make_safe.signaled());
    board.trip(Cause::HostStop);
    assert!(board.as_control().has_changed(view, &mut context));
    assert!(board.make_safe.signaled());
    // Also without a signal: the supervisor's deadline may have come first.
    board.make_safe.reset();
    assert!(board.as_control().has_changed(view, &mut context));
}

#[test]
fn commands_are_taken_only_while_armed_and_carried_out_once_in_their_arming() {
    let board = every_interface();
    assert_eq!(board.as_host().command(MOTOR, DUTY, 0), Err(Refusal::NotArmed { state: SafetyState::Disarmed }));
    assert_eq!(board.request(Event::Arm), Ok(()));
    assert_eq!(board.as_host().command(MOTOR, DUTY, 0), Ok(()));
    let epoch = board.safety().epoch;
    // A command of a later arming stays for the period of that arming.
    assert_eq!(board.as_control().take_command(MOTOR, epoch.wrapping_sub(1)), None);
    assert_eq!(board.as_control().take_command(Place::Motor(1), epoch), None);
    assert!(board.as_control().commanded().has(MOTOR) && !board.as_control().commanded().has(Place::Motor(1)));
    assert_eq!(board.as_control().take_command(MOTOR, epoch), Some(DUTY));
    assert_eq!(board.as_control().take_command(MOTOR, epoch), None);
    assert!(!board.as_control().commanded().has(MOTOR));
    assert_eq!(board.as_host().command(MOTOR, DUTY, 0), Ok(()));
    board.trip(Cause::HostStop);
    assert_eq!(board.as_host().command(MOTOR, DUTY, 0), Err(Refusal::NotArmed { state: SafetyState::Tripped }));
    assert_eq!(board.request(Event::Clear), Ok(()));
    assert_eq!(board.request(Event::Arm), Ok(()));
    assert_eq!(board.safety().epoch, epoch + 1);
    assert_eq!(board.as_control().take_command(MOTOR, epoch + 1), None, "it was of the arming before");
}

/// Each channel has a slot of its own, and a brake one beside its drive's.
#[test]
fn no_two_channels_share_a_place() {
    let config = robot("every-interface");
    let mut taken = [false; CHANNELS];
    for (id, place) in config.channels() {
        assert!(!core::mem::replace(&mut taken[slot(place)], true), "{id}");
    }
    let lasts = [
        Place::Motor(MAX_MOTORS - 1),
        Place::Bldc(MAX_BLDCS - 1),
        Place::Servo(MAX_SERVOS - 1),
        Place::Stepper(STEPPERS - 1),
        Place::Relay(MAX_RELAYS - 1),
        Place::Dac(DAC_OUTPUTS - 1),
        Place::Encoder(ENCODERS - 1),
        Place::Switch(SWITCHES - 1),
        Place::Range(RANGE_SENSORS - 1),
        Place::Analog(ANALOG_INPUTS - 1),
        Place::Supply(MAX_SUPPLIES - 1),
        Place::Sensor(MAX_SENSORS - 1),
        Place::DeadMan(1),
    ];
    let first = |place| match place {
        Place::Motor(_) => Place::Motor(0),
        Place::Bldc(_) => Place::Bldc(0),
        Place::Servo(_) => Place::Servo(0),
        Place::Stepper(_) => Place::Stepper(0),
        Place::Relay(_) => Place::Relay(0),
        Place::Dac(_) => Place::Dac(0),
        Place::Encoder(_) => Place::Encoder(0),
        Place::Switch(_) => Place::Switch(0),
        Place::Range(_) => Place::Range(0),
        Place::Analog(_) => Place::Analog(0),
        Place::Supply(_) => Place::Supply(0),
        Place::Sensor(_) => Place::Sensor(0),
        Place::DeadMan(_) => Place::DeadMan(0),
    };
    // Kinds follow each other without a gap, up to the last slot.
    assert_eq!(slot(Place::Motor(0)), 0);
    for [one, next] in lasts.array_windows() {
        assert_eq!(slot(*one) + 1, slot(first(*next)), "{next:?}");
    }
    assert_eq!(slot(Place::DeadMan(1)), CHANNELS - 1);
    // Brakes come behind the last output.
    assert_eq!(command_slot(Place::Bldc(0), Mode::Brake), slot(Place::Dac(DAC_OUTPUTS - 1)) + 1);
    assert_eq!(command_slot(Place::Bldc(MAX_BLDCS - 1), Mode::Brake), OUTPUTS - 1);
    assert_eq!(command_slot(Place::Bldc(1), Mode::Duty), slot(Place::Bldc(1)));
}

#[test]
fn a_brake_is_commanded_beside_its_drive() {
    let board = armed();
    let epoch = board.safety().epoch;
    for (value, applied) in [(1.0, true), (0.0, false)] {
        assert_eq!(board.as_host().command(Place::Bldc(2), Setpoint { mode: Mode::Brake, value }, 0), Ok(()));
        let commanded = board.as_control().commanded();
        assert!(commanded.has_brake(2) && !commanded.has_brake(1) && !commanded.has(Place::Bldc(2)));
        assert_eq!(board.as_host().command(Place::Bldc(2), DUTY, 0), Ok(()));
        assert!(board.as_control().commanded().has(Place::Bldc(2)));
        assert_eq!(board.as_control().take_brake(1, epoch), None);
        assert_eq!(board.as_control().take_brake(2, epoch), Some(applied));
        assert_eq!(board.as_control().take_brake(2, epoch), None);
        assert!(!board.as_control().commanded().has_brake(2));
        assert_eq!(board.as_control().take_command(Place::Bldc(2), epoch), Some(DUTY));
        assert!(!board.as_control().commanded().has(Place::Bldc(2)));
    }
}

/// A lease ends after its last µs, in a rest that suits the mode it followed, and is counted.
#[test]
fn a_lease_that_is_not_renewed_ends_in_rest() {
    let now = Instant::now();
    for (mode, rest) in [
        (Mode::Duty, Setpoint::NONE),
        (Mode::Speed, Setpoint { mode: Mode::Speed, value: 0.0 }),
        (Mode::Position, Setpoint { mode: Mode::Speed, value: 0.0 }),
    ] {
        let board = armed();
        let epoch = board.safety().epoch;
        let follow = |place| (place, Setpoint { mode, value: 0.25 });
        assert_eq!(board.as_host().lease(&[follow(MOTOR), follow(Place::Motor(1))], 0, now), Ok(()));
        assert_eq!(board.as_host().lease(&[follow(Place::Motor(1))], 0, now + US), Ok(()));
        board.as_control().end_leases(now);
        assert_eq!(board.as_control().take_command(MOTOR, epoch), Some(follow(MOTOR).1));
        board.as_control().end_leases(now + US);
        assert_eq!(board.as_control().take_command(MOTOR, epoch), Some(rest));
        assert_eq!(board.as_control().take_command(Place::Motor(1), epoch), Some(follow(MOTOR).1));
        assert_eq!(board.report().stats().setpoints_expired, 1);
        board.as_control().end_leases(now + US * 2);
        assert_eq!(board.as_control().take_command(Place::Motor(1), epoch), Some(rest));
        board.as_control().end_leases(now + MS);
        assert_eq!(
            (board.as_control().take_command(MOTOR, epoch), board.report().stats().setpoints_expired),
            (None, 2)
        );
    }
}

/// All channels that cycles can move, at once.
#[test]
fn there_is_a_lease_for_each_channel() {
    let board = armed();
    let epoch = board.safety().epoch;
    let now = Instant::now();
    let motors = (0..MAX_MOTORS).map(Place::Motor);
    let places = motors.chain((0..MAX_BLDCS).map(Place::Bldc)).chain((0..STEPPERS).map(Place::Stepper));
    for place in places.clone() {
        assert_eq!(board.as_host().lease(&[(place, DUTY)], 0, now), Ok(()));
    }
    board.as_control().end_leases(now + US);
    for place in places {
        assert_eq!(board.as_control().take_command(place, epoch), Some(Setpoint::NONE), "{place:?}");
    }
}

/// A single command is followed until another one comes.
#[test]
fn a_command_ends_the_lease_of_its_channel() {
    let board = armed();
    let epoch = board.safety().epoch;
    let now = Instant::now();
    assert_eq!(board.as_host().lease(&[(MOTOR, DUTY), (Place::Motor(1), DUTY)], 0, now), Ok(()));
    assert_eq!(board.as_host().command(MOTOR, DUTY, 0), Ok(()));
    board.as_control().end_leases(now + MS);
    assert_eq!(board.as_control().take_command(MOTOR, epoch), Some(DUTY));
    assert_eq!(board.as_control().take_command(Place::Motor(1), epoch), Some(Setpoint::NONE));
    board.trip(Cause::HostStop);
    let refused = Refusal::NotArmed { state: SafetyState::Tripped };
    assert_eq!(board.as_host().lease(&[(MOTOR, DUTY)], 0, now), Err(refused));
}

/// Another host gets the session once the first has been silent for longer than the timeout, and not before.
#[test]
fn a_board_has_one_host() {
    let board = every_interface();
    let timeout = Duration::from_millis(board.config().link_timeout_ms.into());
    let now = Instant::now();
    let first = board.as_host().open_session(LINK, now).expect("nobody else is here");
    assert!(board.as_host().has_session(LINK) && !board.as_host().has_session(LINK + 1));
    assert_eq!(board.as_host().open_session(LINK + 1, now + timeout), Err(Refusal::InUse));
    // The same link may open a new session at any time, which ends its old one.
    let second = board.as_host().open_session(LINK, now).expect("its own link");
    assert_ne!(first, second);
    assert!(!board.as_host().heartbeat(LINK, first, now));
    assert!(!board.as_host().heartbeat(LINK + 1, second, now));
    assert!(board.as_host().heartbeat(LINK, second, now + MS));
    assert_eq!(board.as_host().open_session(LINK + 1, now + MS + timeout), Err(Refusal::InUse));
    let third = board.as_host().open_session(LINK + 1, now + MS + timeout + US).expect("the other is silent");
    assert!(!board.as_host().has_session(LINK) && board.as_host().has_session(LINK + 1));
    assert!(!board.as_host().heartbeat(LINK, second, now) && board.as_host().heartbeat(LINK + 1, third, now));
}

#[test]
fn a_host_is_there_while_it_is_heard() {
    let board = every_interface();
    let timeout = Duration::from_millis(board.config().link_timeout_ms.into());
    assert!(!board.as_supervisor().has_host());
    assert_eq!(board.report().heartbeat_age(), None);
    let now = Instant::now();
    board.as_host().open_session(LINK, now - timeout).expect("nobody else is here");
    assert!(board.as_supervisor().has_host());
    assert_eq!(board.report().heartbeat_age(), Some(timeout));
    board.as_host().open_session(LINK, now - timeout - US).expect("its own link");
    assert!(!board.as_supervisor().has_host());
}

/// A host that starts or leaves leaves nothing running; other links end nothing.
#[test]
fn sessions_begin_and_end_disarmed() {
    let board = armed();
    board.as_host().open_session(LINK, Instant::now()).expect("nobody else is here");
    assert_eq!(board.safety().state, SafetyState::Disarmed);
    assert_eq!(board.request(Event::Arm), Ok(()));
    board.as_host().close_session(LINK + 1);
    assert_eq!(board.safety().state, SafetyState::Armed);
    assert!(board.as_host().has_session(LINK));
    board.as_host().close_session(LINK);
    assert_eq!(board.safety().state, SafetyState::Disarmed);
    assert!(!board.as_host().has_session(LINK));
}

#[test]
fn arming_waits_for_all_that_hold_it_back() {
    let board = armed();
    let armed = Refusal::NotWhile { state: SafetyState::Armed };
    assert_eq!(board.as_host().hold_arming().err(), Some(armed));
    assert_eq!(board.as_host().restart(Restart::Firmware), Err(armed));
    assert_eq!(board.request(Event::Disarm), Ok(()));
    let (one, other) =
        (board.as_host().hold_arming().expect("disarmed"), board.as_host().hold_arming().expect("disarmed"));
    assert_eq!(board.request(Event::Arm), Err(Refusal::Busy));
    drop(one);
    assert_eq!(board.request(Event::Arm), Err(Refusal::Busy));
    drop(other);
    assert_eq!(board.request(Event::Arm), Ok(()));
    assert_eq!(board.request(Event::Disarm), Ok(()));
    assert_eq!(board.as_host().restart(Restart::Firmware), Ok(()));
    assert_eq!(board.restart.try_take(), Some(Restart::Firmware));
    assert_eq!(board.request(Event::Arm), Err(Refusal::Busy), "it is about to restart");
}

#[test]
fn only_a_hosted_image_restarts_into_a_bootloader() {
    let image = |hosted| ImageInfo { hosted, bytes: 64, crc: 1 };
    let board = || -> Shared<NoopRawMutex> {
        let config = robot("every-interface");
        Shared::new(config.clone(), config, ResetCause::Normal)
    };
    for bare in [board(), board().with_image(image(false))] {
        assert_eq!(bare.as_host().restart(Restart::Bootloader), Err(Refusal::NoBootloader));
        assert_eq!(bare.restart.try_take(), None);
        assert_eq!(bare.request(Event::Arm), Ok(()), "a refusal changes nothing");
    }
    let hosted = board().with_image(image(true));
    assert_eq!(hosted.request(Event::Arm), Ok(()));
    assert_eq!(hosted.as_host().restart(Restart::Bootloader), Err(Refusal::NotWhile { state: SafetyState::Armed }));
    assert_eq!(hosted.request(Event::Disarm), Ok(()));
    assert_eq!(hosted.as_host().restart(Restart::Bootloader), Ok(()));
    assert_eq!(hosted.restart.try_take(), Some(Restart::Bootloader));
    assert_eq!((board().as_host().image(), hosted.as_host().image()), (Err(Refusal::NoImage), Ok(image(true))));
}

#[test]
fn a_damaged_image_cannot_be_cleared() {
    let board = crate::testing::board(robot("osmc-bench"), ResetCause::DamagedImage);
    let causes = Causes::only(Cause::DamagedImage);
    assert_eq!(board.safety().causes, causes);
    for event in [Event::Arm, Event::Clear] {
        let refused = board.request(event).expect_err("it is held");
        assert!(matches!(refused, Refusal::CausesPresent { causes: present } if present.contains(Cause::DamagedImage)));
    }
}

#[test]
fn gains_reach_the_loop_they_are_for() {
    let board = every_interface();
    let gains = |kp| PidGains { kp, ki: 0.0, kd: 0.0 };
    board.as_host().change_gains(3, Mode::Speed, gains(1.0));
    board.as_host().change_gains(3, Mode::Speed, gains(2.0));
    board.as_host().change_gains(1, Mode::Position, gains(3.0));
    board.as_host().change_gains(2, Mode::Duty, gains(4.0));
    assert_eq!(board.as_control().take_gains(), Some((1, Mode::Position, gains(3.0))));
    assert_eq!(board.as_control().take_gains(), Some((3, Mode::Speed, gains(2.0))));
    assert_eq!(board.as_control().take_gains(), None);
}

#[test]
fn the_newest_tuning_reaches_its_motor_once() {
    let board = every_interface();
    let tuning = |cascade_per_s| Tuning {
        feed_forward: FeedForward { static_duty: 0.1, duty_per_speed: 0.0, duty_per_acceleration: 0.0 },
        cascade_per_s,
    };
    board.as_host().change_tuning(3, tuning(1.0));
    board.as_host().change_tuning(1, tuning(2.0));
    board.as_host().change_tuning(3, tuning(3.0));
    assert_eq!(board.as_control().take_tuning(), Some((1, tuning(2.0))));
    assert_eq!(board.as_control().take_tuning(), Some((3, tuning(3.0))));
    assert_eq!(board.as_control().take_tuning(), None);
}

/// Hosts are answered once outputs are known and every sensor that can stop the board has reported.
#[test]
fn the_board_has_started_when_its_guards_are_heard() {
    let mut config = robot("every-interface");
    config.ranges.iter_mut().for_each(|range| range.stop_below_m = None);
    config.ranges[1].stop_below_m = Some(0.3);
    let board = board(config, ResetCause::Normal);
    let heard = RangeReading { quality: Quality::NoAnswer, ..RangeReading::NONE };
    board.publish_range(0, heard);
    board.as_control().set_started();
    assert!(!board.as_host().has_started());
    board.publish_range(1, heard);
    assert!(board.as_host().has_started());
    let board = crate::testing::board(robot("osmc-bench"), ResetCause::Normal);
    assert!(!board.as_host().has_started());
    board.as_control().set_started();
    assert!(board.as_host().has_started());
}

/// Several statuses at once each go to their own slot.
#[test]
fn what_is_published_is_shown_in_its_place() {
    let board = every_interface();
    board.as_control().publish_each(Place::Servo(0), [0.1, 0.2, 0.3].map(Status::Scalar).into_iter());
    let servos = [0, 1, 2, 3].map(|index| board.report().status(Place::Servo(index)));
    assert_eq!(servos, [0.1, 0.2, 0.3, 0.0].map(Status::Scalar));
    board.note_can(3, 5);
    assert_eq!((board.report().stats().can_bus_off, board.report().stats().can_warnings), (3, 5));
}

/// Windings close to their limit are reported with their motors' names.
#[test]
fn hosts_are_warned_of_hot_windings() {
    let board = every_interface();
    let windings = [None, Some((90, true)), Some((60, false)), Some((97, true))];
    for (index, winding) in windings.into_iter().enumerate() {
        let winding = winding.map(|(heat_percent, hot)| Winding { heat_percent, hot });
        board.publish(Place::Motor(index), Status::Motor(MotorStatus { winding, ..MotorStatus::IDLE }));
    }
    let hot = [(1, 90), (3, 97)];
    let hot = hot.map(|(index, heat_percent)| HotWinding { channel: board.config().motors[index].id, heat_percent });
    assert_eq!(board.report().hot_windings()[..], hot);
}

#[test]
fn a_changed_configuration_waits_for_the_next_start() {
    let board = every_interface();
    let mut changed = board.config().clone();
    changed.link_timeout_ms += 1;
    board.as_host().set_pending(changed.clone());
    assert_eq!(board.as_host().pending(), changed);
    assert_ne!(board.config(), &changed);
    assert_eq!(board.as_host().built_in(), board.config());
}

/// Initial status of each kind of channel, before its sensor or output has reported.
#[test]
fn a_board_begins_at_rest() {
    let board = every_interface();
    for (id, place) in board.config().channels() {
        let expected = match id.kind {
            ChannelKind::Osmc | ChannelKind::Actuator | ChannelKind::Dhb | ChannelKind::Stepper => {
                Status::Motor(MotorStatus::IDLE)
            }
            ChannelKind::Encoder => Status::Encoder { position: 0, speed: 0.0, illegal: 0 },
            ChannelKind::Range | ChannelKind::Analog => {
                Status::Reading { value: 0.0, quality: Quality::None, taken: Instant::now() }
            }
            _ => Status::Scalar(0.0),
        };
        assert_eq!(board.report().status(place), expected, "{id}");
    }
    assert!(board.config().place(ChannelId::new(ChannelKind::DeadMan, 1)).is_some());
}
