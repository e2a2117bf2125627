//! The desk's channels: shows cues, detects dwells in zones, and reads the pins of a virtual board.

use std::cell::RefCell;

use futures::future::try_join_all;
use r4_driver::TelemetryStream;
use r4_protocol::{ChannelId, ChannelKind, Mode, Quality, SafetyState, Sample, Setpoint};
use r4_rig::{Error, Session};

use super::cue::{BUZZ_DUTY, Outputs, ZONES, Zone};

/// Range below which a hand is over a zone, and above which it has left, m: the sensors look from 0.6 m at the desk, a
/// hand is 0.1 to 0.25 m over it. Our choice.
const IN_M: f32 = 0.52;
const OUT_M: f32 = 0.55;
/// Shortest dwell, µs, from the reading that shows the hand to one that still does: our choice. Readings of a sensor are
/// 240 ms apart and the board's median needs two, so that it is the third echo that ends a dwell.
const DWELL_US: u64 = 200_000;
/// Difference of the stamps of two readings, µs: stamps of one reading scatter by 1 ms.
const FRESH_US: u64 = 100_000;
/// Voltage below which an oscillator is silent, V, and tolerance of a pitch, V: 0.05 V is a twentieth of the lower tone.
const SILENT_V: f64 = 0.5;
const PITCH_TOLERANCE_V: f64 = 0.05;
/// Number of outputs.
const OUTPUTS: usize = 2 * ZONES + 4;

/// Channel of a lamp, 0 to 7.
const fn lamp(number: usize) -> ChannelId {
    ChannelId::new(ChannelKind::Relay, number as u8)
}

/// Channel of an oscillator, left or right.
const fn pitch(side: usize) -> ChannelId {
    ChannelId::new(ChannelKind::Dac, side as u8)
}

/// Channel of a band, left or right.
const fn band(side: usize) -> ChannelId {
    ChannelId::new(ChannelKind::Dhb, side as u8)
}

/// Channel of a zone's range sensor.
#[must_use]
pub const fn range(zone: Zone) -> ChannelId {
    ChannelId::new(ChannelKind::Range, zone as u8)
}

/// Checks that a board has all channels of the desk.
///
/// # Errors
/// The missing channel, in words.
pub fn check(session: &Session<'_>) -> Result<(), String> {
    let outputs = (0..2 * ZONES).map(lamp).chain((0..2).map(pitch)).chain((0..2).map(band));
    for channel in outputs.chain(Zone::ALL.map(range)) {
        session.board.channel(channel).map_err(|_| format!("it has no {channel}"))?;
    }
    Ok(())
}

/// Outputs of the desk, with what was last confirmed of each.
pub struct Desk<'s, 'b> {
    session: &'s Session<'b>,
    /// Confirmed value of each output; `None` while a request is on its way, also when its sender was dropped.
    confirmed: RefCell<[Option<f32>; OUTPUTS]>,
}

impl<'s, 'b> Desk<'s, 'b> {
    /// Takes the outputs of a board that has just been armed: all are off.
    #[must_use]
    pub const fn new(session: &'s Session<'b>) -> Self {
        Self { session, confirmed: RefCell::new([Some(0.0); OUTPUTS]) }
    }

    /// Changes all outputs that differ, at once: those that go on first.
    ///
    /// # Errors
    /// The board's error or refusal.
    pub async fn show(&self, outputs: &Outputs) -> Result<(), Error> {
        let lamps = outputs.lamps.iter().enumerate().map(|(at, on)| (lamp(at), Mode::Switch, f32::from(u8::from(*on))));
        let pitches = outputs.pitch_v.iter().enumerate().map(|(at, volts)| (pitch(at), Mode::Voltage, *volts as f32));
        let duty = |on: bool| if on { BUZZ_DUTY as f32 } else { 0.0 };
        let bands = outputs.bands.iter().enumerate().map(|(at, on)| (band(at), Mode::Duty, duty(*on)));
        let mut changes: Vec<(usize, (ChannelId, Mode, f32))> = lamps.chain(pitches).chain(bands).enumerate().collect();
        changes.retain(|(at, (_, _, value))| self.confirmed.borrow()[*at] != Some(*value));
        changes.sort_by(|(_, a), (_, b)| b.2.total_cmp(&a.2));
        let send = |(at, (channel, mode, value)): (usize, (ChannelId, Mode, f32))| async move {
            self.confirmed.borrow_mut()[at] = None;
            self.session.board.set(channel, Setpoint { mode, value }).await?;
            self.confirmed.borrow_mut()[at] = Some(value);
            Ok::<_, Error>(())
        };
        try_join_all(changes.into_iter().map(send)).await?;
        Ok(())
    }
}

/// Detector of dwells: which zones have a hand over them, from telemetry.
pub struct Zones {
    telemetry: TelemetryStream,
    /// Stamp of each zone's last reading, µs of the board's clock.
    measured_us: [u64; ZONES],
    /// Stamp of the reading since which a hand is over the zone.
    since_us: [Option<u64>; ZONES],
    /// True once the present stay was reported as a dwell.
    is_reported: [bool; ZONES],
}

impl Zones {
    /// Subscribes to the zones' sensors with a telemetry period, ms.
    ///
    /// # Errors
    /// The board's error or refusal.
    pub async fn of(session: &Session<'_>, period_ms: u16) -> Result<Self, Error> {
        for zone in Zone::ALL {
            session.board.subscribe(range(zone), period_ms).await?;
        }
        Ok(Self {
            telemetry: session.board.telemetry(),
            measured_us: [0; ZONES],
            since_us: [None; ZONES],
            is_reported: [false; ZONES],
        })
    }

