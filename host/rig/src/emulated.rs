//! Boards with an emulated processor, for programs built with the feature `emu`.

#[cfg(not(feature = "emu"))]
pub use absent::EmulatedError;
#[cfg(feature = "emu")]
pub use present::{EmulatedError, Observer, Setup};

#[cfg(feature = "emu")]
mod present {
    use std::{error::Error, rc::Rc};

    use r4_boards::Robot;
    use r4_emu::{EmuBoard, EmuError, FileError, Image, Settings};
    use r4_sim::{Simulation, flash::Flash};
    use r4_thumb::ThumbCore;

    use crate::{Notice, rig::Notify};

    /// Callback that attaches an observer to an emulated board after power-up: a log, a trace or a debugger.
    pub type Observer = Rc<dyn Fn(&EmuBoard<ThumbCore>, &Image) -> Result<(), Box<dyn Error + Send + Sync>>>;

    /// Error when an emulated board is started.
    #[derive(Debug, thiserror::Error)]
    pub enum EmulatedError {
        /// No image exists for the robot, or it cannot be read.
        #[error(transparent)]
        File(#[from] FileError),
        /// The image cannot be run.
        #[error(transparent)]
        Emu(#[from] EmuError),
        /// The observer could not be attached.
        #[error(transparent)]
        Observer(Box<dyn Error + Send + Sync>),
    }

    /// Settings of an emulated board.
    #[derive(Clone, Default)]
    pub struct Setup {
        /// Behaviour of the emulated processor.
        pub settings: Settings,
        /// Observer of each board that is powered up; `None` for none.
        pub observer: Option<Observer>,
    }

    impl Setup {
        /// Powers up an emulated board for `robot`, whose name or file is `name`, with the image built for it.
        pub(crate) fn start(
            &self,
            simulation: &mut Simulation,
            (robot, name): (&Robot, &str),
            seed: u64,
            flash: Option<Flash>,
            notify: &Notify,
        ) -> Result<EmuBoard<ThumbCore>, EmulatedError> {
            let image = Image::find(name)?;
            notify(&Notice::Image { path: image.path().to_owned(), digest: image.digest() });
            let board = EmuBoard::start(simulation, robot, seed, &image, ThumbCore::new(), flash, self.settings)?;
            if let Some(observer) = &self.observer {
                observer(&board, &image).map_err(EmulatedError::Observer)?;
            }
            Ok(board)
        }
    }
}

#[cfg(not(feature = "emu"))]
mod absent {
    /// Error of a program without the emulated processor, which also cannot decode the firmware's log.
    #[derive(Debug, thiserror::Error)]
    #[error(
        "this r4 was built without the emulated processor, which emu: boards, `debug`, `bench firmware` and --log need. \
         Run one that has it, in the repository:\n  \
         cargo run --release -p r4 --features emu -- ...\n\
         or install it:\n  \
         cargo install --locked --path host/cli --features emu"
    )]
    pub struct EmulatedError;
}
