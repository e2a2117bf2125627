//! Task `cargo xtask size --protocol`: the size of the protocol's frames in the processor, against a budget.
//!
//! `r4-code-size` has the two ends of a frame as a board has them, in a list for cycles only and in one for every
//! message. It is built for the Giga's processor with the firmware's settings, but without optimisation across crates,
//! so that functions stay separate. Then only what a list leads to is linked.
//!
//! | counted as | what |
//! | --- | --- |
//! | code | functions of protocol, postcard, serde, COBS and CRC, and `memcpy` and its like |
//! | panics | text formatting and panics of `core`, to which failed checks of indices lead; the firmware has them anyway |
//! | constants | tables, of the CRC above all, and texts |

use std::{
    fmt, fs,
    path::{Path, PathBuf},
    process::{Command, ExitCode, Stdio},
};

use serde_json::{Value, json};

use crate::{
    firmware::target_folder,
    image,
    toolchain::{self, TARGET},
};

/// Budget of code for encoding and decoding cycles, bytes.
const BUDGET: u32 = 4096;
const PACKAGE: &str = "r4-code-size";
/// Lists with their purpose. The budget is for the first one.
const LISTS: [(&str, &str); 2] = [("CYCLES_ONLY", "cycles"), ("EVERY_MESSAGE", "every message")];
/// Settings of the firmware's profile.
const PROFILE: [&str; 4] = ["opt-level=\"z\"", "codegen-units=1", "panic=\"abort\"", "lto=false"];

/// Measures the sizes and prints them. Fails when the first is over its budget.
pub(crate) fn run(root: &Path, as_json: bool) -> ExitCode {
    let rows = match LISTS.iter().map(|(list, what)| measure(root, list, what)).collect::<Result<Vec<_>, _>>() {
        Ok(rows) => rows,
        Err(problem) => {
            eprintln!("error: {problem}");
            return ExitCode::FAILURE;
        }
    };
    let report = Report(rows);
    if as_json {
        println!("{:#}", report.json());
    } else {
        println!("{report}");
    }
    if report.fits() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Sizes of the code that a list leads to, bytes.
#[derive(Clone, Debug, PartialEq)]
struct Row {
    what: &'static str,
    code: u32,
    panics: u32,
    constants: u32,
}

struct Report(Vec<Row>);

impl Report {
    fn fits(&self) -> bool {
        // A size of 0 means that nothing was linked, so that nothing was measured.
        self.0.first().is_some_and(|cycles| (1..=BUDGET).contains(&cycles.code))
    }

    fn json(&self) -> Value {
        let row = |row: &Row| json!({ "messages": row.what, "code_bytes": row.code, "panic_bytes": row.panics, "constant_bytes": row.constants });
        json!({ "target": TARGET, "code_budget_bytes": BUDGET, "rows": self.0.iter().map(row).collect::<Vec<_>>() })
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a frame encoded and a frame decoded on {TARGET}, in bytes")?;
        for Row { what, code, panics, constants } in &self.0 {
            write!(f, "\n  {what:<14} code {code:>6}, panics {panics:>5}, constants {constants:>5}")?;
        }
        let verdict = if self.fits() { "held" } else { "NOT HELD" };
        write!(f, "\npromised: at most {BUDGET} of code for cycles: {verdict}")
    }
}

fn measure(root: &Path, list: &str, what: &'static str) -> Result<Row, String> {
    toolchain::complete(root, &[])?;
    let libraries = build(root)?;
    let folder = target_folder(root)?.join("code-size");
    let (script, elf) = (folder.join(format!("{list}.ld")), folder.join(format!("{list}.elf")));
    fs::create_dir_all(&folder)
        .and_then(|()| fs::write(&script, layout(list)))
        .map_err(|error| format!("{}: {error}", script.display()))?;
    let own = |library: &&PathBuf| library.file_name().is_some_and(|name| name.to_string_lossy().contains("code_size"));
    let linked = Command::new(linker(root)?)
        // No entry and no startup code: only sections that the list reaches survive `--gc-sections`.
        .args(["-flavor", "gnu", "--gc-sections", "--entry=0", "--unresolved-symbols=ignore-all", "--whole-archive"])
        .args(libraries.iter().filter(own))
        .args(["--no-whole-archive", "--start-group"])
        .args(libraries.iter().filter(|library| !own(library)))
        .arg("--end-group")
        .args([Path::new("-T"), &script, Path::new("-o"), &elf])
        .status()
        .map_err(|error| format!("the linker cannot be started: {error}"))?;
    if !linked.success() {
        return Err(format!("{list} cannot be linked, see above"));
    }
    let bytes = fs::read(&elf).map_err(|error| format!("{}: {error}", elf.display()))?;
    let section =
        |name| image::section_bytes(&bytes, name).ok_or_else(|| format!("{} has no section {name}", elf.display()));
    Ok(Row { what, code: section(".text")?, panics: section(".panics")?, constants: section(".rodata")? })
}

/// Returns a linker script that keeps only the list; the linker adds what it leads to.
fn layout(list: &str) -> String {
    // Parts of mangled names: the modules of `core` that format and panic.
    let panics = ["4core3fmt", "4core3str", "4core9panicking", "4core6result", "4core6option", "_fail"];
    let panics: String = panics.iter().map(|name| format!(" .text.*{name}*")).collect();
    format!(
        "SECTIONS {{\n  . = 0x08000000;\n  .panics : {{ *({}) }}\n  .text : {{ *(.text .text.*) }}\n  .rodata : {{ KEEP(*(.*{list}*)) *(.rodata .rodata.* .data.rel.ro*) }}\n  /DISCARD/ : {{ *(.ARM.exidx* .ARM.extab*) }}\n}}\n",
        panics.trim_start()
    )
}

/// Builds the package, and returns the libraries of it, its dependencies and the standard library.
fn build(root: &Path) -> Result<Vec<PathBuf>, String> {
    let settings = PROFILE.iter().flat_map(|setting| ["--config".into(), format!("profile.release.{setting}")]);
    let output = Command::new(toolchain::cargo())
        .args(["build", "--quiet", "--release", "--locked", "--package", PACKAGE, "--target", TARGET])
        .args(["--message-format", "json-render-diagnostics"])
        .args(settings)
        .arg("--target-dir")
        .arg(target_folder(root)?.join("code-size"))
        // The caller's flags would change the size.
        .env_remove("RUSTFLAGS")
        .current_dir(root)
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    if !output.status.success() {
        return Err(format!("{PACKAGE} does not build, see above"));
    }
    let text = String::from_utf8_lossy(&output.stdout);
    let mut libraries: Vec<PathBuf> = text.lines().flat_map(libraries_of).collect();
    let standard = sysroot(root)?.join("lib/rustlib").join(TARGET).join("lib");
    let found = fs::read_dir(&standard).map_err(|error| format!("{}: {error}", standard.display()))?;
    libraries.extend(
        found.flatten().map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|end| end == "rlib")),
    );
    Ok(libraries)
}

