//! Task `cargo xtask size`: the size and speed of the image for the Giga, against their budgets.

use std::{
    fmt,
    path::Path,
    process::{Command, ExitCode, Stdio},
};

use serde_json::{Value, json};

use crate::{
    firmware::Firmware,
    image::{Image, Symbol},
    toolchain,
};

/// Budget of flash, bytes: bank 1 without the two sectors of the Arduino bootloader, behind which the image must fit.
const FLASH_BUDGET: u32 = 768 * 1024;
/// Budget of RAM without the stack, bytes, of 512 KiB of AXI SRAM, 32 KiB of DTCM and 64 KiB of SRAM4.
const RAM_BUDGET: u32 = 128 * 1024;
/// Number of large symbols that are listed.
const BIGGEST: usize = 10;

/// Options of `cargo xtask size`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Size {
    robot: String,
    json: bool,
}

impl Size {
    /// Reads the words after `size`.
    ///
    /// # Errors
    /// The word that is no option.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        let mut size = Self { robot: "osmc-bench".into(), json: false };
        let mut words = words.iter();
        while let Some(word) = words.next() {
            match *word {
                "--robot" => size.robot = (*words.next().ok_or("`--robot` needs a value")?).into(),
                "--json" => size.json = true,
                other => return Err(format!("`size` takes no `{other}`")),
            }
        }
        Ok(size)
    }

    /// Builds the image, measures it and prints the result. Fails when it is over a budget.
    pub(crate) fn run(&self, root: &Path) -> ExitCode {
        let report = match self.report(root) {
            Ok(report) => report,
            Err(problem) => {
                eprintln!("error: {problem}");
                return ExitCode::FAILURE;
            }
        };
        if self.json {
            println!("{:#}", report.json());
        } else {
            println!("{report}");
        }
        if report.fits() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
    }

    fn report(&self, root: &Path) -> Result<Report, String> {
        let built = Firmware::new(&self.robot, "bare").build(root)?;
        let measured = measured(root, &self.robot, &built.path)?;
        Ok(Report { robot: self.robot.clone(), image: built.image, measured })
    }
}

/// Measurements of the running image, as `r4 bench firmware` reports them.
#[derive(Clone, Debug, PartialEq)]
struct Measured {
    /// Stack sizes `[{"executor", "reserved", "used"}]`, in bytes.
    stacks: Value,
    /// Instructions `{"median", "max", "p999"}` of the ticks of the control loop.
    control_tick_instructions: Value,
    /// Budget of instructions for 99.9 % of these ticks.
    tick_budget: f64,
}

impl Measured {
    fn read(json: &[u8]) -> Option<Self> {
        let mut json: Value = serde_json::from_slice(json).ok()?;
        let mut field = |name| json.get_mut(name).map(Value::take).filter(|value| !value.is_null());
        Some(Self {
            stacks: field("stacks")?,
            control_tick_instructions: field("control_tick_instructions")?,
            tick_budget: field("limits")?["tick_p999"].as_f64()?,
        })
    }

    /// Returns whether 99.9 % of the control ticks are within their budget.
    fn fits(&self) -> bool {
        self.control_tick_instructions["p999"].as_f64().is_some_and(|instructions| instructions <= self.tick_budget)
    }
}

/// Runs the image on the emulated processor.
///
/// # Errors
/// The run gave no measurements; the program has printed the reason. Limits that the run exceeds are no error here.
fn measured(root: &Path, robot: &str, elf: &Path) -> Result<Measured, String> {
    let output = Command::new(toolchain::cargo())
        .args(["run", "--quiet", "--release", "--package", "r4", "--features", "emu", "--"])
        .args(["bench", "firmware", "--json", "--board", &format!("emu:{robot}")])
        .env("R4_ELF", elf)
        .current_dir(root)
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| format!("cargo does not start: {error}"))?;
    Measured::read(&output.stdout).ok_or("stacks and instructions are not measured: see above".into())
}

/// Result of all measurements.
struct Report {
    robot: String,
    image: Image,
    measured: Measured,
}

impl Report {
    fn fits(&self) -> bool {
        self.image.sizes.flash() <= FLASH_BUDGET && self.image.sizes.ram() <= RAM_BUDGET && self.measured.fits()
    }

    fn biggest(&self) -> &[Symbol] {
        &self.image.symbols[..self.image.symbols.len().min(BIGGEST)]
    }

