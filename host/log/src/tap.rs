//! Recording of the bytes that go over a link.

use std::{collections::BTreeMap, io::Write};

use r4_protocol::{
    ChannelInfo, Cycle, CycleChannel, DeviceInfo, FrameDecoder, Mode, PathPoint, Reply, Request, Setpoint, Telemetry,
    ToDevice, ToHost, VERSION,
};

use crate::{Derive, Gap, Header, Live, RecordError, Recorded, Recorder};

/// Facts about a run which the bytes of its link do not contain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct About {
    /// Address of the board, such as `sim:osmc-bench`.
    pub board: String,
    /// Seed of a virtual board's noise.
    pub seed: Option<u64>,
    /// Name and version of the recording program.
    pub program: String,
    /// Command line of the recording program.
    pub command: String,
    /// Wall clock of the recording.
    pub wall: Wall,
}

/// Wall clock of a recording, ns since 1970-01-01T00:00:00Z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wall {
    /// Wall clock at the beginning only; the host's clock is a virtual one.
    Began {
        /// Wall clock at the beginning, ns since 1970-01-01T00:00:00Z.
        unix_ns: u64,
    },
    /// Wall clock that runs at the rate of the host's clock.
    Runs {
        /// Wall clock when the host's clock was 0, ns since 1970-01-01T00:00:00Z.
        unix_ns_at_zero: u64,
    },
}

/// Listens to both directions of a link and records the messages of board and host.
///
/// Give it every byte, with the host's clock. The file begins once the board has described its channels, as it does
/// whenever a session is opened. Recording never disturbs the link: a failure ends the recording, and
/// [`finish`](Self::finish) returns it.
pub struct Tap<W: Write> {
    about: About,
    file: File<W>,
    to_device: FrameDecoder,
    to_host: FrameDecoder,
    /// Time of the first request, on the host's clock, µs; `None` before it.
    begin_us: Option<u64>,
    info: Option<DeviceInfo>,
    channels: Vec<ChannelInfo>,
    /// Requests without an answer so far, each with the time at which it was sent, on the host's clock, µs.
    waiting: BTreeMap<u16, (u64, Request)>,
    /// Channels that cycles set, with the time to live of those set points, ms.
    bound: (Vec<CycleChannel>, u16),
    clock: Option<Offset>,
    /// Time at which the board was last heard, µs: on the host's clock and on the board's.
    heard_us: Option<(u64, u64)>,
    /// Value of `heard_us` before the link was lost; `None` while there is a link.
    lost_us: Option<(u64, u64)>,
    /// Times of the log minus the board's clock, µs.
    shift_us: i64,
    samples: u64,
    bad_frames: u64,
    /// Listener that also gets what is recorded; held here only until the board has described itself.
    live: Option<Box<dyn Live>>,
    derive: Option<Box<dyn Derive>>,
}

/// State of the file that is being recorded.
enum File<W: Write> {
    /// Not begun: the board has not described itself.
    Before(W),
    Open(Box<Recorder<W>>),
    Failed(RecordError),
}

/// Most requests whose answers are waited for: more than any host has open, so that only requests which are never
/// answered are dropped.
const MOST_WAITING: usize = 1024;

