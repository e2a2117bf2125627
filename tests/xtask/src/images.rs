//! `cargo xtask images`: the board's images that tests run on the emulated board.

use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

use crate::firmware::{self, Firmware};

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

/// Build of all images in a process of its own. Linking an image keeps one core busy, so other steps use the other cores meanwhile.
///
/// Dropped, it ends the process.
pub(crate) struct Background {
    child: Child,
    log: PathBuf,
}

impl Background {
    /// Starts the build, with its output in a file.
    ///
    /// # Errors
    /// This program cannot be started again, or the file not written.
    pub(crate) fn start(root: &Path) -> Result<Self, String> {
        let log = firmware::target_folder(root)?.join("images.log");
        let failed = |error: std::io::Error| format!("{}: {error}", log.display());
        fs::create_dir_all(log.parent().unwrap_or(root)).map_err(failed)?;
        let file = File::create(&log).map_err(failed)?;
        let program = std::env::current_exe().map_err(|error| format!("this program's file is not known: {error}"))?;
        let mut build = Command::new(program);
        build.arg("images").current_dir(root).stdin(Stdio::null());
        build.stdout(file.try_clone().map_err(failed)?).stderr(file);
        let child = build.spawn().map_err(|error| format!("this program cannot be started again: {error}"))?;
        Ok(Self { child, log })
    }

    /// Waits for the end of the build and prints its output.
    ///
    /// # Errors
    /// The build failed; the output says why.
    pub(crate) fn finish(mut self) -> Result<(), String> {
        let status = self.child.wait().map_err(|error| error.to_string())?;
        print!("{}", fs::read_to_string(&self.log).unwrap_or_default());
        if status.success() { Ok(()) } else { Err("an image does not build, see above".into()) }
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        // Both fail for a process that has ended, as it should have.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
