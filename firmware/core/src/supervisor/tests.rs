//! Tests of [`supervise`] as the board runs it: each cause alone, to the tick, then all of them together.

use embassy_time::{Duration, Instant};
use r4_protocol::{
    Cause, Causes, Refusal, SafetyState,
    config::{BoardConfig, Place},
};

use super::{SafetyPins, supervise};
use crate::{
    ResetCause,
    safety::{Event, Safety},
    sensing::range::RangeReading,
    shared::Status,
    testing::{Board, Line, Tasks, board, robot},
};

const MS: Duration = Duration::from_millis(1);
const US: Duration = Duration::from_micros(1);
/// Time for which a released line stops the board after it was last low.
const HELD_FOR: Duration = Duration::from_millis(20);
const LINK: u8 = 1;

/// Supervisor with its lines and its board.
struct Bench {
    shared: Board,
    tasks: Tasks,
    dead_man: Line,
    auxiliary_stop: Line,
    osmc_disable: Line,
    pwm_output_disable: Line,
    heartbeat: Line,
    red: Line,
    green: Line,
    blue: Line,
}

/// Configuration with one range sensor that can stop the board, an auxiliary stop, and 100 ms for the link.
fn config() -> BoardConfig {
    let mut config = robot("every-interface");
    config.link_timeout_ms = 100;
    config.ranges.truncate(1);
    config.ranges[0].stop_below_m = Some(0.3);
    config
}

impl Bench {
    fn with(config: BoardConfig, reset: ResetCause) -> Self {
        let line = Line::new;
        let mut bench = Self {
            shared: board(config, reset),
            tasks: Tasks::default(),
            dead_man: line(true),
            auxiliary_stop: line(true),
            osmc_disable: line(false),
            pwm_output_disable: line(false),
            heartbeat: line(false),
            red: line(false),
            green: line(false),
            blue: line(false),
        };
        bench.tasks.spawn(supervise(
            bench.shared,
            SafetyPins {
                dead_man: bench.dead_man.clone(),
                auxiliary_stop: bench.auxiliary_stop.clone(),
                osmc_disable: bench.osmc_disable.clone(),
                pwm_output_disable: bench.pwm_output_disable.clone(),
                heartbeat: bench.heartbeat.clone(),
                red: bench.red.clone(),
                green: bench.green.clone(),
                blue: bench.blue.clone(),
            },
        ));
        bench
    }

    fn new() -> Self {
        Self::with(config(), ResetCause::Normal)
    }

    /// Armed bench, at a moment at which the supervisor has just checked, with all of its inputs in order.
    fn armed() -> Self {
        let mut bench = Self::new();
        bench.tasks.advance(Duration::from_millis(3));
        bench.shared.publish_range(0, RangeReading { updated: Instant::now(), ..RangeReading::NONE });
        bench.arm();
        bench
    }

    fn arm(&mut self) {
        assert_eq!(self.shared.request(Event::Arm), Ok(()));
        self.settle();
        assert_eq!(self.state(), SafetyState::Armed);
    }

    fn settle(&mut self) {
        self.tasks.settle();
        self.the_lines_show_the_state();
    }

    fn advance(&mut self, duration: Duration) {
        self.tasks.advance(duration);
        self.the_lines_show_the_state();
    }

    fn advance_to(&mut self, moment: Instant) {
        self.tasks.advance_to(moment);
        self.the_lines_show_the_state();
    }

    fn state(&self) -> SafetyState {
        self.shared.safety().state
    }

    fn tripped_by(&self) -> Causes {
        self.shared.safety().causes
    }

    /// Checks what holds after every pass of the supervisor: bridges run only while armed, lights are low while on.
    fn the_lines_show_the_state(&self) {
        let armed = self.state() == SafetyState::Armed;
        assert_eq!((self.osmc_disable.level(), self.pwm_output_disable.level()), (!armed, !armed));
        assert_eq!(self.green.level(), !armed);
        assert_eq!(self.red.level(), self.state() != SafetyState::Tripped);
    }

