//! TAIL: a two-link tail on a person's back that moves its weight against a load that the person lifts.
//!
//! Paper: "Prototyping Mechanical Design of a Robotic Tail for Human Balance Support", TAROS 2023. It is mechanics only: links of 0.70
//! and 0.40 m, at most 7 kg, cable drives of 20 to 30, 0.625 N/m (taken for N m) and 573 W for motor 1, 4 N/m and 262 W for motor 2.
//!
//! What is printed contradicts itself: at a ratio of 25 the motors give 15.6 and 100 N m, and the tail's weight asks for about 50 N m
//! at the back and 10 N m at the middle joint. Three readings:
//!
//! | reading | at the back | at the middle joint |
//! | --- | --- | --- |
//! | as printed, motor 1 at the back | 0.625 N m, 573 W | 4 N m, 262 W |
//! | motor 1 is the outer joint's | 4 N m, 262 W | 0.625 N m, 573 W |
//! | columns of torque and power crossed | 4 N m, 573 W | 0.625 N m, 262 W |
//!
//! The controller is ours: [`law`] is a pure function from what is measured to commands of the drives, [`model`] what it knows of person
//! and tail, [`lqr`] how its gain is found. The person is a declared inverted pendulum: nothing is claimed about people.

pub mod law;
pub mod lqr;
pub mod model;
