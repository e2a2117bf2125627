//! Boot: from reset to running tasks.

use core::{
    mem::MaybeUninit,
    sync::atomic::{AtomicBool, Ordering},
};

use cortex_m::peripheral::{NVIC, SYST};
use embassy_executor::Executor;
use embassy_futures::{block_on, join::join};
use embassy_stm32::{
    Peripherals, SharedData, bind_interrupts,
    can::{self, CanConfigurator},
    dma,
    exti::{self, ExtiInput},
    gpio::{Input, Level, Output, Pull, Speed},
    i2c::{ErrorInterruptHandler, EventInterruptHandler, I2c},
    interrupt::typelevel,
    mode::{Async, Blocking},
    pac, peripherals as stm32, rcc,
    spi::{self, Spi},
    time::Hertz,
    usart::{self, UartTx},
    usb,
};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_time::{Duration, Instant, Timer};
use embedded_hal_bus::spi::{ExclusiveDevice, NoDelay};
use r4_firmware::{
    ResetCause, Restart, Shared,
    control::{self, BoardIo},
    link::serve,
    outputs::{OutputFault, rest_dacs},
    passthrough::PassthroughIo,
    screen::{self, ScreenPins},
    storage::parameters::{Saved, load},
    supervisor::{SafetyPins, supervise},
};
use r4_protocol::{ImageInfo, config::BoardConfig};
use static_cell::{ConstStaticCell, StaticCell};

use crate::{
    analog, clocks, cycles,
    encoders::{
        self, Counters, index,
        lines::{self, Lines},
    },
    executors::{self, Executors},
    flash::Bank2,
    guard, hold,
    i2c::{self, BoardBus, Bounce, Bus, Timing, Wiring},
    image,
    links::{Receiver, Sender, can as can_link, uart, usb as usb_link},
    log,
    peripherals::Processor,
    pins::{self, pin},
    ranging::{self, Rangers},
    reset::{self, Mode, Start},
    safety_pins::{Drive, Flashes, Line},
    steppers::{self, Generators},
    supply,
    sweep::{self, Sweeper},
    switches::{self, Switches},
    watchdog,
};

/// SPI clock of the screen: 80 MHz / 4.
const SCREEN_SPI: Hertz = Hertz(20_000_000);
/// Pause before a failed link is served again.
const LINK_PAUSE: Duration = Duration::from_millis(10);
/// Time from a host's request to restart to the restart: the answer has been sent on every link by then.
const FAREWELL: Duration = Duration::from_millis(20);
/// Interval at which the log task checks for a trip.
const LOG_PERIOD: Duration = Duration::from_millis(20);

type Screen = ScreenPins<
    ExclusiveDevice<Spi<'static, Blocking, spi::mode::Master>, Output<'static>, NoDelay>,
    Output<'static>,
    Output<'static>,
    Output<'static>,
>;

/// State that the tasks share.
pub(crate) type Board = Shared<CriticalSectionRawMutex>;

/// Data that embassy shares between the cores; the Cortex-M4 is held in reset (option byte BCM4 = 0).
#[allow(unsafe_code, reason = "a section is chosen by an unsafe attribute")]
// SAFETY: the section is in SRAM4, which is always clocked and may hold any data.
#[unsafe(link_section = ".sram4.shared")]
static EMBASSY: MaybeUninit<SharedData> = MaybeUninit::uninit();

/// Transfer buffers of I2C4 in SRAM4: BDMA, which serves it, reaches no other memory. Start-up does not clear it.
#[allow(unsafe_code, reason = "a section is chosen by an unsafe attribute")]
// SAFETY: as above.
#[unsafe(link_section = ".sram4.i2c4")]
static mut BOUNCE: MaybeUninit<Bounce> = MaybeUninit::uninit();

/// Returns the buffers of I2C4's transfers. Panics at the second call.
fn bounce() -> &'static mut Bounce {
    static TAKEN: ConstStaticCell<()> = ConstStaticCell::new(());
    TAKEN.take();
    #[allow(
        unsafe_code,
        reason = "memory that start-up does not clear cannot be a cell that knows whether it is taken"
    )]
    // SAFETY: nothing else refers to it, and this point is reached once.
    let place = unsafe {
        let memory = &raw mut BOUNCE;
        &mut *memory
    };
    place.write(Bounce::new())
}

