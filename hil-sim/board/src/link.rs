//! A byte link with the speed of a UART: two pipes whose bytes arrive when they would.

use std::{
    cell::RefCell,
    collections::VecDeque,
    convert::Infallible,
    future::poll_fn,
    rc::Rc,
    task::{Poll, Waker},
};

use embedded_io_async::{ErrorType, Read, Write};

use crate::clock::Clock;

/// Bits on the wire for one byte: start, eight data, stop.
const BITS_PER_BYTE: u64 = 10;
/// Bytes a sender may have under way before it has to wait, as in a UART driver's ring buffer.
const BUFFER: usize = 1024;

/// One direction of a link.
struct Pipe {
    clock: Clock,
    ns_per_byte: u64,
    /// Byte and the moment its last bit arrives.
    under_way: VecDeque<(u64, u8)>,
    reader: Option<Waker>,
}

/// The receiving end of a direction.
pub struct Receiver(Rc<RefCell<Pipe>>);

/// The sending end of a direction.
pub struct Sender(Rc<RefCell<Pipe>>);

/// One end of a link.
pub struct Port {
    /// What comes from the other end.
    pub rx: Receiver,
    /// What goes to the other end.
    pub tx: Sender,
}

/// A full-duplex link of `baud` bits per second: its two ends.
#[must_use]
pub fn serial(clock: &Clock, baud: u32) -> (Port, Port) {
    let pipe = || {
        Rc::new(RefCell::new(Pipe {
            clock: clock.clone(),
            ns_per_byte: BITS_PER_BYTE * 1_000_000_000 / u64::from(baud.max(1)),
            under_way: VecDeque::new(),
            reader: None,
        }))
    };
    let (there, back) = (pipe(), pipe());
    (Port { rx: Receiver(back.clone()), tx: Sender(there.clone()) }, Port { rx: Receiver(there), tx: Sender(back) })
}

impl ErrorType for Receiver {
    type Error = Infallible;
}

impl ErrorType for Sender {
    type Error = Infallible;
}

impl Read for Receiver {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|context| {
            let mut pipe = self.0.borrow_mut();
            let now_ns = pipe.clock.now_ns();
            let arrived = pipe.under_way.iter().take_while(|(at_ns, _)| *at_ns <= now_ns).count();
            let len = arrived.min(buffer.len());
            if len > 0 || buffer.is_empty() {
                for (slot, (_, byte)) in buffer.iter_mut().zip(pipe.under_way.drain(..len)) {
                    *slot = byte;
                }
                return Poll::Ready(Ok(len));
            }
            match pipe.under_way.back() {
                // A receiver that sleeps until the line falls idle, as a UART with idle detection does.
                Some((last_ns, _)) => pipe.clock.wake_at(*last_ns, context.waker()),
                None => pipe.reader = Some(context.waker().clone()),
            }
            Poll::Pending
        })
        .await
    }
}

impl Write for Sender {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        poll_fn(|context| {
            let mut pipe = self.0.borrow_mut();
            let now_ns = pipe.clock.now_ns();
            let on_the_wire = pipe.under_way.iter().filter(|(at_ns, _)| *at_ns > now_ns).count();
            let len = bytes.len().min(BUFFER - on_the_wire.min(BUFFER));
            if len == 0 && !bytes.is_empty() {
                let drained_ns = pipe.under_way.iter().find(|(at_ns, _)| *at_ns > now_ns).map_or(now_ns, |(at, _)| *at);
                pipe.clock.wake_at(drained_ns, context.waker());
                return Poll::Pending;
            }
            let mut at_ns = pipe.under_way.back().map_or(now_ns, |(at_ns, _)| now_ns.max(*at_ns));
            for byte in &bytes[..len] {
                at_ns += pipe.ns_per_byte;
                pipe.under_way.push_back((at_ns, *byte));
            }
            if let Some(reader) = pipe.reader.take() {
                reader.wake();
            }
            Poll::Ready(Ok(len))
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Simulation;

    #[test]
    fn bytes_take_their_time_and_stay_in_order() {
        let mut simulation = Simulation::default();
        let clock = simulation.clock();
        let (mut host, mut device) = serial(&clock, 1_000_000);
        let received = simulation.block_on(async {
            host.tx.write_all(b"0123456789").await.unwrap();
            let mut received = Vec::new();
            while received.len() < 10 {
                let mut buffer = [0; 4];
                let len = device.rx.read(&mut buffer).await.unwrap();
                received.extend_from_slice(&buffer[..len]);
            }
            received
        });
        assert_eq!(received.as_deref(), Some(&b"0123456789"[..]));
        // 10 bytes x 10 bits at 1 Mbit/s.
        assert_eq!(clock.now_ns(), 100_000);
    }

    #[test]
    fn a_sender_waits_for_a_slow_line() {
        let mut simulation = Simulation::default();
        let clock = simulation.clock();
        let (mut host, _device) = serial(&clock, 9600);
        simulation.block_on(async { host.tx.write_all(&[7; 2048]).await }).unwrap().unwrap();
        // Half of it had to leave before the rest found room: 1024 bytes of 1.04 ms.
        assert!(clock.now_ns() > 1_000_000_000, "{}", clock.now_ns());
    }
}
