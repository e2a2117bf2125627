//! Link over CAN: FDCAN2, with the byte stream cut into frames by `r4_protocol::can`, and its short frames for set
//! points.
//!
//! Frames are classic, unless the configuration has a rate for the data phase of CAN FD. The board then sends CAN FD,
//! and hosts do from its first frame on; it still accepts classic frames. Without that rate the controller interprets
//! every frame as a classic one and destroys those of CAN FD by an error frame, as every classic node does (RM0399,
//! 59.4.1 "CAN FD operation").
//!
//! A controller that caused too many errors is off the bus (bus-off). [`watch`] lets it return, not its driver: as long
//! as a bus is shorted, 32 failed frames would follow each other immediately, again and again.

use core::convert::Infallible;
use core::num::{NonZeroU8, NonZeroU16};
use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::{
    can::{
        BufferedFdCanReceiver, BufferedFdCanSender, CanConfigurator, RxFdBuf, TxFdBuf,
        config::{DataBitTiming, FrameTransmissionConfig, GlobalFilter, NominalBitTiming, TxBufferMode},
        filter::{Action, FilterType, StandardFilter, StandardFilterSlot},
        frame::{FdFrame, Header},
    },
    interrupt::typelevel::{FDCAN2_IT0, Handler},
    pac::FDCAN2,
};
use embassy_sync::{blocking_mutex::raw::CriticalSectionRawMutex, signal::Signal};
use embassy_time::{Duration, Timer};
use embedded_can::Id;
use embedded_io_async::{ErrorType, Read, Write};
use r4_protocol::{
    can::{BITRATES_KBIT, DATA_RATES_KBIT, Direction, Inbound, Node, NotTaken, cut, cut_fd},
    config::CanConfig,
};

use crate::boot::Board;

/// Maximum number of frames that wait to be read: 7 ms of a full bus.
const RECEIVED: usize = 64;
/// Maximum number of frames that wait to be sent: one of the longest protocol frames.
const WAITING: usize = 32;
/// Pause after a bus error, which lasts and must not keep the processor busy.
const PAUSE: Duration = Duration::from_millis(1);
/// Pause from bus-off to the next attempt: at most 20 attempts per second, each of which costs 32 frames of 0.1 ms.
/// Short compared with the link timeout of a host.
const BUS_OFF_PAUSE: Duration = Duration::from_millis(50);

const KERNEL_HZ: u32 = 80_000_000;
/// Quanta of a bit: one to synchronise, and those before and after the sample, at 85 %, which allows the longest bus at
/// 1 Mbit/s. Edges may be off by up to 3 quanta, for a board that runs on its internal oscillator.
const BEFORE_SAMPLE: NonZeroU8 = NonZeroU8::new(16).expect("not 0");
const AFTER_SAMPLE: NonZeroU8 = NonZeroU8::new(3).expect("not 0");
/// Kernel clocks per quantum at 1 kbit/s.
const PRESCALER_KBIT: u32 = KERNEL_HZ / 1000 / (1 + BEFORE_SAMPLE.get() + AFTER_SAMPLE.get()) as u32;
// Every rate that a configuration may have is exact.
const _: () = {
    let mut index = 0;
    while index < BITRATES_KBIT.len() {
        assert!(PRESCALER_KBIT.is_multiple_of(BITRATES_KBIT[index] as u32));
        index += 1;
    }
};

/// Bit timing at `kbit_per_s`; `None` for a rate that a valid configuration does not have.
fn timing(kbit_per_s: u16) -> Option<NominalBitTiming> {
    let prescaler = PRESCALER_KBIT.checked_div(kbit_per_s.into())?;
    Some(NominalBitTiming {
        prescaler: NonZeroU16::new(u16::try_from(prescaler).ok()?)?,
        seg1: BEFORE_SAMPLE,
        seg2: AFTER_SAMPLE,
        sync_jump_width: AFTER_SAMPLE,
    })
}