bind_interrupts!(struct Irqs {
    EXTI0 => index::Pulse;
    EXTI1 => index::Pulse;
    EXTI2 => index::Pulse;
    // Order matters: the other handlers undo what the first does to lines that are not its own.
    EXTI9_5 => exti::InterruptHandler<typelevel::EXTI9_5>, lines::Restore, index::Restore;
    EXTI15_10 => lines::Edges;
    TIM2 => steppers::OnClock;
    I2C1_EV => EventInterruptHandler<stm32::I2C1>;
    I2C1_ER => ErrorInterruptHandler<stm32::I2C1>;
    I2C2_EV => i2c::OnBoard;
    I2C2_ER => i2c::OnBoard;
    TIM7 => i2c::OnBoard;
    I2C4_EV => EventInterruptHandler<stm32::I2C4>;
    I2C4_ER => ErrorInterruptHandler<stm32::I2C4>;
    // embassy's handler comes first: uart::OnLine corrects its effect on the receiver.
    USART1 => usart::InterruptHandler<stm32::USART1>, uart::OnLine;
    USART2 => usart::InterruptHandler<stm32::USART2>, uart::OnLine;
    UART4 => usart::InterruptHandler<stm32::UART4>, uart::OnLine;
    DMA1_STREAM2 => dma::InterruptHandler<stm32::DMA1_CH2>;
    DMA1_STREAM3 => dma::InterruptHandler<stm32::DMA1_CH3>;
    DMA1_STREAM4 => dma::InterruptHandler<stm32::DMA1_CH4>;
    DMA1_STREAM5 => uart::OnRing;
    DMA1_STREAM6 => dma::InterruptHandler<stm32::DMA1_CH6>;
    DMA1_STREAM7 => uart::OnRing;
    DMA2_STREAM0 => dma::InterruptHandler<stm32::DMA2_CH0>;
    DMA2_STREAM1 => uart::OnRing;
    DMA2_STREAM2 => dma::InterruptHandler<stm32::DMA2_CH2>;
    // Order matters: the second handler clears what the first counts.
    FDCAN2_IT0 => can_link::OnError, can::IT0InterruptHandler<stm32::FDCAN2>;
    FDCAN2_IT1 => can::IT1InterruptHandler<stm32::FDCAN2>;
    OTG_FS => usb::InterruptHandler<stm32::USB_OTG_FS>;
    BDMA_CHANNEL0 => dma::InterruptHandler<stm32::BDMA_CH0>;
    BDMA_CHANNEL1 => dma::InterruptHandler<stm32::BDMA_CH1>;
});

/// True once the time driver runs; earlier log lines have no time.
static CLOCK_RUNS: AtomicBool = AtomicBool::new(false);

defmt::timestamp!("{=u64:us}", if CLOCK_RUNS.load(Ordering::Relaxed) { Instant::now().as_micros() } else { 0 });

/// Start-up hook that runs before 100 KB of memory are cleared: it enables the instruction cache, without which the
/// clearing takes several times as long, and outputs wait for it. ICIALLU invalidates the cache, CCR.IC enables it
/// (ARMv7-M ARM, B2.2.7 and B3.2.8). It is in assembly, because no Rust may run before memory is cleared.
#[allow(unsafe_code, reason = "assembly")]
mod before_memory {
    core::arch::global_asm!(
        ".pushsection .text.__pre_init, \"ax\"",
        ".global __pre_init",
        ".type __pre_init, %function",
        ".thumb_func",
        "__pre_init:",
        "ldr r0, =0xE000EF50",
        "movs r1, #0",
        "dsb",
        "isb",
        "str r1, [r0]",
        "dsb",
        "isb",
        "ldr r0, =0xE000ED14",
        "ldr r1, [r0]",
        "orr r1, r1, #(1 << 17)",
        "str r1, [r0]",
        "dsb",
        "isb",
        "bx lr",
        ".popsection",
    );
}

