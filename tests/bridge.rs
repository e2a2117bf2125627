//! Tests of the previous R4 firmware's network protocol, from the host's side, with the packets of the published nodes.

use std::{io::ErrorKind, net::UdpSocket};

use crate::program::*;
use r4_links::legacy::LONGEST;

/// The published nodes: `R4-Websockets-Client.py`, which answers heartbeats, and `R4_Receiver.py`, which sends commands
/// from a port of its own and numbers them from 2 (Rak-r/OpenPodCar_V2).
struct Host {
    client: UdpSocket,
    receiver: UdpSocket,
    board: String,
    number: u32,
    /// True while heartbeats are answered.
    alive: bool,
    duty: f64,
    steering_v: f64,
}

impl Host {
    fn sealed(fields: &str) -> String {
        let mut crc = !0_u32;
        for byte in fields.bytes().chain([b'^']) {
            crc ^= u32::from(byte);
            for _ in 0..8 {
                crc = if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
            }
        }
        format!("{fields}^{:#x}^", !crc)
    }

    /// Sends a command as the receiver does for one on its topic.
    fn command(&mut self, data: &str) {
        self.number += 1;
        self.numbered(data, self.number);
    }

    fn numbered(&self, data: &str, number: u32) {
        let packet = Self::sealed(&format!("{data};PNum:{number};T:1692316800000;"));
        self.receiver.send_to(packet.as_bytes(), &self.board).expect("sent");
    }

    /// Reads the next packet of the board as the client does. Packets come without being asked for, so they are this
    /// test's clock.
    fn next(&mut self) {
        let mut buffer = [0; 300];
        let len = loop {
            match self.client.recv(&mut buffer) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                received => break received.expect("a packet"),
            }
        };
        assert!(len <= LONGEST, "the client reads so much of it");
        let text = std::str::from_utf8(&buffer[..len]).expect("text");
        // The data end before the last `;`, and the checksum is between the two `^`.
        let (data, end) = text.rsplit_once(';').expect("fields");
        assert_eq!(Self::sealed(&format!("{data};")), format!("{data};{end}"));
        let field = |key: &str| data.split(';').find_map(|part| part.strip_prefix(key)?.strip_prefix(':'));
        let time = field("T").expect("a time stamp");
        assert!(field("PNum").is_some_and(|number| number.parse::<u32>().is_ok()), "{data}");
        if data.split(';').any(|part| part == "H:R4-ROS2") {
            if self.alive {
                let answer = Self::sealed(&format!("H:ROS2-R4;T:{time};"));
                self.client.send_to(answer.as_bytes(), &self.board).expect("sent");
            }
        } else {
            self.duty = field("OSMC1").expect("a duty").parse().expect("a number");
            self.steering_v = field("AINSTEER").expect("the steering").parse().expect("a number");
        }
    }

    fn until(&mut self, reached: impl Fn(&Self) -> bool) {
        while !reached(self) {
            self.next();
        }
    }
}

/// Starts a bridge in front of a simulated vehicle, and its host.
fn bridge(options: &[&str]) -> (Running, Host) {
    let client = UdpSocket::bind("127.0.0.1:0").expect("a port");
    client.set_read_timeout(Some(PATIENCE)).expect("set");
    let port = client.local_addr().expect("its address").port().to_string();
    let arguments = ["--board", "sim:openpodcar", "--json", "bridge", "legacy-udp", "--listen", "127.0.0.1:0", "--arm"];
    let bridge = start(command(&[&arguments[..], &["--telemetry-port", &port], options].concat()));
    let first = next(bridge.out.as_ref().expect("stdout"), bridge.begin).expect("where it listens");
    let host = Host {
        client,
        receiver: UdpSocket::bind("127.0.0.1:0").expect("a port"),
        board: text(&object(&first), "udp").to_owned(),
        number: 1,
        alive: true,
        duty: 0.0,
        steering_v: f64::NAN,
    };
    (bridge, host)
}

/// Returns the lines on stderr up to the next one with `what` in it.
fn told(bridge: &Running, what: &str) -> Vec<String> {
    let mut lines = Vec::new();
    while let Some(line) = next(&bridge.err, bridge.begin) {
        let found = line.contains(what);
        lines.push(line);
        if found {
            return lines;
        }
    }
    panic!("{what} is not in {lines:#?}");
}

