//! Drawing of the screen's picture: only what differs from the last view is drawn.

use core::fmt::Write;

use embedded_graphics::{
    // Only a robot's name may have letters beyond ASCII, which double a font.
    mono_font::{
        ascii::{FONT_6X12, FONT_9X15, FONT_10X20},
        iso_8859_1::FONT_9X18_BOLD,
    },
    pixelcolor::Rgb888,
    prelude::*,
    primitives::Rectangle,
};
use heapless::String;
use r4_protocol::{Causes, Range, SafetyState, config::MAX_SUPPLIES};

use super::{
    banner,
    fixed::Fixed,
    glyph::Face,
    view::{Bar, Link, Supply, View},
};
use crate::within::Within;

/// Size of the picture, pixels.
pub const SIZE: Size = Size::new(480, 320);

const BLACK: Rgb888 = Rgb888::new(8, 8, 12);
const WHITE: Rgb888 = Rgb888::new(255, 255, 255);
const PALE: Rgb888 = Rgb888::new(160, 168, 180);
const LINE: Rgb888 = Rgb888::new(56, 60, 72);
const TROUGH: Rgb888 = Rgb888::new(36, 40, 52);
const GREY: Rgb888 = Rgb888::new(88, 92, 100);
const GREEN: Rgb888 = Rgb888::new(0, 136, 64);
const LIGHT_GREEN: Rgb888 = Rgb888::new(96, 220, 136);
const RED: Rgb888 = Rgb888::new(200, 20, 28);
const AMBER: Rgb888 = Rgb888::new(255, 184, 40);
const BLUE: Rgb888 = Rgb888::new(64, 168, 255);

const TINY: Face = Face { font: &FONT_6X12, scale: 1 };
const TEXT: Face = Face { font: &FONT_9X15, scale: 1 };
const BOLD: Face = Face { font: &FONT_9X18_BOLD, scale: 1 };
const FIGURE: Face = Face { font: &FONT_10X20, scale: 1 };
const HEADLINE: Face = Face { font: &FONT_10X20, scale: 2 };

/// Margin at the left and right, pixels.
const MARGIN: i32 = 8;
/// Top and height of the state's banner, pixels.
const BANNER_Y: i32 = 26;
const BANNER_HEIGHT: u32 = 80;
const HEADLINE_Y: i32 = 108;
const HEADLINE_LETTERS: usize = 23;
const ADVICE_Y: [i32; 2] = [149, 164];
const MORE_Y: i32 = 180;
/// Number of characters of a line of text across the screen.
const LINE_LETTERS: usize = 51;
/// Top of bars and supplies, pixels, with a rule above them and one below.
const PANELS_Y: i32 = 205;
const ROW_HEIGHT: i32 = 25;
const RULES_Y: [i32; 2] = [201, 306];
const SUPPLY_X: i32 = 320;
const FOOTER_Y: i32 = 308;

/// Draws `view` on a target of [`SIZE`].
///
/// If `last` is the view that the target shows, only the difference is drawn: characters, and columns of bars. The
/// picture is the same as without it.
///
/// # Errors
/// Errors of the target; it may then show any mixture of the two views.
pub fn draw<D>(target: &mut D, view: &View, last: Option<&View>) -> Result<(), D::Error>
where
    D: DrawTarget<Color: From<Rgb888>>,
{
    let mut pen = Pen { target, view, last };
    if last.is_none() {
        let below = BANNER_Y + BANNER_HEIGHT as i32;
        for (y, height) in [(0, BANNER_Y as u32), (below, SIZE.height - below as u32)] {
            pen.fill(Rectangle::new(Point::new(0, y), Size::new(SIZE.width, height)), BLACK)?;
        }
        for y in RULES_Y {
            pen.fill(Rectangle::new(Point::new(MARGIN, y), Size::new(SIZE.width - 2 * MARGIN as u32, 1)), LINE)?;
        }
    }
    pen.header()?;
    pen.banner()?;
    pen.causes()?;
    pen.supplies()?;
    pen.bars()?;
    pen.footer()
}

/// Line of characters that fills its place: the rest of it has the background colour.
struct Label {
    text: String<64>,
    ink: Rgb888,
    paper: Rgb888,
}

