//! Byte link with the speed of a UART: two pipes whose bytes arrive with the delay of the wire.

use std::{
    cell::RefCell,
    collections::VecDeque,
    convert::Infallible,
    future::poll_fn,
    rc::Rc,
    task::{Poll, Waker},
};

use embedded_io_async::{ErrorType, Read, Write};

use crate::{
    clock::Clock,
    uart::{LineNoise, UartByte, ns_per_byte},
};

/// Number of bytes a sender may have in transmission before it has to wait, as in a UART driver's ring buffer.
const BUFFER: usize = 1024;

/// One direction of a link.
struct Pipe {
    clock: Clock,
    ns_per_byte: u64,
    under_way: VecDeque<OnWire>,
    reader: Option<Waker>,
    noise: Option<LineNoise>,
}

/// A byte in transmission.
struct OnWire {
    /// Time at which its last bit arrives, ns.
    at_ns: u64,
    /// Byte that arrives then; `None` if noise hid it.
    byte: Option<UartByte>,
}

impl Pipe {
    /// Sends a byte that arrives at `at_ns`.
    fn push(&mut self, at_ns: u64, value: u8) {
        let sent = UartByte::clean(at_ns, value);
        let byte = self.noise.as_mut().map_or(Some(sent), |noise| noise.pass(sent));
        self.under_way.push_back(OnWire { at_ns, byte });
        if let Some(reader) = self.reader.take() {
            reader.wake();
        }
    }
}

/// The receiving end of a direction.
pub struct Receiver(Rc<RefCell<Pipe>>);

/// The sending end of a direction.
pub struct Sender(Rc<RefCell<Pipe>>);

/// One end of a link.
pub struct Port {
    /// Receiver of bytes from the other end.
    pub rx: Receiver,
    /// Sender of bytes to the other end.
    pub tx: Sender,
}

/// A full-duplex link of `baud` bits per second: its two ends.
#[must_use]
pub fn serial(clock: &Clock, baud: u32) -> (Port, Port) {
    let pipe = || {
        Rc::new(RefCell::new(Pipe {
            clock: clock.clone(),
            ns_per_byte: ns_per_byte(baud),
            under_way: VecDeque::new(),
            reader: None,
            noise: None,
        }))
    };
    let (there, back) = (pipe(), pipe());
    (Port { rx: Receiver(back.clone()), tx: Sender(there.clone()) }, Port { rx: Receiver(there), tx: Sender(back) })
}

/// Both directions of a link, for disturbances.
#[derive(Clone)]
pub struct Cable {
    to_device: Rc<RefCell<Pipe>>,
    to_host: Rc<RefCell<Pipe>>,
}

impl Cable {
    /// The cable whose far end is `device`.
    #[must_use]
    pub fn of(device: &Port) -> Self {
        Self { to_device: device.rx.0.clone(), to_host: device.tx.0.clone() }
    }

    /// Sets the bit rate from now on, bits per second.
    pub fn set_baud(&self, baud: u32) {
        for pipe in [&self.to_device, &self.to_host] {
            pipe.borrow_mut().ns_per_byte = ns_per_byte(baud);
        }
    }

    /// Disturbs bytes sent to the device from now on; `None` ends it.
    pub fn disturb_to_device(&self, noise: Option<LineNoise>) {
        self.to_device.borrow_mut().noise = noise;
    }

    /// Disturbs bytes sent to the host from now on; `None` ends it.
    pub fn disturb_to_host(&self, noise: Option<LineNoise>) {
        self.to_host.borrow_mut().noise = noise;
    }
}

/// Interface for a device with its own timing.
impl Receiver {
    /// Next byte that has arrived up to and at `now_ns`, with all receiver flags.
    pub fn take_arrived(&mut self, now_ns: u64) -> Option<UartByte> {
        let mut pipe = self.0.borrow_mut();
        loop {
            let arrived = pipe.under_way.pop_front_if(|on_wire| on_wire.at_ns <= now_ns)?;
            if arrived.byte.is_some() {
                return arrived.byte;
            }
        }
    }

    /// Arrival time of the next byte in transmission, ns; in the past for a byte that was not taken yet.
    #[must_use]
    pub fn next_arrival_ns(&self) -> Option<u64> {
        self.0.borrow().under_way.iter().find(|on_wire| on_wire.byte.is_some()).map(|next| next.at_ns)
    }

    /// Wakes `waker` once, when the next byte is sent: before it arrives.
    pub fn on_sent(&self, waker: &Waker) {
        self.0.borrow_mut().reader = Some(waker.clone());
    }
}

