//! `r4 arm`, `r4 disarm`, `r4 clear`: changes of the safety state.

use anyhow::bail;
use r4_driver::Error;
use r4_protocol::{HotWinding, Refusal, SafetyState};
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::Args,
    output,
    session::{self, Session},
};

#[derive(Serialize)]
struct State {
    board: String,
    state: String,
    causes: Vec<String>,
    hot_windings: Vec<Hot>,
}

/// Motor whose winding is close to its limit.
#[derive(Serialize)]
pub(crate) struct Hot {
    pub(crate) channel: String,
    pub(crate) heat_percent: u8,
}

impl From<&HotWinding> for Hot {
    fn from(hot: &HotWinding) -> Self {
        Self { channel: hot.channel.to_string(), heat_percent: hot.heat_percent }
    }
}

/// Polling period of an armed board's state, s.
const LOOK_EVERY_S: f64 = 0.05;

pub(crate) fn arm(args: &Args, seconds: Option<f64>) -> anyhow::Result<bool> {
    session::run(args, Pace::RealTime(1.0), async |session| {
        session
            .armed(async || {
                report(args, session).await?;
                eprintln!("armed; Ctrl-C disarms");
                let until_s = seconds.map(|seconds| session.board.now_s() + seconds);
                while until_s.is_none_or(|until_s| session.board.now_s() < until_s) {
                    session.board.sleep_s(LOOK_EVERY_S).await;
                    if let (SafetyState::Tripped, causes) = session.board.safety() {
                        return Err(r4_driver::Error::Stopped { causes }.into());
                    }
                }
                Ok(())
            })
            .await
    })?;
    Ok(true)
}

pub(crate) fn disarm(args: &Args) -> anyhow::Result<bool> {
    session::run(args, Pace::Free, async |session| {
        session.board.disarm().await?;
        report(args, session).await
    })?;
    Ok(true)
}

pub(crate) fn clear(args: &Args) -> anyhow::Result<bool> {
    session::run(args, Pace::Free, async |session| {
        session.board.clear().await?;
        report(args, session).await
    })?;
    Ok(true)
}

/// Waits for the board's next telemetry and prints its state.
async fn report(args: &Args, session: &Session<'_>) -> anyhow::Result<()> {
    let Some(first) = session.board.channels().first() else { bail!("the board has no channels") };
    let mut telemetry = session.board.telemetry();
    // Telemetry carries the state: the next frame is newer than the request before.
    let (safety, causes) = match session.board.subscribe(first.id, 10).await {
        Ok(()) => {
            let frame = telemetry.next().await?;
            session.board.subscribe(first.id, 0).await?;
            (frame.state, frame.causes)
        }
        // Who may not watch may disarm all the same. The second heartbeat from now on was sent after the request.
        Err(Error::Refused(Refusal::Denied)) => {
            let mut answers = session.board.heartbeat_answers();
            answers.next().await?;
            let answer = answers.next().await?;
            (answer.state, answer.causes)
        }
        Err(error) => return Err(error.into()),
    };
    let hot = session.board.hot_windings();
    let state = State {
        board: args.board.to_string(),
        state: safety.to_string(),
        causes: causes.iter().map(|cause| cause.to_string()).collect(),
        hot_windings: hot.iter().map(Hot::from).collect(),
    };
    if args.json {
        return output::json(&state);
    }
    output::line(format_args!("{} is {}", args.board.described(), state.state))?;
    for cause in causes.iter() {
        output::line(format_args!("  {cause}: {}", cause.advice()))?;
    }
    for hot in &hot {
        output::line(format_args!("  {}", r4_rig::heat::words(hot)))?;
    }
    Ok(())
}
