//! Drives a simulated board from code: `cargo run --release -p r4-sim --example drive`.
//!
//! The code inside `with_board` is the same as for a real board; only the link and the clock differ.

use r4_driver::{Clock, with_board};
use r4_sim::{Pace, SimBoard, Simulation};

/// Clock of the simulation, as the driver's trait requires it.
#[derive(Clone)]
struct VirtualClock(r4_sim::Clock);

impl Clock for VirtualClock {
    fn now_us(&self) -> u64 {
        self.0.now_ns() / 1000
    }

    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()> {
        self.0.sleep_until(at_us * 1000)
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut simulation = Simulation::new(Pace::Free);
    let simulated = SimBoard::start(&mut simulation, &r4_boards::load("osmc-bench")?, 1)?;
    let port = simulated.connect().ok_or("already connected")?;
    let clock = VirtualClock(simulation.clock());

    let motor = "osmc0".parse()?;
    let session = with_board(port.rx, port.tx, clock, async |board| {
        board.arm().await?;
        for target_rad in [1.57, -1.57, 0.0] {
            let reached = board.move_to(motor, target_rad, 30.0).await?;
            println!("{target_rad} rad: at {:.4} rad after {:.2} s", reached.position, reached.after_s);
        }
        board.disarm().await
    });
    simulation.block_on(session).ok_or("the simulation came to a standstill")???;
    Ok(())
}