#[test]
fn the_published_nodes_drive_the_vehicle_and_stop_it() {
    let (bridge, mut host) = bridge(&[]);
    // The very first command, and only once: it is carried out when the client has answered a heartbeat. 4095 is more
    // than the actuator may get.
    host.command("D:4095,0,1");
    host.until(|host| !host.steering_v.is_nan());
    let centre_v = host.steering_v;
    host.until(|host| host.steering_v > centre_v + 0.1);
    // The other direction, and into the dead band of the node.
    host.command("D:4095,1,1");
    host.until(|host| host.steering_v < centre_v);
    host.command("D:0,1,1");

    // 2200 of 4095 is more than the drive may get: 0.5.
    host.command("O:2000,0,1");
    host.until(|host| host.duty > 0.48);
    host.command("O:2200,1,1");
    host.until(|host| host.duty < -0.49);
    assert!(host.duty > -0.51, "{}", host.duty);
    // Not of this protocol: the vehicle must not go on backwards.
    for bad in ["O:4096,1,1", "O:2000.5,1,1", "O:1000,2,1", "O:1000"] {
        host.command("O:1000,1,1");
        host.until(|host| host.duty < -0.2);
        host.command(bad);
        host.until(|host| host.duty == 0.0);
    }
    // Nor after a packet that may come from a host that began to count anew.
    host.command("O:1000,1,1");
    host.until(|host| host.duty < -0.2);
    // A packet with a lower number is late only right after the higher one.
    host.command("O:1100,1,1");
    host.numbered("O:500,0,1", host.number - 1);
    host.until(|host| host.duty == 0.0);
    // After a stray packet far ahead, the host's next one is taken all the same.
    host.numbered("O:300,1,1", host.number + 1000);
    host.until(|host| host.duty < -0.05);
    host.command("O:800,0,1");
    host.until(|host| host.duty > 0.15);
    // A stop takes effect whatever its number.
    host.numbered("S:Stop", 1);
    host.until(|host| host.duty == 0.0);
    host.command("O:800,0,1");
    let said = told(&bridge, "osmc0 is stopped: the board has tripped");
    for (what, times) in
        [("conform to the protocol (reported once)", 1), ("higher number (reported once)", 1), ("clear the trip", 1)]
    {
        assert_eq!(said.iter().filter(|line| line.contains(what)).count(), times, "{what}: {said:#?}");
    }
}

#[test]
fn a_host_that_is_silent_drives_nothing_and_may_come_back() {
    let (bridge, mut host) = bridge(&["--host", "127.0.0.1", "--for", "8"]);
    // The client is silent until the board has sent something.
    host.until(|host| !host.steering_v.is_nan());
    told(&bridge, "heartbeat of a host: armed");
    // Damaged, of no meaning to the board, and sent twice.
    host.receiver.send_to(b"O:4095,0,1;^0x1^", &host.board).expect("sent");
    host.command("O:1000,0,1");
    host.numbered("O:1000,0,1", host.number);
    host.until(|host| host.duty > 0.2);
    host.alive = false;
    host.until(|host| host.duty == 0.0);
    // A command that came too long before the heartbeat is not carried out after it.
    host.command("O:1000,0,1");
    // At 25 packets a second, 30 take more than 0.7 s.
    for _ in 0..30 {
        host.next();
    }
    host.alive = true;
    for _ in 0..30 {
        host.next();
    }
    told(&bridge, "no heartbeat from the host for 0.7 s: disarmed");
    let again = told(&bridge, "heartbeat of a host: armed");
    assert!(again.iter().all(|line| !line.contains("disarmed")), "said once: {again:#?}");
    assert_eq!(host.duty, 0.0);
    let seen = rest(&bridge.err, bridge.begin);
    assert!(seen.contains("1 damaged, 1 late or duplicate, 0 from other hosts, 1 commands failed"), "{seen}");
}

#[test]
fn strangers_are_kept_out() {
    all_refused([(&["bridge", "legacy-udp", "--listen", "0.0.0.0:0"][..], &["--public"][..])]);
}
