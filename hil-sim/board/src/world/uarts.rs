//! UART connectors: the output is wired to the input, or a sensor on the body is connected.

use r4_boards::{Mount, UartDevice};

use super::World;
use crate::{
    sensors::{
        gnss::Gnss,
        tfmini_s::{self, TfminiS},
    },
    uart::UartByte,
};

/// A sensor that sends by itself, with the time of its next message, ns.
pub(super) struct Sender {
    sensor: Sensor,
    next_ns: u64,
}

enum Sensor {
    Lidar(TfminiS, Mount),
    Gnss(Gnss),
}

impl Sender {
    /// A sender whose first message is after one period.
    pub(super) fn new(device: UartDevice, seed: u64) -> Self {
        let sensor = match device {
            UartDevice::Lidar(mount) => Sensor::Lidar(TfminiS::new(seed), mount),
            UartDevice::Gnss(spec) => Sensor::Gnss(Gnss::new(spec, seed)),
        };
        Self { next_ns: sensor.period_ns(), sensor }
    }
}

impl Sensor {
    fn period_ns(&self) -> u64 {
        match self {
            Self::Lidar(..) => tfmini_s::PERIOD_NS,
            Self::Gnss(receiver) => receiver.period_ns(),
        }
    }

    /// Message of the sensor for the present state of the body.
    fn message(&mut self, at_ns: u64, world: &mut World) -> Vec<u8> {
        // the file's reader has checked that there is a body
        let (pose, twist) = (world.pose().unwrap_or_default(), world.twist().unwrap_or_default());
        match self {
            Self::Lidar(sensor, mount) => {
                let from = pose.to_world(mount.place_m);
                let direction_rad = pose.yaw_rad + mount.yaw_rad;
                let time_s = at_ns as f64 * 1e-9;
                sensor.frame(world.scene().ray_m(time_s, from, direction_rad, tfmini_s::FARTHEST_M)).to_vec()
            }
            Self::Gnss(receiver) => {
                let aerial_m = receiver.spec.place_m;
                let [forward_m_s, left_m_s] = twist.at(aerial_m);
                let (sin, cos) = libm::sincos(pose.yaw_rad);
                let speed_m_s = [cos * forward_m_s - sin * left_m_s, sin * forward_m_s + cos * left_m_s];
                receiver.sentences(at_ns, pose.to_world(aerial_m), speed_m_s).into_bytes()
            }
        }
    }
}

impl World {
    /// Sends the due messages of the sensor at a connector. Each describes the body at this call, so the receiver has
    /// to call it at [`World::next_uart_ns`].
    pub(crate) fn send_due(&mut self, connector: usize) {
        let now_ns = self.clock.now_ns();
        let Some(mut sender) = self.pins.uarts.get_mut(connector).and_then(|port| port.sender.take()) else { return };
        while sender.next_ns <= now_ns {
            let message = sender.sensor.message(sender.next_ns, self);
            self.pins.uarts[connector].line.write(sender.next_ns, &message);
            sender.next_ns += sender.sensor.period_ns();
        }
        self.pins.uarts[connector].sender = Some(sender);
    }

    /// Time of the next event at a connector, ns: a byte arrives, or a sensor sends; `None` if neither will happen.
    pub(crate) fn next_uart_ns(&self, connector: usize) -> Option<u64> {
        let port = self.pins.uarts.get(connector)?;
        let sends_ns = port.sender.as_ref().map(|sender| sender.next_ns);
        port.line.next_arrival_ns().into_iter().chain(sends_ns).min()
    }

    /// Takes a byte from the board at a connector: its stop bit ended at `at_ns`. Sensors ignore it.
    pub fn uart_sent(&mut self, connector: usize, at_ns: u64, byte: u8) {
        if let Some(port) = self.pins.uarts.get_mut(connector).filter(|port| port.sender.is_none()) {
            port.line.sent(at_ns, byte);
        }
    }

    /// Next byte that has arrived at a connector up to now; `None` if there is none.
    pub fn take_uart_arrived(&mut self, connector: usize) -> Option<UartByte> {
        self.send_due(connector);
        let now_ns = self.clock.now_ns();
        self.pins.uart(connector)?.take_arrived(now_ns)
    }

    /// Time of the next event at a connector, ns, also of a byte that is lost; `u64::MAX` if there is none.
    #[must_use]
    pub fn next_uart_arrival_ns(&self, connector: usize) -> u64 {
        self.next_uart_ns(connector).unwrap_or(u64::MAX)
    }
}
