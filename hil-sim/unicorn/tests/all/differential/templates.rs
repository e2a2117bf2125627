//! Every encoding of ARMv7E-M with FPv5-D16 (DDI0403E A5, A6), as bits. A letter is a field:
//!
//! | letter | field |
//! | --- | --- |
//! | `x` | any bit |
//! | `d n m a t u` | a register: R0 to R12 or LR |
//! | `b` | register like those, with an address; base of a store or load |
//! | `i` | register like those, with a small number; an index |
//! | `h` | R8 to R12 or LR, in three bits |
//! | `p` | register like those, with a multiple of four |
//! | `f` | register like those, with an address of code |
//! | `l` | a list of registers, at least two where there are more than eight, without `b` |
//! | `c` | a condition except AL |
//! | `v` | a number that is not zero |
//!
//! Encodings that the architecture calls UNPREDICTABLE are left out: processors may differ there.

/// Instruction that ends its sequence: a branch, or a wait. Within an IT block it is the last.
pub(crate) const LAST: u32 = 1;
/// Instruction that is not permitted within an IT block.
pub(crate) const ALONE: u32 = 2;
/// Instruction whose registers must all differ.
pub(crate) const DISTINCT: u32 = 4;
/// Instruction that needs an aligned address, and makes several accesses.
pub(crate) const ALIGNED: u32 = 8;
/// Instruction for memory, not for peripherals: exclusive accesses.
pub(crate) const PLAIN: u32 = 16;

/// Rules of instructions that belong together.
const PAIR: u32 = ALONE | DISTINCT | ALIGNED | PLAIN;

pub(crate) struct Template {
    pub(crate) bits: &'static str,
    pub(crate) rules: u32,
}

const fn of(bits: &'static str, rules: u32) -> Template {
    Template { bits, rules }
}

