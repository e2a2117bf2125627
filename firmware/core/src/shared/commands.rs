//! Newest set point of each output: written for hosts, taken by the control loop.

use embassy_time::Instant;
use heapless::Vec;
use r4_protocol::{
    Mode, Setpoint,
    config::{BoardConfig, MAX_BLDCS, MAX_MOTORS, Place, STEPPERS},
};

use super::{
    slots::{OUTPUTS, command_slot, slot},
    statuses::Status,
};

/// Set of outputs: one bit per command slot.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Commanded(u64);

const _: () = assert!(OUTPUTS <= u64::BITS as usize, "a bit for each slot");

impl Commanded {
    /// Returns true if an output has a command; for a brushless drive, one other than to its brake.
    pub(crate) fn has(self, place: Place) -> bool {
        self.has_slot(slot(place))
    }

    /// Returns true if the brake of a brushless drive has a command.
    pub(crate) fn has_brake(self, bldc: usize) -> bool {
        self.has_slot(command_slot(Place::Bldc(bldc), Mode::Brake))
    }

    /// Indices of those of `count` outputs that have a command; `first` is the first of their kind.
    pub(crate) fn among(self, first: Place, count: usize) -> impl Iterator<Item = usize> {
        let mut left = (self.0 >> slot(first)) as u32;
        let indices = core::iter::from_fn(move || {
            let index = left.trailing_zeros();
            left &= left.checked_sub(1)?;
            Some(index as usize)
        });
        indices.take_while(move |index| *index < count)
    }

    fn has_slot(self, slot: usize) -> bool {
        self.0 >> slot & 1 != 0
    }
}

/// Set point that was accepted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Given {
    pub(super) setpoint: Setpoint,
    /// Time of the host's decision, on the board's clock, µs; limited to its arrival, because a date ahead must not
    /// make all following ones look older.
    sent_us: u64,
    /// Date that it came with, µs.
    dated_us: u64,
}

impl Given {
    /// Returns true if it was decided later than a set point of `sent_us`, which was refused. If that has `expired`, an
    /// equal date means the same set point.
    pub(super) fn supersedes(&self, sent_us: u64, expired: bool) -> bool {
        if expired { sent_us <= self.dated_us } else { sent_us < self.sent_us }
    }
}

/// Lease of a cycle's set point: followed until then, unless another comes.
#[derive(Clone, Copy, Debug)]
struct Lease {
    place: Place,
    mode: Mode,
    until: Instant,
}

/// Maximum number of leases: all channels that cycles can move.
const LEASES: usize = MAX_MOTORS + MAX_BLDCS + STEPPERS;

/// Set points of the present arming.
pub(super) struct Commands {
    /// Newest command of each output, with the epoch of its arming.
    commands: [Option<(u16, Setpoint)>; OUTPUTS],
    /// Set of outputs that have a command.
    commanded: Commanded,
    /// Newest set point that each output was given in this arming.
    given: [Option<Given>; OUTPUTS],
    /// Leases, at most one for each channel.
    leases: Vec<Lease, LEASES>,
}

impl Commands {
    pub(super) const fn new() -> Self {
        Self { commands: [None; OUTPUTS], commanded: Commanded(0), given: [None; OUTPUTS], leases: Vec::new() }
    }

    /// Drops all of them, for a new arming.
    pub(super) fn clear(&mut self) {
        self.commands = [None; OUTPUTS];
        self.commanded = Commanded::default();
        self.given = [None; OUTPUTS];
        self.leases.clear();
    }

    /// Stores a command of the arming `epoch` and ends the lease of its channel: the newest command counts.
    pub(super) fn put(&mut self, output: Place, setpoint: Setpoint, epoch: u16, dated_us: u64) {
        self.leases.retain(|lease| lease.place != output);
        let slot = command_slot(output, setpoint.mode);
        self.commands[slot] = Some((epoch, setpoint));
        self.commanded.0 |= 1 << slot;
        let sent_us = dated_us.min(Instant::now().as_micros());
        self.given[slot] = Some(Given { setpoint, sent_us, dated_us });
    }

    /// Leases the command just stored for `place`, in `mode`, until `until`.
    pub(super) fn lease(&mut self, place: Place, mode: Mode, until: Instant) {
        // There is room for every channel, and the command has ended the channel's previous lease.
        let _ = self.leases.push(Lease { place, mode, until });
    }

