//! The board's outputs on I2C: order of writes and safe state. Sensors get the bus time that remains.

pub mod bldc;
pub mod bridge;
mod expander;
pub mod servo;
mod slew;

#[cfg(test)]
mod tests;

use core::task::Context;

use embassy_time::{Duration, Instant};
use heapless::Vec;
use r4_protocol::config::{
    BoardConfig, BridgeConfig, DAC_FULL_SCALE_V, DacConfig, MAX_MOTORS, MAX_SERVOS, MotorConfig, PwmConfig,
    bus_bits as bits,
};

pub use crate::bus::OutputFault;
use crate::{
    bus::Scheduler,
    chips::{
        ChipError,
        mcp4728::{Mcp4728, OUTPUTS as DAC_OUTPUTS},
        pca9685::Pca9685,
    },
    platform::{AnalogOutputs, Bus, Write},
};
use bldc::{Bldcs, Command};
use bridge::{Bridge, Plan, Planned};
use expander::Expander;
use servo::{Pulse, Servos};
use slew::towards;

/// Writes of one control period: one for each motor and each servo, and one for the brushless drives. Further writes
/// wait.
const QUEUE: usize = 32;
/// Counts of a PWM period, over which the phases of a chip's bridges are spread.
const PHASES: usize = 4096;
/// Maximum backlog of servo writes, in control periods.
const SERVO_PERIODS_DUE: usize = 8;
/// Bus time to write the expander, bits.
const EXPANDER_BITS: u32 = bits(4);
/// Maximum bus time of one read-back, bits: mode and prescaler of a PWM chip, each with two addresses and a register.
const CHECK_BITS: u32 = bits(5) + bits(4);

/// Brushless drives and their DAC.
struct Drives {
    chip: Mcp4728,
    rules: Bldcs,
    /// Codes last written to the outputs; `None` when unknown.
    written: Option<[u16; DAC_OUTPUTS]>,
}

impl Drives {
    fn of(config: &BoardConfig) -> Option<Self> {
        let dac = config.bldc_dac?;
        Some(Self { chip: Mcp4728::new(dac.address), rules: Bldcs::new(&config.bldcs, dac), written: None })
    }
}

/// Change that one write of the queue makes once it has been sent.
#[derive(Clone, Copy, Debug)]
enum Change {
    /// Lines of the bridge with this index.
    Bridge(usize, Planned),
    /// Codes of the brushless drives' voltages.
    Drives([u16; DAC_OUTPUTS]),
    /// Pulse of one servo.
    Servo(Pulse),
}

/// Writes of one flush.
#[derive(Debug, Default)]
struct Queue {
    writes: Vec<Write, QUEUE>,
    /// Change that each of the writes makes.
    changes: Vec<Change, QUEUE>,
    /// One bit for each servo that has a write here.
    servos: u32,
}

const _: () = assert!(MAX_SERVOS <= u32::BITS as usize, "a bit for each servo");

impl Queue {
    /// Adds a write; the caller has checked [`Queue::has_room`].
    fn push(&mut self, write: Write, change: Change) {
        if self.writes.push(write).is_ok() {
            let _ = self.changes.push(change);
        }
    }

    fn has_room(&self) -> bool {
        !self.writes.is_full()
    }

    /// Adds the write of a servo's pulse; the caller has checked [`Queue::has_room`].
    fn push_servo(&mut self, write: Write, pulse: Pulse) {
        self.servos |= 1 << pulse.index();
        self.push(write, Change::Servo(pulse));
    }

    /// Returns true if the servo of this pulse has a write here.
    const fn has_servo(&self, pulse: &Pulse) -> bool {
        self.servos >> pulse.index() & 1 != 0
    }

    fn forget(&mut self) {
        self.writes.clear();
        self.changes.clear();
        self.servos = 0;
    }
}

/// PWM chips behind bridges, OSMC first.
fn bridge_chips(config: &BoardConfig) -> [Option<Pca9685>; 2] {
    [config.osmc_pwm, config.dhb_pwm].map(|pwm| pwm.map(|pwm: PwmConfig| Pca9685::new(pwm.address, pwm.frequency_hz)))
}

