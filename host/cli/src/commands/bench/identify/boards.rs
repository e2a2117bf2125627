//! `r4 identify close` on simulated boards with a hidden effect in their motor: how much nearer the simulated board
//! comes, and which effects are claimed where none is hidden.

use anyhow::Context;
use r4_rig::{InRobot, excite::ExciteError};
use rayon::iter::{IntoParallelIterator, ParallelIterator};

use super::{Bench, Row, blind::median};
use crate::{
    args::{Args, IdentifyRows},
    commands::identify::{
        close::{Close, Closed, closed},
        shown::Shown,
    },
    session::Target,
};

const ROBOT: &str = "osmc-bench";
const CHANNEL: &str = "osmc0";
const BOARDS: &str = "`identify close` on blind boards";
/// Length of each of the three recordings, s: the default of `close`.
const SECONDS: f64 = 12.0;
/// Least ratio of the simulated board's error before to that after.
const NEARER: f64 = 5.0;

/// Result of one board.
struct Board {
    /// Names of the effects hidden in the motor.
    hidden: Vec<&'static str>,
    closed: anyhow::Result<Closed>,
}

impl Board {
    /// Ratio of the error on the held-out recording, before over after; 0 without a result.
    fn nearer(&self) -> f64 {
        let first = self.closed.as_ref().ok().and_then(|closed| closed.twin.differences.first());
        first.map_or(0.0, |first| first.rmse_before / first.rmse_after)
    }

    /// True if no allowed duty moves the motor; `close` reports that as an error.
    fn is_immovable(&self) -> bool {
        let why = self.closed.as_ref().err().and_then(|why| why.downcast_ref());
        matches!(why, Some(r4_rig::Error::Excite(why)) if matches!(**why, ExciteError::Immovable { .. }))
    }

    fn found(&self) -> String {
        self.closed.as_ref().map_or_else(|_| "no result".to_owned(), |closed| super::recorded::names(&closed.report))
    }
}

fn board(bench: &Bench<'_>, number: u32) -> anyhow::Result<Board> {
    let seed = IdentifyRows::Close.first_seed(bench.base).wrapping_add(number.into());
    let channel = CHANNEL.parse().ok().context("not a channel")?;
    let hidden = match r4_rig::hidden(&r4_boards::load(ROBOT)?, seed)? {
        InRobot::Motors(motors) => motors.into_iter().find(|(motor, _)| *motor == channel).map(|(_, hidden)| hidden),
        InRobot::Body(..) => None,
    };
    let hidden = hidden.context("the robot has no such motor")?.truth().iter().map(|truth| truth.name).collect();
    let out = tempfile::tempdir().context("cannot make a folder for the recordings")?;
    let close =
        Close { channel, out: out.path().to_owned(), plant_before: None, twin: None, duty: None, seconds: SECONDS };
    let args = Args { board: Target::Sim(ROBOT.to_owned()), blind: Some(seed), ..bench.args.clone() };
    let board = Board { hidden, closed: closed(&args, &close, &Shown::nowhere()) };
    bench.progress.inc(1);
    if let Err(why) = &board.closed {
        bench.say(&format!("r4: board {number} (--blind {seed}) gave no result: {why:#}"));
    } else if bench.each {
        let hidden = if board.hidden.is_empty() { "nothing".to_owned() } else { board.hidden.join(", ") };
        bench.say(&format!(
            "{number:4} --blind {seed}: hidden {hidden}; found {}; {:.2} times as near",
            board.found(),
            board.nearer()
        ));
    }
    Ok(board)
}

pub(super) fn close(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    let boards = bench.numbers(IdentifyRows::Close).into_par_iter().map(|number| board(bench, number));
    let boards = boards.collect::<anyhow::Result<Vec<Board>>>()?;
    // A motor that no allowed duty moves cannot be identified and is not counted.
    let (immovable, movable): (Vec<&Board>, Vec<&Board>) = boards.iter().partition(|board| board.is_immovable());
    let (clean, hiding): (Vec<&Board>, Vec<&Board>) = movable.into_iter().partition(|board| board.hidden.is_empty());
    let counted =
        |boards: &[&Board], is: fn(&Board) -> bool| [boards.iter().filter(|board| is(board)).count(), boards.len()];
    let [farther, _] = counted(&hiding, |board| board.closed.is_ok() && board.nearer() < 1.0);
    let missed = hiding.iter().filter(|board| board.nearer() < NEARER);
    let missed: String =
        missed.map(|board| format!("; less: {} for {}", board.found(), board.hidden.join(", "))).collect();
    let middle = median(hiding.iter().map(|board| board.nearer()));
    let claimed = |board: &Board| board.closed.as_ref().is_ok_and(|closed| !closed.report.effects.is_empty());
    let claims: Vec<String> = clean.iter().filter(|board| claimed(board)).map(|board| board.found()).collect();
    let nothing = clean.iter().filter(|board| board.closed.is_ok() && !claimed(board)).count();
    let nearer = counted(&hiding, |board| board.nearer() >= NEARER);
    let mut rows = vec![
        Row::share(BOARDS, "twin at least 5 times as near", nearer, 0.9)
            .with(format!(
                "median {middle:.1} times; farther for {farther}, which `close` says; not counted: {} whose motor no duty moves, which \
                 `close` says{missed}",
                immovable.len()
            ))
            .simulated(),
    ];
    if !clean.is_empty() {
        let row = Row::share(BOARDS, "nothing claimed where nothing is hidden", [nothing, clean.len()], 1.0);
        rows.push(row.with(claims.join("; ")).simulated());
    }
    Ok(rows)
}