    /// Ends a lease that has run out at `now`: its output, and the mode of its set point.
    pub(super) fn take_expired(&mut self, now: Instant) -> Option<(Place, Mode)> {
        let place = self.leases.iter().position(|lease| lease.until < now)?;
        let Lease { place, mode, .. } = self.leases.swap_remove(place);
        Some((place, mode))
    }

    /// Takes the newest command to `output` in `mode`, if it is of the arming `epoch`; one of a later arming is left.
    pub(super) fn take(&mut self, output: Place, mode: Mode, epoch: u16) -> Option<Setpoint> {
        let slot = command_slot(output, mode);
        let taken = self.commands[slot].take_if(|(given, _)| *given == epoch);
        // A command of a later arming than the caller's is still to be taken.
        if self.commands[slot].is_none() {
            self.commanded.0 &= !(1 << slot);
        }
        taken.map(|(_, setpoint)| setpoint)
    }

    /// Outputs that have a command, of any arming.
    pub(super) fn commanded(&self) -> Commanded {
        self.commanded
    }

    /// Newest set point that `output`, or its brake, was given in this arming.
    pub(super) fn given(&self, output: Place) -> Option<Given> {
        let slots = [command_slot(output, Mode::Duty), command_slot(output, Mode::Brake)];
        slots.into_iter().filter_map(|slot| *self.given.get(slot)?).max_by_key(|given| given.sent_us)
    }

    /// Returns true if a set point is leased.
    #[cfg(test)]
    pub(super) fn has_leases(&self) -> bool {
        !self.leases.is_empty()
    }
}

/// Set point that stops a motor, by the mode that it followed.
pub(super) const fn at_rest(mode: Mode) -> Setpoint {
    match mode {
        // A motor in force mode stays in its place, and so holds the object.
        Mode::Position | Mode::Speed | Mode::Home | Mode::Follow | Mode::Force => {
            Setpoint { mode: Mode::Speed, value: 0.0 }
        }
        _ => Setpoint::NONE,
    }
}

/// Set point that stops `output`, which follows `follows` and has `status`; `None` when `follows` itself is a stop.
pub(super) fn stop_of(config: &BoardConfig, output: Place, follows: Setpoint, status: Status) -> Option<Setpoint> {
    let setpoint = |mode, value| Some(Setpoint { mode, value });
    match (output, status) {
        (Place::Motor(_), _) => Some(at_rest(follows.mode)),
        (Place::Stepper(_), _) => setpoint(Mode::Speed, 0.0),
        // Neutral would release the brake.
        (Place::Bldc(_), _) if follows.mode == Mode::Brake && follows.value != 0.0 => None,
        (Place::Bldc(_), _) => setpoint(Mode::Duty, 0.0),
        // The present angle, on its way.
        (Place::Servo(_), Status::Scalar(angle_rad)) => setpoint(Mode::Position, angle_rad),
        // Open and at the safe voltage, as in the safe state.
        (Place::Relay(_), _) => setpoint(Mode::Switch, 0.0),
        (Place::Dac(index), _) => setpoint(Mode::Voltage, config.dacs[index].safe_v),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::robot;

    /// A query for a kind equals the queries for each of its channels, whatever neighbouring kinds were commanded.
    #[test]
    fn commanded_channels_of_a_kind_are_those_one_by_one() {
        let config = robot("every-interface");
        let kinds = [
            (Place::Motor as fn(usize) -> Place, config.motors.len()),
            (Place::Servo, config.servos.len()),
            (Place::Stepper, config.steppers.len()),
            (Place::Relay, config.relays.len()),
            (Place::Dac, config.dacs.len()),
        ];
        for every in 1..8 {
            let slots = (0..OUTPUTS).filter(|slot| slot % every == 0);
            let commanded = Commanded(slots.fold(0, |set, slot| set | 1 << slot));
            for (place, count) in kinds {
                let one_by_one = (0..count).filter(|index| commanded.has(place(*index)));
                assert!(commanded.among(place(0), count).eq(one_by_one), "every {every} at {:?}", place(0));
            }
        }
    }
}
