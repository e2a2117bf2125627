//! Recording what goes over a link.

use std::{collections::BTreeMap, io::Write};

use r4_protocol::{
    ChannelInfo, Cycle, CycleChannel, DeviceInfo, FrameDecoder, Mode, PathPoint, Reply, Request, Setpoint, ToDevice,
    ToHost, VERSION,
};

use crate::{Gap, Header, Live, RecordError, Recorded, Recorder};

/// What a link's bytes do not say of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct About {
    /// How the board is reached, such as `sim:osmc-bench`.
    pub board: String,
    /// Seed of a virtual board's noise.
    pub seed: Option<u64>,
    /// Name and version of the recording program.
    pub program: String,
    /// Its command line.
    pub command: String,
    /// Wall clock.
    pub wall: Wall,
}

/// Wall clock of a recording, ns since 1970-01-01T00:00:00Z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wall {
    /// At the beginning; the host's clock is a virtual one.
    Began {
        /// Then.
        unix_ns: u64,
    },
    /// The host's clock goes with it.
    Runs {
        /// When the host's clock was 0.
        unix_ns_at_zero: u64,
    },
}

/// Listens to both directions of a link and records what board and host say.
///
/// Give it every byte, with the host's clock. The file begins once the board has described its channels, as it does
/// whenever a session is opened. Recording never disturbs the link: what cannot be recorded ends the recording, and
/// [`finish`](Self::finish) says why.
pub struct Tap<W: Write> {
    about: About,
    file: File<W>,
    to_device: FrameDecoder,
    to_host: FrameDecoder,
    /// When the first request was sent, by the host's clock.
    begin_us: Option<u64>,
    info: Option<DeviceInfo>,
    channels: Vec<ChannelInfo>,
    /// Requests without an answer, and when each was sent.
    waiting: BTreeMap<u16, (u64, Request)>,
    /// What cycles set, and how long that holds, ms.
    bound: (Vec<CycleChannel>, u16),
    clock: Option<Offset>,
    /// When the board was last heard: the host's clock and the board's.
    heard_us: Option<(u64, u64)>,
    /// The same, before the link was lost.
    lost_us: Option<(u64, u64)>,
    /// Times of the log minus the board's clock.
    shift_us: i64,
    samples: u64,
    bad_frames: u64,
    /// Until the board has described itself.
    live: Option<Box<dyn Live>>,
}

/// What has become of the file.
enum File<W: Write> {
    /// The board has not described itself.
    Before(W),
    Open(Box<Recorder<W>>),
    Failed(RecordError),
}

/// Requests whose answers are waited for; more than any host has open, so that what is never answered is forgotten.
const MOST_WAITING: usize = 1024;

impl<W: Write> Tap<W> {
    /// Will record to `writer`. Give a [`std::io::BufWriter`] rather than a bare file.
    pub fn new(writer: W, about: About) -> Self {
        Self {
            about,
            file: File::Before(writer),
            to_device: FrameDecoder::new(),
            to_host: FrameDecoder::new(),
            begin_us: None,
            info: None,
            channels: Vec::new(),
            waiting: BTreeMap::new(),
            bound: (Vec::new(), 0),
            clock: None,
            heard_us: None,
            lost_us: None,
            shift_us: 0,
            samples: 0,
            bad_frames: 0,
            live: None,
        }
    }

    /// Tells all that is recorded to `live`, too. To be called before the board has described itself.
    pub fn tell(&mut self, live: Box<dyn Live>) {
        self.live = Some(live);
    }

    /// Takes it that all bytes from here on are of a link that was opened anew. Once the board has described itself on it, the time
    /// without a link is recorded as a [`Gap`].
    pub fn reopened(&mut self) {
        (self.to_device, self.to_host) = (FrameDecoder::new(), FrameDecoder::new());
        self.waiting.clear();
        self.bound = (Vec::new(), 0);
        if matches!(self.file, File::Open(_)) {
            // Of several attempts the first.
            self.lost_us = self.lost_us.or(self.heard_us);
        }
    }

