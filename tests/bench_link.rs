//! Tests of `r4 bench link` on boards that are served on a pseudo-terminal. The speed of a link depends on the machine
//! and its load, so no time is asserted here: a run of the program shows it.

use crate::program::*;

#[test]
fn a_served_board_is_measured_over_its_pseudo_terminal() {
    let seen = r4(&["bench", "link", "--board", "sim:osmc-bench", "--seconds", "0.3", "--window", "8", "--json"]);
    let told = object(&seen.out);
    assert_eq!(
        (&told["cycle_bytes"], &told["lost"], &told["armed"]),
        (&66.into(), &0.into(), &true.into()),
        "{seen:?}"
    );
    for field in
        ["rtt_us_p50", "rtt_us_p99", "rtt_us_p999", "cycles_per_s", "clock_error_us_p99", "clock_uncertainty_us"]
    {
        let value = told[field].as_f64().unwrap_or_else(|| panic!("{field} in {told}"));
        assert!(value >= 0.0 && (field.starts_with("clock") || value > 0.0), "{field}: {value}");
    }
    for (smaller, larger) in
        [("rtt_us_p50", "rtt_us_p99"), ("rtt_us_p99", "rtt_us_p999"), ("rtt_us_p999", "rtt_us_max")]
    {
        assert!(told[smaller].as_f64() <= told[larger].as_f64(), "{told}");
    }
    assert!(told["round_trips"].as_u64() > Some(0) && told["cycles"].as_u64() > Some(0), "{told}");
    // The program prints each limit, and ends with 0 only when all held.
    let limits = told["limits"].as_array().expect("limits");
    let held = limits.iter().all(|limit| limit["held"] == true);
    assert_eq!((limits.len(), &told["held"], seen.code), (5, &held.into(), Some(i32::from(!held))), "{told}");
}

/// A program that has only the link cannot know the true clock, and moves nothing without being asked.
#[test]
fn a_board_at_the_end_of_a_link_is_measured_without_arming_it() {
    let mut server = start(command(&["sim", "serve", "osmc-bench", "--tcp"]));
    let first = object(&next(server.out.as_ref().expect("stdout"), server.begin).expect("a first line"));
    assert!(first["epoch_ns"].as_u64() > Some(0), "{first}");
    let board = format!("tcp:{}", first["tcp"].as_str().expect("an address"));
    let seen = r4(&["bench", "link", "--board", &board, "--seconds", "0.2", "--json"]);
    let told = object(&seen.out);
    assert_eq!(told["link"], board.as_str());
    assert_eq!(
        (&told["cycle_bytes"], &told["lost"], &told["armed"]),
        (&66.into(), &0.into(), &false.into()),
        "{seen:?}"
    );
    assert!(told["clock_error_us_p99"].is_null() && told["clock_uncertainty_us"].as_f64() > Some(0.0), "{told}");
    // The board is disarmed, so it refuses every set point.
    assert!(told["not_followed"].as_u64() >= told["cycles"].as_u64(), "{told}");
    server.out = None;
}

#[test]
fn what_cannot_be_measured_is_refused() {
    all_refused([
        (&["bench", "link", "--window", "0"][..], &["no number of cycles"][..]),
        (&["bench", "link", "--window", "129"], &["no number of cycles"]),
        (&["bench", "link", "--board", "serial:/dev/nothing-here"], &["does not exist"]),
        (&["bench", "link", "--board", "sim:nothing-here"], &["nothing-here"]),
    ]);
}
