//! Banner with the name of the state, drawn as strokes: letters too large for a font, readable from across a room.

use embedded_graphics::{pixelcolor::Rgb888, prelude::*, primitives::Rectangle};
use r4_protocol::SafetyState;

use super::glyph::mixed;
use crate::{root::sqrtf, within::Within};

/// Letter as the centre lines of its strokes, in pixels from its upper left corner.
struct Letter {
    width: u8,
    lines: &'static [&'static [(u8, u8)]],
}

/// Height of the centre lines, pixels.
const HEIGHT: u32 = 52;
/// Half of a stroke's width, pixels.
const HALF_STROKE: f32 = 5.5;
/// Distance from a letter's right side to the next one's left, pixels.
const SPACING: u32 = 20;

/// Half of the spacing: no other letter is nearer.
const REACH: f32 = SPACING as f32 / 2.0;

const A: Letter = Letter { width: 36, lines: &[&[(0, 52), (18, 0), (36, 52)], &[(6, 35), (30, 35)]] };
const D: Letter = Letter {
    width: 36,
    lines: &[&[(0, 0), (16, 0), (25, 3), (32, 10), (36, 26), (32, 42), (25, 49), (16, 52), (0, 52), (0, 0)]],
};
const E: Letter = Letter { width: 31, lines: &[&[(31, 0), (0, 0), (0, 52), (31, 52)], &[(0, 26), (27, 26)]] };
const I: Letter = Letter { width: 0, lines: &[&[(0, 0), (0, 52)]] };
const M: Letter = Letter { width: 42, lines: &[&[(0, 52), (0, 0), (21, 36), (42, 0), (42, 52)]] };
const P: Letter = Letter {
    width: 34,
    lines: &[&[(0, 52), (0, 0), (20, 0), (28, 3), (33, 9), (34, 15), (33, 21), (28, 27), (20, 30), (0, 30)]],
};
const R: Letter = Letter {
    width: 34,
    lines: &[
        &[(0, 52), (0, 0), (20, 0), (28, 3), (33, 9), (34, 14), (33, 19), (28, 25), (20, 28), (0, 28)],
        &[(17, 28), (34, 52)],
    ],
};
const S: Letter = Letter {
    width: 34,
    lines: &[&[
        (33, 9),
        (29, 3),
        (22, 0),
        (12, 0),
        (5, 3),
        (1, 8),
        (1, 15),
        (5, 21),
        (12, 24),
        (22, 27),
        (30, 31),
        (34, 37),
        (33, 44),
        (29, 49),
        (22, 52),
        (12, 52),
        (5, 49),
        (0, 42),
    ]],
};
const T: Letter = Letter { width: 38, lines: &[&[(0, 0), (38, 0)], &[(19, 0), (19, 52)]] };

/// Fills `area` with `paper` and draws the name of `state` in its middle.
pub(super) fn draw<D>(
    target: &mut D,
    area: Rectangle,
    state: SafetyState,
    [ink, paper]: [Rgb888; 2],
) -> Result<(), D::Error>
where
    D: DrawTarget<Color: From<Rgb888>>,
{
    let word = match state {
        SafetyState::Disarmed => DISARMED,
        SafetyState::Armed => ARMED,
        SafetyState::Tripped => TRIPPED,
    };
    let Size { width, height } = area.size;
    let letters: u32 = word.iter().map(|letter| u32::from(letter.width) + SPACING).sum();
    let left = (width as f32 - (letters - SPACING) as f32) / 2.0;
    let top = (height - HEIGHT) as f32 / 2.0;
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let colours = pixels.map(|(x, y)| {
        let distance = distance_to(word, x as f32 + 0.5 - left, y as f32 + 0.5 - top);
        mixed(ink, paper, (HALF_STROKE - distance + 0.5).within(0.0, 1.0)).into()
    });
    target.fill_contiguous(&area, colours)
}

const DISARMED: &[&Letter] = &[&D, &I, &S, &A, &R, &M, &E, &D];
const ARMED: &[&Letter] = &[&A, &R, &M, &E, &D];
const TRIPPED: &[&Letter] = &[&T, &R, &I, &P, &P, &E, &D];

/// Distance from the nearest stroke of a word, pixels; beyond the letters' reach any larger value.
fn distance_to(word: &[&Letter], x: f32, y: f32) -> f32 {
    let mut nearest = f32::MAX;
    let mut left = 0.0;
    for letter in word {
        let (from_left, width) = (x - left, f32::from(letter.width));
        if (-REACH..=width + REACH).contains(&from_left) {
            for line in letter.lines {
                for (from, to) in line.iter().zip(line.iter().skip(1)) {
                    nearest = nearest.min(distance_to_segment((from_left, y), *from, *to));
                }
            }
        }
        left += width + SPACING as f32;
    }
    nearest
}

fn distance_to_segment((x, y): (f32, f32), from: (u8, u8), to: (u8, u8)) -> f32 {
    let (from_x, from_y) = (f32::from(from.0), f32::from(from.1));
    let (along_x, along_y) = (f32::from(to.0) - from_x, f32::from(to.1) - from_y);
    let (x, y) = (x - from_x, y - from_y);
    let along = ((x * along_x + y * along_y) / (along_x * along_x + along_y * along_y)).within(0.0, 1.0);
    let (x, y) = (x - along * along_x, y - along * along_y);
    sqrtf(x * x + y * y)
}
