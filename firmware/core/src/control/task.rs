//! The control task: one pass per period, and additional ones when outputs must be made safe.

use core::{
    future::Future,
    pin::{Pin, pin},
};

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant, Timer};
use heapless::Vec;
use r4_protocol::{
    Cause, Causes, Mode, MotorSnapshot, SafetyState, Setpoint,
    config::{BoardConfig, Feedback, ForceSensor, MAX_MOTORS, Place, STEPPERS},
    message::CONTROL_SHARE,
};

use super::{
    axis::Axis,
    inputs::Inputs,
    motor::{Output, Raw},
    overload::{self, Overload},
    regeneration,
};
use crate::{
    motion::{
        Bank,
        axis::{Command as StepperCommand, Fault as StepperFault},
        steps::DriverTiming,
    },
    outputs::{Order, OutputFault, Outputs, bldc::Command as DriveCommand, dac_code, rest_dacs},
    platform::{Bus, Peripherals, PulseInputs},
    sensing::{
        analog::Supply,
        angle::Reading,
        on_bus::{Sensors, Values},
        pulse,
        storm::IllegalRate,
    },
    shared::{Commanded, ControlSide, MotorStatus, SafetyView, Shared, Status},
    storage::faults::SNAPSHOT_MS,
};

/// Time from closing the motors' supply to the first duty: contacts bounce, and bridges need 10 ms of good supply.
const POWER_UP: Duration = Duration::from_millis(50);
/// Longest wait of a start for the angles of motors: 100 ms until sensors are polled, three transfers for the set-up,
/// one for a reading, one per period, and a margin for a bus that fails at first.
const FIRST_ANGLES: Duration = Duration::from_millis(150);
/// Interval of the read-back checks while armed, periods; while safe there is one each period.
const CHECK_EVERY: u32 = 4;
/// Control periods between two updates of a winding's heat and of its motor's supply voltage; neighbouring motors update in different
/// periods. Windings take seconds to heat. Only the current of the last period counts: at a duty slew limit of 20 1/s and periods of 1 ms it
/// differs from those in between by at most 0.16 of duty. When this was set, the 99.9 % tick of every-interface took 20 327 instructions with
/// an update in each period, and 19 720 with one in four (`r4 bench firmware`).
const WINDING_TURNS: usize = 8;
/// Number of control periods in which the statuses of brushless drives, servos and relays, which have no feedback, are
/// published in rotation, one kind each: telemetry shows them up to this many periods late. All in each period take 230
/// instructions more in the median tick of every-interface.
const PUBLISH_TURNS: u32 = 3;
/// Interval of rewriting the safe state while safe, periods.
const REASSERT_EVERY: u32 = 16;
/// Number of consecutive late periods that is an overrun: the loops then compute with a wrong period.
const LATE_IN_A_ROW: u32 = 10;

/// Hardware of the control task.
pub struct BoardIo<B, P> {
    /// I2C bus of the board's chips.
    pub bus: B,
    /// Peripherals of the processor: counters, converters, switches, step generators.
    pub peripherals: P,
}

