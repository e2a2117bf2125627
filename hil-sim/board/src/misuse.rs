//! Requests to a chip or the bus that its datasheet forbids or that it silently ignores.
//!
//! Real silicon does not report them: a servo runs at the wrong rate, a bridge loses its gate charge. The models behave
//! as the silicon does and also record it, so that a test can require that there is none.

use core::fmt;

use crate::chips::ili9488::ScreenMisuse;

/// One leg of a full bridge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Leg {
    /// Leg that drives motor terminal A.
    A,
    /// Leg that drives motor terminal B.
    B,
}

impl fmt::Display for Leg {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::A => "A",
            Self::B => "B",
        })
    }
}

/// Kind of misuse. The text (`Display`) says what the real part does and what to do instead.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum MisuseKind {
    /// Access to a register address that the chip does not have.
    UnmappedRegister {
        /// Register address that was sent.
        register: u8,
    },
    /// Write to the reserved test register.
    TestModeWritten {
        /// Value that was sent.
        value: u8,
    },
    /// Write to PRE_SCALE while the chip is awake.
    PrescaleWhileAwake {
        /// Value that was sent.
        value: u8,
        /// Value that stays in force.
        kept: u8,
    },
    /// Write to PRE_SCALE with a value below the hardware minimum.
    PrescaleBelowMinimum {
        /// Value that was sent.
        value: u8,
        /// Value that the chip took.
        taken: u8,
    },
    /// A 1 written to RESTART before the oscillator had time to start.
    RestartTooEarly {
        /// Time since SLEEP was cleared, ns; 0 if it is still set or was cleared by the same write.
        awake_ns: u64,
        /// Time that the datasheet requires, ns.
        needed_ns: u64,
    },
    /// Write to PWM registers while the oscillator is starting.
    OutputsBeforeOscillatorReady {
        /// Time since SLEEP was cleared, ns.
        awake_ns: u64,
        /// Time that the datasheet requires, ns.
        needed_ns: u64,
    },
    /// EXTCLK set while the chip was not asleep.
    ExternalClockWhileAwake,
    /// Wake-up with EXTCLK set, but no clock at the pin.
    ExternalClockMissing,
    /// The same count for switching on and for switching off.
    OnEqualsOff {
        /// Index of the output, 0 to 15.
        channel: u8,
        /// Count that was written to both.
        count: u16,
    },
    /// Full OFF written to part of a channel while outputs change on ACK.
    FullOffNotApplied {
        /// Index of the output, 0 to 15.
        channel: u8,
    },
    /// Several chips that drove the bus in the same read.
    SeveralReaders {
        /// Address that was read from, 7 bits.
        address: u8,
        /// Number of chips that answered.
        chips: usize,
    },
    /// A read of no bytes.
    EmptyRead {
        /// Address that was read from, 7 bits.
        address: u8,
    },
    /// Both inputs of a leg high at the same time, with the high side switched.
    ShootThroughAttempt {
        /// Leg of the bridge.
        leg: Leg,
        /// Duration in counts of the cycle's 4096.
        counts: u16,
    },
    /// A switched high side whose low side never turns on.
    HighSideWithoutRefresh {
        /// Leg of the bridge.
        leg: Leg,
    },
    /// Reversal of direction without both low sides off for a whole PWM period.
    ReversalWithoutDeadTime {
        /// Time for which both had been off, ns.
        off_ns: u64,
        /// Required time, one PWM period, ns.
        needed_ns: u64,
    },
    /// Access to an address between or behind the registers.
    UnimplementedRegister {
        /// Register address that was sent.
        register: u8,
    },
    /// Write to a read-only register.
    ReadOnlyRegister {
        /// Address of the register.
        register: u8,
    },
    /// Read of a port whose pin 7, documented as an output only, is set as an input.
    Pin7ReadAsInput {
        /// Letter of the port.
        port: char,
    },
    /// Command sent while the EEPROM was being written.
    EepromBusy {
        /// First byte of the command.
        command: u8,
        /// Remaining time of the write, ns.
        ready_in_ns: u64,
    },
    /// Loss of supply while the EEPROM was being written.
    EepromWriteInterrupted {
        /// Remaining time of the write, ns.
        ready_in_ns: u64,
    },
    /// Command that ended before its last byte.
    CommandIncomplete {
        /// First byte of the command.
        command: u8,
    },
    /// Byte that starts no command, or follows a complete one.
    UnexpectedByte {
        /// Value of the byte.
        byte: u8,
    },
    /// Command that reads or writes the chip's address bits, without the LDAC edge it requires.
    AddressCommand {
        /// First byte of the command.
        command: u8,
    },
    /// LDAC pulse that is too short.
    LdacPulseTooShort {
        /// Time for which LDAC was low, ns.
        low_ns: u64,
        /// Time that the datasheet requires, ns.
        needed_ns: u64,
    },

    // ---- actuators ----
    /// Motor driven for more of the PWM cycle than its bridge allows.
    DutyAboveLimit {
        /// Duration in counts of the cycle's 4096.
        counts: u16,
        /// Limit in counts of the cycle's 4096.
        limit_counts: u16,
    },
    /// Supply voltage above the rating of the part.
    SupplyAboveLimit {
        /// Voltage of the supply, mV.
        supply_mv: u64,
        /// Rating of the part, mV.
        limit_mv: u64,
    },
    /// Both direction inputs of a bridge high at the same time.
    InputsOverlap {
        /// Duration in counts of the cycle's 4096.
        counts: u16,
    },
    /// Reversal of direction without both inputs low for a whole PWM period.
    ReversalWithoutPause {
        /// Time for which both had been low, or the bridge off, ns.
        idle_ns: u64,
        /// Required time, one PWM period, ns.
        needed_ns: u64,
    },
    /// Servo pulse shorter or longer than the servo accepts.
    ServoPulseOutsideWindow {
        /// Pulse width, ns; the whole frame for a line that is always high.
        pulse_ns: u64,
        /// Shortest accepted width, ns.
        low_ns: u64,
        /// Longest accepted width, ns.
        high_ns: u64,
    },
    /// Servo pulses with a frame that is too short or too long.
    ServoFrameOutsideWindow {
        /// Time from pulse to pulse, ns.
        frame_ns: u64,
        /// Shortest accepted frame, ns.
        low_ns: u64,
        /// Longest accepted frame, ns.
        high_ns: u64,
    },
    /// Servo driven against its mechanical end stop for long.
    ServoHeldAgainstStop {
        /// Duration at the time of the report, ns.
        held_ns: u64,
    },
    /// Throttle voltage that the drive does not tolerate.
    ThrottleOutsideWindow {
        /// Throttle voltage, mV; `None` for NaN.
        throttle_mv: Option<i64>,
        /// Lowest tolerated voltage, mV.
        low_mv: i64,
        /// Highest tolerated voltage, mV.
        high_mv: i64,
    },
    /// Supply of a drive switched on with the throttle outside the dead zone.
    ThrottleBeforeNeutral {
        /// Voltage of the throttle, mV.
        throttle_mv: i64,
    },
    /// Change of direction while a drive is turning.
    DirectionChangedWhileTurning {
        /// Speed at the change, mrad/s.
        speed_mrad_s: i64,
    },
    /// Step input of a stepper driver high or low for too short a time.
    StepPulseTooShort {
        /// True for the high time, false for the low time.
        high: bool,
        /// Duration of the level, ns.
        lasted_ns: u64,
        /// Time that the datasheet requires, ns.
        needed_ns: u64,
    },
    /// Step too soon after a change of direction.
    DirectionSetupTooShort {
        /// Time between the two, ns.
        setup_ns: u64,
        /// Time that the datasheet requires, ns.
        needed_ns: u64,
    },
    /// Change of direction too soon after the edge of a step.
    DirectionHoldTooShort {
        /// Time between the two, ns.
        held_ns: u64,
        /// Time that the datasheet requires, ns.
        needed_ns: u64,
    },
    /// Step too soon after a stepper driver was enabled.
    StepBeforeEnabled {
        /// Time since it was enabled, ns.
        enabled_ns: u64,
        /// Time that the datasheet requires, ns.
        needed_ns: u64,
    },
    /// Step while a stepper driver was disabled or had no supply.
    StepWhileDisabled,
    /// Rotor of a stepper motor that could not follow the steps.
    StepperStalled {
        /// Rate of the steps, steps/s; 0 if they ended too suddenly.
        step_hz: u64,
        /// Speed of the rotor, steps/s.
        rotor_hz: u64,
    },
    // Sensors.
    /// Trigger of an ultrasonic module that is too short.
    TriggerTooShort {
        /// Time for which it was high, ns.
        high_ns: u64,
        /// Time that the data sheet requires, ns.
        needed_ns: u64,
    },
    /// Trigger of an ultrasonic module before its last echo had ended.
    TriggerWhileBusy {
        /// Time until the module is free, ns.
        free_in_ns: u64,
    },
    /// Trigger of an ultrasonic module soon after its last ping.
    PingTooSoon {
        /// Time since the last ping, ns.
        since_ns: u64,
        /// Time that the data sheet requires, ns.
        needed_ns: u64,
    },
    /// Write to an EEPROM of more bytes than a page holds.
    PageOverrun {
        /// Address of the first byte.
        word: u8,
        /// Size of a page, bytes.
        page_bytes: usize,
    },
    /// Write to an EEPROM that ended without STOP.
    WriteWithoutStop {
        /// Number of bytes that were sent.
        bytes: usize,
    },
    /// Violation of the screen controller's datasheet.
    Screen(ScreenMisuse),
}