/// Returns the libraries for the processor that a line of cargo's output names.
fn libraries_of(line: &str) -> Vec<PathBuf> {
    let message: Value = serde_json::from_str(line).unwrap_or_default();
    let files = message["filenames"].as_array().cloned().unwrap_or_default();
    let paths = files.iter().filter_map(Value::as_str).map(PathBuf::from);
    let is_for_target = |path: &PathBuf| path.iter().any(|part| part == TARGET);
    paths.filter(|path| is_for_target(path) && path.extension().is_some_and(|end| end == "rlib")).collect()
}

fn sysroot(root: &Path) -> Result<PathBuf, String> {
    toolchain::sysroot(root).ok_or_else(|| "rustc does not say where it is".into())
}

/// Returns the linker that comes with rustc.
fn linker(root: &Path) -> Result<PathBuf, String> {
    // rust-lld belongs to the host's target, whose name is not known here.
    let hosts = sysroot(root)?.join("lib/rustlib");
    let found = fs::read_dir(&hosts).into_iter().flatten().flatten().map(|host| host.path().join("bin/rust-lld"));
    found
        .into_iter()
        .find(|linker| linker.is_file())
        .ok_or_else(|| format!("there is no rust-lld in {}", hosts.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(code: u32) -> Report {
        Report(vec![
            Row { what: "cycles", code, panics: 9000, constants: 9000 },
            Row { what: "every message", code: 9000, panics: 0, constants: 0 },
        ])
    }

    #[test]
    fn the_budget_is_for_the_code_of_cycles() {
        for (code, fits) in [(0, false), (1, true), (4096, true), (4097, false)] {
            assert_eq!(report(code).fits(), fits, "{code}");
        }
        assert!(report(4097).to_string().contains("NOT HELD"));
        assert_eq!(report(7).json()["rows"][1]["code_bytes"], json!(9000));
    }

    #[test]
    fn libraries_for_the_processor_are_taken_and_others_are_not() {
        let line = json!({ "filenames": [
            format!("/t/{TARGET}/release/deps/liba.rlib"),
            format!("/t/{TARGET}/release/deps/liba.rmeta"),
            "/t/release/deps/libb.rlib",
        ] });
        assert_eq!(libraries_of(&line.to_string()), [Path::new("/t").join(TARGET).join("release/deps/liba.rlib")]);
        assert_eq!(libraries_of("no json"), Vec::<PathBuf>::new());
    }

    #[test]
    fn a_list_and_what_is_no_code_have_their_places() {
        let layout = layout("CYCLES_ONLY");
        assert!(layout.contains("KEEP(*(.*CYCLES_ONLY*))") && layout.contains(".text.*4core3fmt*"), "{layout}");
    }
}