    /// Waits for a dwell: a hand that stays over a zone. Each stay is reported once. Returns the zone, and the stamp of
    /// the reading that ended the dwell, s on the board's clock.
    ///
    /// # Errors
    /// The board is no longer armed, or the link ended.
    pub async fn dwell(&mut self) -> Result<(Zone, f64), Error> {
        loop {
            let frame = self.telemetry.next().await?;
            if frame.state != SafetyState::Armed {
                return Err(r4_driver::Error::Stopped { causes: frame.causes }.into());
            }
            let mut dwelt = None;
            for sample in &frame.samples {
                if let Sample::Reading { channel, value, age_ms, quality } = *sample
                    && let Some(zone) = Zone::ALL.into_iter().find(|zone| range(*zone) == channel)
                {
                    let measured_us = frame.device_us.saturating_sub(u64::from(age_ms) * 1000);
                    let is_there = (quality == Quality::Good).then_some(value);
                    dwelt = self.take(zone, measured_us, is_there).map(|at_s| (zone, at_s)).or(dwelt);
                }
            }
            if let Some(dwelt) = dwelt {
                return Ok(dwelt);
            }
        }
    }

    /// Takes a reading of a zone, m, `None` where nothing is in range. Returns the stamp in s when it ends a dwell.
    fn take(&mut self, zone: Zone, measured_us: u64, range_m: Option<f32>) -> Option<f64> {
        let at = zone as usize;
        let is_fresh = measured_us > self.measured_us[at] + FRESH_US;
        if is_fresh {
            self.measured_us[at] = measured_us;
        }
        match range_m {
            Some(range_m) if range_m < IN_M => {
                let since_us = *self.since_us[at].get_or_insert(measured_us);
                if is_fresh && !self.is_reported[at] && measured_us.saturating_sub(since_us) >= DWELL_US {
                    self.is_reported[at] = true;
                    return Some(measured_us as f64 * 1e-6);
                }
            }
            Some(range_m) if range_m < OUT_M => {}
            _ => {
                self.since_us[at] = None;
                self.is_reported[at] = false;
            }
        }
        None
    }
}

/// Reads the outputs at the pins of a virtual board, as a person perceives them, with the simulation's time, ns.
///
/// # Errors
/// The board is not virtual.
pub fn seen(session: &Session<'_>) -> Result<(Outputs, u64), Error> {
    let mut world = session.virtual_board()?.world();
    let now_ns = world.clock().now_ns();
    let lamps = std::array::from_fn(|at| world.relay_closed(lamp(at)) == Some(true));
    let bands = std::array::from_fn(|side| world.drive(band(side)).is_some_and(|drive| drive.duty > 0.5 * BUZZ_DUTY));
    let pitch_v = std::array::from_fn(|side| {
        let volts = world.pins().dac_v(side).unwrap_or(0.0);
        let nearest_v = volts.round();
        match volts {
            silent if silent < SILENT_V => 0.0,
            tone if (tone - nearest_v).abs() < PITCH_TOLERANCE_V => nearest_v,
            other => other,
        }
    });
    Ok((Outputs { lamps, pitch_v, bands }, now_ns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::xrhmi::cue::{Command, Modality, steps};

    /// Readings of one zone without a board: range, m, every 240 ms.
    fn dwells(ranges_m: &[f32]) -> Vec<usize> {
        let (_, telemetry) = r4_rig::Rig::new("sim:cue-desk".parse().expect("a board"))
            .run(None, async |session| Ok::<_, Error>(session.board.telemetry()))
            .map(|(telemetry, elapsed)| (elapsed, telemetry))
            .expect("a session");
        let mut zones =
            Zones { telemetry, measured_us: [0; ZONES], since_us: [None; ZONES], is_reported: [false; ZONES] };
        let mut found = Vec::new();
        for (at, range_m) in ranges_m.iter().enumerate() {
            // Telemetry repeats each reading, with a stamp that scatters.
            for repeat in 0..5 {
                let measured_us = 1_000_000 + 240_000 * at as u64 + repeat % 2 * 900;
                found.extend(zones.take(Zone::Right, measured_us, Some(*range_m)).map(|_| at));
            }
        }
        found
    }

    #[test]
    fn a_stay_is_one_dwell_and_a_passing_hand_none() {
        assert_eq!(dwells(&[0.6, 0.4, 0.4, 0.4, 0.4, 0.6]), [2], "the second reading of a stay, once");
        assert_eq!(dwells(&[0.6, 0.4, 0.6, 0.4, 0.6]), [0; 0]);
        // Between the thresholds nothing changes; after it has left, a hand dwells again.
        assert_eq!(dwells(&[0.4, 0.53, 0.4, 0.56, 0.4, 0.4]), [2, 5]);
    }

    /// The set points of a cue reach the pins, and only they.
    #[test]
    fn cues_reach_the_pins() {
        let work = async |session: &Session<'_>| {
            session
                .armed(async || {
                    let desk = Desk::new(session);
                    for modality in Modality::ALL {
                        for zone in Zone::ALL {
                            let (outputs, _) = steps(modality, Command { is_pick: zone == Zone::Left, zone })[0];
                            desk.show(&outputs).await?;
                            session.board.sleep_s(0.02).await;
                            assert_eq!(seen(session)?.0, outputs, "{modality:?} {zone:?}");
                        }
                    }
                    Ok::<_, Error>(())
                })
                .await?;
            session.board.sleep_s(0.02).await;
            assert_eq!(seen(session)?.0, Outputs::default(), "disarmed");
            Ok::<_, Error>(())
        };
        r4_rig::Rig::new("sim:cue-desk".parse().expect("a board")).run(None, work).expect("a session");
    }
}
