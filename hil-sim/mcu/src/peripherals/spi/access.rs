//! Accesses to the registers, and the progress of time.

use crate::context::Context;
use crate::peripheral::{Peripheral, Size, Unmodelled};

use super::registers::{self as register, cfg1, cfg2, cr1, sr};
use super::{NAME, Spi};

fn unmodelled(what: impl Into<String>) -> Unmodelled {
    Unmodelled { peripheral: NAME, what: what.into() }
}

impl Spi {
    fn write_cr1(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & cr1::MASRX != 0 {
            return Err(unmodelled("receiving with automatic suspension (MASRX) is not modelled"));
        }
        let old = self.cr1;
        // CSTART and IOLOCK can only be set; CSUSP reads as 0.
        self.cr1 = value & cr1::ALL & !cr1::CSUSP | old & (cr1::CSTART | cr1::IOLOCK);
        // While MODF is set, SPE and IOLOCK stay 0.
        if self.flags & sr::MODF != 0 {
            self.cr1 &= !(cr1::SPE | cr1::IOLOCK);
        }
        if old & cr1::SPE != 0 && !self.enabled() {
            self.switch_off(context);
        }
        if old & cr1::SPE == 0 && self.enabled() {
            self.switch_on(context)?;
        }
        if !self.enabled() {
            self.cr1 &= !cr1::CSTART;
            return Ok(());
        }
        if value & cr1::CSUSP != 0 && self.cr1 & cr1::CSTART != 0 {
            // The suspension waits for the end of the frame on the wire.
            if self.shifting.is_some() {
                self.suspend = true;
            } else {
                self.cr1 &= !cr1::CSTART;
                self.flags |= sr::SUSP;
            }
        }
        self.start(context.now_ns);
        Ok(())
    }

    fn switch_on(&mut self, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if self.cfg2 & cfg2::MASTER == 0 {
            return Err(unmodelled("slave mode is not modelled"));
        }
        if self.cfg2 & (cfg2::SSM | cfg2::SSOE) == 0 {
            return Err(unmodelled("the SS input pin of a master (SSM = 0, SSOE = 0) is not modelled"));
        }
        if self.bits() < 4 {
            context.misuse(NAME, "data frames of less than 4 bits (RM0399, 53.11.3)");
        }
        if 2 * self.packet() > self.capacity() {
            context.misuse(NAME, "a packet is larger than half the FIFO (RM0399, 53.11.3)");
        }
        // Mode fault: the master's SS input is active (53.5.2).
        let selected = (self.cr1 & cr1::SSI != 0) == (self.cfg2 & cfg2::SSIOP != 0);
        if self.cfg2 & cfg2::SSM != 0 && selected {
            self.flags |= sr::MODF;
            self.cr1 &= !(cr1::SPE | cr1::IOLOCK);
        }
        // TSIZE is taken when SPE rises.
        self.unsent = self.cr2 & 0xFFFF;
        self.unwritten = self.unsent;
        Ok(())
    }

    /// Handles SPE = 0: all activity stops, the FIFOs are emptied (53.11.1).
    fn switch_off(&mut self, context: &mut Context<'_>) {
        if self.shifting.is_some() || !self.to_send.is_empty() {
            context.misuse(NAME, "SPE is cleared while frames are still to be sent: they are lost (RM0399, 53.4.12)");
        }
        self.shifting = None;
        self.to_send.clear();
        self.received = 0;
        self.suspend = false;
        self.unsent = 0;
        self.unwritten = 0;
        self.cr1 &= !(cr1::CSTART | cr1::IOLOCK);
    }

    fn write_cfg1(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value & cfg1::CRCEN != 0 {
            return Err(unmodelled("CRC (CFG1.CRCEN) is not modelled"));
        }
        // While SPE is 1, only the DMA enable bits may change.
        let free = cfg1::TXDMAEN | cfg1::RXDMAEN;
        let value = value & cfg1::ALL;
        if self.enabled() && (self.cfg1 ^ value) & !free != 0 {
            context.misuse(NAME, "CFG1 is written while SPE is 1 (RM0399, 53.11.3)");
            self.cfg1 = self.cfg1 & !free | value & free;
        } else {
            self.cfg1 = value;
        }
        Ok(())
    }

    fn write_cfg2(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if value >> cfg2::COMM_AT & 2 != 0 || value & cfg2::SP != 0 {
            return Err(unmodelled("receivers, half duplex and TI mode (CFG2) are not modelled"));
        }
        if self.enabled() || self.cr1 & cr1::IOLOCK != 0 {
            context.misuse(NAME, "CFG2 is written while SPE or IOLOCK is 1 (RM0399, 53.11.4)");
        } else {
            self.cfg2 = value & cfg2::ALL;
        }
        Ok(())
    }

