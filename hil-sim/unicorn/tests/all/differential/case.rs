//! Test case: a few instructions, and the whole state that they may read.

use std::collections::BTreeMap;

use r4_mcu::Bank;

use super::random::Random;
use super::templates::{ALIGNED, ALONE, DISTINCT, FLOAT, INTEGER, LAST, PLAIN, Template};

/// Address of the instructions, in the middle of flash, so that most branches stay there.
pub(crate) const CODE: u32 = 0x0808_0000;
/// WFI, with which all other flash is filled.
pub(crate) const WFI: u16 = 0xBF30;
/// Address of the data, in the middle of DTCM.
pub(crate) const DATA: u32 = 0x2001_0000;
/// Number of bytes on either side of [`DATA`] that are compared after each case.
pub(crate) const AROUND: u32 = 0x1800;

/// Instructions and initial state of one case.
#[derive(Clone, Debug)]
pub(crate) struct Case {
    pub(crate) code: Vec<u16>,
    /// Template of each instruction except IT, as written.
    pub(crate) templates: Vec<&'static str>,
    /// Values of R0 to R12, and LR at index 14.
    pub(crate) r: [u32; 15],
    pub(crate) msp: u32,
    pub(crate) psp: u32,
    pub(crate) xpsr: u32,
    pub(crate) masks: [u32; 3],
    pub(crate) control: u32,
    pub(crate) fpscr: u32,
    pub(crate) s: [u32; 32],
    pub(crate) data: Vec<u8>,
    /// True if loads from peripherals have no result.
    pub(crate) refused: bool,
    pub(crate) mask_changes: bool,
    pub(crate) fpu: bool,
    /// True if some of it is in an IT block.
    pub(crate) is_conditional: bool,
}

/// Register values that instructions require.
type Wanted = BTreeMap<u8, u32>;

impl Case {
    pub(crate) fn new(seed: u64, index: u64) -> Self {
        let mut random = Random::new(seed, index);
        let random = &mut random;
        let mut wanted = Wanted::new();
        let (mut code, mut templates) = (Vec::new(), Vec::new());
        let mut xpsr = random.word() & 0xF80F_0000 | 1 << 24;
        if random.percent(10) {
            // None of priority -1 and above, in which FAULTMASK cannot be set: the translator sets it.
            xpsr |= random.of(&[4, 11, 15, 16, 40]);
        }
        let mut conditional = 0;
        match random.below(4) {
            // As after a return from an exception into an IT block.
            0 => {
                let (it, count) = it(random);
                xpsr |= (it & 3) << 25 | (it >> 2) << 10;
                conditional = count;
            }
            1 => {
                let (it, count) = it(random);
                code.push(0xBF00 | it as u16);
                conditional = count;
            }
            _ => {}
        }
        let straight = if conditional == 0 { 1 + random.below(4) } else { random.below(2) };
        let count = conditional + straight;
        let mut aligned = false;
        for place in 0..count {
            let last = place + 1 == count || place + 1 == conditional;
            let template = loop {
                let template = if random.percent(50) { any(random, INTEGER) } else { any(random, FLOAT) };
                let fits = |rule| template.rules & rule == 0;
                if (last || fits(LAST)) && (place >= conditional || fits(ALONE)) {
                    break template;
                }
            };
            aligned |= template.rules & ALIGNED != 0;
            let bits = template.fill(random, &mut wanted);
            code.extend((0..template.halfwords()).rev().map(|half| (bits >> (16 * half)) as u16));
            templates.push(template.bits);
        }
        let mut r = [0; 15];
        r.fill_with(|| integer(random));
        for (register, value) in wanted {
            r[usize::from(register)] = value;
        }
        let mut s = [0; 32];
        fill_floats(random, &mut s);
        let data = (0..AROUND / 2).flat_map(|_| datum(random).to_le_bytes()).collect();
        Self {
            code,
            templates,
            r,
            msp: DATA - 0x400 + random.below(64) * 4,
            psp: DATA + 0x200 + random.below(64) * 4,
            xpsr,
            masks: [random.below(2), random.of(&[0, 0, 0x10, 0xF0]), u32::from(random.percent(5))],
            control: u32::from(random.percent(10))
                | if xpsr & 0x1FF == 0 { random.below(2) << 1 } else { 0 }
                | u32::from(conditional != 0 || random.percent(80)) << 2,
            fpscr: match random.below(4) {
                0 => 0,
                1 => 0x10,
                2 => random.word() & 0xF000_009F,
                _ => random.word() & 0xF7C0_009F,
            },
            s,
            data,
            // The architecture does not define which of several registers were loaded before.
            refused: !aligned && random.percent(10),
            mask_changes: random.percent(30),
            is_conditional: conditional != 0,
            fpu: conditional != 0 || random.percent(95),
        }
    }