    /// Checks that the board trips by `cause` alone at `moment`, and not a microsecond before.
    #[track_caller]
    fn trips_at(mut self, moment: Instant, cause: Cause) -> Self {
        self.advance_to(moment - US);
        assert_eq!(self.state(), SafetyState::Armed, "{cause} came early");
        self.advance(US);
        self.settle();
        assert_eq!((self.state(), self.tripped_by()), (SafetyState::Tripped, Causes::only(cause)));
        self
    }

    /// Checks that the board is still tripped by `cause` a microsecond before `moment` and can be cleared from then on.
    #[track_caller]
    fn clears_at(mut self, moment: Instant, cause: Cause) -> Self {
        self.advance_to(moment - US);
        let present = Causes::only(cause);
        assert_eq!(self.shared.request(Event::Clear), Err(Refusal::CausesPresent { causes: present }));
        self.advance(US);
        assert_eq!(self.shared.request(Event::Clear), Ok(()), "{cause} stayed");
        self.settle();
        assert_eq!(self.state(), SafetyState::Disarmed);
        self
    }

    /// Time of the supervisor's last pass, or `after` of its periods later.
    fn tick(&self, after: u32) -> Instant {
        Instant::now() + MS * after
    }
}

#[test]
fn before_its_first_look_nothing_may_move() {
    let bench = Bench::new();
    bench.osmc_disable.set(false);
    let mut bench = bench;
    bench.settle();
    assert_eq!(bench.state(), SafetyState::Disarmed);
}

#[test]
fn a_released_handle_stops_at_once() {
    let mut bench = Bench::armed();
    // Between two passes.
    bench.advance(Duration::from_micros(300));
    bench.dead_man.set(false);
    bench.settle();
    assert_eq!(bench.tripped_by(), Causes::only(Cause::DeadMan));
}

#[test]
fn a_handle_that_cannot_be_read_is_released() {
    let bench = Bench::armed();
    bench.dead_man.break_off();
    let next = bench.tick(1);
    bench.trips_at(next, Cause::DeadMan);
}

/// A handle released and held again before any pass.
#[test]
fn a_release_shorter_than_any_look_is_one() {
    let mut bench = Bench::armed();
    bench.advance(Duration::from_micros(300));
    bench.dead_man.set(false);
    bench.dead_man.set(true);
    bench.settle();
    assert_eq!(bench.tripped_by(), Causes::only(Cause::DeadMan));
}

/// The wait ends at the first pass 20 ms after the line was last low: exactly 20 ms are enough, 1 µs less is not.
#[test]
fn a_handle_counts_as_held_after_20_ms_exactly() {
    for (held_after, looks) in [(Duration::MIN, 20), (US, 21), (MS - US, 21)] {
        let mut bench = Bench::armed();
        bench.dead_man.set(false);
        bench.settle();
        let tick = Instant::now();
        bench.advance(Duration::from_millis(7) + held_after);
        bench.dead_man.set(true);
        bench.clears_at(tick + MS * (7 + looks), Cause::DeadMan);
    }
}

/// Each bounce restarts the wait.
#[test]
fn a_bouncing_handle_stays_released() {
    let mut bench = Bench::armed();
    for _ in 0..10 {
        bench.dead_man.set(false);
        bench.settle();
        bench.dead_man.set(true);
        bench.advance(HELD_FOR - MS);
        assert!(bench.shared.request(Event::Clear).is_err());
    }
    let tick = Instant::now();
    bench.clears_at(tick + MS, Cause::DeadMan);
}

#[test]
fn a_pressed_stop_is_seen_at_the_next_look_and_bounces_like_the_handle() {
    let bench = Bench::armed();
    bench.auxiliary_stop.set(false);
    let tick = bench.tick(1);
    let bench = bench.trips_at(tick, Cause::AuxiliaryStop);
    bench.auxiliary_stop.set(true);
    // It was last seen low at the pass that tripped.
    bench.clears_at(tick + HELD_FOR, Cause::AuxiliaryStop);
}

#[test]
fn a_stop_that_cannot_be_read_is_pressed() {
    let bench = Bench::armed();
    bench.auxiliary_stop.break_off();
    let tick = bench.tick(1);
    bench.trips_at(tick, Cause::AuxiliaryStop);
}

