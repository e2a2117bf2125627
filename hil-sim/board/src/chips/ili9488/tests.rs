use super::*;

const MS: u64 = 1_000_000;
/// Duration of a byte at 20 MHz, ns.
const BYTE: u64 = 400;

/// A controller and a time that advances with each byte.
struct Rig {
    chip: Ili9488,
    now_ns: u64,
}

impl Rig {
    fn new() -> Self {
        Self { chip: Ili9488::new(), now_ns: 0 }
    }

    /// A controller after reset, awake and on, with the order and times of the datasheet.
    fn awake() -> Self {
        let mut rig = Self::new();
        rig.pulse(10_000);
        rig.wait(120 * MS);
        rig.send(0x11, &[]);
        rig.wait(5 * MS);
        rig.send(0x29, &[]);
        rig
    }

    fn wait(&mut self, ns: u64) {
        self.now_ns += ns;
    }

    fn pulse(&mut self, ns: u64) {
        self.chip.set_reset(self.now_ns, false);
        self.wait(ns);
        self.chip.set_reset(self.now_ns, true);
    }

    fn byte(&mut self, byte: u8) -> u8 {
        self.wait(BYTE);
        self.chip.transfer(self.now_ns, byte)
    }

    fn send(&mut self, command: u8, data: &[u8]) {
        self.chip.set_data(false);
        self.byte(command);
        self.chip.set_data(true);
        for byte in data {
            self.byte(*byte);
        }
    }

    fn read(&mut self, command: u8, count: usize) -> Vec<u8> {
        self.send(command, &[]);
        (0..count).map(|_| self.byte(0)).collect()
    }

    fn window(&mut self, columns: [u16; 2], pages: [u16; 2]) {
        let bytes = |[start, end]: [u16; 2]| [start.to_be_bytes(), end.to_be_bytes()].concat();
        self.send(0x2A, &bytes(columns));
        self.send(0x2B, &bytes(pages));
    }

    fn misuse(&self) -> Vec<ScreenMisuse> {
        let kinds = self.chip.misuse().first().iter().map(|misuse| misuse.kind);
        kinds.map(|kind| if let MisuseKind::Screen(kind) = kind { kind } else { panic!("{kind:?}") }).collect()
    }
}

const RED: [u8; 3] = [0xFC, 0, 0];

#[test]
fn a_pixel_appears_where_the_address_mode_says() {
    // the glass has its columns from right to left: the memory's column 0 is at its right side
    for (madctl, at) in [
        (0x08, (319 - 3, 7)),
        (0x48, (3, 7)),
        (0x88, (319 - 3, 479 - 7)),
        (0xC8, (3, 479 - 7)),
        (0x28, (319 - 7, 3)),
        (0x68, (7, 3)),
        (0xA8, (319 - 7, 479 - 3)),
        (0xE8, (7, 479 - 3)),
    ] {
        let mut rig = Rig::awake();
        rig.send(0x36, &[madctl]);
        let black = [0; 3 * 320 * 480];
        if madctl & 0x20 == 0 {
            rig.window([0, 319], [0, 479]);
        } else {
            rig.window([0, 479], [0, 319]);
        }
        rig.send(0x2C, &black);
        rig.window([3, 3], [7, 7]);
        rig.send(0x2C, &RED);
        let picture = rig.chip.picture();
        let lit: Vec<_> = (0..480)
            .flat_map(|y| (0..320).map(move |x| (x, y)))
            .filter(|(x, y)| picture.pixel(*x, *y) != [0; 3])
            .collect();
        assert_eq!(lit, [at], "MADCTL 0x{madctl:02X}");
        assert_eq!(picture.pixel(at.0, at.1), [0xFF, 0, 0]);
        assert_eq!(rig.misuse(), []);
    }
}

#[test]
fn windows_fill_row_by_row_over_pauses_and_continue() {
    let mut rig = Rig::awake();
    rig.send(0x36, &[0x48]);
    rig.window([10, 11], [20, 22]);
    rig.send(0x2C, &[RED, [0, 0xFC, 0]].concat());
    rig.wait(MS);
    for byte in [0, 0, 0xFC] {
        rig.byte(byte);
    }
    rig.send(0x3C, &RED);
    let picture = rig.chip.picture();
    let shown = [(10, 20), (11, 20), (10, 21), (11, 21)].map(|(x, y)| picture.pixel(x, y));
    assert_eq!(shown, [[0xFF, 0, 0], [0, 0xFF, 0], [0, 0, 0xFF], [0xFF, 0, 0]]);
    assert_eq!(rig.misuse(), []);
}

