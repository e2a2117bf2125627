//! Bus with the board's chips, I2C2: the interrupt at the end of a transfer begins the next.
//!
//! The control loop has up to ten writes and a read per period. For each, embassy's driver wakes its task, which polls
//! the futures of a whole period and sets up a transfer: 2 300 to 2 700 instructions for a write, where the interrupt
//! here takes 58 (docs/performance.md). Written bytes are sent by DMA; read bytes take an interrupt each: one to four
//! bytes while armed. The controller sends the stop by itself (AUTOEND) and interrupts after it, so that nothing waits
//! for one.

use core::{
    future::poll_fn,
    sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering, fence},
    task::{Context, Poll},
};

use embassy_stm32::{
    Peri,
    i2c::{I2c, Master},
    interrupt::{
        self, InterruptExt,
        typelevel::{self, Handler},
    },
    mode::Blocking,
    pac::{
        self,
        dma::vals::{Dir, Dmdis, Size},
        i2c::{
            regs::{Cr2, Isr},
            vals::{Autoend, Dir as Direction},
        },
        timer::vals::Urs,
    },
    peripherals, rcc,
};
use embassy_sync::waitqueue::AtomicWaker;
use embassy_time::Duration;
use embedded_hal_async::i2c::{ErrorType, I2c as I2cBus, Operation};
use r4_firmware::platform::{self, Write};

use super::{BusError, Transfer, Wiring};

/// Maximum number of transfers that go out together.
const LENGTH: usize = 32;
/// Maximum number of bytes of a read: the longest is that of the MCP4728, 24.
const READ: usize = 32;
/// Maximum number of bytes of a transfer without reloading NBYTES.
const MOST: usize = 255;
const REGISTERS: pac::i2c::I2c = pac::I2C2;
const DMA: pac::dma::Dma = pac::DMA1;
/// DMA stream, whose flags are in the first half of the flag registers.
const STREAM: usize = 0;
/// Request I2C2_TX of DMAMUX1 (RM0399, table 121).
const REQUEST: u8 = 36;
/// Timer of the deadline. A timer of the executor took 290 instructions for each transfer, of which a stop has five
/// (docs/performance.md).
const DEADLINE: pac::timer::TimBasic = pac::TIM7;
/// Time allowed for each byte: twice that of a byte and its acknowledge at 400 kHz, with its share of START and STOP.
const BYTE: Duration = Duration::from_micros(60);

/// State of the transfers, shared with the interrupts.
struct Shared {
    /// Value of CR2 for each transfer, and the address of its bytes if they are written.
    starts: [AtomicU32; LENGTH],
    bytes: [AtomicU32; LENGTH],
    /// Value of CR2 for a read behind a write without a stop.
    reread: AtomicU32,
    /// Number of transfers to carry out, and number completed.
    count: AtomicU32,
    done: AtomicU32,
    read: [AtomicU8; READ],
    received: AtomicU32,
    running: AtomicBool,
    /// Flags of ISR that ended the transfers, TIMEOUT for the deadline; 0 without a failure.
    failure: AtomicU32,
    waker: AtomicWaker,
}

static SHARED: Shared = Shared {
    starts: [const { AtomicU32::new(0) }; LENGTH],
    bytes: [const { AtomicU32::new(0) }; LENGTH],
    reread: AtomicU32::new(0),
    count: AtomicU32::new(0),
    done: AtomicU32::new(0),
    read: [const { AtomicU8::new(0) }; READ],
    received: AtomicU32::new(0),
    running: AtomicBool::new(false),
    failure: AtomicU32::new(0),
    waker: AtomicWaker::new(),
};

impl Shared {
    /// Begins the next transfer.
    fn start(&self) {
        let next = self.done.load(Ordering::Relaxed) as usize;
        let (Some(start), Some(bytes)) = (self.starts.get(next), self.bytes.get(next)) else { return };
        let start = Cr2(start.load(Ordering::Relaxed));
        if start.dir() == Direction::WRITE {
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
        }
        REGISTERS.cr2().write_value(start);
    }

