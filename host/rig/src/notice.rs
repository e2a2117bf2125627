//! Notices for the user while a session runs.

use std::{fmt, path::PathBuf};

use r4_protocol::HotWinding;
use r4_sim::kept::Saved;

/// Message for the user; it is not an error.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Notice {
    /// A winding approaches its temperature limit.
    HotWinding(HotWinding),
    /// A flash file contains parameters that the board does not use.
    FlashNotUsed {
        /// Path of the file.
        path: PathBuf,
        /// Kind of the saved content.
        saved: Saved,
        /// Number of single parameters that do not fit.
        skipped: u32,
        /// Name of the robot that was started.
        robot: String,
    },
    /// Image that an emulated board runs.
    Image {
        /// Path of the ELF file.
        path: PathBuf,
        /// SHA-256 of the file, in hex.
        digest: String,
    },
}

impl fmt::Display for Notice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::HotWinding(hot) => {
                let winding = crate::heat::words(hot);
                write!(f, "warning: {winding}: drive it less, or let it cool; at 100 % the board trips")
            }
            Self::FlashNotUsed { path, saved, skipped, robot } => {
                let path = path.display();
                let instead = "the board starts as it was built, and the next `r4 config save` replaces it";
                match saved {
                    Saved::Nothing | Saved::Changes => {
                        write!(f, "{path}: {skipped} saved parameters do not fit this robot and are not used")
                    }
                    Saved::OtherRobot(other) => {
                        write!(f, "{path}: its parameters are of the robot {other}, not {robot}: {instead}")
                    }
                    Saved::NewerLayout(layout) => {
                        write!(f, "{path}: its parameters are of a newer firmware (layout {layout}): {instead}")
                    }
                    Saved::Damaged => write!(f, "{path}: its parameters are damaged: {instead}"),
                }
            }
            Self::Image { path, digest } => write!(f, "runs {}, SHA-256 {digest}", path.display()),
        }
    }
}