    /// Pairs of halfwords, of which some are wide instructions.
    pub(crate) fn words(&self) -> impl Iterator<Item = (u16, u16)> {
        self.code.windows(2).map(|pair| (pair[0], pair[1]))
    }
}

fn any(random: &mut Random, templates: &'static [Template]) -> &'static Template {
    &templates[random.below(templates.len() as u32) as usize]
}

/// Condition and mask of an IT (A7.7.38), and number of instructions in its block.
fn it(random: &mut Random) -> (u32, u32) {
    let condition = random.below(15);
    let count = 1 + random.below(4);
    let mut mask = 1 << (4 - count);
    for place in 1..count {
        // AL has no else: the bit is then the condition's lowest.
        let other = condition == 14 || random.percent(50);
        let bit = if condition == 14 { 0 } else { u32::from(other) };
        mask |= bit << (4 - place);
    }
    (condition << 4 | mask, count)
}

/// Samples the value of a core register.
fn integer(random: &mut Random) -> u32 {
    const EDGES: [u32; 14] =
        [0, 1, 2, 31, 32, 0x7F, 0x80, 0x7FFF, 0x8000, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF, 0xFFFF_8000, 0x8000_8000];
    match random.below(4) {
        0 => random.of(&EDGES),
        1 => random.below(300),
        _ => random.word(),
    }
}

/// Samples a word of data, sometimes an address of code, for instructions that load PC.
fn datum(random: &mut Random) -> u32 {
    match random.below(4) {
        0 => target(random),
        1 => random.below(0x40) * 0x0101_0101,
        _ => random.word(),
    }
}

fn target(random: &mut Random) -> u32 {
    match random.below(16) {
        0 => CODE + 0x100 * random.below(0x100),
        1 => random.of(&[0xFFFF_FFF1, 0xFFFF_FFF9, 0xFFFF_FFFD, 0xFFFF_FFED, 0xFFFF_FFE9]),
        2 => DATA | 1,
        _ => (CODE + 0x40 + 2 * random.below(0x1000)) | 1,
    }
}

/// Samples an address for loads and stores.
fn pointer(random: &mut Random, aligned: bool, plain: bool) -> u32 {
    let base = match random.below(if plain { 8 } else { 12 }) {
        0..8 => DATA,
        8 | 9 => 0x4000_8000,
        10 => Bank::Flash2.span().0 + 0x8000,
        _ => Bank::Storage.span().0 + 0x8000,
    };
    let unaligned = if aligned || random.percent(60) { 0 } else { random.below(4) };
    base + 4 * random.below(64) + unaligned
}

/// Fills the registers with floats of all kinds, single and double in turns.
fn fill_floats(random: &mut Random, s: &mut [u32; 32]) {
    let mut at = 0;
    while at < 32 {
        if random.percent(50) || at == 31 {
            s[at] = match random.below(8) {
                0 if at > 0 => s[at - 1] ^ random.of(&[0, 0x8000_0000, 1]),
                _ => single(random),
            };
            at += 1;
        } else {
            let bits = match random.below(8) {
                0 if at > 1 => {
                    let before = u64::from(s[at - 2]) | u64::from(s[at - 1]) << 32;
                    before ^ random.of(&[0, 1 << 63, 1])
                }
                _ => double(random),
            };
            (s[at], s[at + 1]) = (bits as u32, (bits >> 32) as u32);
            at += 2;
        }
    }
}

fn single(random: &mut Random) -> u32 {
    let sign = random.below(2) << 31;
    sign | match random.below(8) {
        0 => random.of(&[
            0,
            0x7F80_0000,
            0x7FC0_0000,
            0x7F80_0001,
            0x7FFF_FFFF,
            1,
            0x007F_FFFF,
            0x0080_0000,
            0x7F7F_FFFF,
        ]),
        1 => random.below(0x80_0000),
        2 => (random.below(2000) as f32 / random.of(&[1.0, 2.0, 4.0, 8.0, 3.0])).to_bits(),
        // Near the range limits of integers, and of half precision.
        3 => (random.of(&[31, 32, 15, 16, 30]) as f32).exp2().to_bits() + random.below(5) - 2,
        4 => (127 - 28 + random.below(45)) << 23 | random.word() & 0x7F_FFFF,
        5 => {
            random.of(&[0x3800_0000, 0x3880_0000, 0x4780_0000, 0x3300_0000, 0x477F_E000, 0x477F_F000]) + random.below(3)
        }
        _ => random.word() >> 1,
    }
}

fn double(random: &mut Random) -> u64 {
    let sign = u64::from(random.below(2)) << 63;
    const INFINITY: u64 = 0x7FF << 52;
    sign | match random.below(8) {
        0 => random.of(&[0, INFINITY, INFINITY | 1 << 51, INFINITY | 1, 1, (1 << 52) - 1, 1 << 52, INFINITY - 1]),
        1 => random.next() >> 12,
        2 => (f64::from(random.below(2000)) / random.of(&[1.0, 2.0, 4.0, 8.0, 3.0])).to_bits(),
        3 => f64::from(random.of(&[31, 32, 15, 16, 30])).exp2().to_bits() + u64::from(random.below(5)) - 2,
        4 => u64::from(1023 - 28 + random.below(45)) << 52 | random.next() >> 12,
        // Exactly or nearly representable as a float.
        5 => f64::from(f32::from_bits(single(random) & 0x7FFF_FFFF)).to_bits() ^ u64::from(random.below(2)),
        _ => random.next() >> 1,
    }
}

impl Template {
    fn digits(&self) -> impl Iterator<Item = char> {
        self.bits.chars().filter(|digit| *digit != ' ')
    }

    fn halfwords(&self) -> usize {
        self.digits().count() / 16
    }

    /// Samples the fields of a template and returns its bits; adds the register values that it requires to `wanted`.
    fn fill(&self, random: &mut Random, wanted: &mut Wanted) -> u128 {
        loop {
            let mut fields = BTreeMap::new();
            for digit in self.digits().filter(char::is_ascii_alphabetic) {
                *fields.entry(digit).or_insert(0_u32) += 1;
            }
            let mut drawn: BTreeMap<char, u32> =
                fields.iter().map(|(letter, len)| (*letter, draw(random, *letter, *len))).collect();
            let registers: Vec<u32> = "bdntmauipf".chars().filter_map(|letter| drawn.get(&letter).copied()).collect();
            let repeated = (1..registers.len()).any(|at| registers[..at].contains(&registers[at]));
            if self.rules & DISTINCT != 0 && repeated {
                continue;
            }
            if let (Some(list), Some(base)) = (drawn.get(&'l').copied(), drawn.get(&'b')) {
                let list = list & !(1 << base);
                if list.count_ones() < 2 {
                    continue;
                }
                drawn.insert('l', list);
            }
            for (letter, register) in &drawn {
                let value = match letter {
                    'b' => pointer(random, self.rules & ALIGNED != 0, self.rules & PLAIN != 0),
                    'i' => random.below(64),
                    'p' => random.word() & !3,
                    'f' => target(random),
                    _ => continue,
                };
                wanted.insert(*register as u8, value);
            }
            // REV and CLZ have their operand twice, instructions that belong together share their base.
            let mut left: BTreeMap<char, u32> = fields.clone();
            return self.digits().fold(0_u128, |bits, digit| {
                let bit = match digit {
                    '0' => 0,
                    '1' => 1,
                    letter => {
                        let left = left.entry(letter).or_insert(0);
                        *left -= 1;
                        let register = "ntmdb".contains(letter) && fields[&letter] >= 4;
                        u128::from(drawn[&letter] >> (if register { *left % 4 } else { *left }) & 1)
                    }
                };
                bits << 1 | bit
            });
        }
    }
}

fn draw(random: &mut Random, letter: char, len: u32) -> u32 {
    let whole = 1_u32 << len.min(31);
    match letter {
        'd' | 'n' | 'm' | 'a' | 't' | 'u' | 'b' | 'i' | 'p' | 'f' if len == 3 => random.below(8),
        'd' | 'n' | 'm' | 'a' | 't' | 'u' | 'b' | 'i' | 'p' | 'f' => {
            // R13 is left out.
            let register = random.below(14);
            if register == 13 { 14 } else { register }
        }
        'h' => random.of(&[0, 1, 2, 3, 4, 6]),
        'c' => random.below(14),
        'v' => 1 + random.below(whole - 1),
        'l' => loop {
            let list = random.below(whole) & random.below(whole).max(1);
            if list.count_ones() >= if len > 8 { 2 } else { 1 } {
                break list;
            }
        },
        _ => random.below(whole),
    }
}
