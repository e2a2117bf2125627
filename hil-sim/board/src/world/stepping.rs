//! The processor's step generators and the drivers behind them.

use std::collections::VecDeque;

use r4_firmware::platform::{StepAction, StepEvent, Steppers};
use r4_protocol::ChannelId;

use crate::devices::stepper_driver::{StepperDriver, StepperDriverSpec};

/// Steps and edges of the timers.
const TICK_HZ: u32 = 10_000_000;
const NS_PER_TICK: u64 = 1_000_000_000 / TICK_HZ as u64;
/// Active time of a pulse.
const PULSE_TICKS: u32 = 40;
/// Events that one axis has room for.
const ROOM: usize = 512;

/// One axis: its timer's queue and its driver.
pub(super) struct Axis {
    pub(super) channel: ChannelId,
    pub(super) driver: StepperDriver,
    /// Of the output shaft.
    pub(super) steps_per_turn: u32,
    queue: VecDeque<(u64, StepAction)>,
    positive: bool,
    position: i32,
    enabled_when_high: bool,
    now_ns: u64,
}

impl Axis {
    pub(super) fn new(channel: ChannelId, spec: StepperDriverSpec, steps_per_turn: u32) -> Self {
        let enabled_when_high = spec.enabled_when_high;
        let mut driver = StepperDriver::new(channel.index, spec);
        // The board holds the enable line inactive until the processor drives it.
        driver.enable(0, !enabled_when_high);
        let queue = VecDeque::new();
        Self { channel, driver, steps_per_turn, queue, positive: true, position: 0, enabled_when_high, now_ns: 0 }
    }

    /// Carries out what is due by `now_ns`.
    pub(super) fn catch_up(&mut self, now_ns: u64) {
        while let Some((at_ns, action)) = self.queue.pop_front_if(|(at_ns, _)| *at_ns <= now_ns) {
            match action {
                StepAction::Pulse => {
                    self.driver.step(at_ns, true);
                    self.driver.step(at_ns + u64::from(PULSE_TICKS) * NS_PER_TICK, false);
                    self.position = self.position.wrapping_add(if self.positive { 1 } else { -1 });
                }
                StepAction::Direction(positive) => {
                    self.positive = positive;
                    self.driver.direction(at_ns, positive);
                }
            }
        }
        self.driver.advance(now_ns);
        self.now_ns = now_ns;
    }

    /// The timer forgets what was queued and counted.
    pub(super) fn reset(&mut self) {
        self.queue.clear();
        self.position = 0;
        self.driver.enable(self.now_ns, !self.enabled_when_high);
    }

    /// Where the shaft really is, rad, from where it stood at time 0.
    pub(super) fn angle_rad(&self) -> f64 {
        self.driver.position() as f64 / f64::from(self.steps_per_turn) * std::f64::consts::TAU
    }
}

/// The generators of all axes, as the firmware reaches them.
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
            // In the future, by less than half the clock's range.
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