    fn json(&self) -> Value {
        let biggest =
            |symbol: &Symbol| json!({ "name": symbol.name, "bytes": symbol.bytes, "memory": symbol.memory.name() });
        let Measured { stacks, control_tick_instructions, tick_budget } = &self.measured;
        json!({
            "robot": self.robot,
            "flash_bytes": self.image.sizes.flash(),
            "flash_budget_bytes": FLASH_BUDGET,
            "ram_bytes": self.image.sizes.ram(),
            "ram_budget_bytes": RAM_BUDGET,
            "stacks": stacks,
            "control_tick_instructions": control_tick_instructions,
            "control_tick_budget_p999": tick_budget,
            "biggest": self.biggest().iter().map(biggest).collect::<Vec<_>>(),
        })
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sizes = self.image.sizes;
        writeln!(f, "the image for {}, in bytes", self.robot)?;
        for (memory, bytes, budget) in [("flash", sizes.flash(), FLASH_BUDGET), ("RAM", sizes.ram(), RAM_BUDGET)] {
            let rest = match budget.checked_sub(bytes) {
                Some(free) => format!("{free} free"),
                None => format!("{} TOO MANY", bytes - budget),
            };
            writeln!(f, "  {memory:<5} {bytes:>7} of {budget:>7}, {rest}")?;
        }
        writeln!(f, "the biggest")?;
        for Symbol { name, bytes, memory } in self.biggest() {
            writeln!(f, "  {bytes:>7} {:<13} {name}", memory.name())?;
        }
        let Measured { stacks, control_tick_instructions, tick_budget } = &self.measured;
        writeln!(f, "stacks, in bytes")?;
        for stack in stacks.as_array().into_iter().flatten() {
            let field = |name: &str| stack.get(name).map(Value::to_string).unwrap_or_default();
            writeln!(f, "  {:>7} of {:>7} {}", field("used"), field("reserved"), field("executor"))?;
        }
        let field = |name: &str| control_tick_instructions.get(name).map(Value::to_string).unwrap_or_default();
        let (median, p999) = (field("median"), field("p999"));
        let verdict = if self.measured.fits() { "" } else { ", TOO MANY" };
        write!(f, "instructions of a control tick: median {median}, 99.9 % {p999} of {tick_budget}{verdict}")
    }
}

#[cfg(test)]
mod tests {
    use crate::image::{Memory, Sizes};

    use super::*;

    fn report(text: u32, bss: u32, measured: Measured) -> Report {
        let symbol = |index: u32| Symbol { name: format!("f{index}"), bytes: 100 - index, memory: Memory::Flash };
        let image = Image { sizes: Sizes { text, data: 1000, bss }, symbols: (0..12).map(symbol).collect() };
        Report { robot: "osmc-bench".into(), image, measured }
    }

    /// Makes measurements of a tick of this many instructions, without stacks.
    fn tick(p999: u32) -> Measured {
        Measured {
            stacks: json!([]),
            control_tick_instructions: json!({ "median": 12_000, "p999": p999 }),
            tick_budget: 19_200.0,
        }
    }

    #[test]
    fn command_lines_are_understood() {
        let of = |line: &str| Size::parse(&line.split_whitespace().collect::<Vec<_>>());
        assert_eq!(of(""), Ok(Size { robot: "osmc-bench".into(), json: false }));
        assert_eq!(of("--json --robot openscout"), Ok(Size { robot: "openscout".into(), json: true }));
        for (line, word) in [("--image bare", "--image"), ("--robot", "needs a value")] {
            assert!(of(line).expect_err(line).contains(word), "{line}");
        }
    }

    /// Data count in both memories, and the last byte of a budget may be used.
    #[test]
    fn budgets_are_kept_to_the_byte() {
        let (flash, ram) = (FLASH_BUDGET - 1000, RAM_BUDGET - 1000);
        for (text, bss, fits) in [(flash, ram, true), (flash + 1, ram, false), (flash, ram + 1, false)] {
            assert_eq!(report(text, bss, tick(1)).fits(), fits, "{text} {bss}");
        }
        assert!(report(flash + 24, 0, tick(1)).to_string().contains("786456 of  786432, 24 TOO MANY"));
    }

    #[test]
    fn the_object_has_the_fields_of_the_contract() {
        let json = report(2000, 300, tick(1)).json();
        assert_eq!((&json["flash_bytes"], &json["ram_bytes"]), (&json!(3000), &json!(1300)));
        assert_eq!(json["biggest"].as_array().map(Vec::len), Some(BIGGEST));
        assert_eq!(json["biggest"][0], json!({ "name": "f0", "bytes": 100, "memory": "flash" }));
    }

    #[test]
    fn what_the_emulator_measured_is_taken_over() {
        let told = json!({
            "robot": "osmc-bench",
            "limits": { "tick_p999": 19_200.0 },
            "stacks": [{ "executor": "control", "reserved": 131_072, "used": 9000 }],
            "control_tick_instructions":
                { "median": 12_000, "max": 15_000, "p999": 19_200.0 },
        });
        let measured = Measured::read(told.to_string().as_bytes()).expect("all fields are there");
        let report = report(2000, 300, measured);
        let json = report.json();
        assert_eq!(json["stacks"], told["stacks"]);
        assert_eq!(json["control_tick_instructions"], told["control_tick_instructions"]);
        assert!(report.to_string().contains("9000 of  131072 \"control\""));
        assert!(report.fits());
    }

    #[test]
    fn a_tick_over_its_limit_does_not_fit() {
        let report = report(2000, 300, tick(19_201));
        assert!(!report.fits());
        assert!(report.to_string().ends_with("median 12000, 99.9 % 19201 of 19200, TOO MANY"));
    }

    #[test]
    fn half_of_a_measurement_is_none() {
        let ticks = r#""stacks": [], "control_tick_instructions": {"p999": 1}"#;
        for told in ["", "{}", r#"{"stacks": []}"#, &format!("{{{ticks}}}"), &format!(r#"{{{ticks}, "limits": {{}}}}"#)]
        {
            assert_eq!(Measured::read(told.as_bytes()), None, "{told}");
        }
    }
}