    /// Handles an interrupt of the controller.
    fn on_interrupt(&self) {
        if !self.running.load(Ordering::Relaxed) {
            return;
        }
        let flags = REGISTERS.isr().read();
        if flags.nackf() || flags.berr() || flags.arlo() || flags.ovr() {
            self.failure.store(flags.0, Ordering::Relaxed);
            self.end();
        } else if flags.rxne() {
            // Read before the stop behind the last byte.
            let byte = REGISTERS.rxdr().read().rxdata();
            let received = self.received.load(Ordering::Relaxed);
            self.read.get(received as usize).into_iter().for_each(|place| place.store(byte, Ordering::Relaxed));
            self.received.store(received + 1, Ordering::Relaxed);
        } else if flags.tc() {
            REGISTERS.cr2().write_value(Cr2(self.reread.load(Ordering::Relaxed)));
        } else if flags.stopf() {
            REGISTERS.icr().write(|w| w.set_stopcf(true));
            let done = self.done.load(Ordering::Relaxed) + 1;
            self.done.store(done, Ordering::Relaxed);
            if done < self.count.load(Ordering::Relaxed) { self.start() } else { self.end() }
        }
    }

    /// Handles the deadline: a chip or a fault holds a line.
    fn on_deadline(&self) {
        DEADLINE.sr().write(|w| w.set_uif(false));
        if self.running.load(Ordering::Relaxed) {
            let mut held = Isr(0);
            held.set_timeout(true);
            self.failure.store(held.0, Ordering::Relaxed);
            self.end();
        }
    }

    /// Lets no transfer begin after the one under way. An interrupt in between begins at most one.
    fn end_after_this(&self) {
        self.count.store(self.done.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
    }

    /// Ends all transfers, whether or not one is under way.
    fn end(&self) {
        self.running.store(false, Ordering::Release);
        count_deadline(false);
        interrupts(false);
        DMA.st(STREAM).cr().modify(|w| w.set_en(false));
        self.waker.wake();
    }
}

/// Enables or disables the controller's DMA request and its interrupts for bytes, ends and errors.
fn interrupts(on: bool) {
    REGISTERS.cr1().modify(|w| {
        w.set_txdmaen(on);
        w.set_rxie(on);
        w.set_tcie(on);
        w.set_stopie(on);
        w.set_nackie(on);
        w.set_errie(on);
    });
}

/// Handler of both interrupts of the controller and of that of the deadline.
pub(crate) struct OnBoard;

macro_rules! handlers {
    ($($interrupt:ident: $handler:ident)*) => {$(
        impl Handler<typelevel::$interrupt> for OnBoard {
            #[allow(unsafe_code, reason = "an interrupt handler is declared so")]
            unsafe fn on_interrupt() {
                SHARED.$handler();
            }
        }
    )*};
}

handlers!(I2C2_EV: on_interrupt I2C2_ER: on_interrupt TIM7: on_deadline);

/// Starts the deadline: a timer that counts microseconds to `after`, once.
fn start_deadline(after: Duration) {
    let ticks = after.as_micros().min(u16::MAX.into()) as u16;
    DEADLINE.arr().write(|w| w.set_arr(ticks));
    // Loads the new value and restarts at 0.
    DEADLINE.egr().write(|w| w.set_ug(true));
    count_deadline(true);
}

/// Starts or stops the timer. Only its end interrupts, not its start (URS). An interrupt that is pending when it is
/// stopped is handled before the next transfer begins: it has a higher priority than the control task.
fn count_deadline(counts: bool) {
    DEADLINE.cr1().write(|w| {
        w.set_opm(true);
        w.set_urs(Urs::COUNTER_ONLY);
        w.set_cen(counts);
    });
}

/// Guard that ends the transfers when the caller drops their future: their bytes belong to the caller.
struct Running;

impl Drop for Running {
    fn drop(&mut self) {
        critical_section::with(|_| {
            if SHARED.running.load(Ordering::Relaxed) {
                SHARED.end();
            }
        });
        // The rest of a byte in the stream is dropped with the request; the stream stops after the access under way.
        while DMA.st(STREAM).cr().read().en() {}
    }
}

/// Driver of the bus with the board's chips.
pub(crate) struct BoardBus {
    wiring: Wiring,
    /// Owner of pins and clock; the embassy driver itself is not used.
    _controller: I2c<'static, Blocking, Master>,
    _stream: Peri<'static, peripherals::DMA1_CH0>,
    _deadline: Peri<'static, peripherals::TIM7>,
}

impl BoardBus {
    /// Creates the driver. `controller` must be that of `wiring`, I2C2. Written bytes must lie where DMA1 reaches them.
    pub(crate) fn new(
        controller: I2c<'static, Blocking, Master>,
        stream: Peri<'static, peripherals::DMA1_CH0>,
        deadline: Peri<'static, peripherals::TIM7>,
        wiring: Wiring,
    ) -> Self {
        wiring.start();
        rcc::enable_and_reset::<peripherals::TIM7>();
        let microsecond = rcc::frequency::<peripherals::TIM7>().0 / 1_000_000;
        DEADLINE.psc().write_value((microsecond - 1) as u16);
        count_deadline(false);
        DEADLINE.dier().write(|w| w.set_uie(true));
        #[allow(unsafe_code, reason = "interrupts are enabled so")]
        // SAFETY: its handler is bound, and works on its own registers and atomics.
        unsafe {
            interrupt::TIM7.enable();
        }
        Self { wiring, _controller: controller, _stream: stream, _deadline: deadline }
    }

