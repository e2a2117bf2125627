//! Several virtual boards on one clock.

use std::{rc::Rc, time::Instant};

use futures::future::{try_join, try_join_all};
use r4_sim::{Pace, Simulation};

use crate::{Elapsed, Error, HostClock, NotVirtual, Rig, Session};

/// Virtual boards that share one event clock, and the program that coordinates them.
///
/// Without boards it is a clock alone: a program of timed events runs on it as it does beside boards.
///
/// ```
/// use r4_rig::{Error, Fleet, Rig};
///
/// let rig = Rig::new("sim:osmc-bench".parse()?);
/// let fleet = Fleet::new(vec![rig.clone(), rig]);
/// let member = async |_: usize, session: &r4_rig::Session<'_>| {
///     session.board.sleep_s(0.1).await;
///     Ok::<_, Error>(session.board.now_s())
/// };
/// let (_, ended_s, _) = fleet.run(member, async |_| Ok(()))?;
/// assert_eq!(ended_s.len(), 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Fleet {
    /// Boards with their environments; the pace of each rig is ignored.
    pub rigs: Vec<Rig>,
    /// Pace of the common clock.
    pub pace: Pace,
}

impl Fleet {
    /// Creates a fleet whose clock runs as fast as the computer can.
    #[must_use]
    pub fn new(rigs: Vec<Rig>) -> Self {
        Self { rigs, pace: Pace::Free }
    }

    /// Connects to all boards and runs `member` in a session with each, with the board's number, beside `work`, which
    /// coordinates them. Ends when all of these have ended; returns the results of `work`, and of the members in order.
    ///
    /// # Errors
    /// The first error of `work` or of a member, which ends all others; [`NotVirtual`] for a board on a link;
    /// [`Error::Stopped`] when an emulated board stops.
    pub fn run<T, M, E: From<Error>>(
        &self,
        member: impl AsyncFn(usize, &Session<'_>) -> Result<M, E>,
        work: impl AsyncFnOnce(&HostClock) -> Result<T, E>,
    ) -> Result<(T, Vec<M>, Elapsed), E> {
        let mut simulation = Simulation::new(self.pace);
        if let Some(rig) = self.rigs.iter().find(|rig| rig.target.robot().is_err()) {
            return Err(Error::from(NotVirtual(rig.target.clone())).into());
        }
        let power_up = |rig: &Rig| rig.power_up(&mut simulation);
        let boards = self.rigs.iter().map(power_up).collect::<Result<Vec<_>, _>>()?;
        let clock = simulation.clock();
        let begin = Instant::now();
        let host_clock = HostClock::Virtual(clock.clone());
        let member = &member;
        let members = self.rigs.iter().zip(&boards).enumerate().map(|(number, (rig, (board, _)))| {
            let clock = &clock;
            async move {
                rig.attached(Rc::clone(board), clock, async |session: &Session<'_>| member(number, session).await).await
            }
        });
        let ended = simulation.block_on(try_join(work(&host_clock), try_join_all(members)));
        // Checked before the result, since a failed board is the cause of a standstill.
        if let Some(failure) = boards.iter().find_map(|(board, _)| board.failure()) {
            return Err(Error::Stopped(failure).into());
        }
        let ended = ended.ok_or(Error::Standstill)?;
        let elapsed = Elapsed { simulated_s: clock.now_ns() as f64 * 1e-9, wall_s: begin.elapsed().as_secs_f64() };
        for (board, file) in &boards {
            if let Some(file) = file {
                // Also after an error of a member: the flash keeps what was stored until then.
                file.write(&board.flash()).map_err(Error::from)?;
            }
        }
        let (value, members) = ended?;
        Ok((value, members, elapsed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Members sleep until the same moment and read the same clock, beside a coordinator on it.
    #[test]
    fn boards_and_coordinator_share_one_clock() {
        let rig = Rig::new("sim:osmc-bench".parse().expect("a board"));
        let fleet = Fleet::new(vec![rig.clone(), rig]);
        let until_us = 300_000;
        let member = async |number: usize, session: &Session<'_>| {
            r4_driver::Clock::sleep_until(&session.clock, until_us).await;
            Ok::<_, Error>((number, r4_driver::Clock::now_us(&session.clock)))
        };
        let work = async |clock: &HostClock| {
            r4_driver::Clock::sleep_until(clock, until_us).await;
            Ok(r4_driver::Clock::now_us(clock))
        };
        let (coordinator_us, members, _) = fleet.run(member, work).expect("two boards");
        assert_eq!(coordinator_us, until_us);
        assert_eq!(members, [(0, until_us), (1, until_us)]);
    }

    #[test]
    fn without_boards_it_is_a_clock() {
        let work = async |clock: &HostClock| {
            r4_driver::Clock::sleep_until(clock, 5_000_000).await;
            Ok::<_, Error>(r4_driver::Clock::now_us(clock))
        };
        let member = async |_: usize, _: &Session<'_>| Ok(());
        let (now_us, members, elapsed) = Fleet::new(Vec::new()).run(member, work).expect("a clock");
        assert_eq!((now_us, members.len()), (5_000_000, 0));
        assert!((elapsed.simulated_s - 5.0).abs() < 1e-9);
    }

    #[test]
    fn a_member_on_a_link_is_refused() {
        let fleet = Fleet::new(vec![Rig::new("tcp:127.0.0.1:1".parse().expect("an address"))]);
        let ended = fleet.run(async |_: usize, _: &Session<'_>| Ok::<_, Error>(()), async |_| Ok(()));
        let error = ended.expect_err("no shared clock").to_string();
        assert!(error.contains("tcp:127.0.0.1:1"), "{error}");
    }
}
