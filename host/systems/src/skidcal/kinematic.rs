//! The same tests on perfect actuators: wheels whose speed follows the ramp of the board's profile, without motors and
//! board.

use r4_boards::Drive;
use r4_world::{MAX_STEP_S, Scene, ShaftMotion};

use super::{
    protocol::{
        Felt, Recording, Repeats, Run, SPIN_S, SPIN_SETTLES_S, SkidRobot, TRACKED_EVERY_S, Tracked, WheelSample,
    },
    scene::{Noise, Truth},
};
use crate::Error;

/// Ramp of the wheel speeds, m/s²: that of openscout's profile.
const RAMP_M_S2: f64 = 1.0;
/// Integration steps of the body between two samples of the wheels: 10 ms.
const STEPS_PER_SAMPLE: usize = 40;

pub(super) fn recorded(truth: &Truth, repeats: Repeats, mut noise: Noise) -> Result<Recording, Error> {
    let mut robot = r4_boards::load(super::ABOUT.robot).map_err(r4_rig::Error::from)?;
    truth.put_into(&mut robot);
    let unsuitable = |why: String| Error::Unsuitable { system: super::NAME, board: super::ABOUT.robot.to_owned(), why };
    let skid = SkidRobot::of(&robot, truth.mass_kg).map_err(unsuitable)?;
    let (Some(mut body), Some(Drive::SkidSteer(_))) = (robot.simulation.body, robot.drive) else {
        return Err(unsuitable("it has no [body]".into()));
    };
    let is_left: Vec<bool> = body.channels.iter().map(|channel| skid.drive.left.contains(channel)).collect();
    let mut recording = Recording::new(skid.clone(), 0.0);
    let mut time_s = 0.0;
    let mut travel_m = [0.0; 2];
    let mut tracked_at_s = 0.0;
    let mut rim_m_s = [0.0_f64; 2];
    let mut loads = vec![0.0; is_left.len()];
    let mut hold = |wanted_m_s: [f64; 2], seconds: f64, mut run: Option<&mut Run>| {
        let end_s = time_s + seconds;
        while time_s < end_s - MAX_STEP_S / 2.0 {
            for _ in 0..STEPS_PER_SAMPLE {
                let speed = |left: &bool| rim_m_s[usize::from(!left)] / skid.drive.wheel_radius_m;
                let motion = |left| ShaftMotion { position: 0.0, speed: speed(left) };
                let shafts: Vec<_> = is_left.iter().map(motion).collect();
                body.kind.step(&mut Scene::default(), time_s, &shafts, &mut loads, MAX_STEP_S);
                time_s += MAX_STEP_S;
                for side in [0, 1] {
                    let most_m_s = RAMP_M_S2 * MAX_STEP_S;
                    let change_m_s = (wanted_m_s[side] - rim_m_s[side]).clamp(-most_m_s, most_m_s);
                    // The mean speed of the step is exact here, as the ramp is linear.
                    travel_m[side] += (rim_m_s[side] + change_m_s / 2.0) * MAX_STEP_S;
                    rim_m_s[side] += change_m_s;
                }
            }
            let Some(run) = run.as_deref_mut() else { continue };
            run.wheels.push(WheelSample { time_s, travel_m });
            let forward_m_s2 = body.kind.inertial().specific_force_m_s2[0];
            run.felt.push(Felt::new(time_s, forward_m_s2, noise.inertial_m_s2()));
            if time_s >= tracked_at_s {
                let pose = body.kind.pose();
                run.tracked.push(Tracked::new(time_s, [pose.x_m, pose.y_m, pose.yaw_rad], noise.place()));
                tracked_at_s = time_s + TRACKED_EVERY_S;
            }
        }
    };
    loop {
        // The schedule of a recording on a board, so that the two differ only in the dynamics.
        let more = recording.more(repeats);
        for _ in 0..more {
            for way in skid.straight() {
                let mut run = Run::default();
                for (index, (rim_m_s, seconds)) in way.into_iter().enumerate() {
                    hold(rim_m_s, seconds, (index > 0).then_some(&mut run));
                }
                recording.straight.push(run);
            }
            recording.runs += 1;
        }
        if more == 0 {
            break;
        }
    }
    hold(skid.spin(), SPIN_SETTLES_S, None);
    hold(skid.spin(), SPIN_S, Some(&mut recording.spin));
    Ok(recording)
}