/// Writes the safe state to every output chip of a board that has just been reset, before anything else: opens the
/// relays, applies the brakes, takes brushless drives to neutral, turns bridges off and ends the servos' pulses, unless
/// those are held when safe.
///
/// The chips kept their outputs over the processor's reset, or have just been powered: every register that the safe
/// state needs is written, whatever state they are in. Only the direction lines of brushless drives, which stay as they
/// are, are read back; [`Outputs::init`] reads the rest later. A chip that does not answer is skipped after three
/// tries. Reads no clock, so it can run before there is one; `config` must be valid. On a bus of 400 kHz it takes 1.5
/// ms.
///
/// # Errors
/// The first [`OutputFault`], after all chips were tried.
pub async fn sweep<B: Bus>(bus: B, config: &BoardConfig) -> Result<(), OutputFault> {
    let mut bus = Scheduler::new(bus, config);
    let mut drives = Drives::of(config);
    let mut result = Ok(());
    if let Some(expander) = config.expander {
        let mut expander = Expander::new(expander, config.relays.clone());
        result = sweep_expander(&mut bus, &mut expander, drives.as_mut()).await;
    }
    if let Some(drives) = &mut drives {
        let codes = drives.rules.make_safe().codes;
        let neutral = bus.checked(async |bus: &mut B| Ok(drives.chip.force(bus, codes).await?)).await;
        result = result.and(neutral);
    }
    for chip in bridge_chips(config).into_iter().flatten() {
        let off = bus.checked(async |bus: &mut B| Ok(chip.force_off(bus).await?)).await;
        result = result.and(off);
    }
    if let Some(chip) = config.servo_pwm {
        let mut servos = Servos::new(chip, &config.servos);
        let limp = bus.checked(async |bus: &mut B| Ok(servos.force_safe(bus).await?)).await;
        result = result.and(limp);
    }
    result
}

async fn sweep_expander<B: Bus>(
    bus: &mut Scheduler<B>,
    expander: &mut Expander,
    drives: Option<&mut Drives>,
) -> Result<(), OutputFault> {
    if let Some(drives) = drives {
        let driven = bus.checked(async |bus: &mut B| Ok(expander.driven(bus).await?)).await?;
        driven.into_iter().for_each(|levels| drives.rules.resume(levels));
        expander.set_lines(drives.rules.make_safe().levels);
    }
    bus.checked(async |bus: &mut B| Ok(expander.force(bus).await?)).await
}

/// Sets the processor's own analog outputs to their safe voltages.
pub fn rest_dacs(config: &BoardConfig, outputs: &mut impl AnalogOutputs) {
    config.dacs.iter().for_each(|dac: &DacConfig| outputs.set(dac.id.index, dac_code(dac.safe_v)));
}

/// Returns the nearest code of the processor's own DAC for a voltage.
pub(crate) fn dac_code(volts: f32) -> u16 {
    (libm::roundf(volts / DAC_FULL_SCALE_V * 4096.0) as u16).min(4095)
}

/// All outputs of one board on I2C.
pub struct Outputs<B> {
    bus: Scheduler<B>,
    osmc: Option<Pca9685>,
    dhb: Option<Pca9685>,
    bridges: Vec<Bridge, MAX_MOTORS>,
    /// Bit masks of the bridges that are an OSMC, and of those that are a DHB.
    sets: [u32; 2],
    /// Rate at which a stop ramps down each motor's duty before switching it off, 1/s; `None` for motors that are
    /// switched off at once.
    braked: Vec<Option<f32>, MAX_MOTORS>,
    /// First OSMC and first DHB that had to wait for the next period.
    waiting: [Option<usize>; 2],
    expander: Option<Expander>,
    drives: Option<Drives>,
    servos: Option<Servos>,
    /// Number of servo writes per period; and the number now due, with those that had to wait.
    servos_in_turn: usize,
    servos_due: usize,
    /// Writes of this period that have not been sent.
    queue: Queue,
    period_s: f32,
    /// Number of read-back checks, and the next one in turn.
    checks: usize,
    next_check: usize,
}