impl fmt::Display for MisuseKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Screen(misuse) => misuse.fmt(f),
            Self::UnmappedRegister { register } => write!(
                f,
                "register 0x{register:02X} does not exist: the chip does not acknowledge it and ignores the rest of the \
                 transfer; send the address of an existing register first"
            ),
            Self::TestModeWritten { value } => write!(
                f,
                "0x{value:02X} written to the test register: the datasheet calls the result unpredictable; never write it"
            ),
            Self::PrescaleWhileAwake { value, kept } => write!(
                f,
                "PRE_SCALE 0x{value:02X} written while awake: the chip ignores it and keeps 0x{kept:02X}; set \
                 MODE1.SLEEP first"
            ),
            Self::PrescaleBelowMinimum { value, taken } => write!(
                f,
                "PRE_SCALE 0x{value:02X} is below the hardware minimum: the chip takes 0x{taken:02X}; write that or more"
            ),
            Self::RestartTooEarly { awake_ns, needed_ns } => write!(
                f,
                "RESTART written {awake_ns} ns after waking: the oscillator is not running yet, and the channels stay \
                 off; clear MODE1.SLEEP, wait {needed_ns} ns, then write it"
            ),
            Self::OutputsBeforeOscillatorReady { awake_ns, needed_ns } => write!(
                f,
                "PWM registers written {awake_ns} ns after waking: timing of the outputs is not guaranteed; write them \
                 before clearing MODE1.SLEEP, or wait {needed_ns} ns after it"
            ),
            Self::ExternalClockWhileAwake => f.write_str(
                "MODE1.EXTCLK written while awake: the chip ignores it; set SLEEP, then write SLEEP and EXTCLK together",
            ),
            Self::ExternalClockMissing => f.write_str(
                "woken with MODE1.EXTCLK set and no clock on the pin: no output will move; EXTCLK is sticky, so reset \
                 the chip or cycle its power to return to the internal oscillator",
            ),
            Self::OnEqualsOff { channel, count } => write!(
                f,
                "output {channel}: on and off counts are both {count}, which the datasheet forbids: the output stays \
                 off; use the full-ON or full-OFF bit"
            ),
            Self::FullOffNotApplied { channel } => write!(
                f,
                "output {channel}: full OFF written with MODE2.OCH set, but not all four registers of the channel: the \
                 output keeps running; write all four, or clear OCH"
            ),
            Self::SeveralReaders { address, chips } => write!(
                f,
                "{chips} chips answered a read from 0x{address:02X}: the controller sees the AND of their data; read \
                 each chip at its own address"
            ),
            Self::EmptyRead { address } => write!(
                f,
                "read of no bytes from 0x{address:02X}: the chip already drives the first data bit and may hold SDA \
                 low, so that no STOP is possible; read one byte, or probe with an empty write"
            ),
            Self::ShootThroughAttempt { leg, counts } => write!(
                f,
                "leg {leg}: high and low inputs are both high for {counts} of 4096 counts while the high side is \
                 switched: the driver lets the low side win; switch one input of a leg only"
            ),
            Self::HighSideWithoutRefresh { leg } => write!(
                f,
                "leg {leg}: the high side is switched and the low side never turns on: the bootstrap capacitor is not \
                 recharged, and the high FET will leave saturation; turn the low side on in every cycle"
            ),
            Self::ReversalWithoutDeadTime { off_ns, needed_ns } => write!(
                f,
                "direction reversed after both low sides were off for {off_ns} ns: outputs change at period ends only, \
                 so both directions may overlap in one period; hold both low inputs low for {needed_ns} ns or more"
            ),
            Self::UnimplementedRegister { register } => write!(
                f,
                "there is no register at 0x{register:02X}: what is written is lost and reads are not defined; check the \
                 address, and whether IOCON.BANK is what you take it for"
            ),
            Self::ReadOnlyRegister { register } => {
                write!(f, "register 0x{register:02X} is read-only: the chip ignores the write; leave it out")
            }
            Self::Pin7ReadAsInput { port } => write!(
                f,
                "GPIO{port} read with GP{port}7 as an input: an edge on that pin while its bit is sent can corrupt SDA; \
                 use the pin as an output only"
            ),
            Self::EepromBusy { command, ready_in_ns } => write!(
                f,
                "command 0x{command:02X} sent during an EEPROM write: the chip acknowledges and ignores it; read the \
                 RDY/BSY bit until it is 1, here for another {ready_in_ns} ns"
            ),
            Self::EepromWriteInterrupted { ready_in_ns } => write!(
                f,
                "supply lost {ready_in_ns} ns before the end of an EEPROM write: what it holds then is not defined; keep \
                 the supply up until RDY/BSY is 1"
            ),
            Self::CommandIncomplete { command } => write!(
                f,
                "command 0x{command:02X} ended before its last byte: what was incomplete is dropped, and an EEPROM write \
                 does not start; send all bytes"
            ),
            Self::UnexpectedByte { byte } => write!(
                f,
                "0x{byte:02X} starts no command, or follows a complete one: the datasheet does not say what the chip \
                 does; start a new transfer for every command"
            ),
            Self::AddressCommand { command } => write!(
                f,
                "address command 0x{command:02X}: without a falling edge of LDAC in the 8th clock of this byte, which is \
                 not simulated, the chip does not acknowledge what follows; program the address before assembly"
            ),
            Self::LdacPulseTooShort { low_ns, needed_ns } => write!(
                f,
                "LDAC low for {low_ns} ns: the outputs may not change; hold it low for {needed_ns} ns or more"
            ),

            // ---- actuators ----
            Self::DutyAboveLimit { counts, limit_counts } => write!(
                f,
                "motor driven for {counts} of 4096 counts: the bridge's vendor forbids it and does not say what happens; \
                 drive for {limit_counts} counts or fewer"
            ),
            Self::SupplyAboveLimit { supply_mv, limit_mv } => write!(
                f,
                "supply of {supply_mv} mV: the part is rated for {limit_mv} mV and may be destroyed; here it turns off; \
                 lower the supply or use another part"
            ),
            Self::InputsOverlap { counts } => write!(
                f,
                "IN1 and IN2 both high for {counts} of 4096 counts: taken for a brake, which the vendor has not tested; \
                 hold one of them low"
            ),
            Self::ReversalWithoutPause { idle_ns, needed_ns } => write!(
                f,
                "direction reversed after both inputs were low for {idle_ns} ns: inputs change at period ends only, so \
                 both directions may overlap in one period; hold both low for {needed_ns} ns or more"
            ),
            Self::ServoPulseOutsideWindow { pulse_ns, low_ns, high_ns } => write!(
                f,
                "pulse of {pulse_ns} ns: the servo takes it for noise and goes limp; send pulses of {low_ns} to {high_ns} \
                 ns, or none"
            ),
            Self::ServoFrameOutsideWindow { frame_ns, low_ns, high_ns } => write!(
                f,
                "pulses every {frame_ns} ns: the servo does not follow them and goes limp; send one every {low_ns} to \
                 {high_ns} ns"
            ),
            Self::ServoHeldAgainstStop { held_ns } => write!(
                f,
                "driven against its end stop for {held_ns} ns: the motor is stalled and heats up, gears may strip; keep \
                 the pulse between those of the two stops"
            ),
            Self::ThrottleOutsideWindow { throttle_mv, low_mv, high_mv } => {
                f.write_str("throttle at ")?;
                match throttle_mv {
                    Some(throttle_mv) => write!(f, "{throttle_mv} mV")?,
                    None => f.write_str("no voltage at all")?,
                }
                write!(
                    f,
                    ": the drive stops and may be damaged; keep it between {low_mv} and {high_mv} mV, and return to the \
                     dead zone to run again"
                )
            }
            Self::ThrottleBeforeNeutral { throttle_mv } => write!(
                f,
                "supply came with the throttle at {throttle_mv} mV: the drive refuses to run; go to the dead zone first"
            ),
            Self::DirectionChangedWhileTurning { speed_mrad_s } => write!(
                f,
                "direction changed while turning at {speed_mrad_s} mrad/s: the drive coasts to a standstill before it \
                 obeys; stop, then change direction"
            ),
            Self::StepPulseTooShort { high, lasted_ns, needed_ns } => write!(
                f,
                "step input {} for {lasted_ns} ns: the driver may miss the step, here it does; hold it for {needed_ns} ns \
                 or more",
                if high { "high" } else { "low" }
            ),
            Self::DirectionSetupTooShort { setup_ns, needed_ns } => write!(
                f,
                "step {setup_ns} ns after the direction changed: it may go either way or be missed, here it is missed; \
                 wait {needed_ns} ns or more"
            ),
            Self::DirectionHoldTooShort { held_ns, needed_ns } => write!(
                f,
                "direction changed {held_ns} ns after a step: the step may go either way or be missed, here it is \
                 missed; wait {needed_ns} ns or more"
            ),
            Self::StepBeforeEnabled { enabled_ns, needed_ns } => write!(
                f,
                "step {enabled_ns} ns after the driver was enabled: it is missed; wait {needed_ns} ns or more"
            ),
            Self::StepWhileDisabled => {
                f.write_str("step while the driver is disabled or without supply: it is missed; enable the driver first")
            }
            Self::StepperStalled { step_hz, rotor_hz } => write!(
                f,
                "steps at {step_hz} Hz while the rotor turns at {rotor_hz} Hz: it falls out of step and stands until the \
                 steps pause; start and stop slower, or accelerate less"
            ),
            // Sensors.
            Self::TriggerTooShort { high_ns, needed_ns } => write!(
                f,
                "trigger high for {high_ns} ns: the module ignores it; hold it high for {needed_ns} ns or more"
            ),
            Self::TriggerWhileBusy { free_in_ns } => write!(
                f,
                "triggered before the last echo had ended: the module ignores it; wait for the echo to fall, here for \
                 another {free_in_ns} ns"
            ),
            Self::PingTooSoon { since_ns, needed_ns } => write!(
                f,
                "triggered {since_ns} ns after the last ping: late echoes of that one may be taken for near targets; \
                 leave {needed_ns} ns between pings"
            ),
            Self::PageOverrun { word, page_bytes } => write!(
                f,
                "write from 0x{word:02X} with more than {page_bytes} bytes: the chip goes on at the start of the page \
                 and overwrites what was sent first; start a new write for every page"
            ),
            Self::WriteWithoutStop { bytes } => write!(
                f,
                "{bytes} bytes sent without STOP after them: the chip drops them; end every write with STOP"
            ),
        }
    }
}

