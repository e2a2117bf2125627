//! Radius and track: no parameters of the board, but of the file that says what the robot is.

use anyhow::{bail, ensure};
use futures::future::try_join_all;
use r4_protocol::{ChannelId, Mode, Unit};

use super::{Found, ask::Answers, counts, motor::TIMEOUT_S, read};
use crate::session::Session;
use r4_rig::{Error, Quantity};

/// From how far the robot went, and how far it turned on the spot, while the wheels turned as far as their encoders say.
pub(super) async fn run(
    session: &Session<'_>,
    answers: &mut Answers,
    left: &[ChannelId],
    right: &[ChannelId],
    turn: Quantity,
) -> anyhow::Result<Found> {
    ensure!(turn.unit == Unit::Rad && turn.value > 0.0, "--turn takes an angle above 0, as in 2turns");
    for channel in left.iter().chain(right) {
        let info = session.board.channel(*channel)?;
        if info.mode(Mode::Position).is_none() || info.unit != Unit::Rad {
            bail!("{channel} is no motor with an encoder");
        }
    }
    if let Some(both) = left.iter().find(|channel| right.contains(channel)) {
        bail!("{both} cannot be on both sides");
    }
    let ready =
        format!("Give the robot room for {turn} of its wheels forwards, mark where it stands, then press Enter.");
    answers.ask(session, &ready).await?;
    let (left_rad, right_rad) = drive(session, left, right, [turn.value; 2]).await?;
    let answer = answers.ask(session, "How far forwards did it go, as in 0.70m?").await?;
    let distance_m = read(&answer, Unit::M, "0.70m")?;
    let turned_rad = if right.is_empty() { left_rad } else { (left_rad + right_rad) / 2.0 };
    let radius_m = distance_m / turned_rad;
    ensure!(radius_m > 0.0 && radius_m.is_finite(), "a robot that did not go forwards tells no radius");
    let names = |channels: &[ChannelId]| {
        let names: Vec<_> = channels.iter().map(|channel| format!("\"{channel}\"")).collect();
        names.join(", ")
    };
    let mut note = format!("the wheels turned {:.3} rad", turned_rad);
    if right.is_empty() {
        let toml = format!("wheel_radius_m = {radius_m:.5} # measured over {distance_m:.3} m\n");
        return Ok(Found { changes: Vec::new(), toml: Some(toml), note });
    }
    answers.ask(session, "Now it turns on the spot to the left. Mark how it stands, then press Enter.").await?;
    let (left_rad, right_rad) = drive(session, left, right, [-turn.value, turn.value]).await?;
    let answer = answers.ask(session, "How far did it turn to the left, as in 90deg?").await?;
    let yaw_rad = read(&answer, Unit::Rad, "90deg")?;
    let track_m = radius_m * (right_rad - left_rad) / yaw_rad;
    ensure!(track_m > 0.0 && track_m.is_finite(), "a robot that did not turn to the left tells no track");
    note += &format!(", then {left_rad:.3} rad on the left and {right_rad:.3} rad on the right");
    let toml = format!(
        "[drive.skid-steer]\nwheel_radius_m = {radius_m:.5} # measured over {distance_m:.3} m\n\
         track_m = {track_m:.4} # measured over {}; wheels that scrub make it wider than the drawing\n\
         left = [{}]\nright = [{}]\n",
        Quantity::new(yaw_rad, Unit::Rad),
        names(left),
        names(right)
    );
    Ok(Found { changes: Vec::new(), toml: Some(toml), note })
}

/// Turns the wheels of both sides and returns how far they turned, rad, as a mean of each side.
async fn drive(
    session: &Session<'_>,
    left: &[ChannelId],
    right: &[ChannelId],
    [left_rad, right_rad]: [f64; 2],
) -> anyhow::Result<(f64, f64)> {
    let board = session.board;
    let sides =
        left.iter().map(|channel| (*channel, left_rad)).chain(right.iter().map(|channel| (*channel, right_rad)));
    let mut wheels = Vec::new();
    for (channel, angle) in sides {
        let resolution = f64::from(board.channel(channel)?.resolution);
        wheels.push((channel, resolution, counts(board, channel).await? * resolution, angle));
    }
    session
        .armed(async || {
            let moves = wheels.iter().map(|(channel, _, at, angle)| board.move_to(*channel, at + angle, TIMEOUT_S));
            try_join_all(moves).await?;
            Ok::<_, Error>(())
        })
        .await?;
    let mut turned = Vec::new();
    for (channel, resolution, before, _) in &wheels {
        turned.push(counts(board, *channel).await? * resolution - before);
    }
    let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
    Ok((mean(&turned[..left.len()]), mean(&turned[left.len()..])))
}
