//! Writes to the board's chips that follow each other: the interrupt at the end of one begins the next.
//!
//! The control loop has up to ten a period. For each, embassy's driver wakes its task, which goes through the futures of a whole
//! period and sets up a transfer: 2 300 to 2 700 instructions, where the interrupt here takes 58 (docs/performance.md). The
//! controller sends the stop by itself (AUTOEND) and interrupts after it, so that nothing waits for one.
//!
//! Registers are those of I2C2 and of DMA1's stream 0, which embassy's driver of the same bus also uses, at other times: a
//! [`Chain`] is used through the [`Bus`](super::Bus) that owns both.

use core::{
    future::poll_fn,
    sync::atomic::{AtomicBool, AtomicU32, Ordering, fence},
    task::{Context, Poll},
};

use embassy_futures::select::{Either, select};
use embassy_stm32::{
    interrupt::typelevel::{self, Handler},
    pac::{
        self,
        dma::vals::{Dir, Dmdis, Size},
        i2c::{
            regs::{Cr2, Isr},
            vals::{Autoend, Dir as Direction},
        },
    },
};
use embassy_sync::waitqueue::AtomicWaker;
use embassy_time::{Duration, Timer};
use r4_firmware::platform::Write;

use super::{BusError, Transfer, Wiring};

/// Writes that a chain holds.
pub(super) const LENGTH: usize = 32;
const REGISTERS: pac::i2c::I2c = pac::I2C2;
const DMA: pac::dma::Dma = pac::DMA1;
/// Of its streams, and of the first half of the flags.
const STREAM: usize = 0;
/// I2C2_TX of DMAMUX1 (RM0399, table 121).
const REQUEST: u8 = 36;
/// Allowed for each byte of a chain: twice what a byte and its acknowledge take at 400 kHz, with its share of START and STOP.
const BYTE: Duration = Duration::from_micros(60);

/// What the interrupts know of the chain.
struct Shared {
    /// CR2 of each write, and the address of its bytes.
    starts: [AtomicU32; LENGTH],
    bytes: [AtomicU32; LENGTH],
    /// How many are to be sent, how many have been.
    count: AtomicU32,
    sent: AtomicU32,
    running: AtomicBool,
    /// Flags of ISR that ended it; 0 while none has.
    failure: AtomicU32,
    waker: AtomicWaker,
}

static SHARED: Shared = Shared {
    starts: [const { AtomicU32::new(0) }; LENGTH],
    bytes: [const { AtomicU32::new(0) }; LENGTH],
    count: AtomicU32::new(0),
    sent: AtomicU32::new(0),
    running: AtomicBool::new(false),
    failure: AtomicU32::new(0),
    waker: AtomicWaker::new(),
};

impl Shared {
    /// Begins the write that is next.
    fn start(&self) {
        let next = self.sent.load(Ordering::Relaxed) as usize;
        let (Some(start), Some(bytes)) = (self.starts.get(next), self.bytes.get(next)) else { return };
        let start = Cr2(start.load(Ordering::Relaxed));
        let stream = DMA.st(STREAM);
        DMA.ifcr(0).write(|w| {
            w.set_tcif(STREAM, true);
            w.set_htif(STREAM, true);
            w.set_teif(STREAM, true);
            w.set_dmeif(STREAM, true);
            w.set_feif(STREAM, true);
        });
        stream.m0ar().write_value(bytes.load(Ordering::Relaxed));
        stream.ndtr().write(|w| w.set_ndt(start.nbytes().into()));
        stream.cr().modify(|w| w.set_en(true));
        REGISTERS.cr2().write_value(start);
    }

    /// The controller has something to say.
    fn on_interrupt(&self) {
        if !self.running.load(Ordering::Relaxed) {
            return;
        }
        let flags = REGISTERS.isr().read();
        if flags.nackf() || flags.berr() || flags.arlo() || flags.ovr() {
            self.failure.store(flags.0, Ordering::Relaxed);
            self.end();
        } else if flags.stopf() {
            REGISTERS.icr().write(|w| w.set_stopcf(true));
            let sent = self.sent.load(Ordering::Relaxed) + 1;
            self.sent.store(sent, Ordering::Relaxed);
            if sent < self.count.load(Ordering::Relaxed) { self.start() } else { self.end() }
        }
    }

