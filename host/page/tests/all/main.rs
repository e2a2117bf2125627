//! The page of a simulated board behind a broker, with browsers and drivers as clients. All time is virtual.

#[path = "../../../../tests/xtask/src/browser.rs"]
mod browser;
#[path = "../../../driver/tests/all/simulated/mod.rs"]
mod simulated;

mod chromium;
mod devtools;
mod tab;

use std::{cell::RefCell, pin::pin};

use futures::{
    StreamExt,
    channel::mpsc::{UnboundedSender, unbounded},
    future::{Either, join, select},
};
use r4_broker::Broker;
use r4_driver::{Board, Error, with_board};
use r4_page::{
    Denied, FAREWELL_S, Facts, Guard, Kind, Left, MOST_BROWSERS, Page, STALE_MS, Token,
    http::{HttpError, MOST_HEAD},
    socket::{MOST_MESSAGE, SocketError},
};
use r4_protocol::{Mode, Refusal, SafetyState, Setpoint};
use r4_sim::{Pace, SimBoard, Simulation, link::serial};
use serde_json::Value;
use simulated::VirtualClock;
use tab::{Connection, HOST, Receiver, Sender, Tab, connection, upgrade};
use tungstenite::Message;

/// Link time-out of the built-in boards, ms.
const LINK_TIMEOUT_MS: u64 = 200;
/// Delay of a link between a driver and the broker: about that of USB at full speed.
const BAUD: u32 = 12_000_000;

/// Connects browsers and drivers to a board.
struct Door<'d, 'b> {
    clock: VirtualClock,
    browsers: UnboundedSender<(Receiver, Sender)>,
    broker: &'d Broker<'b, VirtualClock>,
    board: &'d Board<VirtualClock>,
    token: String,
    page: &'d Page<'d, 'b, VirtualClock>,
    left: &'d RefCell<Vec<Left>>,
}

impl Door<'_, '_> {
    fn connect(&self) -> Connection {
        let (here, rx, tx) = connection(self.clock.clone());
        self.browsers.unbounded_send((rx, tx)).expect("served");
        here
    }

    /// Returns the answer to these bytes.
    async fn fetched(&self, request: &str) -> String {
        let mut connection = self.connect();
        connection.send(request.as_bytes()).await;
        connection.answer().await
    }

    /// Runs `work` as a program that is connected to the broker.
    async fn driver<T>(&self, work: impl AsyncFnOnce(&Board<VirtualClock>) -> T) -> T {
        let (here, there) = serial(&self.clock.0, BAUD);
        let client = with_board(here.rx, here.tx, self.clock.clone(), work);
        match select(pin!(client), pin!(self.broker.client(there.rx, there.tx))).await {
            Either::Left((result, _)) => result.expect("a session with the broker"),
            Either::Right((left, _)) => panic!("{left:?}"),
        }
    }

    /// Returns the end of the only connection that has ended.
    fn left(&self) -> Left {
        let mut left = self.left.borrow_mut();
        assert!(left.len() == 1, "{left:?}");
        left.remove(0)
    }
}

fn token() -> Token {
    Token::new([0x5a; 32])
}

/// Runs `work` beside the page of a robot's board.
fn served(robot: &str, guard: &Guard, work: impl AsyncFnOnce(&Door<'_, '_>)) {
    let mut simulation = Simulation::new(Pace::Free);
    let robot = r4_boards::load(robot).expect("built in");
    let board = SimBoard::start(&mut simulation, &robot, 1).expect("the robot has a world");
    let port = board.connect().expect("nobody is connected yet");
    let clock = VirtualClock(simulation.clock());
    let facts = Facts { address: "sim:test".into(), kind: Kind::Simulated, footprint: r4_rig::Footprint::of(&robot) };
    let session = with_board(port.rx, port.tx, clock.clone(), async |board| {
        let broker = Broker::new(board);
        let page = Page::new(&broker, clock.clone(), &facts, guard);
        let (browsers, comers) = unbounded();
        let left = RefCell::default();
        let door = Door {
            clock: clock.clone(),
            browsers,
            broker: &broker,
            board,
            token: token().hex(),
            page: &page,
            left: &left,
        };
        let serving = comers.for_each_concurrent(None, |(rx, tx)| async {
            let how = page.serve(rx, tx).await;
            left.borrow_mut().push(how);
        });
        match select(pin!(work(&door)), pin!(join(broker.run(), serving))).await {
            Either::Left(((), _)) => {}
            Either::Right(((error, ()), _)) => panic!("{error}"),
        }
    });
    simulation.block_on(session).expect("time goes on").expect("a session with the board");
}

