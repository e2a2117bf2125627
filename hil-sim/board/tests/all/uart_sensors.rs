//! Sensors on the body that send at a UART connector, read by a host through the board.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use r4_boards::{GnssOrigin, Mount, Robot, SimulatedGnss, SimulatedUart, UartDevice};
use r4_protocol::{ChannelId, ChannelKind, Mode};

use crate::harness::{Bench, MS, bench};

/// A wall 3 m in front of the robot's middle, a lidar 0.2 m in front of it, and an error-free receiver at the world's
/// origin.
fn robot() -> Robot {
    let mut robot = r4_boards::load("openscout").expect("built in");
    robot.simulation.scene.add_walls(&[[3.0, -5.0], [3.0, 5.0]], false).unwrap();
    let lidar = UartDevice::Lidar(Mount { place_m: [0.2, 0.0], yaw_rad: 0.0 });
    let origin = GnssOrigin { latitude_deg: 53.2, longitude_deg: -0.5, height_m: 40.0 };
    let gnss = SimulatedGnss { origin, rate_hz: 10, deviation_m: 0.0, correlation_s: 60.0, place_m: [0.0; 2] };
    let uart = |port, device| SimulatedUart { port, device };
    robot.simulation.uarts = vec![uart(0, lidar), uart(1, UartDevice::Gnss(gnss))];
    robot
}

/// Drives forwards for `ms`, and discards the bytes that arrive meanwhile.
async fn drive(bench: &Bench<'_>, port: u8, ms: u64) {
    bench.host.arm().await.unwrap();
    for index in 0..4 {
        bench.set(ChannelId::new(ChannelKind::Dhb, index), Mode::Speed, 4.0).await.unwrap();
    }
    bench.sleep_ms(ms).await;
    while !bench.host.uart_read(port).await.unwrap().is_empty() {}
}

/// Bytes that arrive at a connector within `ms`, read every 5 ms: a board buffers 22 ms of them.
async fn received(bench: &Bench<'_>, port: u8, ms: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    for _ in 0..ms / 5 {
        bench.sleep_ms(5).await;
        bytes.extend(bench.host.uart_read(port).await.unwrap());
    }
    bytes
}

#[test]
fn a_lidar_sees_the_wall_that_the_robot_drives_towards() {
    bench(&robot(), async |bench| {
        drive(bench, 0, 2000).await;
        let begin_ns = bench.clock.now_ns();
        let bytes = received(bench, 0, 500).await;
        let periods = (bench.clock.now_ns() - begin_ns) / (10 * MS);
        let mut distances_m = Vec::new();
        let mut rest = &bytes[..];
        while let Some(at) = rest.windows(2).position(|pair| pair == [0x59, 0x59]) {
            let Some(frame) = rest.get(at..at + 9) else { break };
            let sum = frame[..8].iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte));
            if sum == frame[8] {
                distances_m.push(f64::from(u16::from_le_bytes([frame[2], frame[3]])) / 100.0);
                rest = &rest[at + 9..];
            } else {
                rest = &rest[at + 1..];
            }
        }
        // 100 a second; the first and the last may be truncated
        assert!(distances_m.len().abs_diff(periods as usize) <= 2, "{} in {periods}", distances_m.len());
        let twist = bench.board.world().twist().unwrap();
        let pose = bench.board.world().pose().unwrap();
        let [first, last] =
            [&distances_m[..20], &distances_m[distances_m.len() - 20..]].map(|part| part.iter().sum::<f64>() / 20.0);
        // Noise of 0.02 m is 4.5 mm in a mean of 20. The last mean is 0.1 s old, and 0.3 s newer than the first.
        let ahead_m = 3.0 - (pose.x_m + 0.2) + 0.1 * twist.forward_m_s;
        assert!((last - ahead_m).abs() < 0.03, "{last} m, {ahead_m} m");
        assert!((first - last - 0.3 * twist.forward_m_s).abs() < 0.03, "{first} m, {last} m");
    });
}

#[test]
fn a_receiver_follows_the_robot_over_the_ground() {
    bench(&robot(), async |bench| {
        drive(bench, 1, 4000).await;
        let text = String::from_utf8(received(bench, 1, 400).await).unwrap();
        let pose = bench.board.world().pose().unwrap();
        let lines: Vec<&str> = text.lines().collect();
        let place = |line: &str| {
            let fields: Vec<&str> = line.split(',').collect();
            let minutes = fields[4].strip_prefix("000").unwrap().parse::<f64>().unwrap();
            (30.0 - minutes) / 60.0
        };
        // west of Greenwich: eastwards the longitude falls towards 0
        let last = lines.iter().rev().find(|line| line.starts_with("$GPGGA") && line.contains('*')).unwrap();
        // a degree on the parallel of 53.2 degrees, by WGS 84: 6 378 137 m / sqrt(1 - e² sin²) cos pi / 180
        let east_m = place(last) * 66_826.57;
        // a position every 0.1 s, at 0.22 m/s; digits of 1 cm
        assert!((east_m - pose.x_m).abs() < 0.05, "{east_m} m, {} m", pose.x_m);
        assert!(lines.iter().any(|line| line.starts_with("$GPRMC")), "{text}");
        // the sensor ignores bytes, and nothing is echoed
        bench.host.uart_write(1, b"hello").await.unwrap();
        let after = received(bench, 1, 100).await;
        assert!(!String::from_utf8_lossy(&after).contains("hello"));
    });
}