/// Boots, and runs the tasks indefinitely.
///
/// Outputs come first: `main` has driven the stop lines; then every output chip, and only then steps that take time or
/// may fail.
pub(crate) fn run() -> ! {
    watchdog::start();
    quiet();
    processor();
    sweep::run_from_the_internal_oscillator();
    let mut start = Start::take();
    let swept = make_outputs_safe(start.mode());
    watchdog::allow_boot();
    let image = image::check();
    start.damaged = !image.whole;
    no_speculation();

    // After bad starts the crystal is not used: it may be their cause.
    let source = if start.mode() == Mode::Run { clocks::probe() } else { clocks::Source::Internal };
    let mut config = embassy_stm32::Config::default();
    config.rcc = clocks::config(source);
    config.dma_interrupt_priority = executors::TRANSFERS;
    config.bdma_interrupt_priority = executors::TRANSFERS;
    executors::prioritise();
    let p = embassy_stm32::init_primary(config, &EMBASSY);
    CLOCK_RUNS.store(true, Ordering::Relaxed);
    watchdog::feed();
    paint_stack();
    if source == clocks::Source::Crystal {
        clocks::guard();
    }
    reset::note_clock(source == clocks::Source::Crystal);

    defmt::info!("R4 {} for {=str}, image {}", r4_firmware::FIRMWARE_VERSION, robot_name(), env!("R4_IMAGE_KIND"));
    defmt::info!("start: {}, mode {}", start, start.mode());
    if start.damaged {
        defmt::error!("flash does not hold the image of {} bytes with CRC {:#010x}", image.info.bytes, image.info.crc);
    }
    if swept.is_err() {
        defmt::error!("not every output chip could be told its safe state at the start");
    }
    match source {
        clocks::Source::Crystal => defmt::info!("480 MHz from the crystal"),
        clocks::Source::Internal if start.mode() != Mode::Run => defmt::info!("480 MHz from the internal oscillator"),
        clocks::Source::Internal => {
            defmt::error!("the crystal does not start: 480 MHz from the internal oscillator, 1 % off");
        }
    }
    if supply::brown_out_level() == 0 {
        defmt::warn!("the option bytes have no brown-out reset: docs/bring-up.md, option bytes, BOR_LEV");
    }
    let (shared, screen) = start_tasks(p, &start, image.info, source);
    defmt::info!("tasks run");
    static EXECUTOR: StaticCell<Executor> = StaticCell::new();
    EXECUTOR.init_with(Executor::new).run(|spawner| {
        // The screen's task blocks while it draws, and an absent screen cannot be detected.
        if shared.config().screen {
            spawner.spawn(screen_task(shared, screen).expect("one"));
        }
    })
}

/// Configuration that the image was made with.
fn built_in() -> BoardConfig {
    // Packed with the same types, so unpacking cannot fail; without a configuration nothing could be driven.
    match postcard::from_bytes(image::robot()) {
        Ok(config) => config,
        Err(_) => panic!("the configuration does not unpack"),
    }
}

/// Name in the configuration that the image was made with; saved parameters may give the board another one.
fn robot_name() -> &'static str {
    // The first field of the configuration. The name only labels, so that a damaged one is no reason to stop.
    postcard::take_from_bytes(image::robot()).map_or("", |(name, _)| name)
}

/// Writes the safe state of the built-in configuration to every output chip; does so indefinitely in
/// [`Mode::HoldAlone`].
///
/// A function apart from [`run`], which never returns: the configuration takes kilobytes of the stack.
#[inline(never)]
fn make_outputs_safe(mode: Mode) -> Result<(), OutputFault> {
    let config = built_in();
    if mode == Mode::HoldAlone {
        hold::alone(&config);
    }
    Sweeper::new(cycles::AT_RESET_MHZ).sweep(&config)
}