/// The same on the bench, for this machine alone.
fn bench(work: impl AsyncFnOnce(&Door<'_, '_>)) {
    served("osmc-bench", &Guard::of_this_machine(token()), work);
}

fn get(host: &str) -> String {
    format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n")
}

fn stop(origin: &str, token: &str) -> String {
    format!(
        "POST /stop HTTP/1.1\r\nHost: {HOST}\r\nOrigin: {origin}\r\nX-R4-Token: {token}\r\nContent-Length: 0\r\n\r\n"
    )
}

#[test]
fn the_page_has_its_token_for_this_machine_only() {
    bench(async |door| {
        let page = door.fetched(&get(HOST)).await;
        assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.contains("frame-ancestors 'none'"), "{page}");
        assert!(page.contains(&format!("name=\"r4-token\" content=\"{}\"", door.token)) && !page.contains("<!--"));
        assert!(matches!(door.left(), Left::Answered));
        // A name of another site that resolves to this machine.
        let rebound = door.fetched(&get("evil.example")).await;
        assert!(rebound.starts_with("HTTP/1.1 403 ") && !rebound.contains(&door.token), "{rebound}");
        assert!(matches!(door.left(), Left::Denied(Denied::ForeignHost { host }) if host == "evil.example"));
    });
}

#[test]
fn with_a_key_the_page_has_no_token() {
    served("osmc-bench", &Guard::with_key(token()), async |door| {
        let page = door.fetched(&get("robot.local")).await;
        assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && !page.contains(&door.token));
        let mut tab = Tab::open(door).await;
        assert_eq!(tab.order("arm").await, None);
    });
}

#[test]
fn pages_of_other_sites_are_turned_away() {
    bench(async |door| {
        let evil = "http://evil.example";
        let is_foreign = |left| matches!(left, Left::Denied(Denied::ForeignOrigin { origin }) if origin == evil);
        let answer = door.fetched(&upgrade(HOST, evil)).await;
        assert!(answer.starts_with("HTTP/1.1 403 ") && is_foreign(door.left()), "{answer}");
        let answer = door.fetched(&stop(evil, &door.token)).await;
        assert!(answer.starts_with("HTTP/1.1 403 ") && is_foreign(door.left()), "{answer}");
        // Neither is this machine's own page without the token.
        let own = format!("http://{HOST}");
        for wrong in ["", "5a", &"00".repeat(32)] {
            let answer = door.fetched(&stop(&own, wrong)).await;
            assert!(answer.starts_with("HTTP/1.1 403 "), "{answer}");
            assert!(matches!(door.left(), Left::Denied(Denied::WrongToken)));
            let mut tab = Tab::with_token(door, wrong).await;
            tab.listen(0.2, false).await;
            assert!(
                tab.said[0]["refused"]["why"].as_str().is_some_and(|why| why.contains("r4 serve")),
                "{:?}",
                tab.said
            );
            assert!(matches!(door.left(), Left::Denied(Denied::WrongToken)) && tab.board.is_null());
        }
        assert_eq!(door.board.safety().0, SafetyState::Disarmed);
    });
}

#[test]
fn what_is_no_request_ends_the_connection() {
    bench(async |door| {
        let cases = [
            (format!("GET / HTTP/1.1\r\nA: {}", "b".repeat(MOST_HEAD)), "400"),
            ("hello\r\n\r\n".into(), "400"),
            (format!("GET /other HTTP/1.1\r\nHost: {HOST}\r\n\r\n"), "404"),
            (format!("DELETE / HTTP/1.1\r\nHost: {HOST}\r\n\r\n"), "405"),
            (format!("GET /socket HTTP/1.1\r\nHost: {HOST}\r\nOrigin: http://{HOST}\r\n\r\n"), "400"),
        ];
        for (request, status) in cases {
            let answer = door.fetched(&request).await;
            assert_eq!(answer.split(' ').nth(1), Some(status), "{answer}");
            match door.left() {
                Left::Malformed(HttpError::TooLong) => assert!(request.len() > MOST_HEAD),
                Left::Malformed(HttpError::Malformed(_)) => assert_eq!(request, "hello\r\n\r\n"),
                left => assert!(matches!(left, Left::Answered), "{left:?}"),
            }
        }
        // Nothing at all.
        let _silent = door.connect();
        door.board.sleep_s(5.1).await;
        assert!(matches!(door.left(), Left::Silent));
    });
}