#[test]
fn glass_shows_nothing_asleep_or_off_and_negative_when_inverted() {
    let mut rig = Rig::awake();
    rig.send(0x36, &[0x48]);
    rig.window([0, 0], [0, 0]);
    rig.send(0x2C, &RED);
    let corner = |rig: &Rig| rig.chip.picture().pixel(0, 0);
    assert_eq!(corner(&rig), [0xFF, 0, 0]);
    rig.send(0x21, &[]);
    assert_eq!(corner(&rig), [0, 0xFF, 0xFF]);
    rig.send(0x20, &[]);
    rig.send(0x36, &[0x40]);
    assert_eq!(corner(&rig), [0, 0, 0xFF], "without BGR red reaches the blue filter");
    rig.send(0x28, &[]);
    assert_eq!(rig.chip.picture().rgb, vec![0; 3 * 320 * 480]);
    rig.send(0x29, &[]);
    rig.wait(120 * MS);
    rig.send(0x10, &[]);
    assert!(!rig.chip.is_on());
    assert_eq!(rig.misuse(), []);
}

#[test]
fn reads_come_one_bit_late() {
    let mut rig = Rig::awake();
    // 00 94 88 after one idle clock
    assert_eq!(rig.read(0xD3, 4), [0x00, 0x4A, 0x44, 0x00]);
    assert_eq!(rig.read(0x04, 4), [0; 4]);
    // booster on, sleep out, normal mode, display on
    assert_eq!(rig.read(0x0A, 1), [0x9C]);
    rig.send(0x36, &[0x28]);
    assert_eq!(rig.read(0x0B, 1), [0x28]);
    assert_eq!(rig.read(0x0C, 1), [0x66]);
    assert_eq!(rig.misuse(), []);
}

#[test]
fn times_are_watched() {
    let mut rig = Rig::new();
    rig.pulse(4_000);
    assert_eq!(rig.misuse(), [ScreenMisuse::ResetTooShort { low_ns: 4_000, needed_ns: 10_000 }]);

    let early =
        |command, after, waited_ns, needed_ns| ScreenMisuse::CommandTooEarly { command, after, waited_ns, needed_ns };
    // from power-up a reset needs 5 ms; from the awake state 120 ms until SLPOUT
    let mut rig = Rig::awake();
    rig.pulse(10_000);
    rig.wait(119 * MS);
    rig.send(0x11, &[]);
    rig.send(0x3A, &[0x66]);
    rig.wait(5 * MS);
    rig.send(0x10, &[]);
    assert_eq!(
        rig.misuse(),
        [
            early(0x11, None, 119 * MS + BYTE, 120 * MS),
            early(0x3A, Some(0x11), BYTE, 5 * MS),
            early(0x10, Some(0x11), 5 * MS + 3 * BYTE, 120 * MS),
        ]
    );

    let mut rig = Rig::awake();
    rig.send(0x01, &[]);
    rig.send(0x36, &[0x00]);
    assert_eq!(rig.misuse(), [early(0x36, Some(0x01), BYTE, 5 * MS)]);
    assert!(!rig.chip.is_on(), "a software reset puts it to sleep");

    let mut rig = Rig::awake();
    rig.now_ns -= BYTE - 300;
    rig.send(0x00, &[]);
    rig.now_ns -= BYTE - 300;
    rig.send(0x00, &[]);
    assert_eq!(rig.misuse(), [ScreenMisuse::ClockTooFast { byte_ns: 300, needed_ns: 400 }], "told once");
}

#[test]
fn what_it_ignores_is_reported() {
    let mut rig = Rig::awake();
    rig.send(0x5D, &[1]);
    rig.send(0x3A, &[0x55]);
    rig.window([0, 320], [5, 4]);
    rig.send(0x2A, &[0, 0, 0]);
    rig.window([0, 1], [0, 0]);
    rig.send(0x2C, &[0; 7]);
    rig.send(0x2C, &[0; 12]);
    rig.send(0x29, &[]);
    assert_eq!(
        rig.misuse(),
        [
            ScreenMisuse::UnknownCommand { command: 0x5D },
            ScreenMisuse::UnexpectedData { command: Some(0x5D) },
            ScreenMisuse::PixelFormat { value: 0x55 },
            ScreenMisuse::WindowOutside { start: 0, end: 320, size: 320 },
            ScreenMisuse::WindowOutside { start: 5, end: 4, size: 480 },
            ScreenMisuse::ParametersMissing { command: 0x2A, sent: 3, needed: 4 },
            ScreenMisuse::PixelIncomplete,
            ScreenMisuse::PixelsBeyondWindow { window: 2 },
        ]
    );

    let mut rig = Rig::new();
    rig.send(0x2C, &RED);
    assert_eq!(rig.misuse(), [ScreenMisuse::PixelsWhileAsleep]);
}