/// Configuration to run with: the saved one, or in hold mode the built-in one.
///
/// The saved rate of the CAN bus and the board's number on it apply in hold mode, too: with other values the board
/// would disturb the bus on which it is to answer hosts. Flash is only read. If hold mode has also ended badly, the
/// saved configuration is not read.
#[inline(never)]
fn configuration(flash: &mut Bank2, start: &Start, built_in: &BoardConfig) -> BoardConfig {
    let is_held = start.mode() != Mode::Run;
    if is_held && !start.is_first_hold() {
        return built_in.clone();
    }
    let loaded = block_on(load(flash, built_in));
    if is_held {
        return BoardConfig { can: loaded.config.can, ..built_in.clone() };
    }
    match loaded.saved {
        Saved::Nothing => defmt::info!("no saved parameters"),
        Saved::Changes => defmt::info!("{} saved parameters", loaded.changes.values.len()),
        Saved::OtherRobot(robot) => defmt::warn!("saved parameters are for {=str}", robot),
        Saved::NewerLayout(layout) => defmt::warn!("saved parameters have the newer layout {}", layout),
        Saved::Damaged => defmt::error!("saved parameters are damaged"),
    }
    loaded.config
}

/// Creates the state that all tasks share.
///
/// Calls that take configurations by value are in functions of their own: in one function, moving them took two thirds
/// of the stack.
#[inline(never)]
fn board(flash: &mut Bank2, start: &Start, image: ImageInfo) -> &'static Board {
    let built_in = built_in();
    let config = configuration(flash, start, &built_in);
    share(config, built_in, start.cause(), image)
}

#[inline(never)]
fn share(config: BoardConfig, built_in: BoardConfig, reset: ResetCause, image: ImageInfo) -> &'static Board {
    #[allow(unsafe_code, reason = "a section is chosen by an unsafe attribute")]
    // SAFETY: `tcm::load` has cleared the section, and zeros are a new cell; DMA gets no address in it.
    #[unsafe(link_section = ".dtcm.shared")]
    static SHARED: StaticCell<Board> = StaticCell::new();
    SHARED.init_with(|| Shared::new(config, built_in, reset).with_log(log::for_hosts()).with_image(image))
}

