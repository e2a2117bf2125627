//! Actions and resources: the two words of a request that a policy's rules name.

use std::{fmt, str::FromStr};

/// Kind of use that a rule can allow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Action {
    /// Reading of samples, parameters, logs, trips and recordings.
    Read,
    /// Set points, paths, cycles and their binding.
    Set,
    /// Arming of the board.
    Arm,
    /// Clearing of a latched trip.
    Clear,
    /// Change of parameters, gains and names; restarts.
    Configure,
    /// Transfer on an external bus.
    Transfer,
}

impl Action {
    /// All actions, in the order of their bits in a rule.
    pub const ALL: [Self; 6] = [Self::Read, Self::Set, Self::Arm, Self::Clear, Self::Configure, Self::Transfer];

    /// Name in policies and logs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Set => "set",
            Self::Arm => "arm",
            Self::Clear => "clear",
            Self::Configure => "configure",
            Self::Transfer => "transfer",
        }
    }

    /// Returns the action with this name; `None` if there is none.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|action| action.name() == name)
    }

    /// Bit of the action in the set of a rule.
    pub(crate) const fn bit(self) -> u8 {
        1 << self as u8
    }
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Class of resources, of which rules and items may name all or one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// The board as a whole: arming, clearing, restarting.
    Board,
    /// Channel, with its set points and its samples.
    Channel,
    /// Stored parameter, gain or name.
    Configuration,
    /// History of trips that the board has stored.
    Faults,
    /// Log of the firmware.
    Log,
    /// Counters of the board, and the image that it runs.
    Statistics,
    /// External connector: I2C or UART.
    Bus,
    /// Recording on the host's disk.
    Recording,
}

impl Class {
    /// All classes, in the order in which they are declared.
    pub const ALL: [Self; 8] = [
        Self::Board,
        Self::Channel,
        Self::Configuration,
        Self::Faults,
        Self::Log,
        Self::Statistics,
        Self::Bus,
        Self::Recording,
    ];

    /// Name in policies and logs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Board => "board",
            Self::Channel => "channel",
            Self::Configuration => "configuration",
            Self::Faults => "faults",
            Self::Log => "log",
            Self::Statistics => "statistics",
            Self::Bus => "bus",
            Self::Recording => "recording",
        }
    }
}

/// Protected resource: all of a class, or one of it by its name.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Resource {
    class: Class,
    /// Name within the class; empty for the class as a whole.
    name: String,
}

/// Text that is no resource.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is no resource: write one of board, channel, configuration, faults, log, statistics, bus, recording, with a \
     name behind a slash for one of them, as in channel/osmc0"
)]
pub struct NotAResource(pub String);

impl Resource {
    /// Longest name of a resource, bytes. With its class it fits one block of SHA-256, so that hashing takes as long
    /// for any of them.
    pub const MAX_NAME: usize = 40;

    /// Makes a resource of a name within a class; an empty name means the class as a whole. A name longer than
    /// [`Self::MAX_NAME`] is cut, at a character.
    #[must_use]
    pub fn new(class: Class, name: impl Into<String>) -> Self {
        let mut name = name.into();
        let mut len = name.len().min(Self::MAX_NAME);
        while !name.is_char_boundary(len) {
            len -= 1;
        }
        name.truncate(len);
        Self { class, name }
    }

    /// Makes the resource of a class as a whole.
    #[must_use]
    pub fn whole(class: Class) -> Self {
        Self::new(class, "")
    }

    /// Class of the resource.
    #[must_use]
    pub const fn class(&self) -> Class {
        self.class
    }
}

impl fmt::Display for Resource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.class.name())?;
        if self.name.is_empty() { Ok(()) } else { write!(f, "/{}", self.name) }
    }
}

impl FromStr for Resource {
    type Err = NotAResource;

    fn from_str(text: &str) -> Result<Self, NotAResource> {
        let bad = || NotAResource(text.to_owned());
        let (class, name) = match text.split_once('/') {
            Some((_, "")) => return Err(bad()),
            Some(both) => both,
            None => (text, ""),
        };
        if name.len() > Self::MAX_NAME || name.chars().any(char::is_control) {
            return Err(bad());
        }
        let class = Class::ALL.into_iter().find(|known| known.name() == class).ok_or_else(bad)?;
        Ok(Self::new(class, name))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn each_class_is_read_as_it_is_written() {
        for class in Class::ALL {
            for resource in [Resource::whole(class), Resource::new(class, "osmc0")] {
                assert_eq!(resource.to_string().parse(), Ok(resource));
            }
        }
        assert!(Action::ALL.into_iter().all(|action| Action::named(action.name()) == Some(action)));
    }

    proptest! {
        #[test]
        fn any_text_is_a_resource_or_refused(text in ".{0,60}") {
            if let Ok(resource) = text.parse::<Resource>() {
                prop_assert_eq!(resource.to_string(), text);
            }
        }

        #[test]
        fn long_names_are_cut_at_a_character(name in "\\PC{0,60}") {
            let resource = Resource::new(Class::Recording, name.clone());
            prop_assert!(name.starts_with(&resource.name) && resource.name.len() <= Resource::MAX_NAME);
        }
    }
}
