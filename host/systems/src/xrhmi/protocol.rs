//! Session of one participant on a board: three trials in a counterbalanced order, each of 14 cues.

use std::{cell::RefCell, convert::Infallible, future::pending, pin::pin};

use futures::future::{Either, select};
use r4_rig::{Error, Sequence, Session};

use super::{
    cue::{self, Command, Modality, Outputs, Zone},
    desk::{Desk, Zones, seen},
    log::{CommandLog, SessionLog, TrialLog},
    person::{Moment, Person, Shared},
};
use crate::participants::williams_order;

/// Longest time for a command, s: our choice.
const COMMAND_S: f64 = 15.0;
/// Pause after which a tone or a buzz comes again, s: our choice. A missed buzz would otherwise end in a time-out.
const AGAIN_S: f64 = 3.0;
/// Longest wait for a hand over the centre zone, with which a trial begins, s: the time of a break.
const READY_S: f64 = 1800.0;
/// Period of reading the pins of a virtual board while a cue is awaited, s: the resolution of latencies.
const PINS_EVERY_S: f64 = 1e-4;
/// Longest wait for a cue at the pins, s.
const PINS_S: f64 = 0.5;

/// What a session leaves: its log, and on a virtual board the measured latencies.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Log of the session.
    pub log: SessionLog,
    /// Time from the end of the echo that ended a dwell to the complete next cue at the pins, s.
    pub latencies_s: Vec<f64>,
    /// Time from the hand's entry into the zone to the next cue at the pins, s: the dwell included.
    pub crossings_s: Vec<f64>,
    /// Number of cues that did not appear at the pins as they should.
    pub not_shown: usize,
    /// Number of stays in wrong zones, as the synthetic participant knows them.
    pub wrong_stays: usize,
    /// Ranges and outputs every 10 ms.
    pub trace: Vec<Moment>,
    /// Reason of a session that ended early, in words.
    pub stopped: Option<String>,
}

/// Order of the modalities for participant `number`: a Williams design, balanced over six successive numbers.
#[must_use]
pub fn order(number: u64) -> Vec<Modality> {
    // The remainder keeps the number within a machine word; the design repeats after six.
    williams_order((number % 6) as usize, 3).into_iter().map(|at| Modality::ALL[at]).collect()
}

/// Runs the session of participant `number`: the seed decides zones, orders and, on a virtual board, a synthetic person.
///
/// A stop of the board in the middle of a trial ends the session: outputs are safe, the trial is marked as stopped and
/// does not count. The log up to then is in the outcome.
///
/// # Errors
/// The board cannot be armed, or refuses a subscription.
pub async fn run(session: &Session<'_>, number: u64, period_ms: u16) -> Result<Outcome, Error> {
    let outcome = RefCell::new(Outcome::default());
    outcome.borrow_mut().log.participant = format!("P{number:03}");
    let shared = Shared::default();
    let mut zones = Zones::of(session, period_ms).await?;
    let person = RefCell::new(Person::of(number));
    let is_virtual = session.virtual_board().is_ok();
    let acting = async {
        if is_virtual {
            // The same person acts in all trials; answers are given while the hand rests.
            let mut acts = person.borrow().clone();
            acts.act(session, &shared).await
        } else {
            pending::<Result<Infallible, Error>>().await
        }
    };
    let trials = async {
        let ended = session
            .armed(async || {
                let mut run =
                    Run { session, zones: &mut zones, desk: Desk::new(session), shared: &shared, outcome: &outcome };
                for (place, modality) in order(number).into_iter().enumerate() {
                    run.trial(modality, place, &cue::commands(number, place)).await?;
                    if is_virtual && let Some(trial) = outcome.borrow_mut().log.trials.last_mut() {
                        trial.answers = Some(person.borrow_mut().answers(modality));
                    }
                }
                Ok(())
            })
            .await;
        match ended {
            Err(error @ Error::Board(_)) if !outcome.borrow().log.trials.is_empty() => {
                outcome.borrow_mut().stopped = Some(error.to_string());
                Ok(())
            }
            ended => ended,
        }
    };
    let ended: Result<(), Error> = match select(pin!(trials), pin!(acting)).await {
        Either::Left((ended, _)) => ended,
        Either::Right((ended, _)) => ended.map(|never| match never {}),
    };
    ended?;
    let mut outcome = outcome.into_inner();
    outcome.wrong_stays = shared.wrong_stays.get();
    outcome.trace = shared.trace.take();
    Ok(outcome)
}

struct Run<'a, 's, 'b> {
    session: &'s Session<'b>,
    zones: &'a mut Zones,
    desk: Desk<'s, 'b>,
    shared: &'a Shared,
    outcome: &'a RefCell<Outcome>,
}

