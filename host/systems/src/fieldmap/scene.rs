//! Fields and mills that the study samples, and the robot on its plot.

use std::rc::Rc;

use r4_boards::{Robot, SelfCharge};
use r4_maps::{
    grid::{Frame, Grid},
    pose::{Point, Pose},
};
use r4_rig::{Alter, Place, Rig, Target};
use r4_world::{Charge, Cloud, Electric, ElectricSpec, Field, FieldKind, Person, Wander};

use crate::{Error, sampler::Sampler};

/// Purposes of the random numbers: fields and mills.
const OF_FIELD: u64 = 1_401;
const OF_MILL: u64 = 1_402;
/// Name of the world's field in the robot's file.
const NAME: &str = "electric";
/// Period at which the truth is sampled for its mean, s.
const TRUTH_EVERY_S: f64 = 5.0;
/// Gain of the mill by its datasheet, V per V/m: the form factor is relative to it.
pub const VOLTS_PER_UNIT: f64 = 0.005;

/// A square of ground with the statistics of its field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plot {
    /// Side of the square, m; its south-western corner is the origin.
    pub side_m: f64,
    /// Number of cells along a side in which maps are compared.
    pub columns: usize,
    /// Number of stationary space charges.
    charges: usize,
    /// Range of the sizes of the charges, m; range of the size of the passing cloud, m.
    sizes_m: [f64; 2],
    cloud_m: [f64; 2],
}

/// Plot of 40 m by 40 m, which one robot maps.
pub const PLOT: Plot = Plot { side_m: 40.0, columns: 20, charges: 5, sizes_m: [4.0, 9.0], cloud_m: [100.0, 200.0] };
/// Open field of 1 km², for the swarm.
pub const OPEN: Plot =
    Plot { side_m: 1000.0, columns: 20, charges: 8, sizes_m: [100.0, 180.0], cloud_m: [2000.0, 4000.0] };

impl Plot {
    /// Grid of the plot's cells.
    ///
    /// # Errors
    /// [`Error::Unsuitable`] for a plot without a size.
    pub fn frame(&self) -> Result<Frame, Error> {
        Frame::new(Pose::default(), self.side_m / self.columns as f64, self.columns, self.columns)
            .map_err(|error| super::unsuitable("the plot", error.to_string()))
    }
}

/// A sampled field mill on a robot. [`About::sampled`](crate::About::sampled) has the ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mill {
    /// Form factor: field at the mill over the undisturbed one; dimensionless.
    pub form: f64,
    /// Output of the offset stage without a field, V.
    pub zero_v: f64,
    /// Charge of the body and its field.
    pub charge: SelfCharge,
    /// Relative error of the calibration plates' distance; dimensionless.
    pub gap_error: f64,
    /// Relative errors of the plates' voltages; dimensionless.
    pub voltage_errors: [f64; super::mill::REFERENCES_V_PER_M.len()],
}

impl Mill {
    /// Samples the mill of a seed.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        let mut sampler = Sampler::new(seed, OF_MILL);
        Self {
            form: sampler.uniform(1.2, 1.6),
            zero_v: sampler.uniform(2.4, 2.6),
            charge: SelfCharge {
                rest: sampler.uniform(-8.0, 8.0),
                per_rad: sampler.uniform(0.02, 0.06),
                leak_s: sampler.uniform(30.0, 80.0),
            },
            gap_error: sampler.normal(0.003),
            voltage_errors: std::array::from_fn(|_| sampler.normal(0.002)),
        }
    }

    /// Output without an undisturbed field and with the body's charge at rest, V: the offset that a calibration finds.
    #[must_use]
    pub fn offset_v(&self) -> f64 {
        self.zero_v + VOLTS_PER_UNIT * self.form * self.charge.rest
    }

    /// Replaces the mill in a robot by this one.
    pub fn mount(&self, robot: &mut Robot) {
        for reading in robot.simulation.analogs.iter_mut().filter_map(|analog| analog.field.as_mut()) {
            reading.enhancement = self.form;
            reading.zero_v = self.zero_v;
            reading.charge = self.charge;
        }
    }
}

/// A sampled field over a plot, and the mill that measures it.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Plot of ground under the field.
    pub plot: Plot,
    /// Mill on the robot.
    pub mill: Mill,
    electric: Electric,
}

