//! Task `cargo xtask flash`: builds the image for the Giga and writes it into the board with probe-rs over a debug
//! probe, or dfu-util over USB. `docs/bring-up.md` has their requirements.

use std::{
    ffi::OsString,
    fmt, fs, io,
    path::{Path, PathBuf},
    process::{Command, ExitCode, Stdio},
};

use r4_image::{Binary, CHIP, Place, dfu_util};

use crate::firmware::Firmware;

/// Options of `cargo xtask flash`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Flash {
    firmware: Firmware,
    way: Way,
    /// True to print the commands instead of running them.
    dry_run: bool,
}

#[derive(Clone, Debug, PartialEq)]
enum Way {
    /// SWD by a debug probe. Of several probes, `selector` names one as probe-rs does: `VID:PID` or `VID:PID:SERIAL`.
    Probe { selector: Option<String> },
    /// USB device of the Arduino bootloader.
    Dfu,
}

impl Flash {
    /// Reads the words after `flash`.
    ///
    /// # Errors
    /// The word that is no option, or words that exclude each other.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        let (mut selector, mut dfu, mut dry_run, mut image) = (None, false, false, false);
        let mut rest = Vec::new();
        let mut words = words.iter().copied();
        while let Some(word) = words.next() {
            let mut value = || words.next().ok_or_else(|| format!("`{word}` needs a value"));
            match word {
                "--probe" => selector = Some(value()?.to_owned()),
                "--dfu" => dfu = true,
                "--dry-run" => dry_run = true,
                "--robot" | "--image" => {
                    image |= word == "--image";
                    rest.extend([word, value()?]);
                }
                other => return Err(format!("`flash` takes no `{other}`")),
            }
        }
        if dfu && !image {
            rest.extend(["--image", "hosted"]);
        }
        let firmware = Firmware::parse(&rest)?;
        match (dfu, selector) {
            (true, Some(_)) => Err("`--dfu` goes over USB and has no `--probe`".into()),
            (true, None) if !firmware.is_hosted() => {
                Err("`--dfu` takes the hosted image only: the bootloader cannot overwrite itself with a bare one"
                    .into())
            }
            (true, None) => Ok(Self { firmware, way: Way::Dfu, dry_run }),
            (false, selector) => Ok(Self { firmware, way: Way::Probe { selector }, dry_run }),
        }
    }

    /// Builds the image and flashes it.
    pub(crate) fn run(&self, root: &Path) -> ExitCode {
        match self.flash(root) {
            Ok(()) => ExitCode::SUCCESS,
            Err(problem) => {
                eprintln!("error: {problem}");
                ExitCode::FAILURE
            }
        }
    }

    fn flash(&self, root: &Path) -> Result<(), String> {
        let elf = self.firmware.elf(root)?;
        let commands = self.commands(&elf);
        if self.dry_run {
            commands.iter().for_each(|command| println!("{command}"));
            return Ok(());
        }
        // Checked first, because the build takes a minute.
        let program = self.way.program();
        if !is_there(program) {
            return Err(self.way.advice().into());
        }
        println!("{}", self.firmware.build(root)?);
        if self.way == Way::Dfu {
            let content = fs::read(&elf).map_err(|error| format!("{}: {error}", elf.display()))?;
            let path = raw(&elf);
            let bytes = for_bootloader(&content).map_err(|problem| format!("{}: {problem}", elf.display()))?;
            fs::write(&path, bytes).map_err(|error| format!("{}: {error}", path.display()))?;
        }
        for command in &commands {
            println!("{command}");
            let status = Command::new(command.program)
                .args(&command.arguments)
                .status()
                .map_err(|error| format!("{program} cannot be started: {error}"))?;
            if !status.success() {
                return Err(self.way.failed().into());
            }
        }
        Ok(())
    }

    /// Returns the commands that flash the ELF file, in their order.
    fn commands(&self, elf: &Path) -> Vec<CommandLine> {
        match &self.way {
            Way::Probe { selector } => {
                let mut target = vec!["--chip", CHIP, "--protocol", "swd", "--connect-under-reset"];
                if let Some(selector) = selector {
                    target.extend(["--probe", selector]);
                }
                let words = |before: &[&str], after: &[&str]| {
                    [before, &target, after].concat().into_iter().map(OsString::from).collect::<Vec<_>>()
                };
                let mut download = words(&["download"], &["--verify"]);
                download.push(elf.into());
                // Older versions of probe-rs leave the processor halted after flashing.
                [download, words(&["reset"], &[])]
                    .map(|arguments| CommandLine { program: "probe-rs", arguments })
                    .into()
            }
            Way::Dfu => {
                let arguments = dfu_util(&raw(elf)).split_off(1);
                vec![CommandLine { program: "dfu-util", arguments }]
            }
        }
    }
}

impl Way {
    fn program(&self) -> &'static str {
        match self {
            Self::Probe { .. } => "probe-rs",
            Self::Dfu => "dfu-util",
        }
    }

    /// Returns the advice for a missing program.
    fn advice(&self) -> &'static str {
        match self {
            Self::Probe { .. } => {
                "probe-rs is not installed, or not in PATH. Install it with\n  cargo install probe-rs-tools --locked\nor as \
                 https://probe.rs/docs/getting-started/installation says, which also has the rules that let you use a probe \
                 without being root on Linux. Without a debug probe: `cargo xtask flash --dfu`"
            }
            Self::Dfu => {
                "dfu-util is not installed, or not in PATH. Install it with what installs software on this machine, as in `sudo \
                 apt-get install dfu-util` or `brew install dfu-util`; or let r4 write it, which also restarts the board into its \
                 bootloader and reads back: `cargo run --release -p r4 --features dfu -- flash --dfu --robot NAME`"
            }
        }
    }

    /// Returns the advice for a program that fails.
    fn failed(&self) -> &'static str {
        match self {
            Self::Probe { .. } => {
                "probe-rs failed, see above. Is the probe connected to the board's JTAG connector with its reset line, and \
                 the board powered? `probe-rs list` shows the probes. docs/bring-up.md says what else there is to try"
            }
            Self::Dfu => {
                "dfu-util failed, see above. If it found no device: press the reset button twice quickly, so that the \
                 green light pulses, and try again. If it said that the file was downloaded and failed after that, the \
                 board left for the program before it could answer, and all is well"
            }
        }
    }
}