impl Label {
    fn new(ink: Rgb888, text: core::fmt::Arguments<'_>) -> Self {
        let mut label = Self { text: String::new(), ink, paper: BLACK };
        // Text that does not fit here would not fit the screen either.
        let _ = label.text.write_fmt(text);
        label
    }

    fn blank() -> Self {
        Self::new(WHITE, format_args!(""))
    }

    fn on(self, paper: Rgb888) -> Self {
        Self { paper, ..self }
    }

    /// Returns the label aligned to the right end of `letters` characters.
    fn right(self, letters: usize) -> Self {
        Self { text: Self::new(self.ink, format_args!("{:>letters$}", self.text)).text, ..self }
    }

    fn centred(self, letters: usize) -> Self {
        Self { text: Self::new(self.ink, format_args!("{:^letters$}", self.text)).text, ..self }
    }

    /// Character and its colours at `index`; a space looks the same in every ink.
    fn cell(&self, index: usize) -> (char, [Rgb888; 2]) {
        match self.text.chars().nth(index) {
            None | Some(' ') => (' ', [self.paper; 2]),
            Some(character) => (character, [self.ink, self.paper]),
        }
    }
}

struct Pen<'p, 'v, D> {
    target: &'p mut D,
    view: &'p View<'v>,
    /// View that the target shows; `None` when it is black.
    last: Option<&'p View<'v>>,
}

