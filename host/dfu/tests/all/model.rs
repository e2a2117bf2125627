//! Model of a bootloader: the states of USB DFU 1.1 (A.1) and the commands of DfuSe (UM0424, 6; AN3156, 5), on virtual
//! time.

use std::time::Duration;

use r4_dfu::{Descriptor, Usb, UsbError};

/// Address of flash, and the length of its sectors, as in an STM32H747's bank 1.
pub(crate) const FLASH: u32 = 0x0800_0000;
pub(crate) const SECTOR: usize = 128 * 1024;
const SECTORS: usize = 8;

/// Requests of DFU (DFU 1.1, table 3.2).
const DNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const GETSTATUS: u8 = 3;
const CLRSTATUS: u8 = 4;
const ABORT: u8 = 6;

/// States by their number (DFU 1.1, 6.1.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum State {
    Idle = 2,
    DnloadSync = 3,
    Dnbusy = 4,
    DnloadIdle = 5,
    ManifestSync = 6,
    Manifest = 7,
    UploadIdle = 9,
    Error = 10,
}

/// Status by its number (DFU 1.1, 6.1.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Status {
    Ok = 0,
    Prog = 6,
    Address = 8,
    StalledPkt = 15,
}

/// Operation of a block, carried out from the next request for the status on.
#[derive(Clone, Debug)]
enum Operation {
    Pointer(u32),
    Erase(u32),
    Program(u32, Vec<u8>),
}

/// Faults of the bootloader.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Wrong {
    /// Transfer from which on the cable is out, and the bootloader without power.
    pub(crate) unplugged_at: Option<usize>,
    /// Transfer from which on the host is gone, and the bootloader waits.
    pub(crate) host_gone_at: Option<usize>,
    /// Transfer that is stalled.
    pub(crate) stalls_at: Option<usize>,
    /// Address of a byte of flash that keeps a bit at 0.
    pub(crate) worn: Option<u32>,
    /// Address from which on sectors are refused.
    pub(crate) refuses_from: Option<u32>,
}

pub(crate) struct Bootloader {
    pub(crate) flash: Vec<u8>,
    pub(crate) wrong: Wrong,
    pub(crate) transfers: usize,
    /// Address at which a program was started.
    pub(crate) started: Option<u32>,
    pub(crate) can_upload: bool,
    /// Delay of programming behind its report, ms, as in the Arduino bootloader; `None` programs before the report.
    pub(crate) behind_ms: Option<u64>,
    pub(crate) memory: String,
    pub(crate) transfer_bytes: u16,
    pub(crate) now_ms: u64,
    state: State,
    status: Status,
    pointer: u32,
    operation: Option<Operation>,
    ready_ms: u64,
    later: Vec<(u64, u32, Vec<u8>)>,
}

impl Bootloader {
    /// Makes a bootloader whose flash has old content.
    pub(crate) fn new() -> Self {
        Self {
            // 239 is no divisor of a sector's length, so that no sector equals another.
            flash: (0..SECTOR * SECTORS).map(|byte| (byte % 239) as u8).collect(),
            wrong: Wrong::default(),
            transfers: 0,
            started: None,
            can_upload: true,
            behind_ms: None,
            memory: "@Internal Flash  2MB   /0x08000000/01*128Ka,07*128Kg".into(),
            transfer_bytes: 4096,
            now_ms: 0,
            state: State::Idle,
            status: Status::Ok,
            pointer: FLASH,
            operation: None,
            ready_ms: 0,
            later: Vec::new(),
        }
    }

    /// Plugs the cable in again, with the board in its bootloader.
    pub(crate) fn plug_in(&mut self) {
        self.wrong = Wrong::default();
        (self.state, self.status, self.pointer) = (State::Idle, Status::Ok, FLASH);
        (self.operation, self.transfers) = (None, 0);
        self.later.clear();
    }

    /// Lets another host continue.
    pub(crate) fn next_host(&mut self) {
        self.wrong = Wrong::default();
        self.transfers = 0;
    }

