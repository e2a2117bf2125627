//! Tests of the firmware on the chips of a simulated board.

mod bodies;
mod braking;
mod bus_sensors;
mod compatibility;
mod control;
mod dac_and_servo;
mod feedback;
mod follow;
mod friction;
mod harness;
mod index;
mod link;
mod outputs;
mod overload;
mod passthrough;
mod published_defects;
mod ranging;
mod restart;
mod safety;
mod screen;
mod stop_watch;
mod storage;
mod storms;
mod uart_sensors;
mod whole_board;
mod wires;