#[test]
fn a_board_without_a_stop_button_ignores_its_line() {
    let mut bench = Bench::with(BoardConfig { auxiliary_stop: false, ..config() }, ResetCause::Normal);
    bench.auxiliary_stop.set(false);
    bench.advance(MS);
    bench.arm();
    bench.advance(HELD_FOR);
    assert_eq!(bench.state(), SafetyState::Armed);
}

/// Hosts see the stops as channels: the handle at the last pass, the button once it has stopped bouncing.
#[test]
fn the_stops_are_channels() {
    let mut bench = Bench::armed();
    let shown = |bench: &Bench| [0, 1].map(|stop| bench.shared.report().status(Place::DeadMan(stop)));
    let [high, low] = [Status::Scalar(1.0), Status::Scalar(0.0)];
    assert_eq!(shown(&bench), [high, high]);
    bench.dead_man.set(false);
    bench.auxiliary_stop.set(false);
    bench.settle();
    assert_eq!(shown(&bench), [low, low]);
    bench.dead_man.set(true);
    bench.auxiliary_stop.set(true);
    bench.settle();
    // One edge per pass: a handle that chatters must not keep the processor busy.
    assert_eq!(shown(&bench), [low, low]);
    bench.advance(MS);
    assert_eq!(shown(&bench), [high, low]);
    bench.advance(HELD_FOR);
    assert_eq!(shown(&bench), [high, high]);
}

/// A silence of 100 ms is allowed, a tick more is not; the next pass sees it.
#[test]
fn a_silent_host_is_lost_after_the_timeout_exactly() {
    for (heard_after, looks) in [(Duration::MIN, 101), (US, 101), (MS - US, 101)] {
        let mut bench = Bench::armed();
        // Opening a session disarms.
        let session = bench.shared.as_host().open_session(LINK, Instant::now()).expect("nobody else is here");
        bench.arm();
        let tick = Instant::now();
        bench.advance(heard_after);
        assert!(bench.shared.as_host().heartbeat(LINK, session, Instant::now()));
        let bench = bench.trips_at(tick + MS * looks, Cause::LinkLost);
        // After a new heartbeat the cause is gone with the next pass.
        assert!(bench.shared.as_host().heartbeat(LINK, session, Instant::now()));
        bench.clears_at(tick + MS * (looks + 1), Cause::LinkLost);
    }
    // A tick before a pass: at that pass 100 ms and 1 µs have passed.
    let mut bench = Bench::armed();
    bench.advance(MS - US);
    bench.shared.as_host().open_session(LINK, Instant::now()).expect("nobody else is here");
    bench.arm();
    let tick = Instant::now() + US;
    bench.trips_at(tick + MS * 100, Cause::LinkLost);
}

#[test]
fn without_a_host_no_link_is_lost() {
    let mut bench = Bench::armed();
    // The range sensor must report meanwhile.
    for _ in 0..10 {
        bench.advance(MS * 100);
        bench.shared.publish_range(0, RangeReading { updated: Instant::now(), ..RangeReading::NONE });
    }
    assert_eq!(bench.state(), SafetyState::Armed);
    assert!(bench.blue.level());
}

/// The blue light goes out with the same pass that reports the link as lost.
#[test]
fn the_blue_light_shows_a_host() {
    let mut bench = Bench::armed();
    assert!(bench.blue.level());
    bench.shared.as_host().open_session(LINK, Instant::now()).expect("nobody else is here");
    bench.advance(MS);
    assert!(!bench.blue.level());
    bench.advance(MS * 99);
    assert!(!bench.blue.level(), "100 ms are allowed");
    bench.advance(MS);
    assert!(bench.blue.level());
}