    fn at(&self, address: u32) -> Option<usize> {
        let offset = address.checked_sub(FLASH)? as usize;
        (offset < self.flash.len() && self.wrong.refuses_from.is_none_or(|from| address < from)).then_some(offset)
    }

    fn stall(&mut self) -> UsbError {
        (self.state, self.status) = (State::Error, Status::StalledPkt);
        UsbError::Stalled
    }

    /// Cuts power in the middle of an operation: the first half of it is done.
    fn tear(&mut self) {
        match self.operation.take() {
            Some(Operation::Erase(address)) if self.state == State::Dnbusy => {
                if let Some(from) = self.at(address) {
                    self.flash[from..from + SECTOR / 2].fill(0xFF);
                }
            }
            Some(Operation::Program(address, mut data)) if self.state == State::Dnbusy => {
                data.truncate(data.len() / 2);
                self.program(address, &data);
            }
            _ => {}
        }
    }

    /// Counts a transfer, and applies its fault.
    fn transfer(&mut self) -> Result<(), UsbError> {
        let number = self.transfers;
        self.transfers += 1;
        self.now_ms += 1;
        // Blocks that were only queued are programmed when their time has come, whatever the host does.
        while let Some(at) = self.later.iter().position(|(ms, ..)| *ms <= self.now_ms) {
            let (_, address, data) = self.later.remove(at);
            self.program(address, &data);
        }
        // Without power the operation in progress is torn; without a host it is not.
        if self.wrong.unplugged_at.is_some_and(|at| number >= at) {
            self.tear();
            return Err(UsbError::Gone);
        }
        if self.wrong.host_gone_at.is_some_and(|at| number >= at) || self.started.is_some() {
            return Err(UsbError::Gone);
        }
        if self.wrong.stalls_at == Some(number) {
            return Err(self.stall());
        }
        Ok(())
    }

    fn program(&mut self, address: u32, data: &[u8]) -> Status {
        let Some(from) = self.at(address) else { return Status::Address };
        let Some(flash) = self.flash.get_mut(from..from + data.len()) else { return Status::Address };
        // Only erased flash can be programmed.
        if flash.iter().any(|byte| *byte != 0xFF) {
            return Status::Prog;
        }
        flash.copy_from_slice(data);
        if let Some(worn) = self.wrong.worn
            && (address..address + data.len() as u32).contains(&worn)
        {
            // A worn cell reads 0 where 1 was programmed.
            flash[(worn - address) as usize] &= !0x10;
        }
        Status::Ok
    }

    /// Returns the time that an operation takes, and the time that the bootloader names, ms.
    fn time_ms(&self, operation: &Operation) -> u64 {
        match operation {
            Operation::Pointer(_) => 0,
            Operation::Erase(_) => 900,
            Operation::Program(..) if self.behind_ms.is_some() => 0,
            Operation::Program(_, data) => 1 + data.len() as u64 / 200,
        }
    }

    fn carry_out(&mut self) {
        let status = match self.operation.take() {
            None => Status::Ok,
            Some(Operation::Pointer(address)) => {
                let known = self.at(address).is_some();
                if known {
                    self.pointer = address;
                }
                if known { Status::Ok } else { Status::Address }
            }
            Some(Operation::Erase(address)) => match self.at(address) {
                Some(offset) => {
                    let sector = offset / SECTOR * SECTOR;
                    self.flash[sector..sector + SECTOR].fill(0xFF);
                    Status::Ok
                }
                None => Status::Address,
            },
            Some(Operation::Program(address, data)) => match self.behind_ms {
                Some(behind_ms) => {
                    self.later.push((self.now_ms + behind_ms, address, data));
                    Status::Ok
                }
                None => self.program(address, &data),
            },
        };
        self.status = status;
        self.state = if status == Status::Ok { State::DnloadIdle } else { State::Error };
    }