impl<D> Pen<'_, '_, D>
where
    D: DrawTarget<Color: From<Rgb888>>,
{
    fn fill(&mut self, area: Rectangle, colour: Rgb888) -> Result<(), D::Error> {
        self.target.fill_solid(&area, colour.into())
    }

    /// Draws the changed ones of `letters` characters from `at` on.
    fn label(&mut self, at: Point, face: Face, letters: usize, of: impl Fn(&View) -> Label) -> Result<(), D::Error> {
        let label = of(self.view);
        let last = self.last.map_or_else(Label::blank, of);
        for (index, x) in (0..letters).zip((at.x..).step_by(face.cell().width as usize)) {
            let (character, inks) = label.cell(index);
            if last.cell(index) != (character, inks) {
                face.draw(self.target, Point::new(x, at.y), character, inks)?;
            }
        }
        Ok(())
    }

    fn header(&mut self) -> Result<(), D::Error> {
        /// Maximum length of a robot's name.
        const NAME: usize = 32;
        /// Length of `host lost 9999 s`, the longest text here.
        const HOST: usize = 16;
        self.label(Point::new(MARGIN, 4), BOLD, NAME, |view| Label::new(WHITE, format_args!("{}", view.robot)))?;
        let x = right_edge(HOST, BOLD);
        self.label(Point::new(x, 4), BOLD, HOST, |view| {
            match view.link {
                Link::NoHost => Label::new(PALE, format_args!("no host")),
                Link::Alive { age_ms } => {
                    Label::new(LIGHT_GREEN, format_args!("host {}0 ms", (age_ms / 10).min(998) + 1))
                }
                Link::Lost { age_ms } => Label::new(AMBER, format_args!("host lost {} s", (age_ms / 1000).min(9999))),
            }
            .right(HOST)
        })
    }

    fn banner(&mut self) -> Result<(), D::Error> {
        if self.last.is_some_and(|last| last.state == self.view.state) {
            return Ok(());
        }
        let paper = match self.view.state {
            SafetyState::Disarmed => GREY,
            SafetyState::Armed => GREEN,
            SafetyState::Tripped => RED,
        };
        let area = Rectangle::new(Point::new(0, BANNER_Y), Size::new(SIZE.width, BANNER_HEIGHT));
        banner::draw(self.target, area, self.view.state, [WHITE, paper])
    }

    /// Draws the first cause with its advice, then the other causes.
    fn causes(&mut self) -> Result<(), D::Error> {
        self.label(Point::new(MARGIN, HEADLINE_Y), HEADLINE, HEADLINE_LETTERS, |view| {
            match (view.causes.iter().next(), view.state) {
                (Some(cause), _) => Label::new(WHITE, format_args!("{cause}")),
                (None, SafetyState::Disarmed) => Label::new(PALE, format_args!("outputs are off")),
                (None, SafetyState::Armed) => Label::new(WHITE, format_args!("keep clear")),
                (None, SafetyState::Tripped) => Label::new(WHITE, format_args!("cause unknown")),
            }
        })?;
        for (line, y) in ADVICE_Y.into_iter().enumerate() {
            self.label(Point::new(MARGIN, y), TEXT, LINE_LETTERS, |view| {
                let (ink, text) = match (view.causes.iter().next(), view.state) {
                    (Some(cause), _) => (AMBER, cause.advice()),
                    (None, SafetyState::Disarmed) => (PALE, "a host can arm the board"),
                    (None, SafetyState::Armed) => (PALE, "outputs follow the host's commands"),
                    (None, SafetyState::Tripped) => (AMBER, "update this firmware: it does not know the cause"),
                };
                Label::new(ink, format_args!("{}", wrapped(text, LINE_LETTERS, line)))
            })?;
        }
        self.label(Point::new(MARGIN, MORE_Y), BOLD, LINE_LETTERS, |view| {
            Label::new(WHITE, format_args!("{}", other_causes(view.causes)))
        })
    }

    fn supplies(&mut self) -> Result<(), D::Error> {
        /// Length of the text `100.0-120.0 V`.
        const NAME: usize = 13;
        /// Length of the text `-24.3 V`.
        const VOLTS: usize = 7;
        // The range of a 5 V rail is given in tenths of a volt.
        let digits = |range_v: &Range| if range_v.max < 10.0 { 2 } else { 1 };
        for index in 0..MAX_SUPPLIES {
            let y = PANELS_Y + ROW_HEIGHT * index as i32;
            self.label(Point::new(SUPPLY_X, y), TINY, NAME, |view| match view.supplies.get(index) {
                Some(supply) => Label::new(PALE, format_args!("{}", supply.id)),
                None => Label::blank(),
            })?;
            self.label(Point::new(SUPPLY_X, y + 12), TINY, NAME, |view| match view.supplies.get(index) {
                Some(Supply { range_v, .. }) => {
                    let digits = digits(range_v);
                    let [min, max] = [range_v.min, range_v.max].map(|value| Fixed { value, digits });
                    Label::new(PALE, format_args!("{min}-{max} V"))
                }
                None => Label::blank(),
            })?;
            self.label(Point::new(right_edge(VOLTS, FIGURE), y + 2), FIGURE, VOLTS, |view| {
                let Some(Supply { volts, range_v, .. }) = view.supplies.get(index) else { return Label::blank() };
                let digits = digits(range_v);
                let figure = Fixed { value: *volts, digits };
                let label = Label::new(WHITE, format_args!("{figure} V")).right(VOLTS);
                if range_v.contains(*volts) { label } else { label.on(RED) }
            })?;
        }
        Ok(())
    }

    fn bars(&mut self) -> Result<(), D::Error> {
        let layout = BarLayout::of(self.view);
        let last = self.last;
        if last.is_some_and(|last| BarLayout::of(last).places() != layout.places()) {
            let height = ROW_HEIGHT * MAX_SUPPLIES as i32;
            let width = SUPPLY_X - MARGIN;
            self.fill(Rectangle::new(Point::new(MARGIN, PANELS_Y), Size::new(width as u32, height as u32)), BLACK)?;
            self.last = None;
        }
        for index in 0..layout.places() {
            self.bar(&layout, index)?;
        }
        self.last = last;
        Ok(())
    }

    fn bar(&mut self, layout: &BarLayout, index: usize) -> Result<(), D::Error> {
        /// Length of the text `actuator255`.
        const NAME: usize = 11;
        /// Length of the text `-0.98`.
        const VALUE: usize = 5;
        let at = layout.place(index);
        let letter = layout.face.cell().width as i32;
        self.label(at, layout.face, NAME, |view| match view.bars.get(index) {
            Some(bar) => Label::new(if bar.moving { WHITE } else { PALE }, format_args!("{}", bar.id)),
            None => Label::blank(),
        })?;
        let left = at.x + letter * NAME as i32 + 4;
        let columns = |view: &View| view.bars.get(index).map(|bar| Columns::of(bar, layout.width));
        let (new, old) = (columns(self.view), self.last.and_then(columns));
        let top = at.y + 1;
        let height = layout.face.cell().height - 2;
        let differs = |x| {
            let colour = Columns::colour(new, x);
            (Columns::colour(old, x) != colour).then_some(colour)
        };
        // Adjacent columns of one colour are one window.
        let mut x = 0;
        while x < layout.width {
            let colour = differs(x);
            let end = (x..layout.width).find(|x| differs(*x) != colour).unwrap_or(layout.width);
            if let Some(colour) = colour {
                self.fill(Rectangle::new(Point::new(left + x, top), Size::new((end - x) as u32, height)), colour)?;
            }
            x = end;
        }
        if layout.figures {
            let x = left + layout.width + 4;
            self.label(Point::new(x, at.y), layout.face, VALUE, |view| match view.bars.get(index) {
                Some(bar) => {
                    let figure = Fixed { value: bar.value, digits: 2 };
                    Label::new(if bar.moving { WHITE } else { PALE }, format_args!("{figure:+}"))
                }
                None => Label::blank(),
            })?;
        }
        Ok(())
    }

    fn footer(&mut self) -> Result<(), D::Error> {
        /// Length of the text `up 49710d 06:28:15`.
        const UPTIME: usize = 18;
        /// Length of the text `bus retries 4294967295`.
        const COUNTER: usize = 22;
        self.label(Point::new(MARGIN, FOOTER_Y), TINY, UPTIME, |view| {
            let s = view.uptime_s;
            let (days, hours, minutes, s) = (s / 86_400, s / 3600 % 24, s / 60 % 60, s % 60);
            match days {
                0 => Label::new(PALE, format_args!("up {hours:02}:{minutes:02}:{s:02}")),
                _ => Label::new(PALE, format_args!("up {days}d {hours:02}:{minutes:02}:{s:02}")),
            }
        })?;
        let counter = |count, name| Label::new(if count == 0 { PALE } else { AMBER }, format_args!("{name} {count}"));
        let x = (SIZE.width as i32 - TINY.cell().width as i32 * COUNTER as i32) / 2;
        self.label(Point::new(x, FOOTER_Y), TINY, COUNTER, |view| {
            counter(view.late_ticks, "late ticks").centred(COUNTER)
        })?;
        self.label(Point::new(right_edge(COUNTER, TINY), FOOTER_Y), TINY, COUNTER, |view| {
            counter(view.bus_retries, "bus retries").right(COUNTER)
        })
    }
}

