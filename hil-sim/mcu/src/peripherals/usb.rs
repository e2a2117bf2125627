//! OTG_FS (RM0399, 60) as a device without a cable in its connector.
//!
//! The core resets, idles and flushes as a driver expects; settings are stored. Nothing ever arrives: no reset, no
//! frame, no packet, not even the suspend that an idle line would bring. Reading received data, sending (an enabled IN
//! endpoint, the FIFOs) and host mode end the run. So this model does not test a link over USB.

use crate::{Context, Peripheral, Size, Unmodelled};

const GOTGCTL: u32 = 0x000;
const GOTGINT: u32 = 0x004;
const GAHBCFG: u32 = 0x008;
const GUSBCFG: u32 = 0x00C;
const GRSTCTL: u32 = 0x010;
const GINTSTS: u32 = 0x014;
const GINTMSK: u32 = 0x018;
const GRXFSIZ: u32 = 0x024;
const DIEPTXF0: u32 = 0x028;
const GCCFG: u32 = 0x038;
const CID: u32 = 0x03C;
const GHWCFG4: u32 = 0x050;
const DIEPTXF1: u32 = 0x104;
const DIEPTXF8: u32 = 0x120;
const DCFG: u32 = 0x800;
const DCTL: u32 = 0x804;
const DSTS: u32 = 0x808;
const DIEPMSK: u32 = 0x810;
const DOEPMSK: u32 = 0x814;
const DAINT: u32 = 0x818;
const DAINTMSK: u32 = 0x81C;
const DIEPEMPMSK: u32 = 0x834;
/// Offsets of DIEPCTL0 and DOEPCTL0; the other registers of the nine endpoints follow at intervals of 0x20.
const IN: u32 = 0x900;
const OUT: u32 = 0xB00;
const ENDPOINTS: u32 = 9 * 0x20;
const PCGCCTL: u32 = 0xE00;
const END: u32 = 0xE04;

/// Bits of GUSBCFG that force a mode.
const FORCE_HOST: u32 = 1 << 29;
#[cfg(test)]
const FORCE_DEVICE: u32 = 1 << 30;
/// Bit of GRSTCTL: AHBIDL. CSRST, PSRST, FSRST, RXFFLSH and TXFFLSH clear themselves.
const AHB_IDLE: u32 = 1 << 31;
/// Bit of GINTSTS: host mode.
#[cfg(test)]
const CURRENT_MODE_HOST: u32 = 1;
/// Bit of DIEPCTLx and DOEPCTLx: endpoint enabled.
const ENABLE: u32 = 1 << 31;
/// Identity of the Synopsys core as STM32H7 reports it (OTG_CID after a reset).
const CORE_ID: u32 = 0x0000_2300;

/// Stored registers of OTG_FS.
pub struct Usb {
    registers: Box<[u32; (END / 4) as usize]>,
}

impl Default for Usb {
    fn default() -> Self {
        Self::new()
    }
}

impl Usb {
    /// Makes the core in its reset state.
    #[must_use]
    pub fn new() -> Self {
        let mut registers = Box::new([0; (END / 4) as usize]);
        for (at, value) in [
            (GUSBCFG, 0x0000_1440),
            (GRXFSIZ, 0x0000_0400),
            (DIEPTXF0, 0x0200_0200),
            (CID, CORE_ID),
            (DCFG, 0x0220_0000),
            (DCTL, 1 << 1),
            (DSTS, 0x10),
        ] {
            registers[(at / 4) as usize] = value;
        }
        Self { registers }
    }

    /// Returns true if the driver has connected its pull-up: DCTL.SDIS is 0 and the transceiver is on.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.registers[(DCTL / 4) as usize] & 1 << 1 == 0 && self.registers[(GCCFG / 4) as usize] & 1 << 16 != 0
    }

    fn is_plain(at: u32) -> bool {
        let endpoint = |base: u32| {
            // Stored registers are DxEPCTL and DxEPTSIZ, and DxEPINT, whose flags are never set.
            (base..base + ENDPOINTS).contains(&at) && matches!((at - base) % 0x20, 0 | 8 | 0x10)
        };
        matches!(
            at,
            GOTGCTL
                | GOTGINT
                | GAHBCFG
                | GUSBCFG
                | GINTMSK
                | GRXFSIZ
                | DIEPTXF0
                | GCCFG
                | CID
                | GHWCFG4
                | DCFG
                | DCTL
                | DSTS
                | DIEPMSK
                | DOEPMSK
                | DAINT
                | DAINTMSK
                | DIEPEMPMSK
                | PCGCCTL
        ) || (DIEPTXF1..=DIEPTXF8).contains(&at)
            || endpoint(IN)
            || endpoint(OUT)
    }
}

