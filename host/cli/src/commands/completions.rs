//! `r4 completions`

use clap::CommandFactory;
use clap_complete::Shell;

use crate::{args::Args, output};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Completions {
    /// The shell that is to complete them
    pub(crate) shell: Shell,
}

pub(crate) fn run(completions: &Completions) -> anyhow::Result<bool> {
    let mut script = Vec::new();
    clap_complete::generate(completions.shell, &mut Args::command(), "r4", &mut script);
    output::bytes(&script)?;
    Ok(true)
}
