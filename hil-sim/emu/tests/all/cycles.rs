//! Processor cycles as the image counts them.

use crate::emulated::{Setup, harness::MS};
use r4_protocol::{Reply, Request};

/// A period of osmc-bench takes 6 000 to 15 000 instructions (`r4 bench firmware`), each two cycles here: 240 million
/// instructions a second at 480 MHz. Without a host or a set point it is near the lower end.
#[test]
fn the_image_counts_what_control_takes_of_the_processor() {
    let (_, misuse) = Setup::osmc_bench().raw(async |host, device, _| {
        host.hello().await;
        device.clock.sleep(100 * MS).await;
        let Ok(Reply::Stats(stats)) = host.ask(Request::Stats).await else { panic!("every board counts") };
        assert!((4_000..60_000).contains(&stats.worst_tick_cycles), "{stats:?}");
        assert!(stats.ticks >= 100 && stats.ticks_over_share < stats.ticks / 10, "{stats:?}");
    });
    assert_eq!(misuse, Vec::<String>::new());
}
