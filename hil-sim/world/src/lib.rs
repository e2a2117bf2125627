//! Bodies that couple a robot's shafts, and the planar world they move in.
//!
//! A [`Body`] takes the motion of the shafts that a board drives and gives each shaft its load. It is stepped together
//! with the shafts' plants, in steps short enough for the coupling by forces to be stable: see [`MAX_STEP_S`].
//!
//! # Frames and units
//! SI throughout. The world's x and y are horizontal; a body's x points forwards, y to its left, and its yaw turns
//! counterclockwise seen from above (REP-103).

mod berry;
mod body;
pub mod cable_loop;
mod deformable;
mod dice;
mod field;
mod grip;
mod outline;
mod pneumatic;
mod scene;
mod suction;
mod tail;
mod tyre;
mod wheeled;

pub use berry::{AirSupply, Berry, BerryError, BerryPicker, CoilValve, Cylinder, Fate, Fingers, Place, ToolAxes};
pub use body::{AnyBody, Body, Inertial, Pose, ShaftMotion, Twist};
pub use cable_loop::{CableLoop, CableLoopError};
pub use deformable::{Deformable, DeformableError, Shell, Whiskers};
pub use field::{
    Balance, Charge, Cloud, Electric, ElectricSpec, Field, FieldError, FieldKind, Flow, FlowError, FlowSpec, Lag,
    Plume, PlumeSpec, Wander,
};
pub use grip::{Encoders, Finger, GripError, Held, Pads, Palm, Touch, TwoFingers};
pub use outline::{Outline, OutlineError};
pub use pneumatic::{ATMOSPHERE_PA, Chamber, Restriction};
pub use scene::{BoxSpec, Floor, MovableBox, Person, Point, Scene, SceneError, Surface};
pub use suction::{
    Cup, LIMIT_STRETCH, Line, MEMBRANES, MIDDLE, Membrane, MembraneState, Strip, SuctionError, SuctionPad, SuctionState,
};
pub use tail::{Ankle, BalanceTail, Cable, Lift, Link, TailError, TailState, Wearer};
pub use tyre::{Contact, SlipLaw, Springs, Tyre, TyreError};
pub use wheeled::{Axle, Chassis, ChassisError, Wheel, Wheeled};

/// Longest step of a body, s. Plants take no longer ones either, so a body adds no steps to its shafts.
pub const MAX_STEP_S: f64 = 2.5e-4;
/// Standard acceleration of free fall, m/s².
pub const GRAVITY_M_S2: f64 = 9.806_65;