/// Quanta of a bit of the data phase before and after its sample, at 80 % (our choice). The transceiver's delay, see
/// `DATA_RATES_KBIT`, is not compensated: it ends before the sample.
const DATA_BEFORE_SAMPLE: NonZeroU8 = NonZeroU8::new(15).expect("not 0");
const DATA_AFTER_SAMPLE: NonZeroU8 = NonZeroU8::new(4).expect("not 0");
const DATA_PRESCALER_KBIT: u32 = KERNEL_HZ / 1000 / (1 + DATA_BEFORE_SAMPLE.get() + DATA_AFTER_SAMPLE.get()) as u32;
// Every rate of the data phase is exact, too, and its prescaler fits DBRP.
const _: () = {
    let mut index = 1;
    while index < DATA_RATES_KBIT.len() {
        let kbit_per_s = DATA_RATES_KBIT[index] as u32;
        assert!(DATA_PRESCALER_KBIT.is_multiple_of(kbit_per_s) && DATA_PRESCALER_KBIT / kbit_per_s <= 31);
        index += 1;
    }
};

/// Bit timing of the data phase; `None` for classic frames only.
fn data_timing(kbit_per_s: u16) -> Option<DataBitTiming> {
    let prescaler = DATA_PRESCALER_KBIT.checked_div(kbit_per_s.into())?;
    Some(DataBitTiming {
        transceiver_delay_compensation: false,
        prescaler: NonZeroU16::new(u16::try_from(prescaler).ok()?)?,
        seg1: DATA_BEFORE_SAMPLE,
        seg2: DATA_AFTER_SAMPLE,
        sync_jump_width: DATA_AFTER_SAMPLE,
    })
}

/// Number of times that the controller went off the bus, and that one of its error counters reached the warning limit.
static BUS_OFF: AtomicU32 = AtomicU32::new(0);
static WARNINGS: AtomicU32 = AtomicU32::new(0);
/// Signal that one of these numbers has changed.
static CHANGED: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Handler that counts the controller's errors. Must be bound before embassy's, which clears the flag of bus-off.
pub(crate) struct OnError;

impl Handler<FDCAN2_IT0> for OnError {
    #[allow(unsafe_code, reason = "the trait's")]
    unsafe fn on_interrupt() {
        let flags = FDCAN2.ir().read();
        if !flags.bo() && !flags.ew() {
            return;
        }
        // Both flags are set by a change in either direction.
        let state = FDCAN2.psr().read();
        if flags.bo() && state.bo() {
            BUS_OFF.fetch_add(1, Ordering::Relaxed);
        }
        if flags.ew() {
            FDCAN2.ir().write(|w| w.set_ew(true));
            if state.ew() {
                WARNINGS.fetch_add(1, Ordering::Relaxed);
            }
        }
        CHANGED.signal(());
    }
}

/// Reports the controller's errors to hosts, and lets it return to the bus after a pause: it then waits by itself for
/// 128 times 11 recessive bits (ISO 11898-1; RM0399, 59.5.13).
pub(crate) async fn watch(shared: &Board) -> ! {
    loop {
        CHANGED.wait().await;
        let count = BUS_OFF.load(Ordering::Relaxed);
        shared.note_can(count, WARNINGS.load(Ordering::Relaxed));
        if FDCAN2.psr().read().bo() {
            defmt::warn!("CAN: off the bus by errors, for the {}. time", count);
            Timer::after(BUS_OFF_PAUSE).await;
            FDCAN2.cccr().modify(|w| w.set_init(false));
        }
    }
}

/// Buffers of waiting frames.
pub(crate) struct Buffers {
    rx: RxFdBuf<RECEIVED>,
    tx: TxFdBuf<WAITING>,
}

impl Buffers {
    /// Creates the empty buffers.
    pub(crate) const fn new() -> Self {
        Self { rx: RxFdBuf::new(), tx: TxFdBuf::new() }
    }
}

