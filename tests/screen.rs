//! What shells and `man` get.

use std::{
    collections::BTreeSet,
    fs,
    process::{Command, Stdio},
};

use tempfile::TempDir;

/// `r4`, away from the user's settings.
fn r4(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_r4"));
    command.args(args).env_remove("R4_BOARD").env_remove("R4_FLASH").stdin(Stdio::null());
    command
}

/// Exit code, stdout and stderr of a run without a terminal.
fn seen(args: &[&str]) -> (Option<i32>, String, String) {
    let output = r4(args).output().expect("r4 starts");
    let text = |bytes| String::from_utf8(bytes).expect("text");
    (output.status.code(), text(output.stdout), text(output.stderr))
}

/// The verbs, as the help lists them.
fn verbs() -> BTreeSet<String> {
    let (_, help, _) = seen(&["help"]);
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    // Continued descriptions are further in.
    let verbs = listed.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    verbs.filter_map(|line| line.split_whitespace().next()).filter(|verb| *verb != "help").map(str::to_owned).collect()
}

#[test]
fn every_shell_can_complete_every_verb() {
    let verbs = verbs();
    assert!(verbs.len() > 20 && verbs.contains("watch"), "{verbs:?}");
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let (code, script, err) = seen(&["completions", shell]);
        assert_eq!((code, err.as_str()), (Some(0), ""));
        for verb in &verbs {
            assert!(script.contains(verb.as_str()), "{shell} does not know {verb}");
        }
    }
    let (code, _, err) = seen(&["completions", "command.com"]);
    assert!(code == Some(2) && err.contains("zsh"), "{err}");
}

/// In a real bash: what it offers after a few letters.
#[test]
fn bash_completes() {
    let (_, script, _) = seen(&["completions", "bash"]);
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("r4.bash");
    fs::write(&file, script).unwrap();
    let ask = format!(
        "source {} && COMP_WORDS=(r4 de) COMP_CWORD=1 && _r4 r4 de r4 && echo ${{COMPREPLY[@]}}",
        file.display()
    );
    let output = Command::new("bash").args(["--norc", "-c", &ask]).output();
    let Ok(output) = output else {
        eprintln!("not run: there is no bash");
        return;
    };
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), "demo debug", "{output:?}");
}

#[test]
fn every_verb_has_a_page() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("man1");
    let (code, printed, err) = seen(&["man", "--out", out.to_str().unwrap()]);
    assert_eq!((code, printed.as_str(), err.as_str()), (Some(0), "", ""));
    let page = |name: &str| fs::read_to_string(out.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    for verb in verbs() {
        assert!(page(&format!("r4-{verb}.1")).contains("EXIT STATUS"), "{verb}");
    }
    assert!(page("r4-sim-serve.1").contains("slcan"));
    let program = page("r4.1");
    for there in [".SH NAME", "EXIT STATUS", "Ctrl\\-C", "\\-\\-board"] {
        assert!(program.contains(there), "{there} is not in\n{program}");
    }
    assert_eq!(seen(&["man"]).1, program);
    assert_eq!(seen(&["man", "sim", "serve"]).1, page("r4-sim-serve.1"));
    let (code, _, err) = seen(&["man", "fly"]);
    assert!(code == Some(1) && err.contains("no verb `fly`"), "{err}");
}
