//! Robot systems of published papers on R4 boards: each with the paper's method, ours, and a study that compares them.
//!
//! A [`System`] is one folder. It knows a board only through `r4-rig`, so that it runs unchanged on simulated, emulated and real
//! boards, and it knows no other system: what two of them need is in `r4-rig`, `r4-maths` or `r4-world`. [`all`] lists them; the
//! program, benchmarks, tests and pages read that list.
//!
//! A [`study`] runs [arms](Arm) of a system over seeds and makes [rows](Row) of their metrics, each with an interval and its source.
//!
//! A new system is a folder with `mod.rs` (its [`About`], the protocol on a board), a module for each part of the algorithm, and
//! its line in [`all`].

mod about;
pub mod absim;
pub mod access;
pub mod berry;
pub mod cloop;
pub mod effects;
mod error;
pub mod fieldmap;
mod figure;
pub mod gasmap;
pub mod inhand;
pub mod osmc;
#[cfg(feature = "parquet")]
mod parquet;
#[cfg(not(feature = "parquet"))]
#[path = "no_parquet.rs"]
mod parquet;
pub mod participants;
pub mod rover;
mod row;
mod sampler;
pub mod skidcal;
mod statistic;
pub mod study;
pub mod suction;
pub mod tail;
pub mod whisker;
pub mod xrhmi;

pub use about::{About, Arm, Limit, Metric, Paper, REPORTED, Source, Target};
pub use error::Error;
pub use figure::{Curve, Figure, Panel, View};
pub use row::Row;
pub use sampler::Sampler;
pub use statistic::{Statistic, Summary};
pub use study::{Record, Study, Trial, Values};

/// A text file made of a trial's result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ResultFile {
    /// File name without folders.
    pub name: &'static str,
    /// Content of the file, UTF-8.
    pub text: String,
}

/// A robot system: what a paper asks, how it and we answer, and how the answers are measured.
pub trait System: Sync {
    /// Paper, arms and metrics.
    fn about(&self) -> &'static About;

    /// Runs one trial: one arm, one seed, one board.
    ///
    /// The same trial gives the same values, bit for bit. What the seed decides is documented in [`About::sampled`].
    ///
    /// # Errors
    /// When the trial could not be run. An algorithm that fails gives a metric's value, not an error.
    fn run(&self, trial: &Trial) -> Result<Values, Error>;

    /// Curves of a trial's seed and board, for a page about the system; `None` for a system without.
    ///
    /// # Errors
    /// When the trial could not be run.
    fn figure(&self, trial: &Trial) -> Result<Option<Figure>, Error> {
        let _ = trial;
        Ok(None)
    }

    /// Files made of a trial's result for other programs, such as a calibrated body; none for a system without.
    ///
    /// # Errors
    /// When the trial could not be run, or gave nothing that could be written.
    fn files(&self, trial: &Trial) -> Result<Vec<ResultFile>, Error> {
        let _ = trial;
        Ok(Vec::new())
    }

    /// Views from above that go over the panels of [`System::figure`], two beside each other; none for most systems.
    ///
    /// # Errors
    /// When the trial could not be run.
    fn views(&self, trial: &Trial) -> Result<Vec<View>, Error> {
        let _ = trial;
        Ok(Vec::new())
    }

    /// Rows about the speed of this computer, which no seed repeats: benchmarks have them, studies do not.
    ///
    /// # Errors
    /// When something could not be run.
    fn timings(&self, is_quick: bool) -> Result<Vec<Row>, Error> {
        let _ = is_quick;
        Ok(Vec::new())
    }
}

/// All systems, in the order of the papers.
#[must_use]
pub fn all() -> &'static [&'static dyn System] {
    &[
        &skidcal::Skidcal,
        &whisker::Whisker,
        &osmc::Osmc,
        &cloop::Cloop,
        &inhand::Inhand,
        &berry::BerryPicking,
        &suction::Suction,
        &xrhmi::Xrhmi,
        &fieldmap::Fieldmap,
        &absim::Absim,
        &gasmap::Gasmap,
        &tail::Tail,
        &access::Access,
    ]
}

/// Returns the system with this name.
///
/// # Errors
/// [`Error::UnknownSystem`] when [`all`] has none of this name.
pub fn find(name: &str) -> Result<&'static dyn System, Error> {
    let found = all().iter().copied().find(|system| system.about().name == name);
    found.ok_or_else(|| Error::UnknownSystem { name: name.to_owned() })
}
