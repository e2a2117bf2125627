//! Analog inputs and outputs of the processor.
//!
//! # Inputs
//! ADC1 converts the six inputs continuously, with 16 samples per result in hardware, and DMA writes the results to
//! memory in a circle, so that reading an input is reading memory: no interrupt, and no wait. A sample takes 64.5 + 8.5
//! cycles of the converter (RM0399, "Channel-wise programmable sampling time"; 16 bits), all six results 7008. That
//! must be done once in a control period of 1 ms, so the converter needs at least 7.1 MHz; sampling then takes at most
//! 9 µs, long enough for the dividers.
//!
//! The kernel clock is divided to at most 16 MHz. Silicon of revision V halves it once more (RM0399, "ADC clock
//! scheme"), that of revision Y does not: 8 to 16 MHz are within what 16 bits allow, and BOOST is set for the higher.
//! So the kernel clock must be a power of two times 16 MHz, or close below: HSI or the crystal.
//!
//! # Outputs
//! Both channels of DAC1 are driven by their registers: embassy's driver resets the converter when it takes it, which
//! would set outputs that [`crate::sweep`] has made safe to 0 V once more. A reset turns the channels off, and their
//! pins float.

use embassy_stm32::{
    Peri,
    adc::RxDma,
    dma::{self, ChannelInstance, TransferOptions},
    gpio::{AnyPin, Flex},
    interrupt::typelevel::Binding,
    pac::{
        ADC1, ADC12_COMMON, DAC1, RCC,
        adc::vals::{Adcaldif, Boost, Dmngt, Ovrmod, Pcsel, Res, SampleTime},
        adccommon::vals::Presc,
    },
    peripherals, rcc,
};
use embassy_time::{Duration, Instant};
use r4_firmware::platform::{AnalogInputs, AnalogOutputs};

/// Number of analog inputs.
pub const INPUTS: usize = 6;

/// Channels of ADC1, by input.
const CHANNELS: [u8; INPUTS] = [4, 8, 9, 5, 13, 12];

/// Number of samples per result, as a power of two.
const OVERSAMPLING_BITS: u8 = 4;

/// Highest converter clock before the possible halving, Hz.
const CONVERTER_HZ_MAX: u32 = 16_000_000;
/// Lowest converter clock that reads all inputs in a control period, even when it is halved, Hz.
const CONVERTER_HZ_MIN: u32 = 2 * 7_100_000;

/// Time limit for the regulator, which needs 10 µs (data sheet, t_ADCVREG_STUP).
const REGULATOR_WAIT: Duration = Duration::from_millis(1);
/// Time limit for the calibration of offset and linearity: 165 010 cycles of the converter, 23 ms at its slowest.
const CALIBRATION_WAIT: Duration = Duration::from_millis(100);
const ENABLE_WAIT: Duration = Duration::from_millis(1);

/// Memory that DMA1 and DMA2 can write without a detour.
const AXI_SRAM: core::ops::Range<usize> = 0x2400_0000..0x2408_0000;

/// Reason why the inputs do not work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum AnalogError {
    /// The kernel clock is too slow, or there is no divider for it.
    Clock,
    /// DMA does not reach the memory for the results.
    Memory,
    /// The converter's regulator does not start.
    Regulator,
    /// The calibration does not end.
    Calibration,
    /// The converter does not become ready.
    Enable,
}

/// Pins of the inputs, by number.
pub struct Pins {
    /// Pin `ain0` of the carrier.
    pub input0: Peri<'static, peripherals::PC4>,
    /// Pin `ain1` of the carrier.
    pub input1: Peri<'static, peripherals::PC5>,
    /// Pin `ain2` of the carrier.
    pub input2: Peri<'static, peripherals::PB0>,
    /// Pin `ain3` of the carrier.
    pub input3: Peri<'static, peripherals::PB1>,
    /// Pin `ain4` of the carrier.
    pub input4: Peri<'static, peripherals::PC3>,
    /// Pin `ain5` of the carrier.
    pub input5: Peri<'static, peripherals::PC2>,
}

/// Driver of the six analog inputs.
pub struct Inputs {
    codes: *const [u16; INPUTS],
}