/// Five periods without a control tick are allowed, a µs more is not.
#[test]
fn a_dead_control_loop_is_an_overrun() {
    for (before, looks) in [(Duration::MIN, 6), (US, 5)] {
        let mut bench = Bench::armed();
        let tick = bench.tick(1);
        bench.advance_to(tick - before);
        bench.shared.as_control().control_tick(Instant::now());
        bench.advance_to(tick);
        bench.trips_at(tick + MS * looks, Cause::ControlOverrun);
    }
    // With a period of 2 ms that is 10 ms.
    let mut bench = Bench::with(BoardConfig { control_period_us: 2000, ..config() }, ResetCause::Normal);
    bench.advance(MS);
    bench.arm();
    let tick = Instant::now();
    bench.shared.as_control().control_tick(tick);
    let bench = bench.trips_at(tick + MS * 11, Cause::ControlOverrun);
    // A loop that sets up its chips is not dead.
    bench.shared.as_control().control_pauses();
    bench.clears_at(tick + MS * 12, Cause::ControlOverrun);
}

#[test]
fn something_near_stops_at_once() {
    let mut bench = Bench::armed();
    bench.advance(Duration::from_micros(300));
    let reading = RangeReading { stop: true, updated: Instant::now(), ..RangeReading::NONE };
    bench.shared.publish_range(0, reading);
    bench.settle();
    assert_eq!(bench.tripped_by(), Causes::only(Cause::Proximity));
    let tick = Instant::now() + Duration::from_micros(700);
    bench.shared.publish_range(0, RangeReading { stop: false, ..reading });
    bench.clears_at(tick, Cause::Proximity);
}

/// A single sensor may be silent for four cycles of 60 ms: a µs more is a dead task, and each further sensor makes the
/// cycle longer.
#[test]
fn a_silent_range_sensor_stops() {
    for sensors in [1u32, 2, 4] {
        for (before, looks) in [(Duration::MIN, 240 * sensors + 1), (US, 240 * sensors)] {
            let mut bench = Bench::with(
                {
                    let mut config = robot("every-interface");
                    config.ranges.truncate(sensors as usize);
                    config.ranges.iter_mut().for_each(|range| range.stop_below_m = None);
                    config.ranges[0].stop_below_m = Some(0.3);
                    config
                },
                ResetCause::Normal,
            );
            bench.advance(MS);
            bench.arm();
            let tick = bench.tick(1);
            bench.advance_to(tick - before);
            bench.shared.publish_range(0, RangeReading { updated: Instant::now(), ..RangeReading::NONE });
            bench.trips_at(tick + MS * looks, Cause::Proximity);
        }
    }
}

#[test]
fn a_range_sensor_without_a_limit_stops_nothing() {
    let mut config = config();
    config.ranges[0].stop_below_m = None;
    let mut bench = Bench::with(config, ResetCause::Normal);
    bench.advance(MS);
    bench.arm();
    bench.shared.publish_range(0, RangeReading { stop: true, ..RangeReading::NONE });
    bench.advance(MS * 1000);
    assert_eq!(bench.state(), SafetyState::Armed);
}

/// Tasks that detect a cause themselves reach the supervisor between two passes, and the cause stays as long as they
/// report it.
#[test]
fn what_control_sees_stops_at_once() {
    for cause in Cause::ALL {
        let mut bench = Bench::armed();
        bench.advance(Duration::from_micros(300));
        bench.shared.as_control().set_control_causes(Causes::only(cause));
        bench.settle();
        assert_eq!(bench.tripped_by(), Causes::only(cause));
        // A second cause arrives while the first one is present.
        let other = Cause::ALL[(cause as usize + 1) % Cause::ALL.len()];
        let both = Causes::only(cause).union(Causes::only(other));
        bench.shared.as_control().set_control_causes(both);
        bench.settle();
        assert_eq!(bench.tripped_by(), both);
        let tick = Instant::now() + Duration::from_micros(700);
        bench.shared.as_control().set_control_causes(Causes::only(cause));
        bench.advance_to(tick);
        bench.shared.as_control().set_control_causes(Causes::NONE);
        bench.clears_at(tick + MS, cause);
    }
}

/// A cause that is over at once trips as well, and can be cleared at once.
#[test]
fn a_momentary_cause_trips() {
    for cause in Cause::ALL {
        let mut bench = Bench::armed();
        bench.shared.trip(cause);
        bench.settle();
        assert_eq!(bench.tripped_by(), Causes::only(cause));
        assert_eq!(bench.shared.request(Event::Clear), Ok(()));
        bench.settle();
        assert_eq!(bench.state(), SafetyState::Disarmed);
    }
}

