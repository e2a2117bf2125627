//! The firmware's screen on the controller's model: the visible picture, and the bus traffic for it.
#![allow(clippy::unwrap_used, reason = "test")]

use std::{
    cell::RefCell,
    env, fs,
    io::Cursor,
    path::{Path, PathBuf},
    rc::Rc,
};

use embedded_hal::{
    delay::DelayNs,
    spi::{Operation, SpiDevice},
};
use mipidsi::{Builder, interface::SpiInterface, models::ILI9488Rgb565};
use proptest::prelude::*;
use r4_firmware::screen::{Bar, Link, MAX_BARS, ScreenPins, Source, Supply, View, draw, run, start};
use r4_protocol::{Cause, Causes, ChannelId, ChannelKind, Range, SafetyState};
use r4_sim::{
    Simulation,
    chips::ili9488::{Picture, ScreenMisuse, ScreenSpi, ScreenWiring},
    misuse::MisuseKind,
};

const MS: u64 = 1_000_000;
/// Fastest clock of the controller, Hz.
const CLOCK_HZ: u32 = 20_000_000;
/// Size of a full picture, bytes, three for each pixel.
const FULL_PICTURE: u64 = 3 * 480 * 320;

/// Bus traffic of a sequence of views, and the picture of the last one.
struct Shown {
    picture: Picture,
    /// Number of bytes for each view.
    bytes: Vec<u64>,
}

/// Draws `views` on one panel, incrementally or completely each time.
fn show(views: &[View<'static>], incremental: bool) -> Shown {
    let mut simulation = Simulation::default();
    let wiring = ScreenWiring::new(simulation.clock(), CLOCK_HZ);
    let bytes = simulation.block_on(async {
        let (spi, data, mut reset, mut buffer) = (wiring.spi(), wiring.data_command(), wiring.reset(), [0; 510]);
        let interface = SpiInterface::new(spi, data, &mut buffer);
        let mut panel = start(interface, &mut reset).await.unwrap();
        let mut last = None;
        let mut bytes = Vec::new();
        for view in views {
            let before = wiring.screen(|screen| screen.bytes());
            draw(&mut panel, view, last.filter(|_| incremental)).unwrap();
            last = Some(view);
            bytes.push(wiring.screen(|screen| screen.bytes()) - before);
        }
        bytes
    });
    wiring.screen(|screen| {
        assert!(screen.misuse().is_empty(), "{:?}", screen.misuse().first());
        Shown { picture: screen.picture().turned(), bytes: bytes.unwrap() }
    })
}

/// Writes `picture` as a PNG, for visual inspection.
fn write_png(path: &Path, picture: &Picture) {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, picture.width as u32, picture.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(&picture.rgb).unwrap();
    fs::write(path, file).unwrap();
}

/// Reads a picture that [`write_png`] has written.
fn read_png(path: &Path) -> Picture {
    let file = fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut reader = png::Decoder::new(Cursor::new(file)).read_info().unwrap();
    let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
    let frame = reader.next_frame(&mut rgb).unwrap();
    assert_eq!((frame.color_type, frame.bit_depth), (png::ColorType::Rgb, png::BitDepth::Eight), "{}", path.display());
    Picture { width: frame.width as usize, height: frame.height as usize, rgb }
}

fn supply(index: u8, volts: f32, min: f32, max: f32) -> Supply {
    Supply { id: ChannelId::new(ChannelKind::Supply, index), volts, range_v: Range::new(min, max) }
}

fn bar(kind: ChannelKind, index: u8, value: f32) -> Bar {
    Bar { id: ChannelId::new(kind, index), value, moving: value != 0.0 }
}

fn causes(all: &[Cause]) -> Causes {
    all.iter().fold(Causes::NONE, |causes, cause| causes.union(Causes::only(*cause)))
}

/// A bench that has just been switched on.
fn disarmed() -> View<'static> {
    View {
        robot: "osmc-bench",
        state: SafetyState::Disarmed,
        causes: Causes::NONE,
        supplies: [supply(0, 24.31, 18.0, 29.4), supply(1, 12.04, 10.5, 14.0)].into_iter().collect(),
        link: Link::NoHost,
        uptime_s: 83,
        bars: [bar(ChannelKind::Osmc, 0, 0.0), bar(ChannelKind::Actuator, 1, 0.0)].into_iter().collect(),
        late_ticks: 0,
        bus_retries: 0,
    }
}

