//! Characters of any size from the bitmaps of the fonts, always with their background, so that each is one window.

use crate::within::Within;
use embedded_graphics::{
    mono_font::{MonoFont, MonoTextStyle},
    pixelcolor::{BinaryColor, Rgb888},
    prelude::*,
    primitives::Rectangle,
    text::{Baseline, Text},
};

/// Font with a magnification.
#[derive(Clone, Copy)]
pub(super) struct Face {
    pub(super) font: &'static MonoFont<'static>,
    /// Screen pixels per pixel of the font.
    pub(super) scale: u32,
}

impl Face {
    /// Size of one character with its gap, pixels.
    pub(super) fn cell(self) -> Size {
        let Size { width, height } = self.font.character_size;
        Size::new((width + self.font.character_spacing) * self.scale, height * self.scale)
    }

    /// Paints the whole cell of `character`.
    pub(super) fn draw<D>(self, target: &mut D, at: Point, character: char, inks: [Rgb888; 2]) -> Result<(), D::Error>
    where
        D: DrawTarget<Color: From<Rgb888>>,
    {
        let [ink, paper] = inks;
        let bitmap = Bitmap::of(self.font, character);
        let cell = self.cell();
        let shades = (0..cell.height)
            .flat_map(|y| (0..cell.width).map(move |x| (x, y)))
            .map(|(x, y)| D::Color::from(mixed(ink, paper, bitmap.coverage(x, y, self.scale))));
        target.fill_contiguous(&Rectangle::new(at, cell), shades)
    }
}

/// Colour between `paper`, at a share of 0, and `ink`, at 1.
pub(super) fn mixed(ink: Rgb888, paper: Rgb888, share: f32) -> Rgb888 {
    let part = |ink: u8, paper: u8| (f32::from(paper) + (f32::from(ink) - f32::from(paper)) * share + 0.5) as u8;
    Rgb888::new(part(ink.r(), paper.r()), part(ink.g(), paper.g()), part(ink.b(), paper.b()))
}

/// Bitmap of one character, a word per row, with the left column in bit 0.
struct Bitmap([u32; 32]);

impl Bitmap {
    fn of(font: &MonoFont, character: char) -> Self {
        let mut bitmap = Self([0; 32]);
        let mut utf8 = [0; 4];
        let text = character.encode_utf8(&mut utf8);
        let style = MonoTextStyle::new(font, BinaryColor::On);
        // Drawing into memory cannot fail.
        let _ = Text::with_baseline(text, Point::zero(), style, Baseline::Top).draw(&mut bitmap);
        bitmap
    }

    fn bit(&self, x: i32, y: i32) -> f32 {
        let row = usize::try_from(y).ok().and_then(|y| self.0.get(y)).copied().unwrap_or(0);
        let set = (0..32).contains(&x) && row >> x & 1 == 1;
        if set { 1.0 } else { 0.0 }
    }

    /// Share of ink in pixel `x`, `y` of the character enlarged `scale` times.
    ///
    /// Between the centres of the font's pixels the ink is interpolated and cut where it falls below a threshold, which
    /// turns stairs into slopes. The threshold is slightly below a half, so that large letters look bold, and one
    /// screen pixel wide for soft edges.
    fn coverage(&self, x: u32, y: u32, scale: u32) -> f32 {
        if scale == 1 {
            return self.bit(x as i32, y as i32);
        }
        let (left, right) = middle(x, scale);
        let (top, bottom) = middle(y, scale);
        let row = |y: i32| self.bit(left, y) + (self.bit(left + 1, y) - self.bit(left, y)) * right;
        let ink = row(top) + (row(top + 1) - row(top)) * bottom;
        ((ink - CUT) * scale as f32 + 0.5).within(0.0, 1.0)
    }
}

/// Threshold of the interpolated ink; below it is background.
const CUT: f32 = 0.4;

/// Pixel of the font whose centre lies before the centre of `pixel`, and the distance between the centres, in font
/// pixels.
fn middle(pixel: u32, scale: u32) -> (i32, f32) {
    let at = (pixel as f32 + 0.5) / scale as f32 - 0.5;
    let before = libm::floorf(at);
    (before as i32, at - before)
}

impl OriginDimensions for Bitmap {
    fn size(&self) -> Size {
        Size::new(32, 32)
    }
}

impl DrawTarget for Bitmap {
    type Color = BinaryColor;
    type Error = core::convert::Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<BinaryColor>>>(&mut self, pixels: I) -> Result<(), Self::Error> {
        for Pixel(at, colour) in pixels {
            let row = usize::try_from(at.y).ok().and_then(|y| self.0.get_mut(y));
            if let (Some(row), 0..32, true) = (row, at.x, colour.is_on()) {
                *row |= 1 << at.x;
            }
        }
        Ok(())
    }
}
