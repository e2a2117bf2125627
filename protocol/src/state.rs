//! Safety states of a board, and the causes that trip it.

use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// State of the board's safety supervisor. Outputs move only in [`SafetyState::Armed`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum SafetyState {
    /// Outputs are safe; the board can be armed while no cause is present.
    Disarmed,
    /// Outputs follow set points.
    Armed,
    /// Outputs are safe; this holds until a host clears it while no cause is present.
    Tripped,
}

impl fmt::Display for SafetyState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Disarmed => "disarmed",
            Self::Armed => "armed",
            Self::Tripped => "tripped",
        })
    }
}

/// Cause of a trip. The number is the bit in [`Causes`]: append, never reorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Cause {
    /// The dead-man's handle is released or its wire is cut.
    DeadMan = 0,
    /// A range sensor measures less than its limit, or stops measuring.
    Proximity = 1,
    /// No heartbeat has come from the host within the configured time-out.
    LinkLost = 2,
    /// A host has asked for a stop.
    HostStop = 3,
    /// The board has been reset by its watchdog.
    WatchdogReset = 4,
    /// A transfer on the board's I2C bus failed and could not be recovered.
    I2cFault = 5,
    /// A chip does not hold what was written to it.
    ReadBackMismatch = 6,
    /// A supply rail is outside its configured range.
    SupplyOutOfRange = 7,
    /// Position feedback contradicts the drive: wrong way, impossible speed, sensor open or shorted.
    EncoderImplausible = 8,
    /// A motor is driven hard and does not move.
    Stalled = 9,
    /// The control loop has missed its deadline repeatedly.
    ControlOverrun = 10,
    /// The configuration is missing or contradicts itself.
    BadConfiguration = 11,
    /// The button at the auxiliary stop input is pressed or its wire is cut.
    AuxiliaryStop = 12,
    /// A motor's winding is as hot as it may become, by its current and thermal time constant.
    Overload = 13,
    /// The processor's crystal stopped, or its clock disagrees with an independent oscillator.
    ClockFault = 14,
    /// The firmware has ended badly several times in a row: the board only holds its outputs safe, until it is
    /// restarted.
    RepeatedBadStarts = 15,
    /// An input has had more edges than its sensor can make: its interrupt is masked, and its edges are lost.
    InterruptStorm = 16,
    /// The firmware's image in flash is not what was built: the board only holds its outputs safe, until it is flashed.
    DamagedImage = 17,
    /// A motor's force sensor measures more than its limit.
    ForceLimit = 18,
}

impl Cause {
    /// All causes, in bit order.
    pub const ALL: [Self; 19] = [
        Self::DeadMan,
        Self::Proximity,
        Self::LinkLost,
        Self::HostStop,
        Self::WatchdogReset,
        Self::I2cFault,
        Self::ReadBackMismatch,
        Self::SupplyOutOfRange,
        Self::EncoderImplausible,
        Self::Stalled,
        Self::ControlOverrun,
        Self::BadConfiguration,
        Self::AuxiliaryStop,
        Self::Overload,
        Self::ClockFault,
        Self::RepeatedBadStarts,
        Self::InterruptStorm,
        Self::DamagedImage,
        Self::ForceLimit,
    ];

    /// Returns what a person can do about the cause.
    #[must_use]
    pub const fn advice(self) -> &'static str {
        match self {
            Self::DeadMan => "hold the dead-man's handle, or check its wire",
            Self::Proximity => "clear the space in front of the range sensors",
            Self::LinkLost => "keep one host connected; it must send a heartbeat within the timeout",
            Self::HostStop => "clear it when it is safe to go on",
            Self::WatchdogReset => "read the fault history before going on: the firmware hung",
            Self::I2cFault => "check the board's I2C wiring and pull-ups",
            Self::ReadBackMismatch => "check the output chips' supply",
            Self::SupplyOutOfRange => "check the battery and the fuses",
            Self::EncoderImplausible => "check the encoder or potentiometer wiring and its direction",
            Self::Stalled => {
                "check that its sensor shows motion, free the mechanism or ask for less; then raise limits"
            }
            Self::ControlOverrun => "report it: the control loop does not fit its period",
            Self::BadConfiguration => "correct the robot's configuration",
            Self::AuxiliaryStop => "release the stop button, or check its wire",
            Self::Overload => "free the mechanism or ask for less, and let the motor cool down",
            Self::ClockFault => "switch the board off and on; if it comes back, replace the crystal",
            Self::RepeatedBadStarts => "outputs are only held safe: read the log, then switch off and on, or flash",
            Self::InterruptStorm => "check wire and shield of encoder 3 and the range sensors; the log names the input",
            Self::DamagedImage => "outputs are only held safe: flash the firmware again, as with `r4 flash`",
            Self::ForceLimit => "free what is pressed by hand, check the force sensor, or ask for less force",
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::DeadMan => "dead-man released",
            Self::Proximity => "proximity",
            Self::LinkLost => "link lost",
            Self::HostStop => "host stop",
            Self::WatchdogReset => "watchdog reset",
            Self::I2cFault => "I2C fault",
            Self::ReadBackMismatch => "read-back mismatch",
            Self::SupplyOutOfRange => "supply out of range",
            Self::EncoderImplausible => "feedback implausible",
            Self::Stalled => "stalled",
            Self::ControlOverrun => "control overrun",
            Self::BadConfiguration => "bad configuration",
            Self::AuxiliaryStop => "auxiliary stop",
            Self::Overload => "overload",
            Self::ClockFault => "clock fault",
            Self::RepeatedBadStarts => "repeated bad starts",
            Self::InterruptStorm => "interrupt storm",
            Self::DamagedImage => "damaged image",
            Self::ForceLimit => "force limit",
        })
    }
}