/// One misuse: its time, the part, and its kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Misuse {
    /// Virtual time of the misuse, ns.
    pub time_ns: u64,
    /// Kind of part, for example `"PCA9685"`.
    pub chip: &'static str,
    /// Seven-bit I2C address of the part; for a part without one, its number on the board.
    pub address: u8,
    /// Kind of misuse with its values.
    pub kind: MisuseKind,
}

impl fmt::Display for Misuse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ns, {} 0x{:02X}: {}", self.time_ns, self.chip, self.address, self.kind)
    }
}

/// Number of misuses, and the first of them. Allocates nothing until there is one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MisuseLog {
    total: u64,
    first: Vec<Misuse>,
}

impl MisuseLog {
    /// Number of misuses that are kept; the rest are only counted.
    pub const KEPT: usize = 64;

    /// An empty log, without allocation.
    #[must_use]
    pub const fn new() -> Self {
        Self { total: 0, first: Vec::new() }
    }

    /// Counts a misuse, and keeps it while there is room.
    #[cold]
    pub fn report(&mut self, misuse: Misuse) {
        self.total = self.total.saturating_add(1);
        if self.first.len() < Self::KEPT {
            self.first.push(misuse);
        }
    }

    /// Number of all misuses, kept or not.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.total
    }

    /// Kept misuses, oldest first.
    #[must_use]
    pub fn first(&self) -> &[Misuse] {
        &self.first
    }

    /// True if there was no misuse.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.total == 0
    }

    /// Resets the log to empty.
    pub fn clear(&mut self) {
        self.total = 0;
        self.first.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_all_and_keeps_the_first() {
        let mut log = MisuseLog::new();
        for time_ns in 0..100 {
            let kind = MisuseKind::TestModeWritten { value: 1 };
            log.report(Misuse { time_ns, chip: "PCA9685", address: 0x40, kind });
        }
        assert_eq!(log.total(), 100);
        assert_eq!(log.first().len(), MisuseLog::KEPT);
        assert_eq!(log.first()[63].time_ns, 63);
        log.clear();
        assert!(log.is_empty() && log.first().is_empty());
    }

    #[test]
    fn text_names_time_part_and_remedy() {
        let kind = MisuseKind::PrescaleWhileAwake { value: 0x79, kept: 0x1E };
        let text = Misuse { time_ns: 12, chip: "PCA9685", address: 0x42, kind }.to_string();
        assert_eq!(
            text,
            "12 ns, PCA9685 0x42: PRE_SCALE 0x79 written while awake: the chip ignores it and keeps 0x1E; set \
             MODE1.SLEEP first"
        );
    }
}