#[test]
fn a_watchdog_reset_is_a_trip_from_the_start() {
    let mut bench = Bench::with(config(), ResetCause::Watchdog);
    bench.settle();
    assert_eq!(bench.tripped_by(), Causes::only(Cause::WatchdogReset));
    assert_eq!(bench.shared.request(Event::Clear), Ok(()));
    bench.settle();
    assert_eq!(bench.state(), SafetyState::Disarmed);
}

#[test]
fn a_bad_configuration_is_never_armed() {
    let mut bench = Bench::with(BoardConfig { link_timeout_ms: 0, ..config() }, ResetCause::Normal);
    bench.advance(MS);
    assert_eq!(bench.tripped_by(), Causes::only(Cause::BadConfiguration));
    assert!(bench.shared.request(Event::Clear).is_err());
}

/// An external watchdog sees the supervisor's period and not how often it is woken.
#[test]
fn the_heartbeat_toggles_once_a_period() {
    let mut bench = Bench::armed();
    let before = bench.heartbeat.edges();
    for _ in 0..10 {
        bench.advance(Duration::from_micros(500));
        bench.shared.supervisor.signal(());
        bench.settle();
        bench.advance(Duration::from_micros(500));
    }
    assert_eq!(bench.heartbeat.edges() - before, 10);
}

/// The control loop is woken by a trip, an arming and a disarming, and by nothing else.
#[test]
fn control_hears_of_each_change() {
    let mut bench = Bench::armed();
    let told = |bench: &Bench| bench.shared.make_safe.try_take().is_some();
    assert!(told(&bench));
    bench.advance(MS * 10);
    assert!(!told(&bench));
    bench.dead_man.set(false);
    bench.settle();
    assert!(told(&bench));
    bench.shared.trip(Cause::HostStop);
    bench.settle();
    assert!(!told(&bench), "it is safe already");
    bench.dead_man.set(true);
    bench.advance(HELD_FOR);
    assert_eq!(bench.shared.request(Event::Clear), Ok(()));
    assert!(told(&bench));
}

/// For every set of causes that the supervisor detects, with each cause of the control loop, in every state and at
/// every event: exactly those causes are present, and the state is the pure machine's.
#[test]
fn all_causes_together_are_what_each_is_alone() {
    const WATCHED: [Cause; 5] =
        [Cause::DeadMan, Cause::AuxiliaryStop, Cause::LinkLost, Cause::ControlOverrun, Cause::Proximity];
    let by_control = || Cause::ALL.map(Causes::only).into_iter().chain([Causes::NONE]);
    let states = [Safety::Disarmed, Safety::Armed, Safety::Tripped { causes: Causes::only(Cause::Stalled) }];
    let events = [Event::Tick, Event::Arm, Event::Disarm, Event::Clear, Event::Trip(Causes::only(Cause::HostStop))];
    for set in 0u16..1 << WATCHED.len() {
        let holds = |cause| WATCHED.iter().position(|watched| *watched == cause).is_some_and(|bit| set & 1 << bit != 0);
        let mut bench = Bench::new();
        let session = bench.shared.as_host().open_session(LINK, Instant::now()).expect("nobody else is here");
        bench.dead_man.set(!holds(Cause::DeadMan));
        bench.auxiliary_stop.set(!holds(Cause::AuxiliaryStop));
        let now = Instant::now();
        let long_ago = now - MS * 150;
        let heard = if holds(Cause::LinkLost) { long_ago } else { now };
        assert!(bench.shared.as_host().heartbeat(LINK, session, heard));
        bench.shared.as_control().control_tick(if holds(Cause::ControlOverrun) { long_ago } else { now });
        let reading = RangeReading { stop: holds(Cause::Proximity), updated: now, ..RangeReading::NONE };
        bench.shared.publish_range(0, reading);
        for (control, before) in by_control().flat_map(|control| states.map(|before| (control, before))) {
            for event in events {
                bench.shared.set_safety(before);
                bench.shared.as_control().set_control_causes(control);
                bench.shared.supervisor.signal(());
                bench.settle();
                let watched = WATCHED.into_iter().filter(|cause| holds(*cause)).map(Causes::only);
                let present = watched.fold(control, Causes::union);
                let (looked, _) = before.next(Event::Tick, present);
                assert_eq!(bench.tripped_by(), looked.causes());
                let (expected, answer) = looked.next(event, present);
                assert_eq!(bench.shared.request(event), answer);
                bench.settle();
                assert_eq!((bench.state(), bench.tripped_by()), (expected.state(), expected.causes()));
            }
        }
    }
}

