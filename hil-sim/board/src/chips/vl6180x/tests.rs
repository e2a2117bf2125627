use super::*;

const MS: u64 = 1_000_000;

fn put(chip: &mut Vl6180x, register: u16, value: u8) {
    let at_ns = chip.felt_ns;
    I2cChip::start(chip, at_ns, ADDRESS, false);
    let [high, low] = register.to_be_bytes();
    assert!([high, low, value].iter().all(|byte| chip.write(at_ns, *byte)));
    chip.stop(at_ns);
}

fn get<const N: usize>(chip: &mut Vl6180x, register: u16) -> [u8; N] {
    let at_ns = chip.felt_ns;
    I2cChip::start(chip, at_ns, ADDRESS, false);
    assert!(register.to_be_bytes().iter().all(|byte| chip.write(at_ns, *byte)));
    I2cChip::start(chip, at_ns, ADDRESS, true);
    let bytes = [(); N].map(|()| chip.read(at_ns));
    chip.stop(at_ns);
    bytes
}

fn tuned(offset_m: f64) -> Vl6180x {
    let mut chip = Vl6180x::new(5, offset_m);
    for (first, values) in NEEDED {
        (first..).zip(values).for_each(|(register, value)| put(&mut chip, register, *value));
    }
    put(&mut chip, 0x014, 0x04);
    chip
}

fn at(distance_m: f64) -> Option<Target> {
    Some(Target { distance_m, reflectance: 0.17 })
}

/// Status, range, mm, and duration, ns, of one single measurement.
fn single(chip: &mut Vl6180x, target: Option<Target>) -> (u8, u8, u64) {
    put(chip, 0x015, 7);
    put(chip, 0x018, 1);
    let from_ns = chip.felt_ns;
    while get::<1>(chip, 0x04F) != [4] {
        assert!(chip.felt_ns - from_ns < 100 * MS, "it does not end");
        let until_ns = chip.felt_ns + 10_000;
        chip.feel(until_ns, target);
    }
    (get::<1>(chip, 0x04D)[0] >> 4, get::<1>(chip, 0x062)[0], chip.felt_ns - from_ns)
}

#[test]
fn a_range_is_the_distance_with_the_chips_offset() {
    for (offset_m, offset_mm) in [(0.0, 0.0), (0.008, 8.0)] {
        let mut chip = tuned(offset_m);
        for distance_mm in [10.0, 50.0, 100.0, 140.0] {
            let mean = (0..100).map(|_| {
                let (error, millimetres, _) = single(&mut chip, at(distance_mm * 1e-3));
                assert_eq!(error, 0);
                f64::from(millimetres)
            });
            let mean = mean.sum::<f64>() / 100.0;
            // five standard errors of the mean of a hundred
            let tolerance = 5.0 * 0.1 * (distance_mm / 50.0).max(1.0);
            assert!((mean - distance_mm - offset_mm).abs() < tolerance, "{distance_mm} mm: {mean} mm");
        }
    }
}

/// Duration: 3.2 ms, 1.2 ms at 50 mm and four times that at 100 mm, and 4.396 ms of averaging.
#[test]
fn a_range_takes_as_long_as_light_needs_to_come_back() {
    let mut chip = tuned(0.0);
    for (target, ms) in [(at(0.05), 8.796), (at(0.1), 12.396), (None, 56.596)] {
        let (_, _, took_ns) = single(&mut chip, target);
        assert!((took_ns as f64 * 1e-6 - ms).abs() < 0.011, "{target:?}: {took_ns} ns");
    }
}

#[test]
fn what_does_not_reflect_enough_is_no_target() {
    let mut chip = tuned(0.0);
    for target in [None, at(0.4), Some(Target { distance_m: 0.1, reflectance: 0.01 }), at(f64::NAN)] {
        let (error, millimetres, _) = single(&mut chip, target);
        assert_eq!((error, millimetres), (7, 255), "{target:?}");
    }
    let white = Some(Target { distance_m: 0.2, reflectance: 0.88 });
    assert_eq!(single(&mut chip, white).0, 0);
    assert_eq!(single(&mut tuned(-0.03), at(0.01)).0, 14);
    assert_eq!(single(&mut tuned(0.1), white).0, 15);
}

#[test]
fn without_the_settings_of_the_application_note_nothing_is_measured() {
    for (left_out, (run, _)) in NEEDED.into_iter().enumerate() {
        let mut chip = Vl6180x::new(5, 0.0);
        put(&mut chip, 0x014, 0x04);
        for (number, (first, values)) in NEEDED.into_iter().enumerate() {
            let written = values.iter().take(if number == left_out { values.len() - 1 } else { values.len() });
            (first..).zip(written).for_each(|(register, value)| put(&mut chip, register, *value));
        }
        assert_eq!(single(&mut chip, at(0.05)).0, 1, "without the last of {run:#06x}");
    }
}

/// A series with a period of 20 ms, whose flag stays until it is cleared; the next start ends the series.
#[test]
fn a_series_ranges_by_itself_until_it_is_told_to_stop() {
    let mut chip = tuned(0.0);
    put(&mut chip, 0x01B, 1);
    put(&mut chip, 0x018, 3);
    let mut ranges = 0;
    for _ in 0..100 {
        let until_ns = chip.felt_ns + 10 * MS;
        chip.feel(until_ns, at(0.05));
        if get::<1>(&mut chip, 0x04F) == [4] {
            ranges += 1;
            put(&mut chip, 0x015, 1);
            assert_eq!(get::<1>(&mut chip, 0x04F), [0]);
        }
        assert_eq!(get::<1>(&mut chip, 0x04D)[0] & 1, 0, "busy");
    }
    assert_eq!(ranges, 50);
    put(&mut chip, 0x018, 1);
    let until_ns = chip.felt_ns + 30 * MS;
    chip.feel(until_ns, at(0.05));
    put(&mut chip, 0x015, 1);
    let until_ns = chip.felt_ns + 100 * MS;
    chip.feel(until_ns, at(0.05));
    assert_eq!((get::<1>(&mut chip, 0x04D)[0] & 1, get::<1>(&mut chip, 0x04F)[0]), (1, 0), "idle");
}

#[test]
fn the_loss_of_its_supply_is_seen_and_wrong_registers_are_reported() {
    let mut chip = tuned(0.0);
    assert_eq!(get::<1>(&mut chip, 0x016), [0]);
    chip.power_cycle();
    assert_eq!((get::<1>(&mut chip, 0x016), get::<3>(&mut chip, 0x01A)), ([1], [0, 0xFF, 0x31]));
    assert_eq!(chip.misuse().first(), []);
    put(&mut chip, 0x062, 1);
    get::<1>(&mut chip, 0x300);
    let kinds: Vec<_> = chip.misuse().first().iter().map(|misuse| misuse.kind).collect();
    let read_only = MisuseKind::ReadOnlyRegister { register: 0x62 };
    assert_eq!(kinds, [read_only, MisuseKind::UnimplementedRegister { register: 0 }]);
}
