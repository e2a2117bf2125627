//! Encoders and potentiometers.

use std::f64::consts::TAU;

use anyhow::{bail, ensure};
use r4_protocol::{ChannelId, Mode, Parameter, Unit};

use super::{Change, Found, Parameters, ask::Answers, counts, read};
use crate::session::Session;
use r4_rig::{Error, Quantity};

/// A motor that is sent somewhere is waited for so long, s.
pub(super) const TIMEOUT_S: f64 = 60.0;
/// Where a potentiometer is read: this share of the range from either end.
const FROM_END: f64 = 0.1;
/// Two places nearer than this share of the range tell too little.
const LEAST_APART: f64 = 0.2;

/// Counts per turn, from turns by hand or a drive whose true length is told.
pub(super) async fn encoder(
    session: &Session<'_>,
    answers: &mut Answers,
    channel: ChannelId,
    turns: f64,
    drive: Option<Quantity>,
) -> anyhow::Result<Found> {
    let board = session.board;
    let parameters = Parameters::of(board).await?;
    let info = *parameters.need(channel, Parameter::CountsPerTurn, "has no encoder")?;
    ensure!(turns.is_finite() && turns != 0.0, "--turns takes a number of turns other than 0");
    let (moved, turned) = match drive {
        None => {
            answers.ask(session, &format!("Turn {channel} to a mark by hand, then press Enter.")).await?;
            let before = counts(board, channel).await?;
            let back = format!("Turn it {turns} turns forwards, to the same mark again, then press Enter.");
            answers.ask(session, &back).await?;
            (counts(board, channel).await? - before, turns)
        }
        Some(distance) => {
            ensure!(distance.unit == Unit::Rad && distance.value != 0.0, "--drive takes an angle, as in 720deg");
            if board.channel(channel)?.mode(Mode::Position).is_none() {
                bail!("{channel} cannot be driven to a position: leave --drive out and turn it by hand");
            }
            let before = counts(board, channel).await?;
            let target = before * f64::from(board.channel(channel)?.resolution) + distance.value;
            answers
                .ask(session, &format!("Mark where {channel} stands, then press Enter: it turns by {distance}."))
                .await?;
            session.armed(async || Ok::<_, Error>(board.move_to(channel, target, TIMEOUT_S).await?)).await?;
            let moved = counts(board, channel).await? - before;
            let answer = answers.ask(session, "How far did it really turn, as in 715deg or 1.98turns?").await?;
            (moved, read(&answer, Unit::Rad, "715deg")? / TAU)
        }
    };
    ensure!(moved.abs() >= 1.0, "{channel} was not seen to move: is its encoder wired to this connector?");
    ensure!(turned != 0.0, "what did not turn tells nothing");
    let per_turn = moved / turned;
    if per_turn < 0.0 {
        bail!("{channel} counts backwards: change `inverted` of its encoder in the robot's file, not its scale");
    }
    // Each look may be a count off.
    let unsure = 100.0 * 2.0 / moved.abs();
    let change = Change::new(&info, per_turn.round());
    let note = format!(
        "{moved:.0} counts in {turned:.4} turns: {per_turn:.1} a turn, sure within {unsure:.2} % and how well the mark was met"
    );
    Ok(Found { changes: vec![change], toml: None, note })
}

/// Both points of a potentiometer, from two places whose true position is told.
pub(super) async fn potentiometer(
    session: &Session<'_>,
    answers: &mut Answers,
    channel: ChannelId,
    drive: bool,
) -> anyhow::Result<Found> {
    let board = session.board;
    let parameters = Parameters::of(board).await?;
    let of = |parameter| parameters.need(channel, parameter, "has no potentiometer").copied();
    let (low_code, low) = (of(Parameter::PotLowCode)?, of(Parameter::PotLowPosition)?);
    let (high_code, high) = (of(Parameter::PotHighCode)?, of(Parameter::PotHighPosition)?);
    let (min, max) = (f64::from(of(Parameter::PositionMin)?.active), f64::from(of(Parameter::PositionMax)?.active));
    let line =
        Line { low: (low.active.into(), low_code.active.into()), high: (high.active.into(), high_code.active.into()) };
    let resolution = f64::from(board.channel(channel)?.resolution);
    let margin = FROM_END * (max - min);
    let mut points = Vec::new();
    for (which, place) in [("first", min + margin), ("second", max - margin)] {
        if drive {
            session.armed(async || Ok::<_, Error>(board.move_to(channel, place, TIMEOUT_S).await?)).await?;
        }
        let what = if drive { "Measure where it is" } else { "Move it there, and measure where that is" };
        let answer = answers.ask(session, &format!("{channel}, {which} place. {what}, as in 12.5mm?")).await?;
        let truly = read(&answer, Unit::M, "12.5mm")?;
        points.push((truly, line.code(counts(board, channel).await? * resolution)));
    }
    let [first, second] = points[..] else { bail!("two places are needed") };
    if (second.0 - first.0).abs() < LEAST_APART * (max - min) {
        bail!("the two places are too near: at least {}", Quantity::new(LEAST_APART * (max - min), Unit::M));
    }
    let truth = Line { low: first, high: second };
    let codes = [low.active, high.active].map(|position| truth.code(position.into()).round());
    if let Some(code) = codes.iter().find(|code| !(0.0..=65_535.0).contains(*code)) {
        bail!("one end would be at code {code:.0}, which no converter has: was all measured right?");
    }
    let changes = vec![Change::new(&low_code, codes[0]), Change::new(&high_code, codes[1])];
    let shift = (truth.position(line.code(min)) - min, truth.position(line.code(max)) - max);
    let shown = |value| Quantity::new(value, Unit::M);
    let note = format!("until now it was {} off at the low end and {} at the high end", shown(shift.0), shown(shift.1));
    Ok(Found { changes, toml: None, note })
}

/// Codes against positions, by two points.
struct Line {
    low: (f64, f64),
    high: (f64, f64),
}

impl Line {
    fn code(&self, position: f64) -> f64 {
        self.low.1 + (position - self.low.0) / (self.high.0 - self.low.0) * (self.high.1 - self.low.1)
    }

    fn position(&self, code: f64) -> f64 {
        self.low.0 + (code - self.low.1) / (self.high.1 - self.low.1) * (self.high.0 - self.low.0)
    }
}