/// A robot with every kind of bar in motion.
fn armed() -> View<'static> {
    View {
        robot: "openpodcar-2",
        state: SafetyState::Armed,
        link: Link::Alive { age_ms: 27 },
        uptime_s: 3 * 3600 + 25 * 60 + 45,
        bars: [
            bar(ChannelKind::Osmc, 0, 0.62),
            bar(ChannelKind::Osmc, 1, -0.35),
            bar(ChannelKind::Actuator, 2, 0.98),
            bar(ChannelKind::Actuator, 3, 0.0),
        ]
        .into_iter()
        .collect(),
        ..disarmed()
    }
}

/// All problems at once, with the longest texts.
fn tripped() -> View<'static> {
    let kinds = [ChannelKind::Actuator, ChannelKind::Stepper, ChannelKind::Servo, ChannelKind::Bldc];
    View {
        robot: "warehouse-tug-with-a-long-name-7",
        state: SafetyState::Tripped,
        causes: causes(&[Cause::SupplyOutOfRange, Cause::EncoderImplausible, Cause::Stalled]),
        supplies: [
            supply(0, 16.82, 18.0, 29.4),
            supply(1, 12.04, 10.5, 14.0),
            supply(2, 5.02, 4.75, 5.25),
            supply(255, -0.1, 100.0, 120.0),
        ]
        .into_iter()
        .collect(),
        link: Link::Lost { age_ms: u32::MAX },
        uptime_s: u32::MAX,
        bars: (0..MAX_BARS)
            .map(|n| bar(kinds[n / 4], if n == 3 { 255 } else { n as u8 }, n as f32 / 7.5 - 1.0))
            .collect(),
        late_ticks: u32::MAX,
        bus_retries: u32::MAX,
    }
}

/// The widest advice, of two lines.
fn stalled() -> View<'static> {
    let bars = (0..6).map(|n| bar(ChannelKind::Dhb, n, 0.3 * f32::from(n) - 0.7)).collect();
    View {
        state: SafetyState::Tripped,
        causes: Causes::only(Cause::Stalled),
        link: Link::Alive { age_ms: 8 },
        bars,
        late_ticks: 3,
        ..armed()
    }
}

/// More causes than fit in a line.
fn all_causes() -> View<'static> {
    View { state: SafetyState::Tripped, causes: causes(&Cause::ALL), ..armed() }
}

/// A trip without a cause, figures at and beyond their limits, including NaN, and the largest number of bars with
/// figures.
fn limits() -> View<'static> {
    let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 7.5, -7.5, 1.0, -1.0, 0.005];
    View {
        state: SafetyState::Tripped,
        supplies: [supply(0, f32::NAN, 9.0, 10.0), supply(1, 9.99, 0.0, 9.99)].into_iter().collect(),
        link: Link::Lost { age_ms: 1999 },
        uptime_s: 86_400,
        bars: (0..).zip(values).map(|(index, value)| bar(ChannelKind::Servo, index, value)).collect(),
        bus_retries: 1,
        ..armed()
    }
}

