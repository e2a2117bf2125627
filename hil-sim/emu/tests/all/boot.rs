//! Boot of the board from its image: identity, lights, pins, and no misuse of a chip.

use std::process::Command;

use crate::emulated::{Setup, image};
use r4_mcu::{
    Level, Pin,
    cpu::{Core, Register},
    peripherals::gpio::Mode,
};
use r4_protocol::{Causes, SafetyState};
use r4_sim::Lights;

#[test]
fn the_board_comes_up_and_a_host_connects() {
    let setup = Setup::osmc_bench();
    setup.bench(async |emu| {
        assert_eq!(&emu.host.info().robot[..], "osmc-bench");
        assert_eq!(emu.safety().await, (SafetyState::Disarmed, Causes::NONE));
        assert_eq!(emu.board.lights(), Lights { red: false, green: false, blue: true });
        emu.host.arm().await.expect("nothing is wrong");
        emu.sleep_ms(20).await;
        assert_eq!(emu.board.lights(), Lights { red: false, green: true, blue: true });
        emu.host.disarm().await.expect("always");
        emu.sleep_ms(20).await;
        assert_eq!(emu.board.lights(), Lights { red: false, green: false, blue: true });
    });
}

/// The image starts behind the bootloader: the bootloader's first sector is empty here, and the chip starts where the
/// bootloader would jump to.
#[test]
fn the_hosted_image_starts_behind_the_bootloader() {
    let setup = Setup::of(r4_boards::load("osmc-bench").expect("built in"), image("osmc-bench", "hosted"));
    assert_eq!(setup.image().start(), Some(0x0804_0000));
    assert_eq!(image("osmc-bench", "bare").start(), Some(0x0800_0000));
    setup.bench(async |emu| {
        assert_eq!(&emu.host.info().robot[..], "osmc-bench");
        emu.host.arm().await.expect("nothing is wrong");
        assert_eq!(emu.safety().await, (SafetyState::Armed, Causes::NONE));
        let pc = emu.emulated.machine().core.get(Register::Pc);
        assert!((0x0804_0000..0x0810_0000).contains(&pc), "{pc:#010x} is not in the image");
    });
}

/// The loaded bytes are those of the file, with the same SHA-256 digest.
#[test]
fn the_image_is_the_file() {
    let image = image("osmc-bench", "bare");
    let output = Command::new("sha256sum").arg(image.path()).output().expect("coreutils");
    let told = String::from_utf8(output.stdout).expect("ASCII");
    assert_eq!(told.split(' ').next(), Some(&image.digest()[..]));
    assert_eq!(std::fs::read(image.path()).expect("it is there"), image.elf());
}

/// Each pin of the carrier is configured as its file states, and no other pin is driven: a driven input would work
/// against its sensor, a driven free pin against whatever is plugged in.
#[test]
fn every_pin_is_what_the_carriers_file_says_and_no_other_is_driven() {
    for robot in ["osmc-bench", "every-interface"] {
        let setup = Setup::new(robot);
        setup.bench(async |emu| {
            for armed in [false, true] {
                if armed {
                    emu.host.arm().await.expect("nothing is wrong");
                    emu.sleep_ms(100).await;
                }
                let machine = emu.emulated.machine();
                let gpio = machine.chip.gpio();
                let mut wrong = Vec::new();
                for (port, number) in ('A'..='K').flat_map(|port| (0..16).map(move |number| (port, number))) {
                    let pin = Pin::new(port, number);
                    let mode = gpio.mode(pin);
                    let carrier = &setup.robot().carrier;
                    let known =
                        carrier.pins.iter().find(|known| (known.stm32.port, known.stm32.number) == (port, number));
                    let right = match known {
                        Some(known) => is_right(&known.id, known.af, mode, gpio.alternate(pin)),
                        None => is_debugger(pin) || !is_driven(gpio.driven(pin)) && mode != Mode::Output,
                    };
                    if !right {
                        let name = known.map_or("free", |known| &known.id);
                        wrong.push(format!("{pin} ({name}): {mode:?}, {:?}", gpio.alternate(pin)));
                    }
                }
                assert_eq!(wrong, Vec::<String>::new(), "{robot}, armed: {armed}");
            }
        });
    }
}

/// Returns true for the debugger's pins: PA13, PA14, PA15, PB3, PB4 have its functions after reset (RM0399, 12.3.2).
fn is_debugger(pin: Pin) -> bool {
    [('A', 13), ('A', 14), ('A', 15), ('B', 3), ('B', 4)]
        .into_iter()
        .any(|(port, number)| pin == Pin::new(port, number))
}

fn is_driven(level: Level) -> bool {
    matches!(level, Level::Low | Level::High)
}

/// Checks a pin's configuration by its id: outputs are the pins that the carrier wires to inputs of other parts.
fn is_right(id: &str, af: Option<u8>, mode: Mode, alternate: Option<u8>) -> bool {
    const OUTPUTS: [&str; 14] = [
        "osmc_dis",
        "pca_oe_n",
        "dac_ldac_n",
        "heartbeat_out",
        "led_r",
        "led_g",
        "led_b",
        "step_en",
        "dir",
        "us0_trig",
        "us1_trig",
        "us2_trig",
        "us3_trig",
        "tft_",
    ];
    const INPUTS: [&str; 6] = ["dmh_sense", "estop_in", "enc3_", "us2_echo", "us3_echo", "btn"];
    let begins = |with: &[&str]| with.iter().any(|start| id.starts_with(start));
    let switch = id.starts_with("enc") && id.ends_with("_sw");
    if begins(&INPUTS) || switch {
        // A pin of an interface that the robot does not have stays as after reset.
        return matches!(mode, Mode::Input | Mode::Analog);
    }
    match af {
        Some(af) => alternate.is_none_or(|alternate| alternate == af) && mode != Mode::Output || mode == Mode::Analog,
        None if id.starts_with("ain") => mode == Mode::Analog,
        None => mode == Mode::Analog || mode == Mode::Output && begins(&OUTPUTS) || mode == Mode::Input,
    }
}
