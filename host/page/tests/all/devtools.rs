//! Headless Chromium by its DevTools protocol: JSON over two pipes, each message with a 0 behind it.

use std::{
    io::{BufRead, BufReader, Write},
    process::{Child, ChildStdin, Command, Stdio},
    sync::mpsc::{Receiver, channel},
    thread,
    time::{Duration, Instant},
};

use data_encoding::BASE64;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::browser::chromium;

/// A browser that has not answered by then hangs.
const PATIENCE: Duration = Duration::from_secs(60);

/// A started browser; ended when dropped.
pub(crate) struct Browser {
    child: Child,
    to: ChildStdin,
    from: Receiver<Value>,
    next_id: u64,
    /// True once the page that was opened last is loaded.
    has_loaded: bool,
    /// Complaints of pages: exceptions, and what the browser has logged.
    pub(crate) complaints: Vec<String>,
    _profile: TempDir,
}

/// A tab, by the session that steers it.
pub(crate) struct Tab {
    target: String,
    session: String,
}

/// Screen of a tab.
#[derive(Clone, Copy)]
pub(crate) struct Screen {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) is_phone: bool,
    pub(crate) is_dark: bool,
}

impl Browser {
    /// Starts Chromium; `None` on a machine without it.
    pub(crate) fn start() -> Option<Self> {
        let program = chromium().ok()?;
        let profile = TempDir::new().expect("a folder");
        let mut command = Command::new("sh");
        // Chromium listens on descriptor 3, and speaks on 4.
        command
            .args(["-c", "exec \"$0\" \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>/dev/null"])
            .arg(program)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-quic",
                "--no-first-run",
                "--hide-scrollbars",
            ])
            .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
            .args(["--remote-debugging-pipe", &format!("--user-data-dir={}", profile.path().display())])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        let mut child = command.spawn().ok()?;
        let (to, out) = (child.stdin.take().expect("piped"), child.stdout.take().expect("piped"));
        let (sender, from) = channel();
        thread::spawn(move || {
            for message in BufReader::new(out).split(0).map_while(Result::ok) {
                if sender.send(serde_json::from_slice(&message).expect("JSON")).is_err() {
                    break;
                }
            }
        });
        Some(Self { child, to, from, next_id: 0, has_loaded: false, complaints: Vec::new(), _profile: profile })
    }

    fn call(&mut self, session: Option<&str>, method: &str, parameters: Value) -> Value {
        self.next_id += 1;
        let mut message = json!({ "id": self.next_id, "method": method, "params": parameters });
        if let Some(session) = session {
            message["sessionId"] = session.into();
        }
        self.to.write_all(format!("{message}\0").as_bytes()).expect("the browser runs");
        let begin = Instant::now();
        loop {
            let answer = self.from.recv_timeout(PATIENCE.saturating_sub(begin.elapsed()));
            let mut answer = answer.unwrap_or_else(|why| panic!("{method}: {why}"));
            if answer["id"] == self.next_id {
                assert!(answer["error"].is_null(), "{method}: {answer}");
                return answer["result"].take();
            }
            self.note(&answer);
        }
    }

    /// Notes what the browser says by itself.
    fn note(&mut self, event: &Value) {
        match event["method"].as_str() {
            Some("Page.loadEventFired") => self.has_loaded = true,
            Some("Runtime.exceptionThrown" | "Log.entryAdded") => self.complaints.push(event["params"].to_string()),
            _ => {}
        }
    }

    /// Opens an address in a tab of its own, and waits until it is there.
    pub(crate) fn open(&mut self, address: &str, screen: Screen) -> Tab {
        let target = self.call(None, "Target.createTarget", json!({ "url": "about:blank", "newWindow": true }));
        let target = target["targetId"].as_str().expect("a target").to_owned();
        let session = self.call(None, "Target.attachToTarget", json!({ "targetId": target, "flatten": true }));
        let tab = Tab { session: session["sessionId"].as_str().expect("a session").to_owned(), target };
        for domain in ["Page", "Runtime", "Log"] {
            self.on(&tab, &format!("{domain}.enable"), json!({}));
        }
        self.show(&tab, screen);
        self.has_loaded = false;
        self.on(&tab, "Page.navigate", json!({ "url": address }));
        while !self.has_loaded {
            let event = self.from.recv_timeout(PATIENCE).unwrap_or_else(|why| panic!("{address} does not load: {why}"));
            self.note(&event);
        }
        tab
    }

    fn on(&mut self, tab: &Tab, method: &str, parameters: Value) -> Value {
        self.call(Some(&tab.session), method, parameters)
    }

    /// Gives a tab a screen.
    pub(crate) fn show(&mut self, tab: &Tab, Screen { width, height, is_phone, is_dark }: Screen) {
        let ratio = if is_phone { 2 } else { 1 };
        let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": ratio, "mobile": is_phone });
        self.on(tab, "Emulation.setDeviceMetricsOverride", metrics);
        self.on(tab, "Emulation.setTouchEmulationEnabled", json!({ "enabled": is_phone }));
        let scheme = if is_dark { "dark" } else { "light" };
        let features = json!([{ "name": "prefers-color-scheme", "value": scheme }]);
        self.on(tab, "Emulation.setEmulatedMedia", json!({ "features": features }));
    }

    /// Value of an expression in a tab.
    pub(crate) fn value(&mut self, tab: &Tab, expression: &str) -> Value {
        let parameters = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let mut result = self.on(tab, "Runtime.evaluate", parameters);
        assert!(result["exceptionDetails"].is_null(), "{expression}: {result}");
        result["result"]["value"].take()
    }

    /// Waits until an expression is true; `false` where it is not after `seconds`.
    pub(crate) fn is_soon(&mut self, tab: &Tab, expression: &str, seconds: f64) -> bool {
        let script = format!(
            "new Promise((done) => {{
               const until = performance.now() + {seconds} * 1000;
               const look = () => {{
                 if ({expression}) return done(true);
                 if (performance.now() > until) return done(false);
                 setTimeout(look, 10);
               }};
               look();
             }})"
        );
        self.value(tab, &script) == true
    }

    /// Presses and lets go of a key.
    pub(crate) fn press(&mut self, tab: &Tab, key: &str, code: &str) {
        for kind in ["keyDown", "keyUp"] {
            self.on(tab, "Input.dispatchKeyEvent", json!({ "type": kind, "key": key, "code": code }));
        }
    }

    /// A picture of what a tab shows, or of all of its page, as PNG.
    pub(crate) fn picture(&mut self, tab: &Tab, is_whole: bool) -> Vec<u8> {
        let picture = self.on(tab, "Page.captureScreenshot", json!({ "captureBeyondViewport": is_whole }));
        BASE64.decode(picture["data"].as_str().expect("a picture").as_bytes()).expect("base 64")
    }

    /// Kills what runs a tab, as the operating system does.
    pub(crate) fn kill(&mut self, tab: Tab) {
        // The tab does not answer that.
        self.next_id += 1;
        let message = json!({ "id": self.next_id, "method": "Page.crash", "params": {}, "sessionId": tab.session });
        self.to.write_all(format!("{message}\0").as_bytes()).expect("the browser runs");
        self.call(None, "Target.closeTarget", json!({ "targetId": tab.target }));
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // All its processes end with it.
        self.next_id += 1;
        let _ = self.to.write_all(format!("{{\"id\":{},\"method\":\"Browser.close\"}}\0", self.next_id).as_bytes());
        let begin = Instant::now();
        while self.from.recv_timeout(Duration::from_secs(5).saturating_sub(begin.elapsed())).is_ok() {}
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
