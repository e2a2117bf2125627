//! Cost of a program: instructions and stack, by exception.
//!
//! Both are assigned at exception entries and returns, between runs of the core, so that no instruction is slowed down.
//! The memory below the stack pointer is unused at that time (AAPCS32, 6.2.1.1): it is searched for written bytes,
//! which are charged to the code that ran since the previous such time, and painted again.

use crate::memory::Memory;

/// Number of exceptions, thread mode included.
const EXCEPTIONS: usize = 16 + 240;
/// Size of a comparison, bytes.
const CHUNK: usize = 32;

/// Stack to watch, with its paint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StackArea {
    /// Lowest address of the stack.
    pub end: u32,
    /// Address after the highest.
    pub start: u32,
    /// Byte to paint it with; that of the program, if it paints its stack itself.
    pub paint: u8,
}

/// Execution of the marked instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// Virtual time of the execution, ns.
    pub at_ns: u64,
    /// Exception whose handler executes it; 0 for thread mode.
    pub exception: u16,
    /// Instructions executed by that handler so far, without those of nested exceptions.
    pub instructions: u64,
}

/// Counts since the start of the profile.
#[derive(Clone, Debug)]
pub struct Profile {
    instructions: Vec<u64>,
    entries: Vec<u64>,
    depths: Vec<u32>,
    stack: StackArea,
    /// Active exceptions, the innermost last, each with the stack pointer before it.
    nested: Vec<(u16, u32)>,
    /// Lowest address written so far.
    lowest: u32,
    mark: Option<u32>,
    moments: Vec<Moment>,
}

impl Profile {
    /// Starts a profile and paints the free part of the stack; thread mode is executing, or no code yet.
    pub(super) fn new(stack: StackArea, mark: Option<u32>, memory: &Memory, sp: u32) -> Self {
        let mut profile = Self {
            instructions: vec![0; EXCEPTIONS],
            entries: vec![0; EXCEPTIONS],
            depths: vec![0; EXCEPTIONS],
            stack,
            nested: Vec::new(),
            lowest: sp.clamp(stack.end, stack.start),
            mark,
            moments: Vec::new(),
        };
        profile.restarted(memory, sp);
        profile
    }

    /// Returns the instructions executed by the handler of an exception, or by thread mode (0), without those of nested
    /// exceptions.
    #[must_use]
    pub fn instructions(&self, exception: u16) -> u64 {
        self.instructions.get(usize::from(exception)).copied().unwrap_or(0)
    }

    /// Returns the number of entries into the handler.
    #[must_use]
    pub fn entries(&self, exception: u16) -> u64 {
        self.entries.get(usize::from(exception)).copied().unwrap_or(0)
    }

    /// Returns its deepest stack use, bytes, with its frame and without the interrupted code.
    #[must_use]
    pub fn depth(&self, exception: u16) -> u32 {
        self.depths.get(usize::from(exception)).copied().unwrap_or(0)
    }

    /// Iterates over the exceptions that executed instructions.
    pub fn active(&self) -> impl Iterator<Item = u16> {
        (0..EXCEPTIONS as u16).filter(|exception| self.instructions(*exception) > 0)
    }

    /// Returns the deepest use of the stack, bytes.
    #[must_use]
    pub fn deepest(&self) -> u32 {
        self.stack.start - self.lowest
    }

    /// Takes the executions of the marked instruction since the last call.
    pub fn take_moments(&mut self) -> Vec<Moment> {
        std::mem::take(&mut self.moments)
    }

    pub(super) fn executed(&mut self, exception: u16, instructions: u64) {
        if let Some(count) = self.instructions.get_mut(usize::from(exception)) {
            *count += instructions;
        }
    }

    pub(super) fn observed(&mut self, address: u32, at_ns: u64, exception: u16) {
        if self.mark == Some(address) {
            self.moments.push(Moment { at_ns, exception, instructions: self.instructions(exception) });
        }
    }

    /// Charges stack use before an exception is entered or left from `exception`.
    pub(super) fn leaves_off(&mut self, memory: &Memory, exception: u16, sp: u32) {
        let StackArea { end, start, .. } = self.stack;
        if !(end..=start).contains(&sp) {
            return;
        }
        // The whole free part is searched, because a frame may be large and sparsely written.
        let written = lowest_written(memory, self.stack, end, sp);
        let reached = written.unwrap_or(sp);
        if let Some(written) = written {
            paint(memory, self.stack, written, sp);
        }
        self.lowest = self.lowest.min(reached);
        let base = self.nested.last().map_or(start, |(_, base)| *base);
        if let Some(depth) = self.depths.get_mut(usize::from(exception)) {
            *depth = (*depth).max(base.saturating_sub(reached));
        }
    }