/// Runs the control loop indefinitely, with the second highest priority.
pub async fn run<M: RawMutex, B: Bus, P: Peripherals>(shared: &Shared<M>, io: BoardIo<B, P>) -> ! {
    let shared = ControlSide::of(shared);
    let config = shared.config();
    let mut control = Control::new(config, io);
    control.initialise(shared).await;
    control.find_angles(shared).await;
    // Sensors are read before the first host is answered, so that the first answer already shows a flat battery.
    control.sense(shared);
    shared.set_control_causes(control.causes());
    shared.set_started();

    let period = Duration::from_micros(config.control_period_us.into());
    let share = (P::CYCLES_HZ as f32 * config.control_period_us as f32 * 1e-6 * CONTROL_SHARE) as u32;
    let mut due = Instant::now();
    let mut late_in_a_row = 0;
    let mut cycles = control.peripherals.control_cycles();
    loop {
        let until_now = control.peripherals.control_cycles();
        let taken = until_now.wrapping_sub(core::mem::replace(&mut cycles, until_now));
        let begin = period_begins(Instant::now());
        shared.control_tick(begin);
        control.tick(shared, due).await;
        due += period;
        let end = Instant::now();
        shared.count(|stats| {
            stats.ticks = stats.ticks.wrapping_add(1);
            stats.worst_tick_us = stats.worst_tick_us.max((end - begin).as_micros() as u32);
            stats.worst_tick_cycles = stats.worst_tick_cycles.max(taken);
            stats.ticks_over_share = stats.ticks_over_share.wrapping_add((taken > share).into());
            stats.bus_retries = stats.bus_retries.wrapping_add(control.outputs.take_retries());
            if end > due {
                stats.late_ticks = stats.late_ticks.wrapping_add(1);
            }
        });
        late_in_a_row = if end > due { late_in_a_row + 1 } else { 0 };
        if end > due {
            // Missed periods are skipped: two passes at once would see the same sensors twice.
            due = end;
        }
        if late_in_a_row == LATE_IN_A_ROW {
            late_in_a_row = 0;
            shared.trip(Cause::ControlOverrun);
        }
        while let Either::Second(()) = select(Timer::at(due), shared.make_safe.wait()).await {
            // Stopped, also when it has been cleared and armed again before this check.
            let view = shared.safety();
            if view.state != SafetyState::Armed || view.epoch != control.epoch {
                control.stop(shared).await;
                shared.set_control_causes(control.causes());
            }
        }
    }
}

/// Marks the beginning of each period by its symbol: a measurement from outside, in an emulator or by a debugger, sets
/// its breakpoint here. It does nothing else, and differs from every other function so that it is not merged with one.
#[inline(never)]
fn period_begins(at: Instant) -> Instant {
    core::hint::black_box(at)
}