/// Starts the controller, and returns the two halves of the link.
pub(crate) fn start(
    mut can: CanConfigurator<'static>,
    config: CanConfig,
    buffers: &'static mut Buffers,
) -> (Receiver, Sender) {
    // With a valid configuration neither the fallback to node 0 nor the controller's own timing is used.
    let node = u8::try_from(config.node).ok().and_then(Node::new).unwrap_or(const { Node::new(0).expect("in range") });
    let timing = timing(config.kbit_per_s);
    let mut registers = can
        .config()
        // In the order of writing: frames of one identifier must not overtake each other.
        .set_tx_buffer_mode(TxBufferMode::Fifo)
        .set_global_filter(GlobalFilter::reject_all())
        .set_automatic_bus_off_recovery(false);
    if let Some(timing) = timing {
        registers = registers.set_nominal_bit_timing(timing);
    }
    let format = match data_timing(config.data_kbit_per_s) {
        None => Format::Classic,
        Some(timing) => {
            let switch = config.data_kbit_per_s != config.kbit_per_s;
            let transmission =
                if switch { FrameTransmissionConfig::AllowFdCanAndBRS } else { FrameTransmissionConfig::AllowFdCan };
            registers = registers.set_data_bit_timing(timing).set_frame_transmit(transmission);
            Format::Fd { switch }
        }
    };
    if format == Format::Classic {
        registers = registers.set_frame_transmit(FrameTransmissionConfig::ClassicCanOnly);
    }
    can.set_config(registers);
    let (stream, setpoints) = (standard(node.identifier(Direction::ToDevice)), standard(node.setpoint_identifier()));
    let filter = StandardFilter { filter: FilterType::DedicatedDual(stream, setpoints), action: Action::StoreInFifo0 };
    can.properties().set_standard_filter(StandardFilterSlot::_0, filter);
    let can = can.into_normal_mode().buffered_fd(&mut buffers.tx, &mut buffers.rx);
    let (reader, writer) = (can.reader(), can.writer());
    // The halves count as users of the controller, which is switched off when there are none.
    core::mem::forget(can);
    FDCAN2.ie().modify(|w| w.set_ewe(true));
    (
        Receiver { frames: reader, inbound: Inbound::new(node), waiting: None },
        Sender { frames: writer, id: standard(node.identifier(Direction::ToHost)).into(), format },
    )
}

fn standard(identifier: u16) -> embedded_can::StandardId {
    // Every identifier of the protocol has 11 bits.
    embedded_can::StandardId::new(identifier).unwrap_or(embedded_can::StandardId::MAX)
}

/// Byte stream from the frames to this board.
pub(crate) struct Receiver {
    frames: BufferedFdCanReceiver,
    inbound: Inbound,
    /// Frame that has to wait until the bytes before it are read.
    waiting: Option<FdFrame>,
}

impl Receiver {
    /// Takes `frame`; false if there is no room and it is kept for later.
    fn take(&mut self, frame: FdFrame) -> bool {
        let Id::Standard(id) = *frame.id() else { return true };
        let full = self.inbound.take(id.as_raw(), frame.data()) == Err(NotTaken::Full);
        if full {
            self.waiting = Some(frame);
        }
        !full
    }

    /// Takes the frames that have arrived: of set points that were not read in time only the newest is followed.
    fn take_waiting(&mut self) {
        if let Some(frame) = self.waiting.take()
            && !self.take(frame)
        {
            return;
        }
        while let Ok(Ok(envelope)) = self.frames.try_receive() {
            if !self.take(envelope.frame) {
                return;
            }
        }
    }
}

impl ErrorType for Receiver {
    type Error = Infallible;
}

impl Read for Receiver {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        loop {
            self.take_waiting();
            match self.inbound.read(buffer) {
                0 if buffer.is_empty() => return Ok(0),
                0 => {}
                len => return Ok(len),
            }
            match self.frames.receive().await {
                // The buffer was empty, so the frame is taken.
                Ok(envelope) => drop(self.take(envelope.frame)),
                // Passive or off the bus: the controller returns by itself.
                Err(_) => Timer::after(PAUSE).await,
            }
        }
    }
}

/// Format of the frames that are sent.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Format {
    Classic,
    /// CAN FD; `switch` gives the data phase a rate of its own.
    Fd {
        switch: bool,
    },
}

/// Byte stream to hosts, in frames.
pub(crate) struct Sender {
    frames: BufferedFdCanSender,
    id: Id,
    format: Format,
}

impl Sender {
    async fn send(&mut self, data: &[u8]) {
        // A piece has at most 64 bytes, and a length that frames can have.
        let length = data.len() as u8;
        let header = match self.format {
            Format::Classic => Header::new(self.id, length, false),
            Format::Fd { switch } => Header::new_fd(self.id, length, false, switch),
        };
        if let Ok(frame) = FdFrame::new(header, data) {
            self.frames.write(frame).await;
        }
    }
}

impl ErrorType for Sender {
    type Error = Infallible;
}

impl Write for Sender {
    /// Completes when the frames wait for the bus. While no other node is on the bus, no acknowledge comes and they
    /// wait indefinitely.
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        if self.format == Format::Classic {
            for data in cut(bytes) {
                self.send(data).await;
            }
        } else {
            for data in cut_fd(bytes) {
                self.send(&data).await;
            }
        }
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
