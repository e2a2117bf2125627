//! The page in headless Chromium, in real time. Without Chromium the test says that it did not run; with R4_CHROMIUM_REQUIRED=1 that is an
//! error. Pictures of the page are in cargo's folder for tests, `page/*.png`, to be looked at.

use std::{
    env, fs,
    future::poll_fn,
    io::{self, Write},
    net::TcpListener,
    path::{Path, PathBuf},
    pin::{Pin, pin},
    rc::Rc,
    sync::mpsc,
    task::Poll,
    thread::{self, JoinHandle},
};

use async_io::Async;
use embassy_sync::{blocking_mutex::raw::NoopRawMutex, pipe::Pipe};
use futures::{
    Stream as _, StreamExt,
    channel::mpsc::{UnboundedReceiver, UnboundedSender, unbounded},
    future::{join3, select},
    stream::FuturesUnordered,
};
use r4_broker::Broker;
use r4_driver::with_board;
use r4_links::{Accepted, Listener};
use r4_page::{Facts, Guard, Kind, Page};
use r4_protocol::{ChannelId, ChannelKind, Mode, Setpoint};
use r4_rig::{Error, HostClock, Interrupt, Pace, Rig, Session};
use serde_json::Value;

use crate::{
    devtools::{Browser, Screen, Tab},
    token,
};

/// Set to 1 where a machine without Chromium is an error: in CI.
const REQUIRED: &str = "R4_CHROMIUM_REQUIRED";
const DESKTOP: Screen = Screen { width: 1280, height: 800, is_phone: false, is_dark: false };
const PHONE: Screen = Screen { width: 390, height: 844, is_phone: true, is_dark: true };
/// Link time-out of the board, ms. A browser on a busy machine may be late by more than the 200 ms of the robot's file; what happens
/// within these is tested in virtual time, in `main.rs`.
const LINK_TIMEOUT_MS: u16 = 1000;

/// Wheels of openscout, left and right, with speeds of a curve, rad/s.
const WHEELS: [(u8, f32); 4] = [(0, 4.0), (2, 4.0), (1, 7.0), (3, 7.0)];

/// A served openscout on an empty floor, in real time, on a thread of its own until it is dropped.
struct Served {
    http: String,
    /// Work of another program: it arms and drives with the first share of its speeds, changes to the second, and leaves.
    drive: UnboundedSender<f32>,
    interrupt: Interrupt,
    thread: Option<JoinHandle<()>>,
}

impl Served {
    fn new(guard: Guard) -> Self {
        let (interrupt, (drive, shares), (told, address)) = (Interrupt::default(), unbounded(), mpsc::channel());
        let thread = thread::spawn({
            let interrupt = interrupt.clone();
            move || {
                let mut rig = Rig::new("sim:openscout".parse().expect("a board"));
                (rig.pace, rig.interrupt) = (Pace::RealTime(1.0), interrupt);
                rig.alter = Some(Rc::new(|robot| robot.config.link_timeout_ms = LINK_TIMEOUT_MS));
                let ended = rig.run(None, async |session| {
                    let socket = Async::<TcpListener>::bind(([127, 0, 0, 1], 0)).expect("a port that is free");
                    let at = socket.get_ref().local_addr().expect("bound");
                    told.send(format!("http://{at}/")).expect("waited for");
                    serve(session, Listener::new(socket, None), &guard, shares).await;
                    Ok::<_, Error>(())
                });
                assert!(matches!(ended, Err(Error::Interrupted(_))), "{:?}", ended.err());
            }
        });
        Self { http: address.recv().expect("served"), drive, interrupt, thread: Some(thread) }
    }

    fn drives(&self, share: f32) {
        self.drive.unbounded_send(share).expect("served");
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.interrupt.set();
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(thread::panicking() || matches!(ended, Some(Ok(()))), "the board failed");
    }
}

async fn serve(session: &Session<'_>, mut listener: Listener, guard: &Guard, shares: UnboundedReceiver<f32>) {
    let footprint = session.robot().as_ref().and_then(r4_rig::Footprint::of);
    let facts = Facts { address: session.target().to_string(), kind: Kind::Simulated, footprint };
    let broker = Broker::new(session.board);
    let page = Page::new(&broker, session.clock.clone(), &facts, guard);
    let mut browsers = FuturesUnordered::new();
    let serving = poll_fn(|context| {
        while let Poll::Ready(accepted) = listener.poll_accept(context) {
            if let Accepted::Client(link) = accepted.expect("connections") {
                browsers.push(page.serve(link.rx, link.tx));
            }
        }
        while let Poll::Ready(Some(_)) = Pin::new(&mut browsers).poll_next(context) {}
        Poll::<()>::Pending
    });
    let mut shares = shares;
    join3(serving, broker.run(), drive(&broker, session.clock.clone(), &mut shares)).await;
}

