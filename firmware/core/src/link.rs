//! One link to a host: frames in, answers and telemetry out.

use embassy_futures::select::{Either3, select3};
use embassy_sync::{
    blocking_mutex::{Mutex, raw::NoopRawMutex, raw::RawMutex},
    channel::Channel,
};
use embassy_time::{Duration, Timer};
use embedded_io_async::{Read, Write};
use r4_protocol::{FrameDecoder, Refusal, Request, ToDevice, ToHost, encode_frame, frame::MAX_FRAME};

use crate::{
    dispatch::{Host, Outcome, carry_out, dispatch},
    shared::Shared,
};

/// Answers waiting for the transmitter; a host that asks faster than its link carries is held back by the link itself.
const ANSWERS: usize = 4;

/// Requests that take time and wait for the one before.
const WAITING: usize = 2;

/// How often a link looks whether the board has started.
const START_POLL: Duration = Duration::from_millis(1);

/// Serves one link until it fails. `number` tells the links of a board apart.
///
/// Waits for the outputs to be in a known state before it takes the first message, and says nothing before it has answered one.
pub async fn serve<M: RawMutex, R: Read, W: Write>(shared: &Shared<M>, number: u8, rx: R, tx: W) {
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
    // Either end failing ends the link; the supervisor then misses its heartbeat.
    select3(receive, transmit, work).await;
}

type Waiting = Channel<NoopRawMutex, (u16, Request), WAITING>;

type SharedHost = Mutex<NoopRawMutex, core::cell::RefCell<Host>>;

async fn receive<M: RawMutex, R: Read>(
    shared: &Shared<M>,
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
            let Ok(message) = frame else { continue };
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
    shared: &Shared<M>,
    mut tx: W,
    answers: &Channel<NoopRawMutex, ToHost, ANSWERS>,
    host: &SharedHost,
) {
    let mut buffer = [0; MAX_FRAME];
    let mut silent = true;
    loop {
        let (due, log_due) = host.lock(|host| (host.borrow().subscriptions.next_due(), host.borrow().log.next_due()));
        // The first that is ready: the log only where there is nothing else.
        let message = match select3(answers.receive(), Timer::at(due), Timer::at(log_due)).await {
            Either3::First(answer) => Some(answer),
            Either3::Second(()) => {
                host.lock(|host| host.borrow_mut().subscriptions.telemetry(shared)).map(ToHost::Telemetry)
            }
            Either3::Third(()) => {
                shared.log().and_then(|log| host.lock(|host| host.borrow_mut().log.chunk(log))).map(ToHost::Log)
            }
        };
        // Every message fits: a test encodes the largest of each kind.
        let Some(Ok(frame)) = message.map(|message| encode_frame(&message, &mut buffer)) else { continue };
        // Ends whatever half a frame the host may still hold from before. Not sooner: on a bus that others share a board says
        // nothing until it is spoken to, and all it says is asked for.
        if core::mem::take(&mut silent) && tx.write_all(&[0]).await.is_err() {
            return;
        }
        if tx.write_all(frame).await.is_err() {
            return;
        }
    }
}
