//! One link to a host: frames in, answers and telemetry out.

use embassy_futures::select::{Either3, select3};
use embassy_sync::{
    blocking_mutex::{Mutex, raw::NoopRawMutex, raw::RawMutex},
    channel::Channel,
};
use embassy_time::{Duration, Instant, Timer};
use embedded_io_async::{Read, Write};
use r4_protocol::{FrameDecoder, FrameError, Refusal, Request, ToDevice, ToHost, encode_frame, frame::MAX_FRAME};

use crate::{
    dispatch::{Host, Outcome, carry_out, dispatch, unknown},
    shared::{HostSide, ReportSide, Shared},
};

/// Maximum number of answers waiting for the transmitter; a host that sends requests faster than its link carries is
/// held back by the link itself.
const ANSWERS: usize = 4;

/// Maximum number of deferred requests that wait for the one before.
const WAITING: usize = 2;

/// Interval of checking whether the board has started.
const START_POLL: Duration = Duration::from_millis(1);

/// Serves one link until it fails. `number` identifies the link within the board.
///
/// Waits for the outputs to be in a known state before it takes the first message, and sends nothing before its first
/// answer.
pub async fn serve<M: RawMutex, R: Read, W: Write>(shared: &Shared<M>, number: u8, rx: R, tx: W) {
    let shared = HostSide::of(shared);
    while !shared.has_started() {
        Timer::after(START_POLL).await;
    }
    let answers: Channel<NoopRawMutex, ToHost, ANSWERS> = Channel::new();
    let waiting: Waiting = Channel::new();
    let host: SharedHost = Mutex::new(core::cell::RefCell::new(Host::default()));
    let receive = receive(shared, number, rx, &answers, &waiting, &host);
    let transmit = transmit(shared, tx, &answers, &host);
    let work = async {
        loop {
            let (seq, request) = waiting.receive().await;
            answers.send(carry_out(shared, seq, request).await).await;
        }
    };
    // A failure of either direction ends the link; the supervisor then misses its heartbeat.
    select3(receive, transmit, work).await;
}

type Waiting = Channel<NoopRawMutex, (u16, Request), WAITING>;

type SharedHost = Mutex<NoopRawMutex, core::cell::RefCell<Host>>;

async fn receive<M: RawMutex, R: Read>(
    shared: HostSide<'_, M>,
    number: u8,
    mut rx: R,
    answers: &Channel<NoopRawMutex, ToHost, ANSWERS>,
    waiting: &Waiting,
    host: &SharedHost,
) {
    let mut decoder = FrameDecoder::new();
    let mut buffer = [0; 64];
    while let Ok(len @ 1..) = rx.read(&mut buffer).await {
        for byte in &buffer[..len] {
            let Some(frame) = decoder.push::<ToDevice>(*byte) else { continue };
            shared.count(|stats| match frame {
                Ok(_) => stats.frames = stats.frames.wrapping_add(1),
                Err(_) => stats.bad_frames = stats.bad_frames.wrapping_add(1),
            });
            let message = match frame {
                Ok(message) => message,
                Err(FrameError::NotAMessage { seq: Some(seq) }) => {
                    answers.send(unknown(shared, number, seq, Instant::now())).await;
                    continue;
                }
                Err(_) => continue,
            };
            match host.lock(|host| dispatch(shared, number, &mut host.borrow_mut(), message)) {
                Outcome::Nothing => {}
                Outcome::Answer(answer) => answers.send(answer).await,
                // Heartbeats must not wait for flash or for a bus.
                Outcome::Later { seq, request } => {
                    if waiting.try_send((seq, request)).is_err() {
                        answers.send(ToHost::Response { seq, result: Err(Refusal::TransferFailed) }).await;
                    }
                }
            }
        }
    }
}

