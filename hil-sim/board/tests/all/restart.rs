//! Restart of the processor, with what it keeps and makes safe, and raw access to the board's connectors.

use std::rc::Rc;

use crate::harness::{self, HostClock, MS, ROTARY, osmc_bench};
use r4_boards::Robot;
use r4_driver::{Board, Error, with_board};
use r4_firmware::ResetCause;
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelKind, Mode, Parameter, ParameterKey, Refusal, SafetyState, Setpoint,
};
use r4_sim::{Clock, Pace, SimBoard, Simulation, VirtualBoard};

/// A board that can be restarted between sessions.
pub(crate) struct Restarts {
    simulation: Simulation,
    pub(crate) board: Rc<SimBoard>,
}

impl Restarts {
    pub(crate) fn new(robot: &Robot) -> Self {
        let mut simulation = Simulation::new(Pace::Free);
        let board = Rc::new(SimBoard::start(&mut simulation, robot, 1).expect("the robot has a world"));
        Self { simulation, board }
    }

    /// Runs one session to its end.
    pub(crate) fn session<T>(&mut self, work: impl AsyncFnOnce(&Board<HostClock>, &SimBoard, &Clock) -> T) -> T {
        let port = self.board.connect().expect("nobody is connected");
        let clock = self.simulation.clock();
        let board = self.board.clone();
        let session =
            with_board(port.rx, port.tx, HostClock(clock.clone()), async |host| work(host, &board, &clock).await);
        self.simulation.block_on(session).expect("time goes on").expect("a session")
    }

    pub(crate) fn restart(&mut self, cause: ResetCause) {
        self.board.restart(&mut self.simulation, cause);
    }

    fn pass_ms(&mut self, ms: u64) {
        let clock = self.simulation.clock();
        self.simulation.block_on(clock.sleep(ms * MS)).expect("time goes on");
    }
}

const KP: ParameterKey = ParameterKey { channel: Some(ROTARY), parameter: Parameter::PositionKp };
const TIMEOUT: ParameterKey = ParameterKey { channel: None, parameter: Parameter::LinkTimeoutMs };

#[test]
fn saved_parameters_hold_from_the_next_start_on() {
    let mut board = Restarts::new(&osmc_bench());
    let find = async |host: &Board<HostClock>, key: ParameterKey| {
        let all = host.parameters().await.expect("they are told");
        all.into_iter().find(|info| info.key == key).expect("it has it")
    };
    board.session(async |host, _, _| {
        let before = find(host, KP).await;
        assert_eq!((before.active, before.set, before.built_in), (4.0, 4.0, 4.0));
        host.set_parameter(KP, 5.5).await.unwrap();
        host.set_parameter(TIMEOUT, 400.0).await.unwrap();
        host.set_name("Ada").await.unwrap();
        let beyond = host.set_parameter(TIMEOUT, 5000.0).await;
        assert!(matches!(beyond, Err(Error::Refused(Refusal::BadParameter { .. }))), "{beyond:?}");
        let unknown = ParameterKey { parameter: Parameter::PulseLow, ..KP };
        let unknown = host.set_parameter(unknown, 1.0).await;
        assert!(matches!(unknown, Err(Error::Refused(Refusal::UnknownParameter { .. }))), "{unknown:?}");
        let changed = find(host, KP).await;
        assert_eq!((changed.active, changed.set, changed.built_in), (4.0, 5.5, 4.0));
    });
    // not saved, so lost
    board.restart(ResetCause::Normal);
    board.session(async |host, _, _| {
        assert_eq!(find(host, KP).await.set, 4.0);
        host.set_parameter(KP, 5.5).await.unwrap();
        host.set_parameter(TIMEOUT, 400.0).await.unwrap();
        host.set_name("Ada").await.unwrap();
        host.arm().await.unwrap();
        let armed = host.save_parameters().await;
        assert!(matches!(armed, Err(Error::Refused(Refusal::NotWhile { .. }))), "{armed:?}");
        host.disarm().await.unwrap();
        host.save_parameters().await.unwrap();
    });
    board.restart(ResetCause::Normal);
    board.session(async |host, _, _| {
        let kept = find(host, KP).await;
        assert_eq!((kept.active, kept.set, kept.built_in), (5.5, 5.5, 4.0));
        assert_eq!((&host.info().robot[..], host.info().link_timeout_ms), ("Ada", 400));
        host.reset_parameters().await.unwrap();
        host.save_parameters().await.unwrap();
    });
    board.restart(ResetCause::Normal);
    board.session(async |host, _, _| {
        assert_eq!(find(host, KP).await.active, 4.0);
        assert_eq!(&host.info().robot[..], "osmc-bench");
    });
}

