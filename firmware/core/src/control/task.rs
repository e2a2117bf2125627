//! The control task: one pass per period, and out of turn when outputs must be made safe.

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant, Timer};
use heapless::Vec;
use r4_protocol::{
    Cause, Causes, Mode, SafetyState,
    config::{BoardConfig, Feedback, MAX_MOTORS, MAX_SUPPLIES, Place, SupplyConfig},
};

use super::axis::Axis;
use crate::{
    outputs::{OutputFault, Outputs},
    platform::{Bus, Peripherals},
    sensing::filter::LowPass,
    shared::{SafetyView, Shared, Status},
};

/// From closing the motors' supply to the first duty: contacts bounce, and bridges want 10 ms of good supply.
const POWER_UP: Duration = Duration::from_millis(50);
/// While armed, one thing is read back from the chips every so many periods; while safe, every period.
const CHECK_EVERY: u32 = 4;
/// While safe, the safe state is written again every so many periods.
const REASSERT_EVERY: u32 = 16;
/// As many late periods in a row are an overrun: the loops compute with a period that is not theirs.
const LATE_IN_A_ROW: u32 = 10;
/// Smooths a rail against the dips of single PWM periods, s.
const SUPPLY_FILTER_S: f32 = 0.01;
/// A rail is back in range only this share of the range inside it.
const SUPPLY_HYSTERESIS: f32 = 0.02;

/// What the control task works with.
pub struct BoardIo<B, P> {
    /// The I2C bus with the board's chips.
    pub bus: B,
    /// Counters, converters, switches, step generators.
    pub peripherals: P,
}

/// Runs the control loop for ever, with the second highest priority.
pub async fn run<M: RawMutex, B: Bus, P: Peripherals>(shared: &Shared<M>, io: BoardIo<B, P>) -> ! {
    let config = shared.config();
    let mut control = Control::new(config, io);
    control.initialise().await;
    // Sensors are read before the first host is answered: it is told of a flat battery at once.
    control.sense(shared);
    shared.set_control_causes(control.causes());
    shared.set_started();

    let period = Duration::from_micros(config.control_period_us.into());
    let mut due = Instant::now();
    let mut late_in_a_row = 0;
    loop {
        let begin = Instant::now();
        shared.control_tick(begin);
        control.tick(shared).await;
        due += period;
        let end = Instant::now();
        shared.count(|stats| {
            stats.ticks = stats.ticks.wrapping_add(1);
            stats.worst_tick_us = stats.worst_tick_us.max((end - begin).as_micros() as u32);
            stats.bus_retries = stats.bus_retries.wrapping_add(control.outputs.take_retries());
            if end > due {
                stats.late_ticks = stats.late_ticks.wrapping_add(1);
            }
        });
        late_in_a_row = if end > due { late_in_a_row + 1 } else { 0 };
        if end > due {
            // Skip what was missed: two passes at once would see the same sensors twice.
            due = end;
        }
        if late_in_a_row == LATE_IN_A_ROW {
            late_in_a_row = 0;
            shared.trip(Cause::ControlOverrun);
        }
        while let Either::Second(()) = select(Timer::at(due), shared.make_safe.wait()).await {
            // Stopped, also when it has been cleared and armed again before we could look.
            let view = shared.safety();
            if view.state != SafetyState::Armed || view.epoch != control.epoch {
                control.make_safe().await;
                shared.set_control_causes(control.causes());
            }
        }
    }
}

struct Control<B, P> {
    outputs: Outputs<B>,
    peripherals: P,
    motors: Vec<Axis, MAX_MOTORS>,
    supplies: Vec<Supply, MAX_SUPPLIES>,
    /// When the motors' supply may be relied on.
    powered_at: Instant,
    /// The arming whose commands are being followed.
    epoch: u16,
    tick: u32,
    /// What went wrong with the outputs since they were last initialised.
    fault: Option<OutputFault>,
    /// Whether the safe state has been written since the outputs were last driven.
    safe: bool,
    bad_configuration: bool,
    sensors: Causes,
}

impl<B: Bus, P: Peripherals> Control<B, P> {
    /// With a configuration that is not valid there are no motors to drive, only outputs to hold safe.
    fn new(config: &BoardConfig, io: BoardIo<B, P>) -> Self {
        let period_s = config.control_period_us as f32 * 1e-6;
        let motors = config.motors.iter().map_while(|motor| Axis::new(motor, period_s).ok()).collect();
        let bad_configuration = config.validate().is_err();
        Self {
            outputs: Outputs::new(io.bus, config),
            peripherals: io.peripherals,
            motors: if bad_configuration { Vec::new() } else { motors },
            supplies: config.supplies.iter().map(|supply| Supply::new(*supply, period_s)).collect(),
            powered_at: Instant::MIN,
            epoch: 0,
            tick: 0,
            fault: None,
            safe: false,
            bad_configuration,
            sensors: Causes::NONE,
        }
    }

    async fn tick<M: RawMutex>(&mut self, shared: &Shared<M>) {
        self.tick = self.tick.wrapping_add(1);
        self.outputs.begin_tick();
        self.sense(shared);
        for (index, motor) in self.motors.iter_mut().enumerate() {
            for (mode, gains) in [Mode::Position, Mode::Speed].into_iter().zip(shared.take_gains(index)) {
                gains.into_iter().for_each(|gains| motor.set_gains(mode, gains));
            }
        }
        let view = shared.safety();
        if view.state == SafetyState::Armed {
            self.drive(shared, view).await;
        } else {
            self.hold_safe().await;
        }
        for (index, motor) in self.motors.iter().enumerate() {
            shared.publish(Place::Motor(index), Status::Motor(motor.status()));
        }
        for index in 0..shared.config().relays.len() {
            shared.publish(Place::Relay(index), Status::Scalar(self.outputs.is_closed(index).into()));
        }
        shared.set_control_causes(self.causes());
    }

