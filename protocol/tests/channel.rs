//! Tests of ranges and descriptions of channels, at their edges.

use r4_protocol::{ChannelId, ChannelInfo, ChannelKind, Mode, ModeInfo, Range, Unit};

#[test]
fn a_range_holds_its_ends_and_nothing_that_is_no_number() {
    let range = Range::new(-1.0, 2.0);
    for inside in [-1.0, -0.0, 2.0] {
        assert!(range.contains(inside), "{inside}");
    }
    for outside in [(-1.0f32).next_down(), 2.0f32.next_up(), f32::INFINITY, f32::NAN] {
        assert!(!range.contains(outside), "{outside}");
    }
}

#[test]
fn a_range_without_order_holds_nothing() {
    for range in [Range::new(1.0, -1.0), Range::new(f32::NAN, 1.0), Range::new(-1.0, f32::NAN)] {
        assert!(![-1.0, 0.0, 1.0, f32::NAN].into_iter().any(|value| range.contains(value)), "{range:?}");
    }
}

#[test]
fn a_symmetric_range_goes_as_far_both_ways() {
    assert_eq!(Range::symmetric(2.5), Range::new(-2.5, 2.5));
}

#[test]
fn units_and_modes_are_written_as_users_read_them() {
    use {Mode::*, Unit::*};
    let units = [Rad, RadPerS, M, MPerS, Unit::Duty, V, Bool].map(|unit| unit.to_string());
    assert_eq!(units.join(" "), "rad rad/s m m/s duty V bool");
    let modes = [Position, Speed, Mode::Duty, Mode::Switch, Voltage, Brake, Home].map(|mode| mode.to_string());
    assert_eq!(modes.join(" "), "position speed duty switch voltage brake home");
    let bad = "motor1".parse::<ChannelId>().expect_err("no kind of channel");
    assert!(bad.to_string().contains("osmc0"), "{bad}");
}

#[test]
fn a_channel_says_which_modes_it_has() {
    let speed = ModeInfo { mode: Mode::Speed, unit: Unit::RadPerS, range: Range::symmetric(20.0) };
    let info = ChannelInfo {
        id: ChannelId::new(ChannelKind::Osmc, 0),
        unit: Unit::Rad,
        range: Range::symmetric(8.0),
        rate_hz: 1000.0,
        resolution: 0.0015,
        modes: [speed].into_iter().collect(),
    };
    assert_eq!(info.mode(Mode::Speed), Some(&speed));
    assert_eq!(info.mode(Mode::Duty), None);
}