/// Left end of a label that ends at the right margin.
fn right_edge(letters: usize, face: Face) -> i32 {
    SIZE.width as i32 - MARGIN - face.cell().width as i32 * letters as i32
}

/// Text of the causes after the first, as many as fit a line.
fn other_causes(causes: Causes) -> String<64> {
    let mut text = String::new();
    let count = causes.iter().skip(1).count();
    for (index, cause) in causes.iter().skip(1).enumerate() {
        let mut longer = text.clone();
        let separator = if index == 0 { "also " } else { ", " };
        let written = write!(longer, "{separator}{cause}");
        let room = if index + 1 == count { LINE_LETTERS } else { LINE_LETTERS - ", 11 more".len() };
        if written.is_err() || longer.len() > room {
            let _ = write!(text, ", {} more", count - index);
            break;
        }
        text = longer;
    }
    text
}

/// Returns line number `line` of `text`, broken at spaces into lines of at most `letters` characters.
fn wrapped(text: &str, letters: usize, line: usize) -> &str {
    let mut rest = text;
    for _ in 0..line {
        rest = rest.get(first_line(rest, letters).len()..).unwrap_or("").trim_start();
    }
    first_line(rest, letters)
}

fn first_line(text: &str, letters: usize) -> &str {
    if text.len() <= letters {
        return text;
    }
    let end = text.match_indices(' ').map(|(at, _)| at).take_while(|at| *at <= letters).last();
    text.get(..end.unwrap_or(letters)).unwrap_or(text)
}

/// Layout of the bars: a small number of bars is drawn large and with figures.
#[derive(Clone, Copy)]
struct BarLayout {
    face: Face,
    rows: usize,
    columns: usize,
    /// Width of the bar alone, pixels.
    width: i32,
    figures: bool,
}

