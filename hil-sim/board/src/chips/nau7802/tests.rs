use super::*;

const MS: u64 = 1_000_000;

fn put(chip: &mut Nau7802, bytes: &[u8]) {
    let at_ns = chip.felt_ns;
    chip.start(at_ns, ADDRESS, false);
    assert!(bytes.iter().all(|byte| chip.write(at_ns, *byte)));
    chip.stop(at_ns);
}

fn get<const N: usize>(chip: &mut Nau7802, register: u8) -> [u8; N] {
    let at_ns = chip.felt_ns;
    chip.start(at_ns, ADDRESS, false);
    assert!(chip.write(at_ns, register));
    chip.start(at_ns, ADDRESS, true);
    let bytes = [(); N].map(|()| chip.read(at_ns));
    chip.stop(at_ns);
    bytes
}

fn code(chip: &mut Nau7802) -> f64 {
    let [high, middle, low] = get(chip, 0x12);
    f64::from(i32::from_be_bytes([high, middle, low, 0]) >> 8)
}

fn is_ready(chip: &mut Nau7802) -> bool {
    get::<1>(chip, 0x00)[0] & 0x20 != 0
}

/// Advances by `ms` with `mv_v` at the input.
fn pass(chip: &mut Nau7802, ms: u64, mv_v: f64) {
    let until_ns = chip.felt_ns + ms * MS;
    chip.feel(until_ns, mv_v);
}

/// A chip at 80 conversions a second with this gain code, its regulator settled, its offset calibrated.
fn set_up(gain: u8) -> Nau7802 {
    let mut chip = Nau7802::new(3);
    put(&mut chip, &[0x00, 0x02]);
    pass(&mut chip, 1, 0.0);
    put(&mut chip, &[0x01, 0x28 | gain, 0x30]);
    put(&mut chip, &[0x00, 0x96]);
    pass(&mut chip, 500, 0.0);
    put(&mut chip, &[0x02, 0x34]);
    pass(&mut chip, 400, 0.0);
    assert_eq!(get::<1>(&mut chip, 0x02), [0x30], "calibrated");
    chip
}

/// Five standard deviations of the noise at 80 conversions a second, counts.
fn tolerance(gain: f64) -> f64 {
    5.0 * 8_f64.sqrt() * 50e-9_f64.hypot(1.5e-6 / gain) * gain / 1.5 * HALF + 1.0
}

#[test]
fn a_code_is_the_ratio_times_the_gain_in_parts_of_half_the_reference() {
    for gain_code in 0..8 {
        let gain = f64::from(1 << gain_code);
        for share in [-0.9, -0.1, 0.0, 0.25, 0.8] {
            let mut chip = set_up(gain_code);
            pass(&mut chip, 100, share * 500.0 / gain);
            let code = code(&mut chip);
            assert!((code - share * HALF).abs() < tolerance(gain), "gain {gain}, {share}: {code}");
            assert_eq!(chip.misuse().first(), []);
        }
    }
}

/// The reference falls with the voltage that feeds the bridge: only the relative noise and offset increase.
#[test]
fn the_regulators_voltage_cancels_out() {
    let mut chip = set_up(7);
    pass(&mut chip, 100, 2.0);
    let before = code(&mut chip);
    put(&mut chip, &[0x01, 0x3F]);
    pass(&mut chip, 100, 2.0);
    let after = code(&mut chip);
    // 2.4 V instead of 3.0 V: 20 uV are 1.67 uV/V more, of 3906, plus the noise
    let more = OFFSET_V * (1.0 / 2.4 - 1.0 / 3.0) / 3.906_25e-3 * HALF;
    assert!((after - before - more).abs() < 2.0 * 1.25 * tolerance(128.0), "{before}, {after}");
}

/// One period after a step a 24th of it is converted, then a half, then all but a 24th.
#[test]
fn a_step_is_told_over_four_conversions_and_so_is_a_change_of_the_gain() {
    let mut chip = set_up(7);
    pass(&mut chip, 100, 0.0);
    // up to the start of a period
    code(&mut chip);
    while !is_ready(&mut chip) {
        let until_ns = chip.felt_ns + 10_000;
        chip.feel(until_ns, 0.0);
    }
    let from = code(&mut chip);
    let full = 2.0 / 3.906_25 * HALF;
    for share in [1.0 / 24.0, 0.5, 23.0 / 24.0, 1.0, 1.0] {
        assert!(!is_ready(&mut chip));
        let until_ns = chip.felt_ns + 12_500_000;
        chip.feel(until_ns, 2.0);
        assert!(is_ready(&mut chip));
        let told = code(&mut chip) - from;
        assert!((told - share * full).abs() < 2.0 * tolerance(128.0) + 1e-3 * HALF, "{share}: {told}");
    }
    // half the gain: the new code settles in the same way
    put(&mut chip, &[0x01, 0x2E]);
    for share in [23.0 / 24.0 + 0.5 / 24.0, 0.75, 0.5 + 0.5 / 24.0, 0.5] {
        let until_ns = chip.felt_ns + 12_500_000;
        chip.feel(until_ns, 2.0);
        let told = code(&mut chip) - from;
        assert!((told - share * full).abs() < 2.0 * tolerance(128.0) + 1e-3 * HALF, "{share}: {told}");
    }
}