async fn transmit<M: RawMutex, W: Write>(
    shared: HostSide<'_, M>,
    mut tx: W,
    answers: &Channel<NoopRawMutex, ToHost, ANSWERS>,
    host: &SharedHost,
) {
    let mut buffer = [0; MAX_FRAME];
    let mut silent = true;
    loop {
        let (due, log_due) = host.lock(|host| (host.borrow().subscriptions.next_due(), host.borrow().log.next_due()));
        // The first that is ready, in this order of priority: the log gets only the time that remains.
        let message = match select3(answers.receive(), Timer::at(due), Timer::at(log_due)).await {
            Either3::First(answer) => Some(answer),
            Either3::Second(()) => host
                .lock(|host| host.borrow_mut().subscriptions.telemetry(ReportSide::of(&shared)))
                .map(ToHost::Telemetry),
            Either3::Third(()) => {
                shared.log().and_then(|log| host.lock(|host| host.borrow_mut().log.chunk(log))).map(ToHost::Log)
            }
        };
        // The encoding cannot fail: a test encodes the largest message of each kind.
        let Some(Ok(frame)) = message.map(|message| encode_frame(&message, &mut buffer)) else { continue };
        // The zero byte ends any incomplete frame that the host may still hold. Not sooner: on a shared bus a board
        // sends nothing before it is addressed, and everything it sends is requested.
        if core::mem::take(&mut silent) && tx.write_all(&[0]).await.is_err() {
            return;
        }
        if tx.write_all(frame).await.is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use core::{cell::RefCell, convert::Infallible, future::poll_fn, task::Poll};
    use std::{collections::VecDeque, rc::Rc, task::Waker, vec::Vec};

    use embedded_io_async::ErrorType;
    use r4_protocol::{
        DeviceStats, Reply, SCHEMA_HASH, SafetyState, VERSION,
        frame::{Check, encode_with},
    };

    use super::*;
    use crate::{
        shared::ResetCause,
        testing::{Board, Tasks, board, robot},
    };

    /// One direction of a link, as a pipe.
    #[derive(Clone, Default)]
    struct Pipe(Rc<RefCell<(VecDeque<u8>, Option<Waker>)>>);

    impl Pipe {
        fn take(&self) -> Vec<u8> {
            self.0.borrow_mut().0.drain(..).collect()
        }

        fn put(&self, bytes: &[u8]) {
            let mut pipe = self.0.borrow_mut();
            pipe.0.extend(bytes);
            pipe.1.take().into_iter().for_each(Waker::wake);
        }
    }

    impl ErrorType for Pipe {
        type Error = Infallible;
    }

    impl Read for Pipe {
        async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
            poll_fn(|context| {
                let mut pipe = self.0.borrow_mut();
                if pipe.0.is_empty() {
                    pipe.1 = Some(context.waker().clone());
                    return Poll::Pending;
                }
                let len = pipe.0.len().min(buffer.len());
                buffer[..len].fill_with(|| pipe.0.pop_front().unwrap_or_default());
                Poll::Ready(Ok(len))
            })
            .await
        }
    }

    impl Write for Pipe {
        async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
            self.put(bytes);
            Ok(bytes.len())
        }

        async fn flush(&mut self) -> Result<(), Infallible> {
            Ok(())
        }
    }

    /// Board whose control loop has not begun, and a host at its link.
    struct Bench {
        board: Board,
        tasks: Tasks,
        to_board: Pipe,
        to_host: Pipe,
    }

    impl Bench {
        fn new() -> Self {
            let mut config = robot("every-interface");
            config.ranges.clear();
            let board = board(config, ResetCause::Normal);
            let (to_board, to_host) = (Pipe::default(), Pipe::default());
            let mut tasks = Tasks::default();
            tasks.spawn(serve(board, 1, to_board.clone(), to_host.clone()));
            Self { board, tasks, to_board, to_host }
        }

        fn ask(&mut self, seq: u16, request: Request) {
            let mut buffer = [0; MAX_FRAME];
            let frame = encode_frame(&ToDevice::Request { seq, request }, &mut buffer).expect("it fits");
            self.to_board.put(frame);
        }

        fn answers(bytes: &[u8]) -> Vec<ToHost> {
            let mut decoder = FrameDecoder::new();
            bytes.iter().filter_map(|byte| decoder.push::<ToHost>(*byte)).map(|frame| frame.expect("whole")).collect()
        }
    }

    /// Nothing is answered before the outputs are in a known state; then everything is. Before its first answer, and
    /// only there, a board ends any incomplete frame that the host may still hold.
    #[test]
    fn a_host_is_answered_once_the_outputs_are_known() {
        let mut bench = Bench::new();
        bench.ask(1, Request::Hello { version: VERSION, schema: SCHEMA_HASH });
        bench.tasks.advance(Duration::from_millis(100));
        assert!(bench.to_host.take().is_empty() && !bench.board.as_host().has_session(1));
        bench.board.as_control().set_started();
        bench.tasks.advance(START_POLL);
        let bytes = bench.to_host.take();
        assert_eq!((bytes[0], bytes.iter().filter(|byte| **byte == 0).count()), (0, 2));
        let answers = Bench::answers(&bytes[1..]);
        assert!(matches!(answers[..], [ToHost::Response { seq: 1, result: Ok(Reply::Hello(_)) }]), "{answers:?}");
        // Damaged bytes are counted, and the next frame is accepted.
        bench.to_board.put(b"\x05noise\0");
        bench.ask(2, Request::Stats);
        bench.tasks.settle();
        let bytes = bench.to_host.take();
        assert_eq!(bytes.iter().filter(|byte| **byte == 0).count(), 1);
        let stats = DeviceStats { frames: 2, bad_frames: 1, ..DeviceStats::default() };
        assert_eq!(Bench::answers(&bytes), [ToHost::Response { seq: 2, result: Ok(Reply::Stats(stats)) }]);
        // A request of a later version, and one whose checksum is too short for a command.
        for unknown in [
            encode_with(&(0u8, 3u16, 200u8), Check::Long, &mut [0; MAX_FRAME]).expect("it fits").to_vec(),
            encode_with(&ToDevice::Request { seq: 3, request: Request::Arm }, Check::Short, &mut [0; MAX_FRAME])
                .expect("it fits")
                .to_vec(),
        ] {
            bench.to_board.put(&unknown);
            bench.tasks.settle();
            let refused = ToHost::Response { seq: 3, result: Err(Refusal::UnknownMessage) };
            assert_eq!(Bench::answers(&bench.to_host.take()), [refused]);
        }
        assert_eq!(bench.board.safety().state, SafetyState::Disarmed);
    }
}
