//! Benchmark of the cores, in instructions per second of this PC: `cargo run --release -p r4-unicorn --example bench`.
//!
//! Runs three loops of hand-assembled code on both cores, each for some time: pure arithmetic in long blocks, the mix
//! of a program (loads, stores, a call, short blocks), and polling of a register, where every access goes through the
//! bus.

use std::time::Instant;

use r4_mcu::cpu::{Access, Core, CoreBus, CoreError, Limits, NoResult, Register};
use r4_mcu::{Memory, Region};
use r4_thumb::ThumbCore;
use r4_unicorn::UnicornCore;

const CODE: u32 = 0x0800_0000;

struct Bus {
    instructions: u64,
    accesses: u64,
}

impl CoreBus for Bus {
    fn read(&mut self, _: &Access) -> Result<u32, NoResult> {
        self.accesses += 1;
        Ok(0)
    }

    fn write(&mut self, _: &Access, _: u32) -> Result<(), NoResult> {
        self.accesses += 1;
        Ok(())
    }

    fn limits(&self) -> Limits {
        Limits { instructions: self.instructions, mask_changes: false }
    }

    fn event(&mut self) {}

    fn remapped(&mut self) -> Option<&[Region]> {
        None
    }
}

fn main() -> Result<(), CoreError> {
    println!("unicorn");
    measure(UnicornCore::new)?;
    println!("thumb");
    measure(|| Ok(ThumbCore::new()))
}

fn measure<C: Core>(create: impl Fn() -> Result<C, CoreError>) -> Result<(), CoreError> {
    // Sixteen additions and a branch.
    let mut arithmetic = vec![0x1840_u16; 16];
    arithmetic.push(0xE7EE);
    // 0: ldr r1,[r0]; adds r1,#1; str r1,[r0]; bl 12; cmp r1,#0; bne 0; b 0; 16: push {r4,lr}; mul r4,r1; pop {r4,pc}
    let program = vec![0x6801, 0x3101, 0x6001, 0xF000, 0xF803, 0x2900, 0xD1F8, 0xE7F7, 0xB510, 0x434C, 0xBD10];
    // 0: ldr r2,[r3]; lsls r2,r2,#1; bpl 0
    let polling = vec![0x681A, 0x0052, 0xD5FC];
    for (name, code, instructions) in
        [("arithmetic", arithmetic, 1_000_000_000), ("program", program, 400_000_000), ("polling", polling, 6_000_000)]
    {
        let memory = Memory::new();
        let bytes: Vec<u8> = code.iter().flat_map(|half: &u16| half.to_le_bytes()).collect();
        memory.write_slice(CODE, &bytes).ok_or_else(|| CoreError("no flash".into()))?;
        let mut core = create()?;
        core.map(memory.regions())?;
        for (register, value) in [
            (Register::R(0), 0x2000_0000),
            (Register::R(3), 0x4000_0000),
            (Register::Sp, 0x2001_0000),
            (Register::Pc, CODE),
        ] {
            core.set(register, value);
        }
        let mut bus = Bus { instructions, accesses: 0 };
        let start = Instant::now();
        let stop = core.run(&mut bus)?;
        let seconds = start.elapsed().as_secs_f64();
        let millions = stop.instructions as f64 / seconds / 1e6;
        println!(
            "{name:10} {millions:7.1} million instructions/s, {:.2} million accesses/s",
            bus.accesses as f64 / seconds / 1e6
        );
    }
    Ok(())
}
