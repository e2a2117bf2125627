//! DMAMUX: routing of requests to channels, events after a number of requests, and requests generated from triggers
//! (RM0399, DMAMUX).

use crate::context::Context;
use crate::peripheral::Unmodelled;

/// Properties of an instance (RM0399, DMAMUX implementation).
#[derive(Debug)]
pub(super) struct Kind {
    pub(super) name: &'static str,
    /// Width masks of the fields SYNC_ID and SIG_ID.
    sync_id: u32,
    signal_id: u32,
    /// Returns true for requests that stay pending until they are served.
    is_pulse: fn(u8) -> bool,
    /// Trigger and synchronization input that a channel's event output is wired to.
    event_trigger: fn(usize) -> Option<u8>,
    event_sync: fn(usize) -> Option<u8>,
    overrun_irq: u16,
}

pub(super) static DMAMUX1: Kind = Kind {
    name: "DMAMUX1",
    sync_id: 7,
    signal_id: 7,
    // Pulses come from timers 1 to 8, DAC1 and timers 15 to 17 (RM0399, DMAMUX1, request inputs).
    is_pulse: |request| matches!(request, 11..=32 | 47..=53 | 55..=60 | 67..=70 | 105..=112),
    event_trigger: |channel| (channel < 3).then_some(channel as u8),
    event_sync: |channel| (channel < 3).then_some(channel as u8),
    overrun_irq: 102,
};

pub(super) static DMAMUX2: Kind = Kind {
    name: "DMAMUX2",
    sync_id: 0x1f,
    signal_id: 0x1f,
    is_pulse: |_| false,
    event_trigger: |channel| (channel < 7).then_some(channel as u8),
    event_sync: |channel| (channel < 6).then_some(channel as u8),
    overrun_irq: 128,
};

const GENERATORS: usize = 8;
const SOIE: u32 = 1 << 8;
const EGE: u32 = 1 << 9;
const SE: u32 = 1 << 16;
const OIE: u32 = 1 << 8;
const GE: u32 = 1 << 16;

/// Request lines of peripherals, by their number at the multiplexer.
#[derive(Clone, Copy, Debug, Default)]
pub struct Requests(u128);

impl Requests {
    fn set(&mut self, id: u8, level: bool) {
        let bit = 1_u128 << (id & 127);
        if level {
            self.0 |= bit;
        } else {
            self.0 &= !bit;
        }
    }

    fn get(self, id: u8) -> bool {
        self.0 >> (id & 127) & 1 != 0
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    control: u32,
    /// Number of requests served since the last event, or since the synchronization.
    served: u32,
    /// Number of requests still passed on (with SE only).
    open: u32,
}

#[derive(Clone, Copy, Debug, Default)]
struct Generator {
    control: u32,
    pending: u32,
}

#[derive(Debug)]
pub(super) struct Mux {
    kind: &'static Kind,
    lines: Requests,
    channels: Vec<Channel>,
    generators: [Generator; GENERATORS],
    /// Overrun flags SOFx and OFx.
    sync_overruns: u32,
    trigger_overruns: u32,
    /// Channels with an event to pass on to other inputs of the same multiplexer.
    events: Vec<usize>,
    /// Level of the overrun interrupt.
    level: bool,
}

impl Mux {
    pub(super) fn new(kind: &'static Kind, channels: usize) -> Self {
        Self {
            kind,
            lines: Requests::default(),
            channels: vec![Channel::default(); channels],
            generators: Default::default(),
            sync_overruns: 0,
            trigger_overruns: 0,
            events: Vec::new(),
            level: false,
        }
    }

    /// Resets registers and counters; the request lines belong to the peripherals and stay.
    pub(super) fn reset(&mut self, context: &mut Context<'_>) {
        *self = Self { lines: self.lines, level: self.level, ..Self::new(self.kind, self.channels.len()) };
        self.irq(context);
    }

    pub(super) fn request(&mut self, id: u8, level: bool) {
        self.lines.set(id, level);
    }

    fn line(&self, id: u8) -> bool {
        match id {
            0 => false,
            // Requests 1 to 8 come from the request generators.
            1..=8 => self.generators[usize::from(id) - 1].pending > 0,
            _ => self.lines.get(id),
        }
    }

    /// Returns true while the channel requests an access from its controller.
    pub(super) fn output(&self, channel: usize) -> bool {
        let state = &self.channels[channel];
        self.line((state.control & 0x7f) as u8) && (state.control & SE == 0 || state.open > 0)
    }

    /// Returns the number of the request that a channel selects.
    pub(super) fn selected(&self, channel: usize) -> u8 {
        (self.channels[channel].control & 0x7f) as u8
    }

    /// Notes that the controller serves the channel's request.
    pub(super) fn acknowledge(&mut self, channel: usize) {
        let id = self.selected(channel);
        if (1..=8).contains(&id) {
            let generator = &mut self.generators[usize::from(id) - 1];
            generator.pending = generator.pending.saturating_sub(1);
        } else if (self.kind.is_pulse)(id) {
            self.lines.set(id, false);
        }
        let state = &mut self.channels[channel];
        state.open = state.open.saturating_sub(1);
        state.served += 1;
        // NBREQ + 1 requests make an event.
        if state.served > state.control >> 19 & 0x1f {
            state.served = 0;
            if state.control & EGE != 0 {
                self.events.push(channel);
            }
        }
    }

