//! Environment variables by which ROS nodes find each other. The library `ros2-client` does not read them.
//!
//! # Source
//! ROS 2 documentation (Jazzy), *The ROS_DOMAIN_ID* and *Improved Dynamic Discovery*: variables, ranges, defaults.

use std::{
    env::VarError,
    fmt,
    net::{IpAddr, Ipv4Addr, Ipv6Addr},
};

/// Highest domain whose UDP ports are below 65 536: 7400 + 250 · 232.
const DOMAIN_MAX: u16 = 232;

/// Range of discovery: the networks on which the node looks for others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// All networks of this machine's interfaces.
    Subnet,
    /// The loopback interface of this machine only.
    Localhost,
}

/// Mapping of service calls to DDS messages, in which implementations differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Services {
    /// Mapping of Fast DDS and Connext, by the DDS-RPC specification.
    Enhanced,
    /// Mapping of Cyclone DDS.
    Cyclone,
}

/// Settings by which nodes find each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Discovery {
    /// Number of the ROS domain, 0 to 232; nodes of different domains do not see each other.
    pub domain: u16,
    /// Networks on which the node looks for others.
    pub reach: Reach,
    /// Mapping of services, which must be that of the other nodes.
    pub services: Services,
}

/// Error of a variable whose value is invalid or not supported.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum EnvironmentError {
    /// The domain is no number from 0 to 232.
    #[error("ROS_DOMAIN_ID={value:?} is not a domain: set it to a number from 0 to {DOMAIN_MAX}, or unset it for 0")]
    Domain {
        /// Value of the variable.
        value: String,
    },
    /// The range of discovery is unknown.
    #[error(
        "ROS_AUTOMATIC_DISCOVERY_RANGE={value:?} is not a range: set it to SUBNET or LOCALHOST, or unset it for SUBNET"
    )]
    Range {
        /// Value of the variable.
        value: String,
    },
    /// Discovery is switched off, but this node can be found in no other way.
    #[error("ROS_AUTOMATIC_DISCOVERY_RANGE=OFF hides this node from all others: set it to SUBNET or LOCALHOST")]
    Off,
    /// The flag is neither 0 nor 1.
    #[error("ROS_LOCALHOST_ONLY={value:?} is neither 0 nor 1: set it to one of them, or unset it for 0")]
    LocalhostOnly {
        /// Value of the variable.
        value: String,
    },
    /// The two variables contradict each other.
    #[error("ROS_LOCALHOST_ONLY=1 and ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET contradict each other: unset the first")]
    Contradiction,
    /// Peers are named, which this node does not support.
    #[error("ROS_STATIC_PEERS={value:?}: named peers are not supported; unset it, and use one network for all nodes")]
    StaticPeers {
        /// Value of the variable.
        value: String,
    },
    /// The other nodes do not use DDS, or their mapping of services is unknown.
    #[error(
        "RMW_IMPLEMENTATION={value:?}: supported are rmw_fastrtps_cpp, rmw_connextdds and rmw_cyclonedds_cpp; set it to one of them, or \
         unset it for the first"
    )]
    Middleware {
        /// Value of the variable.
        value: String,
    },
    /// The value of a variable is not valid Unicode.
    #[error("{name} is not valid Unicode: set it again")]
    NotText {
        /// Name of the variable.
        name: &'static str,
    },
}

impl Discovery {
    /// Reads the settings from this process's environment.
    ///
    /// # Errors
    /// [`EnvironmentError`] for an invalid or unsupported value; its message names the variable.
    pub fn from_environment() -> Result<Self, EnvironmentError> {
        Self::from_variables(|name| match std::env::var(name) {
            Ok(value) => Ok(Some(value)),
            Err(VarError::NotPresent) => Ok(None),
            Err(VarError::NotUnicode(_)) => Err(EnvironmentError::NotText { name }),
        })
    }

