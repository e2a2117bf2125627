//! Interrupt of the external lines 10 to 15: the tracks of encoder 3, and the echoes of range sensors 2 and 3.
//!
//! embassy's input with interrupts masks a line until a task has handled it, which would lose edges. So the handler is
//! our own, [`Edges`], bound as `EXTI15_10`. It uses the lines' levels and not their pending bits, so additional calls
//! do no harm. Pending bits are cleared before the levels are read, so that an edge after the reading calls it again.
//!
//! embassy's handler of another vector (the dead-man's handle on line 7) masks and clears *all* lines that it finds
//! pending, also these. [`Restore`] must be bound after it, in the same vector: it unmasks ours and calls the handler
//! for them.
//!
//! A line that the robot does not use stays masked, and so does one with more edges than its [`EdgeBudget`].
//!
//! ```text
//! bind_interrupts!(struct Irqs {
//!     EXTI15_10 => encoders::lines::Edges;
//!     EXTI9_5 => exti::InterruptHandler<typelevel::EXTI9_5>, encoders::lines::Restore;
//! });
//! ```

use core::{cell::RefCell, sync::atomic::Ordering};

use critical_section::{CriticalSection, Mutex};
use embassy_stm32::{
    Peri,
    gpio::{Input, Pull},
    interrupt::{self, InterruptExt, Priority, typelevel},
    pac, peripherals,
};
use r4_firmware::sensing::{
    quadrature::Decoder,
    storm::{ECHO_EDGES_PER_MS, ENCODER_EDGES_PER_MS, EdgeBudget},
};

use crate::{ranging, steppers};

/// Number of port I: the four lines are its pins 10, 11, 14 and 15.
const PORT_I: u8 = 8;
const TRACK_A: usize = 10;
const TRACK_B: usize = 11;
const ECHO_2: usize = 14;
const ECHO_3: usize = 15;
const OURS: [usize; 4] = [TRACK_A, TRACK_B, ECHO_2, ECHO_3];

/// Groups of lines that share a budget of edges: both tracks, each echo.
const GROUPS: [&[usize]; 3] = [&[TRACK_A, TRACK_B], &[ECHO_2], &[ECHO_3]];
/// Edges per millisecond that are accepted for each group.
const EDGES_PER_MS: [u32; 3] = [ENCODER_EDGES_PER_MS, ECHO_EDGES_PER_MS, ECHO_EDGES_PER_MS];

/// Budget of each group; `None` for an unused one.
type Budgets = [Option<EdgeBudget>; 3];

static BUDGETS: Mutex<RefCell<Budgets>> = Mutex::new(RefCell::new([None; 3]));
static DECODER: Mutex<RefCell<Decoder>> = Mutex::new(RefCell::new(Decoder::new()));

/// Pins of the four lines.
pub struct Pins {
    /// Pin `enc3_a` of the carrier.
    pub track_a: Peri<'static, peripherals::PI10>,
    /// Pin `enc3_b` of the carrier.
    pub track_b: Peri<'static, peripherals::PI11>,
    /// Pin `us2_echo` of the carrier.
    pub echo2: Peri<'static, peripherals::PI14>,
    /// Pin `us3_echo` of the carrier.
    pub echo3: Peri<'static, peripherals::PI15>,
}