    /// Takes bytes that the host has sent at `now_us` of its clock.
    pub fn sent(&mut self, now_us: u64, bytes: &[u8]) {
        for byte in bytes {
            // The host's own frames are sound.
            if let Some(Ok(message)) = self.to_device.push(*byte) {
                let recorded = self.host_says(now_us, message);
                self.check(recorded);
            }
        }
    }

    /// Takes bytes that the host has received at `now_us` of its clock.
    pub fn received(&mut self, now_us: u64, bytes: &[u8]) {
        for byte in bytes {
            match self.to_host.push(*byte) {
                Some(Ok(message)) => {
                    let recorded = self.board_says(now_us, message);
                    self.heard_us = self.clock.map(|_| (now_us, self.device_us(now_us)));
                    self.check(recorded);
                }
                Some(Err(_)) => self.bad_frames += 1,
                None => {}
            }
        }
    }

    /// When the host said hello, by its clock; what a log's `sent_us` counts from.
    #[must_use]
    pub fn began_us(&self) -> Option<u64> {
        self.begin_us
    }

    /// Samples recorded so far.
    #[must_use]
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Frames from the board that were damaged: what they said is not recorded.
    #[must_use]
    pub fn bad_frames(&self) -> u64 {
        self.bad_frames
    }

    /// Why nothing is recorded any more.
    #[must_use]
    pub fn failure(&self) -> Option<&RecordError> {
        match &self.file {
            File::Failed(error) => Some(error),
            File::Before(_) | File::Open(_) => None,
        }
    }

    /// Writes the end of the file. `None` if the board never described itself: nothing was written.
    ///
    /// # Errors
    /// What went wrong first.
    pub fn finish(self) -> Result<Option<W>, RecordError> {
        match self.file {
            File::Before(_) => Ok(None),
            File::Open(recorder) => recorder.finish().map(Some),
            File::Failed(error) => Err(error),
        }
    }

    fn check(&mut self, recorded: Result<(), RecordError>) {
        if let Err(error) = recorded {
            self.file = File::Failed(error);
        }
    }

    fn recorder(&mut self) -> Option<&mut Recorder<W>> {
        match &mut self.file {
            File::Open(recorder) => Some(recorder),
            File::Before(_) | File::Failed(_) => None,
        }
    }

    fn device_us(&self, now_us: u64) -> u64 {
        self.clock.map_or(now_us, |offset| now_us.saturating_add_signed(offset.us))
    }

    fn host_says(&mut self, now_us: u64, message: ToDevice) -> Result<(), RecordError> {
        let (seq, request) = match message {
            ToDevice::Request { seq, request } => (seq, request),
            ToDevice::Cycle(cycle) => return self.cycle(now_us, cycle),
            ToDevice::Heartbeat { .. } => return Ok(()),
        };
        // Sent again because the answer did not come.
        if self.waiting.get(&seq).is_some_and(|(_, waiting)| *waiting == request) {
            return Ok(());
        }
        if let Request::Bind { channels, ttl_ms } = &request {
            self.bound = (channels.to_vec(), *ttl_ms);
        }
        let begin_us = *self.begin_us.get_or_insert(now_us);
        let device_us = match request {
            // The date of a point of a path is when the channel is to be there.
            Request::Set { setpoint: Setpoint { mode: Mode::Follow, .. }, .. } => self.device_us(now_us),
            // What the board compares with its clock.
            Request::Set { sent_us, .. } | Request::Follow { sent_us, .. } => sent_us,
            _ => self.device_us(now_us),
        };
        let as_recorded = as_path(&request, device_us);
        let recorded = match self.recorder() {
            Some(recorder) => {
                let request = as_recorded.as_ref().unwrap_or(&request);
                recorder.request(device_us, Some(now_us.saturating_sub(begin_us)), request)
            }
            None => Ok(()),
        };
        if self.waiting.len() >= MOST_WAITING
            && let Some((&oldest, _)) = self.waiting.iter().min_by_key(|(_, (sent_us, _))| sent_us)
        {
            self.waiting.remove(&oldest);
        }
        self.waiting.insert(seq, (now_us, request));
        recorded
    }

