//! `cargo xtask images`: the board's images that tests run on the emulated board.

use std::path::Path;

use crate::firmware::Firmware;

/// Robots and images that tests name.
const IMAGES: [(&str, &str); 13] = [
    ("osmc-bench", "bare"),
    ("osmc-bench", "hosted"),
    ("openscout", "bare"),
    ("every-interface", "bare"),
    ("balance-tail", "bare"),
    ("hil-sim/emu/tests/robots/feedback-bench.toml", "bare"),
    ("osmc-evaluation", "bare"),
    ("cable-loop", "bare"),
    ("two-finger-gripper", "bare"),
    ("berry-picker", "bare"),
    ("suction-pad", "bare"),
    ("deformobot", "bare"),
    ("cue-desk", "bare"),
];

/// Builds all images, one after the other.
///
/// # Errors
/// The first image that does not build.
pub(crate) fn build(root: &Path) -> Result<(), String> {
    IMAGES.iter().try_for_each(|(robot, image)| {
        println!("{}", Firmware::new(robot, image).build(root)?);
        Ok(())
    })
}
