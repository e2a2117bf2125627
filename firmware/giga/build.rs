//! Build parameters of the image: the robot's configuration, the carrier's pins, the place in flash.
//!
//! | variable | value | default |
//! | --- | --- | --- |
//! | `R4_ROBOT` | a built-in robot, or the path of its file; `cargo xtask firmware` replaces its configuration by that of another robot on the same carrier | `osmc-bench` |
//! | `R4_IMAGE` | `bare`: from the start of flash; `hosted`: behind the Arduino bootloader | `bare` |

use std::{env, error::Error, fmt::Write, fs, path::PathBuf};

use r4_boards::Carrier;
use r4_protocol::image::{CODE_AT, RECORD_AT, ROBOT_AT, ROBOT_BYTES};

/// Address and size of bank 1: 8 sectors of 128 KiB (RM0399, table 15). Bank 2 holds parameters and trips, and no code.
const BANK_1: u32 = 0x0800_0000;
const BANK_1_LEN: u32 = 0x10_0000;
/// Size of the Arduino bootloader and its header: the first two sectors.
const BOOTLOADER_LEN: u32 = 0x4_0000;

fn main() -> Result<(), Box<dyn Error>> {
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let robot = variable("R4_ROBOT", "osmc-bench");
    let image = variable("R4_IMAGE", "bare");
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=memory.x.in");
    println!("cargo:rerun-if-changed=../../boards");
    if robot.ends_with(".toml") {
        println!("cargo:rerun-if-changed={robot}");
    }

    let board = r4_boards::load(&robot)?;
    board.config.validate().map_err(|problem| format!("{robot}: {problem:?}"))?;
    let mut config = postcard::to_allocvec(&board.config)?;
    if config.len() > ROBOT_BYTES {
        return Err(format!(
            "{robot}: its configuration takes {} bytes, and there is room for {ROBOT_BYTES}",
            config.len()
        )
        .into());
    }
    config.resize(ROBOT_BYTES, 0xFF);
    fs::write(out.join("config.postcard"), config)?;
    fs::write(out.join("pins.rs"), pins(&board.carrier)?)?;
    println!("cargo:rustc-env=R4_IMAGE_KIND={image}");

    let offset = match image.as_str() {
        "bare" => 0,
        "hosted" => BOOTLOADER_LEN,
        other => return Err(format!("R4_IMAGE is `bare` or `hosted`, not `{other}`").into()),
    };
    let memory = fs::read_to_string("memory.x.in")?
        .replace("@FLASH_ORIGIN@", &format!("{:#010X}", BANK_1 + offset))
        .replace("@FLASH_LENGTH@", &format!("{:#X}", BANK_1_LEN - offset))
        .replace("@RECORD_AT@", &format!("{RECORD_AT:#X}"))
        .replace("@ROBOT_AT@", &format!("{ROBOT_AT:#X}"))
        .replace("@CODE_AT@", &format!("{CODE_AT:#X}"));
    fs::write(out.join("memory.x"), memory)?;
    println!("cargo:rustc-link-search={}", out.display());
    // List of tests for probe-rs, from embedded-test.
    println!("cargo:rustc-link-arg-tests=-Tembedded-test.x");
    Ok(())
}

/// Value of an environment variable; cargo rebuilds when it changes.
fn variable(name: &str, default: &str) -> String {
    println!("cargo:rerun-if-env-changed={name}");
    env::var(name).unwrap_or_else(|_| default.to_owned())
}

/// Pins of the carrier as a macro and as numbers; see `src/pins.rs`.
fn pins(carrier: &Carrier) -> Result<String, std::fmt::Error> {
    let (mut owned, mut numbers) = (String::new(), String::new());
    for pin in &carrier.pins {
        let (id, stm32) = (&pin.id, pin.stm32);
        writeln!(owned, "    ($p:expr, {id}) => {{ $p.{stm32} }};")?;
        if let Some(signal) = &pin.signal {
            writeln!(owned, "    ($p:expr, {id} as {signal}) => {{ $p.{stm32} }};")?;
        }
        if let (Some(signal), Some(af)) = (&pin.signal, pin.af) {
            writeln!(owned, "    (af {id} as {signal}) => {{ {af}u8 }};")?;
        }
        let port = pin.stm32.port as u8 - b'A';
        let upper = id.to_uppercase();
        writeln!(numbers, "pub(crate) const {upper}: Place = Place {{ port: {port}, number: {} }};", pin.stm32.number)?;
    }
    Ok(format!("macro_rules! pin {{\n{owned}}}\n\n{numbers}"))
}
