//! The processor's step generators and the drivers connected to them.

use std::collections::VecDeque;

use r4_firmware::platform::{StepAction, StepEvent, Steppers};
use r4_protocol::ChannelId;

use crate::devices::stepper_driver::{StepperDriver, StepperDriverSpec};

/// Clock of the timers for steps and edges, Hz.
const TICK_HZ: u32 = 10_000_000;
const NS_PER_TICK: u64 = 1_000_000_000 / TICK_HZ as u64;
/// Active time of a pulse, timer ticks.
const PULSE_TICKS: u32 = 40;
/// Capacity of an axis for events.
const ROOM: usize = 512;

/// Pulses at a driver's step input, by the level of its direction input: those that the processor sent, even if the
/// driver dropped them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepPulses {
    /// Number of pulses with direction high.
    pub forward: u64,
    /// Number of pulses with direction low.
    pub backward: u64,
}

/// A change of a line to the driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wire {
    Step(bool),
    Direction(bool),
    Enable(bool),
    Supply(bool),
}

/// One axis: its timer's queue and its driver.
pub(super) struct Axis {
    pub(super) channel: ChannelId,
    pub(super) driver: StepperDriver,
    /// Steps per turn of the output shaft.
    pub(super) steps_per_turn: u32,
    queue: VecDeque<(u64, StepAction)>,
    positive: bool,
    position: i32,
    enabled_when_high: bool,
    now_ns: u64,
    pulses: StepPulses,
    step_high: bool,
    direction_high: bool,
    /// Edges from a processor that drives the lines itself, in order of time.
    wires: VecDeque<(u64, Wire)>,
    /// Time up to which such a processor has reported all edges, ns; the driver does not advance beyond it.
    told_ns: Option<u64>,
}

impl Axis {
    pub(super) fn new(channel: ChannelId, spec: StepperDriverSpec, steps_per_turn: u32) -> Self {
        let enabled_when_high = spec.enabled_when_high;
        let mut driver = StepperDriver::new(channel.index, spec);
        // the board holds the enable line inactive until the processor drives it
        driver.enable(0, !enabled_when_high);
        let queue = VecDeque::new();
        Self {
            channel,
            driver,
            steps_per_turn,
            queue,
            positive: true,
            position: 0,
            enabled_when_high,
            now_ns: 0,
            pulses: StepPulses::default(),
            step_high: false,
            direction_high: true,
            wires: VecDeque::new(),
            told_ns: None,
        }
    }

    /// Executes events that are due by `now_ns`.
    pub(super) fn catch_up(&mut self, now_ns: u64) {
        self.now_ns = now_ns;
        if let Some(told_ns) = self.told_ns {
            self.follow_wires(now_ns.min(told_ns));
            return;
        }
        while let Some((at_ns, action)) = self.queue.pop_front_if(|(at_ns, _)| *at_ns <= now_ns) {
            match action {
                StepAction::Pulse => {
                    self.driver.step(at_ns, true);
                    self.driver.step(at_ns + u64::from(PULSE_TICKS) * NS_PER_TICK, false);
                    self.position = self.position.wrapping_add(if self.positive { 1 } else { -1 });
                    self.pulses.count(self.positive);
                }
                StepAction::Direction(positive) => {
                    self.positive = positive;
                    self.driver.direction(at_ns, positive);
                }
            }
        }
        self.driver.advance(now_ns);
    }

    /// Advances the driver to `to_ns`, edge by edge.
    fn follow_wires(&mut self, to_ns: u64) {
        while let Some((at_ns, wire)) = self.wires.pop_front_if(|(at_ns, _)| *at_ns <= to_ns) {
            match wire {
                Wire::Step(high) => {
                    self.driver.step(at_ns, high);
                    if high && !self.step_high {
                        self.pulses.count(self.direction_high);
                    }
                    self.step_high = high;
                }
                Wire::Direction(high) => {
                    self.driver.direction(at_ns, high);
                    self.direction_high = high;
                }
                Wire::Enable(high) => self.driver.enable(at_ns, high),
                Wire::Supply(on) => self.driver.supply(at_ns, on),
            }
        }
        self.driver.advance(to_ns);
    }

    /// Records an edge, at a time up to now and not before what the driver has seen; edges of different lines in any
    /// order.
    fn tell(&mut self, at_ns: u64, wire: Wire) {
        self.told_ns.get_or_insert(self.now_ns);
        let place = self.wires.partition_point(|(earlier_ns, _)| *earlier_ns <= at_ns);
        self.wires.insert(place, (at_ns, wire));
    }