impl<B: Bus> Outputs<B> {
    /// Creates the outputs as `config` wires them; without any if it is not valid. Call [`Outputs::init`] before
    /// anything else.
    #[must_use]
    pub fn new(bus: B, config: &BoardConfig) -> Self {
        let [osmc, dhb] = bridge_chips(config);
        let valid = config.validate().is_ok();
        let braked = config.motors.iter().filter(|_| valid);
        let braked = braked.map(|motor| (motor.stop_brake_ms > 0).then_some(motor.duty_slew_per_s));
        let motors = config.motors.iter().filter(|_| valid);
        let on_osmc = |motor: &MotorConfig| matches!(motor.bridge, BridgeConfig::Osmc(_));
        let bridges = motors.enumerate().map(|(index, motor)| {
            let chip = if on_osmc(motor) { osmc } else { dhb };
            // Spread evenly over the PWM period of their chip; the two chips have clocks of their own.
            let same_chip = |other: &&MotorConfig| on_osmc(other) == on_osmc(motor);
            let count = config.motors.iter().filter(same_chip).count();
            let before = config.motors.iter().take(index).filter(same_chip).count();
            let phase = (PHASES * before / count) as u16;
            // A change takes effect at the end of the running PWM period; then a whole one must pass with the bridge at
            // rest.
            let reversal = chip.map_or(Duration::MIN, |chip| 2 * chip.period());
            Bridge::new(motor.bridge, motor.inverted, phase, reversal)
        });
        let expander = config.expander.filter(|_| valid);
        let period_s = config.control_period_us as f32 * 1e-6;
        let drives = Drives::of(config).filter(|_| valid);
        let servos = config.servo_pwm.filter(|_| valid).map(|chip| Servos::new(chip, &config.servos));
        let bridges: Vec<Bridge, MAX_MOTORS> = bridges.collect();
        let set = |osmc| bridges.iter().rev().fold(0, |set, bridge| set << 1 | u32::from(bridge.is_osmc() == osmc));
        let lines = bridges.iter().map(Bridge::line_count).sum::<usize>();
        let servo_checks = servos.as_ref().map_or(0, |servos| 1 + servos.count());
        Self {
            bus: Scheduler::new(bus, config),
            checks: 1 + osmc.iter().chain(&dhb).count() + lines + servo_checks,
            sets: [set(true), set(false)],
            bridges,
            braked: braked.collect(),
            waiting: [None; 2],
            osmc,
            dhb,
            expander: expander.map(|expander| Expander::new(expander, config.relays.clone())),
            drives,
            servos_in_turn: servos.as_ref().map_or(0, |servos| servos.writes_per_period(period_s)),
            servos,
            servos_due: 0,
            queue: Queue::default(),
            period_s,
            next_check: 0,
        }
    }

    /// Brings every output chip from any state into a known one with all outputs off. Never call it while armed: a DAC
    /// delivered with another start-up voltage gets its EEPROM written, and ignores all commands meanwhile, up to 50
    /// ms.
    ///
    /// # Errors
    /// [`OutputFault`]; outputs may then be in any state the chips were in.
    pub async fn init(&mut self) -> Result<(), OutputFault> {
        self.forget_queue();
        if let (Some(expander), Some(drives)) = (&self.expander, &mut self.drives) {
            // Motors may still turn from before the reset of the processor, so the direction lines stay as they are.
            let driven = self.bus.checked(async |bus: &mut B| Ok(expander.driven(bus).await?)).await?;
            driven.into_iter().for_each(|levels| drives.rules.resume(levels));
        }
        // The motors' supply relay and the brakes come first; then drives go to neutral.
        self.expander_safe(async |expander: &mut Expander, bus: &mut B| expander.init(bus).await).await?;
        if let Some(drives) = &mut self.drives {
            let codes = drives.rules.make_safe().codes;
            drives.written = None;
            self.bus.checked(async |bus: &mut B| drives.chip.init(bus, codes).await).await?;
            drives.written = Some(codes);
        }
        for chip in self.bridge_chips() {
            self.bus.checked(async |bus: &mut B| chip.init(bus).await).await?;
        }
        self.bridges.iter_mut().for_each(Bridge::now_off);
        match &mut self.servos {
            Some(servos) => self.bus.checked(async |bus: &mut B| servos.init(bus).await).await,
            None => Ok(()),
        }
    }

