//! Messages of sensors and joints.

use serde::{Deserialize, Serialize};

use super::{Header, Quaternion, Vector3};

/// Message `sensor_msgs/msg/JointState`: state or set points of joints, in rad and rad/s for rotary joints, m and m/s for linear ones.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// Time of the measurement or the decision; no frame.
    pub header: Header,
    /// Names of the joints.
    pub name: Vec<String>,
    /// Positions in the order of the names, rad or m; empty without positions.
    pub position: Vec<f64>,
    /// Speeds in the order of the names, rad/s or m/s; empty without speeds.
    pub velocity: Vec<f64>,
    /// Efforts in the order of the names, N m or N; empty without efforts.
    pub effort: Vec<f64>,
}

/// Message `sensor_msgs/msg/Imu`: turn rate and acceleration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// Time of the measurement, and the frame of the sensor's axes.
    pub header: Header,
    /// Orientation of the sensor; without meaning where its covariance begins with -1.
    pub orientation: Quaternion,
    /// Covariance of the orientation, rad²; it begins with -1 where there is no orientation.
    pub orientation_covariance: [f64; 9],
    /// Turn rate about each axis, rad/s.
    pub angular_velocity: Vector3,
    /// Covariance of the turn rate, rad²/s²; all 0 when unknown.
    pub angular_velocity_covariance: [f64; 9],
    /// Acceleration less that of free fall, m/s²: +9.81 upwards at rest.
    pub linear_acceleration: Vector3,
    /// Covariance of the acceleration, m²/s⁴; all 0 when unknown.
    pub linear_acceleration_covariance: [f64; 9],
}

/// Message `sensor_msgs/msg/Range`: distance measured by sound or light.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// Time of the measurement, and the sensor's frame, whose x axis is the line of sight.
    pub header: Header,
    /// Kind of sensor: [`Range::ULTRASOUND`] or [`Range::INFRARED`].
    pub radiation_type: u8,
    /// Full angle of the sensor's cone, rad.
    pub field_of_view: f32,
    /// Shortest distance that the sensor measures, m.
    pub min_range: f32,
    /// Longest distance that the sensor measures, m.
    pub max_range: f32,
    /// Measured distance, m; infinite where nothing reflects (REP-117).
    pub range: f32,
    /// Variance of the distance, m²; 0 when unknown.
    pub variance: f32,
}

impl Range {
    /// Value of `radiation_type` for ultrasound.
    pub const ULTRASOUND: u8 = 0;
    /// Value of `radiation_type` for optical sensors.
    pub const INFRARED: u8 = 1;
}

/// Message `sensor_msgs/msg/BatteryState`: state of a supply. Quantities without a sensor are NaN.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BatteryState {
    /// Time of the measurement, and the name of the channel as frame.
    pub header: Header,
    /// Voltage of the supply, V.
    pub voltage: f32,
    /// Temperature of the battery, °C.
    pub temperature: f32,
    /// Current, A; negative when discharging.
    pub current: f32,
    /// Remaining charge, A h.
    pub charge: f32,
    /// Capacity at the last full charge, A h.
    pub capacity: f32,
    /// Capacity by design, A h.
    pub design_capacity: f32,
    /// State of charge, 0 to 1.
    pub percentage: f32,
    /// State of charging; 0 when unknown.
    pub power_supply_status: u8,
    /// Health: 0 for unknown, 1 for good, 4 for over-voltage.
    pub power_supply_health: u8,
    /// Chemistry of the cells; 0 when unknown.
    pub power_supply_technology: u8,
    /// True when a battery is present.
    pub present: bool,
    /// Voltage of each cell, V; empty when unknown.
    pub cell_voltage: Vec<f32>,
    /// Temperature of each cell, °C; empty when unknown.
    pub cell_temperature: Vec<f32>,
    /// Place of the battery: the channel's name.
    pub location: String,
    /// Serial number; empty where there is none.
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