/// Creates the drivers and starts all tasks except the screen's, which has the thread to itself; in hold mode starts
/// only those of the links to hosts, and never returns.
///
/// A function apart from [`run`], which never returns: its stack is then free for the tasks.
#[inline(never)]
fn start_tasks(p: Peripherals, start: &Start, image: ImageInfo, source: clocks::Source) -> (&'static Board, Screen) {
    let held = start.mode() != Mode::Run;
    let mut flash = Bank2::new(p.FLASH);
    let shared = board(&mut flash, start, image);
    watchdog::feed();
    let has_ranges = !shared.config().ranges.is_empty();

    let host_tx =
        UartTx::new(p.USART1, pin!(p, uart_dbg_tx as USART1_TX), p.DMA1_CH4, Irqs, uart::config(uart::HOST_BAUD));
    let Ok(host_tx) = host_tx else { panic!("a baud rate cannot be made") };
    let host_rx = uart::receive::<stm32::USART1>(&host_tx, pin!(p, uart_dbg_rx as USART1_RX), p.DMA1_CH5);

    static CAN_BUFFERS: StaticCell<can_link::Buffers> = StaticCell::new();
    let (can_rx, can_tx) = can_link::start(
        CanConfigurator::new(p.FDCAN2, pin!(p, can_rx as FDCAN2_RX), pin!(p, can_tx as FDCAN2_TX), Irqs),
        shared.config().can,
        CAN_BUFFERS.init_with(can_link::Buffers::new),
    );

    static USB_OUT: ConstStaticCell<[u8; 256]> = ConstStaticCell::new([0; 256]);
    let driver = usb::Driver::new_fs(
        p.USB_OTG_FS,
        Irqs,
        pin!(p, usb_dp as USB_OTG_FS_DP),
        pin!(p, usb_dm as USB_OTG_FS_DM),
        USB_OUT.take(),
        usb_link::config(),
    );
    let mut dacs = analog::Outputs::new(p.DAC1, pin!(p, dac_l as DAC1_OUT1), pin!(p, dac_r as DAC1_OUT2));
    rest_dacs(shared.config(), &mut dacs);
    let spawn_links = |executors: &Executors| {
        executors.links.spawn(uart_task(shared, host_rx, host_tx).expect("one"));
        executors.links.spawn(can_task(shared, can_rx, can_tx).expect("one"));
        executors.usb.spawn(usb_task(shared, driver).expect("one"));
        executors.links.spawn(restart_task(shared).expect("one"));
    };
    if held {
        defmt::error!("{}, {} bad starts in a row: outputs are only held safe", start.mode(), start.bad_starts);
        spawn_links(&executors::start());
        hold::beside_links(shared.config());
    }

    let flashes = (source == clocks::Source::Internal).then(|| Flashes::new(3));
    let output = |high: bool| if high { Level::High } else { Level::Low };
    let safety = SafetyPins {
        dead_man: Line::Watched(ExtiInput::new(pin!(p, dmh_sense as EXTI7), p.EXTI7, Pull::Down, Irqs)),
        auxiliary_stop: Line::Polled(Input::new(pin!(p, estop_in), Pull::Down)),
        osmc_disable: Drive::plain(Output::new(pin!(p, osmc_dis), output(true), Speed::Low)),
        pwm_output_disable: Drive::plain(Output::new(pin!(p, pca_oe_n), output(true), Speed::Low)),
        heartbeat: Drive::heartbeat(Output::new(pin!(p, heartbeat_out), output(false), Speed::Low)),
        red: Drive::light(Output::new(pin!(p, led_r), output(true), Speed::Low), flashes),
        green: Drive::light(Output::new(pin!(p, led_g), output(true), Speed::Low), None),
        blue: Drive::light(Output::new(pin!(p, led_b), output(true), Speed::Low), flashes),
    };
    // Low permanently: codes written to the DAC take effect at once.
    core::mem::forget(Output::new(pin!(p, dac_ldac_n), Level::Low, Speed::Low));

    let board_bus = BoardBus::new(
        I2c::new_blocking(
            p.I2C2,
            pin!(p, i2c_board_scl as I2C2_SCL),
            pin!(p, i2c_board_sda as I2C2_SDA),
            Timing::FAST.config(false),
        ),
        p.DMA1_CH0,
        p.TIM7,
        Wiring {
            registers: pac::I2C2,
            reset: rcc::enable_and_reset::<stm32::I2C2>,
            scl: pins::I2C_BOARD_SCL,
            sda: pins::I2C_BOARD_SDA,
            timing: Timing::FAST,
        },
    );
    let connector_a = Bus::new(
        I2c::new(
            p.I2C1,
            pin!(p, i2c_ext_scl as I2C1_SCL),
            pin!(p, i2c_ext_sda as I2C1_SDA),
            p.DMA1_CH2,
            p.DMA1_CH3,
            Irqs,
            Timing::STANDARD.config(true),
        ),
        Wiring {
            registers: pac::I2C1,
            reset: rcc::enable_and_reset::<stm32::I2C1>,
            scl: pins::I2C_EXT_SCL,
            sda: pins::I2C_EXT_SDA,
            timing: Timing::STANDARD,
        },
        None,
    );
    let connector_b = Bus::new(
        I2c::new(
            p.I2C4,
            pin!(p, i2c_ext2_scl as I2C4_SCL),
            pin!(p, i2c_ext2_sda as I2C4_SDA),
            p.BDMA_CH0,
            p.BDMA_CH1,
            Irqs,
            Timing::STANDARD.config(false),
        ),
        Wiring {
            registers: pac::I2C4,
            reset: rcc::enable_and_reset::<stm32::I2C4>,
            scl: pins::I2C_EXT2_SCL,
            sda: pins::I2C_EXT2_SDA,
            timing: Timing::STANDARD,
        },
        Some(bounce()),
    );

    let tx_a =
        UartTx::new(p.USART2, pin!(p, uart_a_tx as USART2_TX), p.DMA1_CH6, Irqs, uart::config(uart::CONNECTOR_BAUD));
    let tx_b =
        UartTx::new(p.UART4, pin!(p, uart_b_tx as UART4_TX), p.DMA2_CH0, Irqs, uart::config(uart::CONNECTOR_BAUD));
    let (Ok(tx_a), Ok(tx_b)) = (tx_a, tx_b) else { panic!("a baud rate cannot be made") };
    let rx_a = uart::receive::<stm32::USART2>(&tx_a, pin!(p, uart_a_rx as USART2_RX), p.DMA1_CH7);
    let rx_b = uart::receive::<stm32::UART4>(&tx_b, pin!(p, uart_b_rx as UART4_RX), p.DMA2_CH1);
    let raw = PassthroughIo { i2c: [connector_a, connector_b], uart_rx: [rx_a, rx_b], uart_tx: [tx_a, tx_b] };

    // The steppers come first: their clock gives the time of an echo's edge.
    let steppers = Generators::new(
        steppers::Parts {
            clock: p.TIM2,
            timers: (p.TIM12, p.TIM14, p.TIM15, p.TIM4),
            steps: (
                pin!(p, step0 as TIM12_CH1),
                pin!(p, step1 as TIM14_CH1),
                pin!(p, step2 as TIM15_CH1),
                pin!(p, step3 as TIM4_CH2),
            ),
            directions: (pin!(p, dir0), pin!(p, dir1), pin!(p, dir2), pin!(p, dir3)),
            enable: pin!(p, step_en),
        },
        executors::STEPS,
    );
    let config = shared.config();
    let switches = Switches::new(switches::Pins {
        switch0: pin!(p, enc0_sw),
        switch1: pin!(p, enc1_sw),
        switch2: pin!(p, enc2_sw),
        switch3: pin!(p, enc3_sw),
    });
    let lines = Lines::new(
        lines::Pins {
            track_a: pin!(p, enc3_a as EXTI10),
            track_b: pin!(p, enc3_b as EXTI11),
            echo2: pin!(p, us2_echo as EXTI14),
            echo3: pin!(p, us3_echo as EXTI15),
        },
        [config.uses_encoder(3), config.uses_range(2), config.uses_range(3)],
        executors::EDGES,
    );
    let encoders = Counters::new(
        encoders::Parts {
            timer0: p.TIM8,
            tracks0: (pin!(p, enc0_a as TIM8_CH1), pin!(p, enc0_b as TIM8_CH2)),
            timer1: p.TIM3,
            tracks1: (pin!(p, enc1_a as TIM3_CH1), pin!(p, enc1_b as TIM3_CH2)),
            timer2: p.TIM1,
            tracks2: (pin!(p, enc2_a as TIM1_CH1), pin!(p, enc2_b as TIM1_CH2)),
        },
        lines,
        core::array::from_fn(|encoder| config.index_active_low(encoder as u8)),
    );
    let rangers = Rangers::new(
        ranging::Pins {
            trigger0: pin!(p, us0_trig),
            trigger1: pin!(p, us1_trig),
            trigger2: pin!(p, us2_trig),
            trigger3: pin!(p, us3_trig),
            echo0: pin!(p, us0_echo as TIM2_CH4),
            echo1: pin!(p, us1_echo as TIM2_CH3),
        },
        [config.uses_range(0), config.uses_range(1)],
        steppers.clock(),
    );
    static CODES: ConstStaticCell<[u16; analog::INPUTS]> = ConstStaticCell::new([0; analog::INPUTS]);
    let inputs = analog::Inputs::new(
        p.ADC1,
        analog::Pins {
            input0: pin!(p, ain0 as ADC1_INP4),
            input1: pin!(p, ain1 as ADC1_INP8),
            input2: pin!(p, ain2 as ADC1_INP9),
            input3: pin!(p, ain3 as ADC1_INP5),
            input4: pin!(p, ain4 as ADC1_INP13),
            input5: pin!(p, ain5 as ADC1_INP12),
        },
        p.DMA2_CH2,
        Irqs,
        CODES.take(),
    );
    if let Err(error) = &inputs {
        defmt::error!("the analog inputs do not work: {}", error);
    }
    let processor =
        Processor { storms: Default::default(), encoders, switches, steppers, inputs: inputs.ok(), outputs: dacs };

    let mut spi_config = spi::Config::default();
    spi_config.frequency = SCREEN_SPI;
    let select = Output::new(pin!(p, tft_cs), Level::High, Speed::Low);
    let spi =
        Spi::new_blocking_txonly(p.SPI1, pin!(p, tft_sck as SPI1_SCK), pin!(p, tft_mosi as SPI1_MOSI), spi_config);
    // Setting the level of the chip select cannot fail.
    let Ok(spi) = ExclusiveDevice::new_no_delay(spi, select);
    let screen = ScreenPins {
        spi,
        data_command: Output::new(pin!(p, tft_dc), Level::Low, Speed::Medium),
        reset: Output::new(pin!(p, tft_rst), Level::High, Speed::Low),
        backlight: Output::new(pin!(p, tft_bl), Level::Low, Speed::Low),
    };

    supply::watch(shared);
    let executors = executors::start();
    watchdog::tighten();
    executors.supervisor.spawn(safety_task(shared, safety).expect("one"));
    executors.control.spawn(control_task(shared, BoardIo { bus: board_bus, peripherals: processor }).expect("one"));
    if has_ranges {
        executors.control.spawn(ranging_task(shared, rangers).expect("one"));
    } else {
        // Dropping them would disconnect the echo pins, at which a motor's angle sensor may send its pulses.
        core::mem::forget(rangers);
    }
    spawn_links(&executors);
    executors.links.spawn(passthrough_task(shared, raw).expect("one"));
    executors.links.spawn(storage_task(shared, flash).expect("one"));
    executors.links.spawn(log_task(shared).expect("one"));
    executors.links.spawn(well_task().expect("one"));
    (shared, screen)
}

