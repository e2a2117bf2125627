//! The image on a CAN bus: its bit rate and number, which it keeps, and its way back from bus-off.

use crate::emulated::{Emu, Setup};
use r4_protocol::{
    Parameter, ParameterKey, Request, SCHEMA_HASH, ToDevice, VERSION,
    can::{Direction, Node, cut},
    frame::encode_frame,
};

const fn node(number: u8) -> Node {
    Node::new(number).expect("at most 127")
}

/// Another host greets the board with the number `to`; how many frames the board with the number `from` has answered.
async fn answers(emu: &Emu<'_>, to: Node, from: Node) -> u64 {
    let hello = Request::Hello { version: VERSION, schema: SCHEMA_HASH };
    let mut buffer = [0; _];
    let frame = encode_frame(&ToDevice::Request { seq: 1, request: hello }, &mut buffer).expect("short");
    let before = sent(emu, from);
    // Longer than a frame of 8 bytes takes at 125 kbit/s.
    const APART_NS: u64 = 1_200_000;
    let begin_ns = emu.clock.now_ns();
    for (data, at_ns) in cut(frame).zip((begin_ns + APART_NS..).step_by(APART_NS as usize)) {
        emu.emulated.can_receive(at_ns, to.identifier(Direction::ToDevice), data.to_vec());
    }
    emu.sleep_ms(100).await;
    sent(emu, from) - before
}

fn sent(emu: &Emu<'_>, node: Node) -> u64 {
    emu.emulated.can_sent(node.identifier(Direction::ToHost))
}

async fn set(emu: &Emu<'_>, parameter: Parameter, value: f32) -> Result<(), r4_driver::Error> {
    emu.host.set_parameter(ParameterKey { channel: None, parameter }, value).await
}

#[test]
fn bit_rate_and_number_are_those_that_the_board_has_kept() {
    let first = Setup::osmc_bench();
    first.bench(async |emu| {
        assert_eq!(emu.emulated.can_bit_rate(), 1e6);
        assert!(answers(emu, node(0), node(0)).await > 0);
        for (parameter, value) in [(Parameter::CanRate, 800.0), (Parameter::CanNode, 128.0)] {
            assert!(set(emu, parameter, value).await.is_err(), "{parameter} {value}");
        }
        set(emu, Parameter::CanRate, 125.0).await.expect("one of the rates");
        set(emu, Parameter::CanNode, 5.0).await.expect("in range");
        emu.host.save_parameters().await.expect("there is room");
        assert_eq!(emu.emulated.can_bit_rate(), 1e6, "taken at the next start");
    });
    let mut flash = first.last().flash().clone();
    flash.power_up();
    Setup::osmc_bench().with_flash(flash).bench(async |emu| {
        assert_eq!(emu.emulated.can_bit_rate(), 125e3);
        // Frames for the board beside it are not its own.
        for other in [0, 4] {
            assert_eq!(answers(emu, node(other), node(5)).await, 0, "{other}");
        }
        assert!(answers(emu, node(5), node(5)).await > 0);
        assert_eq!(sent(emu, node(0)), 0);
    });
}

#[test]
fn a_board_comes_back_from_bus_off() {
    Setup::osmc_bench().bench(async |emu| {
        assert!(answers(emu, node(0), node(0)).await > 0);
        emu.emulated.inject_can_bus_off();
        // 128 times 11 recessive bits, 1.4 ms, then it takes part again.
        emu.sleep_ms(5).await;
        assert!(answers(emu, node(0), node(0)).await > 0);
    });
}