    /// Opens every relay, the motors' supply included, applies brakes, then turns every motor output off, in whatever
    /// state.
    ///
    /// # Errors
    /// [`OutputFault::Bus`], after all were tried; the lines of [`crate::supervisor::SafetyPins`] still hold the bridges.
    pub async fn make_safe(&mut self) -> Result<(), OutputFault> {
        self.forget_queue();
        let mut result =
            self.expander_safe(async |expander: &mut Expander, bus: &mut B| Ok(expander.rewrite(bus).await?)).await;
        for chip in self.bridge_chips() {
            let off = self.bus.checked(async |bus: &mut B| Ok(chip.all_off(bus).await?)).await;
            result = result.and(off);
        }
        if result.is_ok() {
            self.bridges.iter_mut().for_each(Bridge::now_off);
        }
        result.and(self.neutral_and_servos_safe().await)
    }

    /// Begins a stop that keeps the motors' supply on: takes brushless drives to neutral and brakes them, opens every
    /// relay but the motors'. Takes less than a control period, so that step pulses continue on time;
    /// [`Outputs::step_brakes`] does the rest, and [`Outputs::make_safe`] must follow.
    ///
    /// # Errors
    /// [`OutputFault::Bus`], after all were tried.
    pub async fn brake(&mut self) -> Result<(), OutputFault> {
        self.forget_queue();
        let mut result = Ok(());
        if let Some(expander) = &mut self.expander {
            expander.open_general();
            if let Some(drives) = &mut self.drives {
                expander.set_lines(drives.rules.make_safe().levels);
            }
            result = self.bus.checked(async |bus: &mut B| Ok(expander.rewrite(bus).await?)).await;
        }
        result.and(self.neutral_and_servos_safe().await)
    }

    /// Advances a braking stop by one period: turns non-braking bridges off, as many as fit the period, then steps the
    /// others' ramps to duty 0, at which a bridge shorts its motor. The slew limit of each motor holds here too.
    /// Returns true once all non-braking bridges are off.
    ///
    /// # Errors
    /// [`OutputFault::Bus`], after all were tried.
    pub async fn step_brakes(&mut self) -> Result<bool, OutputFault> {
        let mut result = Ok(true);
        for index in 0..self.bridges.len() {
            let bridge = &self.bridges[index];
            let off_bits = bits(2 + 4 * bridge.line_count() as u32);
            let Some(chip) = self.chip_of(bridge) else { continue };
            if !bridge.is_on() || self.braked[index].is_some() {
                continue;
            }
            if !self.bus.fits(off_bits) {
                result = result.and(Ok(false));
                continue;
            }
            let bridge = &mut self.bridges[index];
            let off = self.bus.checked(async |bus: &mut B| Ok(bridge.off(&chip, bus).await?)).await;
            result = off.and(result);
        }
        for index in 0..self.bridges.len() {
            let Some(slew_per_s) = self.braked[index] else { continue };
            let duty = towards(self.bridges[index].applied(), 0.0, slew_per_s * self.period_s);
            if self.bridges[index].is_on() {
                self.drive(index, duty);
            }
        }
        self.flush(|_| false).await.and(result)
    }

    /// Takes brushless drives to neutral, whatever their command, and servos to their safe state.
    async fn neutral_and_servos_safe(&mut self) -> Result<(), OutputFault> {
        let mut result = Ok(());
        if let Some(drives) = &mut self.drives {
            let codes = drives.rules.make_safe().codes;
            let neutral = self.bus.checked(async |bus: &mut B| Ok(drives.chip.set(bus, codes, None).await?)).await;
            drives.written = neutral.is_ok().then_some(codes);
            result = neutral;
        }
        if let Some(servos) = &mut self.servos {
            let limp = self.bus.checked(async |bus: &mut B| Ok(servos.make_safe(bus).await?)).await;
            result = result.and(limp);
        }
        result
    }