#[test]
fn what_the_page_does_not_say_ends_its_socket() {
    let longest = || Message::text("x".repeat(MOST_MESSAGE + 1));
    let is_too_long = |left: &Left| matches!(left, Left::Broken(SocketError::TooLong(_)));
    let is_no_text = |left: &Left| matches!(left, Left::Broken(SocketError::NoText));
    let is_unknown = |left: &Left| matches!(left, Left::Unknown);
    type Case<'c> = (Message, &'c dyn Fn(&Left) -> bool);
    let cases: [Case<'_>; 4] = [
        (longest(), &is_too_long),
        (Message::binary(vec![1, 2, 3]), &is_no_text),
        (Message::text("{\"ask\":\"dance\"}"), &is_unknown),
        (Message::text(format!("{{\"hello\":{{\"token\":\"{}\"}}}}", token().hex())), &is_unknown),
    ];
    bench(async |door| {
        for (message, is_expected) in cases {
            let mut tab = Tab::open(door).await;
            tab.message(message.clone()).await;
            door.board.sleep_s(0.01).await;
            let left = door.left();
            assert!(is_expected(&left), "{left:?} after {message:?}");
        }
        // Before its token, nothing else.
        let mut tab = Tab::with_token(door, "5a").await;
        tab.listen(0.1, false).await;
        assert!(matches!(door.left(), Left::Denied(Denied::WrongToken)));
    });
}

#[test]
fn the_page_shows_what_the_board_is_and_does() {
    bench(async |door| {
        let mut tab = Tab::open(door).await;
        assert_eq!((tab.board["robot"].as_str(), tab.board["kind"].as_str()), (Some("osmc-bench"), Some("simulated")));
        assert!(tab.board["shape"].is_null() && tab.look["place"].is_null(), "a bench does not drive");
        let channels = tab.board["channels"].as_array().expect("a list").clone();
        let motor = channels.iter().position(|channel| channel["name"] == "osmc0").expect("the bench's motor");
        assert_eq!(channels[motor]["series"][0]["unit"], "deg");
        assert_eq!((tab.state(), tab.look["next"].as_str()), ("disarmed", Some("outputs are safe")));
        let moved = door.driver(async |driver| {
            driver.arm().await?;
            driver.set("osmc0".parse().expect("a channel"), Setpoint { mode: Mode::Position, value: 1.0 }).await?;
            driver.sleep_s(2.0).await;
            driver.disarm().await
        });
        let seen = async {
            let is_there = |values: &Value| {
                let values = values.as_array().into_iter().flatten().find(|values| values["at"] == motor)?;
                // 1 rad, within the 0.01 rad in which the bench's motor rests.
                (values["numbers"][0].as_f64()? - 1f64.to_degrees()).abs().le(&0.6).then(|| values["follows"].clone())
            };
            tab.until("at 1 rad", |tab| is_there(&tab.look["values"]).is_some()).await;
            assert_eq!(tab.look["commands"], "another program");
            let follows = is_there(&tab.look["values"]).expect("seen");
            assert!(follows.as_str().is_some_and(|follows| follows.starts_with("position 57.30 deg")), "{follows}");
            tab.listen(1.2, true).await;
            tab.said.clone()
        };
        let (moved, said) = join(moved, seen).await;
        moved.expect("moved");
        let counters = said.iter().find(|said| said["counters"].is_array()).expect("counters");
        assert!(counters["counters"][0]["value"].as_str().is_some_and(|value| value.ends_with(" ms")), "{counters}");
    });
}