    fn sense<M: RawMutex>(&mut self, shared: &Shared<M>) {
        let mut causes = Causes::NONE;
        for (motor, config) in self.motors.iter_mut().zip(&shared.config().motors) {
            let (Axis::Measured(motor), Some(control)) = (motor, config.control) else { continue };
            let raw = match control.feedback {
                Feedback::Encoder { index, .. } => self.peripherals.count(index),
                Feedback::Potentiometer { analog, .. } => self.peripherals.code(analog),
            };
            causes = causes.union(motor.sense(raw, None));
        }
        for (index, supply) in self.supplies.iter_mut().enumerate() {
            let (volts, in_range) = supply.update(self.peripherals.code(supply.config.analog));
            shared.publish(Place::Supply(index), Status::Scalar(volts));
            if !in_range {
                causes.set(Cause::SupplyOutOfRange, true);
            }
        }
        self.sensors = causes;
    }

    /// One period of every loop, for the arming in `view`. Outputs are written in the order of [`Outputs::order`].
    async fn drive<M: RawMutex>(&mut self, shared: &Shared<M>, view: SafetyView) {
        if view.epoch != self.epoch {
            self.epoch = view.epoch;
            self.motors.iter_mut().for_each(Axis::stop);
            if self.outputs.has_motor_power_relay() {
                self.outputs.close_motor_power();
                self.powered_at = Instant::now() + POWER_UP;
            }
        }
        self.safe = false;
        if let Err(fault) = self.switch_relays(shared, view).await {
            return self.fail(shared, fault);
        }
        for index in self.outputs.order(self.tick) {
            let motor = &mut self.motors[index];
            if let Some(setpoint) = shared.take_command(Place::Motor(index), view.epoch) {
                motor.command(setpoint);
            }
            if Instant::now() < self.powered_at {
                // The motors' supply has just been closed: drivers need it before their inputs move.
                continue;
            }
            let (duty, causes) = motor.step();
            causes.iter().for_each(|cause| shared.trip(cause));
            // A stop that came while another bridge was written must not wait for this one.
            if shared.safety() != view {
                return self.make_safe().await;
            }
            match self.outputs.drive(index, duty).await {
                Ok(applied) => motor.set_applied(applied),
                Err(fault) => return self.fail(shared, fault),
            }
        }
        if self.tick.is_multiple_of(CHECK_EVERY) {
            self.check().await;
        }
    }

    /// Tells the supervisor now, and not after the time-outs of the other outputs.
    fn fail<M: RawMutex>(&mut self, shared: &Shared<M>, fault: OutputFault) {
        self.fault = Some(fault);
        shared.set_control_causes(self.causes());
    }

    async fn switch_relays<M: RawMutex>(&mut self, shared: &Shared<M>, view: SafetyView) -> Result<(), OutputFault> {
        for index in 0..shared.config().relays.len() {
            if let Some(setpoint) = shared.take_command(Place::Relay(index), view.epoch) {
                self.outputs.switch(index, setpoint.value != 0.0);
            }
        }
        self.outputs.write_expander().await
    }

    async fn initialise(&mut self) {
        // The only way out of a fault: whatever a chip lost, it gets again.
        self.fault = self.outputs.init().await.err();
        self.safe = self.fault.is_none();
    }

    async fn make_safe(&mut self) {
        self.motors.iter_mut().for_each(Axis::stop);
        match self.outputs.make_safe().await {
            Ok(()) => self.safe = true,
            Err(fault) => self.fault = Some(fault),
        }
    }

    async fn hold_safe(&mut self) {
        self.motors.iter_mut().for_each(Axis::stop);
        if !self.safe || self.tick.is_multiple_of(REASSERT_EVERY) {
            self.make_safe().await;
        }
        if self.fault.is_some() {
            self.initialise().await;
        } else {
            self.check().await;
        }
    }

    async fn check(&mut self) {
        if let Err(fault) = self.outputs.check_next().await {
            self.fault = Some(fault);
        }
    }

    fn causes(&self) -> Causes {
        let mut causes = self.sensors;
        causes.set(Cause::I2cFault, self.fault == Some(OutputFault::Bus));
        causes.set(Cause::ReadBackMismatch, self.fault == Some(OutputFault::Mismatch));
        causes.set(Cause::BadConfiguration, self.bad_configuration);
        causes
    }
}

/// One measured rail.
struct Supply {
    config: SupplyConfig,
    filter: Option<LowPass>,
    period_s: f32,
    in_range: bool,
}

impl Supply {
    fn new(config: SupplyConfig, period_s: f32) -> Self {
        Self { config, filter: None, period_s, in_range: true }
    }

    /// Volts, and whether they are in range.
    fn update(&mut self, code: u16) -> (f32, bool) {
        let measured_v = f32::from(code) * self.config.volts_per_code;
        let period_s = self.period_s;
        let filter = self.filter.get_or_insert_with(|| {
            let mut filter = LowPass::new(SUPPLY_FILTER_S, period_s);
            filter.reset(measured_v);
            filter
        });
        let volts = filter.step(measured_v);
        let range = self.config.range_v;
        let margin = if self.in_range { 0.0 } else { (range.max - range.min) * SUPPLY_HYSTERESIS };
        self.in_range = volts >= range.min + margin && volts <= range.max - margin;
        (volts, self.in_range)
    }
}
