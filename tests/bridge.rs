//! The network protocol of the R4 firmware of before, from the host's side.

use std::{io::ErrorKind, net::UdpSocket};

use crate::program::*;
use r4_links::legacy::Packet;

struct Host {
    socket: UdpSocket,
    board: String,
    number: u32,
}

impl Host {
    fn send(&mut self, packet: Packet) {
        self.number += 1;
        let text = packet.with("PNum", self.number).to_string();
        self.socket.send_to(text.as_bytes(), &self.board).expect("sent");
    }

    fn heartbeat(&mut self, answered: &Packet) {
        let time = answered.get("T").unwrap_or("0").to_owned();
        self.send(Packet::default().with("H", "ROS2-R4").with("T", time));
    }

    /// The next packet of the board; they come by themselves, so that they are this test's clock.
    fn next(&self) -> Packet {
        let mut buffer = [0; 300];
        let len = loop {
            match self.socket.recv(&mut buffer) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                received => break received.expect("a packet"),
            }
        };
        Packet::parse(&buffer[..len]).expect("a good one")
    }
}

#[test]
fn a_host_of_before_drives_the_board_until_it_is_silent() {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a port");
    socket.set_read_timeout(Some(PATIENCE)).expect("set");
    let port = socket.local_addr().expect("its address").port().to_string();
    let arguments = ["--board", "sim:openpodcar", "--json", "bridge", "legacy-udp", "--listen", "127.0.0.1:0", "--arm"];
    let bridge = start(command(&[&arguments[..], &["--for", "6", "--telemetry-port", &port]].concat()));
    let first = next(bridge.out.as_ref().expect("stdout"), bridge.begin).expect("where it listens");
    let mut host = Host { socket, board: text(&object(&first), "udp").to_owned(), number: 0 };
    host.heartbeat(&Packet::default());
    // Damaged, and once more: neither is taken.
    host.socket.send_to(b"O:4095,0,1;^0x1^", &host.board).expect("sent");
    host.number -= 1;
    host.heartbeat(&Packet::default());

    let mut duty = 0.0;
    let mut steering_v = None;
    while duty < 0.2 {
        let packet = host.next();
        host.heartbeat(&packet);
        // 1024 of 4095, backwards, on the first.
        host.send(Packet::default().with("O", "1024,1,1"));
        duty = packet.get("OSMC1").map_or(duty, |duty| -duty.parse::<f64>().expect("a number"));
        steering_v = packet.get("AINSTEER").map(|volts| volts.parse::<f64>().expect("a number")).or(steering_v);
    }
    // 0.1417 V and 46.92 V/m: somewhere on its 46.7 mm.
    assert!(steering_v.is_some_and(|volts| (0.1..2.4).contains(&volts)), "{steering_v:?}");

    let told = |what: &str| {
        let line = std::iter::from_fn(|| next(&bridge.err, bridge.begin)).find(|line| line.contains(what));
        assert!(line.is_some(), "{what}");
    };
    told("armed");
    // Silence, for longer than 0.7 s.
    told("no heartbeat of the host for 0.7 s: disarmed");
    while duty != 0.0 {
        duty = host.next().get("OSMC1").map_or(duty, |duty| duty.parse().expect("a number"));
    }
    // It has begun anew, and counts from the start.
    host.number = 0;
    host.heartbeat(&Packet::default());
    told("armed");
    told("1 damaged, 1 late");
}

#[test]
fn strangers_are_kept_out() {
    all_refused([(&["bridge", "legacy-udp", "--listen", "0.0.0.0:0"][..], &["--public"][..])]);
}