    /// Notes the exception that continues or begins after that.
    pub(super) fn goes_on(&mut self, exception: u16, sp_before: u32, sp: u32) {
        let mut base = sp_before;
        if sp >= sp_before {
            // The handler was left; its frame stays if another one follows at once (tail-chaining).
            let left = self.nested.pop();
            if sp > sp_before {
                return;
            }
            base = left.map_or(sp_before, |(_, base)| base);
        }
        self.nested.push((exception, base));
        if let Some(count) = self.entries.get_mut(usize::from(exception)) {
            *count += 1;
        }
    }

    /// Starts again after a reset: no exception is active, and the stack is unused.
    pub(super) fn restarted(&mut self, memory: &Memory, sp: u32) {
        self.nested.clear();
        paint(memory, self.stack, self.stack.end, sp.clamp(self.stack.end, self.stack.start));
    }
}

/// Returns the lowest address in `from..to` that is not painted.
fn lowest_written(memory: &Memory, stack: StackArea, from: u32, to: u32) -> Option<u32> {
    let (region, offset) = memory.locate(from)?;
    let cells = region.bytes().get(offset as usize..(offset + (to - from)) as usize)?;
    let differs =
        |chunk: &[std::cell::Cell<u8>]| chunk.iter().fold(0, |all, byte| all | (byte.get() ^ stack.paint)) != 0;
    let chunk = cells.chunks(CHUNK).position(differs)?;
    let first = chunk * CHUNK;
    let within = cells[first..].iter().position(|byte| byte.get() != stack.paint)?;
    Some(from + (first + within) as u32)
}

fn paint(memory: &Memory, stack: StackArea, from: u32, to: u32) {
    let Some((region, offset)) = memory.locate(from) else { return };
    if let Some(cells) = region.bytes().get(offset as usize..(offset + (to - from)) as usize) {
        cells.iter().for_each(|byte| byte.set(stack.paint));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AREA: StackArea = StackArea { end: 0x2400_0000, start: 0x2400_8000, paint: 0xCC };

    fn write(memory: &Memory, address: u32) {
        memory.write(address, crate::Size::Word, 0x1234_5678).unwrap();
    }

    #[test]
    fn what_was_written_is_charged_to_who_ran() {
        let memory = Memory::new();
        let mut profile = Profile::new(AREA, None, &memory, AREA.start);
        // Thread mode uses 0x400 bytes, returns to 0x100, and is interrupted by exception 20.
        write(&memory, AREA.start - 0x400);
        let sp = AREA.start - 0x100;
        profile.leaves_off(&memory, 0, sp);
        profile.goes_on(20, sp, sp - 0x20);
        // Exception 20 uses less than thread mode had there before, and is interrupted by 30, which uses 0x40.
        write(&memory, sp - 0x80);
        profile.leaves_off(&memory, 20, sp - 0x60);
        profile.goes_on(30, sp - 0x60, sp - 0x80);
        write(&memory, sp - 0xA0);
        profile.leaves_off(&memory, 30, sp - 0x80);
        // Exception 40 follows 30 on the same frame.
        profile.goes_on(40, sp - 0x80, sp - 0x80);
        profile.leaves_off(&memory, 40, sp - 0x80);
        profile.goes_on(20, sp - 0x80, sp - 0x60);
        profile.leaves_off(&memory, 20, sp - 0x20);
        profile.goes_on(0, sp - 0x20, sp);
        write(&memory, AREA.start - 0x200);
        profile.leaves_off(&memory, 0, sp);
        assert_eq!([0, 20, 30, 40].map(|exception| profile.depth(exception)), [0x400, 0x80, 0x40, 0x20]);
        assert_eq!([20, 30, 40].map(|exception| profile.entries(exception)), [1, 1, 1]);
        assert_eq!(profile.deepest(), 0x400);
    }

    #[test]
    fn a_large_frame_hardly_written_is_seen_at_once() {
        let memory = Memory::new();
        let mut profile = Profile::new(AREA, None, &memory, AREA.start);
        write(&memory, AREA.end);
        profile.leaves_off(&memory, 0, AREA.start);
        profile.goes_on(20, AREA.start, AREA.start - 0x20);
        profile.leaves_off(&memory, 20, AREA.start - 0x20);
        assert_eq!([profile.depth(0), profile.depth(20), profile.deepest()], [0x8000, 0x20, 0x8000]);
    }

    #[test]
    fn a_mark_tells_who_and_when() {
        let mut profile = Profile::new(AREA, Some(0x0800_1000), &Memory::new(), AREA.start);
        profile.executed(107, 12);
        profile.observed(0x0800_1000, 5, 107);
        profile.observed(0x0800_2000, 6, 107);
        assert_eq!(profile.take_moments(), [Moment { at_ns: 5, exception: 107, instructions: 12 }]);
        assert_eq!(profile.take_moments(), []);
        assert_eq!(profile.active().collect::<Vec<_>>(), [107]);
    }
}