    /// PWM chips behind bridges, OSMC first.
    fn bridge_chips(&self) -> impl Iterator<Item = Pca9685> + use<B> {
        self.osmc.into_iter().chain(self.dhb)
    }

    /// Opens all relays, applies all brakes and calls `write` to update the chip.
    async fn expander_safe(
        &mut self,
        mut write: impl AsyncFnMut(&mut Expander, &mut B) -> Result<(), ChipError<B::Error>>,
    ) -> Result<(), OutputFault> {
        let Some(expander) = &mut self.expander else { return Ok(()) };
        expander.open_all();
        if let Some(drives) = &mut self.drives {
            expander.set_lines(drives.rules.make_safe().levels);
        }
        self.bus.checked(async |bus: &mut B| write(expander, bus).await).await
    }

    /// Begins a control period: the bus has its full time again.
    pub fn begin_tick(&mut self) {
        self.forget_queue();
        self.bus.begin_period();
    }

    /// Bus scheduler, for sensors.
    pub(crate) fn bus(&mut self) -> &mut Scheduler<B> {
        &mut self.bus
    }

    /// Sends the writes that [`Outputs::drive`], [`Outputs::write_drives`] and [`Outputs::write_servos`] have queued in
    /// this period, in that order. When `stops` asks for it ([`Bus::write_all`]), the unsent rest is discarded: those
    /// outputs are then as before. Returns true if everything was sent.
    ///
    /// # Errors
    /// [`OutputFault::Bus`]; the output whose write failed may then be in either state, those behind it are as before.
    pub async fn flush(&mut self, stops: impl FnMut(&mut Context<'_>) -> bool) -> Result<bool, OutputFault> {
        let (sent, result) = self.bus.send(&self.queue.writes, stops).await;
        let complete = sent == self.queue.writes.len();
        // Each write ended before the following ones took the bus: at least nine bits for each byte.
        let mut ended = Instant::now();
        for (write, change) in self.queue.writes.iter().zip(&self.queue.changes).take(sent).rev() {
            match *change {
                Change::Bridge(index, planned) => self.bridges[index].sent(planned, ended),
                Change::Drives(codes) => self.drives.iter_mut().for_each(|drives| drives.written = Some(codes)),
                Change::Servo(pulse) => self.servos.iter_mut().for_each(|servos| servos.sent(pulse)),
            }
            let took = self.bus.byte_time() * (1 + write.bytes().len() as u32);
            ended = ended.checked_sub(took).unwrap_or(ended);
        }
        self.forget_queue();
        result.map(|()| complete)
    }

    fn forget_queue(&mut self) {
        self.queue.forget();
    }

    /// Returns true if the motors' supply goes over a relay.
    #[must_use]
    pub fn has_motor_power_relay(&self) -> bool {
        self.expander.as_ref().is_some_and(Expander::has_motor_power)
    }

    /// Closes the relay of the motors' supply, with the next [`Outputs::write_expander`].
    pub fn close_motor_power(&mut self) {
        self.expander.iter_mut().for_each(Expander::close_motor_power);
    }

    /// Closes or opens relay number `index` of the configuration, with the next [`Outputs::write_expander`].
    pub fn switch(&mut self, index: usize, closed: bool) {
        self.expander.iter_mut().for_each(|expander| expander.switch(index, closed));
    }

    /// Commanded state of each relay, true for closed, in the order of the configuration.
    pub fn closed_relays(&self) -> impl Iterator<Item = bool> + '_ {
        self.expander.iter().flat_map(Expander::closed)
    }