#[embassy_executor::task]
async fn safety_task(shared: &'static Board, pins: SafetyPins<Line, Drive>) -> ! {
    supervise(shared, pins).await
}

#[embassy_executor::task]
async fn control_task(shared: &'static Board, io: BoardIo<BoardBus, Processor>) -> ! {
    control::run(shared, io).await
}

#[embassy_executor::task]
async fn ranging_task(shared: &'static Board, hardware: Rangers) -> ! {
    let config = shared.config();
    let publish = |index, reading| shared.publish_range(index, reading);
    r4_firmware::ranging::run(&config.ranges, config.air_temperature_c, hardware, publish).await
}

#[embassy_executor::task]
async fn uart_task(shared: &'static Board, rx: uart::Receiver, tx: UartTx<'static, Async>) -> ! {
    let (mut rx, mut tx) = (Receiver::Uart(rx), Sender::Uart(tx));
    loop {
        serve(shared, 0, &mut rx, &mut tx).await;
        Timer::after(LINK_PAUSE).await;
    }
}

#[embassy_executor::task]
async fn can_task(shared: &'static Board, rx: can_link::Receiver, tx: can_link::Sender) -> ! {
    let (mut rx, mut tx) = (Receiver::Can(rx), Sender::Can(tx));
    let link = async {
        loop {
            serve(shared, 1, &mut rx, &mut tx).await;
            Timer::after(LINK_PAUSE).await;
        }
    };
    join(link, can_link::watch(shared)).await.0
}