/// Another program, which drives a curve.
async fn drive(broker: &Broker<'_, HostClock>, clock: HostClock, shares: &mut UnboundedReceiver<f32>) {
    let Some(mut share) = shares.next().await else { return };
    let (up, down) = (Pipe::<NoopRawMutex, 4096>::new(), Pipe::<NoopRawMutex, 4096>::new());
    let program = with_board(&down, &up, clock, async |board| {
        board.arm().await.expect("armed");
        while share > 0.0 {
            for (wheel, rad_s) in WHEELS {
                let channel = ChannelId::new(ChannelKind::Dhb, wheel);
                board.set(channel, Setpoint { mode: Mode::Speed, value: share * rad_s }).await.expect("taken");
            }
            share = shares.next().await.unwrap_or(0.0);
        }
        board.disarm().await.expect("disarmed");
    });
    select(Box::pin(program), pin!(broker.client(&up, &down))).await;
}

/// The browser, or why nothing is tested.
fn browser() -> Option<Browser> {
    let browser = Browser::start();
    if browser.is_none() {
        let is_required = env::var_os(REQUIRED).is_some_and(|value| value == "1");
        assert!(!is_required, "{REQUIRED}=1, and there is no Chromium: install it, or name it in CHROMIUM");
        // Past the harness, which keeps to itself what tests that pass have printed.
        let _ = writeln!(io::stderr(), "\n*** NOT RUN: the page is not tested in a browser: no Chromium ***\n");
    }
    browser
}

fn pictures() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("page");
    fs::create_dir_all(&folder).expect("a folder");
    folder
}

impl Browser {
    fn wait(&mut self, tab: &Tab, expression: &str) {
        let is_so = self.is_soon(tab, expression, 30.0);
        let state = self.value(tab, "[document.body.dataset.state, document.body.innerText.slice(0, 400)].join(': ')");
        assert!(is_so, "not {expression}: {state}");
    }

    fn click(&mut self, tab: &Tab, id: &str) {
        self.value(tab, &format!("document.getElementById('{id}').click()"));
    }

    fn photograph(&mut self, tab: &Tab, name: &str) {
        // As drawn after the newest look.
        self.value(tab, "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done())))");
        for (suffix, is_whole) in [("", false), ("-whole", true)] {
            let picture = self.picture(tab, is_whole);
            fs::write(pictures().join(format!("{name}{suffix}.png")), picture).expect("written");
        }
    }

    /// Clears a trip, if there is one, and arms by the page: the relay in the motors' supply closes.
    fn arm(&mut self, tab: &Tab) {
        // A board is free once it is disarmed after the program that commanded it.
        self.wait(tab, "document.getElementById('link').textContent.includes('no program commands')");
        if self.value(tab, "document.body.dataset.state") == "tripped" {
            self.click(tab, "clear");
        }
        self.wait(tab, "!document.getElementById('arm').disabled");
        self.click(tab, "arm");
        self.wait(tab, &format!("{} === 'on'", chip("relay0")));
    }

    /// Nothing is wider than the screen, and what is touched is as large as a finger.
    fn check_layout(&mut self, tab: &Tab) {
        let too_wide = self.value(
            tab,
            "[...document.querySelectorAll('body *')].filter((node) => node.getClientRects().length
               && node.getBoundingClientRect().right > innerWidth + 0.5).map((node) => node.outerHTML.slice(0, 80))",
        );
        assert_eq!(too_wide, Value::Array(Vec::new()));
        let too_small = self.value(
            tab,
            "[...document.querySelectorAll('button')].filter((node) => node.getClientRects().length
               && node.getBoundingClientRect().height < 44).map((node) => node.outerHTML.slice(0, 80))",
        );
        assert_eq!(too_small, Value::Array(Vec::new()));
    }
}

/// Text of a channel's only value on the page.
fn chip(channel: &str) -> String {
    format!("document.querySelector('.chip[title=\"{channel} value\"] span').textContent")
}

