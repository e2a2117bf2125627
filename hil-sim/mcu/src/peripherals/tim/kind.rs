//! Features of each timer (RM0399, one chapter for each group).

use crate::context::Clocks;

/// Features of one timer of the chip.
#[derive(Debug)]
pub(super) struct Kind {
    pub(super) number: u8,
    pub(super) name: &'static str,
    /// Number of capture/compare channels.
    pub(super) channels: usize,
    pub(super) is_32_bit: bool,
    /// The timer is on APB2.
    apb2: bool,
    /// Encoder interface; center-aligned counting belongs to the same timers.
    pub(super) has_encoder: bool,
    pub(super) has_cr2: bool,
    pub(super) has_smcr: bool,
    /// Mask of the repetition counter, 0 without one. Timers with it also have BDTR.
    pub(super) repetition: u32,
    /// DMA bursts (DCR, DMAR).
    pub(super) has_burst: bool,
    /// Inputs of DMAMUX1 for the channels and the update; 0 for none.
    pub(super) channel_requests: [u8; 4],
    pub(super) update_request: u8,
    /// Flags of SR on each interrupt.
    pub(super) vectors: &'static [(u32, u16)],
}

/// Flags of SR: UIF, CC1IF to CC4IF, COMIF, TIF, BIF and B2IF.
const ALL: u32 = 0x1ff;
const UPDATE: u32 = 1;
const COMPARE: u32 = 0x1e;
const TRIGGER: u32 = 0x60;
const BREAK: u32 = 0x180;

const BASIC: Kind = Kind {
    number: 6,
    name: "TIM6",
    channels: 0,
    is_32_bit: false,
    apb2: false,
    has_encoder: false,
    has_cr2: true,
    has_smcr: false,
    repetition: 0,
    has_burst: false,
    channel_requests: [0; 4],
    update_request: 69,
    vectors: &[(ALL, 54)],
};

const GENERAL: Kind = Kind { channels: 4, has_encoder: true, has_smcr: true, has_burst: true, ..BASIC };

const SMALL: Kind = Kind { update_request: 0, ..BASIC };

static KINDS: [Kind; 14] = [
    Kind {
        number: 1,
        name: "TIM1",
        apb2: true,
        repetition: 0xffff,
        channel_requests: [11, 12, 13, 14],
        update_request: 15,
        vectors: &[(BREAK, 24), (UPDATE, 25), (TRIGGER, 26), (COMPARE, 27)],
        ..GENERAL
    },
    Kind {
        number: 2,
        name: "TIM2",
        is_32_bit: true,
        channel_requests: [18, 19, 20, 21],
        update_request: 22,
        vectors: &[(ALL, 28)],
        ..GENERAL
    },
    Kind {
        number: 3,
        name: "TIM3",
        channel_requests: [23, 24, 25, 26],
        update_request: 27,
        vectors: &[(ALL, 29)],
        ..GENERAL
    },
    Kind {
        number: 4,
        name: "TIM4",
        channel_requests: [29, 30, 31, 0],
        update_request: 32,
        vectors: &[(ALL, 30)],
        ..GENERAL
    },
    Kind {
        number: 5,
        name: "TIM5",
        is_32_bit: true,
        channel_requests: [55, 56, 57, 58],
        update_request: 59,
        vectors: &[(ALL, 50)],
        ..GENERAL
    },
    BASIC,
    Kind { number: 7, name: "TIM7", update_request: 70, vectors: &[(ALL, 55)], ..BASIC },
    Kind {
        number: 8,
        name: "TIM8",
        apb2: true,
        repetition: 0xffff,
        channel_requests: [47, 48, 49, 50],
        update_request: 51,
        vectors: &[(BREAK, 43), (UPDATE, 44), (TRIGGER, 45), (COMPARE, 46)],
        ..GENERAL
    },
    Kind { number: 12, name: "TIM12", channels: 2, has_smcr: true, vectors: &[(ALL, 43)], ..SMALL },
    Kind { number: 13, name: "TIM13", channels: 1, has_cr2: false, vectors: &[(ALL, 44)], ..SMALL },
    Kind { number: 14, name: "TIM14", channels: 1, has_cr2: false, vectors: &[(ALL, 45)], ..SMALL },
    Kind {
        number: 15,
        name: "TIM15",
        channels: 2,
        apb2: true,
        has_smcr: true,
        repetition: 0xff,
        has_burst: true,
        channel_requests: [105, 0, 0, 0],
        update_request: 106,
        vectors: &[(ALL, 116)],
        ..SMALL
    },
    Kind {
        number: 16,
        name: "TIM16",
        channels: 1,
        apb2: true,
        repetition: 0xff,
        has_burst: true,
        channel_requests: [109, 0, 0, 0],
        update_request: 110,
        vectors: &[(ALL, 117)],
        ..SMALL
    },
    Kind {
        number: 17,
        name: "TIM17",
        channels: 1,
        apb2: true,
        repetition: 0xff,
        has_burst: true,
        channel_requests: [111, 0, 0, 0],
        update_request: 112,
        vectors: &[(ALL, 118)],
        ..SMALL
    },
];

impl Kind {
    pub(super) fn of(number: u8) -> Option<&'static Self> {
        KINDS.iter().find(|kind| kind.number == number)
    }

    /// Returns the bits of CR2 that exist: CCPC, CCUS, CCDS, MMS, TI1S, OISx, MMS2.
    pub(super) fn cr2_bits(&self) -> u32 {
        match self.number {
            1 | 8 => 0x00f5_7ffd,
            2..=5 => 0x00f8,
            15 => 0x07fd,
            16 | 17 => 0x030d,
            12 => 0x00f0,
            _ => 0x0070,
        }
    }

    /// Returns the bits of SMCR that exist: SMS, TS, MSM, and of timers with the input ETR its settings.
    pub(super) fn smcr_bits(&self) -> u32 {
        if self.has_encoder { 0x0031_fff7 } else { 0x0031_00f7 }
    }

    /// Returns the bits of AF1 that exist: the sources of the break input, ETRSEL.
    pub(super) fn af1_bits(&self) -> u32 {
        match self.number {
            1 | 8 => 0x0003_cf07,
            2..=5 => 0x0003_c000,
            _ => 0x0f07,
        }
    }

    /// Returns the bits of BDTR that exist; a second break input has only a timer with an encoder interface.
    pub(super) fn bdtr_bits(&self) -> u32 {
        if self.has_encoder { 0x03ff_ffff } else { 0x000f_ffff }
    }

    pub(super) fn hz(&self, clocks: &Clocks) -> u64 {
        if self.apb2 { clocks.tim_apb2_hz } else { clocks.tim_apb1_hz }
    }

    /// Returns the largest count.
    pub(super) fn top(&self) -> u64 {
        if self.is_32_bit { u64::from(u32::MAX) } else { 0xffff }
    }

    pub(super) fn has_break(&self) -> bool {
        self.repetition != 0
    }
}