    /// Carries out the first `count` transfers that were [`put`], `bytes` in total; returns the number completed, and
    /// the error that ended them, if any.
    async fn carry_out(
        &mut self,
        count: usize,
        bytes: usize,
        mut stops: impl FnMut(&mut Context<'_>) -> bool,
    ) -> (usize, Result<(), BusError>) {
        if poll_fn(|context| Poll::Ready(stops(context))).await {
            return (0, Ok(()));
        }
        let transfer = match Transfer::begin(&self.wiring) {
            Ok(transfer) => transfer,
            Err(error) => return (0, Err(error)),
        };
        begin(count, self.wiring.timing.deadline + BYTE * bytes as u32);
        let running = Running;
        let mut goes_on = true;
        poll_fn(|context| {
            SHARED.waker.register(context.waker());
            if goes_on && stops(context) {
                goes_on = false;
                SHARED.end_after_this();
            }
            if SHARED.running.load(Ordering::Acquire) { Poll::Pending } else { Poll::Ready(()) }
        })
        .await;
        drop(running);
        (SHARED.done.load(Ordering::Relaxed) as usize, transfer.end(failure()))
    }
}

/// Value of CR2 for a transfer of `length` bytes, at most [`MOST`].
fn start(address: u8, direction: Direction, length: usize, end: Autoend) -> Cr2 {
    let mut cr2 = Cr2(0);
    cr2.set_sadd(u16::from(address) << 1);
    cr2.set_dir(direction);
    cr2.set_nbytes(length as u8);
    cr2.set_autoend(end);
    cr2.set_start(true);
    cr2
}

/// Stores a transfer at `place`, below [`LENGTH`], to be carried out next; a read has no `bytes`.
fn put(place: usize, start: Cr2, bytes: &[u8]) {
    if let (Some(to), Some(from)) = (SHARED.starts.get(place), SHARED.bytes.get(place)) {
        to.store(start.0, Ordering::Relaxed);
        from.store(bytes.as_ptr().addr() as u32, Ordering::Relaxed);
    }
}

/// Begins the first of `count` transfers, which are given up after `deadline`.
fn begin(count: usize, deadline: Duration) {
    SHARED.count.store(count as u32, Ordering::Relaxed);
    SHARED.done.store(0, Ordering::Relaxed);
    SHARED.received.store(0, Ordering::Relaxed);
    SHARED.failure.store(0, Ordering::Relaxed);
    if count == 0 {
        return;
    }
    // The bytes that the stream reads must be written before it is started.
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
    start_deadline(deadline);
    interrupts(true);
    SHARED.start();
}

/// Error that ended the transfers, if any.
fn failure() -> Result<(), BusError> {
    match Isr(SHARED.failure.load(Ordering::Relaxed)) {
        flags if flags.timeout() => Err(BusError::Held),
        flags if flags.nackf() => Err(BusError::NoAcknowledge),
        flags if flags.berr() => Err(BusError::Bus),
        flags if flags.arlo() => Err(BusError::Arbitration),
        flags if flags.ovr() => Err(BusError::Overrun),
        _ => Ok(()),
    }
}

/// Copies the bytes that were read to `to`, which they fill.
fn take(to: &mut [u8]) {
    to.iter_mut().zip(&SHARED.read).for_each(|(to, from)| *to = from.load(Ordering::Relaxed));
}

/// Checks that NBYTES and the read buffer can hold a transfer.
fn check(write: &[u8], read: &[u8]) -> Result<(), BusError> {
    if write.len() > MOST || read.len() > READ || write.is_empty() && read.is_empty() {
        return Err(BusError::BadLength);
    }
    Ok(())
}

impl ErrorType for BoardBus {
    type Error = BusError;
}

impl I2cBus for BoardBus {
    async fn read(&mut self, address: u8, read: &mut [u8]) -> Result<(), BusError> {
        check(&[], read)?;
        put(0, start(address, Direction::READ, read.len(), Autoend::AUTOMATIC), &[]);
        self.carry_out(1, 1 + read.len(), |_| false).await.1?;
        take(read);
        Ok(())
    }