/// Set of causes, a bit for each [`Cause`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Causes(u32);

impl Causes {
    /// Set without a cause.
    pub const NONE: Self = Self(0);

    /// Makes the set of one cause.
    #[must_use]
    pub const fn only(cause: Cause) -> Self {
        Self(1 << cause as u8)
    }

    /// Returns whether the set is empty; a bit without a known cause counts.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns whether the set contains `cause`.
    #[must_use]
    pub const fn contains(self, cause: Cause) -> bool {
        self.0 & (1 << cause as u8) != 0
    }

    /// Returns the causes of both sets.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Adds `cause` to the set, or removes it.
    pub const fn set(&mut self, cause: Cause, present: bool) {
        let bit = 1 << cause as u8;
        if present {
            self.0 |= bit;
        } else {
            self.0 &= !bit;
        }
    }

    /// Returns the bits of the set, bit n being [`Cause::ALL`]`[n]`.
    #[must_use]
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// Makes a set of bits. Bits without a cause are kept, so that a newer board's cause is not lost.
    #[must_use]
    pub const fn from_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// Causes that leave the supply, the bus and the control loop working, so that motors can be braked before they are
    /// switched off.
    const BRAKED: Self = Self::only(Cause::Proximity)
        .union(Self::only(Cause::LinkLost))
        .union(Self::only(Cause::HostStop))
        .union(Self::only(Cause::EncoderImplausible))
        .union(Self::only(Cause::Stalled));

    /// Returns whether a stop for these causes may brake before it switches off (IEC 60204-1, category 1). A single
    /// cause that takes the power away at once forbids it, and so does one that this version does not know. The empty
    /// set, as when a host disarms, allows it.
    #[must_use]
    pub const fn allow_braking(self) -> bool {
        self.0 & !Self::BRAKED.0 == 0
    }

    /// Iterates over the causes that this version knows, in bit order.
    pub fn iter(self) -> impl Iterator<Item = Cause> {
        let mut left = self.0;
        core::iter::from_fn(move || {
            while left != 0 {
                let bit = left.trailing_zeros();
                // Clears the lowest bit that is set.
                left &= left - 1;
                if let Some(cause) = Cause::ALL.get(bit as usize) {
                    return Some(*cause);
                }
            }
            None
        })
    }
}

impl fmt::Display for Causes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        for cause in self.iter() {
            write!(f, "{separator}{cause}")?;
            separator = ", ";
        }
        if self.is_empty() { f.write_str("none") } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::string::ToString;

    use super::*;

    #[test]
    fn every_cause_has_its_own_bit_and_comes_back() {
        for (bit, cause) in Cause::ALL.into_iter().enumerate() {
            let only = Causes::only(cause);
            assert_eq!(only.bits(), 1 << bit);
            assert!(only.iter().eq([cause]));
        }
    }

    /// Tries every set of two causes, together with a bit that this version does not know.
    #[test]
    fn a_set_holds_what_was_put_in_and_not_taken_out() {
        let newer = Causes::from_bits(1 << 31);
        for one in Cause::ALL {
            for other in Cause::ALL {
                let both = Causes::only(one).union(Causes::only(other)).union(newer);
                for cause in Cause::ALL {
                    assert_eq!(both.contains(cause), cause == one || cause == other, "{cause} in {both}");
                }
                assert!(!both.is_empty());
                let mut set = newer;
                for present in [true, true, false, false, true] {
                    set.set(one, present);
                    set.set(other, true);
                    assert_eq!(set.contains(one), present || one == other);
                    assert!(set.contains(other));
                    assert_eq!(set.bits() & newer.bits(), newer.bits(), "what is not known is kept");
                }
                assert_eq!(set, both);
            }
        }
        assert!(Causes::NONE.is_empty() && Causes::default().is_empty());
        assert_eq!(Causes::from_bits(0), Causes::NONE);
        assert!(!newer.is_empty(), "a cause of a newer board is one");
    }

    /// Tries every possible set.
    #[test]
    fn a_stop_brakes_only_where_every_cause_leaves_supply_bus_and_loop_working() {
        const LEAVES_THEM: [Cause; 5] =
            [Cause::Proximity, Cause::LinkLost, Cause::HostStop, Cause::EncoderImplausible, Cause::Stalled];
        for bits in 0..1 << Cause::ALL.len() {
            let causes = Causes::from_bits(bits);
            assert_eq!(causes.allow_braking(), causes.iter().all(|cause| LEAVES_THEM.contains(&cause)), "{causes}");
        }
        for unknown in Cause::ALL.len()..32 {
            assert!(!Causes::from_bits(1 << unknown).allow_braking(), "bit {unknown}");
        }
    }

    #[test]
    fn every_cause_has_its_own_name_and_says_what_to_do() {
        for (place, cause) in Cause::ALL.into_iter().enumerate() {
            assert!(cause.advice().contains(' '), "{cause}");
            for other in &Cause::ALL[..place] {
                assert_ne!(other.advice(), cause.advice());
                assert_ne!(other.to_string(), cause.to_string());
            }
        }
        assert_eq!(Causes::NONE.to_string(), "none");
        let two = Causes::only(Cause::Stalled).union(Causes::only(Cause::DeadMan));
        assert_eq!(two.to_string(), "dead-man released, stalled");
    }
}