#[embassy_executor::task]
async fn usb_task(shared: &'static Board, driver: usb_link::Driver) -> ! {
    static MEMORY: StaticCell<usb_link::Memory> = StaticCell::new();
    let (mut device, rx, tx) = usb_link::start(driver, MEMORY.init_with(usb_link::Memory::new));
    let (mut rx, mut tx) = (Receiver::Usb(rx), Sender::Usb(tx));
    let link = async {
        loop {
            if let Receiver::Usb(rx) = &mut rx {
                rx.wait_connection().await;
            }
            defmt::info!("USB is connected");
            serve(shared, 2, &mut rx, &mut tx).await;
        }
    };
    join(device.run(), link).await.0
}

#[embassy_executor::task]
async fn passthrough_task(shared: &'static Board, io: PassthroughIo<Bus, uart::Receiver, UartTx<'static, Async>>) -> ! {
    shared.passthrough.run(io).await
}

#[embassy_executor::task]
async fn storage_task(shared: &'static Board, flash: Bank2) -> ! {
    r4_firmware::storage::run(&shared.storage, flash, robot_name()).await
}

#[embassy_executor::task]
async fn screen_task(shared: &'static Board, pins: Screen) -> ! {
    screen::run(shared, pins).await
}

/// Writes trips to the debugger's log.
#[embassy_executor::task]
async fn log_task(shared: &'static Board) -> ! {
    let mut trips = shared.trips();
    loop {
        Timer::after(LOG_PERIOD).await;
        if shared.trips() != trips {
            trips = shared.trips();
            defmt::warn!("trip {}: {}", trips, defmt::Display2Format(&shared.trip_causes()));
        }
    }
}