#[test]
fn trips_are_remembered_with_what_came_before_them() {
    let mut board = Restarts::new(&osmc_bench());
    board.session(async |host, board, clock| {
        assert_eq!(host.faults().await.unwrap(), []);
        host.arm().await.unwrap();
        host.set(ROTARY, Setpoint { mode: Mode::Duty, value: 0.8 }).await.unwrap();
        clock.sleep(1000 * MS).await;
        board.dead_man().set(false);
        clock.sleep(100 * MS).await;
        board.dead_man().set(true);
        clock.sleep(100 * MS).await;
        host.clear().await.unwrap();
        host.stop().await.unwrap();
        clock.sleep(100 * MS).await;
    });
    board.restart(ResetCause::Normal);
    board.session(async |host, _, _| {
        let faults = host.faults().await.unwrap();
        let causes: Vec<_> = faults.iter().map(|fault| fault.causes).collect();
        // newest first
        assert_eq!(causes, [Causes::only(Cause::HostStop), Causes::only(Cause::DeadMan)]);
        assert!(faults[0].number == faults[1].number + 1 && faults[0].device_us > faults[1].device_us, "{faults:?}");
        let moments = host.fault_snapshots(1).await.unwrap();
        assert!(moments.len() == 20 && moments[0].before_ms >= 190, "{moments:?}");
        assert!(moments.is_sorted_by(|a, b| a.before_ms > b.before_ms));
        // it was turning until then
        let motor = moments[19].motors[0];
        assert!(motor.speed > 0.5 && motor.duty > 0.79 && moments[0].motors[0].position < motor.position, "{motor:?}");
        assert!((moments[19].supplies_v[0] - 24.0).abs() < 2.0);
        let none = host.fault_snapshots(2).await;
        assert!(matches!(none, Err(Error::Refused(Refusal::NoSuchFault))), "{none:?}");
    });
}

#[test]
fn the_last_32_trips_are_kept() {
    let mut board = Restarts::new(&osmc_bench());
    board.session(async |host, _, clock| {
        for _ in 0..40 {
            host.stop().await.unwrap();
            clock.sleep(20 * MS).await;
            host.clear().await.unwrap();
        }
        clock.sleep(1000 * MS).await;
        let faults = host.faults().await.unwrap();
        assert_eq!(faults.len(), 32);
        assert_eq!(faults[0].number - faults[31].number, 31);
    });
}

#[test]
fn a_reset_while_driving_ends_safe_and_a_watchdog_s_is_latched() {
    for (cause, trips_by) in [
        (ResetCause::Normal, None),
        (ResetCause::Watchdog, Some(Cause::WatchdogReset)),
        (ResetCause::Clock, Some(Cause::ClockFault)),
    ] {
        let mut board = Restarts::new(&osmc_bench());
        let port = board.board.connect().expect("nobody is connected");
        let clock = board.simulation.clock();
        // the host is still connected when the processor resets
        let drive = async |host: &Board<HostClock>| {
            host.arm().await.unwrap();
            host.set(ROTARY, Setpoint { mode: Mode::Duty, value: 0.8 }).await.unwrap();
            clock.sleep(1000 * MS).await;
            std::future::pending::<()>().await;
        };
        let mut session = Box::pin(with_board(port.rx, port.tx, HostClock(clock.clone()), drive));
        let until = async {
            let sleep = clock.sleep(1500 * MS);
            futures_lite(&mut session, sleep).await;
        };
        board.simulation.block_on(until).expect("time goes on");
        drop(session);
        assert!(board.board.world().speed(ROTARY).unwrap() > 0.5);
        board.restart(cause);
        // the lines float to levels at which nothing moves, before any firmware runs
        assert_eq!(board.board.world().drive(ROTARY).unwrap().coast, 1.0);
        board.pass_ms(100);
        assert_eq!(board.board.world().relay_closed(ChannelId::new(ChannelKind::Relay, 0)), Some(false));
        board.session(async |host, _, _| {
            let expected = trips_by
                .map_or((SafetyState::Disarmed, Causes::NONE), |cause| (SafetyState::Tripped, Causes::only(cause)));
            assert_eq!((host.info().state, host.info().causes), expected);
            if trips_by.is_some() {
                assert!(host.arm().await.is_err());
                host.clear().await.unwrap();
            }
            host.arm().await.unwrap();
        });
        assert_eq!(board.board.world().misuse(), []);
    }
}