    /// Writes the expander if anything has changed.
    ///
    /// # Errors
    /// [`OutputFault::Bus`]; its pins may then be in either state.
    pub async fn write_expander(&mut self) -> Result<(), OutputFault> {
        if !self.expander.as_ref().is_some_and(Expander::has_changed) {
            return Ok(());
        }
        // The result is ignored: this write comes first in every period and always fits.
        self.bus.fits(EXPANDER_BITS);
        let Some(expander) = &mut self.expander else { return Ok(()) };
        self.bus.checked(async |bus: &mut B| Ok(expander.rewrite(bus).await?)).await
    }

    /// Plans `duty` for bridge `index`, within its rules, for the next [`Outputs::flush`], and returns the duty that
    /// the bridge then has. A write that does not fit this period on the bus waits for the next.
    pub fn drive(&mut self, index: usize, duty: f32) -> f32 {
        let Some(chip) = self.chip_of(&self.bridges[index]) else { return 0.0 };
        match self.bridges[index].plan(&chip, duty) {
            Plan::Keep(applied) => applied,
            Plan::Send(write, planned) if self.reserve(&write) => {
                self.queue.push(write, Change::Bridge(index, planned));
                planned.applied()
            }
            Plan::Send(..) => {
                self.waiting[usize::from(!self.bridges[index].is_osmc())].get_or_insert(index);
                self.bridges[index].applied()
            }
        }
    }

    /// Reserves the bus time of `write` in this period; false when it has to wait.
    fn reserve(&mut self, write: &Write) -> bool {
        self.queue.has_room() && self.bus.fits(bits(1 + write.bytes().len() as u32))
    }

    /// Order in which to write the bridges in this period: OSMC first, then DHB, each group beginning with the first
    /// that had to wait in the last period.
    pub fn order(&mut self) -> [Order; 2] {
        let firsts = core::mem::take(&mut self.waiting);
        core::array::from_fn(|kind| Order { left: self.sets[kind], first: firsts[kind].unwrap_or(0) })
    }

    /// Sets the command of brushless drive number `index` of the configuration, effective from the next
    /// [`Outputs::step_drives`] on.
    pub fn command_drive(&mut self, index: usize, command: Command) {
        self.drives.iter_mut().for_each(|drives| drives.rules.command(index, command));
    }

    /// Advances the brushless drives' rules by one period. Their lines are written by [`Outputs::write_expander`],
    /// their voltages by [`Outputs::write_drives`].
    pub fn step_drives(&mut self) {
        let Some(drives) = &mut self.drives else { return };
        let levels = drives.rules.step(self.period_s).levels;
        self.expander.iter_mut().for_each(|expander| expander.set_lines(levels));
    }

    /// Queues changed voltages of the DAC for the next [`Outputs::flush`], if they fit this period.
    pub fn write_drives(&mut self) {
        let Some(drives) = &self.drives else { return };
        let codes = drives.rules.wanted().codes;
        let Some(write) = drives.chip.change(codes, drives.written) else { return };
        if self.reserve(&write) {
            // Unknown until the write has been sent: the DAC may hold the old or the new codes.
            self.drives.iter_mut().for_each(|drives| drives.written = None);
            self.queue.push(write, Change::Drives(codes));
        }
    }

