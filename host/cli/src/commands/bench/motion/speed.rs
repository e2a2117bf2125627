//! Quality of a board's speed estimate: gain and delay against its own positions.

use std::{cell::RefCell, f64::consts::TAU, rc::Rc};

use r4_boards::Robot;
use r4_plants::PlantSpec;
use r4_protocol::{ChannelId, ChannelKind, Mode, Sample, Setpoint};
use r4_rig::{Error, Rig, Session};

use crate::args::Args;

/// Motor without friction and dead band on the bench's OSMC: 8.7 rad/s at full duty, time constant 64 ms.
const MOTOR: &str = r#"
model = "dc-gear-motor"
source = "synthetic: r4 bench motion"
[parameters]
resistance_ohm = 2.4
inductance_h = 0.001
torque_constant_nm_per_a = 0.11
gear_ratio = 25.0
inertia_kg_m2 = 0.2
viscous_nm_s_per_rad = 0.03
"#;
/// Model of the motor for its robot's file: 1 / 8.7 duty s/rad, and 64 ms times that.
const DUTY_PER_SPEED: f32 = 0.115;
const TIME_CONSTANT_S: f32 = 0.064;
const CHANNEL: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
/// Mean and amplitude of the duty, which oscillates around a steady rotation so that friction and encoder edges have no
/// influence.
const DUTY: f64 = 0.45;
const SWING: f64 = 0.3;
/// Period of the board's control and of its samples, s.
const PERIOD_S: f64 = 0.001;
/// Period of the set points, start of the evaluation, and duration, s.
const EVERY_S: f64 = 0.002;
const SETTLES_S: f64 = 1.0;
const LASTS_S: f64 = 4.0;

/// Gain of the reported speed relative to that of the positions, and its delay behind it, s.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub(super) gain: f64,
    pub(super) delay_s: f64,
}

/// Measures an oscillation of `hz` with the observer's model, or without it behind the low-pass of the same time
/// constant.
pub(super) fn seen(args: &Args, hz: f64, has_model: bool) -> anyhow::Result<Seen> {
    let plant = PlantSpec::from_toml("motor of r4 bench motion", MOTOR)?;
    let alter = move |robot: &mut Robot| {
        for motor in robot.simulation.motors.iter_mut().filter(|motor| motor.channel == CHANNEL) {
            motor.plant = r4_boards::PlantFile { name: "motor of r4 bench motion".to_owned(), text: plant.to_toml() };
        }
        let configured = robot.config.motors.iter_mut().filter(|motor| motor.id == CHANNEL);
        for motor in configured {
            // Winding of this motor, so that the oscillation does not count as an overload.
            if let Some(winding) = &mut motor.winding {
                (winding.dead_duty, winding.resistance_ohm, winding.back_emf) = (0.0, 2.4, 25.0 * 0.11);
                winding.rated_a = 5.0;
            }
            let Some(control) = &mut motor.control else { continue };
            control.feed_forward.static_duty = 0.0;
            control.feed_forward.duty_per_speed = DUTY_PER_SPEED;
            control.feed_forward.duty_per_acceleration = if has_model { TIME_CONSTANT_S * DUTY_PER_SPEED } else { 0.0 };
        }
    };
    let rig = Rig { seed: args.seed, alter: Some(Rc::new(alter)), ..Rig::new("sim:osmc-bench".parse()?) };
    let (looks, _) = rig.run(None, async |session| swing(session, hz).await)?;
    let period = (1.0 / (hz * PERIOD_S)).round() as usize;
    anyhow::ensure!(looks.len() >= 2 * period, "too few samples of {CHANNEL} for {hz} Hz: {}", looks.len());
    let [position, speed] = [0, 1].map(|of| harmonic(&looks.iter().map(|look| look[of]).collect::<Vec<_>>(), period));
    // The derivative of an oscillation has ω times its amplitude and leads by a quarter of a turn.
    let gain = speed.0 / (TAU * hz * position.0);
    let late = (position.1 + TAU / 4.0 - speed.1).rem_euclid(TAU);
    let late = if late > TAU / 2.0 { late - TAU } else { late };
    Ok(Seen { gain, delay_s: late / (TAU * hz) })
}

/// Position and speed of each control period once the oscillation is steady, rad and rad/s.
async fn swing(session: &Session<'_>, hz: f64) -> Result<Vec<[f64; 2]>, Error> {
    let board = session.board;
    let resolution = f64::from(board.channel(CHANNEL)?.resolution);
    let mut samples = board.samples(CHANNEL, 1).await?;
    let seen = RefCell::new(Vec::new());
    session
        .armed(async || {
            board.sleep_s(0.1).await;
            let begin_us = board.device_us();
            let after_s = |device_us: u64| (device_us as f64 - begin_us as f64) * 1e-6;
            while after_s(board.device_us()) < LASTS_S {
                let value = DUTY + SWING * (TAU * hz * after_s(board.device_us())).sin();
                board.set(CHANNEL, Setpoint { mode: Mode::Duty, value: value as f32 }).await?;
                board.sleep_s(EVERY_S).await;
                while let Some(sample) = samples.try_next() {
                    let Sample::Motor { position, speed, .. } = sample.sample else { continue };
                    if after_s(sample.device_us) >= SETTLES_S {
                        seen.borrow_mut().push([f64::from(position) * resolution, f64::from(speed)]);
                    }
                }
            }
            Ok::<_, Error>(())
        })
        .await?;
    Ok(seen.into_inner())
}

/// Amplitude and phase, rad, of an oscillation with a period of `period` samples around a linear trend, over whole
/// periods.
fn harmonic(values: &[f64], period: usize) -> (f64, f64) {
    let whole = values.len() / period * period;
    let values = &values[values.len() - whole..];
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    // The mean over a whole period contains no oscillation, so the means of the first and last period give the trend.
    let slope = (mean(&values[whole - period..]) - mean(&values[..period])) / (whole - period) as f64;
    let (mut sin, mut cos) = (0.0f64, 0.0f64);
    for (index, value) in values.iter().enumerate() {
        let steady = slope * index as f64;
        let angle = TAU * index as f64 / period as f64;
        sin += 2.0 / whole as f64 * (value - steady) * angle.sin();
        cos += 2.0 / whole as f64 * (value - steady) * angle.cos();
    }
    (sin.hypot(cos), cos.atan2(sin))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swing_on_a_ramp_is_read_off() {
        let values: Vec<f64> =
            (0..1000).map(|at| 3.0 + 0.2 * f64::from(at) + 0.5 * (TAU * f64::from(at) / 100.0 + 0.3).sin()).collect();
        let (amplitude, phase) = harmonic(&values, 100);
        assert!((amplitude - 0.5).abs() < 1e-9 && (phase - 0.3).abs() < 1e-9, "{amplitude}, {phase}");
    }
}