    /// Sets the level of the step input from `at_ns` on.
    pub(super) fn step_line(&mut self, at_ns: u64, high: bool) {
        self.tell(at_ns, Wire::Step(high));
    }

    /// Sets the level of the direction input from `at_ns` on.
    pub(super) fn direction_line(&mut self, at_ns: u64, high: bool) {
        self.tell(at_ns, Wire::Direction(high));
    }

    /// Sets the level of the enable input from now, `now_ns`, on.
    pub(super) fn enable(&mut self, now_ns: u64, high: bool) {
        if self.told_ns.is_some() {
            self.tell(now_ns, Wire::Enable(high));
        } else {
            self.driver.enable(now_ns, high);
        }
    }

    /// Switches the motor's supply from now, `now_ns`, on.
    pub(super) fn supply(&mut self, now_ns: u64, on: bool) {
        if self.told_ns.is_some() {
            self.tell(now_ns, Wire::Supply(on));
        } else {
            self.driver.supply(now_ns, on);
        }
    }

    /// Declares that all edges up to `up_to_ns` have been reported.
    pub(super) fn settle(&mut self, up_to_ns: u64) {
        self.told_ns = self.told_ns.max(Some(up_to_ns));
        self.follow_wires(up_to_ns.min(self.now_ns));
    }

    pub(super) const fn pulses(&self) -> StepPulses {
        self.pulses
    }

    /// Resets the timer's queue and count; lines float to levels at which nothing moves.
    pub(super) fn reset(&mut self) {
        self.queue.clear();
        self.position = 0;
        let now_ns = self.now_ns;
        if self.told_ns.is_some() {
            self.tell(now_ns, Wire::Step(false));
        }
        self.enable(now_ns, !self.enabled_when_high);
    }

    /// True position of the shaft relative to time 0, rad.
    pub(super) fn angle_rad(&self) -> f64 {
        self.driver.position() as f64 / f64::from(self.steps_per_turn) * std::f64::consts::TAU
    }

    pub(super) fn speed_rad_s(&self) -> f64 {
        self.driver.speed_hz() / f64::from(self.steps_per_turn) * std::f64::consts::TAU
    }
}

impl StepPulses {
    fn count(&mut self, forward: bool) {
        *if forward { &mut self.forward } else { &mut self.backward } += 1;
    }

    /// Number of forward minus backward pulses.
    #[must_use]
    pub const fn net(self) -> i64 {
        self.forward.wrapping_sub(self.backward) as i64
    }
}

/// Generators of all axes, as the firmware accesses them.
impl Steppers for super::Processor {
    const TICK_HZ: u32 = TICK_HZ;
    const PULSE_TICKS: u32 = PULSE_TICKS;
    const DIRECTION_LATENCY_TICKS: u32 = 0;

    fn now(&mut self) -> u32 {
        (self.0.borrow().clock().now_ns() / NS_PER_TICK) as u32
    }

    fn enable(&mut self, high: bool) {
        let mut world = self.0.borrow_mut();
        world.catch_up();
        world.set_stepper_enable(high);
    }

    fn queue(&mut self, axis: u8, events: &[StepEvent]) -> usize {
        let mut world = self.0.borrow_mut();
        world.catch_up();
        let now_ns = world.clock().now_ns();
        let now = (now_ns / NS_PER_TICK) as u32;
        let Some(axis) = world.axis(axis) else { return 0 };
        let room = ROOM.saturating_sub(axis.queue.len()).min(events.len());
        for event in &events[..room] {
            // in the future, by less than half the clock's range
            let ahead = event.at.wrapping_sub(now);
            axis.queue.push_back((now_ns / NS_PER_TICK * NS_PER_TICK + u64::from(ahead) * NS_PER_TICK, event.action));
        }
        room
    }

    fn pending(&mut self, axis: u8) -> u32 {
        let mut world = self.0.borrow_mut();
        world.catch_up();
        world.axis(axis).map_or(0, |axis| axis.queue.len() as u32)
    }

    fn position(&mut self, axis: u8) -> i32 {
        let mut world = self.0.borrow_mut();
        world.catch_up();
        world.axis(axis).map_or(0, |axis| axis.position)
    }

    fn stop(&mut self, axis: u8) {
        let mut world = self.0.borrow_mut();
        world.catch_up();
        if let Some(axis) = world.axis(axis) {
            axis.queue.clear();
        }
    }
}
