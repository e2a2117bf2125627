//! Inputs that are read each period, whether or not a motor uses them.

use core::f32::consts::TAU;

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant};
use heapless::Vec;
use r4_protocol::{
    Cause, Causes,
    config::{ANALOG_INPUTS, BoardConfig, ENCODERS, MAX_SUPPLIES, Place, SWITCHES},
};

use crate::{
    platform::Peripherals,
    sensing::{
        analog::{Analog, Supply},
        encoder::Encoder,
        switch::Switch,
    },
    shared::{ControlSide, Status},
};

/// Time constant of the speed filter of an encoder that no motor uses, s.
const ENCODER_FILTER_S: f32 = 0.02;

/// State of switches, encoders, analog inputs and supplies.
pub(super) struct Inputs {
    /// Encoders, each with its number and the radians per count.
    encoders: Vec<(u8, f32, Encoder), ENCODERS>,
    /// Switches, each with its number.
    switches: Vec<(u8, Switch), SWITCHES>,
    /// Analog inputs, each with its number.
    analogs: Vec<(u8, Analog), ANALOG_INPUTS>,
    supplies: Vec<Supply, MAX_SUPPLIES>,
}

impl Inputs {
    pub(super) fn new(config: &BoardConfig, period_s: f32) -> Self {
        let encoders = config.encoders.iter().map(|encoder| {
            let state = Encoder::new(encoder.inverted, period_s, ENCODER_FILTER_S);
            (encoder.id.index, TAU / encoder.counts_per_turn as f32, state)
        });
        let switches = config.switches.iter().map(|switch| (switch.id.index, Switch::new(switch, period_s)));
        let analogs = config.analogs.iter().map(|analog| (analog.id.index, Analog::new(analog, period_s)));
        Self {
            encoders: encoders.collect(),
            switches: switches.collect(),
            analogs: analogs.collect(),
            supplies: config.supplies.iter().map(|supply| Supply::new(supply, period_s)).collect(),
        }
    }

    /// Reads all inputs and publishes them; returns the causes that they show.
    pub(super) fn sense<M: RawMutex>(
        &mut self,
        shared: ControlSide<'_, M>,
        peripherals: &mut impl Peripherals,
    ) -> Causes {
        let mut causes = Causes::NONE;
        let switches = self.switches.iter_mut().map(|(number, switch)| {
            let closed = switch.update(peripherals.is_high(*number));
            Status::Scalar(closed.into())
        });
        shared.publish_each(Place::Switch(0), switches);
        let encoders = self.encoders.iter_mut().map(|(number, radians, encoder)| {
            let (position, counts_per_s) = encoder.update(peripherals.count(*number));
            Status::Encoder { position, speed: counts_per_s * *radians, illegal: peripherals.illegal(*number) }
        });
        shared.publish_each(Place::Encoder(0), encoders);
        let now = Instant::now();
        let analogs = self.analogs.iter_mut().map(|(input, analog)| {
            let reading = analog.update(peripherals.code(*input));
            let taken = match reading.age_ms {
                0 => now,
                // An input that has never been good has the greatest age.
                age_ms => now.checked_sub(Duration::from_millis(age_ms.into())).unwrap_or(Instant::MIN),
            };
            Status::Reading { value: reading.volts, quality: reading.quality, taken }
        });
        shared.publish_each(Place::Analog(0), analogs);
        let supplies = self.supplies.iter_mut().map(|supply| {
            let (volts, in_range) = supply.update(peripherals.code(supply.analog()));
            if !in_range {
                causes.set(Cause::SupplyOutOfRange, true);
            }
            Status::Scalar(volts)
        });
        shared.publish_each(Place::Supply(0), supplies);
        causes
    }

    /// State of switch number `number`, true for closed; `None` while unknown.
    pub(super) fn is_closed(&self, number: u8) -> Option<bool> {
        self.switches.iter().find(|(of, _)| *of == number).and_then(|(_, switch)| switch.closed())
    }

    /// Voltage at analog input number `number`, V; `None` where it is not read or cannot be relied on.
    pub(super) fn analog_v(&self, number: u8) -> Option<f32> {
        self.analogs.iter().find(|(of, _)| *of == number).and_then(|(_, analog)| analog.good_volts())
    }

    /// Supply at position `index` of the configuration.
    pub(super) fn supply(&self, index: usize) -> Option<&Supply> {
        self.supplies.get(index)
    }

    /// Filtered voltage of every supply, V.
    pub(super) fn supplies_v(&self) -> impl Iterator<Item = f32> + '_ {
        self.supplies.iter().map(Supply::volts)
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::Quality;

    use super::*;
    use crate::{
        shared::ResetCause,
        testing::{self, Board, Peripherals, Tasks},
    };

    const PERIOD_S: f32 = 1e-3;

