//! What an effect's contribution depends on.

/// What an effect's contribution is a function of: where its trace shows in a residual.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Dependence {
    /// The commanded duty.
    Input,
    /// The speed of the output.
    Speed,
    /// The position of the output.
    Position,
    /// The acceleration of the output.
    Acceleration,
    /// The sign of the speed or of the duty.
    Direction,
    /// Time itself.
    Time,
    /// The voltage of the supply or the current drawn from it.
    Supply,
    /// What went before.
    History,
}

impl Dependence {
    /// The word used in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Input => "input",
            Self::Speed => "speed",
            Self::Position => "position",
            Self::Acceleration => "acceleration",
            Self::Direction => "direction",
            Self::Time => "time",
            Self::Supply => "supply",
            Self::History => "history",
        }
    }
}