impl Peripheral for Usb {
    fn read(&mut self, offset: u32, size: Size, _: &mut Context<'_>) -> Result<u32, Unmodelled> {
        match offset {
            _ if size != Size::Word => Err(Unmodelled::register("OTG_FS", offset)),
            GRSTCTL => Ok(AHB_IDLE),
            // Without an ID pin the core is in host mode only if that is forced, which is not modelled.
            GINTSTS => Ok(0),
            _ if offset < END && Self::is_plain(offset) => Ok(self.registers[(offset / 4) as usize]),
            // DTXFSTSx reports an empty FIFO.
            _ if (IN..IN + ENDPOINTS).contains(&offset) && (offset - IN) % 0x20 == 0x18 => {
                let number = (offset - IN) / 0x20;
                let size = if number == 0 { DIEPTXF0 } else { DIEPTXF1 + 4 * (number - 1) };
                Ok(self.registers[(size / 4) as usize] >> 16)
            }
            _ => Err(Unmodelled::register("OTG_FS", offset)),
        }
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        const READ_ONLY: [u32; 4] = [CID, GHWCFG4, DSTS, DAINT];
        let in_endpoint = (IN..IN + ENDPOINTS).contains(&offset) && (offset - IN).is_multiple_of(0x20);
        match offset {
            _ if size != Size::Word => return Err(Unmodelled::register("OTG_FS", offset)),
            GUSBCFG if value & FORCE_HOST != 0 => {
                return Err(Unmodelled { peripheral: "OTG_FS", what: "host mode (GUSBCFG.FHMOD)".into() });
            }
            GRSTCTL if value & 1 != 0 => {
                // CSRST keeps the settings of the transceiver and the forced mode.
                let kept = [GUSBCFG, GCCFG].map(|at| self.registers[(at / 4) as usize]);
                self.reset(context);
                for (at, value) in [GUSBCFG, GCCFG].into_iter().zip(kept) {
                    self.registers[(at / 4) as usize] = value;
                }
            }
            GRSTCTL | GINTSTS | GOTGINT => {}
            _ if in_endpoint && value & ENABLE != 0 => {
                return Err(Unmodelled { peripheral: "OTG_FS", what: "sending (DIEPCTLx.EPENA)".into() });
            }
            _ if READ_ONLY.contains(&offset) => {}
            _ if offset < END && Self::is_plain(offset) => self.registers[(offset / 4) as usize] = value,
            _ => return Err(Unmodelled::register("OTG_FS", offset)),
        }
        Ok(())
    }

    fn reset(&mut self, _: &mut Context<'_>) {
        *self = Self::new();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Bench;

    #[test]
    fn a_device_driver_comes_up_and_waits() {
        let (mut usb, mut bench) = (Usb::new(), Bench::default());
        assert_eq!(bench.read(&mut usb, CID), 0x2300);
        assert_eq!(bench.read(&mut usb, GRSTCTL) >> 31, 1);
        bench.write(&mut usb, GRSTCTL, 1);
        assert_eq!(bench.read(&mut usb, GRSTCTL) & 1, 0, "CSRST clears itself");
        bench.write(&mut usb, GUSBCFG, FORCE_DEVICE | 1 << 6);
        assert_eq!(bench.read(&mut usb, GINTSTS) & CURRENT_MODE_HOST, 0);
        bench.modify(&mut usb, GCCFG, 0, 1 << 16);
        bench.modify(&mut usb, GOTGCTL, 0, 0b11 << 6);
        assert!(!usb.is_connected());
        bench.write(&mut usb, DCTL, 0);
        assert!(usb.is_connected());
        bench.write(&mut usb, GRSTCTL, 1 << 4 | 1 << 5 | 0x10 << 6);
        assert_eq!(bench.read(&mut usb, GRSTCTL), AHB_IDLE, "flushed");
        bench.run(&mut usb, 10_000_000_000);
        assert_eq!(bench.read(&mut usb, GINTSTS), 0);
        assert_eq!(bench.take_signals(), []);
    }

    #[test]
    fn traffic_ends_the_run() {
        let (mut usb, mut bench) = (Usb::new(), Bench::default());
        // Unmodelled accesses: GRXSTSP, a FIFO, a host channel, an IN transfer, host mode.
        assert!(bench.try_read(&mut usb, 0x020, Size::Word).is_err());
        assert!(bench.try_write(&mut usb, 0x1000, Size::Word, 0).is_err());
        assert!(bench.try_write(&mut usb, 0x500, Size::Word, 0).is_err());
        assert!(bench.try_write(&mut usb, IN + 0x20, Size::Word, ENABLE).is_err());
        assert!(bench.try_write(&mut usb, GUSBCFG, Size::Word, FORCE_HOST).is_err());
        bench.write(&mut usb, OUT, ENABLE | 64);
        assert_eq!(bench.read(&mut usb, OUT), ENABLE | 64, "ready to receive is fine");
    }

    #[test]
    fn an_empty_fifo_has_the_room_it_was_given() {
        let (mut usb, mut bench) = (Usb::new(), Bench::default());
        bench.write(&mut usb, DIEPTXF1 + 4, 64 << 16 | 128);
        assert_eq!(bench.read(&mut usb, IN + 2 * 0x20 + 0x18), 64);
    }
}
