//! The link over CAN: FDCAN2 with classic frames, cut as `r4_protocol::can` says, and its short way for set points.

use core::convert::Infallible;
use core::num::{NonZeroU8, NonZeroU16};

use embassy_stm32::can::{
    BufferedCanReceiver, BufferedCanSender, CanConfigurator, Frame, RxBuf, TxBuf,
    config::{GlobalFilter, NominalBitTiming, TxBufferMode},
    filter::{Action, FilterType, StandardFilter, StandardFilterSlot},
};
use embassy_time::{Duration, Timer};
use embedded_can::Id;
use embedded_io_async::{ErrorType, Read, Write};
use r4_protocol::{
    can::{BITRATES_KBIT, Direction, Inbound, Node, NotTaken, cut},
    config::CanConfig,
};

/// Frames that wait to be read: 7 ms of a full bus.
const RECEIVED: usize = 64;
/// Frames that wait to be sent: one of the longest protocol frames.
const WAITING: usize = 32;
/// After an error of the bus: it lasts, and must not keep the processor.
const PAUSE: Duration = Duration::from_millis(1);

const KERNEL_HZ: u32 = 80_000_000;
/// Quanta of a bit: one to synchronise, and those before and after the sample, at 85 %, which lets the bus be as long as 1 Mbit/s
/// allows. Edges are followed by up to 3 quanta, for a board that runs on its internal oscillator.
const BEFORE_SAMPLE: NonZeroU8 = NonZeroU8::new(16).expect("not 0");
const AFTER_SAMPLE: NonZeroU8 = NonZeroU8::new(3).expect("not 0");
/// As many kernel clocks are a quantum at 1 kbit/s.
const PRESCALER_KBIT: u32 = KERNEL_HZ / 1000 / (1 + BEFORE_SAMPLE.get() + AFTER_SAMPLE.get()) as u32;
// Every rate a configuration may have is exact.
const _: () = {
    let mut index = 0;
    while index < BITRATES_KBIT.len() {
        assert!(PRESCALER_KBIT.is_multiple_of(BITRATES_KBIT[index] as u32));
        index += 1;
    }
};

/// The bit at `kbit_per_s`; `None` for a rate that a valid configuration does not have.
fn timing(kbit_per_s: u16) -> Option<NominalBitTiming> {
    let prescaler = PRESCALER_KBIT.checked_div(kbit_per_s.into())?;
    Some(NominalBitTiming {
        prescaler: NonZeroU16::new(u16::try_from(prescaler).ok()?)?,
        seg1: BEFORE_SAMPLE,
        seg2: AFTER_SAMPLE,
        sync_jump_width: AFTER_SAMPLE,
    })
}

/// Where frames wait.
pub(crate) struct Buffers {
    rx: RxBuf<RECEIVED>,
    tx: TxBuf<WAITING>,
}

impl Buffers {
    /// Nothing waits.
    pub(crate) const fn new() -> Self {
        Self { rx: RxBuf::new(), tx: TxBuf::new() }
    }
}

/// Starts the controller, and gives the two halves of the link.
pub(crate) fn start(
    mut can: CanConfigurator<'static>,
    config: CanConfig,
    buffers: &'static mut Buffers,
) -> (Receiver, Sender) {
    // Neither 0 nor the controller's own timing is taken with a configuration that is valid.
    let node = u8::try_from(config.node).ok().and_then(Node::new).unwrap_or(const { Node::new(0).expect("in range") });
    let timing = timing(config.kbit_per_s);
    let mut registers = can
        .config()
        // In the order of writing: frames of one identifier must not overtake each other.
        .set_tx_buffer_mode(TxBufferMode::Fifo)
        .set_global_filter(GlobalFilter::reject_all())
        .set_automatic_bus_off_recovery(true);
    if let Some(timing) = timing {
        registers = registers.set_nominal_bit_timing(timing);
    }
    can.set_config(registers);
    let (stream, setpoints) = (standard(node.identifier(Direction::ToDevice)), standard(node.setpoint_identifier()));
    let filter = StandardFilter { filter: FilterType::DedicatedDual(stream, setpoints), action: Action::StoreInFifo0 };
    can.properties().set_standard_filter(StandardFilterSlot::_0, filter);
    let can = can.into_normal_mode().buffered(&mut buffers.tx, &mut buffers.rx);
    let (reader, writer) = (can.reader(), can.writer());
    // The halves count as users of the controller, which is switched off when there are none.
    core::mem::forget(can);
    (
        Receiver { frames: reader, inbound: Inbound::new(node), waiting: None },
        Sender { frames: writer, identifier: node.identifier(Direction::ToHost) },
    )
}

fn standard(identifier: u16) -> embedded_can::StandardId {
    // Every identifier of the protocol has 11 bits.
    embedded_can::StandardId::new(identifier).unwrap_or(embedded_can::StandardId::MAX)
}

/// Bytes out of the frames to this board.
pub(crate) struct Receiver {
    frames: BufferedCanReceiver,
    inbound: Inbound,
    /// One that has to wait until the bytes before it are read.
    waiting: Option<Frame>,
}

impl Receiver {
    /// Takes `frame`, or keeps it; false when it is kept.
    fn take(&mut self, frame: Frame) -> bool {
        let Id::Standard(id) = *frame.id() else { return true };
        let full = self.inbound.take(id.as_raw(), frame.data()) == Err(NotTaken::Full);
        if full {
            self.waiting = Some(frame);
        }
        !full
    }

    /// Takes what has come: of set points that were not read in time the newest is followed, and not one after another.
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
                // There was nothing to read: it is taken.
                Ok(envelope) => drop(self.take(envelope.frame)),
                // Passive or off the bus: the controller comes back by itself.
                Err(_) => Timer::after(PAUSE).await,
            }
        }
    }
}

/// Frames to hosts.
pub(crate) struct Sender {
    frames: BufferedCanSender,
    identifier: u16,
}

impl ErrorType for Sender {
    type Error = Infallible;
}

impl Write for Sender {
    /// Done when the frames wait for the bus. While nobody else is on it, nobody acknowledges, and they wait for ever.
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        for data in cut(bytes) {
            // Neither the identifier nor the length is too long.
            if let Ok(frame) = Frame::new_standard(self.identifier, data) {
                self.frames.write(frame).await;
            }
        }
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