/// `R4_UPDATE_GOLDEN=1 cargo test -p r4-sim --test all golden` rewrites the golden pictures. No other check judges
/// them: inspect each changed one.
#[test]
fn pictures_are_the_golden_ones() {
    let mut wrong = Vec::new();
    for (name, view) in [
        ("disarmed", disarmed()),
        ("armed", armed()),
        ("tripped", tripped()),
        ("stalled", stalled()),
        ("all-causes", all_causes()),
        ("limits", limits()),
    ] {
        let golden = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/screen-{name}.png"));
        let ours = show(&[view], false).picture;
        if env::var_os("R4_UPDATE_GOLDEN").is_some() {
            write_png(&golden, &ours);
        }
        let wanted = read_png(&golden);
        assert_eq!((ours.width, ours.height), (wanted.width, wanted.height), "{}", golden.display());
        let differ = |(x, y): &(usize, usize)| ours.pixel(*x, *y) != wanted.pixel(*x, *y);
        let pixels = (0..ours.height).flat_map(|y| (0..ours.width).map(move |x| (x, y)));
        if let Some((x, y)) = pixels.clone().find(differ) {
            let seen = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("screen-{name}.png"));
            write_png(&seen, &ours);
            let count = pixels.filter(differ).count();
            wrong.push(format!("{count} pixels from {x}, {y}: {} is not {}", seen.display(), golden.display()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn banner_tells_the_state() {
    for (name, view, colour) in [
        ("disarmed", disarmed(), [88, 92, 100]),
        ("armed", armed(), [0, 136, 64]),
        ("tripped", tripped(), [200, 20, 28]),
        ("stalled", stalled(), [200, 20, 28]),
        ("all-causes", all_causes(), [200, 20, 28]),
    ] {
        let Shown { picture, .. } = show(&[view], false);
        assert_eq!((picture.width, picture.height), (480, 320));
        let near = |seen: [u8; 3]| seen.iter().zip(colour).all(|(seen, wanted)| seen.abs_diff(wanted) <= 4);
        // 18 bits: each part is rounded to a multiple of 4
        for x in 0..480 {
            for y in [27, 105] {
                assert!(near(picture.pixel(x, y)), "{name}: {:?} at {x}, {y}", picture.pixel(x, y));
            }
        }
        // the word: much of it pure white, and a good part of the banner
        let white = (0..480).flat_map(|x| (26..106).map(move |y| (x, y)));
        let white = white.filter(|(x, y)| picture.pixel(*x, *y) == [255; 3]).count();
        assert!((3_000..20_000).contains(&white), "{name}: {white} white pixels");
    }
}

#[test]
fn a_full_picture_has_hardly_more_bytes_than_pixels() {
    let shown = show(&[armed()], true);
    // letters and bars are drawn over a filled screen: less than a third of it is sent twice
    assert!((FULL_PICTURE..FULL_PICTURE * 4 / 3).contains(&shown.bytes[0]), "{} bytes", shown.bytes[0]);
}

#[test]
fn little_news_is_few_bytes() {
    let second = View { uptime_s: armed().uptime_s + 1, link: Link::Alive { age_ms: 31 }, ..armed() };
    let mut moved = second.clone();
    for bar in &mut moved.bars {
        bar.value -= 0.1;
    }
    let views = [armed(), armed(), second, moved, tripped()];
    let Shown { bytes, .. } = show(&views, true);
    assert_eq!(bytes[1], 0, "nothing changed");
    // one digit of 6 by 12 and one of 9 by 18 pixels, each with its window: CASET, PASET, RAMWR with 8 parameters
    assert_eq!(bytes[2], 3 * (6 * 12 + 9 * 18) + 2 * 11);
    // at five pictures a second, four moving bars must leave nine tenths of a 20 MHz bus free
    assert!(bytes[3] < u64::from(CLOCK_HZ) / 8 / 5 / 10, "{} bytes", bytes[3]);
    // a new state changes the banner and the texts
    assert!(bytes[4] < FULL_PICTURE, "{} bytes", bytes[4]);
    println!("bytes: {bytes:?}");
}

fn kinds() -> impl Strategy<Value = ChannelKind> {
    use ChannelKind::*;
    prop::sample::select(vec![Osmc, Actuator, Dhb, Bldc, Servo, Stepper])
}

/// Voltages, including numbers that a broken sensor gives.
fn volts() -> impl Strategy<Value = f32> {
    prop_oneof![8 => 0.0..60.0_f32, 1 => any::<f32>()]
}

prop_compose! {
    fn any_view()(
        robot in prop::sample::select(vec!["osmc-bench", "", "warehouse-tug-with-a-long-name-7", "Chariot élévateur €"]),
        state in prop::sample::select(vec![SafetyState::Disarmed, SafetyState::Armed, SafetyState::Tripped]),
        causes in prop_oneof![2 => Just(0), 1 => any::<u32>(), 2 => (0..17_u32).prop_map(|bit| 1 << bit)],
        supplies in prop::collection::vec((any::<u8>(), volts(), volts(), volts()), 0..=4),
        link in prop_oneof![
            Just(Link::NoHost),
            any::<u32>().prop_map(|age_ms| Link::Alive { age_ms }),
            any::<u32>().prop_map(|age_ms| Link::Lost { age_ms }),
        ],
        uptime_s in prop_oneof![0..100_000_u32, any::<u32>()],
        bars in prop::collection::vec((kinds(), any::<u8>(), prop_oneof![8 => -1.0..1.0_f32, 1 => any::<f32>()], any::<bool>()), 0..=MAX_BARS),
        late_ticks in prop_oneof![Just(0), any::<u32>()],
        bus_retries in prop_oneof![Just(0), any::<u32>()],
    ) -> View<'static> {
        View {
            robot,
            state,
            causes: Causes::from_bits(causes),
            supplies: supplies.into_iter().map(|(index, volts, min, max)| supply(index, volts, min, max)).collect(),
            link,
            uptime_s,
            bars: bars
                .into_iter()
                .map(|(kind, index, value, moving)| Bar { id: ChannelId::new(kind, index), value, moving })
                .collect(),
            late_ticks,
            bus_retries,
        }
    }
}

/// A view and others that differ from it in a few items, as on a running robot.
fn sequences() -> impl Strategy<Value = Vec<View<'static>>> {
    prop::collection::vec((any_view(), any::<u16>()), 2..6).prop_map(|drawn| {
        let mut now = drawn[0].0.clone();
        drawn
            .into_iter()
            .map(|(other, news)| {
                let new = |bit: u16| news & 1 << bit != 0;
                if new(0) && new(1) {
                    now = other;
                } else {
                    now.state = if new(2) { other.state } else { now.state };
                    now.causes = if new(3) { other.causes } else { now.causes };
                    now.supplies = if new(4) { other.supplies } else { now.supplies.clone() };
                    now.link = if new(5) { other.link } else { now.link };
                    now.uptime_s = if new(6) { other.uptime_s } else { now.uptime_s };
                    now.bars = if new(7) { other.bars } else { now.bars.clone() };
                    for bar in now.bars.iter_mut() {
                        bar.value *= if new(8) { -0.7 } else { 1.0 };
                        bar.moving ^= new(9);
                    }
                }
                now.clone()
            })
            .collect()
    })
}

proptest! {
    // each case sends about ten full pictures byte by byte
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn drawing_the_difference_gives_the_full_picture(views in sequences()) {
        let step_by_step = show(&views, true).picture;
        let at_once = show(&views[views.len() - 1..], false).picture;
        if let Some(at) = (0..480 * 320).find(|at| step_by_step.rgb[3 * at..][..3] != at_once.rgb[3 * at..][..3]) {
            prop_assert!(false, "they differ at {}, {}", at % 480, at / 480);
        }
    }
}

/// Delay on the bus's own clock, so that its time advances.
struct BusDelay(ScreenSpi);

impl DelayNs for BusDelay {
    fn delay_ns(&mut self, ns: u32) {
        self.0.transaction(&mut [Operation::DelayNs(ns)]).unwrap();
    }
}

#[test]
fn the_libraries_own_start_breaks_the_datasheet() {
    let wiring = ScreenWiring::new(Simulation::default().clock(), CLOCK_HZ);
    let mut buffer = [0; 510];
    let interface = SpiInterface::new(wiring.spi(), wiring.data_command(), &mut buffer);
    let panel = Builder::new(ILI9488Rgb565, interface).reset_pin(wiring.reset());
    assert!(panel.init(&mut BusDelay(wiring.spi())).is_ok());
    let misuse = wiring.screen(|screen| screen.misuse().first().to_vec());
    let early = misuse.iter().filter(|misuse| {
        matches!(misuse.kind, MisuseKind::Screen(ScreenMisuse::CommandTooEarly { after: Some(0x11), .. }))
    });
    // COLMOD, MADCTL, INVOFF, 0xB6, NORON, DISPON: directly after SLPOUT
    assert_eq!(early.count(), 6);
    // 16 bits per pixel are for parallel interfaces
    let format = MisuseKind::Screen(ScreenMisuse::PixelFormat { value: 0x55 });
    assert!(misuse.iter().any(|misuse| misuse.kind == format));
}

/// Source of views that counts seconds.
struct Uptime(RefCell<u32>);

impl Source for Uptime {
    fn view(&self) -> View<'_> {
        *self.0.borrow_mut() += 1;
        View { robot: "counts", uptime_s: *self.0.borrow(), ..disarmed() }
    }
}

#[test]
fn task_shows_five_pictures_a_second_and_lights_up_with_the_first() {
    let mut simulation = Simulation::default();
    let clock = simulation.clock();
    let wiring = ScreenWiring::new(clock.clone(), CLOCK_HZ);
    let source = Rc::new(Uptime(RefCell::new(0)));
    spawn(&mut simulation, &wiring, source.clone());
    simulation
        .block_on(async {
            clock.sleep_until(239 * MS).await;
            assert!(!wiring.is_lit(), "the panel shows noise");
            clock.sleep_until(241 * MS).await;
            assert!(wiring.is_lit());
            assert_eq!(*source.0.borrow(), 1);
            clock.sleep_until(241 * MS + 1_000 * MS).await;
            assert_eq!(*source.0.borrow(), 6);
        })
        .unwrap();
    wiring.screen(|screen| assert!(screen.misuse().is_empty(), "{:?}", screen.misuse().first()));
}

fn spawn(simulation: &mut Simulation, wiring: &ScreenWiring, source: Rc<Uptime>) {
    let pins = ScreenPins {
        spi: wiring.spi(),
        data_command: wiring.data_command(),
        reset: wiring.reset(),
        backlight: wiring.backlight(),
    };
    simulation.spawn(async move { run(&*source, pins).await });
}

#[test]
fn a_failing_bus_is_left_alone_for_five_seconds_and_the_picture_comes_back() {
    let mut simulation = Simulation::default();
    let clock = simulation.clock();
    let wiring = ScreenWiring::new(clock.clone(), CLOCK_HZ);
    let source = Rc::new(Uptime(RefCell::new(0)));
    wiring.set_fault(true);
    spawn(&mut simulation, &wiring, source.clone());
    simulation
        .block_on(async {
            // fails at SLPOUT, 120 ms after the reset, and tries again 5 s later
            clock.sleep_until(5_100 * MS).await;
            assert_eq!(wiring.faults(), 1);
            clock.sleep_until(5_250 * MS).await;
            assert_eq!(wiring.faults(), 2);
            wiring.set_fault(false);
            clock.sleep_until(10_600 * MS).await;
            assert!(wiring.is_lit());
            // and while it runs
            wiring.set_fault(true);
            clock.sleep_until(11_000 * MS).await;
            assert!(!wiring.is_lit());
            assert_eq!(wiring.faults(), 3);
            wiring.set_fault(false);
            clock.sleep_until(17_000 * MS).await;
            assert!(wiring.is_lit());
        })
        .unwrap();
    let last = View { robot: "counts", uptime_s: *source.0.borrow(), ..disarmed() };
    let picture = wiring.screen(|screen| screen.picture().turned());
    assert_eq!(picture, show(&[last], false).picture);
    wiring.screen(|screen| assert!(screen.misuse().is_empty(), "{:?}", screen.misuse().first()));
}
