//! Field mill: conversion of its offset stage's voltage to the undisturbed field, and calibration between plates.
//!
//! `E = (V - V_0) / (k F) - q`, with the voltage V_0 without a field, the datasheet's k, the form factor F of the body,
//! and the field q of the charge that the wheels bring onto the body: `dq/dt = a |ω| - q / T` at a rate ω of the
//! wheels.

use nalgebra::DMatrix;
use r4_maths::least_squares::{linear, nonlinear};
use r4_rig::{Place, Velocity};

use crate::rover::Program;

/// Fields between the plates, V/m: voltages over 1 m. With 250 V/m the offset stage reaches its ends at a form factor of 2.
pub const REFERENCES_V_PER_M: [f64; 5] = [-150.0, -75.0, 0.0, 75.0, 150.0];
/// Index of the reference without a field, at which the wheels turn to measure the charge.
pub const NO_FIELD: usize = 2;
/// Reading time of the mill at each reference, s.
const READS_S: f64 = 4.0;
/// Time for which the wheels turn to and fro, and time for which the charge leaks afterwards, s.
const TURNS_S: f64 = 150.0;
const LEAKS_S: f64 = 120.0;
/// Displacement of one swing, m, and its speed, m/s.
const SWING_M: f64 = 0.5;
const SPEED_M_S: f64 = 0.3;

/// Parameters of a mill on its robot, from a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Voltage without a field, V; it includes the charge at rest.
    pub offset_v: f64,
    /// Form factor: field at the mill over the undisturbed field; dimensionless.
    pub form: f64,
    /// Field that a radian of the wheels adds (a), V/m.
    pub per_rad: f64,
    /// Time constant of the charge's leak (T), s.
    pub leak_s: f64,
}

impl Calibration {
    /// Undisturbed field, V/m, for a voltage, V, and the field of the body's charge, V/m.
    #[must_use]
    pub fn field(&self, volts: f64, charge: f64) -> f64 {
        (volts - self.offset_v) / (super::scene::VOLTS_PER_UNIT * self.form) - charge
    }

    /// Returns the calibration of a mill that stands alone, without a form factor.
    #[must_use]
    pub const fn without_form(self) -> Self {
        Self { form: 1.0, ..self }
    }

    /// Returns the calibration of a mill on a body without charge.
    #[must_use]
    pub const fn without_charge(self) -> Self {
        Self { per_rad: 0.0, ..self }
    }
}

/// Field of the body's charge relative to that at rest, computed from the wheels' motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ChargeState {
    field: f64,
    at_s: f64,
}

impl ChargeState {
    /// Updates the charge by the angle, rad, that the wheels turned until `time_s`, at a constant rate since the last
    /// call.
    pub fn roll(&mut self, of: &Calibration, time_s: f64, angle_rad: f64) {
        let after_s = time_s - self.at_s;
        self.at_s = time_s;
        if after_s > 0.0 {
            let kept = (-after_s / of.leak_s).exp();
            self.field = self.field * kept + of.per_rad * angle_rad * of.leak_s / after_s * (1.0 - kept);
        }
    }

    /// Field of the charge, V/m, relative to that at rest.
    #[must_use]
    pub const fn field(&self) -> f64 {
        self.field
    }
}

/// Program that reads the mill at rest.
#[derive(Debug, Default)]
pub struct Reads {
    sum_v: f64,
    count: f64,
}

impl Reads {
    /// Mean voltage, V; `None` without a sample.
    #[must_use]
    pub fn mean_v(&self) -> Option<f64> {
        (self.count > 0.0).then(|| self.sum_v / self.count)
    }
}

impl Program for Reads {
    fn sense(&mut self, _: f64, _: Place, volts: f64) {
        self.sum_v += volts;
        self.count += 1.0;
    }

    fn drive(&mut self, time_s: f64, _: Place, _: f64) -> Option<Velocity> {
        (time_s < READS_S).then(Velocity::default)
    }
}

/// Program that turns the wheels to and fro, then lets the charge leak.
#[derive(Debug, Default)]
pub struct Turns {
    /// Times, s, and wheel angles since the previous time, rad.
    rolled: Vec<(f64, f64)>,
    /// Times, s, and voltages, V.
    signal: Vec<(f64, f64)>,
}

impl Program for Turns {
    fn sense(&mut self, time_s: f64, _: Place, volts: f64) {
        self.signal.push((time_s, volts));
    }

    fn rolled(&mut self, time_s: f64, angle_rad: f64) {
        self.rolled.push((time_s, angle_rad));
    }

    fn drive(&mut self, time_s: f64, _: Place, _: f64) -> Option<Velocity> {
        if time_s > TURNS_S + LEAKS_S {
            return None;
        }
        let way = if ((time_s * SPEED_M_S / SWING_M) as u64).is_multiple_of(2) { 1.0 } else { -1.0 };
        let forward_m_s = if time_s < TURNS_S { way * SPEED_M_S } else { 0.0 };
        Some(Velocity { forward_m_s, yaw_rad_s: 0.0 })
    }
}

/// Computes offset and form factor from the mean voltages at [`REFERENCES_V_PER_M`], and the charge's parameters from
/// the wheels' motion without a field.
///
/// # Errors
/// A fit that the voltages do not determine, in words.
pub fn calibrated(means_v: &[f64], turns: &Turns) -> Result<Calibration, String> {
    let references = DMatrix::from_fn(means_v.len(), 2, |row, column| [1.0, REFERENCES_V_PER_M[row]][column]);
    let line = linear(&references, means_v).map_err(|error| error.to_string())?;
    let (offset_v, slope) = (line.parameters[0], line.parameters[1]);
    let form = slope / super::scene::VOLTS_PER_UNIT;
    let with = |parameters: &[f64]| Calibration {
        offset_v,
        form,
        per_rad: parameters[0],
        leak_s: parameters[1].clamp(0.0, 8.0).exp(),
    };
    // The offset is fitted again: a remaining charge at rest, and drift, must not be attributed to the wheels.
    let residuals = |parameters: &[f64]| {
        let calibration = with(parameters);
        let (mut charge, mut rolled) = (ChargeState::default(), turns.rolled.iter().peekable());
        let of = |(time_s, volts): &(f64, f64)| {
            while let Some((at_s, angle_rad)) = rolled.next_if(|(at_s, _)| at_s <= time_s) {
                charge.roll(&calibration, *at_s, *angle_rad);
            }
            calibration.field(*volts, charge.field()) - parameters[2]
        };
        turns.signal.iter().map(of).collect()
    };
    let fit = nonlinear(&[0.03, 4.0, 0.0], residuals).map_err(|error| error.to_string())?;
    Ok(with(fit.parameters.as_slice()))
}
