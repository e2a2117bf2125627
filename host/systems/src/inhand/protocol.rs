//! Manipulation on a board: grip, pivot by the palm, roll by the fingers, with stops at which the encoders are read.

use std::f64::consts::FRAC_PI_2;

use r4_driver::TelemetryStream;
use r4_protocol::{Mode, Quality, SafetyState, Sample, Setpoint};
use r4_rig::{Error, Sequence, Session};
use r4_world::{AnyBody, TwoFingers};

use super::{four_bar::Observation, scene::Setup};

/// Travel of the palm to each side, m, and of the fingers, rad: the paper's.
const PIVOT_M: f64 = 0.015;
const ROLL_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// Stops of a motion, as shares of its travel: from the middle to one end, to the other, and back. Each position is
/// approached from both sides.
pub(super) const SHARES: [f64; 21] =
    [0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.8, 0.6, 0.4, 0.2, 0.0, -0.2, -0.4, -0.6, -0.8, -1.0, -0.8, -0.6, -0.4, -0.2, 0.0];
/// Lead of the set point over the shaft that holds the grip, rad: 0.3 N m with a servo of 6 N m/rad. Our choice: no
/// trial was run with another one.
pub(super) const SQUEEZE_RAD: f64 = 0.05;
/// Angle of the open fingers before the grip, rad from upright.
pub(super) const OPEN_RAD: f64 = 0.25;
/// Closing speed of the fingers, rad/s.
const CLOSE_RAD_S: f64 = 0.4;
/// Period at which set points follow the encoders, s: one period of the servos' pulses.
const EVERY_S: f64 = 0.02;
/// Number of these periods for the move to a stop, and for settling there.
const MOVE_PERIODS: usize = 8;
const SETTLE_PERIODS: usize = 6;
/// Number of readings averaged at a stop, one every 10 ms.
const READINGS: usize = 20;
/// Telemetry period of the readings, ms.
const READ_EVERY_MS: u16 = 10;
/// Nominal distance of the contacts for the fingers' motion during a pivot, m. It need not be exact: the fingers'
/// angles are measured.
const NOMINAL_M: f64 = 0.08;

/// Motion of the manipulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Pivot: the palm widens and narrows.
    Pivot,
    /// Roll: both fingers turn the same way.
    Roll,
}

impl Motion {
    /// Motions of the paper, in their order.
    pub const BOTH: [Self; 2] = [Self::Pivot, Self::Roll];

    const fn name(self) -> &'static str {
        match self {
            Self::Pivot => "pivot",
            Self::Roll => "roll",
        }
    }
}

/// Readings at one stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    /// Motion that the stop belongs to.
    pub motion: Motion,
    /// Number of the repetition, from 0 on.
    pub repeat: usize,
    /// Time since the first stop, s.
    pub time_s: f64,
    /// Mean readings of left, right and palm encoder, rad.
    pub read_rad: [f64; 3],
    /// Set points of both fingers meanwhile, rad.
    pub set_rad: [f64; 2],
    /// Last direction of the palm: 1 when it widened, -1 when it narrowed.
    pub palm_direction: f64,
    /// True state during the readings.
    pub truth: Truth,
}

/// True state of a grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Distances from the joints to the contacts, left and right, m; NaN without a contact.
    pub contact_m: [f64; 2],
    /// Distance between the contacts, m; NaN without both.
    pub size_m: f64,
    /// Normal force at the left contact, N.
    pub grip_n: f64,
    /// Speed of the object, m/s.
    pub object_m_s: f64,
    /// True palm width and finger angles.
    pub at: Observation,
}

impl Truth {
    /// Reads the true state of a gripper.
    #[must_use]
    pub fn of(body: &TwoFingers) -> Self {
        let touches = body.touches();
        let contact_m = touches.map(|touch| touch.map_or(f64::NAN, |touch| touch.distance_m));
        let size_m = match touches {
            [Some(left), Some(right)] => (right.place_m[0] - left.place_m[0]).hypot(right.place_m[1] - left.place_m[1]),
            _ => f64::NAN,
        };
        let grip_n = touches[0].map_or(0.0, |touch| touch.normal_n);
        let at = Observation { palm_m: body.width_m(), finger_rad: body.finger_rad() };
        Self { contact_m, size_m, grip_n, object_m_s: body.object_m_s(), at }
    }
}

impl Stop {
    /// Palm width and finger angles by the encoders alone.
    #[must_use]
    pub fn plain(&self, setup: &Setup) -> Observation {
        let [left_rad, right_rad, palm_rad] = self.read_rad;
        let palm_m = setup.palm.zero_m + setup.palm.m_per_rad * palm_rad;
        Observation { palm_m, finger_rad: [FRAC_PI_2 + left_rad, FRAC_PI_2 + right_rad] }
    }

