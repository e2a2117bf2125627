//! Occupancy grids: the free cells, from range readings.

mod distance;
mod matching;
mod traverse;

pub use matching::{Matched, Search, match_scan};
use thiserror::Error;
pub use traverse::{Crossing, traverse};

use crate::{
    grid::{Cell, Frame, Grid, GridError},
    pose::{Point, Pose, distance_m},
};

/// Error of a reading or a parameter that an occupancy grid cannot use.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum OccupancyError {
    /// The grid does not have this place.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// The parameters of the inverse sensor model contradict each other.
    #[error("{what} is {value}, and {needed} is needed")]
    Model {
        /// Name of the parameter.
        what: &'static str,
        /// Value of the parameter.
        value: f64,
        /// Condition that it must satisfy.
        needed: &'static str,
    },
    /// The range is negative or not a number, or the bearing or pose is not finite.
    #[error("range {range_m} m at bearing {bearing_rad} rad: leave out readings that are not finite or below 0")]
    Reading {
        /// Range of the reading, m.
        range_m: f64,
        /// Bearing of the reading, rad.
        bearing_rad: f64,
    },
}

/// Knowledge about a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// The probability of an obstacle is below [`InverseSensor::free_below`].
    Free,
    /// The probability of an obstacle is above [`InverseSensor::occupied_above`].
    Occupied,
    /// The probability is between these: the cell has not been seen, or readings contradict each other.
    Unknown,
}

/// Inverse sensor model: the probabilities that one ray gives to the cells that it meets.
///
/// # Source
/// Moravec, Elfes, "High Resolution Maps from Wide Angle Sonar", ICRA 1985; log-odds: Thrun, Burgard, Fox, *Probabilistic
/// Robotics*, MIT Press 2005, 9.2. The default probabilities are the usual ones of lidar maps (Hornung et al., "OctoMap",
/// Autonomous Robots 34, 2013: 0.7 and 0.4, clamped to 0.12 and 0.97).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseSensor {
    /// Probability that the cell in which a ray ends has an obstacle, from this ray alone; 0.5 to 1.
    pub end_occupied: f64,
    /// Probability that a cell which a ray crosses has an obstacle, from this ray alone; 0 to 0.5.
    pub crossed_occupied: f64,
    /// Lowest and highest probability of a cell, so that obstacles that moved away are forgotten after a few rays.
    pub clamp: [f64; 2],
    /// Probability below which a cell is free.
    pub free_below: f64,
    /// Probability above which a cell is occupied.
    pub occupied_above: f64,
    /// Longest range of the sensor, m: a reading of as much, or infinity, met no obstacle, and frees the cells up to
    /// here.
    pub max_range_m: f64,
}

impl InverseSensor {
    /// Returns the usual model of a lidar with this longest range, m.
    #[must_use]
    pub const fn lidar(max_range_m: f64) -> Self {
        Self {
            end_occupied: 0.7,
            crossed_occupied: 0.4,
            clamp: [0.12, 0.97],
            free_below: 0.35,
            occupied_above: 0.65,
            max_range_m,
        }
    }

    fn check(&self) -> Result<(), OccupancyError> {
        let within = |what, value: f64, low: f64, high: f64, needed| {
            // False for NaN.
            if low < value && value < high { Ok(()) } else { Err(OccupancyError::Model { what, value, needed }) }
        };
        within("end_occupied", self.end_occupied, 0.5, 1.0, "more than 0.5 and less than 1")?;
        within("crossed_occupied", self.crossed_occupied, 0.0, 0.5, "more than 0 and less than 0.5")?;
        within("clamp[0]", self.clamp[0], 0.0, self.free_below, "more than 0 and less than free_below")?;
        within("clamp[1]", self.clamp[1], self.occupied_above, 1.0, "more than occupied_above and less than 1")?;
        within("free_below", self.free_below, 0.0, 0.5, "more than 0 and less than 0.5")?;
        within("occupied_above", self.occupied_above, 0.5, 1.0, "more than 0.5 and less than 1")?;
        within("max_range_m", self.max_range_m, 0.0, f64::INFINITY, "a finite length above 0 m")
    }
}

fn log_odds(probability: f64) -> f64 {
    (probability / (1.0 - probability)).ln()
}

/// Occupancy grid in log-odds, 0 for unknown cells.
///
/// ```
/// use r4_maps::{grid::Frame, occupancy::{InverseSensor, Occupancy, State}, pose::Pose};
/// let frame = Frame::new(Pose::default(), 0.1, 40, 20).unwrap();
/// let mut map = Occupancy::new(frame, InverseSensor::lidar(8.0)).unwrap();
/// for _ in 0..3 {
///     // A lidar at (0.55, 1.05) sees a wall 2 m ahead.
///     map.insert(Pose::new(0.55, 1.05, 0.0), 0.0, 2.0).unwrap();
/// }
/// assert_eq!(map.state([25, 10]), Ok(State::Occupied));
/// assert_eq!(map.state([15, 10]), Ok(State::Free));
/// assert_eq!(map.state([30, 10]), Ok(State::Unknown));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Occupancy {
    odds: Grid<f64>,
    sensor: InverseSensor,
}