    fn write_cr2(&mut self, value: u32, context: &mut Context<'_>) {
        if self.enabled() && (self.cr2 ^ value) & 0xFFFF != 0 {
            context.misuse(NAME, "TSIZE is written while SPE is 1 (RM0399, 53.11.2)");
            return;
        }
        self.flags &= !sr::TSERF;
        self.cr2 = value;
    }

    fn write_txdr(&mut self, size: Size, value: u32, context: &mut Context<'_>) {
        let frame_bytes = self.access_bytes();
        let access_bytes = size.bytes() as usize;
        if access_bytes < frame_bytes {
            context.misuse(NAME, "TXDR is written by less than a data frame (RM0399, 53.11.8)");
            return;
        }
        if !self.enabled() {
            context.misuse(NAME, "TXDR is written while SPE is 0: the frame is lost (RM0399, 53.4.11)");
            return;
        }
        // An access wider than a frame holds several frames, the first in the low bits.
        for nth in 0..access_bytes / frame_bytes {
            if self.counted() && self.unwritten == 0 {
                // The rest of the last packet is discarded.
                break;
            }
            if self.to_send.len() >= self.capacity() {
                context.misuse(NAME, "TXDR is written while the TxFIFO is full: a frame is lost (RM0399, 53.4.11)");
                break;
            }
            self.to_send.push_back(value >> (8 * frame_bytes * nth) as u32);
            if self.counted() {
                self.unwritten -= 1;
                if self.unwritten == 0 && self.cr2 >> 16 == 0 {
                    self.flags |= sr::TXTF;
                    // All frames are written, so the interrupts that ask for more are disabled.
                    self.ier &= !(sr::TXP | sr::DXP);
                }
            }
        }
        self.start(context.now_ns);
    }
}

impl Peripheral for Spi {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        self.bring_to_now(context);
        if size != Size::Word && offset != register::RXDR {
            return Err(unmodelled(format!("read of {} bytes at {offset:#05x}", size.bytes())));
        }
        let value = match offset {
            register::CR1 => self.cr1,
            register::CR2 => self.cr2,
            register::CFG1 => self.cfg1,
            register::CFG2 => self.cfg2,
            register::IER => self.ier,
            register::SR => self.sr(),
            register::IFCR | register::TXDR | register::TXCRC | register::RXCRC => 0,
            register::RXDR if self.received > 0 => {
                return Err(unmodelled("what comes in at MISO is not modelled, and RXDR is read"));
            }
            register::RXDR => 0,
            register::CRCPOLY => self.crcpoly,
            register::UDRDR => self.udrdr,
            register::I2SCFGR => self.i2scfgr,
            _ => return Err(Unmodelled::register(NAME, offset)),
        };
        self.update_lines(context);
        Ok(value)
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.bring_to_now(context);
        if size != Size::Word && offset != register::TXDR {
            return Err(unmodelled(format!("write of {} bytes at {offset:#05x}", size.bytes())));
        }
        match offset {
            register::CR1 => self.write_cr1(value, context)?,
            register::CR2 => self.write_cr2(value, context),
            register::CFG1 => self.write_cfg1(value, context)?,
            register::CFG2 => self.write_cfg2(value, context)?,
            register::IER => self.ier = value & 0x7FF,
            register::IFCR => self.flags &= !(value & sr::CLEARED),
            register::TXDR => self.write_txdr(size, value, context),
            register::CRCPOLY | register::UDRDR if self.enabled() => {
                context.misuse(NAME, "CRCPOLY or UDRDR is written while SPE is 1 (RM0399, 53.11.1)");
            }
            register::CRCPOLY => self.crcpoly = value,
            register::UDRDR => self.udrdr = value,
            register::I2SCFGR if value & 1 != 0 => return Err(unmodelled("I2S is not modelled")),
            register::I2SCFGR => self.i2scfgr = value & 0x03FF_7FBE,
            register::SR | register::RXDR | register::TXCRC | register::RXCRC => {
                context.misuse(NAME, format!("a read-only register at {offset:#05x} is written (RM0399, 53.11)"));
            }
            _ => return Err(Unmodelled::register(NAME, offset)),
        }
        self.update_lines(context);
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        self.next_ns()
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.bring_to_now(context);
        self.update_lines(context);
    }

    fn clocks_changed(&mut self, context: &mut Context<'_>) {
        if context.clocks.spi123_hz != self.kernel_hz && self.shifting.is_some() {
            context.misuse(NAME, "the kernel clock changes within a frame (RM0399, 53.4.1)");
        }
        self.kernel_hz = context.clocks.spi123_hz;
    }

    fn reset(&mut self, context: &mut Context<'_>) {
        let lines = self.lines;
        *self = Self { lines, ..Self::new() };
        self.update_lines(context);
    }
}