    async fn write(&mut self, address: u8, write: &[u8]) -> Result<(), BusError> {
        check(write, &[])?;
        put(0, start(address, Direction::WRITE, write.len(), Autoend::AUTOMATIC), write);
        self.carry_out(1, 1 + write.len(), |_| false).await.1
    }

    async fn write_read(&mut self, address: u8, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if write.is_empty() {
            return self.read(address, read).await;
        }
        if read.is_empty() {
            return self.write(address, write).await;
        }
        check(write, read)?;
        put(0, start(address, Direction::WRITE, write.len(), Autoend::SOFTWARE), write);
        let reread = start(address, Direction::READ, read.len(), Autoend::AUTOMATIC);
        SHARED.reread.store(reread.0, Ordering::Relaxed);
        self.carry_out(1, 2 + write.len() + read.len(), |_| false).await.1?;
        take(read);
        Ok(())
    }

    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), BusError> {
        match operations {
            [Operation::Write(write)] => self.write(address, write).await,
            [Operation::Read(read)] => self.read(address, read).await,
            [Operation::Write(write), Operation::Read(read)] => self.write_read(address, write, read).await,
            // The firmware uses no other shapes.
            _ => Err(BusError::BadLength),
        }
    }
}

impl platform::Bus for BoardBus {
    async fn write_all(
        &mut self,
        writes: &[Write],
        mut stops: impl FnMut(&mut Context<'_>) -> bool,
    ) -> (usize, Result<(), BusError>) {
        let mut sent = 0;
        for writes in writes.chunks(LENGTH) {
            let mut bytes = 0;
            for (place, write) in writes.iter().enumerate() {
                let length = write.bytes().len();
                put(place, start(write.address(), Direction::WRITE, length, Autoend::AUTOMATIC), write.bytes());
                bytes += 1 + length;
            }
            let (more, result) = self.carry_out(writes.len(), bytes, &mut stops).await;
            sent += more;
            if more < writes.len() {
                return (sent, result);
            }
        }
        (sent, Ok(()))
    }

    async fn recover(&mut self) {
        self.wiring.free().await;
    }
}