impl<W: Write> Tap<W> {
    /// Creates a tap that records to `writer`. Give a [`std::io::BufWriter`] rather than a bare file.
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
            derive: None,
        }
    }

    /// Also sends all that is recorded to `live`. Must be called before the board has described itself.
    pub fn tell(&mut self, live: Box<dyn Live>) {
        self.live = Some(live);
    }

    /// Returns true when something is derived already, as after a lost link.
    #[must_use]
    pub fn is_deriving(&self) -> bool {
        self.derive.is_some()
    }

    /// Also records what `derive` derives from each frame from now on.
    pub fn derive(&mut self, derive: Box<dyn Derive>) {
        self.derive = Some(derive);
    }

    /// Notes that all further bytes come from a link that was opened anew. Once the board has described itself on it,
    /// the time without a link is recorded as a [`Gap`].
    pub fn reopened(&mut self) {
        // Half a frame of the lost link must not be joined with the first bytes of the new one.
        (self.to_device, self.to_host) = (FrameDecoder::new(), FrameDecoder::new());
        self.waiting.clear();
        self.bound = (Vec::new(), 0);
        if matches!(self.file, File::Open(_)) {
            // Of several failed attempts to reopen, the first loss counts.
            self.lost_us = self.lost_us.or(self.heard_us);
        }
    }

    /// Records bytes that the host sent at `now_us` of its clock.
    pub fn sent(&mut self, now_us: u64, bytes: &[u8]) {
        for byte in bytes {
            // The host encodes its own frames, so none is damaged; incomplete ones are no message yet.
            if let Some(Ok(message)) = self.to_device.push(*byte) {
                let recorded = self.host_says(now_us, message);
                self.check(recorded);
            }
        }
    }

    /// Records bytes that the host received at `now_us` of its clock.
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

    /// Returns the time of the host's hello on its clock, µs; a log's `sent_us` counts from it.
    #[must_use]
    pub fn began_us(&self) -> Option<u64> {
        self.begin_us
    }

    /// Returns the number of samples recorded so far.
    #[must_use]
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Returns the number of damaged frames from the board, which are missing from the recording.
    #[must_use]
    pub fn bad_frames(&self) -> u64 {
        self.bad_frames
    }

    /// Returns the error that ended the recording; `None` while it goes on.
    #[must_use]
    pub fn failure(&self) -> Option<&RecordError> {
        match &self.file {
            File::Failed(error) => Some(error),
            File::Before(_) | File::Open(_) => None,
        }
    }

    /// Writes the end of the file. Returns `None` if the board never described itself: nothing was written.
    ///
    /// # Errors
    /// The first error of the recording.
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
        // The driver repeats a request whose answer is late; the log holds it once.
        if self.waiting.get(&seq).is_some_and(|(_, waiting)| *waiting == request) {
            return Ok(());
        }
        if let Request::Bind { channels, ttl_ms } = &request {
            self.bound = (channels.to_vec(), *ttl_ms);
        }
        let begin_us = *self.begin_us.get_or_insert(now_us);
        let device_us = match request {
            // A point of a path carries the time at which the channel is to be there, not the time of sending.
            Request::Set { setpoint: Setpoint { mode: Mode::Follow, .. }, .. } => self.device_us(now_us),
            // The board compares these times with its clock to reject late set points.
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

    /// Records the set points of a cycle as one request per channel.
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
                            // The board may have restarted or be another one, so an offset from before the loss is
                            // invalid.
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
            // The measurements of a cycle's answer are in telemetry too.
            ToHost::Cycle(_) | ToHost::Log(_) => Ok(()),
            ToHost::Telemetry(telemetry) => {
                let Some(recorder) = self.recorder() else { return Ok(()) };
                recorder.telemetry(&telemetry)?;
                self.samples += telemetry.samples.len() as u64;
                self.derived(&telemetry)
            }
        }
    }

    /// Records what is derived from a frame.
    fn derived(&mut self, telemetry: &Telemetry) -> Result<(), RecordError> {
        let (File::Open(recorder), Some(derive)) = (&mut self.file, &mut self.derive) else { return Ok(()) };
        let (_, log_time_ns) = recorder.times_ns(telemetry.device_us)?;
        let mut recorded = Ok(());
        derive.derive(&self.channels, telemetry, log_time_ns, &mut |topic, json| {
            if recorded.is_ok() {
                recorded = recorder.derived(telemetry.device_us, topic, json);
            }
        });
        recorded
    }

    /// Begins the file once the last channel is described, or continues it after a lost link.
    fn begin(&mut self) -> Result<(), RecordError> {
        let Some(info) = self.info.as_ref().filter(|info| self.channels.len() == usize::from(info.channels)) else {
            return Ok(());
        };
        // A placeholder while the file is replaced; every error below is stored by `check`.
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
                // The file of the first board ends here, complete.
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

    /// Updates the offset of the board's clock, which read `device_us` between `sent_us` and `now_us` of the host's
    /// clock.
    fn clock_seen(&mut self, sent_us: u64, device_us: u64, now_us: u64) {
        let round_trip_us = now_us.saturating_sub(sent_us);
        // Both directions are taken to last equally long.
        let middle_us = sent_us.saturating_add(round_trip_us / 2);
        let new = Offset { us: device_us.wrapping_sub(middle_us).cast_signed(), round_trip_us, seen_us: now_us };
        // Half the round trip bounds the error of the middle: a slow answer must not replace a better, recent offset.
        if self.clock.is_none_or(|old| new.uncertainty_us(now_us) <= old.uncertainty_us(now_us)) {
            self.clock = Some(new);
        }
    }
}

/// Lag of a board's clock behind its expected value beyond which the board has restarted, µs: more than frames wait
/// in queues.
const BEGAN_ANEW_US: u64 = 100_000;

/// Returns the gap of a board that was last heard at `heard_us` of the host's clock (`board_us` of its own) and
/// answers again with the offset `now`. `shift_us` is the shift of the log's times before the gap.
fn gap(heard_us: u64, board_us: u64, now: Offset, shift_us: i64) -> Gap {
    let without_link_us = now.seen_us.saturating_sub(heard_us);
    let (expected_us, is_us) = (board_us + without_link_us, now.seen_us.saturating_add_signed(now.us));
    // The clocks may have drifted apart in the meantime.
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

/// Offset of the board's clock from the host's, as measured by one round trip.
#[derive(Clone, Copy)]
struct Offset {
    us: i64,
    round_trip_us: u64,
    seen_us: u64,
}

/// Bound of the relative drift of two crystals (200 ppm), by which an old offset becomes less certain.
const DRIFT: f64 = 200e-6;

impl Offset {
    /// Returns the bound of the offset's error at `now_us`, µs.
    fn uncertainty_us(&self, now_us: u64) -> f64 {
        self.round_trip_us as f64 / 2.0 + now_us.saturating_sub(self.seen_us) as f64 * DRIFT
    }
}
/// Returns a set point that is a single point of a path, sent at `device_us`, as a path; `None` for other requests.
fn as_path(request: &Request, device_us: u64) -> Option<Request> {
    let Request::Set { channel, setpoint: Setpoint { mode: Mode::Follow, value }, sent_us, .. } = *request else {
        return None;
    };
    let point = PathPoint { at_us: sent_us, position: value, speed: None, feed_forward: 0.0 };
    Some(Request::Follow { channel, sent_us: device_us, points: [point].into_iter().collect() })
}