#[test]
fn a_conversion_is_ready_once_and_read_again_it_is_the_old_one() {
    let mut chip = set_up(7);
    pass(&mut chip, 100, 1.0);
    assert!(is_ready(&mut chip));
    let first = code(&mut chip);
    assert!(!is_ready(&mut chip));
    assert_eq!(code(&mut chip).to_bits(), first.to_bits());
    pass(&mut chip, 13, 1.0);
    assert!(is_ready(&mut chip));
}

#[test]
fn what_is_beyond_full_scale_is_clipped() {
    let mut chip = set_up(7);
    for (mv_v, end) in [(5.0, HALF), (-5.0, -HALF)] {
        pass(&mut chip, 100, mv_v);
        let code = code(&mut chip);
        // the calibrated offset, 0.17 % of full scale, and the noise
        assert!((code - end).abs() < 2e-3 * HALF + tolerance(128.0), "{mv_v}: {code}");
    }
}

#[test]
fn calibrations_take_offset_and_gain_away_and_tell_what_they_cannot() {
    let mut chip = set_up(7);
    // offset calibration with the present input
    put(&mut chip, &[0x02, 0x36]);
    pass(&mut chip, 300, -0.5);
    assert_eq!(get::<1>(&mut chip, 0x02)[0] & 4, 4, "under way");
    pass(&mut chip, 200, -0.5);
    assert_eq!((get::<1>(&mut chip, 0x02)[0] & 0x0C, get::<1>(&mut chip, 0x03)[0] & 0x80), (0, 0x80));
    assert!(code(&mut chip).abs() < tolerance(128.0));
    // gain calibration: the present input becomes full scale
    put(&mut chip, &[0x02, 0x37]);
    pass(&mut chip, 500, 1.0);
    pass(&mut chip, 100, 0.25);
    let half = code(&mut chip);
    let gain = 3.906_25 / 1.5;
    assert!((half / HALF - 0.5).abs() < 1e-3 + gain * tolerance(128.0) / HALF, "{half}");
    // a negative input has no valid gain
    put(&mut chip, &[0x02, 0x37]);
    pass(&mut chip, 500, -1.0);
    assert_eq!(get::<1>(&mut chip, 0x02)[0] & 0x0C, 8);
}

#[test]
fn it_is_ready_200_us_after_power_up_and_off_after_a_reset() {
    let mut chip = Nau7802::new(3);
    put(&mut chip, &[0x00, 0x02]);
    let until_ns = chip.felt_ns + 199_000;
    chip.feel(until_ns, 0.0);
    assert_eq!(get::<1>(&mut chip, 0x00), [0x02]);
    pass(&mut chip, 1, 0.0);
    assert_eq!(get::<1>(&mut chip, 0x00), [0x0A]);
    let mut chip = set_up(5);
    for reset in [|chip: &mut Nau7802| put(chip, &[0x00, 0x01]), Nau7802::power_cycle] {
        reset(&mut chip);
        pass(&mut chip, 100, 1.0);
        assert_eq!(get::<3>(&mut chip, 0x00).map(|byte| byte & !1), [0, 0, 0]);
        assert_eq!(get::<7>(&mut chip, 0x03), [0, 0, 0, 0, 0x80, 0, 0]);
        assert_eq!(get::<1>(&mut chip, 0x1F), [0x0F]);
    }
}

#[test]
fn registers_there_are_not_and_those_that_cannot_be_written_are_reported() {
    let mut chip = Nau7802::new(3);
    put(&mut chip, &[0x12, 0]);
    get::<1>(&mut chip, 0x1D);
    let kinds: Vec<_> = chip.misuse().first().iter().map(|misuse| misuse.kind).collect();
    let read_only = MisuseKind::ReadOnlyRegister { register: 0x12 };
    assert_eq!(kinds, [read_only, MisuseKind::UnimplementedRegister { register: 0x1D }]);
}
