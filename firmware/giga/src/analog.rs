//! The processor's analog inputs and outputs.
//!
//! # Inputs
//! ADC1 converts the six inputs over and over, 16 samples to a result in hardware, and DMA writes the results to memory in a
//! circle, so that reading one is reading memory: no interrupt, and nothing to wait for. A sample takes 64.5 + 8.5 cycles of
//! the converter (RM0399, "Channel-wise programmable sampling time"; 16 bits), all six results 7008. That must be done once in a control
//! period of 1 ms, so the converter needs 7.1 MHz at least; sampling then takes 9 µs at most, long enough for the dividers.
//!
//! The kernel clock is divided to at most 16 MHz. Silicon of revision V halves it once more (RM0399, "ADC clock
//! scheme"), that of revision Y does not: 8 to 16 MHz are within what 16 bits allow, and BOOST is set for the higher. So the kernel
//! clock must be a power of two times 16 MHz, or close below: HSI or the crystal.
//!
//! # Outputs
//! Both channels of DAC1, by their registers: embassy's driver resets the converter when it takes it, which would take outputs
//! that [`crate::sweep`] has made safe to 0 V once more. A reset turns the channels off, and their pins float.

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

/// Inputs.
pub const INPUTS: usize = 6;

/// Channels of ADC1, by input.
const CHANNELS: [u8; INPUTS] = [4, 8, 9, 5, 13, 12];

/// Samples to a result, as a power of two.
const OVERSAMPLING_BITS: u8 = 4;

/// Before it is halved, or not.
const CONVERTER_HZ_MAX: u32 = 16_000_000;
/// For all inputs in a control period, also when it is halved.
const CONVERTER_HZ_MIN: u32 = 2 * 7_100_000;

/// The regulator needs 10 µs (data sheet, t_ADCVREG_STUP).
const REGULATOR_WAIT: Duration = Duration::from_millis(1);
/// Offset and linearity take 165 010 cycles of the converter, 23 ms at its slowest.
const CALIBRATION_WAIT: Duration = Duration::from_millis(100);
const ENABLE_WAIT: Duration = Duration::from_millis(1);

/// Where DMA1 and DMA2 write without help.
const AXI_SRAM: core::ops::Range<usize> = 0x2400_0000..0x2408_0000;

/// Why the inputs do not work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum AnalogError {
    /// The kernel clock is too slow, or there is no divider for it.
    Clock,
    /// DMA does not reach the memory for the results.
    Memory,
    /// The converter's regulator does not come up.
    Regulator,
    /// The calibration does not end.
    Calibration,
    /// The converter does not get ready.
    Enable,
}

/// The pins, by input.
pub struct Pins {
    /// `ain0`
    pub input0: Peri<'static, peripherals::PC4>,
    /// `ain1`
    pub input1: Peri<'static, peripherals::PC5>,
    /// `ain2`
    pub input2: Peri<'static, peripherals::PB0>,
    /// `ain3`
    pub input3: Peri<'static, peripherals::PB1>,
    /// `ain4`
    pub input4: Peri<'static, peripherals::PC3>,
    /// `ain5`
    pub input5: Peri<'static, peripherals::PC2>,
}

/// The six analog inputs.
pub struct Inputs {
    codes: *const [u16; INPUTS],
}

impl Inputs {
    /// Calibrates the converter, which takes up to 0.1 s, and starts it. Results go to `codes`, in AXI SRAM.
    ///
    /// # Errors
    /// [`AnalogError`]
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
            // As dropping it would do.
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
        // SAFETY: the memory is DMA's for ever, and read volatile only.
        let transfer =
            unsafe { channel.read_raw(request, ADC1.dr().as_ptr().cast::<u16>(), codes as *mut [u16], options) };
        // Dropping it would stop it.
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

/// Out of power-down, calibrated and ready (RM0399, "ADC deep-power-down", "Calibration", "ADC on-off control").
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

/// All inputs in turn, without end.
fn scan() {
    ADC1.cfgr().modify(|w| {
        w.set_res(Res::BITS16);
        w.set_cont(true);
        w.set_dmngt(Dmngt::DMA_CIRCULAR);
        // A result that DMA did not take in time gives way to the next.
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
        // SAFETY: within the array, which is there for ever; half-words are written and read at once.
        unsafe {
            self.codes.cast::<u16>().add(usize::from(index)).read_volatile()
        }
    }
}

/// The two analog outputs.
pub struct Outputs(());

impl Outputs {
    /// Clocks the converter and leaves it as it is: a channel that is off turns on when it is set.
    #[must_use]
    pub fn start() -> Self {
        critical_section::with(|_| RCC.apb1lenr().modify(|w| w.set_dac12en(true)));
        Self(())
    }

    /// The same with both channels on, at 0 V where nobody has set them.
    #[must_use]
    pub fn new(
        _converter: Peri<'static, peripherals::DAC1>,
        left: Peri<'static, peripherals::PA4>,
        right: Peri<'static, peripherals::PA5>,
    ) -> Self {
        // Analog, as after a reset, and so they stay when `Flex` lets them go.
        drop((Flex::new(left), Flex::new(right)));
        let outputs = Self::start();
        (0..CHANNELS_OUT).for_each(|channel| DAC1.cr().modify(|w| w.set_en(channel, true)));
        outputs
    }
}

/// Channels of DAC1.
const CHANNELS_OUT: usize = 2;

impl AnalogOutputs for Outputs {
    fn set(&mut self, index: u8, code: u16) {
        let channel = usize::from(index);
        if channel < CHANNELS_OUT {
            // Before the channel is turned on, so that it comes up there.
            DAC1.dhr12r(channel).write(|w| w.set_dhr(code.min(4095)));
            DAC1.cr().modify(|w| w.set_en(channel, true));
        }
    }
}