/// Returns the future itself, opaque to the optimiser: its code is not inlined into the caller, which is placed in fast
/// memory.
fn apart<'f, T>(future: Pin<&'f mut (dyn Future<Output = T> + 'f)>) -> Pin<&'f mut (dyn Future<Output = T> + 'f)> {
    core::hint::black_box(future)
}

struct Control<B, P> {
    outputs: Outputs<B>,
    peripherals: P,
    motors: Vec<Axis, MAX_MOTORS>,
    /// Overload protection of each motor with a winding, and the index of the supply that feeds it.
    windings: Vec<Option<(Overload, Option<usize>)>, MAX_MOTORS>,
    /// Rate of illegal transitions of each motor's encoder.
    illegal: [IllegalRate; MAX_MOTORS],
    /// All steppers; `None` without any.
    steppers: Option<Bank>,
    stepper_setpoints: [Setpoint; STEPPERS],
    inputs: Inputs,
    /// Time from which the motors' supply may be relied on.
    powered_at: Instant,
    /// Epoch of the arming whose commands are being followed.
    epoch: u16,
    tick: u32,
    /// Fault of the outputs since they were last initialised.
    fault: Option<OutputFault>,
    /// True if the safe state has been written since the outputs were last driven.
    safe: bool,
    /// Epoch of the arming whose braking stop has been written: see [`crate::safety::stop`].
    braked: Option<u16>,
    bad_configuration: bool,
    /// Sensors on the I2C bus.
    bus_sensors: Sensors,
    /// Causes shown by the inputs, and the time of their last reading.
    sensors: Causes,
    sensed: Instant,
    /// Number of trips seen, and the time of one that is still to be handed over, µs.
    trips: u32,
    tripped_us: Option<u64>,
    /// Number of periods between two snapshots for the fault history.
    moment_every: u32,
}

impl<B: Bus, P: Peripherals> Control<B, P> {
    /// Creates the task's state. An invalid configuration leaves nothing to drive, only outputs to hold safe.
    // A function of its own: inlined, its temporaries would stay on the stack for as long as the task runs.
    #[inline(never)]
    fn new(config: &BoardConfig, io: BoardIo<B, P>) -> Self {
        let period_s = config.control_period_us as f32 * 1e-6;
        let mut peripherals = io.peripherals;
        let valid = config.validate().is_ok();
        let steppers = steppers(config, &mut peripherals);
        let mut control = Self {
            windings: Vec::new(),
            illegal: [IllegalRate::new(period_s); MAX_MOTORS],
            outputs: Outputs::new(io.bus, config),
            motors: Vec::new(),
            bad_configuration: !valid || steppers.is_err(),
            steppers: steppers.unwrap_or_default(),
            stepper_setpoints: [Setpoint::NONE; STEPPERS],
            inputs: Inputs::new(config, period_s),
            peripherals,
            powered_at: Instant::MIN,
            epoch: 0,
            tick: 0,
            fault: None,
            safe: false,
            braked: None,
            bus_sensors: Sensors::new(
                config.sensors.iter().filter(|_| valid),
                Duration::from_micros(config.control_period_us.into()),
            ),
            sensors: Causes::NONE,
            sensed: Instant::MIN,
            trips: 0,
            tripped_us: None,
            moment_every: (u32::from(SNAPSHOT_MS) * 1000 / config.control_period_us.max(1)).max(1),
        };
        // Extended in place: motors are half of the state, and a copy of them would need that much more stack.
        let motors = config.motors.iter().filter(|_| valid);
        control.motors.extend(motors.clone().map_while(|motor| Axis::new(motor, period_s).ok()));
        let winding_s = period_s * WINDING_TURNS as f32;
        control.windings.extend(motors.enumerate().map(|(index, motor)| {
            let winding = motor.winding?;
            let supply = config.supplies.iter().position(|supply| Some(supply.id.index) == winding.supply);
            let kept = control.peripherals.kept(index);
            Some((Overload::new(winding, winding_s).resume(motor.id, kept), supply))
        }));
        control
    }

    /// Runs the period that was to begin at `due`.
    async fn tick<M: RawMutex>(&mut self, shared: ControlSide<'_, M>, due: Instant) {
        self.tick = self.tick.wrapping_add(1);
        self.outputs.begin_tick();
        self.sense(shared);
        while let Some((index, mode, gains)) = shared.take_gains() {
            self.motors.get_mut(index).into_iter().for_each(|motor| motor.set_gains(mode, gains));
        }
        while let Some((index, tuning)) = shared.take_tuning() {
            self.motors.get_mut(index).into_iter().for_each(|motor| motor.set_tuning(tuning));
        }
        // Before the bus, whose time varies up to a whole period: pulses are queued two periods ahead, from a steady
        // moment.
        self.step_steppers(shared);
        self.outputs.bus().leave_time(Instant::now().saturating_duration_since(due));
        let view = shared.safety();
        if view.state == SafetyState::Armed {
            self.drive(shared, view).await;
        } else {
            apart(pin!(self.hold_safe(shared))).await;
        }
        self.ask_sensors(shared, view).await;
        self.publish_outputs(shared);
        self.record(shared);
        shared.set_control_causes(self.causes());
    }

    /// Takes snapshots for the fault history, and hands a trip over to it.
    fn record<M: RawMutex>(&mut self, shared: ControlSide<'_, M>) {
        let now_us = Instant::now().as_micros();
        // One period later, when the causes that came with the first are known too.
        if let Some(tripped_us) = self.tripped_us.take() {
            shared.storage.trip(tripped_us, shared.trip_causes());
        }
        if self.tick.is_multiple_of(self.moment_every) {
            let motors = self.motors.iter().map(|motor| {
                let MotorStatus { position, speed, duty, .. } = motor.status();
                MotorSnapshot { position, speed, duty }
            });
            shared.storage.note(now_us, motors, self.inputs.supplies_v());
        }
        let trips = shared.trips();
        if trips != self.trips {
            self.trips = trips;
            self.tripped_us = Some(now_us);
        }
    }

    fn publish_outputs<M: RawMutex>(&self, shared: ControlSide<'_, M>) {
        let windings = self.windings.iter().map(|winding| winding.as_ref().map(|(overload, _)| overload.status()));
        let motors = self.motors.iter().zip(windings);
        let motors = motors.map(|(motor, winding)| Status::Motor(MotorStatus { winding, ..motor.status() }));
        shared.publish_each(Place::Motor(0), motors);
        shared.set_measured(self.sensed);
        match self.tick % PUBLISH_TURNS {
            0 => shared.publish_each(Place::Bldc(0), self.outputs.drive_shares().map(Status::Scalar)),
            1 => shared.publish_each(Place::Servo(0), self.outputs.servo_angles().map(Status::Scalar)),
            _ => {
                let relays = self.outputs.closed_relays().map(|closed| Status::Scalar(closed.into()));
                shared.publish_each(Place::Relay(0), relays);
            }
        }
        let steppers = self.steppers.iter().flat_map(Bank::status).zip(self.stepper_setpoints);
        let steppers = steppers.map(|(status, setpoint)| {
            // A search ends at rest where it found its place.
            let found = setpoint.mode == Mode::Home && status.homed && !status.moving;
            Status::Motor(MotorStatus {
                setpoint,
                position: status.position_steps,
                speed: status.speed,
                duty: 0.0,
                settled: status.settled || found,
                homed: status.homed,
                winding: None,
            })
        });
        shared.publish_each(Place::Stepper(0), steppers);
    }

    fn sense<M: RawMutex>(&mut self, shared: ControlSide<'_, M>) {
        self.sensed = Instant::now();
        let mut causes = self.inputs.sense(shared, &mut self.peripherals);
        causes.set(Cause::InterruptStorm, self.peripherals.storm());
        for ((motor, config), illegal) in self.motors.iter_mut().zip(&shared.config().motors).zip(&mut self.illegal) {
            // By reference, because it is large.
            let (Axis::Measured(motor), Some(control)) = (motor, &config.control) else { continue };
            let mut transitions = 0;
            let output = match control.feedback {
                Feedback::Encoder { index, .. } => {
                    transitions = self.peripherals.illegal(index);
                    Output::Code(self.peripherals.count(index))
                }
                Feedback::Potentiometer { analog, .. } => Output::Code(self.peripherals.code(analog)),
                Feedback::Angle { .. } | Feedback::Pulses { .. } => {
                    let newest = angle(control.feedback, &self.bus_sensors, &mut self.peripherals, self.sensed);
                    Output::Angle(newest, self.sensed)
                }
            };
            let mut motor_side = 0;
            if let Some(side) = &control.motor_side {
                transitions = transitions.wrapping_add(self.peripherals.illegal(side.index));
                motor_side = self.peripherals.count(side.index);
            }
            if illegal.update(transitions) {
                causes.set(Cause::EncoderImplausible, true);
            }
            let raw = Raw { output, motor_side };
            let home = control.homing.and_then(|homing| self.inputs.is_closed(homing.switch));
            causes = causes.union(motor.sense(raw, home));
            if let Some(force) = &control.force {
                let newtons = newtons(force.sensor, &self.inputs, &self.bus_sensors, self.sensed);
                causes = causes.union(motor.sense_force(newtons));
            }
            if let Feedback::Encoder { index, counts_per_index: 1.., .. } = control.feedback
                && let Some(count) = self.peripherals.at_index(index)
            {
                causes = causes.union(motor.sense_index(count));
            }
        }
        causes.set(Cause::Overload, self.is_overloaded(shared.config()));
        self.sensors = causes;
    }

    /// Updates the heat of the windings that are due, by the current of the last period, and keeps it over a reset; sets the supply voltage
    /// of their motors, where it is measured. Returns whether any motor is overloaded.
    fn is_overloaded(&mut self, config: &BoardConfig) -> bool {
        let mut overloaded = false;
        for (index, (motor, winding)) in self.motors.iter_mut().zip(&mut self.windings).enumerate() {
            let Some((overload, supply)) = winding else { continue };
            if !(self.tick as usize + index).is_multiple_of(WINDING_TURNS) {
                overloaded |= overload.is_present();
                continue;
            }
            let winding = overload.winding();
            let supply_v = supply.and_then(|index| self.inputs.supply(index)).map(Supply::volts);
            if let Some(supply_v) = supply_v {
                motor.set_supply(supply_v / winding.nominal_v);
            }
            let sensed = winding
                .current_sense
                .and_then(|sense| Some((self.inputs.analog_v(sense.analog)? - sense.zero_v) / sense.volts_per_a));
            let (duty, speed) = motor.applied();
            let current_a = match sensed {
                Some(current_a) => current_a,
                // All transistors are off while safe.
                None if self.safe => 0.0,
                None => overload::current_a(winding, duty, speed, supply_v.unwrap_or(winding.nominal_v)),
            };
            overloaded |= overload.step(current_a);
            if let Some(word) = overload.word(config.motors[index].id) {
                self.peripherals.keep(index, word);
            }
        }
        overloaded
    }

    /// Runs one period of every loop, for the arming in `view`. Outputs are written in the order of how much a late one
    /// matters.
    async fn drive<M: RawMutex>(&mut self, shared: ControlSide<'_, M>, view: SafetyView) {
        if view.epoch != self.epoch {
            if !self.safe {
                // Stopped and armed again before this loop could see it: the last arming still ends here.
                self.make_safe(shared).await;
            }
            self.epoch = view.epoch;
            self.motors.iter_mut().for_each(Axis::stop);
            if self.outputs.has_motor_power_relay() {
                self.outputs.close_motor_power();
                self.powered_at = Instant::now() + POWER_UP;
            }
        }
        (self.safe, self.braked) = (false, None);
        if let Err(fault) = self.write_outputs(shared, view).await {
            self.fault = Some(fault);
            // The supervisor learns of it now, and not after the time-outs of the other outputs.
            shared.set_control_causes(self.causes());
        }
    }

    async fn write_outputs<M: RawMutex>(
        &mut self,
        shared: ControlSide<'_, M>,
        view: SafetyView,
    ) -> Result<(), OutputFault> {
        let now = Instant::now();
        shared.end_leases(now);
        let commanded = shared.commanded();
        // The motors' supply may just have been closed: drivers need it before their inputs move.
        let powered = now >= self.powered_at;
        self.take_commands(shared, view, commanded, powered);
        self.outputs.write_expander().await?;
        let [osmc, dhb] = self.outputs.order();
        self.step_motors(shared, view, commanded, powered, osmc);
        let check = self.tick % CHECK_EVERY == 1 && self.outputs.reserve_check();
        // DHB bridges go first in every second period, in which they have the bus to themselves: all of them fit.
        let dhb_first = self.tick.is_multiple_of(2);
        if !dhb_first {
            self.write_drives_and_servos();
        }
        self.step_motors(shared, view, commanded, powered, dhb);
        if dhb_first {
            self.write_drives_and_servos();
        }
        // A stop since then, or during the transfers, drops the unsent writes.
        self.outputs.flush(|context| shared.has_changed(view, context)).await?;
        if self.may_go_on(shared, view).await && check {
            self.outputs.check_next().await?;
        }
        Ok(())
    }

    fn write_drives_and_servos(&mut self) {
        self.outputs.write_drives();
        self.outputs.write_servos();
    }

    /// Returns true if no stop has come in this period. A stop is carried out at once: it must not wait for the
    /// remaining writes.
    async fn may_go_on<M: RawMutex>(&mut self, shared: ControlSide<'_, M>, view: SafetyView) -> bool {
        let goes_on = shared.safety() == view;
        if !goes_on {
            self.stop(shared).await;
        }
        goes_on
    }

    /// Steps the motors in the order `motors`; their bridges are written with the next [`Outputs::flush`].
    fn step_motors<M: RawMutex>(
        &mut self,
        shared: ControlSide<'_, M>,
        view: SafetyView,
        commanded: Commanded,
        powered: bool,
        motors: Order,
    ) {
        for index in motors {
            let motor = &mut self.motors[index];
            if commanded.has(Place::Motor(index))
                && let Some(setpoint) = shared.take_command(Place::Motor(index), view.epoch)
            {
                motor.command(setpoint);
            }
            if !powered {
                continue;
            }
            if let Some(motor) = motor.following() {
                let now_us = self.sensed.as_micros();
                motor.follow(shared.leg(index, now_us), now_us);
            }
            let (duty, causes) = motor.step();
            causes.iter().for_each(|cause| shared.trip(cause));
            let duty = self.limit_regeneration(index, duty);
            let applied = self.outputs.drive(index, duty);
            self.motors[index].set_applied(applied);
        }
    }

    /// Duty for a motor whose loop requests `duty`: with less braking where its supply voltage is too high.
    fn limit_regeneration(&self, index: usize, duty: f32) -> f32 {
        let Some(Some((overload, Some(supply)))) = self.windings.get(index) else { return duty };
        let Some(supply) = self.inputs.supply(*supply) else { return duty };
        let measured_v = supply.measured_v();
        let share = regeneration::share(supply.config(), measured_v);
        let (_, speed) = self.motors[index].applied();
        regeneration::limit(overload.winding(), duty, speed, measured_v, share)
    }

    /// Takes the commands of all outputs except motors, and advances their rules by one step.
    fn take_commands<M: RawMutex>(
        &mut self,
        shared: ControlSide<'_, M>,
        view: SafetyView,
        commanded: Commanded,
        powered: bool,
    ) {
        let config = shared.config();
        let take = |place| shared.take_command(place, view.epoch);
        for index in commanded.among(Place::Relay(0), config.relays.len()) {
            if let Some(setpoint) = take(Place::Relay(index)) {
                self.outputs.switch(index, setpoint.value != 0.0);
            }
        }
        for index in commanded.among(Place::Dac(0), config.dacs.len()) {
            if let Some(setpoint) = take(Place::Dac(index)) {
                self.peripherals.set(config.dacs[index].id.index, dac_code(setpoint.value));
                shared.publish(Place::Dac(index), Status::Scalar(setpoint.value));
            }
        }
        if !powered {
            return;
        }
        for index in 0..config.bldcs.len() {
            let share = commanded.has(Place::Bldc(index)).then(|| take(Place::Bldc(index))).flatten();
            let share = share.map(|setpoint| setpoint.value);
            let brake = commanded.has_brake(index).then(|| shared.take_brake(index, view.epoch)).flatten();
            // A brake command wins over a speed of the same period; a released brake leaves the speed.
            let command = match (brake, share) {
                (Some(true), _) => DriveCommand::Brake,
                (_, Some(share)) => DriveCommand::Run(share),
                (Some(false), None) => DriveCommand::Run(0.0),
                (None, None) => continue,
            };
            self.outputs.command_drive(index, command);
        }
        self.outputs.step_drives();
        for index in commanded.among(Place::Servo(0), config.servos.len()) {
            if let Some(setpoint) = take(Place::Servo(index)) {
                self.outputs.command_servo(index, setpoint.value);
            }
        }
        self.outputs.step_servos();
        let Some(bank) = &mut self.steppers else { return };
        if !bank.is_armed() {
            bank.arm(&mut self.peripherals);
        }
        for index in commanded.among(Place::Stepper(0), config.steppers.len()) {
            let Some(setpoint) = take(Place::Stepper(index)) else { continue };
            let command = match setpoint.mode {
                Mode::Position => StepperCommand::Position(setpoint.value),
                Mode::Speed => StepperCommand::Speed(setpoint.value),
                Mode::Home => StepperCommand::Home(setpoint.value),
                // Dispatch rejects all other modes.
                _ => continue,
            };
            // Dispatch has checked the same limits. If the axis still refuses, because no counter goes that far, it
            // must not keep moving to an older target; telemetry shows the stop.
            self.stepper_setpoints[index] = if bank.command(index, command).is_ok() {
                setpoint
            } else {
                let _ = bank.command(index, StepperCommand::Speed(0.0));
                Setpoint { mode: Mode::Speed, value: 0.0 }
            };
        }
    }

    /// Queues the pulses of the coming periods in the step generators, or only counts the pulses made.
    fn step_steppers<M: RawMutex>(&mut self, shared: ControlSide<'_, M>) {
        let Some(bank) = &mut self.steppers else { return };
        let inputs = &self.inputs;
        let mut causes = Causes::NONE;
        bank.step(
            |number| inputs.is_closed(number),
            &mut self.peripherals,
            |_, fault| {
                let cause = match fault {
                    StepperFault::Late | StepperFault::QueueFull => Cause::ControlOverrun,
                    StepperFault::Miscounted | StepperFault::SwitchUnknown | StepperFault::SwitchNotFound => {
                        Cause::EncoderImplausible
                    }
                };
                causes.set(cause, true);
            },
        );
        causes.iter().for_each(|cause| shared.trip(cause));
    }

    async fn initialise<M: RawMutex>(&mut self, shared: ControlSide<'_, M>) {
        // Known causes are published before the set-up, which takes longer than a loop may hang.
        shared.set_control_causes(self.causes());
        shared.control_pauses();
        self.rest_dacs(shared);
        // The set-up is the only way out of a fault: it restores whatever a chip lost.
        self.fault = self.outputs.init().await.err();
        self.safe = self.fault.is_none();
        shared.control_tick(Instant::now());
    }

    /// Waits until each motor with an angle sensor has a position, at most [`FIRST_ANGLES`]: hosts then find a board
    /// that can be armed, or that reports the cause.
    async fn find_angles<M: RawMutex>(&mut self, shared: ControlSide<'_, M>) {
        let config = shared.config();
        let until = Instant::now() + FIRST_ANGLES;
        let is_missing = |sensors: &Sensors, peripherals: &mut P| {
            let feedback = config.motors.iter().filter_map(|motor| Some(motor.control?.feedback));
            let is_angle = |feedback: &Feedback| matches!(feedback, Feedback::Angle { .. } | Feedback::Pulses { .. });
            let now = Instant::now();
            feedback.filter(is_angle).any(|feedback| angle(feedback, sensors, peripherals, now).is_none())
        };
        while !self.bad_configuration && Instant::now() < until && is_missing(&self.bus_sensors, &mut self.peripherals)
        {
            self.outputs.begin_tick();
            self.bus_sensors.ask(self.outputs.bus(), || false, publish_to(shared)).await;
            Timer::after(Duration::from_millis(1)).await;
            shared.control_tick(Instant::now());
        }
    }

    fn rest_dacs<M: RawMutex>(&mut self, shared: ControlSide<'_, M>) {
        rest_dacs(shared.config(), &mut self.peripherals);
        for (index, dac) in shared.config().dacs.iter().enumerate() {
            shared.publish(Place::Dac(index), Status::Scalar(dac.safe_v));
        }
    }

    /// Brakes, or makes safe at once, as the supervisor has begun, and only once. A stop within a period is carried out
    /// there, and requested again behind it.
    async fn stop<M: RawMutex>(&mut self, shared: ControlSide<'_, M>) {
        let view = shared.safety();
        if view.braking {
            self.brake(shared, view.epoch).await;
        } else if !self.safe {
            self.make_safe(shared).await;
        }
    }

    /// Begins to brake, once for the stop of each arming.
    async fn brake<M: RawMutex>(&mut self, shared: ControlSide<'_, M>, epoch: u16) {
        if self.braked == Some(epoch) {
            return;
        }
        if let Some(bank) = &mut self.steppers {
            bank.brake(&mut self.peripherals);
            self.stepper_setpoints = [Setpoint::NONE; STEPPERS];
        }
        self.rest_dacs(shared);
        self.motors.iter_mut().for_each(Axis::stop);
        match self.outputs.brake().await {
            Ok(()) => self.braked = Some(epoch),
            Err(fault) => {
                self.fault = Some(fault);
                // The supervisor then switches off.
                shared.set_control_causes(self.causes());
            }
        }
    }

    async fn make_safe<M: RawMutex>(&mut self, shared: ControlSide<'_, M>) {
        self.braked = None;
        // Without the bus first: pulses and voltages of the processor itself end at once.
        if let Some(bank) = &mut self.steppers {
            bank.make_safe(&mut self.peripherals);
            self.stepper_setpoints = [Setpoint::NONE; STEPPERS];
        }
        self.rest_dacs(shared);
        self.motors.iter_mut().for_each(Axis::stop);
        match self.outputs.make_safe().await {
            Ok(()) => self.safe = true,
            Err(fault) => self.fault = Some(fault),
        }
    }

    async fn hold_safe<M: RawMutex>(&mut self, shared: ControlSide<'_, M>) {
        self.motors.iter_mut().for_each(Axis::stop);
        let view = shared.safety();
        if view.braking {
            self.brake(shared, view.epoch).await;
            if self.fault.is_none() {
                match self.outputs.step_brakes().await {
                    // The supervisor waits for this, for a limited time.
                    Ok(true) => shared.brakes_written(view.epoch),
                    Ok(false) => {}
                    Err(fault) => self.fault = Some(fault),
                }
            }
            // A fault of a chip ends the braking stop.
            if self.fault.is_none() {
                self.check().await;
            }
            return;
        }
        if !self.safe || self.tick.is_multiple_of(REASSERT_EVERY) {
            self.make_safe(shared).await;
        }
        if self.fault.is_some() {
            self.initialise(shared).await;
        } else if self.tick % REASSERT_EVERY == REASSERT_EVERY / 2 {
            self.fault = self.outputs.check_drives().await.err();
        } else {
            self.check().await;
        }
    }

    /// Gives the sensors the bus time that the outputs have left in this period, unless a stop has come: that is
    /// carried out next.
    async fn ask_sensors<M: RawMutex>(&mut self, shared: ControlSide<'_, M>, view: SafetyView) {
        // The safe state and the DAC's read-back take the whole period.
        let is_taken = view.state != SafetyState::Armed && self.tick.is_multiple_of(REASSERT_EVERY / 2);
        if self.bus_sensors.is_empty() || is_taken || self.fault.is_some() {
            return;
        }
        self.bus_sensors.ask(self.outputs.bus(), || shared.safety() != view, publish_to(shared)).await;
    }

    async fn check(&mut self) {
        if !self.outputs.reserve_check() {
            return;
        }
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

/// Returns the function that publishes the values of sensors on the bus.
fn publish_to<M: RawMutex>(shared: ControlSide<'_, M>) -> impl FnMut(usize, Values) {
    move |index, Values { values, quality, taken }| {
        shared.publish(Place::Sensor(index), Status::Sensor { values, quality, taken });
    }
}

/// Force at a motor's force sensor, N; `None` where it cannot be relied on.
fn newtons(sensor: ForceSensor, inputs: &Inputs, sensors: &Sensors, now: Instant) -> Option<f32> {
    match sensor {
        ForceSensor::Analog { analog, zero_v, newtons_per_v } => {
            Some((inputs.analog_v(analog)? - zero_v) * newtons_per_v)
        }
        ForceSensor::LoadCell { force } => {
            let reading = sensors.force(force)?;
            // A reading older than two periods means that the sensor may be lost.
            let is_recent = now.saturating_duration_since(reading.taken) <= reading.period * 2;
            is_recent.then_some(reading.newtons)
        }
    }
}

/// Last reading of a motor's angle sensor; `None` also for feedback of another kind.
fn angle(feedback: Feedback, sensors: &Sensors, peripherals: &mut impl PulseInputs, now: Instant) -> Option<Reading> {
    match feedback {
        Feedback::Angle { angle, .. } => sensors.angle(angle),
        Feedback::Pulses { range, frames_hz, .. } => {
            let pulse = peripherals.pulse(range)?;
            let taken = now.checked_sub(Duration::from_micros(pulse.age_us.into()))?;
            let period = Duration::from_hz(u64::from(frames_hz).max(1));
            Some(Reading { counts: pulse::counts(pulse, frames_hz)?, taken, period })
        }
        Feedback::Encoder { .. } | Feedback::Potentiometer { .. } => None,
    }
}

/// Steppers of a board; `None` without any.
///
/// # Errors
/// [`BadSteppers`] for a configuration that cannot work.
fn steppers(config: &BoardConfig, peripherals: &mut impl Peripherals) -> Result<Option<Bank>, BadSteppers> {
    let Some(bank) = config.stepper_bank.filter(|_| !config.steppers.is_empty()) else { return Ok(None) };
    let setup_s = bank.direction_setup_us as f32 * 1e-6;
    let timing = DriverTiming {
        direction_setup_s: setup_s,
        direction_hold_s: setup_s,
        enable_setup_s: bank.enable_setup_us as f32 * 1e-6,
        rate_max_hz: bank.rate_max_hz,
    };
    let (low, hold) = (bank.enable_active_low, bank.hold_when_safe);
    Bank::new(&config.steppers, &timing, low, hold, config.control_period_us, peripherals)
        .map(Some)
        .map_err(|_| BadSteppers)
}

/// Error: a stepper cannot work as configured.
struct BadSteppers;