/// Program with its arguments.
#[derive(Clone, Debug, PartialEq)]
struct CommandLine {
    program: &'static str,
    arguments: Vec<OsString>,
}

/// Prints the command as a person would type it.
impl fmt::Display for CommandLine {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.program)?;
        for word in &self.arguments {
            let word = word.to_string_lossy();
            if word.contains(char::is_whitespace) {
                write!(formatter, " '{word}'")?
            } else {
                write!(formatter, " {word}")?
            }
        }
        Ok(())
    }
}

/// Returns the path of the raw image, beside the ELF file.
fn raw(elf: &Path) -> PathBuf {
    elf.with_extension("bin")
}

/// Returns the bytes for the bootloader, if it will start them.
fn for_bootloader(elf: &[u8]) -> Result<Vec<u8>, String> {
    let binary = Binary::of(elf).map_err(|error| error.to_string())?;
    match Place::of(&binary).map_err(|error| error.to_string())? {
        Place::Hosted => Ok(binary.bytes),
        Place::Bare => Err("it is for the beginning of flash, and not behind the bootloader".into()),
    }
}

fn is_there(program: &str) -> bool {
    let result = Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    !matches!(result, Err(error) if error.kind() == io::ErrorKind::NotFound)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(line: &str) -> Result<Flash, String> {
        Flash::parse(&line.split_whitespace().collect::<Vec<_>>())
    }

    fn commands(line: &str, elf: &str) -> Vec<String> {
        of(line).expect(line).commands(elf.as_ref()).iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_probe_flashes_verifies_and_resets() {
        let target = "--chip STM32H747XIHx --protocol swd --connect-under-reset";
        assert_eq!(
            commands("--robot openscout", "f/a.elf"),
            [format!("probe-rs download {target} --verify f/a.elf"), format!("probe-rs reset {target}")]
        );
        assert_eq!(
            commands("--probe 0483:374e:0042 --image hosted", "f/a b.elf"),
            [
                format!("probe-rs download {target} --probe 0483:374e:0042 --verify 'f/a b.elf'"),
                format!("probe-rs reset {target} --probe 0483:374e:0042")
            ]
        );
    }

    #[test]
    fn the_bootloader_gets_the_raw_image_behind_itself() {
        for line in ["--dfu", "--dfu --image hosted", "--image hosted --dfu"] {
            let expected = ["dfu-util -d 2341:0366 -a 0 -s 0x08040000:leave -D f/a-hosted.bin"];
            assert_eq!(commands(line, "f/a-hosted.elf"), expected, "{line}");
        }
    }

    #[test]
    fn robot_and_image_are_those_of_the_firmware() {
        let flash = |firmware, dry_run| Flash { firmware, way: Way::Probe { selector: None }, dry_run };
        assert_eq!(of(""), Ok(flash(Firmware::new("osmc-bench", "bare"), false)));
        let hosted = Firmware::new("a/b.toml", "hosted");
        assert_eq!(of("--dry-run --image hosted --robot a/b.toml"), Ok(flash(hosted, true)));
    }

    #[test]
    fn others_are_refused_by_the_word_that_is_wrong() {
        for (line, word) in [
            ("--probe", "`--probe` needs a value"),
            ("--image flash", "not `flash`"),
            ("--robot", "`--robot` needs a value"),
            ("now", "takes no `now`"),
            ("--dfu --image bare", "hosted image only"),
            ("--dfu --probe 0483:374e", "has no `--probe`"),
        ] {
            let problem = of(line).expect_err(line);
            assert!(problem.contains(word), "{line}: {problem}");
        }
    }

    /// Makes an ELF file with one loaded segment at `address`, which begins with a stack pointer and the address of a
    /// function.
    fn elf(address: u32) -> Vec<u8> {
        let mut elf = vec![0; 52];
        elf[..6].copy_from_slice(b"\x7fELF\x01\x01");
        (elf[0x1C], elf[0x2A], elf[0x2C]) = (52, 32, 1);
        for value in [1, 84, address, address, 100, 100, 5, 4, 0x2401_0000, address + 0x41] {
            elf.extend(u32::to_le_bytes(value));
        }
        elf.resize(84 + 100, 0);
        elf
    }

    #[test]
    fn only_what_the_bootloader_will_start_is_given_to_it() {
        assert_eq!(for_bootloader(&elf(0x0804_0000)).expect("good").len(), 128, "whole flash words");
        for (file, why) in [
            (elf(0x0800_0000), "not behind the bootloader"),
            (elf(0x0808_0000), "behind the bootloader (hosted)"),
            (b"text".to_vec(), "no ELF"),
        ] {
            let problem = for_bootloader(&file).expect_err(why);
            assert!(problem.contains(why), "{problem}");
        }
    }

    #[test]
    fn a_missing_program_is_noticed() {
        assert!(!is_there("r4-no-such-program"));
        assert!(is_there(env!("CARGO")), "cargo is there");
    }
}