/// The four lines, with their interrupt enabled.
pub struct Lines(#[expect(dead_code, reason = "holds the pins as they are")] [Input<'static>; 4]);

impl Lines {
    /// Enables the interrupt, at `priority`: above everything that takes longer than the interval between edges. `used`
    /// selects encoder 3, echo 2 and echo 3. The steppers' clock must run.
    #[must_use]
    pub fn new(pins: Pins, used: [bool; 3], priority: Priority) -> Self {
        let inputs = [
            Input::new(pins.track_a, Pull::Up),
            Input::new(pins.track_b, Pull::Up),
            // Pulled down: an echo without a sensor must not look like one that does not end.
            Input::new(pins.echo2, Pull::Down),
            Input::new(pins.echo3, Pull::Down),
        ];
        critical_section::with(|cs| {
            for line in OURS {
                pac::SYSCFG.exticr(line / 4).modify(|w| w.set_exti(line % 4, PORT_I));
                pac::EXTI.rtsr(0).modify(|w| w.set_line(line, true));
                pac::EXTI.ftsr(0).modify(|w| w.set_line(line, true));
            }
            let (a, b) = tracks(pac::GPIOI.idr().read());
            DECODER.borrow_ref_mut(cs).update(a, b);
            let budget = |edges_per_ms| EdgeBudget::new(edges_per_ms, steppers::TICK_HZ / 1000);
            let all = EDGES_PER_MS.into_iter().zip(used).map(|(edges, used)| used.then(|| budget(edges)));
            all.zip(BUDGETS.borrow_ref_mut(cs).iter_mut()).for_each(|(budget, place)| *place = budget);
            set_masks(&BUDGETS.borrow_ref(cs));
        });
        interrupt::EXTI15_10.set_priority(priority);
        #[allow(unsafe_code, reason = "turns an interrupt on")]
        // SAFETY: the handler shares state through critical sections only.
        unsafe {
            interrupt::EXTI15_10.enable();
        }
        // For edges since the levels were read.
        interrupt::EXTI15_10.pend();
        Self(inputs)
    }

    /// Decoder of encoder 3, with its counts.
    #[must_use]
    pub fn encoder(&self) -> Decoder {
        critical_section::with(|cs| *DECODER.borrow_ref(cs))
    }
}

/// Count of encoder 3.
pub(super) fn count(cs: CriticalSection<'_>) -> u16 {
    DECODER.borrow_ref(cs).count()
}

/// Returns for encoder 3, echo 2 and echo 3 whether they have lost edges by a storm, at `now` of the steppers' clock,
/// and unmasks them when it is time. The control loop calls it in every period in which there may be a storm.
pub(crate) fn storms(cs: CriticalSection<'_>, now: u32) -> [bool; 3] {
    let mut budgets = BUDGETS.borrow_ref_mut(cs);
    let mut tried = false;
    let storms = core::array::from_fn(|group| {
        let Some(budget) = &mut budgets[group] else { return false };
        let verdict = budget.look(now);
        tried |= verdict.unmask;
        verdict.storm
    });
    if tried {
        set_masks(&budgets);
        // Handle the present levels.
        interrupt::EXTI15_10.pend();
    }
    storms
}

fn tracks(levels: pac::gpio::regs::Idr) -> (bool, bool) {
    (levels.idr(TRACK_A).to_bits() != 0, levels.idr(TRACK_B).to_bits() != 0)
}

/// Unmasks the lines that have some of their budget left, and masks the others.
fn set_masks(budgets: &Budgets) {
    pac::EXTI.imr(0).modify(|w| {
        for (lines, budget) in GROUPS.into_iter().zip(budgets) {
            lines.iter().for_each(|line| w.set_line(*line, is_open(budget.as_ref())));
        }
    });
}

fn is_open(budget: Option<&EdgeBudget>) -> bool {
    budget.is_some_and(|budget| !budget.is_masked())
}

/// Handler of the `EXTI15_10` vector.
pub struct Edges;

impl typelevel::Handler<typelevel::EXTI15_10> for Edges {
    #[allow(unsafe_code, reason = "the trait's")]
    unsafe fn on_interrupt() {
        let pending = pac::EXTI.pr(0).read();
        pac::EXTI.pr(0).write(|w| OURS.into_iter().for_each(|line| w.set_line(line, true)));
        critical_section::with(|cs| {
            let now = steppers::Clock::ticks();
            let mut budgets = BUDGETS.borrow_ref_mut(cs);
            let mut spent = false;
            for (lines, budget) in GROUPS.into_iter().zip(budgets.iter_mut()) {
                // A masked line is pending, too, when another one calls.
                if let Some(budget) = budget.as_mut().filter(|budget| !budget.is_masked()) {
                    spent |= lines.iter().any(|line| pending.line(*line)) && budget.edge(now);
                }
            }
            let levels = pac::GPIOI.idr().read();
            let (a, b) = tracks(levels);
            if is_open(budgets[0].as_ref()) {
                DECODER.borrow_ref_mut(cs).update(a, b);
            }
            for (echo, line, budget) in [(2, ECHO_2, &budgets[1]), (3, ECHO_3, &budgets[2])] {
                if is_open(budget.as_ref()) {
                    ranging::on_level(cs, echo, levels.idr(line).to_bits() != 0);
                }
            }
            if spent {
                set_masks(&budgets);
                ranging::STORM.store(true, Ordering::Relaxed);
            }
        });
    }
}

/// Handler of `EXTI9_5` and any other vector that embassy's handler uses, to be bound after that.
pub struct Restore;

impl Restore {
    fn restore() {
        critical_section::with(|cs| set_masks(&BUDGETS.borrow_ref(cs)));
        interrupt::EXTI15_10.pend();
    }
}

impl typelevel::Handler<typelevel::EXTI9_5> for Restore {
    #[allow(unsafe_code, reason = "the trait's")]
    unsafe fn on_interrupt() {
        Self::restore();
    }
}