impl BarLayout {
    fn of(view: &View) -> Self {
        match view.bars.len() {
            0..=4 => Self { face: TEXT, rows: 4, columns: 1, width: 149, figures: true },
            5..=8 => Self { face: TINY, rows: 8, columns: 1, width: 197, figures: true },
            _ => Self { face: TINY, rows: 8, columns: 2, width: 77, figures: false },
        }
    }

    const fn places(&self) -> usize {
        self.rows * self.columns
    }

    fn place(&self, index: usize) -> Point {
        let (column, row) = (index / self.rows, index % self.rows);
        let pitch = ROW_HEIGHT * MAX_SUPPLIES as i32 / self.rows as i32;
        let gap = (pitch - self.face.cell().height as i32) / 2;
        Point::new(MARGIN + 154 * column as i32, PANELS_Y + gap + pitch * row as i32)
    }
}

/// Bar described by its pixel columns, from the middle to `edge`.
#[derive(Clone, Copy)]
struct Columns {
    middle: i32,
    edge: i32,
    colour: Rgb888,
}

impl Columns {
    fn of(bar: &Bar, width: i32) -> Self {
        let middle = width / 2;
        // NaN becomes 0, since the cast gives 0.
        let length = libm::roundf(bar.value.within(-1.0, 1.0) * middle as f32) as i32;
        Self { middle, edge: middle + length, colour: if bar.moving { BLUE } else { GREY } }
    }

    /// Colour of column `x`, also where there is no bar.
    fn colour(bar: Option<Self>, x: i32) -> Rgb888 {
        let Some(Self { middle, edge, colour }) = bar else { return BLACK };
        if x == middle {
            PALE
        } else if (middle.min(edge)..=middle.max(edge)).contains(&x) {
            colour
        } else {
            TROUGH
        }
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::Cause;

    use super::*;

    #[test]
    fn every_cause_and_all_of_its_advice_fits() {
        for cause in Cause::ALL {
            let mut name = String::<64>::new();
            write!(name, "{cause}").expect("fits");
            assert!(name.len() <= HEADLINE_LETTERS, "{cause}");
            let lines = [0, 1].map(|line| wrapped(cause.advice(), LINE_LETTERS, line));
            assert!(lines.iter().all(|line| line.len() <= LINE_LETTERS), "{lines:?}");
            assert!(
                lines
                    .iter()
                    .flat_map(|line| line.split(' '))
                    .filter(|word| !word.is_empty())
                    .eq(cause.advice().split(' '))
            );
        }
    }

    #[test]
    fn no_set_of_causes_is_cut() {
        for bits in 0..1 << Cause::ALL.len() {
            let causes = Causes::from_bits(bits);
            let text = other_causes(causes);
            assert!(text.len() <= LINE_LETTERS, "{text}");
            let told = text.split(", ").filter(|part| !part.is_empty() && !part.ends_with(" more")).count();
            let more = text.rsplit(", ").next().and_then(|part| part.strip_suffix(" more"));
            let more: usize = more.map_or(0, |count| count.parse().expect("a number"));
            assert_eq!(told + more, causes.iter().skip(1).count(), "{text}");
        }
    }

    #[test]
    fn the_last_cause_may_fill_the_line() {
        let causes = [Cause::DeadMan, Cause::Proximity, Cause::LinkLost, Cause::Stalled, Cause::ControlOverrun];
        let also = |causes: &[Cause]| {
            other_causes(causes.iter().fold(Causes::NONE, |all, cause| all.union(Causes::only(*cause))))
        };
        let whole = "also proximity, link lost, stalled, control overrun";
        assert_eq!((whole.len(), also(&causes).as_str()), (LINE_LETTERS, whole));
        assert_eq!(also(&Cause::ALL), "also proximity, link lost, host stop, 15 more");
    }

    #[test]
    fn words_longer_than_a_line_are_cut() {
        assert_eq!(wrapped("abcdefgh ij", 4, 0), "abcd");
        assert_eq!(wrapped("abc defg hi", 4, 1), "defg");
        assert_eq!(wrapped("abc", 4, 1), "");
    }
}