/// A tab that dies at moments between its beats: the board trips by itself, in the time of its link time-out, and others may go on.
#[test]
fn a_tab_that_stops_beating_trips_the_board() {
    for moment in 0..10 {
        bench(async |door| {
            let mut tab = Tab::open(door).await;
            assert_eq!(tab.order("arm").await, None);
            tab.until("armed", |tab| tab.state() == "armed").await;
            tab.listen(1.0 + 0.005 * f64::from(moment), true).await;
            assert_eq!((tab.state(), tab.look["commands"].as_str()), ("armed", Some("this page")));
            // Its last beat was up to 50 ms ago.
            let died_us = door.board.host_now_us();
            while door.board.safety().0 == SafetyState::Armed {
                door.board.sleep_s(0.002).await;
                // What keeps the broker's own view of the board fresh is the telemetry that the tab still receives.
                assert!(door.board.host_now_us() < died_us + 1_000_000, "still armed");
            }
            let after_ms = (door.board.host_now_us() - died_us) / 1000;
            // The beat before, the program's looks of 50 ms and the supervisor's own.
            assert!((LINK_TIMEOUT_MS - 55..=LINK_TIMEOUT_MS + 60).contains(&after_ms), "{after_ms} ms");
            tab.listen(0.2, false).await;
            assert_eq!((tab.state(), tab.causes()), ("tripped", vec!["link lost"]));
            // The tab comes back, clears, and arms again.
            tab.listen(1.5, true).await;
            assert_eq!(tab.order("clear").await, None);
            assert_eq!(tab.order("arm").await, None);
        });
    }
}

/// The same by a connection that the operating system closes, as it does for a browser that is killed.
#[test]
fn a_tab_that_is_gone_trips_the_board() {
    bench(async |door| {
        let mut tab = Tab::open(door).await;
        assert_eq!(tab.order("arm").await, None);
        tab.listen(0.5, true).await;
        let mut other = Tab::open(door).await;
        assert_eq!(other.state(), "armed");
        tab.connection.close().await;
        other.listen(0.4, true).await;
        assert_eq!((other.state(), other.causes()), ("tripped", vec!["link lost"]));
        assert!(matches!(door.left(), Left::Gone));
        // And no client commands any more.
        other.listen(0.5, true).await;
        assert_eq!(other.look["commands"], Value::Null);
        assert_eq!(other.order("clear").await, None);
    });
}

/// A page whose beats come through, and which sees nothing of the board any more.
#[test]
fn a_page_that_sees_old_looks_keeps_nothing_armed() {
    bench(async |door| {
        let mut tab = Tab::open(door).await;
        assert_eq!(tab.order("arm").await, None);
        tab.until("armed", |tab| tab.state() == "armed").await;
        let seen = tab.look["tick_ms"].clone();
        let frozen_us = door.board.host_now_us();
        while door.board.safety().0 == SafetyState::Armed {
            tab.say(&serde_json::json!({ "beat": { "tick_ms": seen } })).await;
            tab.listen(0.05, false).await;
            assert!(door.board.host_now_us() < frozen_us + 3_000_000, "still armed");
        }
        let after_ms = (door.board.host_now_us() - frozen_us) / 1000;
        assert!((STALE_MS..=STALE_MS + LINK_TIMEOUT_MS + 150).contains(&after_ms), "{after_ms} ms");
        // A beat that has seen the future has seen nothing.
        tab.listen(1.5, true).await;
        assert_eq!(tab.order("clear").await, None);
        tab.say(&serde_json::json!({ "ask": "arm" })).await;
        for _ in 0..20 {
            tab.say(&serde_json::json!({ "beat": { "tick_ms": u64::MAX } })).await;
            tab.listen(0.05, false).await;
        }
        assert_ne!(tab.state(), "armed");
    });
}

#[test]
fn a_stop_is_taken_from_any_page() {
    bench(async |door| {
        let mut commanding = Tab::open(door).await;
        let mut watching = Tab::open(door).await;
        let own = format!("http://{HOST}");
        for way in 0..3 {
            assert_eq!(commanding.order("arm").await, None);
            commanding.until("armed", |tab| tab.state() == "armed").await;
            match way {
                // A page that does not beat stops all the same.
                0 => watching.ask("stop").await,
                1 => commanding.ask("stop").await,
                // A page whose socket is gone.
                _ => assert!(door.fetched(&stop(&own, &door.token)).await.starts_with("HTTP/1.1 200 ")),
            }
            commanding.until("tripped", |tab| tab.state() == "tripped").await;
            assert_eq!(commanding.causes(), ["host stop"], "{way}");
            commanding.until("let go", |tab| tab.look["commands"].is_null()).await;
            watching.listen(0.1, false).await;
            assert_eq!(watching.state(), "tripped");
            assert_eq!(commanding.order("clear").await, None);
            commanding.until("disarmed", |tab| tab.state() == "disarmed").await;
        }
    });
}

