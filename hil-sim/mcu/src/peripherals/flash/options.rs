//! Option bytes: their two registers, their lock, and their change (RM0399, 4.4, 4.5.3, 4.9.7 to 4.9.9).

use crate::{Context, Unmodelled};

/// Option bytes of the Arduino Giga as delivered: RDP level 0, the Cortex-M7 boots and the Cortex-M4 does not, software
/// watchdogs, banks not swapped.
pub(super) const DELIVERED: u32 = 0x0B86_AAF0;
pub(super) const KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];
/// Duration of a change, ns. The manual gives no time; the value only forces programs to wait.
pub(super) const CHANGE_NS: u64 = 100_000_000;
/// Bits of the register OPTCR.
pub(super) const OPTLOCK: u32 = 1;
pub(super) const OPTSTART: u32 = 1 << 1;
pub(super) const MER: u32 = 1 << 4;
pub(super) const OPTCHANGEERRIE: u32 = 1 << 30;
pub(super) const SWAP_BANK: u32 = 1 << 31;
/// Bits of the register OPTSR.
pub(super) const OPT_BUSY: u32 = 1;
const BOR_LEV: u32 = 0b11 << 2;
pub(super) const IWDG1_SW: u32 = 1 << 4;
const RDP: u32 = 0xFF << 8;
pub(super) const SWAP_BANK_OPT: u32 = 1 << 31;
/// Options without effect in the model: IWDG2_SW, and resets, freezes and I/O speed, which matter only with low-power
/// modes.
const WITHOUT_EFFECT: u32 = 0b111 << 5 | 0b11 << 17 | 0b11 << 24 | 1 << 29;
const MODELLED: u32 = BOR_LEV | IWDG1_SW | RDP | SWAP_BANK_OPT | WITHOUT_EFFECT;
/// Options that are not modelled, with their names.
const OTHERS: [(u32, &str); 5] = [
    (1 << 23, "BOOT_CM7"),
    (1 << 22, "BOOT_CM4"),
    (1 << 21, "SECURITY"),
    (0b11 << 19, "ST_RAM_SIZE"),
    (1 << 30 | 0b111 << 26 | 1 << 16 | 1 << 1, "reserved bits"),
];

/// Level of readout protection (4.5.3, table 22). Level 2 is not modelled: it cannot be left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Level {
    /// Level 0, without readout protection.
    Zero,
    /// The flash is closed once a debugger has been connected.
    One,
    /// No debugger access, and no change of options any more.
    Two,
}

impl Level {
    pub(super) fn of(options: u32) -> Self {
        match options >> 8 & 0xFF {
            0xAA => Self::Zero,
            0xCC => Self::Two,
            _ => Self::One,
        }
    }
}

/// Returns the options that are not modelled and differ from those of the Giga.
pub(super) fn unmodelled(options: u32) -> Option<Unmodelled> {
    let differing = (options ^ DELIVERED) & !(MODELLED | OPT_BUSY);
    let mut names: Vec<&str> = OTHERS.iter().filter(|(bits, _)| differing & bits != 0).map(|(_, name)| *name).collect();
    if Level::of(options) == Level::Two {
        names.push("RDP level 2 (0xCC), which nothing can take back on a chip");
    }
    (!names.is_empty()).then(|| {
        let what = format!(
            "option bytes OPTSR {options:#010x}: not modelled is {}; keep what {DELIVERED:#010x} has there",
            names.join(", ")
        );
        Unmodelled { peripheral: "FLASH", what }
    })
}

/// Names an unmodelled register by its offset: protection areas, boot addresses, the CRC unit.
pub(super) fn unmodelled_register(offset: u32) -> Unmodelled {
    let name = match offset & 0x2FC {
        0x28 | 0x2C => "PRAR (PCROP area)",
        0x30 | 0x34 => "SCAR (secure-only area)",
        0x3C => "WPSN_PRG (write protection of sectors)",
        0x40 | 0x44 => "BOOT7 (boot addresses of the Cortex-M7)",
        0x48 | 0x4C => "BOOT4 (boot addresses of the Cortex-M4)",
        0x50..=0x5C => "CRC unit",
        _ => return Unmodelled::register("FLASH", offset),
    };
    let what = format!("option or register {name} at offset {offset:#05x} is not modelled");
    Unmodelled { peripheral: "FLASH", what }
}

/// Option bytes, and the state of their change.
pub(super) struct Options {
    /// Register OPTSR_CUR, without OPT_BUSY.
    pub(super) current: u32,
    /// Register OPTSR_PRG, the next values.
    pub(super) next: u32,
    /// Number of keys written correctly; `None` after a wrong one, until a reset.
    keys: Option<usize>,
    pub(super) unlocked: bool,
    /// Time at which the change takes effect, ns; `u64::MAX` without one.
    pub(super) ends_ns: u64,
}

impl Options {
    pub(super) fn new() -> Self {
        Self { current: DELIVERED, next: DELIVERED, keys: Some(0), unlocked: false, ends_ns: u64::MAX }
    }

    pub(super) fn is_busy(&self) -> bool {
        self.ends_ns != u64::MAX
    }

    pub(super) fn status(&self) -> u32 {
        self.current | if self.is_busy() { OPT_BUSY } else { 0 }
    }

    /// Returns the present level of readout protection.
    pub(super) fn level(&self) -> Level {
        Level::of(self.current)
    }

    /// Returns true if the requested change removes the protection, which erases the protected memories (4.5.3, table
    /// 24).
    pub(super) fn regresses(&self) -> bool {
        (self.level(), Level::of(self.next)) == (Level::One, Level::Zero)
    }

    /// Sets the option bytes directly, as a programmer would.
    pub(super) fn set(&mut self, options: u32) {
        (self.current, self.next) = (options & !OPT_BUSY, options & !OPT_BUSY);
    }

    pub(super) fn write_key(&mut self, key: u32, context: &mut Context<'_>) {
        self.keys = match self.keys {
            Some(given) if !self.unlocked && KEYS.get(given) == Some(&key) => Some(given + 1),
            _ => {
                let what = "a wrong key: option bytes stay locked until a reset (RM0399, 4.5.1)";
                context.misuse("FLASH", what);
                self.unlocked = false;
                None
            }
        };
        if self.keys == Some(KEYS.len()) {
            (self.unlocked, self.keys) = (true, Some(0));
        }
    }

    pub(super) fn write_next(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if !self.unlocked {
            let what = "OPTSR_PRG is written while OPTCR is locked; the chip ignores it (RM0399, 4.4.3)";
            context.misuse("FLASH", what);
            return Ok(());
        }
        unmodelled(value).map_or(Ok(()), Err)?;
        self.next = value & !OPT_BUSY;
        Ok(())
    }

    /// Completes the change of the option bytes.
    pub(super) fn finish(&mut self) {
        (self.current, self.ends_ns) = (self.next, u64::MAX);
    }

    /// Resets the registers with the chip: an unfinished change is dropped (4.3.14).
    pub(super) fn reset(&mut self) {
        (self.next, self.ends_ns) = (self.current, u64::MAX);
        (self.keys, self.unlocked) = (Some(0), false);
    }
}