const IS_TRIPPED: &str = "document.body.dataset.state === 'tripped'";
const CAUSES: &str = "document.getElementById('causes').textContent";

#[test]
fn a_page_shows_arms_and_stops_a_board() {
    let Some(mut browser) = browser() else { return };
    let served = Served::new(Guard::of_this_machine(token()));
    let tab = browser.open(&served.http, DESKTOP);
    browser.wait(&tab, "document.body.dataset.state === 'disarmed'");
    assert_eq!(browser.value(&tab, "document.getElementById('robot').textContent"), "openscout");
    assert_eq!(browser.value(&tab, "document.getElementById('kind').textContent"), "simulated");
    assert_eq!(browser.value(&tab, &chip("relay0")), "off");

    // Another program drives, and the page watches.
    served.drives(1.0);
    browser.wait(&tab, "document.getElementById('link').textContent.includes('another program commands')");
    browser.wait(&tab, "parseFloat(document.querySelector('.chip[title=\"dhb1 speed\"] span').textContent) > 300");
    browser.wait(&tab, "page.floor.path.length > 60");
    served.drives(0.5);
    browser.wait(&tab, "page.floor.path.length > 100");
    browser.check_layout(&tab);
    browser.photograph(&tab, "desktop-moving");
    browser.show(&tab, Screen { is_dark: true, ..DESKTOP });
    browser.photograph(&tab, "desktop-moving-dark");
    browser.show(&tab, DESKTOP);
    served.drives(0.0);
    browser.wait(&tab, "document.getElementById('link').textContent.includes('no program commands')");

    // The page arms: the relay in the motors' supply closes. A tab that is killed trips the board.
    browser.arm(&tab);
    browser.photograph(&tab, "desktop-armed");
    browser.kill(tab);

    let phone = browser.open(&served.http, PHONE);
    browser.wait(&phone, IS_TRIPPED);
    let causes = browser.value(&phone, CAUSES);
    assert!(causes.as_str().is_some_and(|causes| causes.contains("link lost: keep one host connected")), "{causes}");
    browser.wait(&phone, "document.getElementById('link').textContent.includes('no program commands')");
    browser.check_layout(&phone);
    browser.photograph(&phone, "phone-tripped");

    // By its key, and by its button.
    for way in ["key", "button"] {
        browser.arm(&phone);
        match way {
            "key" => browser.press(&phone, " ", "Space"),
            _ => browser.click(&phone, "stop"),
        }
        browser.wait(
            &phone,
            &format!(
                "{CAUSES}.includes('host stop') && document.getElementById('message').textContent === 'stop: done'"
            ),
        );
        browser.wait(&phone, &format!("{} === 'off'", chip("relay0")));
    }
    browser.show(&phone, Screen { is_dark: false, ..PHONE });
    browser.photograph(&phone, "phone-stopped-light");

    // A stop without a socket.
    browser.arm(&phone);
    browser.value(&phone, "page.socket.close()");
    browser.click(&phone, "stop");
    browser.wait(&phone, "document.getElementById('message').textContent === 'stop: done'");
    browser.wait(&phone, IS_TRIPPED);
    assert_eq!(browser.complaints, Vec::<String>::new());
}

/// With a key the page is nothing without what is behind the # of its address.
#[test]
fn a_page_with_a_key_asks_for_it() {
    let Some(mut browser) = browser() else { return };
    let (served, token) = (Served::new(Guard::with_key(token())), token().hex());
    let tab = browser.open(&served.http, PHONE);
    browser.wait(&tab, "!document.getElementById('key').hidden");
    browser.photograph(&tab, "phone-key");
    browser.value(
        &tab,
        "document.getElementById('token').value = '00'.repeat(32), document.querySelector('#key button').click()",
    );
    browser.wait(&tab, "document.getElementById('why').textContent.includes('not the key')");
    browser.value(
        &tab,
        &format!("document.getElementById('token').value = '{token}', document.querySelector('#key button').click()"),
    );
    browser.wait(&tab, "document.body.dataset.state === 'disarmed'");
    let by_address = browser.open(&format!("{}#{token}", served.http), PHONE);
    browser.wait(&by_address, "document.body.dataset.state === 'disarmed'");
    assert_eq!(browser.value(&by_address, "location.hash"), "");
}
