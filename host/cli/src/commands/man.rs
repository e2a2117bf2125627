//! `r4 man`: manual pages, made from the command-line definitions.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use clap::Command;
use clap_mangen::{
    Man,
    roff::{Roff, bold, roman},
};

use crate::output;

/// Pages are in the roff format; to read one: `r4 man move | man -l -`.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Manual {
    /// Verb, as in `move` or `sim serve` [default: the program]
    #[arg(conflicts_with = "out")]
    pub(crate) verb: Vec<String>,
    /// Write the pages of the program and of every verb into this folder, as r4.1, r4-move.1 and so on
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

/// Meanings of the exit codes, for every page; `docs/program.md` has the same table.
const EXIT_STATUS: [(&str, &str); 8] = [
    ("0", "Success: the requested result was reached."),
    ("1", "Failure; a message on stderr says why."),
    ("2", "The command line was not understood; nothing was done."),
    ("3", "The request was refused."),
    ("4", "There is no link to the board."),
    ("5", "The board stopped."),
    ("6", "`identify` finished, and no model explains the recordings."),
    ("130", "Ctrl-C, after which the board was disarmed."),
];

pub(crate) fn run(manual: &Manual, program: Command) -> anyhow::Result<bool> {
    // `help` would get pages of its own.
    let mut program = program.disable_help_subcommand(true);
    // Building sets each verb's full name and the global options.
    program.build();
    match &manual.out {
        Some(folder) => {
            fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
            write_all(&program, folder)?;
        }
        None => output::bytes(&page(find(&program, &manual.verb)?)?)?,
    }
    Ok(true)
}

fn find<'c>(program: &'c Command, verb: &[String]) -> anyhow::Result<&'c Command> {
    let mut found = program;
    for name in verb {
        match found.find_subcommand(name) {
            Some(inner) => found = inner,
            None => bail!("there is no command `{}`: `r4 help` lists them", verb.join(" ")),
        }
    }
    Ok(found)
}

fn write_all(command: &Command, folder: &Path) -> anyhow::Result<()> {
    for verb in command.get_subcommands().filter(|verb| !verb.is_hide_set()) {
        write_all(verb, folder)?;
    }
    let file = folder.join(Man::new(command.clone()).get_filename());
    fs::write(&file, page(command)?).with_context(|| format!("cannot write {}", file.display()))
}

/// Manual page of one command, as roff.
fn page(command: &Command) -> anyhow::Result<Vec<u8>> {
    let man = Man::new(command.clone()).source(concat!("r4 ", env!("CARGO_PKG_VERSION"))).manual("R4");
    let mut page = Vec::new();
    man.render(&mut page)?;
    let mut exit_status = Roff::default();
    exit_status.control("SH", ["EXIT STATUS"]);
    for (code, meaning) in EXIT_STATUS {
        exit_status.control("TP", []).text([bold(code)]).text([roman(meaning)]);
    }
    exit_status.to_writer(&mut page)?;
    Ok(page)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_is_in_the_guide() {
        let guide = include_str!("../../../../docs/program.md");
        for (code, meaning) in EXIT_STATUS {
            assert!(guide.contains(&format!("| {code} | {meaning} |")), "{code} {meaning}");
        }
    }
}