impl Run<'_, '_, '_> {
    /// Runs one trial: a hand over the centre zone begins it, then each dwell in the right zone brings the next cue.
    async fn trial(&mut self, modality: Modality, place: usize, commands: &[Command]) -> Result<(), Error> {
        self.shared.asks_ready.set(true);
        let session = self.session;
        let mut sequence = Sequence::new(session);
        let ready = async {
            while self.zones.dwell().await?.0 != Zone::Centre {}
            Ok(())
        };
        sequence.state("ready", READY_S, ready).await?;
        self.shared.asks_ready.set(false);
        let trial = TrialLog { modality, place: place + 1, commands: Vec::new(), is_complete: false, answers: None };
        self.outcome.borrow_mut().log.trials.push(trial);
        let mut ended_ns = self.echo_ns(Zone::Centre);
        for command in commands {
            let log = CommandLog {
                command: *command,
                cued_s: Vec::new(),
                mistakes: Vec::new(),
                reached_s: None,
                timed_out_s: None,
            };
            self.change(|trial| trial.commands.push(log));
            let reach = self.reach(modality, *command, ended_ns);
            match sequence.state("reach", COMMAND_S, reach).await {
                Ok(()) => ended_ns = self.echo_ns(command.zone),
                Err(Error::StateTimedOut { .. }) => {
                    let at_s = session.board.device_us() as f64 * 1e-6;
                    self.change(|trial| {
                        if let Some(log) = trial.commands.last_mut() {
                            log.timed_out_s = Some(at_s);
                        }
                    });
                    // The next cue follows a time-out, not an echo: it has no latency.
                    ended_ns = None;
                }
                Err(error) => return Err(error),
            }
        }
        self.desk.show(&Outputs::default()).await?;
        self.change(|trial| trial.is_complete = true);
        Ok(())
    }

    /// Presents a command's cue until its zone has a dwell.
    async fn reach(&mut self, modality: Modality, command: Command, ended_ns: Option<(u64, u64)>) -> Result<(), Error> {
        let (session, outcome, desk) = (self.session, self.outcome, &self.desk);
        let steps = cue::steps(modality, command);
        let change = |change: &dyn Fn(&mut CommandLog)| {
            if let Some(log) = outcome.borrow_mut().log.trials.last_mut().and_then(|trial| trial.commands.last_mut()) {
                change(log);
            }
        };
        let present = async {
            loop {
                let at_s = session.board.device_us() as f64 * 1e-6;
                change(&|log| log.cued_s.push(at_s));
                for (outputs, for_s) in &steps {
                    desk.show(outputs).await?;
                    if for_s.is_infinite() {
                        pending::<()>().await;
                    }
                    session.board.sleep_s(*for_s).await;
                }
                session.board.sleep_s(AGAIN_S).await;
            }
        };
        let measure = async {
            if let Some(ended_ns) = ended_ns {
                self::measure(session, &steps[0].0, ended_ns, outcome).await?;
            }
            pending::<Result<Infallible, Error>>().await
        };
        let zones = &mut *self.zones;
        let watch = async {
            loop {
                let (zone, at_s) = zones.dwell().await?;
                if zone == command.zone {
                    change(&|log| log.reached_s = Some(at_s));
                    return Ok(());
                }
                change(&|log| log.mistakes.push((zone, at_s)));
            }
        };
        let shown = async {
            match select(pin!(present), pin!(measure)).await {
                Either::Left((ended, _)) => ended,
                Either::Right((ended, _)) => ended,
            }
        };
        let ended: Result<(), Error> = match select(pin!(watch), pin!(shown)).await {
            Either::Left((ended, _)) => ended,
            Either::Right((ended, _)) => {
                let ended: Result<Infallible, Error> = ended;
                ended.map(|never| match never {})
            }
        };
        ended
    }

    fn change(&self, change: impl FnOnce(&mut TrialLog)) {
        if let Some(trial) = self.outcome.borrow_mut().log.trials.last_mut() {
            change(trial);
        }
    }

    /// End of the last echo at a zone's sensor, and entry of the hand, ns; `None` on a real board.
    fn echo_ns(&self, zone: Zone) -> Option<(u64, u64)> {
        let board = self.session.virtual_board().ok()?;
        let fell_ns = board.world().range_sensor(zone as u8)?.echo_fell_ns()?;
        Some((fell_ns, self.shared.entered_ns.get()))
    }
}

/// Reads the pins until they show a cue's first step, and records the time since the echo and since the hand's entry.
async fn measure(
    session: &Session<'_>,
    expected: &Outputs,
    (echo_ns, entered_ns): (u64, u64),
    outcome: &RefCell<Outcome>,
) -> Result<(), Error> {
    loop {
        let (outputs, now_ns) = seen(session)?;
        let since_s = |from_ns: u64| now_ns.saturating_sub(from_ns) as f64 * 1e-9;
        if outputs == *expected {
            let mut outcome = outcome.borrow_mut();
            outcome.latencies_s.push(since_s(echo_ns));
            outcome.crossings_s.push(since_s(entered_ns));
            return Ok(());
        }
        if since_s(echo_ns) > PINS_S {
            outcome.borrow_mut().not_shown += 1;
            return Ok(());
        }
        session.board.sleep_s(PINS_EVERY_S).await;
    }
}
