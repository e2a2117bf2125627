use embedded_hal::i2c::Operation;

use super::*;
use crate::{i2c::I2cBus, misuse::MisuseKind};

struct Bench {
    bus: I2cBus,
    chip: std::rc::Rc<std::cell::RefCell<As5600>>,
    now_ns: u64,
}

impl Bench {
    fn new() -> Self {
        let chip = std::rc::Rc::new(std::cell::RefCell::new(As5600::new(3)));
        let mut bus = I2cBus::new(400_000);
        bus.attach(chip.clone());
        Self { bus, chip, now_ns: 0 }
    }

    fn write(&mut self, bytes: &[u8]) -> bool {
        self.now_ns += 1_000_000;
        self.bus.execute(self.now_ns, 0x36, &mut [Operation::Write(bytes)]).is_ok()
    }

    fn read<const N: usize>(&mut self, register: u8) -> [u8; N] {
        self.now_ns += 1_000_000;
        let mut bytes = [0; N];
        let mut operations = [Operation::Write(&[register]), Operation::Read(&mut bytes)];
        self.bus.execute(self.now_ns, 0x36, &mut operations).expect("it answers");
        bytes
    }

    /// Holds the magnet at an angle until the slowest filter has settled.
    fn turn_to(&mut self, angle_rad: f64) {
        self.chip.borrow_mut().feel(self.now_ns, angle_rad);
        self.now_ns += 20_000_000;
        self.chip.borrow_mut().feel(self.now_ns, angle_rad);
    }
}

#[test]
fn an_angle_is_counts_of_a_turn() {
    let mut bench = Bench::new();
    // A quarter of a count from the next on either side, and five deviations of the slowest filter: 0.015° are 0.17
    // counts.
    for (angle_rad, counts) in [(0.0008, 0), (1.0, 651), (-0.5 / 4096.0 * TAU, 4095), (7.0, 467)] {
        bench.turn_to(angle_rad);
        let [high, low] = bench.read(0x0C);
        let shown = i32::from(u16::from_be_bytes([high, low]));
        let off = (shown - counts + 2048).rem_euclid(4096) - 2048;
        assert!(off.abs() <= 1, "{angle_rad}: {shown}");
        assert_eq!(bench.read::<3>(0x0B), [0x20, high, low], "status and angle in one go");
    }
    assert_eq!(bench.chip.borrow().misuse().first(), []);
}

/// Address pointer rule of page 13.
#[test]
fn a_pointer_that_is_set_to_an_angle_comes_back_to_it() {
    let mut bench = Bench::new();
    bench.turn_to(1.0);
    let [high, low, again_high, again_low] = bench.read(0x0C);
    assert_eq!([high, low], [again_high, again_low]);
    let [.., raw_low, angle_high] = bench.read::<4>(0x0B);
    assert_eq!([raw_low, angle_high], [low, high], "counted on from the status: RAW ANGLE, then ANGLE");
    assert_eq!(bench.read::<1>(0x1A), [64]);
}

#[test]
fn angle_goes_from_zpos_over_its_range() {
    let mut bench = Bench::new();
    bench.turn_to(0.75 * TAU + 0.001);
    for (settings, expected) in [([0x01, 0x04, 0x00], 2048), ([0x05, 0x08, 0x00], 4095)] {
        assert!(bench.write(&settings));
        let [high, low] = bench.read(0x0E);
        let shown = u16::from_be_bytes([high, low]);
        // rounded down, one count of noise, doubled by half the range
        assert!(shown.abs_diff(expected) <= 2, "{shown}, not {expected}");
    }
}

#[test]
fn a_magnet_shows_in_the_status() {
    let mut bench = Bench::new();
    let states =
        [(Magnet::Good, 0x20, 64), (Magnet::Weak, 0x30, 128), (Magnet::Strong, 0x28, 0), (Magnet::Absent, 0x10, 128)];
    for (magnet, status, gain) in states {
        bench.chip.borrow_mut().set_magnet(magnet);
        bench.turn_to(1.0);
        assert_eq!((bench.read(0x0B), bench.read(0x1A)), ([status], [gain]), "{magnet:?}");
    }
}

/// Settling to 95 % in the filter's settling time, with the filter's noise.
#[test]
fn a_filter_settles_and_smooths() {
    for (bits, settling_s, noise_deg) in
        [(0, 2.2e-3, 0.015), (1, 1.1e-3, 0.021), (2, 0.55e-3, 0.030), (3, 0.286e-3, 0.043)]
    {
        let mut bench = Bench::new();
        assert!(bench.write(&[0x07, bits, 0]));
        let mut chip = bench.chip.borrow_mut();
        let step_ns = bench.now_ns;
        chip.feel(step_ns, 1.0);
        chip.feel(step_ns + 1, 2.0);
        chip.feel(step_ns + 1 + (settling_s * 1e9) as u64, 2.0);
        let come = chip.filtered_rad.expect("sampled") - 1.0;
        // a sample is up to 150 us old, or was just taken for the next 150 us
        let least = 1.0 - f64::exp(-3.0 * (settling_s - 150e-6) / settling_s);
        let most = 1.0 - f64::exp(-3.0 * (settling_s + 150e-6) / settling_s);
        assert!((least..most).contains(&come), "{bits}: {come}");
        chip.feel(step_ns + 50_000_000, 2.0);
        let mut sum = [0.0, 0.0];
        for sample in 0..2000 {
            chip.feel(step_ns + 50_000_000 + sample * 150_000, 2.0);
            let off = f64::from(chip.raw) + 0.5 - 2.0 / TAU * 4096.0;
            sum = [sum[0] + off, sum[1] + off * off];
        }
        let deviation = (sum[1] / 2000.0 - (sum[0] / 2000.0).powi(2)).sqrt();
        // Rounding adds a twelfth of a count squared, or almost nothing if the angle is in the middle of a count.
        let noise = noise_deg / 360.0 * 4096.0;
        assert!(deviation < (noise * noise + 0.25f64).sqrt() * 1.1, "{bits}: {deviation}, {noise}");
        assert!(bits < 2 || deviation > 0.7 * noise, "{bits}: {deviation}, {noise}");
    }
}

#[test]
fn what_is_no_register_is_not_acknowledged_and_burning_is_told() {
    let mut bench = Bench::new();
    assert!(!bench.write(&[0x10]));
    assert!(bench.write(&[0xFF, 0x80]));
    let misuse: Vec<_> = bench.chip.borrow().misuse().first().iter().map(|misuse| misuse.kind).collect();
    let expected = [MisuseKind::UnmappedRegister { register: 0x10 }, MisuseKind::ReadOnlyRegister { register: 0xFF }];
    assert_eq!(misuse, expected);
}

#[test]
fn after_power_up_settings_and_samples_are_gone() {
    let mut bench = Bench::new();
    bench.turn_to(1.0);
    assert!(bench.write(&[0x07, 0x03, 0x0C]));
    assert_eq!(bench.read(0x07), [0x03, 0x0C]);
    bench.chip.borrow_mut().power_cycle();
    assert_eq!((bench.read(0x07), bench.read(0x0B)), ([0, 0], [0x10, 0, 0]));
    bench.turn_to(1.0);
    assert_eq!(bench.read(0x0B), [0x20]);
}