    fn download(&mut self, block: u16, data: &[u8]) -> Result<(), UsbError> {
        if !matches!(self.state, State::Idle | State::DnloadIdle) || data.len() > self.transfer_bytes.into() {
            return Err(self.stall());
        }
        let address = |data: &[u8]| u32::from_le_bytes([data[1], data[2], data[3], data[4]]);
        self.operation = match (block, data) {
            (_, []) => {
                self.state = State::ManifestSync;
                return Ok(());
            }
            (0, [0x21, ..]) if data.len() == 5 => Some(Operation::Pointer(address(data))),
            (0, [0x41, ..]) if data.len() == 5 => Some(Operation::Erase(address(data))),
            (2.., _) => {
                let offset = u32::from(block - 2) * u32::from(self.transfer_bytes);
                Some(Operation::Program(self.pointer + offset, data.to_vec()))
            }
            _ => return Err(self.stall()),
        };
        self.state = State::DnloadSync;
        Ok(())
    }

    fn upload(&mut self, block: u16, buffer: &mut [u8]) -> Result<usize, UsbError> {
        if !self.can_upload || !matches!(self.state, State::Idle | State::UploadIdle) || block < 2 {
            return Err(self.stall());
        }
        let address = self.pointer + u32::from(block - 2) * u32::from(self.transfer_bytes);
        let Some(from) = self.at(address) else { return Err(self.stall()) };
        let length = buffer.len().min(self.flash.len() - from);
        buffer[..length].copy_from_slice(&self.flash[from..from + length]);
        self.state = State::UploadIdle;
        Ok(length)
    }

    fn answer_status(&mut self, buffer: &mut [u8]) -> Result<usize, UsbError> {
        let mut poll_ms = 0;
        match self.state {
            State::DnloadSync => {
                if let Some(operation) = &self.operation {
                    poll_ms = self.time_ms(operation);
                }
                self.state = State::Dnbusy;
                self.ready_ms = self.now_ms + poll_ms;
            }
            // A request for the status before its time is an error (DFU 1.1, A.2.5).
            State::Dnbusy if self.now_ms < self.ready_ms => {
                self.tear();
                return Err(self.stall());
            }
            State::Dnbusy => self.carry_out(),
            State::ManifestSync => {
                self.state = State::Manifest;
                self.started = Some(self.pointer);
            }
            _ => {}
        }
        let [low, middle, high, _] = (poll_ms as u32).to_le_bytes();
        let answer = [self.status as u8, low, middle, high, self.state as u8, 0];
        buffer[..6].copy_from_slice(&answer);
        Ok(6)
    }
}

impl Usb for Bootloader {
    fn descriptor(&self) -> Descriptor {
        let [low, high] = self.transfer_bytes.to_le_bytes();
        // Can download and will detach; upload is optional (DFU 1.1, table 4.2).
        let attributes = 0x09 | u8::from(self.can_upload) << 1;
        let bytes = [9, 0x21, attributes, 0xFF, 0, low, high, 0x1A, 0x01];
        let functional = dfu_core::functional_descriptor::FunctionalDescriptor::from_bytes(&bytes);
        let functional = functional.expect("a functional descriptor").expect("nine bytes");
        Descriptor { functional, memory: self.memory.clone() }
    }

    fn control_out(&mut self, request: u8, value: u16, data: &[u8]) -> Result<(), UsbError> {
        self.transfer()?;
        match (request, self.state) {
            (DNLOAD, _) => self.download(value, data),
            (CLRSTATUS, State::Error) => {
                (self.state, self.status) = (State::Idle, Status::Ok);
                Ok(())
            }
            (ABORT, State::Idle | State::DnloadSync | State::DnloadIdle | State::ManifestSync | State::UploadIdle) => {
                self.state = State::Idle;
                self.operation = None;
                Ok(())
            }
            _ => Err(self.stall()),
        }
    }

    fn control_in(&mut self, request: u8, value: u16, buffer: &mut [u8]) -> Result<usize, UsbError> {
        self.transfer()?;
        match request {
            GETSTATUS => self.answer_status(buffer),
            UPLOAD => self.upload(value, buffer),
            _ => Err(self.stall()),
        }
    }

    fn sleep(&mut self, time: Duration) {
        self.now_ms += time.as_millis() as u64;
    }
}
