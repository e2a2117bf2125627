//! `r4 access`: keys, tokens, decisions and the log of a guarded board, for its administrator.

mod check;
mod log;

use std::{
    ffi::OsString,
    path::{Path, PathBuf},
};

use anyhow::Context;
use r4_access::{Credential, unix_ms};
use serde::Serialize;

use crate::{args::Args, output};

#[derive(Clone, Debug, clap::Subcommand)]
pub(crate) enum Access {
    /// Make a key for a subject, and print its table for the policy
    Key {
        /// Name of the subject; example: alice
        subject: String,
        /// Name of the policy, as its key `name` has it
        #[arg(long, value_name = "NAME")]
        policy: String,
        /// Purpose of the subject's requests
        #[arg(long, value_name = "PURPOSE")]
        purpose: String,
        /// Life of a token, s; the program renews it twice per life
        #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(10..=3600), value_name = "SECONDS")]
        life: u64,
        /// New file for the private key, which only you may read; `--token` takes it
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Print a token for one connection, for a program or a person without a key
    Grant {
        /// Private key of the subject, as `access key` made it
        #[arg(value_name = "FILE")]
        credential: PathBuf,
        /// Declare an emergency: break-glass, which the log flags
        #[arg(long)]
        emergency: bool,
    },
    /// Decide requests by a policy, without a board, and print the reasons
    Check(check::Check),
    /// Verify an access log and print its entries
    Log(log::Log),
}

#[derive(Serialize)]
struct Made<'m> {
    subject: &'m str,
    key: String,
    file: &'m Path,
}

#[derive(Serialize)]
struct Granted<'g> {
    subject: &'g str,
    token: &'g str,
    life_s: u64,
}

pub(crate) fn run(args: &Args, what: &Access) -> anyhow::Result<bool> {
    match what {
        Access::Key { subject, policy, purpose, life, out } => {
            let credential = Credential::make(subject, policy, purpose, *life)?;
            credential.write(out).context("the key was not made")?;
            let key = credential.public_key();
            if args.json {
                output::json(&Made { subject, key, file: out })?;
            } else {
                output::line(format_args!("[[subject]]\nname = \"{subject}\"\nkey = \"{key}\"\nroles = []"))?;
                eprintln!(
                    "r4: the private key is in {}; copy the table above into the policy, with its roles",
                    out.display()
                );
            }
        }
        Access::Grant { credential, emergency } => {
            let credential = Credential::read(credential)?;
            let token = credential.token(*emergency, unix_ms())?;
            let Credential { subject, life_s, .. } = &credential;
            if args.json {
                output::json(&Granted { subject, token: &token, life_s: *life_s })?;
            } else {
                output::line(&token)?;
                eprintln!("r4: valid for one connection within {life_s} s");
            }
        }
        Access::Check(check) => return check::run(args, check),
        Access::Log(log) => log::run(args, log)?,
    }
    Ok(true)
}

/// Path of the log of a policy's guard.
pub(crate) fn log_of(policy: &Path) -> PathBuf {
    let mut name: OsString = policy.as_os_str().to_owned();
    name.push(".log");
    PathBuf::from(name)
}
