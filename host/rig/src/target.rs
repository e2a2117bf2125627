//! Names of boards.

use std::{fmt, str::FromStr};

use r4_links::{Address, BadAddress};

/// A board, by its name or by where it is.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// A simulated board of this robot: a built-in name or a TOML file.
    Sim(String),
    /// An emulated processor that runs the firmware's ELF, in the same simulated environment.
    Emu(String),
    /// A board at the other end of a link: a real one, or a virtual one that another program serves.
    Link(Address),
}

/// The operation needs a board whose environment can be read and changed.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{0} is a board at the other end of a link: this needs a simulated one, as in --board sim:osmc-bench")]
pub struct NotVirtual(pub(crate) Target);

/// The text names no board.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BadTarget {
    /// A link, but not one that can be opened.
    #[error(transparent)]
    Address(#[from] BadAddress),
    /// Neither a kind of virtual board nor a kind of link.
    #[error(
        "`{text}` names no board: write sim: and a robot's name or file, or serial:, tcp: or can: and where it is; \
         built in: {}",
        r4_boards::names().map(|name| format!("sim:{name}")).collect::<Vec<_>>().join(" ")
    )]
    UnknownKind {
        /// As it was given.
        text: String,
    },
}

impl Target {
    /// The same kind of virtual board for another robot.
    ///
    /// # Errors
    /// When this is a link, whose board has the robot that it has.
    pub fn with_robot(&self, robot: &str) -> Result<Self, NotVirtual> {
        match self {
            Self::Sim(_) => Ok(Self::Sim(robot.to_owned())),
            Self::Emu(_) => Ok(Self::Emu(robot.to_owned())),
            Self::Link(_) => Err(NotVirtual(self.clone())),
        }
    }

    /// Name, with `(simulated)` or `(emulated)` behind it where the board is not real.
    #[must_use]
    pub fn described(&self) -> String {
        match self {
            Self::Sim(_) => format!("{self} (simulated)"),
            Self::Emu(_) => format!("{self} (emulated)"),
            Self::Link(_) => self.to_string(),
        }
    }

    /// Name or file of a virtual board's robot.
    ///
    /// # Errors
    /// When this is a link.
    pub fn robot(&self) -> Result<&str, NotVirtual> {
        match self {
            Self::Sim(robot) | Self::Emu(robot) => Ok(robot),
            Self::Link(_) => Err(NotVirtual(self.clone())),
        }
    }

    /// Whether the board and its environment are simulated.
    #[must_use]
    pub fn is_virtual(&self) -> bool {
        !matches!(self, Self::Link(_))
    }
}

impl FromStr for Target {
    type Err = BadTarget;

    fn from_str(text: &str) -> Result<Self, BadTarget> {
        match text.split_once(':') {
            Some(("sim", robot)) if !robot.is_empty() => Ok(Self::Sim(robot.to_owned())),
            Some(("emu", robot)) if !robot.is_empty() => Ok(Self::Emu(robot.to_owned())),
            Some(("serial" | "can" | "tcp", _)) => Ok(Self::Link(text.parse()?)),
            _ => Err(BadTarget::UnknownKind { text: text.to_owned() }),
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sim(robot) => write!(f, "sim:{robot}"),
            Self::Emu(robot) => write!(f, "emu:{robot}"),
            Self::Link(address) => address.fmt(f),
        }
    }
}