#[test]
fn a_refusal_says_what_to_do() {
    bench(async |door| {
        let mut tab = Tab::open(door).await;
        assert_eq!(tab.order("stop").await, None);
        tab.until("tripped", |tab| tab.state() == "tripped").await;
        let why = tab.order("arm").await.expect("refused");
        assert!(why.contains("host stop") && why.contains("clear it first"), "{why}");
        assert_eq!(tab.state(), "tripped");
        assert_eq!(tab.order("clear").await, None);
        assert_eq!(tab.order("disarm").await, None, "a board that is disarmed already");
        assert_eq!(door.board.stats().await.expect("answered").refused, 1);
    });
}

#[test]
fn a_page_commands_while_it_is_armed_and_no_longer() {
    bench(async |door| {
        let mut tab = Tab::open(door).await;
        assert_eq!(tab.order("arm").await, None);
        tab.until("armed", |tab| tab.state() == "armed").await;
        let (refused, ()) = join(door.driver(async |driver| driver.arm().await), tab.listen(0.3, true)).await;
        assert_eq!(refused, Err(Error::Refused(Refusal::InUse)));
        assert_eq!(tab.order("disarm").await, None);
        tab.until("let go", |tab| tab.look["commands"].is_null()).await;
        door.driver(async |driver| {
            driver.arm().await.expect("nobody commands");
            for order in ["arm", "disarm", "clear"] {
                let why = tab.order(order).await.expect("refused");
                assert!(why.contains("another host commands"), "{order}: {why}");
            }
            // Its next heartbeat.
            driver.sleep_s(0.1).await;
            assert_eq!(driver.safety().0, SafetyState::Armed);
            assert_eq!(tab.order("stop").await, None);
        })
        .await;
    });
}

#[test]
fn a_page_is_told_why_the_link_is_lost() {
    bench(async |door| {
        let mut tab = Tab::open(door).await;
        door.page.lose("the cable was pulled".into());
        tab.listen(FAREWELL_S, false).await;
        assert_eq!(tab.said.last().expect("a farewell")["lost"]["why"], "the cable was pulled");
    });
}

#[test]
fn a_page_that_does_not_read_is_let_go() {
    bench(async |door| {
        let mut tab = Tab::open(door).await;
        for _ in 0..300 {
            tab.beat().await;
            door.board.sleep_s(0.05).await;
        }
        assert!(matches!(door.left(), Left::Slow));
    });
}

#[test]
fn a_page_that_says_nothing_is_let_go() {
    bench(async |door| {
        let mut tab = Tab::open(door).await;
        tab.listen(9.9, false).await;
        assert!(door.left.borrow().is_empty());
        tab.listen(0.3, false).await;
        assert!(matches!(door.left(), Left::Silent));
    });
}

#[test]
fn there_are_so_many_pages_and_no_more() {
    bench(async |door| {
        let mut tabs = Vec::new();
        for _ in 0..MOST_BROWSERS {
            tabs.push(Tab::open(door).await);
        }
        let answer = door.fetched(&upgrade(HOST, &format!("http://{HOST}"))).await;
        assert!(answer.starts_with("HTTP/1.1 503 "), "{answer}");
        assert!(matches!(door.left(), Left::Full));
        let mut first = tabs.remove(0);
        first.connection.close().await;
        door.board.sleep_s(0.01).await;
        assert!(matches!(door.left(), Left::Gone));
        Tab::open(door).await;
    });
}

#[test]
fn a_robot_that_drives_is_seen_on_the_floor() {
    served("openscout", &Guard::of_this_machine(token()), async |door| {
        let mut tab = Tab::open(door).await;
        assert_eq!(tab.board["shape"]["outline_m"].as_array().map(Vec::len), Some(4));
        let drives = door.driver(async |driver| {
            driver.arm().await?;
            driver.sleep_s(0.1).await;
            for wheel in ["dhb0", "dhb1", "dhb2", "dhb3"] {
                let setpoint = Setpoint { mode: Mode::Position, value: 10.0 };
                driver.set(wheel.parse().expect("a channel"), setpoint).await?;
            }
            driver.sleep_s(3.0).await;
            driver.disarm().await
        });
        let (driven, ()) = join(drives, tab.listen(3.5, true)).await;
        driven.expect("driven");
        tab.until("a place", |tab| tab.look["place"].is_object()).await;
        let place = &tab.look["place"];
        // Wheels of 56 mm, 10 rad: as far as their settling within 0.005 rad shows, and what start and stop make of four of them.
        let (x_m, y_m) = (place["x_m"].as_f64().expect("a number"), place["y_m"].as_f64().expect("a number"));
        assert!((x_m - 0.56).abs() < 0.01 && y_m.abs() < 0.01, "{place}");
    });
}
