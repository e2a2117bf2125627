//! The optional screen: 480 by 320 pixels on an ILI9488, write-only over SPI.
//!
//! [`View`] is the content, [`draw`] draws its changes on any `DrawTarget`, [`run`] owns the panel.

mod banner;
mod draw;
mod fixed;
mod glyph;
mod panel;
mod source;
mod task;
mod view;

pub use draw::{SIZE, draw};
pub use panel::{Panel, PanelError, start};
pub use task::{ScreenPins, run};
pub use view::{Bar, Link, MAX_BARS, Source, Supply, View};