/// Polls `work` until `end` is ready.
async fn futures_lite<W: Future + Unpin>(work: &mut W, end: impl Future<Output = ()>) {
    let mut end = Box::pin(end);
    std::future::poll_fn(|context| {
        let _ = std::pin::Pin::new(&mut *work).poll(context);
        end.as_mut().poll(context)
    })
    .await;
}

#[test]
fn a_host_restarts_the_board_unless_it_is_armed() {
    let mut board = Restarts::new(&osmc_bench());
    board.session(async |host, board, clock| {
        host.arm().await.unwrap();
        let armed = host.restart().await;
        assert!(matches!(armed, Err(Error::Refused(Refusal::NotWhile { .. }))), "{armed:?}");
        host.disarm().await.unwrap();
        host.restart().await.unwrap();
        let asked = harness::within(clock, 10 * MS, board.restart_requested()).await;
        assert_eq!(asked, Some(()));
    });
}

#[test]
fn raw_connectors_are_reached_from_the_host() {
    let mut board = Restarts::new(&r4_boards::load("every-interface").expect("built in"));
    board.session(async |host, board, clock| {
        // the memory at the external I2C connectors: a page written and read back
        host.i2c_transfer(0, 0x50, &[0x10, 1, 2, 3], 0).await.unwrap();
        clock.sleep(6 * MS).await;
        assert_eq!(host.i2c_transfer(0, 0x50, &[0x10], 3).await.unwrap(), [1, 2, 3]);
        assert_eq!(board.world().pins().eeprom(0).unwrap().borrow().memory()[0x10..0x13], [1, 2, 3]);
        let nobody = host.i2c_transfer(1, 0x33, &[0], 0).await;
        assert!(matches!(nobody, Err(Error::Refused(Refusal::NoAcknowledge { address: 0x33 }))), "{nobody:?}");
        let beyond = host.i2c_transfer(2, 0x50, &[0], 0).await;
        assert!(matches!(beyond, Err(Error::Refused(Refusal::BadTransfer))), "{beyond:?}");
        // the output of a UART connector is wired to its input
        host.uart_write(1, b"hello").await.unwrap();
        clock.sleep(10 * MS).await;
        assert_eq!(host.uart_read(1).await.unwrap(), b"hello");
        assert_eq!(host.uart_read(0).await.unwrap(), b"");
    });
}

#[test]
fn a_screen_shows_the_state_and_disturbs_nothing() {
    let robot = r4_boards::load("every-interface").expect("built in");
    let mut board = Restarts::new(&robot);
    let screen = board.board.plug_screen(&mut board.simulation);
    let colour = |x, y| screen.screen(|screen| screen.picture().turned().pixel(x, y));
    board.session(async |host, _, clock| {
        clock.sleep(2000 * MS).await;
        assert!(screen.is_lit());
        let disarmed = colour(20, 60);
        host.arm().await.unwrap();
        clock.sleep(500 * MS).await;
        let armed = colour(20, 60);
        host.stop().await.unwrap();
        clock.sleep(500 * MS).await;
        let tripped = colour(20, 60);
        // grey, green, red
        assert!(armed[1] > armed[0] && tripped[0] > tripped[1], "{disarmed:?} {armed:?} {tripped:?}");
        assert_eq!(host.stats().await.unwrap().late_ticks, 0);
    });
    assert_eq!(screen.screen(|screen| screen.misuse().first().len()), 0);
}

