//! Calibration of encoders and potentiometers.

use std::f64::consts::TAU;

use r4_protocol::{ChannelId, Mode, Parameter, Unit};

use super::{CalibrateError, Change, Found, Person, Turning, counts, read};
use crate::{Error, Quantity, Session, parameters::Parameters};

/// Timeout of a motor's move, s.
pub(crate) const TIMEOUT_S: f64 = 60.0;
/// Distance of a potentiometer's positions from either end, as a share of the range.
const FROM_END: f64 = 0.1;
/// Least distance of two positions, as a share of the range: closer ones give too little accuracy.
const LEAST_APART: f64 = 0.2;

/// Calibrates counts per turn, from turns by hand, or from a drive whose true angle a person measures.
pub(crate) async fn encoder(
    session: &Session<'_>,
    person: &mut impl Person,
    channel: ChannelId,
    by: Turning,
) -> Result<Found, Error> {
    let board = session.board;
    let parameters = Parameters::of(board).await?;
    let info = *parameters.need(channel, Parameter::CountsPerTurn, "has no encoder")?;
    let (moved, turned) = match by {
        Turning::ByHand { turns } => {
            if !turns.is_finite() || turns == 0.0 {
                return Err(CalibrateError::NoTurns.into());
            }
            person.ask(session, &format!("Turn {channel} to a mark by hand, then press Enter.")).await?;
            let before = counts(board, channel).await?;
            let back = format!("Turn it {turns} turns forwards, to the same mark again, then press Enter.");
            person.ask(session, &back).await?;
            (counts(board, channel).await? - before, turns)
        }
        Turning::Driven(distance) => {
            if distance.unit != Unit::Rad || distance.value == 0.0 {
                return Err(CalibrateError::NoDrive.into());
            }
            if board.channel(channel)?.mode(Mode::Position).is_none() {
                let why = "cannot be driven to a position: leave --drive out and turn it by hand";
                return Err(CalibrateError::Unfit { channel, why }.into());
            }
            let before = counts(board, channel).await?;
            let target = before * f64::from(board.channel(channel)?.resolution) + distance.value;
            person
                .ask(session, &format!("Mark where {channel} stands, then press Enter: it turns by {distance}."))
                .await?;
            session.armed(async || Ok::<_, Error>(board.move_to(channel, target, TIMEOUT_S).await?)).await?;
            let moved = counts(board, channel).await? - before;
            let answer = person.ask(session, "How far did it really turn, as in 715deg or 1.98turns?").await?;
            (moved, read(&answer, Unit::Rad, "715deg")? / TAU)
        }
    };
    if moved.abs() < 1.0 {
        return Err(CalibrateError::NotSeen { channel }.into());
    }
    if turned == 0.0 {
        return Err(CalibrateError::NotTurned.into());
    }
    let per_turn = moved / turned;
    if per_turn < 0.0 {
        return Err(CalibrateError::Backwards { channel }.into());
    }
    // Either reading may be off by one count.
    let unsure = 100.0 * 2.0 / moved.abs();
    let change = Change::new(&info, per_turn.round());
    let note = format!(
        "{moved:.0} counts in {turned:.4} turns: {per_turn:.1} a turn, sure within {unsure:.2} % and how well the mark was met"
    );
    Ok(Found { changes: vec![change], toml: None, note })
}

/// Calibrates both points of a potentiometer, from two positions that a person measures.
pub(crate) async fn potentiometer(
    session: &Session<'_>,
    person: &mut impl Person,
    channel: ChannelId,
    drive: bool,
) -> Result<Found, Error> {
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
    let mut points = [(0.0, 0.0); 2];
    for (point, (which, place)) in points.iter_mut().zip([("first", min + margin), ("second", max - margin)]) {
        if drive {
            session.armed(async || Ok::<_, Error>(board.move_to(channel, place, TIMEOUT_S).await?)).await?;
        }
        let what = if drive { "Measure where it is" } else { "Move it there, and measure where that is" };
        let answer = person.ask(session, &format!("{channel}, {which} place. {what}, as in 12.5mm?")).await?;
        let truly = read(&answer, Unit::M, "12.5mm")?;
        // The board reports positions by its present calibration, which is undone here.
        *point = (truly, line.code(counts(board, channel).await? * resolution));
    }
    let [first, second] = points;
    let least = LEAST_APART * (max - min);
    if (second.0 - first.0).abs() < least {
        return Err(CalibrateError::TooNear { least: Quantity::new(least, Unit::M) }.into());
    }
    let truth = Line { low: first, high: second };
    let codes = [low.active, high.active].map(|position| truth.code(position.into()).round());
    if let Some(&code) = codes.iter().find(|code| !(0.0..=65_535.0).contains(*code)) {
        return Err(CalibrateError::NoSuchCode { code }.into());
    }
    let changes = vec![Change::new(&low_code, codes[0]), Change::new(&high_code, codes[1])];
    let shift = (truth.position(line.code(min)) - min, truth.position(line.code(max)) - max);
    let shown = |value| Quantity::new(value, Unit::M);
    let note = format!("until now it was {} off at the low end and {} at the high end", shown(shift.0), shown(shift.1));
    Ok(Found { changes, toml: None, note })
}

/// Straight line of codes over positions, m, through two points.
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
