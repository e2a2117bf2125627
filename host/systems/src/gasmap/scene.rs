//! Leaks that the study samples, and the robot in the factory.

use std::rc::Rc;

use r4_boards::{Mount, Robot, SimulatedUart, UartDevice, World};
use r4_maps::{grid::Grid, pose::Point};
use r4_rig::{Alter, Rig, Target};
use r4_world::{Field, FieldKind, Person, Plume};

use super::plan::Plan;
use crate::{Error, sampler::Sampler};

/// Purpose of the random numbers of a case.
const OF_CASE: u64 = 1;
/// Name of the world's file.
pub const WORLD: &str = "factory";
/// Name of the world's gas field.
const GAS: &str = "gas";
/// Aisles in which gas may leak: y of the middle of the first, m; distance between two, m; number of aisles.
const AISLES: (f64, f64, f64) = (9.0, 4.0, 9.0);
/// Ends of the aisles' two halves along x, m.
const HALVES_M: [[f64; 2]; 2] = [[9.0, 27.0], [33.0, 47.0]];
/// Period at which the truth is sampled for its mean, s.
const TRUTH_EVERY_S: f64 = 40.0;

/// A sampled leak. [`About::sampled`](crate::About::sampled) has the ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Position of the source, m.
    pub source_m: Point,
    /// Flow of released gas, m³/s.
    pub release_m3_s: f64,
    /// Standard deviation of a new puff, m: that of a leak that mixes with the air around it, about the size of a cell.
    pub radius_m: f64,
    /// Seed of the plume's randomness.
    pub seed: u64,
}

impl Case {
    /// Samples the case of a seed.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        let mut sampler = Sampler::new(seed, OF_CASE);
        let (first_m, pitch_m, aisles) = AISLES;
        let aisle = sampler.uniform(0.0, aisles).floor();
        let [from_m, to_m] = HALVES_M[usize::from(sampler.uniform(0.0, 1.0) > 0.5)];
        Self {
            source_m: [sampler.uniform(from_m, to_m), first_m + pitch_m * aisle + sampler.uniform(-0.6, 0.6)],
            release_m3_s: sampler.log_uniform(0.5e-4, 2e-4),
            radius_m: sampler.uniform(0.4, 0.8),
            seed: seed.wrapping_mul(7919).wrapping_add(1),
        }
    }

    /// Returns the plume of this case in a world.
    ///
    /// # Errors
    /// The reason in words: a world without gas, or a source where no air flows.
    pub fn plume(&self, world: &World) -> Result<Plume, String> {
        let gas = world.fields.iter().find_map(|field| match &field.kind {
            FieldKind::Gas(plume) if field.name == GAS => Some(plume),
            _ => None,
        });
        let changed = gas.ok_or("its world has no field `gas`")?.changed(|spec| {
            spec.source_m = self.source_m;
            spec.release_m3_s = self.release_m3_s;
            spec.radius_m = self.radius_m;
            spec.seed = self.seed;
        });
        changed.map_err(|error| error.to_string())
    }
}

/// A hall with a leak, as the study simulates it.
#[derive(Clone, Debug)]
pub struct Hall {
    /// Leak of the seed.
    pub case: Case,
    /// The world without people.
    pub world: World,
    /// State of the gas at time 0.
    pub plume: Plume,
    /// Floor plan of the hall, known to the robot.
    pub plan: Rc<Plan>,
}

impl Hall {
    /// Loads the hall and puts the leak of a case into it.
    ///
    /// # Errors
    /// [`Error::Rig`] when the world cannot be read; [`Error::Unsuitable`] when it has no gas or no room.
    pub fn of(case: Case, cell_m: f64) -> Result<Self, Error> {
        let world = r4_boards::load_world(WORLD).map_err(r4_rig::Error::from)?;
        let unsuitable = |why: String| Error::Unsuitable { system: super::NAME, board: WORLD.to_owned(), why };
        let start = world.start;
        let plan = Plan::of(world.scene.walls_m().collect(), [start.x_m, start.y_m], cell_m).map_err(unsuitable)?;
        let plume = case.plume(&world).map_err(unsuitable)?;
        Ok(Self { case, world, plume, plan: Rc::new(plan) })
    }

    /// Gas in the air, as a field of a world.
    #[must_use]
    pub fn field(&self) -> Field {
        Field { name: GAS.to_owned(), kind: FieldKind::Gas(Box::new(self.plume.clone())) }
    }

    /// Mean concentration of each free cell over a mission, ppm; `None` for cells that are not free.
    #[must_use]
    pub fn truth_ppm(&self, until_s: f64) -> Grid<Option<f64>> {
        let mut gas = self.field();
        let frame = *self.plan.free().frame();
        let mut sum = self.plan.free().map(|free| free.then_some(0.0));
        let samples = (until_s / TRUTH_EVERY_S).ceil().max(1.0);
        for sample in 0..samples as usize {
            let time_s = (sample as f64 + 0.5) * TRUTH_EVERY_S;
            for index in 0..frame.cells() {
                if let Some(sum) = &mut sum.values_mut()[index] {
                    *sum += gas.value(time_s, frame.centre(frame.cell(index))) / samples;
                }
            }
        }
        sum
    }

    /// Rig of a board in the hall: with the leak, a second lidar that looks to the left, and `people`.
    #[must_use]
    pub fn rig(&self, board: &Target, seed: u64, people: Vec<Person>) -> Rig {
        let mut rig = Rig::new(board.clone());
        rig.seed = seed;
        rig.world = Some(WORLD.to_owned());
        rig.alter = Some(self.altered(people));
        rig
    }

    fn altered(&self, people: Vec<Person>) -> Alter {
        let field = self.field();
        Rc::new(move |robot: &mut Robot| {
            robot.simulation.fields = vec![field.clone()];
            for person in &people {
                // Adding fails only for a path whose times do not increase; callers give increasing ones.
                let _ = robot.simulation.scene.add_person(person.clone());
            }
            let left = Mount { place_m: [0.0, 0.18], yaw_rad: std::f64::consts::FRAC_PI_2 };
            robot.simulation.uarts.push(SimulatedUart { port: 1, device: UartDevice::Lidar(left) });
        })
    }
}
