//! `r4 access check`: decisions of a policy, one or many.

use std::{
    fs::File,
    io::{self, BufRead, BufReader},
    path::PathBuf,
};

use anyhow::{Context, bail};
use r4_access::{Action, Asker, Basis, Policy, Request, decide, unix_ms};
use serde::{Deserialize, Serialize};

use crate::{args::Args, output};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Check {
    /// The policy
    #[arg(value_name = "POLICY")]
    policy: PathBuf,
    /// Action: read, set, arm, clear, configure or transfer
    #[arg(required_unless_present = "requests")]
    action: Option<String>,
    /// Resource: its class, or one by its name; example: channel/osmc0
    #[arg(required_unless_present = "requests")]
    resource: Option<String>,
    /// Subject with a valid token [default: none]
    #[arg(long = "as", value_name = "SUBJECT")]
    subject: Option<String>,
    /// Purpose of the token
    #[arg(long, default_value = "", value_name = "PURPOSE")]
    purpose: String,
    /// An emergency of the subject is in force
    #[arg(long)]
    emergency: bool,
    /// Read requests from this file, one JSON object a line, and print a decision for each; `-` is stdin
    #[arg(long, conflicts_with_all = ["action", "resource", "subject", "purpose", "emergency"], value_name = "FILE")]
    requests: Option<PathBuf>,
}

/// Request of a line.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Asked {
    /// Subject with a valid token; absent for none.
    subject: Option<String>,
    #[serde(default)]
    purpose: String,
    #[serde(default)]
    emergency: bool,
    action: String,
    resource: String,
    /// Time of the request, Unix ms; absent for now.
    at_ms: Option<u64>,
}

#[derive(Serialize)]
struct Decided {
    granted: bool,
    basis: Option<Basis>,
    facts: String,
    reason: Option<String>,
}

/// Decides; false if a single request is denied.
pub(super) fn run(args: &Args, check: &Check) -> anyhow::Result<bool> {
    let policy = Policy::read(&check.policy).with_context(|| check.policy.display().to_string())?;
    let (Some(action), Some(resource)) = (&check.action, &check.resource) else {
        return many(&policy, check).map(|()| true);
    };
    let decided = decided(
        &policy,
        &Asked {
            subject: check.subject.clone(),
            purpose: check.purpose.clone(),
            emergency: check.emergency,
            action: action.clone(),
            resource: resource.clone(),
            at_ms: None,
        },
    )?;
    let granted = decided.granted;
    if args.json {
        output::json(&decided)?;
        return Ok(granted);
    }
    match (&decided.reason, decided.basis) {
        (Some(reason), _) => output::line(format_args!("denied: {reason}"))?,
        (None, Some(Basis::BreakGlass)) => output::line("granted by break-glass, which the log flags")?,
        (None, _) => output::line("granted")?,
    }
    Ok(granted)
}

fn many(policy: &Policy, check: &Check) -> anyhow::Result<()> {
    let Some(path) = &check.requests else { bail!("name an action and a resource, or --requests") };
    let lines: Box<dyn BufRead> = if path.as_os_str() == "-" {
        Box::new(io::stdin().lock())
    } else {
        Box::new(BufReader::new(File::open(path).with_context(|| path.display().to_string())?))
    };
    for (line, number) in lines.lines().zip(1..) {
        let place = || format!("{}:{number}", path.display());
        let asked: Asked = serde_json::from_str(&line.with_context(place)?).with_context(place)?;
        output::json(&decided(policy, &asked).with_context(place)?)?;
    }
    Ok(())
}

fn decided(policy: &Policy, asked: &Asked) -> anyhow::Result<Decided> {
    let now_ms = asked.at_ms.unwrap_or_else(unix_ms);
    let asker = match &asked.subject {
        None => None,
        Some(name) => {
            let subject = policy.subject(name).with_context(|| {
                let known: Vec<&str> = policy.subjects().map(|subject| subject.name.as_str()).collect();
                format!("the policy has no subject `{name}`: it has {}", known.join(", "))
            })?;
            Some(Asker { subject, purpose: &asked.purpose, is_emergency: asked.emergency })
        }
    };
    let action = Action::named(&asked.action).with_context(|| {
        let known: Vec<&str> = Action::ALL.iter().map(|action| action.name()).collect();
        format!(
            "there is no action `{}`: write {} (stops and disarming are never refused)",
            asked.action,
            known.join(", ")
        )
    })?;
    let request = Request { action, resource: asked.resource.parse()? };
    // A retention without a date counts from the start of `r4 serve`: here from the request.
    let decision = decide(policy, asker.as_ref(), &request, now_ms, now_ms);
    Ok(Decided {
        granted: decision.is_granted(),
        basis: decision.basis,
        facts: decision.facts.to_string(),
        reason: decision.facts.reason().map(|reason| reason.to_string()),
    })
}