    /// Set points like any others.
    fn cycle(&mut self, now_us: u64, cycle: Cycle) -> Result<(), RecordError> {
        let sent_us = self.device_us(now_us);
        let (Some(begin_us), Ok(mode)) = (self.begin_us, cycle.mode()) else { return Ok(()) };
        let (channels, ttl_ms) = self.bound.clone();
        for (channel, steps) in channels.iter().zip(cycle.set()) {
            if let (Ok(Some(setpoint)), Some(recorder)) = (channel.setpoint(mode, steps), self.recorder()) {
                let point_us = (setpoint.mode == Mode::Follow)
                    .then(|| sent_us.saturating_add_signed(-i64::from(cycle.age_us(sent_us))));
                let request =
                    Request::Set { channel: channel.channel, setpoint, sent_us: point_us.unwrap_or(sent_us), ttl_ms };
                let request = as_path(&request, sent_us).unwrap_or(request);
                recorder.request(sent_us, Some(now_us.saturating_sub(begin_us)), &request)?;
            }
        }
        Ok(())
    }

    fn board_says(&mut self, now_us: u64, message: ToHost) -> Result<(), RecordError> {
        match message {
            ToHost::Response { seq, result } => {
                let Some((sent_us, request)) = self.waiting.remove(&seq) else { return Ok(()) };
                match result {
                    Ok(Reply::Hello(info)) => {
                        if self.lost_us.is_some() {
                            // It may be another clock.
                            self.clock = None;
                        }
                        self.clock_seen(sent_us, info.device_us, now_us);
                        self.channels.clear();
                        self.info = Some(info);
                        self.begin()
                    }
                    Ok(Reply::Channel(channel)) => {
                        self.channels.push(channel);
                        self.begin()
                    }
                    Ok(_) => Ok(()),
                    Err(reason) => {
                        let device_us = self.device_us(now_us);
                        self.recorder().map_or(Ok(()), |recorder| recorder.refusal(device_us, &request, &reason))
                    }
                }
            }
            ToHost::Heartbeat { host_us, device_us, state, causes, .. } => {
                self.clock_seen(host_us, device_us, now_us);
                self.recorder().map_or(Ok(()), |recorder| recorder.state(device_us, state, causes))
            }
            // What it measures is in telemetry, too.
            ToHost::Cycle(_) | ToHost::Log(_) => Ok(()),
            ToHost::Telemetry(telemetry) => {
                let Some(recorder) = self.recorder() else { return Ok(()) };
                recorder.telemetry(&telemetry)?;
                self.samples += telemetry.samples.len() as u64;
                Ok(())
            }
        }
    }