    /// Bench with only number 1, 2 or 3 of each kind, so that the position in the configuration differs from the
    /// number; 24 V.
    fn bench() -> (Board, Inputs, Peripherals) {
        let mut config = testing::robot("every-interface");
        config.encoders.retain(|encoder| encoder.id.index == 2);
        config.switches.retain(|switch| switch.id.index == 3);
        config.analogs.retain(|analog| analog.id.index == 1);
        let inputs = Inputs::new(&config, PERIOD_S);
        let board = testing::board(config, ResetCause::Normal);
        let peripherals = Peripherals::default();
        peripherals.codes[4].set(code(board, 0, 24.0));
        peripherals.codes[5].set(code(board, 1, 12.0));
        (board, inputs, peripherals)
    }

    fn code(board: Board, supply: usize, volts: f32) -> u16 {
        (volts / board.config().supplies[supply].volts_per_code) as u16
    }

    #[test]
    fn a_switch_is_known_by_its_number_once_it_is_steady() {
        let (board, mut inputs, mut peripherals) = bench();
        peripherals.low[3].set(true);
        assert_eq!((inputs.is_closed(3), inputs.is_closed(0)), (None, None));
        for low in [true, false] {
            peripherals.low[3].set(low);
            for _ in 0..5 {
                inputs.sense(board.as_control(), &mut peripherals);
            }
            assert_eq!((inputs.is_closed(3), inputs.is_closed(0)), (Some(low), None));
            assert_eq!(board.report().status(Place::Switch(0)), Status::Scalar(low.into()));
        }
    }

    /// An encoder of 2400 counts per turn; a steady count per period is its speed within the ripple of the filter.
    #[test]
    fn an_encoder_shows_counts_turns_and_what_no_shaft_does() {
        let (board, mut inputs, mut peripherals) = bench();
        peripherals.illegal[2].set(7);
        for counts in 0..1000 {
            peripherals.counts[2].set(counts);
            inputs.sense(board.as_control(), &mut peripherals);
        }
        let Status::Encoder { position, speed, illegal } = board.report().status(Place::Encoder(0)) else {
            panic!("an encoder")
        };
        assert_eq!((position, illegal), (999, 7));
        let expected = TAU / 2400.0 / PERIOD_S;
        assert!((speed / expected - 1.0).abs() < 1e-3, "{speed} rad/s");
        // Backward Euler of 20 ms: 1 - (1 + 1/20)^-20 of the step to twice that.
        for counts in 0..20 {
            peripherals.counts[2].set(1001 + 2 * counts);
            inputs.sense(board.as_control(), &mut peripherals);
        }
        let Status::Encoder { speed, .. } = board.report().status(Place::Encoder(0)) else { panic!("an encoder") };
        assert!((speed / expected - 1.623).abs() < 2e-3, "{speed} rad/s");
    }

    /// The time of a reading is that of its last good code.
    #[test]
    fn an_analog_input_shows_its_volts_and_when_they_were_good() {
        let (board, mut inputs, mut peripherals) = bench();
        let mut tasks = Tasks::default();
        let analog = board.config().analogs[0];
        assert_eq!(inputs.analog_v(1), None);
        peripherals.codes[1].set(0);
        inputs.sense(board.as_control(), &mut peripherals);
        // The greatest age that can be reported.
        let never = Instant::now() - Duration::from_millis(u16::MAX.into());
        let never = Status::Reading { value: 0.0, quality: Quality::Low, taken: never };
        assert_eq!(board.report().status(Place::Analog(0)), never);
        peripherals.codes[1].set(20_000);
        for _ in 0..20 {
            tasks.advance(Duration::from_millis(1));
            inputs.sense(board.as_control(), &mut peripherals);
        }
        let (good, volts) = (Instant::now(), 20_000.0 * analog.volts_per_code + analog.offset_v);
        assert_eq!((inputs.analog_v(1), inputs.analog_v(0)), (Some(volts), None));
        let shown = Status::Reading { value: volts, quality: Quality::Good, taken: good };
        assert_eq!(board.report().status(Place::Analog(0)), shown);
        peripherals.codes[1].set(0);
        for _ in 0..20 {
            tasks.advance(Duration::from_millis(1));
            inputs.sense(board.as_control(), &mut peripherals);
        }
        assert_eq!(inputs.analog_v(1), None);
        let shown = Status::Reading { value: volts, quality: Quality::Low, taken: good };
        assert_eq!(board.report().status(Place::Analog(0)), shown);
    }

    /// Each supply raises the cause on its own, and is shown to hosts.
    #[test]
    fn every_supply_is_watched() {
        for (low, volts) in [(0, [12.0, 12.0]), (1, [24.0, 5.0])] {
            let (board, mut inputs, mut peripherals) = bench();
            assert_eq!(inputs.sense(board.as_control(), &mut peripherals), Causes::NONE);
            let (_, mut inputs, _) = bench();
            peripherals.codes[4 + low].set(code(board, low, volts[low]));
            assert_eq!(inputs.sense(board.as_control(), &mut peripherals), Causes::only(Cause::SupplyOutOfRange));
            for (index, (shown, volts)) in inputs.supplies_v().zip(volts).enumerate() {
                assert!((shown - volts).abs() < 0.01, "{shown} V");
                assert_eq!(board.report().status(Place::Supply(index)), Status::Scalar(shown));
                assert_eq!(inputs.supply(index).map(Supply::volts), Some(shown));
            }
            assert!(inputs.supply(2).is_none());
        }
    }
}
