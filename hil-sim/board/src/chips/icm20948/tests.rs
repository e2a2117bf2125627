use super::*;

/// A chip awake at 112.5 samples a second, ±2 g and ±250 °/s, with filters of 51.2 and 50.4 Hz.
fn awake() -> Icm20948 {
    let mut chip = Icm20948::new(0x68, 1);
    chip.feel(POWER_UP_NS, Truth::default());
    for write in [&[0x7F, 0x00][..], &[0x7F, 0x20], &[0x00, 9, 3 << 3 | 1], &[0x14, 3 << 3 | 1], &[0x7F, 0], &[0x06, 1]]
    {
        put(&mut chip, write);
    }
    chip
}

fn put(chip: &mut Icm20948, bytes: &[u8]) {
    let at_ns = chip.felt_ns;
    assert!(chip.acknowledges(0x68, false));
    chip.start(at_ns, 0x68, false);
    assert!(bytes.iter().all(|byte| chip.write(at_ns, *byte)));
    chip.stop(at_ns);
}

fn get<const N: usize>(chip: &mut Icm20948, register: u8) -> [u8; N] {
    let at_ns = chip.felt_ns;
    put(chip, &[register]);
    chip.start(at_ns, 0x68, true);
    let bytes = std::array::from_fn(|_| chip.read(at_ns));
    chip.stop(at_ns);
    bytes
}

fn counts(chip: &mut Icm20948) -> [i16; 6] {
    let bytes: [u8; 12] = get(chip, 0x2D);
    std::array::from_fn(|axis| i16::from_be_bytes([bytes[2 * axis], bytes[2 * axis + 1]]))
}

/// Samples of `seconds`, each read within 1 ms.
fn run(chip: &mut Icm20948, truth: Truth, seconds: f64) -> Vec<[i16; 6]> {
    let end_ns = chip.felt_ns + (seconds * 1e9) as u64;
    let mut samples = Vec::new();
    while chip.felt_ns < end_ns {
        let until_ns = chip.felt_ns + 1_000_000;
        chip.feel(until_ns, truth);
        if get::<1>(chip, 0x1A) == [1] {
            samples.push(counts(chip));
        }
    }
    samples
}

#[test]
fn a_sample_is_what_the_chip_feels_in_counts_with_the_noise_of_the_data_sheet() {
    let mut chip = awake();
    let truth = Truth { acceleration_m_s2: [0.0, -4.903_325, 9.806_65], rate_rad_s: [0.0, 1.0, -2.0] };
    let samples = run(&mut chip, truth, 40.0);
    // 112.5 a second, the first after one period
    assert!((4495..=4500).contains(&samples.len()), "{}", samples.len());
    // past the settling of the filter: e^-8 of its step remain after 25 ms
    let settled = &samples[10..];
    let expected = [0.0, -8192.0, 16_384.0, 0.0, 57.295_78 * 131.072, -114.591_56 * 131.072];
    // 230 ug and 0.015 °/s, times the square root of pi/2 times 50.4 and 51.2 Hz
    let noise = [230e-6 * 8.898 * 16_384.0, 0.015 * 8.968 * 131.072];
    for axis in 0..6 {
        let values = settled.iter().map(|sample| f64::from(sample[axis]));
        let count = settled.len() as f64;
        let mean = values.clone().sum::<f64>() / count;
        let rms = (values.map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
        // five standard errors of a mean, and of a standard deviation
        assert!((mean - expected[axis]).abs() < 5.0 * noise[axis / 3] / count.sqrt(), "axis {axis}: {mean}");
        assert!((rms / noise[axis / 3] - 1.0).abs() < 5.0 / (2.0 * count).sqrt(), "axis {axis}: {rms}");
    }
    assert_eq!(chip.misuse().first(), []);
}

#[test]
fn the_filter_lets_a_step_through_with_its_bandwidth() {
    let mut chip = awake();
    run(&mut chip, Truth::default(), 1.0);
    let step = Truth { rate_rad_s: [0.0, 0.0, 2.0], ..Truth::default() };
    let begin_ns = chip.felt_ns;
    // time constant of a first-order 51.2 Hz filter, at which it has reached 1 - 1/e
    chip.feel(begin_ns + (1e9 / (TAU * 51.2)) as u64, step);
    let share = chip.filtered[5] / 2.0_f64.to_degrees();
    assert!((share - 0.632_12).abs() < 1e-4, "{share}");
}

#[test]
fn what_does_not_fit_is_clipped() {
    let mut chip = awake();
    let truth = Truth { acceleration_m_s2: [30.0, -30.0, 0.0], rate_rad_s: [5.0, -5.0, 0.0] };
    let samples = run(&mut chip, truth, 0.5);
    let [x, y, _, p, q, _] = *samples.last().expect("some");
    assert_eq!([x, y, p, q], [i16::MAX, i16::MIN, i16::MAX, i16::MIN]);
}

#[test]
fn a_chip_that_starts_answers_nothing_and_one_that_sleeps_measures_nothing() {
    let mut chip = Icm20948::new(0x69, 1);
    chip.feel(POWER_UP_NS - 1, Truth::default());
    assert!(!chip.acknowledges(0x69, false));
    chip.feel(POWER_UP_NS, Truth::default());
    assert!(chip.acknowledges(0x69, false) && !chip.acknowledges(0x68, false));
    let mut chip = awake();
    assert!(!run(&mut chip, Truth::default(), 0.1).is_empty());
    put(&mut chip, &[0x06, 0x41]);
    assert!(run(&mut chip, Truth::default(), 0.1).is_empty());
    put(&mut chip, &[0x06, 0x80]);
    assert!(!chip.acknowledges(0x68, false), "it resets");
}

#[test]
fn registers_there_are_not_and_those_that_cannot_be_written_are_reported() {
    let mut chip = awake();
    put(&mut chip, &[0x00, 0x12]);
    let _: [u8; 1] = get(&mut chip, 0x01);
    let kinds: Vec<_> = chip.misuse().first().iter().map(|misuse| misuse.kind).collect();
    let read_only = MisuseKind::ReadOnlyRegister { register: 0x00 };
    assert_eq!(kinds, [read_only, MisuseKind::UnimplementedRegister { register: 0x01 }]);
    assert_eq!(get(&mut chip, 0x00), [0xEA]);
}