/// Integer instructions (A5.2 and A5.3).
pub(crate) const INTEGER: &[Template] = &[
    // A5.2.1: shifts, sums and immediate values.
    of("000 00 xxxxx nnn ddd", 0),
    of("000 01 xxxxx nnn ddd", 0),
    of("000 10 xxxxx nnn ddd", 0),
    of("0001 10 x mmm nnn ddd", 0),
    of("0001 11 x mmm nnn ddd", 0),
    of("001 xx ddd xxxxxxxx", 0),
    // A5.2.2: data processing.
    of("010000 xxxx mmm ddd", 0),
    // A5.2.3: high registers.
    of("010001 00 0 mmmm nnn", 0),
    of("010001 00 1 mmmm hhh", 0),
    of("010001 01 1 mmmm hhh", 0),
    of("010001 10 0 mmmm ddd", 0),
    of("010001 10 1 mmmm hhh", 0),
    of("010001 00 1 pppp 101", 0),
    of("010001 00 0 1101 ddd", 0),
    of("010001 10 0 1101 ddd", 0),
    of("010001 10 0 1111 ddd", 0),
    of("010001 00 0 1111 ddd", 0),
    of("010001 10 1 ffff 111", LAST),
    of("010001 11 0 ffff 000", LAST),
    of("010001 11 1 ffff 000", LAST),
    // A5.2.4 and literal loads.
    of("01001 ttt xxxxxxxx", 0),
    of("0101 xxx iii bbb ttt", DISTINCT),
    of("011 xx xxxxx bbb ttt", 0),
    of("1000 x xxxxx bbb ttt", 0),
    of("1001 x ttt xxxxxxxx", 0),
    of("1010 x ddd xxxxxxxx", 0),
    // A5.2.5: miscellaneous.
    of("1011 0000 x xxxxxxx", 0),
    of("1011 x0x1 xxxxx nnn", ALONE | LAST),
    of("1011 0010 xx mmm ddd", 0),
    of("1011 1010 00 mmm ddd", 0),
    of("1011 1010 01 mmm ddd", 0),
    of("1011 1010 11 mmm ddd", 0),
    of("1011 010 x llllllll", 0),
    of("1011 110 0 llllllll", 0),
    of("1011 0110 011 x 00 vv", ALONE),
    of("1011 1110 xxxxxxxx", LAST),
    of("1011 1111 0xxx 0000", LAST),
    of("11000 bbb llllllll", ALIGNED),
    of("11001 bbb llllllll", ALIGNED),
    // Branches, SVC, UDF.
    of("1101 cccc xxxxxxxx", ALONE | LAST),
    of("1101 1110 xxxxxxxx", LAST),
    of("1101 1111 xxxxxxxx", LAST),
    of("11100 xxxxxxxxxxx", LAST),
    // A5.3.1: data processing, modified immediate.
    of("11110 x 0 000 x x nnnn 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 0 000 0 1 nnnn 0 xxx 1111 xxxxxxxx", 0),
    of("11110 x 0 001 x x nnnn 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 0 001 x x 1111 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 0 001 x 0 1111 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 0 010 0 x nnnn 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 0 010 0 1 nnnn 0 xxx 1111 xxxxxxxx", 0),
    of("11110 x 0 100 0 x nnnn 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 0 100 0 1 nnnn 0 xxx 1111 xxxxxxxx", 0),
    of("11110 x 0 101 x x nnnn 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 0 110 1 x nnnn 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 0 110 1 1 nnnn 0 xxx 1111 xxxxxxxx", 0),
    of("11110 x 0 111 0 x nnnn 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 0 100 0 x 1101 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 0 110 1 x 1101 0 xxx dddd xxxxxxxx", 0),
    of("11110 0 0 100 0 0 1101 0 000 1101 xxxxxx00", 0),
    // A5.3.3: plain immediate.
    of("11110 x 10000 0 nnnn 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 10101 0 nnnn 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 10000 0 1111 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 10101 0 1111 0 xxx dddd xxxxxxxx", 0),
    of("11110 x 10x10 0 xxxx 0 xxx dddd xxxxxxxx", 0),
    of("11110 0 11000 0 nnnn 0 xxx dddd xx 0 xxxxx", 0),
    of("11110 0 11001 0 nnnn 0 vvv dddd vv 0 xxxxx", 0),
    of("11110 0 11001 0 nnnn 0 000 dddd 00 0 0xxxx", 0),
    of("11110 0 11100 0 nnnn 0 xxx dddd xx 0 xxxxx", 0),
    of("11110 0 11101 0 nnnn 0 vvv dddd vv 0 xxxxx", 0),
    of("11110 0 11101 0 nnnn 0 000 dddd 00 0 0xxxx", 0),
    of("11110 0 11x10 0 nnnn 0 0xx dddd xx 0 0xxxx", 0),
    of("11110 0 11x10 0 nnnn 0 1xx dddd xx 0 00000", 0),
    of("11110 0 11011 0 nnnn 0 0xx dddd xx 0 1xxxx", 0),
    of("11110 0 11011 0 1111 0 0xx dddd xx 0 1xxxx", 0),
    // A5.3.4: branches and control.
    of("11110 x cccc xxxxxx 10 x 0 x xxxxxxxxxxx", ALONE | LAST),
    of("11110 x xxxxxxxxxx 10 x 1 x xxxxxxxxxxx", LAST),
    of("11110 0 0000000010 10 1 1 1 xxxxxxxxxxx", LAST),
    of("11110 x xxxxxxxxxx 11 x 1 x xxxxxxxxxxx", LAST),
    of("11110 1 1111111xxx 11 1 1 1 xxxxxxxxxxx", LAST),
    of("11110 0111 000 nnnn 1000 vv00 00000000", LAST),
    of("11110 0111 000 nnnn 1000 1000 00000 0xx", LAST),
    of("11110 0111 000 nnnn 1000 1000 00000 101", LAST),
    of("11110 0111 000 pppp 1000 1000 00001 00x", LAST),
    of("11110 0111 000 nnnn 1000 1000 00010 0xx", LAST),
    of("11110 0111 000 nnnn 1000 1000 00010 100", LAST),
    of("11110 0111 11 0 1111 1000 dddd 00000 0xx", 0),
    of("11110 0111 11 0 1111 1000 dddd 00000 101", 0),
    of("11110 0111 11 0 1111 1000 dddd 00000 11x", 0),
    of("11110 0111 11 0 1111 1000 dddd 00001 00x", 0),
    of("11110 0111 11 0 1111 1000 dddd 00010 0xx", 0),
    of("11110 0111 11 0 1111 1000 dddd 00010 100", 0),
    of("11110 0111 01 0 1111 1000 0000 00000 xxx", LAST),
    of("11110 0111 01 0 1111 1000 0000 1111 xxxx", 0),
    of("11110 0111 01 1 1111 1000 1111 0010 1111", 0),
    of("11110 0111 01 1 1111 1000 1111 0100 xxxx", 0),
    of("11110 0111 01 1 1111 1000 1111 0101 xxxx", 0),
    of("11110 0111 01 1 1111 1000 1111 0110 xxxx", LAST),
    of("11110 1111 111 xxxx 1010 xxxx xxxxxxxx", LAST),
    // A5.3.5: load and store multiple.
    of("11101 00 010 x 0 bbbb 0 0 0 lllllllllllll", ALIGNED),
    of("11101 00 010 x 0 bbbb 0 1 0 lllllllllllll", ALIGNED),
    of("11101 00 100 x 0 bbbb 0 x 0 lllllllllllll", ALIGNED),
    of("11101 00 010 x 1 bbbb 0 0 0 lllllllllllll", ALIGNED),
    of("11101 00 010 x 1 bbbb 0 1 0 lllllllllllll", ALIGNED),
    of("11101 00 100 x 1 bbbb 0 x 0 lllllllllllll", ALIGNED),
    of("11101 00 010 1 1 1101 0 x 0 lllllllllllll", ALIGNED),
    of("11101 00 100 1 0 1101 0 x 0 lllllllllllll", ALIGNED),
    of("11101 00 010 x 1 bbbb 1 0 0 lllllllllllll", ALIGNED | LAST),
    of("1011 110 1 llllllll", LAST),
    // A5.3.6: double or exclusive, table branches.
    of("11101 00 1 x 1 x 0 bbbb tttt uuuu xxxxxxxx", ALIGNED | DISTINCT),
    of("11101 00 x x 1 1 0 bbbb tttt uuuu xxxxxxxx", ALIGNED | DISTINCT),
    of("11101 00 x x 1 1 1 bbbb tttt uuuu xxxxxxxx", ALIGNED | DISTINCT),
    of("11101 00 1 x 1 0 1 1111 tttt uuuu xxxxxxxx", ALIGNED | DISTINCT),
    of("11101 00 0 0 1 0 1 bbbb tttt 1111 xxxxxxxx", ALIGNED | PLAIN),
    of("11101 00 0 0 1 0 0 bbbb tttt dddd xxxxxxxx", ALIGNED | DISTINCT | PLAIN),
    of("11101 00 0 1 1 0 1 bbbb tttt 1111 010x 1111", ALIGNED | PLAIN),
    of("11101 00 0 1 1 0 0 bbbb tttt 1111 010x dddd", ALIGNED | DISTINCT | PLAIN),
    // Exclusive pairs, and instructions in between.
    of("11101 00 0 0 1 0 1 bbbb tttt 1111 0000000x  11101 00 0 0 1 0 0 bbbb uuuu dddd 0000000x", PAIR),
    of("11101 00 0 1 1 0 1 bbbb tttt 1111 0100 1111 11101 00 0 1 1 0 0 bbbb uuuu 1111 0100 dddd", PAIR),
    of("11101 00 0 1 1 0 1 bbbb tttt 1111 0101 1111 11101 00 0 1 1 0 0 bbbb uuuu 1111 0101 dddd", PAIR),
    of(
        "11101 00 0 0 1 0 1 bbbb tttt 1111 00000000 11110 0111 01 1 1111 1000 1111 0010 1111 \
         11101 00 0 0 1 0 0 bbbb uuuu dddd 00000000",
        PAIR,
    ),
    of("11101 00 0 1 1 0 1 bbbb 1111 0000 000x iiii", LAST | DISTINCT),
    of("11101 00 0 1 1 0 1 1111 1111 0000 000x iiii", LAST),
    // A5.3.7 to A5.3.10: single loads and stores, hints.
    of("11111 00 x 1 0x 1 bbbb tttt xxxxxxxxxxxx", 0),
    of("11111 00 0 1 10 1 bbbb tttt xxxxxxxxxxxx", 0),
    of("11111 00 0 1 00 0 bbbb tttt xxxxxxxxxxxx", 0),
    of("11111 00 0 1 01 0 bbbb tttt xxxxxxxxxxxx", 0),
    of("11111 00 0 1 10 0 bbbb tttt xxxxxxxxxxxx", 0),
    of("11111 00 0 0 00 x bbbb tttt 1 1 x 0 xxxxxxxx", 0),
    of("11111 00 0 0 00 x bbbb tttt 1 1 0 0 xxxxxxxx", 0),
    of("11111 00 x 0 00 1 bbbb tttt 1 xx 1 xxxxxxxx", DISTINCT),
    of("11111 00 x 0 01 1 bbbb tttt 1 xx 1 xxxxxxxx", DISTINCT),
    of("11111 00 0 0 10 1 bbbb tttt 1 xx 1 xxxxxxxx", DISTINCT),
    of("11111 00 0 0 00 0 bbbb tttt 1 xx 1 xxxxxxxx", DISTINCT),
    of("11111 00 0 0 01 0 bbbb tttt 1 xx 1 xxxxxxxx", DISTINCT),
    of("11111 00 0 0 10 0 bbbb tttt 1 xx 1 xxxxxxxx", DISTINCT),
    of("11111 00 x 0 0x 1 bbbb tttt 1 100 xxxxxxxx", 0),
    of("11111 00 0 0 10 1 bbbb tttt 1 1x0 xxxxxxxx", 0),
    of("11111 00 x 0 0x 1 bbbb tttt 1 110 xxxxxxxx", 0),
    of("11111 00 0 0 xx 0 bbbb tttt 1 110 xxxxxxxx", 0),
    of("11111 00 x 0 0x 1 bbbb tttt 000000 xx iiii", DISTINCT),
    of("11111 00 0 0 10 1 bbbb tttt 000000 xx iiii", DISTINCT),
    of("11111 00 0 0 00 0 bbbb tttt 000000 xx iiii", DISTINCT),
    of("11111 00 0 0 01 0 bbbb tttt 000000 xx iiii", DISTINCT),
    of("11111 00 0 0 10 0 bbbb tttt 000000 xx iiii", DISTINCT),
    of("11111 00 x x 0x 1 1111 tttt xxxxxxxxxxxx", 0),
    of("11111 00 0 x 10 1 1111 tttt xxxxxxxxxxxx", 0),
    of("11111 00 0 0 10 1 1101 1111 1 011 00000100", LAST),
    of("11111 00 x 1 00 1 bbbb 1111 xxxxxxxxxxxx", 0),
    // A5.3.11: data processing, shifted register.
    of("11101 01 000x x nnnn 0 xxx dddd xx xx mmmm", 0),
    of("11101 01 0000 1 nnnn 0 xxx 1111 xx xx mmmm", 0),
    of("11101 01 001x x nnnn 0 xxx dddd xx xx mmmm", 0),
    of("11101 01 001x x 1111 0 xxx dddd xx xx mmmm", 0),
    of("11101 01 0100 x nnnn 0 xxx dddd xx xx mmmm", 0),
    of("11101 01 0100 1 nnnn 0 xxx 1111 xx xx mmmm", 0),
    of("11101 01 0110 0 nnnn 0 xxx dddd xx x0 mmmm", 0),
    of("11101 01 1000 x nnnn 0 xxx dddd xx xx mmmm", 0),
    of("11101 01 1000 1 nnnn 0 xxx 1111 xx xx mmmm", 0),
    of("11101 01 101x x nnnn 0 xxx dddd xx xx mmmm", 0),
    of("11101 01 1101 x nnnn 0 xxx dddd xx xx mmmm", 0),
    of("11101 01 1101 1 nnnn 0 xxx 1111 xx xx mmmm", 0),
    of("11101 01 1110 x nnnn 0 xxx dddd xx xx mmmm", 0),
    of("11101 01 1000 x 1101 0 000 dddd xx 00 mmmm", 0),
    // A5.3.12 to A5.3.15: registers, extension, parallel arithmetic.
    of("11111 010 0 xx x nnnn 1111 dddd 0000 mmmm", 0),
    of("11111 010 0 00x nnnn 1111 dddd 10 xx mmmm", 0),
    of("11111 010 0 01x nnnn 1111 dddd 10 xx mmmm", 0),
    of("11111 010 0 10x nnnn 1111 dddd 10 xx mmmm", 0),
    of("11111 010 0 0xx 1111 1111 dddd 10 xx mmmm", 0),
    of("11111 010 0 10x 1111 1111 dddd 10 xx mmmm", 0),
    of("11111 010 1 001 nnnn 1111 dddd 0xxx mmmm", 0),
    of("11111 010 1 010 nnnn 1111 dddd 0xxx mmmm", 0),
    of("11111 010 1 110 nnnn 1111 dddd 0xxx mmmm", 0),
    of("11111 010 1 101 nnnn 1111 dddd 0xxx mmmm", 0),
    of("11111 010 1 000 nnnn 1111 dddd 0xxx mmmm", 0),
    of("11111 010 1 100 nnnn 1111 dddd 0xxx mmmm", 0),
    of("11111 010 1 000 nnnn 1111 dddd 10 xx mmmm", 0),
    of("11111 010 1 010 nnnn 1111 dddd 1000 mmmm", 0),
    of("11111 010 1 001 mmmm 1111 dddd 10 xx mmmm", 0),
    of("11111 010 1 011 mmmm 1111 dddd 1000 mmmm", 0),
    // A5.3.16 and A5.3.17: multiplication, division.
    of("11111 0110 000 nnnn aaaa dddd 000x mmmm", 0),
    of("11111 0110 000 nnnn 1111 dddd 0000 mmmm", 0),
    of("11111 0110 001 nnnn aaaa dddd 00 xx mmmm", 0),
    of("11111 0110 001 nnnn 1111 dddd 00 xx mmmm", 0),
    of("11111 0110 010 nnnn aaaa dddd 000x mmmm", 0),
    of("11111 0110 010 nnnn 1111 dddd 000x mmmm", 0),
    of("11111 0110 011 nnnn aaaa dddd 000x mmmm", 0),
    of("11111 0110 011 nnnn 1111 dddd 000x mmmm", 0),
    of("11111 0110 100 nnnn aaaa dddd 000x mmmm", 0),
    of("11111 0110 100 nnnn 1111 dddd 000x mmmm", 0),
    of("11111 0110 101 nnnn aaaa dddd 000x mmmm", 0),
    of("11111 0110 101 nnnn 1111 dddd 000x mmmm", 0),
    of("11111 0110 110 nnnn aaaa dddd 000x mmmm", 0),
    of("11111 0110 111 nnnn 1111 dddd 0000 mmmm", 0),
    of("11111 0110 111 nnnn aaaa dddd 0000 mmmm", 0),
    of("11111 0111 0 x 0 nnnn dddd aaaa 0000 mmmm", DISTINCT),
    of("11111 0111 0 x 1 nnnn 1111 dddd 1111 mmmm", 0),
    of("11111 0111 100 nnnn dddd aaaa 0000 mmmm", DISTINCT),
    of("11111 0111 100 nnnn dddd aaaa 10xx mmmm", DISTINCT),
    of("11111 0111 100 nnnn dddd aaaa 110x mmmm", DISTINCT),
    of("11111 0111 101 nnnn dddd aaaa 110x mmmm", DISTINCT),
    of("11111 0111 110 nnnn dddd aaaa 0000 mmmm", DISTINCT),
    of("11111 0111 110 nnnn dddd aaaa 0110 mmmm", DISTINCT),
];