/// Interface for a device with its own timing.
impl Sender {
    /// Puts a byte on the wire whose stop bit ends at `at_ns`, not before that of the preceding byte. There is no flow
    /// control: that is up to the device's own transmitter.
    pub fn push(&mut self, at_ns: u64, byte: u8) {
        let mut pipe = self.0.borrow_mut();
        let at_ns = pipe.under_way.back().map_or(at_ns, |last| at_ns.max(last.at_ns));
        pipe.push(at_ns, byte);
    }
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
            let mut len = 0;
            while len < buffer.len()
                && let Some(arrived) = pipe.under_way.pop_front_if(|on_wire| on_wire.at_ns <= now_ns)
            {
                // a driver drops bytes without a stop bit
                if let Some(byte) = arrived.byte.filter(|byte| !byte.framing_error) {
                    buffer[len] = byte.value;
                    len += 1;
                }
            }
            if len > 0 || buffer.is_empty() {
                return Poll::Ready(Ok(len));
            }
            match pipe.under_way.back() {
                // the receiver sleeps until the line falls idle, as a UART with idle detection does
                Some(last) => pipe.clock.wake_at(last.at_ns, context.waker()),
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
            let on_the_wire = pipe.under_way.iter().filter(|on_wire| on_wire.at_ns > now_ns).count();
            let len = bytes.len().min(BUFFER - on_the_wire.min(BUFFER));
            if len == 0 && !bytes.is_empty() {
                let next = pipe.under_way.iter().find(|on_wire| on_wire.at_ns > now_ns);
                let drained_ns = next.map_or(now_ns, |next| next.at_ns);
                pipe.clock.wake_at(drained_ns, context.waker());
                return Poll::Pending;
            }
            let mut at_ns = pipe.under_way.back().map_or(now_ns, |last| now_ns.max(last.at_ns));
            for byte in &bytes[..len] {
                at_ns += pipe.ns_per_byte;
                pipe.push(at_ns, *byte);
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
        // 10 bytes x 10 bits at 1 Mbit/s
        assert_eq!(clock.now_ns(), 100_000);
    }

    #[test]
    fn a_device_with_its_own_timing_says_when_bytes_pass() {
        let mut simulation = Simulation::default();
        let clock = simulation.clock();
        let (mut host, mut device) = serial(&clock, 1_000_000);
        simulation.block_on(async { host.tx.write_all(b"ab").await }).unwrap().unwrap();
        assert_eq!(device.rx.next_arrival_ns(), Some(10_000));
        assert_eq!(device.rx.take_arrived(9_999), None);
        assert_eq!(device.rx.take_arrived(50_000), Some(UartByte::clean(10_000, b'a')));
        assert_eq!(device.rx.take_arrived(50_000), Some(UartByte::clean(20_000, b'b')));
        assert_eq!((device.rx.take_arrived(50_000), device.rx.next_arrival_ns()), (None, None));
        // 8.68 us a byte; the second one cannot end before the first
        device.tx.push(8_680, b'x');
        device.tx.push(8_000, b'y');
        device.tx.push(17_360, b'z');
        let mut buffer = [0; 3];
        simulation.block_on(async { host.rx.read_exact(&mut buffer).await }).unwrap().unwrap();
        assert_eq!((&buffer, clock.now_ns()), (b"xyz", 17_360));
    }

    /// Every byte on an inverted line loses its start bit; spikes only set a flag.
    #[test]
    fn noise_acts_on_what_is_sent_after_it_began() {
        let mut simulation = Simulation::default();
        let clock = simulation.clock();
        let (mut host, mut device) = serial(&clock, 1_000_000);
        let cable = Cable::of(&device);
        simulation.block_on(async { host.tx.write_all(b"a").await }).unwrap().unwrap();
        cable.disturb_to_device(Some(LineNoise::new(1.0, 0.0, 1)));
        simulation.block_on(async { host.tx.write_all(b"b").await }).unwrap().unwrap();
        cable.disturb_to_device(Some(LineNoise::new(0.0, 1.0, 1)));
        simulation.block_on(async { host.tx.write_all(b"c").await }).unwrap().unwrap();
        assert_eq!(device.rx.take_arrived(30_000), Some(UartByte::clean(10_000, b'a')));
        assert_eq!(device.rx.next_arrival_ns(), Some(30_000));
        let spiked = UartByte { noise: true, ..UartByte::clean(30_000, b'c') };
        assert_eq!(device.rx.take_arrived(30_000), Some(spiked));
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
