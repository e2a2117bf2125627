//! Fake board for the tests of this crate, at the other end of a TCP link: it accepts every request and reports them.
//! The tests of real behaviour use the simulator, which depends on this crate.

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    sync::mpsc::{self, Receiver, Sender},
    thread,
};

use r4_protocol::{
    Causes, ChannelId, ChannelInfo, ChannelKind, DeviceInfo, FrameDecoder, Mode, ModeInfo, Quality, Range, Refusal,
    Reply, Request, SafetyState, Sample, Telemetry, ToDevice, ToHost, Unit, encode_frame, frame::MAX_FRAME,
};

use crate::Address;

/// Only channel of the fake board.
pub(crate) const MOTOR: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);

/// Behaviour of the fake board in one connection.
#[derive(Clone, Default)]
pub(crate) struct Session {
    /// Answer to every request, if it refuses them all.
    pub refusal: Option<Refusal>,
    /// Constant reading of its clock, µs.
    pub device_us: u64,
    /// Causes in its heartbeats.
    pub causes: Causes,
    /// Closes the connection at a stop request.
    pub ends_at_stop: bool,
}

pub(crate) struct FakeBoard {
    pub address: Address,
    /// Requests it received, except hellos and descriptions.
    pub asked: Receiver<Request>,
}

impl FakeBoard {
    /// Starts a board that accepts one connection per session, one after another, and then no more.
    pub(crate) fn new(sessions: &[Session]) -> Self {
        let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
        let port = listener.local_addr().expect("bound").port();
        let (tell, asked) = mpsc::channel();
        let sessions = sessions.to_vec();
        thread::spawn(move || {
            for session in &sessions {
                let (stream, _) = listener.accept().expect("a host");
                session.serve(stream, &tell);
            }
        });
        Self { address: Address::Tcp { host: "127.0.0.1".into(), port }, asked }
    }
}

impl Session {
    /// Serves one host until it disconnects.
    fn serve(&self, mut stream: TcpStream, tell: &Sender<Request>) {
        let (mut decoder, mut bytes, mut subscribed) = (FrameDecoder::new(), [0; 512], false);
        while let Ok(len @ 1..) = stream.read(&mut bytes) {
            for message in bytes[..len].iter().filter_map(|byte| decoder.push::<ToDevice>(*byte)) {
                let mut answers = Vec::new();
                match message.expect("undamaged") {
                    ToDevice::Request { request: Request::Stop, .. } if self.ends_at_stop => return,
                    ToDevice::Request { seq, request } => {
                        let result = self.refusal.map_or_else(|| Ok(self.reply(&request)), Err);
                        answers.push(ToHost::Response { seq, result });
                        subscribed |= matches!(request, Request::Subscribe { .. });
                        if !matches!(request, Request::Hello { .. } | Request::Describe { .. }) {
                            // The test may not read the requests.
                            let _ = tell.send(request);
                        }
                    }
                    ToDevice::Heartbeat { host_us, .. } => {
                        answers.push(ToHost::Heartbeat {
                            host_us,
                            device_us: self.device_us,
                            state: SafetyState::Disarmed,
                            causes: self.causes,
                            hot: Default::default(),
                        });
                        answers.extend(subscribed.then(|| self.telemetry()));
                    }
                    ToDevice::Cycle(_) => {}
                }
                for answer in answers {
                    let mut buffer = [0; MAX_FRAME];
                    let frame = encode_frame(&answer, &mut buffer).expect("it fits");
                    if stream.write_all(frame).is_err() {
                        return;
                    }
                }
            }
        }
    }

    fn reply(&self, request: &Request) -> Reply {
        match request {
            Request::Hello { .. } => Reply::Hello(DeviceInfo {
                robot: "fake".try_into().expect("short"),
                firmware: "0".try_into().expect("short"),
                session: 1,
                channels: 1,
                link_timeout_ms: 1000,
                device_us: self.device_us,
                state: SafetyState::Disarmed,
                causes: self.causes,
            }),
            Request::Describe { .. } => Reply::Channel(channel()),
            _ => Reply::Done,
        }
    }

    /// Two samples of its channel, between those of another.
    fn telemetry(&self) -> ToHost {
        let sample = |channel, value| Sample::Reading { channel, value, quality: Quality::Good, age_ms: 0 };
        let other = ChannelId::new(ChannelKind::Osmc, 1);
        ToHost::Telemetry(Telemetry {
            device_us: self.device_us,
            state: SafetyState::Disarmed,
            causes: self.causes,
            samples: [sample(other, 1.0), sample(MOTOR, 2.0), sample(other, 3.0), sample(MOTOR, 4.0)]
                .into_iter()
                .collect(),
        })
    }
}

pub(crate) fn channel() -> ChannelInfo {
    let duty = ModeInfo { mode: Mode::Duty, unit: Unit::Duty, range: Range::symmetric(1.0) };
    ChannelInfo {
        id: MOTOR,
        unit: Unit::Duty,
        range: Range::symmetric(1.0),
        rate_hz: 1000.0,
        resolution: 0.0,
        modes: [duty].into_iter().collect(),
    }
}
