//! Calibration of wheel radius and track: entries of the robot's file, not parameters of the board.

use futures::future::try_join_all;
use r4_protocol::{ChannelId, Mode, Unit};

use super::{CalibrateError, Found, Person, counts, motor::TIMEOUT_S, read};
use crate::{Error, Quantity, Session};

/// Calibrates the radius from the distance that the robot moves, and the track from the angle that it turns on the
/// spot, while the encoders count the wheels' angles.
pub(crate) async fn run(
    session: &Session<'_>,
    person: &mut impl Person,
    left: &[ChannelId],
    right: &[ChannelId],
    turn: Quantity,
) -> Result<Found, Error> {
    if turn.unit != Unit::Rad || turn.value.is_nan() || turn.value <= 0.0 {
        return Err(CalibrateError::NoTurn.into());
    }
    for &channel in left.iter().chain(right) {
        let info = session.board.channel(channel)?;
        if info.mode(Mode::Position).is_none() || info.unit != Unit::Rad {
            return Err(CalibrateError::Unfit { channel, why: "is no motor with an encoder" }.into());
        }
    }
    if let Some(&channel) = left.iter().find(|channel| right.contains(channel)) {
        return Err(CalibrateError::BothSides { channel }.into());
    }
    let ready =
        format!("Give the robot room for {turn} of its wheels forwards, mark where it stands, then press Enter.");
    person.ask(session, &ready).await?;
    let (left_rad, right_rad) = drive(session, left, right, [turn.value; 2]).await?;
    let answer = person.ask(session, "How far forwards did it go, as in 0.70m?").await?;
    let distance_m = read(&answer, Unit::M, "0.70m")?;
    let turned_rad = if right.is_empty() { left_rad } else { (left_rad + right_rad) / 2.0 };
    let radius_m = distance_m / turned_rad;
    if radius_m <= 0.0 || !radius_m.is_finite() {
        return Err(CalibrateError::NoRadius.into());
    }
    let names = |channels: &[ChannelId]| {
        let names: Vec<_> = channels.iter().map(|channel| format!("\"{channel}\"")).collect();
        names.join(", ")
    };
    let mut note = format!("the wheels turned {:.3} rad", turned_rad);
    if right.is_empty() {
        let toml = format!("wheel_radius_m = {radius_m:.5} # measured over {distance_m:.3} m\n");
        return Ok(Found { changes: Vec::new(), toml: Some(toml), note });
    }
    person.ask(session, "Now it turns on the spot to the left. Mark how it stands, then press Enter.").await?;
    let (left_rad, right_rad) = drive(session, left, right, [-turn.value, turn.value]).await?;
    let answer = person.ask(session, "How far did it turn to the left, as in 90deg?").await?;
    let yaw_rad = read(&answer, Unit::Rad, "90deg")?;
    // This is the effective track: the scrubbing of the tyres makes it wider than the distance of the wheels.
    let track_m = radius_m * (right_rad - left_rad) / yaw_rad;
    if track_m <= 0.0 || !track_m.is_finite() {
        return Err(CalibrateError::NoTrack.into());
    }
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

/// Turns the wheels of both sides. Returns the mean angle of each side's wheels, rad.
async fn drive(
    session: &Session<'_>,
    left: &[ChannelId],
    right: &[ChannelId],
    [left_rad, right_rad]: [f64; 2],
) -> Result<(f64, f64), Error> {
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
            // All wheels move at the same time; one after another they would scrub over the ground.
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