/// Floating-point instructions (A6.4 to A6.7).
pub(crate) const FLOAT: &[Template] = &[
    // Data processing of three registers.
    of("1110 1110 0x00 xxxx xxxx 1010 xxx0 xxxx", 0),
    of("1110 1110 0x01 xxxx xxxx 1010 xxx0 xxxx", 0),
    of("1110 1110 0x10 xxxx xxxx 1010 xxx0 xxxx", 0),
    of("1110 1110 0x11 xxxx xxxx 1010 xxx0 xxxx", 0),
    of("1110 1110 1x00 xxxx xxxx 1010 x0x0 xxxx", 0),
    of("1110 1110 1x01 xxxx xxxx 1010 xxx0 xxxx", 0),
    of("1110 1110 1x10 xxxx xxxx 1010 xxx0 xxxx", 0),
    of("1110 1110 0000 xxxx xxxx 1011 0x00 xxxx", 0),
    of("1110 1110 0001 xxxx xxxx 1011 0x00 xxxx", 0),
    of("1110 1110 0010 xxxx xxxx 1011 0x00 xxxx", 0),
    of("1110 1110 0011 xxxx xxxx 1011 0x00 xxxx", 0),
    of("1110 1110 1000 xxxx xxxx 1011 0000 xxxx", 0),
    of("1110 1110 1001 xxxx xxxx 1011 0x00 xxxx", 0),
    of("1110 1110 1010 xxxx xxxx 1011 0x00 xxxx", 0),
    // Data processing of two registers, or one.
    of("1110 1110 1x11 xxxx xxxx 1010 0000 xxxx", 0),
    of("1110 1110 1011 xxxx xxxx 1011 0000 xxxx", 0),
    of("1110 1110 1x11 000x xxxx 1010 x1x0 xxxx", 0),
    of("1110 1110 1011 000x xxxx 1011 x100 xxxx", 0),
    of("1110 1110 1x11 001x xxxx 1010 x1x0 xxxx", 0),
    of("1110 1110 1011 0010 xxxx 1011 x1x0 xxxx", 0),
    of("1110 1110 1x11 0011 xxxx 1011 x100 xxxx", 0),
    of("1110 1110 1x11 0100 xxxx 1010 x1x0 xxxx", 0),
    of("1110 1110 1011 0100 xxxx 1011 x100 xxxx", 0),
    of("1110 1110 1x11 0101 xxxx 1010 x100 0000", 0),
    of("1110 1110 1011 0101 xxxx 1011 x100 0000", 0),
    of("1110 1110 1x11 0110 xxxx 1010 x1x0 xxxx", 0),
    of("1110 1110 1011 0110 xxxx 1011 x100 xxxx", 0),
    of("1110 1110 1x11 0111 xxxx 1010 01x0 xxxx", 0),
    of("1110 1110 1011 0111 xxxx 1011 0100 xxxx", 0),
    of("1110 1110 1011 0111 xxxx 1010 11x0 xxxx", 0),
    of("1110 1110 1x11 0111 xxxx 1011 1100 xxxx", 0),
    of("1110 1110 1x11 1000 xxxx 1010 x1x0 xxxx", 0),
    of("1110 1110 1011 1000 xxxx 1011 x1x0 xxxx", 0),
    of("1110 1110 1x11 110x xxxx 1010 x1x0 xxxx", 0),
    of("1110 1110 1x11 110x xxxx 1011 x100 xxxx", 0),
    // Fixed point, of 32 and 16 bits.
    of("1110 1110 1x11 1x1x xxxx 1010 11x0 xxxx", 0),
    of("1110 1110 1011 1x1x xxxx 1011 11x0 xxxx", 0),
    of("1110 1110 1x11 1x1x xxxx 1010 01x0 0xxx", 0),
    of("1110 1110 1011 1x1x xxxx 1011 01x0 0xxx", 0),
    of("1110 1110 1x11 1x1x xxxx 1010 0100 1000", 0),
    // Instructions that only FPv5 has.
    of("1111 1110 0xxx xxxx xxxx 1010 x0x0 xxxx", ALONE),
    of("1111 1110 00xx xxxx xxxx 1011 0000 xxxx", ALONE),
    of("1111 1110 1x00 xxxx xxxx 1010 xxx0 xxxx", ALONE),
    of("1111 1110 1000 xxxx xxxx 1011 0x00 xxxx", ALONE),
    of("1111 1110 1x11 10xx xxxx 1010 01x0 xxxx", ALONE),
    of("1111 1110 1011 10xx xxxx 1011 0100 xxxx", ALONE),
    of("1111 1110 1x11 11xx xxxx 1010 x1x0 xxxx", ALONE),
    of("1111 1110 1x11 11xx xxxx 1011 x100 xxxx", ALONE),
    // Between core and extension registers.
    of("1110 1110 000x xxxx tttt 1010 x001 0000", 0),
    of("1110 1110 00xx xxxx tttt 1011 0001 0000", 0),
    of("1110 1110 1110 0001 tttt 1010 0001 0000", 0),
    of("1110 1110 1111 0001 tttt 1010 0001 0000", 0),
    of("1110 1110 1111 0001 1111 1010 0001 0000", 0),
    of("1110 1100 010x tttt uuuu 1010 00x1 0xxx", DISTINCT),
    of("1110 1100 010x tttt uuuu 1011 0001 xxxx", DISTINCT),
    // Loads and stores; the lists end before S31.
    of("1110 1101 xx0x bbbb xxxx 1010 xxxxxxxx", ALIGNED),
    of("1110 1101 x00x bbbb xxxx 1011 xxxxxxxx", ALIGNED),
    of("1110 1101 xx01 1111 xxxx 1010 xxxxxxxx", ALIGNED),
    of("1110 1100 1x0x bbbb 0xxx 1010 0000 vvvv", ALIGNED),
    of("1110 1100 1x1x bbbb 0xxx 1010 0000 vvvv", ALIGNED),
    of("1110 1101 0x1x bbbb 0xxx 1010 0000 vvvv", ALIGNED),
    of("1110 1100 100x bbbb 0xxx 1011 0000 vvv0", ALIGNED),
    of("1110 1100 101x bbbb 0xxx 1011 0000 vvv0", ALIGNED),
    of("1110 1101 001x bbbb 0xxx 1011 0000 vvv0", ALIGNED),
    of("1110 1101 001x bbbb 0xxx 1011 0000 vvv1", ALIGNED),
    of("1110 1101 0x10 1101 0xxx 1010 0000 vvvv", ALIGNED),
    of("1110 1100 1x11 1101 0xxx 1010 0000 vvvv", ALIGNED),
    // Registers and encodings that do not exist: D16 and above, division with bit 6.
    of("1110 1110 01xx xxxx xxxx 1011 xxx0 xxxx", 0),
    of("1110 1110 1x00 xxxx xxxx 1010 x1x0 xxxx", 0),
];