#[test]
fn every_robot_comes_up_arms_and_is_driven() {
    for name in r4_boards::names() {
        let robot = r4_boards::load(name).expect("built in");
        let mut board = Restarts::new(&robot);
        board.session(async |host, board, clock| {
            host.arm().await.unwrap_or_else(|error| panic!("{name}: {error}"));
            for motor in &robot.config.motors {
                let limit = motor.duty_max.min(0.7);
                let setpoint = match motor.control {
                    // a tenth of its range from its position
                    Some(control) => {
                        let here = board.world().position(motor.id).expect("a motor") as f32;
                        let room = (control.position.max - control.position.min) / 10.0;
                        let step = room.min(1.0).copysign(control.position.max - here - room);
                        Setpoint { mode: Mode::Position, value: here + step }
                    }
                    None => Setpoint { mode: Mode::Duty, value: limit },
                };
                let from = board.world().position(motor.id).expect("a motor");
                host.set(motor.id, setpoint).await.unwrap_or_else(|error| panic!("{name}: {error}"));
                clock.sleep(3000 * MS).await;
                let moved = board.world().position(motor.id).expect("a motor") - from;
                match setpoint.mode {
                    Mode::Position => {
                        let wanted = f64::from(setpoint.value) - from;
                        // within a twentieth of the distance: gains are a starting point, but the target must be
                        // reached
                        assert!(
                            (moved - wanted).abs() < 0.05 * wanted.abs(),
                            "{name} {}: {moved} of {wanted}",
                            motor.id
                        );
                    }
                    _ => assert!(moved > 0.0, "{name} {}: {moved}", motor.id),
                }
            }
            for bldc in &robot.config.bldcs {
                let from = board.world().position(bldc.id).expect("a drive");
                let turn = |value| host.set(bldc.id, Setpoint { mode: Mode::Duty, value });
                turn(0.1).await.unwrap_or_else(|error| panic!("{name}: {error}"));
                clock.sleep(500 * MS).await;
                let moved = board.world().position(bldc.id).expect("a drive") - from;
                assert!(moved > 0.0, "{name} {}: {moved}", bldc.id);
                turn(0.0).await.unwrap_or_else(|error| panic!("{name}: {error}"));
            }
            // two heartbeats: a robot without motors and drives was armed only now
            clock.sleep(110 * MS).await;
            assert_eq!(host.safety().0, SafetyState::Armed, "{name}: {}", host.safety().1);
            let stats = host.stats().await.unwrap();
            assert_eq!((stats.late_ticks, stats.bus_retries), (0, 0), "{name}");
        });
        assert_eq!(board.board.world().misuse(), [], "{name}");
    }
}

#[test]
fn a_board_starts_with_every_analog_input_broken() {
    let mut board = Restarts::new(&r4_boards::load("every-interface").expect("built in"));
    for source in board.board.world().pins().analogs[..4].iter_mut().flatten() {
        source.input.fault = Some(r4_sim::sensors::analog_input::AnalogFault::ShortToGround);
    }
    board.session(async |host, _, _| host.arm().await.expect("a broken input is told, and stops nothing"));
}

#[test]
fn a_reset_leaves_the_direction_of_a_drive_that_still_turns() {
    let bldc0 = ChannelId::new(ChannelKind::Bldc, 0);
    let mut board = Restarts::new(&r4_boards::load("every-interface").expect("built in"));
    board.session(async |host, board, clock| {
        host.arm().await.unwrap();
        clock.sleep(60 * MS).await;
        host.set(bldc0, Setpoint { mode: Mode::Duty, value: -0.8 }).await.unwrap();
        clock.sleep(6000 * MS).await;
        assert!(board.world().speed(bldc0).unwrap() < -20.0);
    });
    board.restart(ResetCause::Watchdog);
    board.pass_ms(300);
    assert!(board.board.world().speed(bldc0).unwrap() < -1.0, "it still turns");
    board.session(async |host, _, clock| {
        host.clear().await.unwrap();
        host.arm().await.unwrap();
        clock.sleep(60 * MS).await;
        // the opposite direction: only after a rest at neutral
        host.set(bldc0, Setpoint { mode: Mode::Duty, value: 0.8 }).await.unwrap();
        clock.sleep(7000 * MS).await;
    });
    assert_eq!(board.board.world().misuse(), []);
}