    /// Palm width and finger angles, corrected by the datasheet's play and compliance. The grip presses the fingers
    /// open against their shafts, so that play is always on one side. The link between shaft and finger bends by the
    /// servo's torque, which follows from the shaft's lag behind its set point. The rack's play is on the side from
    /// which the palm came.
    #[must_use]
    pub fn corrected(&self, setup: &Setup) -> Observation {
        let Observation { palm_m, finger_rad } = self.plain(setup);
        let softer = setup.finger.servo_nm_per_rad / setup.finger.link_nm_per_rad;
        let opened_rad = |side: usize| {
            let behind_rad = self.read_rad[side] - self.set_rad[side];
            softer * behind_rad + (0.5 * setup.finger.play_rad).copysign(behind_rad)
        };
        Observation {
            palm_m: palm_m - 0.5 * self.palm_direction * setup.palm.play_m,
            finger_rad: [finger_rad[0] + opened_rad(0), finger_rad[1] + opened_rad(1)],
        }
    }
}

/// Connection of the program to the gripper of a board.
struct Hand<'h, 'b> {
    session: &'h Session<'b>,
    setup: &'h Setup,
    telemetry: TelemetryStream,
    /// Last set points of left, right and palm, rad.
    set_rad: [f64; 3],
    palm_direction: f64,
}

/// Grips the object with a palm width of `palm_m`, and performs the motions in their order, `repeats` times.
///
/// # Errors
/// The error of the board when it is not virtual, does not arm, or stops; [`Error::StateTimedOut`] when a state takes
/// too long because there is nothing to grip.
pub async fn manipulate(
    session: &Session<'_>,
    setup: &Setup,
    palm_m: f64,
    motions: &[Motion],
    repeats: usize,
) -> Result<Vec<Stop>, Error> {
    for joint in &setup.joints {
        session.board.subscribe(joint.encoder, READ_EVERY_MS).await?;
    }
    let mut hand =
        Hand { session, setup, telemetry: session.board.telemetry(), set_rad: [0.0; 3], palm_direction: 1.0 };
    session.armed(async || hand.manipulate(palm_m, motions, repeats).await).await
}

impl Hand<'_, '_> {
    async fn manipulate(&mut self, palm_m: f64, motions: &[Motion], repeats: usize) -> Result<Vec<Stop>, Error> {
        let mut sequence = Sequence::new(self.session);
        sequence.state("open", 4.0, self.open(palm_m)).await?;
        sequence.state("grip", 4.0, self.grip()).await?;
        let begin_s = self.session.board.now_s();
        let mut stops = Vec::new();
        for repeat in 0..repeats {
            for &motion in motions {
                let (left_rad, palm_rad) = (self.set_rad[0], self.set_rad[2]);
                for share in SHARES {
                    let stop = self.stop(motion, share, left_rad, palm_rad);
                    let (read_rad, truth) = sequence.state(motion.name(), 2.0, stop).await?;
                    let time_s = self.session.board.now_s() - begin_s;
                    let (set_rad, palm_direction) = ([self.set_rad[0], self.set_rad[1]], self.palm_direction);
                    stops.push(Stop { motion, repeat, time_s, read_rad, set_rad, palm_direction, truth });
                }
            }
        }
        Ok(stops)
    }

    async fn set(&mut self, number: usize, value_rad: f64) -> Result<(), Error> {
        if number == 2 && value_rad != self.set_rad[2] {
            self.palm_direction = (value_rad - self.set_rad[2]).signum();
        }
        // Fingers that close on nothing stop at the ends of their servos' travel.
        let info = self.session.board.channel(self.setup.joints[number].servo)?.mode(Mode::Position);
        let value_rad = info.map_or(value_rad, |info| value_rad.clamp(info.range.min.into(), info.range.max.into()));
        self.set_rad[number] = value_rad;
        let setpoint = Setpoint { mode: Mode::Position, value: value_rad as f32 };
        Ok(self.session.board.set(self.setup.joints[number].servo, setpoint).await?)
    }

    /// Waits for the next readings of all three encoders, rad.
    async fn read(&mut self) -> Result<[f64; 3], Error> {
        loop {
            let frame = self.telemetry.next().await?;
            if frame.state == SafetyState::Tripped {
                return Err(r4_driver::Error::Stopped { causes: frame.causes }.into());
            }
            let reading = |number: usize| {
                let joint = &self.setup.joints[number];
                frame.samples.iter().find_map(|sample| match *sample {
                    Sample::Reading { channel, value, quality: Quality::Good, .. } if channel == joint.encoder => {
                        Some((f64::from(value) - joint.zero_v) / joint.v_per_rad)
                    }
                    _ => None,
                })
            };
            if let (Some(left), Some(right), Some(palm)) = (reading(0), reading(1), reading(2)) {
                return Ok([left, right, palm]);
            }
        }
    }

