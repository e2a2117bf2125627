//! Names of boards, as users write them.

use std::{fmt, str::FromStr};

use r4_boards::Robot;
use r4_links::{Address, BadAddress, LinkKind};

/// A board, by its name or by its address.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// A simulated board of this robot: a built-in name or a TOML file.
    Sim(String),
    /// Emulated board: an emulated processor runs the firmware's ELF file, in the same simulated environment.
    Emu(String),
    /// Board on a link: a real one, or a virtual one that another program serves.
    Link(Address),
}

/// Error of an operation that needs a board whose environment can be read and changed.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{0} is a board at the other end of a link: this needs a simulated one, as in --board sim:osmc-bench")]
pub struct NotVirtual(pub(crate) Target);

/// Error of a text that names no board.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BadTarget {
    /// The address of a link is not valid.
    #[error(transparent)]
    Address(#[from] BadAddress),
    /// The kind is neither a virtual board nor a link.
    #[error(
        "`{text}` names no board: write sim: and a robot's name or file, or {}; built in: {}",
        LinkKind::all_forms(),
        r4_boards::names().map(|name| format!("sim:{name}")).collect::<Vec<_>>().join(" ")
    )]
    UnknownKind {
        /// Text as the caller gave it.
        text: String,
    },
}

impl Target {
    /// Returns the same kind of virtual board for another robot.
    ///
    /// # Errors
    /// [`NotVirtual`] for a link, whose board has its own robot.
    pub fn with_robot(&self, robot: &str) -> Result<Self, NotVirtual> {
        match self {
            Self::Sim(_) => Ok(Self::Sim(robot.to_owned())),
            Self::Emu(_) => Ok(Self::Emu(robot.to_owned())),
            Self::Link(_) => Err(NotVirtual(self.clone())),
        }
    }

    /// File of the robot; `None` when it is not known.
    ///
    /// A board on a link does not report its robot's description, so `named`, the name that it reports, is looked up among
    /// the built-in robots.
    #[must_use]
    pub fn description(&self, named: &str) -> Option<Robot> {
        let name = match self {
            Self::Sim(name) | Self::Emu(name) => name,
            Self::Link(_) => r4_boards::names().find(|name| *name == named)?,
        };
        r4_boards::load(name).ok()
    }

    /// Name of the board, followed by `(simulated)` or `(emulated)` unless it is on a link.
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
    /// [`NotVirtual`] for a link.
    pub fn robot(&self) -> Result<&str, NotVirtual> {
        match self {
            Self::Sim(robot) | Self::Emu(robot) => Ok(robot),
            Self::Link(_) => Err(NotVirtual(self.clone())),
        }
    }

    /// Returns true when the board and its environment are simulated.
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
            _ if LinkKind::of(text).is_some() => Ok(Self::Link(text.parse()?)),
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
