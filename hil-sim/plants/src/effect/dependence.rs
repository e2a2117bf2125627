//! Quantities that an effect's contribution depends on.

/// Quantity of which an effect's contribution is a function, and over which it shows in a residual.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Dependence {
    /// Duty that is commanded.
    Input,
    /// Speed of the output.
    Speed,
    /// Position of the output.
    Position,
    /// Acceleration of the output.
    Acceleration,
    /// Sign of the speed or of the duty.
    Direction,
    /// Time since the start.
    Time,
    /// Voltage of the supply or the current drawn from it.
    Supply,
    /// Earlier values of input or output.
    History,
}

impl Dependence {
    /// Word for the quantity in reports.
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