impl Scene {
    /// Samples the scene of a seed.
    ///
    /// # Errors
    /// [`Error::Unsuitable`] when the sampled field is not valid.
    pub fn of(seed: u64, plot: Plot) -> Result<Self, Error> {
        let mut sampler = Sampler::new(seed, OF_FIELD);
        let side_m = plot.side_m;
        let sign = |sampler: &mut Sampler| if sampler.uniform(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
        let uniform_v_per_m = sampler.uniform(60.0, 100.0);
        let charges = (0..plot.charges)
            .map(|_| Charge {
                place_m: [0.1, 0.1].map(|margin| sampler.uniform(margin * side_m, (1.0 - margin) * side_m)),
                size_m: sampler.uniform(plot.sizes_m[0], plot.sizes_m[1]),
                peak_v_per_m: sign(&mut sampler) * sampler.uniform(30.0, 70.0),
            })
            .collect();
        let drift = Wander { deviation: sampler.uniform(15.0, 30.0), tau_s: sampler.log_uniform(60.0, 300.0) };
        // The course of the day is a hill so wide and so fast that the whole plot sees the same, over some 2000 s.
        let (day_m, day_m_s) = (40_000.0, 20.0);
        let day = Cloud {
            charge: Charge {
                place_m: [-day_m_s * sampler.uniform(0.0, 3000.0), 0.0],
                size_m: day_m,
                peak_v_per_m: sign(&mut sampler) * sampler.uniform(20.0, 50.0),
            },
            velocity_m_s: [day_m_s, 0.0],
            wander: Wander::default(),
        };
        // Every part of the plot sees the passing cloud differently, which the robot's model of drift does not contain.
        let cloud_m = sampler.uniform(plot.cloud_m[0], plot.cloud_m[1]);
        let passing = Cloud {
            charge: Charge {
                place_m: [0, 1].map(|_| sampler.uniform(-cloud_m, cloud_m)),
                size_m: cloud_m,
                peak_v_per_m: 0.0,
            },
            velocity_m_s: [sampler.uniform(0.0, 0.1), sampler.uniform(-0.1, 0.1)],
            wander: Wander { deviation: sampler.uniform(5.0, 15.0), tau_s: 300.0 },
        };
        let seed_of_field = seed.wrapping_mul(7919).wrapping_add(14);
        let spec = ElectricSpec { uniform_v_per_m, charges, clouds: vec![day, passing], drift, seed: seed_of_field };
        Ok(Self { plot, mill: Mill::of(seed), electric: made(spec)? })
    }

    /// Scene with a given field and mill, on [`PLOT`].
    ///
    /// # Errors
    /// [`Error::Unsuitable`] when the field is not valid.
    pub fn with(spec: ElectricSpec, mill: Mill) -> Result<Self, Error> {
        Ok(Self { plot: PLOT, mill, electric: made(spec)? })
    }

    /// Copy of the field at time 0.
    #[must_use]
    pub fn field(&self) -> Field {
        Field { name: NAME.to_owned(), kind: FieldKind::Electric(Box::new(self.electric.clone())) }
    }

    /// Mean of the field from time 0 to `until_s` in the middle of each cell, V/m.
    ///
    /// # Errors
    /// [`Error::Unsuitable`] for a plot without a size.
    pub fn truth(&self, until_s: f64) -> Result<Grid<f64>, Error> {
        let frame = self.plot.frame()?;
        let places: Vec<Point> = (0..frame.cells()).map(|index| frame.centre(frame.cell(index))).collect();
        Grid::of(frame, self.means_at(&places, until_s))
            .map_err(|error| super::unsuitable("the plot", error.to_string()))
    }

    /// Means of the field at positions, m, from time 0 to `until_s`, V/m.
    #[must_use]
    pub fn means_at(&self, places: &[Point], until_s: f64) -> Vec<f64> {
        let mut field = self.field();
        let mut sums = vec![0.0; places.len()];
        let samples = (until_s / TRUTH_EVERY_S).ceil().max(1.0);
        for sample in 0..samples as usize {
            let time_s = (sample as f64 + 0.5) * until_s / samples;
            for (sum, place) in sums.iter_mut().zip(places) {
                *sum += field.value(time_s, *place) / samples;
            }
        }
        sums
    }

    /// Drift: mean over the plot at each of these times, s, minus the mean over the times, V/m.
    ///
    /// # Errors
    /// [`Error::Unsuitable`] for a plot without a size.
    pub fn drift(&self, times_s: &[f64]) -> Result<Vec<f64>, Error> {
        let (mut field, frame) = (self.field(), self.plot.frame()?);
        let over_plot = |time_s: &f64| {
            // A seventh of the cells is enough for a mean, and saves most of the time.
            let cells = (0..frame.cells()).step_by(7);
            let count = cells.len() as f64;
            cells.map(|index| field.value(*time_s, frame.centre(frame.cell(index)))).sum::<f64>() / count
        };
        let values: Vec<f64> = times_s.iter().map(over_plot).collect();
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        Ok(values.into_iter().map(|value| value - mean).collect())
    }

    /// Rig of a board in the scene, from `start` on, with `people`.
    #[must_use]
    pub fn rig(&self, board: &Target, seed: u64, start: Place, people: Vec<Person>) -> Rig {
        let mut rig = Rig::new(board.clone());
        rig.seed = seed;
        rig.alter = Some(self.altered(start, people));
        rig
    }

    fn altered(&self, start: Place, people: Vec<Person>) -> Alter {
        let (field, mill) = (self.field(), self.mill);
        Rc::new(move |robot: &mut Robot| {
            robot.simulation.fields = vec![field.clone()];
            mill.mount(robot);
            for person in &people {
                // Adding fails only for a path whose times do not increase; callers give increasing ones.
                let _ = robot.simulation.scene.add_person(person.clone());
            }
            if let Some(body) = &mut robot.simulation.body {
                body.kind.set_pose(r4_world::Pose { x_m: start.x_m, y_m: start.y_m, yaw_rad: start.yaw_rad });
            }
        })
    }
}

fn made(spec: ElectricSpec) -> Result<Electric, Error> {
    Electric::new(spec).map_err(|error| super::unsuitable("the field", error.to_string()))
}

/// Distance between a pose and a position, m.
#[must_use]
pub fn from_m(at: Place, to: Point) -> f64 {
    (at.x_m - to[0]).hypot(at.y_m - to[1])
}