    async fn mean(&mut self, count: usize) -> Result<[f64; 3], Error> {
        let mut sum = [0.0; 3];
        for _ in 0..count {
            let read_rad = self.read().await?;
            sum = [0, 1, 2].map(|number| sum[number] + read_rad[number]);
        }
        Ok(sum.map(|sum| sum / count as f64))
    }

    async fn open(&mut self, palm_m: f64) -> Result<(), Error> {
        let palm_rad = (palm_m - self.setup.palm.zero_m) / self.setup.palm.m_per_rad;
        for (number, value_rad) in [(0, OPEN_RAD), (1, -OPEN_RAD), (2, palm_rad)] {
            self.set(number, value_rad).await?;
        }
        self.session.board.sleep_s(0.8).await;
        Ok(())
    }

    /// Closes both fingers until both shafts lag their set points by [`SQUEEZE_RAD`].
    async fn grip(&mut self) -> Result<(), Error> {
        let mut holds = [false; 2];
        while holds != [true; 2] {
            self.session.board.sleep_s(EVERY_S - 1e-3 * f64::from(READ_EVERY_MS)).await;
            self.skip();
            let read_rad = self.read().await?;
            for (side, closing) in [(0, -1.0), (1, 1.0)] {
                holds[side] = closing * (self.set_rad[side] - read_rad[side]) >= SQUEEZE_RAD;
                if !holds[side] {
                    self.set(side, self.set_rad[side] + closing * CLOSE_RAD_S * EVERY_S).await?;
                }
            }
        }
        // The grip is still settling after the last step and would move the part before the first stop.
        for _ in 0..4 * SETTLE_PERIODS {
            self.follow().await?;
        }
        Ok(())
    }

    /// Discards readings that were queued.
    fn skip(&mut self) {
        while self.telemetry.try_next().is_some() {}
    }

    /// One period of the grip: the right finger keeps its lead over its shaft. It controls the torque, the left finger
    /// the position.
    async fn follow(&mut self) -> Result<(), Error> {
        self.session.board.sleep_s(EVERY_S - 1e-3 * f64::from(READ_EVERY_MS)).await;
        self.skip();
        let read_rad = self.read().await?;
        self.set(1, read_rad[1] + SQUEEZE_RAD).await
    }

    /// Moves to a share of a motion, whose middle has the given set points of the left finger and the palm, and reads
    /// the encoders there.
    async fn stop(
        &mut self,
        motion: Motion,
        share: f64,
        left_rad: f64,
        palm_rad: f64,
    ) -> Result<([f64; 3], Truth), Error> {
        let (to_left_rad, to_palm_rad) = match motion {
            Motion::Pivot => {
                (left_rad - 0.5 * share * PIVOT_M / NOMINAL_M, palm_rad + share * PIVOT_M / self.setup.palm.m_per_rad)
            }
            Motion::Roll => (left_rad + share * ROLL_RAD, palm_rad),
        };
        let [from_left_rad, _, from_palm_rad] = self.set_rad;
        for period in 1..=MOVE_PERIODS {
            let part = period as f64 / MOVE_PERIODS as f64;
            self.set(0, from_left_rad + part * (to_left_rad - from_left_rad)).await?;
            self.set(2, from_palm_rad + part * (to_palm_rad - from_palm_rad)).await?;
            self.follow().await?;
        }
        for _ in 0..SETTLE_PERIODS {
            self.follow().await?;
        }
        // The set points are constant from here on; the shaft settles within two pulses.
        self.session.board.sleep_s(0.06).await;
        self.skip();
        let read_rad = self.mean(READINGS).await?;
        Ok((read_rad, look(self.session)?))
    }
}

/// Reads the true state of the grasp.
pub(super) fn look(session: &Session<'_>) -> Result<Truth, Error> {
    let mut world = session.virtual_board()?.world();
    world.catch_up();
    match world.body() {
        Some(AnyBody::TwoFingers(body)) => Ok(Truth::of(body)),
        // Not reached: `Setup::of` refuses robots without such a gripper.
        _ => Ok(Truth {
            contact_m: [f64::NAN; 2],
            size_m: f64::NAN,
            grip_n: 0.0,
            object_m_s: 0.0,
            at: Observation { palm_m: f64::NAN, finger_rad: [f64::NAN; 2] },
        }),
    }
}