    /// Begins the file when the last channel is known.
    fn begin(&mut self) -> Result<(), RecordError> {
        let Some(info) = self.info.as_ref().filter(|info| self.channels.len() == usize::from(info.channels)) else {
            return Ok(());
        };
        // Any other way on leads through `check`.
        let file = match std::mem::replace(&mut self.file, File::Failed(RecordError::Ended)) {
            File::Before(writer) => {
                let offset_us = self.clock.map_or(0, |offset| offset.us);
                let (unix_ns, clock_offset_ns) = match self.about.wall {
                    Wall::Began { unix_ns } => (unix_ns, None),
                    Wall::Runs { unix_ns_at_zero } => (
                        unix_ns_at_zero.saturating_add(self.begin_us.unwrap_or_default().saturating_mul(1_000)),
                        unix_ns_at_zero.cast_signed().checked_sub(offset_us.saturating_mul(1_000)),
                    ),
                };
                let recorded = Recorded {
                    unix_ns,
                    program: self.about.program.clone(),
                    command: self.about.command.clone(),
                    clock_offset_ns,
                };
                let header = Header {
                    robot: info.robot.to_string(),
                    board: self.about.board.clone(),
                    firmware: info.firmware.to_string(),
                    protocol_version: VERSION,
                    channels: self.channels.clone(),
                    seed: self.about.seed,
                    recorded: Some(recorded),
                };
                let mut recorder = Recorder::new(writer, &header)?.with_live(self.live.take());
                recorder.state(info.device_us, info.state, info.causes)?;
                File::Open(Box::new(recorder))
            }
            File::Open(recorder) if recorder.channels() != self.channels => {
                // Its file is finished.
                drop(recorder);
                File::Failed(RecordError::OtherBoard)
            }
            File::Open(mut recorder) => {
                if let (Some((heard_us, board_us)), Some(offset)) = (self.lost_us.take(), self.clock) {
                    let gap = gap(heard_us, board_us, offset, self.shift_us);
                    self.shift_us = gap.clock_shift_us;
                    recorder.gap(info.device_us, &gap)?;
                    recorder.state(info.device_us, info.state, info.causes)?;
                }
                File::Open(recorder)
            }
            failed @ File::Failed(_) => failed,
        };
        self.file = file;
        Ok(())
    }

    /// Takes the board's clock as read between `sent_us` and `now_us` of the host's.
    fn clock_seen(&mut self, sent_us: u64, device_us: u64, now_us: u64) {
        let round_trip_us = now_us.saturating_sub(sent_us);
        let middle_us = sent_us.saturating_add(round_trip_us / 2);
        let new = Offset { us: device_us.wrapping_sub(middle_us).cast_signed(), round_trip_us, seen_us: now_us };
        if self.clock.is_none_or(|old| new.uncertainty_us(now_us) <= old.uncertainty_us(now_us)) {
            self.clock = Some(new);
        }
    }
}

/// A board's clock that is this far behind where it should be began anew, us: more than frames wait for each other.
const BEGAN_ANEW_US: u64 = 100_000;

/// What became of a board that was last heard at `heard_us` of the host's clock, `board_us` of its own, by the first round trip since.
fn gap(heard_us: u64, board_us: u64, now: Offset, shift_us: i64) -> Gap {
    let without_link_us = now.seen_us.saturating_sub(heard_us);
    let (expected_us, is_us) = (board_us + without_link_us, now.seen_us.saturating_add_signed(now.us));
    let wrong_us = BEGAN_ANEW_US + (without_link_us as f64 * DRIFT) as u64;
    let restarted = is_us + wrong_us < expected_us;
    let anew_us = if restarted { (expected_us - is_us).cast_signed() } else { 0 };
    Gap {
        time_s: 0.0,
        without_link_s: without_link_us as f64 / 1e6,
        restarted,
        clock_shift_us: shift_us.saturating_add(anew_us),
    }
}

/// Board clock minus host clock, as one round trip showed it.
#[derive(Clone, Copy)]
struct Offset {
    us: i64,
    round_trip_us: u64,
    seen_us: u64,
}

/// Two crystals drift apart by no more than this share, of which an old offset is worth less.
const DRIFT: f64 = 200e-6;

impl Offset {
    /// How wrong it may be by now, us.
    fn uncertainty_us(&self, now_us: u64) -> f64 {
        self.round_trip_us as f64 / 2.0 + now_us.saturating_sub(self.seen_us) as f64 * DRIFT
    }
}
/// A single point of a path, sent at `device_us`, as the path that it is.
fn as_path(request: &Request, device_us: u64) -> Option<Request> {
    let Request::Set { channel, setpoint: Setpoint { mode: Mode::Follow, value }, sent_us, .. } = *request else {
        return None;
    };
    let point = PathPoint { at_us: sent_us, position: value, speed: None, feed_forward: 0.0 };
    Some(Request::Follow { channel, sent_us: device_us, points: [point].into_iter().collect() })
}
