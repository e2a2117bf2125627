//! The inputs that are read each period, whether or not a motor uses them.

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
    shared::{Shared, Status},
};

/// Smooths the speed of an encoder that is read by itself, s.
const ENCODER_FILTER_S: f32 = 0.02;

/// Switches, encoders, analog inputs and supplies.
pub(super) struct Inputs {
    /// Each with its number and the radians of a count.
    encoders: Vec<(u8, f32, Encoder), ENCODERS>,
    /// Each with its number.
    switches: Vec<(u8, Switch), SWITCHES>,
    /// Each with its input.
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

    /// Reads all and tells hosts; returns the causes they show.
    pub(super) fn sense<M: RawMutex>(&mut self, shared: &Shared<M>, peripherals: &mut impl Peripherals) -> Causes {
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
            let age = Duration::from_millis(reading.age_ms.into());
            // One that has never been good is older than the board.
            let taken = now.checked_sub(age).unwrap_or(Instant::MIN);
            Status::Reading { value: reading.volts, quality: reading.quality, taken }
        });
        shared.publish_each(Place::Analog(0), analogs);
        for (index, supply) in self.supplies.iter_mut().enumerate() {
            let (volts, in_range) = supply.update(peripherals.code(supply.analog()));
            shared.publish(Place::Supply(index), Status::Scalar(volts));
            if !in_range {
                causes.set(Cause::SupplyOutOfRange, true);
            }
        }
        causes
    }

    /// Whether switch number `number` is closed, once that is known.
    pub(super) fn is_closed(&self, number: u8) -> Option<bool> {
        self.switches.iter().find(|(of, _)| *of == number).and_then(|(_, switch)| switch.closed())
    }

    /// Volts at analog input number `number`, where it is read and can be relied on.
    pub(super) fn analog_v(&self, number: u8) -> Option<f32> {
        self.analogs.iter().find(|(of, _)| *of == number).and_then(|(_, analog)| analog.good_volts())
    }

    /// Supply at position `index` of the configuration.
    pub(super) fn supply(&self, index: usize) -> Option<&Supply> {
        self.supplies.get(index)
    }

    /// Of every supply, V.
    pub(super) fn supplies_v(&self) -> impl Iterator<Item = f32> + '_ {
        self.supplies.iter().map(Supply::volts)
    }
}
