//! What sensors and joints say.

use serde::{Deserialize, Serialize};

use super::{Header, Quaternion, Vector3};

/// `sensor_msgs/msg/JointState`: rad and rad/s of what turns, m and m/s of what slides.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// When.
    pub header: Header,
    /// Names of the joints.
    pub name: Vec<String>,
    /// One for each name, or none.
    pub position: Vec<f64>,
    /// One for each name, or none.
    pub velocity: Vec<f64>,
    /// One for each name, or none: N m or N.
    pub effort: Vec<f64>,
}

/// `sensor_msgs/msg/Imu`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// Frame of the numbers.
    pub header: Header,
    /// Where it is turned to.
    pub orientation: Quaternion,
    /// Begins with -1 where there is no orientation.
    pub orientation_covariance: [f64; 9],
    /// rad/s
    pub angular_velocity: Vector3,
    /// All 0: not known.
    pub angular_velocity_covariance: [f64; 9],
    /// Acceleration less that of free fall, m/s².
    pub linear_acceleration: Vector3,
    /// All 0: not known.
    pub linear_acceleration_covariance: [f64; 9],
}

/// `sensor_msgs/msg/Range`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// Its x axis is where the sensor looks.
    pub header: Header,
    /// [`Range::ULTRASOUND`] or [`Range::INFRARED`].
    pub radiation_type: u8,
    /// rad
    pub field_of_view: f32,
    /// m
    pub min_range: f32,
    /// m
    pub max_range: f32,
    /// m; infinite where nothing reflects.
    pub range: f32,
    /// 0: not known, m².
    pub variance: f32,
}

impl Range {
    /// Sound.
    pub const ULTRASOUND: u8 = 0;
    /// Light.
    pub const INFRARED: u8 = 1;
}

/// `sensor_msgs/msg/BatteryState`: NaN for what nothing measures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BatteryState {
    /// When.
    pub header: Header,
    /// V
    pub voltage: f32,
    /// °C
    pub temperature: f32,
    /// Negative when discharging, A.
    pub current: f32,
    /// A h
    pub charge: f32,
    /// A h
    pub capacity: f32,
    /// A h
    pub design_capacity: f32,
    /// 0 to 1.
    pub percentage: f32,
    /// 0: not known.
    pub power_supply_status: u8,
    /// 0: not known, 1: good, 4: over-voltage.
    pub power_supply_health: u8,
    /// 0: not known.
    pub power_supply_technology: u8,
    /// Whether there is one.
    pub present: bool,
    /// V
    pub cell_voltage: Vec<f32>,
    /// °C
    pub cell_temperature: Vec<f32>,
    /// Which of several.
    pub location: String,
    /// Nothing where it has none.
    pub serial_number: String,
}

impl Default for BatteryState {
    fn default() -> Self {
        Self {
            header: Header::default(),
            voltage: f32::NAN,
            temperature: f32::NAN,
            current: f32::NAN,
            charge: f32::NAN,
            capacity: f32::NAN,
            design_capacity: f32::NAN,
            percentage: f32::NAN,
            power_supply_status: 0,
            power_supply_health: 0,
            power_supply_technology: 0,
            present: true,
            cell_voltage: Vec::new(),
            cell_temperature: Vec::new(),
            location: String::new(),
            serial_number: String::new(),
        }
    }
}