impl Occupancy {
    /// Makes a map of unknown cells.
    ///
    /// # Errors
    /// [`OccupancyError::Model`] with the name of the parameter.
    pub fn new(frame: Frame, sensor: InverseSensor) -> Result<Self, OccupancyError> {
        sensor.check()?;
        Ok(Self { odds: Grid::filled(frame, 0.0), sensor })
    }

    /// Returns the frame of the map.
    #[must_use]
    pub const fn frame(&self) -> &Frame {
        self.odds.frame()
    }

    /// Adds one ray of a range sensor at `sensor` (world): bearing, rad, from the sensor's x axis, and range, m.
    ///
    /// Cells beyond the grid are left out: a ray that leaves it frees the cells that it crosses inside. A range of
    /// [`InverseSensor::max_range_m`] or more met no obstacle.
    ///
    /// # Errors
    /// [`OccupancyError::Reading`] and, for a sensor that is not on the grid, [`OccupancyError::Grid`]; the map is not changed.
    pub fn insert(&mut self, sensor: Pose, bearing_rad: f64, range_m: f64) -> Result<(), OccupancyError> {
        if range_m.is_nan() || range_m < 0.0 || !bearing_rad.is_finite() || !sensor.is_finite() {
            return Err(OccupancyError::Reading { range_m, bearing_rad });
        }
        let met = range_m < self.sensor.max_range_m;
        let length_m = range_m.min(self.sensor.max_range_m);
        let (sin, cos) = (sensor.yaw_rad + bearing_rad).sin_cos();
        let end = [sensor.x_m + length_m * cos, sensor.y_m + length_m * sin];
        let frame = *self.odds.frame();
        frame.cell_at(sensor.point())?;
        let end_cell = if met { frame.cell_at(end).ok() } else { None };
        let crossed = log_odds(self.sensor.crossed_occupied);
        for Crossing { cell, .. } in traverse(&frame, sensor.point(), end)? {
            // Rounding may put the end into the previous cell; it is counted once, below.
            if Some(cell) != end_cell {
                self.add(cell, crossed);
            }
        }
        if let Some(cell) = end_cell {
            self.add(cell, log_odds(self.sensor.end_occupied));
        }
        Ok(())
    }

    fn add(&mut self, cell: Cell, log_odds_change: f64) {
        let [low, high] = self.sensor.clamp.map(log_odds);
        if let Ok(odds) = self.odds.get_mut(cell) {
            *odds = (*odds + log_odds_change).clamp(low, high);
        }
    }

    /// Returns the probability that a cell has an obstacle; 0.5 for an unknown cell.
    ///
    /// # Errors
    /// [`OccupancyError::Grid`].
    pub fn probability(&self, cell: Cell) -> Result<f64, OccupancyError> {
        Ok(1.0 / (1.0 + (-self.odds.get(cell)?).exp()))
    }

    /// Returns the knowledge about a cell.
    ///
    /// # Errors
    /// [`OccupancyError::Grid`].
    pub fn state(&self, cell: Cell) -> Result<State, OccupancyError> {
        Ok(self.state_of(*self.odds.get(cell)?))
    }

    fn state_of(&self, odds: f64) -> State {
        if odds < log_odds(self.sensor.free_below) {
            State::Free
        } else if odds > log_odds(self.sensor.occupied_above) {
            State::Occupied
        } else {
            State::Unknown
        }
    }

    /// Returns the states of all cells.
    #[must_use]
    pub fn states(&self) -> Grid<State> {
        self.odds.map(|odds| self.state_of(*odds))
    }

    /// Returns the distance, m, from each cell's centre to that of the nearest occupied cell; infinite without any.
    #[must_use]
    pub fn clearance_m(&self) -> Grid<f64> {
        clearance_m(&self.odds.map(|odds| self.state_of(*odds) == State::Occupied))
    }

    /// Returns the cells where the centre of a round robot may be: they are free, and their centre is at least
    /// `radius_m` from that of every occupied cell. Unknown cells are never among them.
    #[must_use]
    pub fn free_for(&self, radius_m: f64) -> Grid<bool> {
        let clearance_m = self.clearance_m();
        let states = self.states();
        let free = clearance_m.values().iter().zip(states.values());
        let free = free.map(|(clear_m, state)| *state == State::Free && *clear_m >= radius_m).collect();
        Grid::of(*self.frame(), free).unwrap_or_else(|_| Grid::filled(*self.frame(), false))
    }
}

/// Returns the distance, m, from each cell's centre to that of the nearest marked cell; infinite without any, 0 in
/// marked cells.
///
/// # Source
/// Felzenszwalb, Huttenlocher, "Distance Transforms of Sampled Functions", Theory of Computing 8, 2012: exact, linear in the
/// number of cells.
#[must_use]
pub fn clearance_m(marked: &Grid<bool>) -> Grid<f64> {
    distance::transform(marked)
}

/// Returns whether a straight line between two points of the world crosses no marked cell.
///
/// # Errors
/// [`OccupancyError::Grid`] if the first point is not on the grid.
pub fn is_clear(marked: &Grid<bool>, from: Point, to: Point) -> Result<bool, OccupancyError> {
    let reach = distance_m(from, to);
    if !reach.is_finite() {
        return Err(OccupancyError::Grid(GridError::Outside { x_m: to[0], y_m: to[1] }));
    }
    Ok(traverse(marked.frame(), from, to)?.all(|crossing| matches!(marked.get(crossing.cell), Ok(false))))
}