impl Inputs {
    /// Calibrates the converter, which takes up to 0.1 s, and starts it. Results go to `codes`, in AXI SRAM.
    ///
    /// # Errors
    /// [`AnalogError`] names the step that failed.
    pub fn new<D: RxDma<peripherals::ADC1> + ChannelInstance>(
        _converter: Peri<'static, peripherals::ADC1>,
        pins: Pins,
        dma: Peri<'static, D>,
        interrupts: impl Binding<D::Interrupt, dma::InterruptHandler<D>> + 'static,
        codes: &'static mut [u16; INPUTS],
    ) -> Result<Self, AnalogError> {
        if !AXI_SRAM.contains(&codes.as_ptr().addr()) {
            return Err(AnalogError::Memory);
        }
        rcc::enable_and_reset::<peripherals::ADC1>();
        let divider = divider(rcc::frequency::<peripherals::ADC1>().0).ok_or(AnalogError::Clock)?;
        let Pins { input0, input1, input2, input3, input4, input5 } = pins;
        let pins: [Peri<'static, AnyPin>; INPUTS] =
            [input0.into(), input1.into(), input2.into(), input3.into(), input4.into(), input5.into()];
        for pin in pins {
            let mut pin = Flex::new(pin);
            pin.set_as_analog();
            // Dropping it would disconnect the pin.
            core::mem::forget(pin);
        }
        start(divider)?;
        scan();
        let request = dma.request();
        let codes = core::ptr::from_mut(codes);
        let mut channel = dma::Channel::new(dma, interrupts);
        let mut options = TransferOptions::default();
        options.circular = true;
        options.half_transfer_ir = false;
        options.complete_transfer_ir = false;
        #[allow(unsafe_code, reason = "DMA")]
        // SAFETY: the memory belongs to DMA permanently, and is only read, by volatile reads.
        let transfer =
            unsafe { channel.read_raw(request, ADC1.dr().as_ptr().cast::<u16>(), codes as *mut [u16], options) };
        // Dropping it would stop the transfer.
        core::mem::forget(transfer);
        ADC1.cr().modify(|w| w.set_adstart(true));
        Ok(Self { codes })
    }
}

fn divider(kernel_hz: u32) -> Option<Presc> {
    let dividers = [
        (1, Presc::DIV1),
        (2, Presc::DIV2),
        (4, Presc::DIV4),
        (6, Presc::DIV6),
        (8, Presc::DIV8),
        (10, Presc::DIV10),
        (12, Presc::DIV12),
        (16, Presc::DIV16),
    ];
    let allowed = CONVERTER_HZ_MIN..=CONVERTER_HZ_MAX;
    dividers.into_iter().find(|(by, _)| allowed.contains(&(kernel_hz / by))).map(|(_, divider)| divider)
}

fn wait(limit: Duration, error: AnalogError, done: impl Fn() -> bool) -> Result<(), AnalogError> {
    let end = Instant::now() + limit;
    while !done() {
        if Instant::now() > end {
            return Err(error);
        }
    }
    Ok(())
}

/// Takes the converter out of power-down, calibrates and enables it (RM0399, "ADC deep-power-down", "Calibration", "ADC
/// on-off control").
fn start(divider: Presc) -> Result<(), AnalogError> {
    ADC12_COMMON.ccr().modify(|w| w.set_presc(divider));
    ADC1.cr().modify(|w| {
        w.set_deeppwd(false);
        w.set_boost(Boost::LT25);
    });
    ADC1.cr().modify(|w| w.set_advregen(true));
    wait(REGULATOR_WAIT, AnalogError::Regulator, || ADC1.isr().read().ldordy())?;
    ADC1.cr().modify(|w| {
        w.set_adcaldif(Adcaldif::SINGLE_ENDED);
        w.set_adcallin(true);
    });
    ADC1.cr().modify(|w| w.set_adcal(true));
    wait(CALIBRATION_WAIT, AnalogError::Calibration, || !ADC1.cr().read().adcal())?;
    ADC1.isr().write(|w| w.set_adrdy(true));
    ADC1.cr().modify(|w| w.set_aden(true));
    wait(ENABLE_WAIT, AnalogError::Enable, || ADC1.isr().read().adrdy())
}

/// Sets up the conversion of all inputs in turn, without end.
fn scan() {
    ADC1.cfgr().modify(|w| {
        w.set_res(Res::BITS16);
        w.set_cont(true);
        w.set_dmngt(Dmngt::DMA_CIRCULAR);
        // A result that DMA did not take in time is overwritten by the next.
        w.set_ovrmod(Ovrmod::OVERWRITE);
    });
    ADC1.cfgr2().modify(|w| {
        w.set_rovse(true);
        w.set_ovsr((1 << OVERSAMPLING_BITS) - 1);
        w.set_ovss(OVERSAMPLING_BITS);
    });
    for channel in CHANNELS {
        let channel = usize::from(channel);
        ADC1.pcsel().modify(|w| w.set_pcsel(channel, Pcsel::PRESELECTED));
        ADC1.smpr(channel / 10).modify(|w| w.set_smp(channel % 10, SampleTime::CYCLES64_5));
    }
    ADC1.sqr1().write(|w| {
        w.set_l(INPUTS as u8 - 1);
        (0..4).for_each(|rank| w.set_sq(rank, CHANNELS[rank]));
    });
    ADC1.sqr2().write(|w| (4..INPUTS).for_each(|rank| w.set_sq(rank - 4, CHANNELS[rank])));
}

impl AnalogInputs for Inputs {
    fn code(&mut self, index: u8) -> u16 {
        if usize::from(index) >= INPUTS {
            return 0;
        }
        #[allow(unsafe_code, reason = "DMA writes it")]
        // SAFETY: within the array, which is never freed; half-words are written and read atomically.
        unsafe {
            self.codes.cast::<u16>().add(usize::from(index)).read_volatile()
        }
    }
}

/// Driver of the two analog outputs.
pub struct Outputs(());

impl Outputs {
    /// Enables the converter's clock and leaves the channels as they are: a channel that is off turns on when it is
    /// set.
    #[must_use]
    pub fn start() -> Self {
        critical_section::with(|_| RCC.apb1lenr().modify(|w| w.set_dac12en(true)));
        Self(())
    }

    /// Creates the driver with both channels on, at 0 V where no code has been set.
    #[must_use]
    pub fn new(
        _converter: Peri<'static, peripherals::DAC1>,
        left: Peri<'static, peripherals::PA4>,
        right: Peri<'static, peripherals::PA5>,
    ) -> Self {
        // Analog mode, as after a reset, which the pins keep when `Flex` is dropped.
        drop((Flex::new(left), Flex::new(right)));
        let outputs = Self::start();
        (0..CHANNELS_OUT).for_each(|channel| DAC1.cr().modify(|w| w.set_en(channel, true)));
        outputs
    }
}

/// Number of channels of DAC1.
const CHANNELS_OUT: usize = 2;

impl AnalogOutputs for Outputs {
    fn set(&mut self, index: u8, code: u16) {
        let channel = usize::from(index);
        if channel < CHANNELS_OUT {
            // The code is set before the channel is turned on, so that it starts there.
            DAC1.dhr12r(channel).write(|w| w.set_dhr(code.min(4095)));
            DAC1.cr().modify(|w| w.set_en(channel, true));
        }
    }
}