/// Braking time of the longest stop.
const BRAKE: Duration = Duration::from_millis(450);
/// Time in which the brakes must be written.
const WRITTEN: Duration = Duration::from_millis(5);

impl Bench {
    /// Armed bench with stops that brake.
    fn braking() -> Self {
        let mut config = robot("every-interface");
        config.ranges.truncate(1);
        // The longest braking time of all counts.
        config.motors[0].stop_brake_ms = 300;
        config.steppers[0].stop_brake_ms = BRAKE.as_millis() as u16;
        assert_eq!(Duration::from_millis(config.stop_brake_ms().into()), BRAKE);
        let mut bench = Self::with(config, ResetCause::Normal);
        bench.tasks.advance(Duration::from_millis(3));
        bench.shared.publish_range(0, RangeReading { updated: Instant::now(), ..RangeReading::NONE });
        bench.arm();
        bench
    }

    fn lines_are(&self, high: bool) -> bool {
        (self.osmc_disable.level(), self.pwm_output_disable.level()) == (high, high)
    }
}

/// The deadline is the supervisor's own: the control loop only reports that the brakes are written.
#[test]
fn the_lines_follow_at_the_deadline_whatever_the_control_loop_does() {
    for (written, limit) in [(false, WRITTEN), (true, BRAKE)] {
        for stop in [Event::Trip(Causes::only(Cause::HostStop)), Event::Disarm] {
            let mut bench = Bench::braking();
            let from = Instant::now();
            assert_eq!(bench.shared.request(stop), Ok(()));
            bench.tasks.settle();
            assert!(bench.shared.safety().braking && bench.lines_are(false));
            if written {
                bench.shared.as_control().brakes_written(bench.shared.safety().epoch);
            }
            bench.shared.make_safe.reset();
            bench.tasks.advance_to(from + limit - US);
            assert!(bench.lines_are(false), "{stop:?}, written: {written}");
            // The supervisor's next pass.
            bench.tasks.advance_to(from + limit + MS);
            assert!(bench.lines_are(true), "{stop:?}, written: {written}");
            assert!(bench.shared.make_safe.signaled(), "the control loop makes safe now");
            assert!(!bench.shared.safety().braking);
        }
    }
}

/// Every cause that removes the power also does so while a stop brakes; the others do not.
#[test]
fn a_cause_that_forbids_braking_ends_it_at_once() {
    for cause in Cause::ALL {
        let mut bench = Bench::braking();
        assert_eq!(bench.shared.request(Event::Disarm), Ok(()));
        bench.shared.as_control().brakes_written(bench.shared.safety().epoch);
        bench.tasks.advance(20 * MS);
        assert!(bench.lines_are(false));
        bench.shared.trip(cause);
        bench.tasks.settle();
        assert_eq!(bench.lines_are(false), Causes::only(cause).allow_braking(), "{cause}");
    }
}

/// Brakes written for one arming do not count for the next.
#[test]
fn brakes_of_an_earlier_arming_do_not_count() {
    let mut bench = Bench::braking();
    let before = bench.shared.safety().epoch;
    assert_eq!(bench.shared.request(Event::Disarm), Ok(()));
    assert_eq!(bench.shared.request(Event::Arm), Ok(()));
    assert!(!bench.shared.safety().braking, "armed");
    assert_eq!(bench.shared.request(Event::Disarm), Ok(()));
    bench.shared.as_control().brakes_written(before);
    bench.tasks.advance(WRITTEN + MS);
    assert!(bench.lines_are(true));
}