    /// Share of full speed commanded of each brushless drive, -1..=1, in the order of the configuration.
    pub fn drive_shares(&self) -> impl Iterator<Item = f32> + '_ {
        self.drives.iter().flat_map(|drives| drives.rules.shares())
    }

    /// Sends servo number `index` of the configuration to `angle`, rad.
    pub fn command_servo(&mut self, index: usize, angle: f32) {
        self.servos.iter_mut().for_each(|servos| servos.command(index, angle));
    }

    /// Advances the servos' rules by one period; [`Outputs::write_servos`] writes them.
    pub fn step_servos(&mut self) {
        self.servos.iter_mut().for_each(|servos| servos.step(self.period_s));
    }

    /// Queues the servos whose turn it is and that fit this period for the next [`Outputs::flush`], each once, and up
    /// to as many again of those that had to wait.
    pub fn write_servos(&mut self) {
        let in_turn = self.servos_in_turn;
        self.servos_due = (self.servos_due + in_turn).min(SERVO_PERIODS_DUE * in_turn);
        for _ in 0..self.servos_due.min(2 * in_turn) {
            if !self.queue.has_room() || self.bus.bits_left() < bits(Servos::WRITE_BYTES) {
                break;
            }
            let next = self.servos.as_mut().and_then(Servos::next_write);
            let Some((write, pulse)) = next.filter(|(_, pulse)| !self.queue.has_servo(pulse)) else {
                self.servos_due = 0;
                break;
            };
            self.servos_due -= 1;
            self.bus.fits(bits(Servos::WRITE_BYTES));
            self.queue.push_servo(write, pulse);
        }
    }

    /// Commanded angle of each servo, rad, in the order of the configuration; NaN without pulses.
    pub fn servo_angles(&self) -> impl Iterator<Item = f32> + '_ {
        self.servos.iter().flat_map(Servos::angles).map(|angle| angle.unwrap_or(f32::NAN))
    }

    fn chip_of(&self, bridge: &Bridge) -> Option<Pca9685> {
        if bridge.is_osmc() { self.osmc } else { self.dhb }
    }

    /// Reserves bus time for one [`Outputs::check_next`] in this period; false when that does not fit and must wait.
    pub fn reserve_check(&mut self) -> bool {
        self.bus.fits(CHECK_BITS)
    }

    /// Reads back and compares the next register set of expander and PWM chips in turn. Call it only after
    /// [`Outputs::flush`], and where [`Outputs::reserve_check`] allows it.
    ///
    /// # Errors
    /// [`OutputFault`] for a failed transfer or a register that does not hold what was written.
    pub async fn check_next(&mut self) -> Result<(), OutputFault> {
        let mut step = self.next_check;
        self.next_check = (step + 1) % self.checks;
        if step == 0 {
            let Some(expander) = &self.expander else { return Ok(()) };
            return self.bus.checked(async |bus: &mut B| expander.verify(bus).await).await;
        }
        step -= 1;
        for chip in self.bridge_chips() {
            if step == 0 {
                return self.bus.checked(async |bus: &mut B| chip.verify_mode(bus).await).await;
            }
            step -= 1;
        }
        for bridge in &self.bridges {
            if let (Some(chip), true) = (self.chip_of(bridge), step < bridge.line_count()) {
                return self.bus.checked(async |bus: &mut B| bridge.verify(&chip, bus, step).await).await;
            }
            step -= bridge.line_count().min(step);
        }
        let Some(servos) = &self.servos else { return Ok(()) };
        match step.checked_sub(1) {
            None => self.bus.checked(async |bus: &mut B| servos.verify_mode(bus).await).await,
            Some(index) => self.bus.checked(async |bus: &mut B| servos.verify(bus, index).await).await,
        }
    }

    /// Reads the DAC back and compares. A stop must not wait that long, so it is only for a safe board; while armed,
    /// each changed voltage is acknowledged on the bus.
    ///
    /// # Errors
    /// [`OutputFault`] for a failed transfer or a register that does not hold what was written.
    pub async fn check_drives(&mut self) -> Result<(), OutputFault> {
        match &self.drives {
            Some(Drives { chip, written: Some(codes), .. }) => {
                self.bus.checked(async |bus: &mut B| chip.verify(bus, codes).await).await
            }
            _ => Ok(()),
        }
    }

    /// Number of repeated transfers since the last call.
    pub fn take_retries(&mut self) -> u32 {
        self.bus.take_retries()
    }
}

/// Iterator over bridge indices, from one of them on and then those before it.
#[derive(Clone, Debug)]
pub struct Order {
    /// One bit for each remaining bridge.
    left: u32,
    first: usize,
}

const _: () = assert!(MAX_MOTORS <= u32::BITS as usize, "a bit for each bridge");

impl Iterator for Order {
    type Item = usize;

    fn next(&mut self) -> Option<usize> {
        if self.left == 0 {
            return None;
        }
        let later = self.left >> self.first << self.first;
        let next = if later == 0 { self.left } else { later }.trailing_zeros();
        self.left ^= 1 << next;
        Some(next as usize)
    }
}
