use super::*;

const MS: u64 = 1_000_000;

fn put(chip: &mut Ina226, bytes: &[u8]) {
    let at_ns = chip.felt_ns;
    chip.start(at_ns, 0x45, false);
    assert!(bytes.iter().all(|byte| chip.write(at_ns, *byte)));
    chip.stop(at_ns);
}

fn get(chip: &mut Ina226, register: u8) -> u16 {
    let at_ns = chip.felt_ns;
    put(chip, &[register]);
    chip.start(at_ns, 0x45, true);
    let bytes = [chip.read(at_ns), chip.read(at_ns)];
    chip.stop(at_ns);
    u16::from_be_bytes(bytes)
}

/// Mean of four samples at 1.1 ms each of shunt and bus.
#[test]
fn a_result_is_the_mean_of_its_conversions() {
    let mut chip = Ina226::new(0x45);
    put(&mut chip, &[0x00, 0x43, 0x27]);
    chip.feel(4_400_000, Inputs { shunt_v: 0.010, bus_v: 12.0 });
    assert_eq!(get(&mut chip, 0x06), 0);
    chip.feel(8_800_000, Inputs { shunt_v: -0.002, bus_v: 10.0 });
    assert_eq!((get(&mut chip, 0x06), get(&mut chip, 0x06)), (1 << 3, 0), "ready, and told once");
    // 4 mV in counts of 2.5 uV, 11 V in counts of 1.25 mV
    assert_eq!((get(&mut chip, 0x01), get(&mut chip, 0x02)), (1600, 8800));
    put(&mut chip, &[0x05, 0x08, 0x00]);
    assert_eq!((get(&mut chip, 0x04), get(&mut chip, 0x03)), (1600, 704));
    assert_eq!(chip.misuse().first(), []);
}

#[test]
fn what_does_not_fit_is_clipped() {
    let mut chip = Ina226::new(0x45);
    for (shunt_v, counts) in [(0.1, i16::MAX), (-0.1, i16::MIN)] {
        let until_ns = chip.felt_ns + 10 * MS;
        chip.feel(until_ns, Inputs { shunt_v, bus_v: 50.0 });
        assert_eq!((get(&mut chip, 0x01) as i16, get(&mut chip, 0x02)), (counts, 0x7FFF));
    }
}

#[test]
fn a_reset_and_the_loss_of_its_supply_leave_the_registers_of_power_up() {
    for reset in [|chip: &mut Ina226| put(chip, &[0x00, 0x80, 0x00]), Ina226::power_cycle] {
        let mut chip = Ina226::new(0x45);
        put(&mut chip, &[0x05, 0x12, 0x34]);
        put(&mut chip, &[0x00, 0x0F, 0xFF]);
        assert_eq!((get(&mut chip, 0x05), get(&mut chip, 0x00)), (0x1234, 0x4FFF));
        reset(&mut chip);
        assert_eq!((get(&mut chip, 0x05), get(&mut chip, 0x00)), (0, 0x4127));
        assert_eq!((get(&mut chip, 0xFE), get(&mut chip, 0xFF)), (0x5449, 0x2260));
    }
}

#[test]
fn registers_there_are_not_and_those_that_cannot_be_written_are_reported() {
    let mut chip = Ina226::new(0x45);
    put(&mut chip, &[0x02, 0, 0]);
    get(&mut chip, 0x08);
    let kinds: Vec<_> = chip.misuse().first().iter().map(|misuse| misuse.kind).collect();
    let read_only = MisuseKind::ReadOnlyRegister { register: 0x02 };
    assert_eq!(kinds, [read_only, MisuseKind::UnimplementedRegister { register: 0x08 }]);
}