    /// No write is begun after the one that is under way. An interrupt in between begins at most one.
    fn end_after_this(&self) {
        self.count.store(self.sent.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
    }

    /// Ends the chain, whether or not a transfer is under way.
    fn end(&self) {
        self.running.store(false, Ordering::Release);
        interrupts(false);
        DMA.st(STREAM).cr().modify(|w| w.set_en(false));
        self.waker.wake();
    }
}

/// Lets the controller ask for bytes, and tell of stops and errors.
fn interrupts(on: bool) {
    REGISTERS.cr1().modify(|w| {
        w.set_txdmaen(on);
        w.set_stopie(on);
        w.set_nackie(on);
        w.set_errie(on);
    });
}

/// The chain's part of the controller's interrupts, before embassy's handler: that finds no flags then, and wakes nobody.
pub(crate) struct Next;

/// After embassy's handler, which takes interrupts away.
pub(crate) struct Rearm;

macro_rules! handlers {
    ($($interrupt:ident)*) => {$(
        impl Handler<typelevel::$interrupt> for Next {
            #[allow(unsafe_code, reason = "an interrupt handler is declared so")]
            unsafe fn on_interrupt() {
                SHARED.on_interrupt();
            }
        }

        impl Handler<typelevel::$interrupt> for Rearm {
            #[allow(unsafe_code, reason = "an interrupt handler is declared so")]
            unsafe fn on_interrupt() {
                if SHARED.running.load(Ordering::Relaxed) {
                    interrupts(true);
                }
            }
        }
    )*};
}

handlers!(I2C2_EV I2C2_ER);

/// Ends the chain when the caller gives it up: its bytes are the caller's.
struct Running;

impl Drop for Running {
    fn drop(&mut self) {
        critical_section::with(|_| {
            if SHARED.running.load(Ordering::Relaxed) {
                SHARED.end();
            }
        });
        // What the stream still holds of a byte is dropped with the request; it ends with the access that is under way.
        while DMA.st(STREAM).cr().read().en() {}
    }
}

/// The one chain, of the bus with the board's chips.
pub(crate) struct Chain(());

impl Chain {
    /// The bus of I2C2, with DMA1's stream 0, must be its only owner.
    pub(crate) const fn new() -> Self {
        Self(())
    }

    /// Sends at most [`LENGTH`] writes, which DMA1 reaches, as [`Bus::write_all`](r4_firmware::platform::Bus::write_all) does.
    pub(super) async fn send(
        &mut self,
        wiring: &Wiring,
        writes: &[Write],
        mut stops: impl FnMut(&mut Context<'_>) -> bool,
    ) -> (usize, Result<(), BusError>) {
        if poll_fn(|context| Poll::Ready(stops(context))).await {
            return (0, Ok(()));
        }
        let transfer = match Transfer::begin(wiring) {
            Ok(transfer) => transfer,
            Err(error) => return (0, Err(error)),
        };
        let bytes = begin(writes);
        let running = Running;
        let mut goes_on = true;
        let all = poll_fn(|context| {
            SHARED.waker.register(context.waker());
            if goes_on && stops(context) {
                goes_on = false;
                SHARED.end_after_this();
            }
            if SHARED.running.load(Ordering::Acquire) { Poll::Pending } else { Poll::Ready(()) }
        });
        let result = match select(all, Timer::after(wiring.timing.deadline + BYTE * bytes)).await {
            Either::First(()) => failure(),
            Either::Second(()) => Err(BusError::Held),
        };
        drop(running);
        (SHARED.sent.load(Ordering::Relaxed) as usize, transfer.end(result))
    }
}

/// Begins the first of `writes`; how many bytes they are together, addresses included.
fn begin(writes: &[Write]) -> u32 {
    let mut count = 0;
    let mut bytes = 0;
    for ((write, start), from) in writes.iter().zip(&SHARED.starts).zip(&SHARED.bytes) {
        let length = write.bytes().len();
        let mut cr2 = Cr2(0);
        cr2.set_sadd(u16::from(write.address()) << 1);
        cr2.set_dir(Direction::WRITE);
        cr2.set_nbytes(length as u8);
        cr2.set_autoend(Autoend::AUTOMATIC);
        cr2.set_start(true);
        start.store(cr2.0, Ordering::Relaxed);
        from.store(write.bytes().as_ptr().addr() as u32, Ordering::Relaxed);
        count += 1;
        bytes += 1 + length as u32;
    }
    SHARED.count.store(count, Ordering::Relaxed);
    SHARED.sent.store(0, Ordering::Relaxed);
    SHARED.failure.store(0, Ordering::Relaxed);
    if count > 0 {
        // What the stream reads has been written before it is started.
        fence(Ordering::SeqCst);
        let stream = DMA.st(STREAM);
        pac::DMAMUX1.ccr(STREAM).write(|w| w.set_dmareq_id(REQUEST));
        stream.par().write_value(REGISTERS.txdr().as_ptr().addr() as u32);
        stream.fcr().write(|w| w.set_dmdis(Dmdis::ENABLED));
        stream.cr().write(|w| {
            w.set_dir(Dir::MEMORY_TO_PERIPHERAL);
            w.set_minc(true);
            w.set_msize(Size::BITS8);
            w.set_psize(Size::BITS8);
        });
        SHARED.running.store(true, Ordering::Release);
        interrupts(true);
        SHARED.start();
    }
    bytes
}

/// What ended the chain, if not its end.
fn failure() -> Result<(), BusError> {
    match Isr(SHARED.failure.load(Ordering::Relaxed)) {
        flags if flags.nackf() => Err(BusError::NoAcknowledge),
        flags if flags.berr() => Err(BusError::Bus),
        flags if flags.arlo() => Err(BusError::Arbitration),
        flags if flags.ovr() => Err(BusError::Overrun),
        _ => Ok(()),
    }
}