    /// Reads the settings from `variable` in place of the environment. An empty variable counts as not set.
    ///
    /// # Errors
    /// [`EnvironmentError`] for an invalid or unsupported value, and the errors of `variable`.
    pub fn from_variables(
        variable: impl Fn(&'static str) -> Result<Option<String>, EnvironmentError>,
    ) -> Result<Self, EnvironmentError> {
        let set = |name: &'static str| -> Result<Option<String>, EnvironmentError> {
            Ok(variable(name)?.filter(|value| !value.is_empty()))
        };
        let domain = match set("ROS_DOMAIN_ID")? {
            None => 0,
            Some(value) => {
                let number = value.parse().ok().filter(|domain| *domain <= DOMAIN_MAX);
                number.ok_or(EnvironmentError::Domain { value })?
            }
        };
        let is_localhost_only = match set("ROS_LOCALHOST_ONLY")?.as_deref() {
            None | Some("0") => false,
            Some("1") => true,
            Some(value) => return Err(EnvironmentError::LocalhostOnly { value: value.to_owned() }),
        };
        // A contradiction is refused, because a node that is visible on more networks than intended can be commanded from there.
        let reach = match set("ROS_AUTOMATIC_DISCOVERY_RANGE")?.as_deref() {
            Some("SUBNET") if is_localhost_only => return Err(EnvironmentError::Contradiction),
            None | Some("SYSTEM_DEFAULT") if is_localhost_only => Reach::Localhost,
            None | Some("SUBNET" | "SYSTEM_DEFAULT") => Reach::Subnet,
            Some("LOCALHOST") => Reach::Localhost,
            Some("OFF") => return Err(EnvironmentError::Off),
            Some(value) => return Err(EnvironmentError::Range { value: value.to_owned() }),
        };
        let services = match set("RMW_IMPLEMENTATION")?.as_deref() {
            None | Some("rmw_fastrtps_cpp" | "rmw_fastrtps_dynamic_cpp" | "rmw_connextdds") => Services::Enhanced,
            Some("rmw_cyclonedds_cpp") => Services::Cyclone,
            Some(value) => return Err(EnvironmentError::Middleware { value: value.to_owned() }),
        };
        match set("ROS_STATIC_PEERS")? {
            Some(value) => Err(EnvironmentError::StaticPeers { value }),
            None => Ok(Self { domain, reach, services }),
        }
    }

    /// Returns the addresses of the interfaces that may be used; `None` for all interfaces.
    #[must_use]
    pub fn only_networks(self) -> Option<[IpAddr; 2]> {
        let localhost = [IpAddr::V4(Ipv4Addr::LOCALHOST), IpAddr::V6(Ipv6Addr::LOCALHOST)];
        (self.reach == Reach::Localhost).then_some(localhost)
    }
}

impl fmt::Display for Discovery {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reach = match self.reach {
            Reach::Subnet => "this machine and its networks",
            Reach::Localhost => "this machine only",
        };
        let services = match self.services {
            Services::Enhanced => "Fast DDS",
            Services::Cyclone => "Cyclone DDS",
        };
        write!(to, "ROS domain {}, {reach}, services as in {services}", self.domain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(variables: &[(&str, &str)]) -> Result<Discovery, EnvironmentError> {
        Discovery::from_variables(|name| {
            Ok(variables.iter().find(|(of, _)| *of == name).map(|(_, value)| (*value).to_owned()))
        })
    }

    #[test]
    fn what_is_asked_for_is_kept_and_said() {
        for (variables, domain, reach) in [
            (&[][..], 0, Reach::Subnet),
            (&[("ROS_DOMAIN_ID", "")], 0, Reach::Subnet),
            (&[("ROS_DOMAIN_ID", "232")], 232, Reach::Subnet),
            (&[("ROS_LOCALHOST_ONLY", "1")], 0, Reach::Localhost),
            (&[("ROS_LOCALHOST_ONLY", "0")], 0, Reach::Subnet),
            (&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")], 0, Reach::Localhost),
            (&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "SYSTEM_DEFAULT"), ("ROS_DOMAIN_ID", "7")], 7, Reach::Subnet),
        ] {
            let services = Services::Enhanced;
            assert_eq!(of(variables), Ok(Discovery { domain, reach, services }), "{variables:?}");
        }
        let cyclone = of(&[("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp"), ("ROS_LOCALHOST_ONLY", "1")]).expect("known");
        assert_eq!(cyclone.to_string(), "ROS domain 0, this machine only, services as in Cyclone DDS");
        assert!(of(&[]).expect("nothing").only_networks().is_none() && cyclone.only_networks().is_some());
    }

    #[test]
    fn what_cannot_be_kept_is_refused_by_the_name_of_the_variable() {
        for (variables, says) in [
            (&[("ROS_DOMAIN_ID", "233")][..], "ROS_DOMAIN_ID"),
            (&[("ROS_DOMAIN_ID", "-1")], "ROS_DOMAIN_ID"),
            (&[("ROS_DOMAIN_ID", "seven")], "from 0 to 232"),
            (&[("ROS_LOCALHOST_ONLY", "yes")], "ROS_LOCALHOST_ONLY"),
            (&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")], "OFF"),
            (&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "lan")], "SUBNET or LOCALHOST"),
            (&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"), ("ROS_LOCALHOST_ONLY", "1")], "contradict"),
            (&[("ROS_STATIC_PEERS", "10.0.0.7")], "ROS_STATIC_PEERS"),
            (&[("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")], "rmw_fastrtps_cpp"),
        ] {
            let refused = of(variables).expect_err("refused").to_string();
            assert!(refused.contains(says), "{variables:?}: {refused}");
        }
    }
}
