//! Hosts of unsupported protocol versions, with recorded traffic: the board reports the mismatch, and nothing moves.

use crate::harness::{Device, RawHost, osmc_bench, raw_bench};
use r4_protocol::{Refusal, Reply, SCHEMA_HASH, SafetyState, ToHost, VERSION};

#[path = "../../../../protocol/tests/golden/tables.rs"]
mod tables;

use tables::{GOLDEN, SESSION, rows};

fn mismatch() -> Refusal {
    Refusal::ProtocolMismatch { version: VERSION, schema: SCHEMA_HASH }
}

fn nothing_moved(device: &Device) {
    let robot = osmc_bench();
    for (motor, simulated) in robot.config.motors.iter().zip(&robot.simulation.motors) {
        let position = device.board.world().position(motor.id).expect("the bench has it");
        assert!(position == simulated.start && device.duty(motor.id) == 0.0, "{} at {position}", motor.id);
    }
}

/// Messages of the board in the 2 ms after `bytes`.
async fn heard(host: &mut RawHost, bytes: &[u8]) -> Vec<ToHost> {
    host.send_bytes(bytes).await;
    host.listen(2).await
}

#[test]
fn a_host_of_version_4_is_told_the_boards_version() {
    raw_bench(&osmc_bench(), async |host, device| {
        host.listen(5).await;
        let [hello] = &rows(SESSION, "hello")[..] else { panic!("one row") };
        let told = heard(host, hello).await;
        assert_eq!(told, [ToHost::Response { seq: 0, result: Err(mismatch()) }]);
        // then continues as if the refusal had not arrived: arms, commands half of the supply
        let said = rows(SESSION, "host");
        assert!(said.len() > 10, "a whole session");
        for bytes in said {
            for message in heard(host, &bytes).await {
                let ToHost::Response { result, .. } = message else { panic!("{message:?} without a session") };
                // the goodbye at the end is accepted from any host
                let refused = matches!(result, Err(Refusal::NoSession | Refusal::UnknownMessage) | Ok(Reply::Done));
                assert!(refused || result == Err(mismatch()), "{result:?}");
            }
            nothing_moved(device);
        }
        assert_eq!(host.hello().await.state, SafetyState::Disarmed);
    });
}

/// The messages reach a session of a current host: bytes that another host left on the line, or a replayed recording.
#[test]
fn no_message_of_an_older_version_moves_anything() {
    raw_bench(&osmc_bench(), async |host, device| {
        host.listen(5).await;
        for (version, golden) in (1..).zip(GOLDEN) {
            let said = rows(golden, "to-device");
            assert!(said.len() > 30, "version {version}: {} messages", said.len());
            let (mut done, mut answers) = (0, 0);
            for bytes in &said {
                for message in heard(host, bytes).await {
                    let ToHost::Response { result, .. } = message else { panic!("{message:?} to {bytes:02x?}") };
                    answers += 1;
                    match result {
                        // commands have another checksum, and no version has the requests of all others
                        Err(Refusal::NoSession | Refusal::UnknownMessage) => {}
                        Ok(Reply::Done) => done += 1,
                        Err(refusal) => assert_eq!(refusal, mismatch()),
                        Ok(reply) => panic!("{reply:?} to {bytes:02x?}"),
                    }
                }
                nothing_moved(device);
            }
            // stop and goodbye; heartbeats and cycles are not answered
            assert_eq!(done, 2, "version {version}");
            assert!(answers > 20 && answers < said.len(), "version {version}: {answers} answers to {}", said.len());
        }
        assert_eq!(host.hello().await.state, SafetyState::Tripped);
    });
}

/// Messages from boards to hosts are not accepted by a board.
#[test]
fn no_answer_of_an_older_version_moves_anything() {
    raw_bench(&osmc_bench(), async |host, device| {
        host.hello().await;
        for bytes in GOLDEN.iter().flat_map(|golden| rows(golden, "to-host")) {
            host.send_bytes(&bytes).await;
            host.listen(2).await;
            nothing_moved(device);
        }
    });
}