    /// Passes on the event outputs of served channels; called after `acknowledge`, when a context is available.
    pub(super) fn carry_events(&mut self, context: &mut Context<'_>) {
        for channel in std::mem::take(&mut self.events) {
            if let Some(input) = (self.kind.event_trigger)(channel) {
                self.trigger_pulse(input, context);
            }
            if let Some(input) = (self.kind.event_sync)(channel) {
                self.synchronize(input, true, context);
                self.synchronize(input, false, context);
            }
        }
    }

    /// Handles a pulse at a trigger input of the generators.
    pub(super) fn trigger_pulse(&mut self, input: u8, context: &mut Context<'_>) {
        // One pulse is one trigger, also where both edges count: RM0399 gives no width for it.
        let any = |polarity| polarity != 0;
        self.trigger(input, any, context);
    }

    /// Handles an edge at a trigger input of the generators.
    pub(super) fn trigger_edge(&mut self, input: u8, rising: bool, context: &mut Context<'_>) {
        self.trigger(input, |polarity| polarity & if rising { 1 } else { 2 } != 0, context);
    }

    fn trigger(&mut self, input: u8, counts: impl Fn(u32) -> bool, context: &mut Context<'_>) {
        for (number, generator) in self.generators.iter_mut().enumerate() {
            let control = generator.control;
            let selected = control & self.kind.signal_id == u32::from(input);
            if control & GE == 0 || !selected || !counts(control >> 17 & 3) {
                continue;
            }
            // A trigger before the last requests were served is an overrun.
            if generator.pending > 0 {
                self.trigger_overruns |= 1 << number;
            }
            generator.pending = (control >> 19 & 0x1f) + 1;
        }
        self.irq(context);
    }

    /// Handles an edge at a synchronization input of the channels.
    pub(super) fn synchronize(&mut self, input: u8, rising: bool, context: &mut Context<'_>) {
        for (number, channel) in self.channels.iter_mut().enumerate() {
            let control = channel.control;
            let edge = if rising { 1 } else { 2 };
            if control & SE == 0 || control >> 24 & self.kind.sync_id != u32::from(input) || control >> 17 & edge == 0 {
                continue;
            }
            if channel.open > 0 {
                self.sync_overruns |= 1 << number;
            }
            channel.open = (control >> 19 & 0x1f) + 1;
            channel.served = 0;
        }
        self.irq(context);
    }

    fn irq(&mut self, context: &mut Context<'_>) {
        let told = |overruns: u32, number: usize, enabled: bool| enabled && overruns >> number & 1 != 0;
        let sync = self.channels.iter().enumerate().any(|(n, c)| told(self.sync_overruns, n, c.control & SOIE != 0));
        let trigger =
            self.generators.iter().enumerate().any(|(n, g)| told(self.trigger_overruns, n, g.control & OIE != 0));
        let level = sync || trigger;
        if self.level != level {
            self.level = level;
            context.irq(self.kind.overrun_irq, level);
        }
    }

    pub(super) fn read(&self, offset: u32) -> Result<u32, Unmodelled> {
        let index = (offset / 4) as usize;
        Ok(match offset {
            0x00..0x80 if index < self.channels.len() => self.channels[index].control,
            0x80 => self.sync_overruns,
            0x100..0x120 => self.generators[index - 0x40].control,
            0x140 => self.trigger_overruns,
            // CFR and RGCFR are write-only.
            0x84 | 0x144 => 0,
            _ => return Err(Unmodelled::register(self.kind.name, offset)),
        })
    }

    pub(super) fn write(&mut self, offset: u32, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let index = (offset / 4) as usize;
        match offset {
            0x00..0x80 if index < self.channels.len() => self.write_channel(index, value, context),
            0x84 => self.sync_overruns &= !value,
            0x100..0x120 => self.write_generator(index - 0x40, value, context),
            0x144 => self.trigger_overruns &= !value,
            0x80 | 0x140 => {}
            _ => return Err(Unmodelled::register(self.kind.name, offset)),
        }
        self.irq(context);
        Ok(())
    }

    fn write_channel(&mut self, index: usize, value: u32, context: &mut Context<'_>) {
        let value = value & (0x00ff_037f | self.kind.sync_id << 24);
        let id = value & 0x7f;
        let twice = id != 0 && self.channels.iter().enumerate().any(|(n, c)| n != index && c.control & 0x7f == id);
        if twice {
            context.misuse(
                self.kind.name,
                format!("request {id} selected by a second channel, {index} (RM0399, DMAMUX, request multiplexer)"),
            );
        }
        let channel = &mut self.channels[index];
        if (channel.control ^ value) & (SE | EGE | 0x00f8_007f) != 0 {
            *channel = Channel { control: value, ..Channel::default() };
        }
        channel.control = value;
    }

    fn write_generator(&mut self, index: usize, value: u32, context: &mut Context<'_>) {
        let generator = &mut self.generators[index];
        let value = value & (0x00ff_0100 | self.kind.signal_id);
        if generator.control & value & GE != 0 && (generator.control ^ value) & 0x00f8_0000 != 0 {
            context.misuse(
                self.kind.name,
                format!("GNBREQ of generator {index} written while it is enabled (RM0399, DMAMUX_RGxCR)"),
            );
        }
        generator.control = value;
        if value & GE == 0 {
            generator.pending = 0;
        }
    }
}