/// Ends the count of bad starts after a good run.
#[embassy_executor::task]
async fn well_task() {
    Timer::after(reset::RUN_WELL).await;
    reset::ran_well();
}

/// Carries out a restart that a host requested; the request is only accepted while the board is not armed.
#[embassy_executor::task]
async fn restart_task(shared: &'static Board) -> ! {
    let restart = shared.restart_requested().await;
    defmt::info!("a host asked for a restart");
    Timer::after(FAREWELL).await;
    if restart == Restart::Bootloader {
        reset::ask_for_bootloader();
    }
    cortex_m::peripheral::SCB::sys_reset()
}

/// Paints the free part of the stack, so that a debugger sees its greatest depth. Not called at the reset, where
/// outputs would wait for it.
#[inline(never)]
fn paint_stack() {
    const PAINT: u32 = 0xCCCC_CCCC;
    /// Bytes below the stack pointer that the compiler may use.
    const MARGIN: usize = 64;
    #[allow(unsafe_code, reason = "a symbol of the linker's, and memory that is nobody's")]
    // SAFETY: only the address of the symbol is used. Below the stack pointer is only the free stack, down to its end;
    // data that an interrupt has left there is not used after its return.
    unsafe {
        unsafe extern "C" {
            safe static _stack_end: u8;
        }
        let end = (&raw const _stack_end).addr() + guard::STACK_BYTES;
        for at in (end..cortex_m::register::msp::read() as usize - MARGIN).step_by(4) {
            core::ptr::with_exposed_provenance_mut::<u32>(at).write_volatile(PAINT);
        }
    }
}

/// Number of words with a bit for each of the 150 interrupts.
const INTERRUPT_WORDS: usize = 5;

/// Clears the state that a bootloader may have left: its tick, its interrupts, and a set interrupt mask.
fn quiet() {
    #[allow(unsafe_code, reason = "no driver owns an interrupt yet")]
    // SAFETY: each bit written disables an interrupt or clears its pending state; no driver and no critical section
    // exists yet.
    unsafe {
        (*SYST::PTR).csr.write(0);
        (*NVIC::PTR).icer.iter().take(INTERRUPT_WORDS).for_each(|interrupts| interrupts.write(u32::MAX));
        (*NVIC::PTR).icpr.iter().take(INTERRUPT_WORDS).for_each(|interrupts| interrupts.write(u32::MAX));
        cortex_m::interrupt::enable();
    }
}

/// Enables the instruction cache and disables the data cache, which the Arduino bootloader may have left on, so that
/// DMA and the processor see the same data. Starts the cycle counter, and guards address 0 and the stack's end.
fn processor() {
    let Some(mut core) = cortex_m::Peripherals::take() else { return };
    if cortex_m::peripheral::SCB::dcache_enabled() {
        core.SCB.disable_dcache(&mut core.CPUID);
    }
    core.SCB.enable_icache();
    cycles::start(&mut core.DCB, &mut core.DWT);
    guard::start(&mut core.MPU);
}

/// Disables the external memory's first bank, which is on after reset: speculative reads of the processor at
/// 0x6000_0000 would wait there for a memory that does not exist.
fn no_speculation() {
    pac::RCC.ahb3enr().modify(|w| w.set_fmcen(true));
    let _ = pac::RCC.ahb3enr().read();
    pac::FMC.bcr1().modify(|w| w.set_mbken(false));
}
