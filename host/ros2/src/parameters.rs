//! Configuration of a board as parameters of a node, under its keys: `osmc0.position_kp`, `board.link_timeout_ms`.
//!
//! A board applies gains and feed-forward at once, and keeps them until it restarts. Other parameters must be saved and apply from its
//! next start; that is the task of `r4 config`, and setting them here is refused.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
};

use futures::channel::oneshot;
use r4_driver::{Board, Clock, Error};
use r4_protocol::{
    ChannelId, Mode, Parameter as Number, ParameterInfo, ParameterKey,
    config::{FeedForward, PidGains, Tuning},
};
use r4_rig::ParameterUnits;
use serde::Serialize;

use crate::bag::cdr;
use crate::message::{
    DescribeParametersResponse, GetParameterTypesResponse, GetParametersResponse, ListParametersRequest,
    ListParametersResponse, ListParametersResult, NamesRequest, Parameter, ParameterDescriptor, ParameterValue,
    SetParametersAtomicallyResponse, SetParametersRequest, SetParametersResponse, SetParametersResult, parameter_type,
};

/// Longest answer that other nodes receive, bytes of CDR with its header of 4.
///
/// RustDDS 0.15.1 splits answers of more than 1372 bytes (an Ethernet frame without its headers) into fragments, and writes
/// a stray byte before the inline QoS of each, which holds the caller's number: other nodes cannot read such a fragment, and
/// a debug build panics. Rounded down, because the limit follows from its sizes of headers.
const LONGEST_ANSWER_BYTES: usize = 1300;

/// Call of a parameter service, with the sender of its answer.
#[derive(Debug)]
pub enum ParameterCall {
    /// Call of `~/list_parameters`, which lists names.
    List(ListParametersRequest, oneshot::Sender<ListParametersResponse>),
    /// Call of `~/get_parameters`, which reads values.
    Get(NamesRequest, oneshot::Sender<GetParametersResponse>),
    /// Call of `~/get_parameter_types`, which reads types.
    Types(NamesRequest, oneshot::Sender<GetParameterTypesResponse>),
    /// Call of `~/describe_parameters`, which reads units and constraints.
    Describe(NamesRequest, oneshot::Sender<DescribeParametersResponse>),
    /// Call of `~/set_parameters`, which sets each parameter by itself.
    Set(SetParametersRequest, oneshot::Sender<SetParametersResponse>),
    /// Call of `~/set_parameters_atomically`, which sets all parameters or none.
    SetAtomically(SetParametersRequest, oneshot::Sender<SetParametersAtomicallyResponse>),
}

/// Reason why a parameter was not set.
#[derive(Debug, thiserror::Error)]
enum NotSet {
    #[error("the board has no parameter {0}: `ros2 param list` lists them")]
    Unknown(String),
    #[error("{0} is a number: set a double or an integer")]
    Type(String),
    #[error("{0} must be a finite number in single precision")]
    NotFinite(String),
    #[error("{key} takes effect at the board's next start: `r4 config set {key} {value} --save`, then restart it")]
    AtStart { key: ParameterKey, value: f32 },
    #[error(transparent)]
    Board(#[from] Error),
    /// The board has refused a group and then the old values of another, whose present values are unknown.
    #[error(
        "{refused}; after that {group} could not be restored ({source}) and may have the new values: set them again"
    )]
    NotRestored { refused: Error, group: Group, source: Error },
}

/// Group of parameters that a board changes with one request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Group {
    Position(ChannelId),
    Speed(ChannelId),
    Tuning(ChannelId),
}

impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Position(channel) => write!(f, "the position gains of {channel}"),
            Self::Speed(channel) => write!(f, "the speed gains of {channel}"),
            Self::Tuning(channel) => write!(f, "the feed-forward and cascade of {channel}"),
        }
    }
}

impl Group {
    /// Returns the group of a parameter that a board applies at once; `None` for others.
    fn of(key: ParameterKey) -> Option<Self> {
        let channel = key.channel?;
        match key.parameter {
            Number::PositionKp | Number::PositionKi | Number::PositionKd => Some(Self::Position(channel)),
            Number::SpeedKp | Number::SpeedKi | Number::SpeedKd => Some(Self::Speed(channel)),
            Number::StaticDuty | Number::DutyPerSpeed | Number::DutyPerAcceleration | Number::Cascade => {
                Some(Self::Tuning(channel))
            }
            _ => None,
        }
    }
}

/// Parameters of a board, read from it at the first call.
#[derive(Debug, Default)]
pub struct ParameterStore {
    /// Parameters as the board started with them, in its order; `None` until they were read.
    known: Option<Vec<ParameterInfo>>,
    /// Values that this node has set since.
    changed: BTreeMap<ParameterKey, f32>,
}

impl ParameterStore {
    /// Carries out a call and answers it. If the board does not answer, the call sees no parameters.
    pub async fn handle<C: Clock>(&mut self, board: &Board<C>, call: ParameterCall) {
        if self.known.is_none() {
            // After an error the next call reads them again.
            self.known = board.parameters().await.ok();
        }
        // The caller may be gone by now; then the answer is dropped.
        match call {
            ParameterCall::List(request, answer) => drop(answer.send(self.short_list(&request))),
            ParameterCall::Get(request, answer) => {
                let values = request.names.iter().map(|name| self.value(name)).collect();
                drop(answer.send(short(GetParametersResponse { values })));
            }
            ParameterCall::Types(request, answer) => {
                let types = request.names.iter().map(|name| self.value(name).kind).collect();
                drop(answer.send(short(GetParameterTypesResponse { types })));
            }
            ParameterCall::Describe(request, answer) => {
                let descriptors = request.names.iter().map(|name| self.describe(name)).collect();
                drop(answer.send(short(DescribeParametersResponse { descriptors })));
            }
            ParameterCall::Set(request, answer) => {
                let mut results = Vec::new();
                for parameter in &request.parameters {
                    results.push(result(self.set(board, std::slice::from_ref(parameter)).await));
                }
                let mut response = SetParametersResponse { results };
                if !fits(&response) {
                    // Which of them were set must reach the caller; only the reasons can be left out.
                    response.results.iter_mut().for_each(|result| result.reason.clear());
                }
                drop(answer.send(short(response)));
            }
            ParameterCall::SetAtomically(request, answer) => {
                let result = result(self.set(board, &request.parameters).await);
                drop(answer.send(SetParametersAtomicallyResponse { result }));
            }
        }
    }

    fn infos(&self) -> impl Iterator<Item = &ParameterInfo> {
        self.known.iter().flatten()
    }

    fn info(&self, name: &str) -> Option<&ParameterInfo> {
        let key: ParameterKey = name.parse().ok()?;
        self.infos().find(|info| info.key == key)
    }

    /// Returns the value that the board works with; `None` for an unknown key.
    fn number(&self, key: ParameterKey) -> Option<f32> {
        let known = || self.infos().find(|info| info.key == key).map(|info| info.active);
        self.changed.get(&key).copied().or_else(known)
    }

    fn value(&self, name: &str) -> ParameterValue {
        let number = self.info(name).and_then(|info| self.number(info.key));
        number.map_or_else(ParameterValue::default, |number| ParameterValue::double(shortest(number)))
    }

    fn describe(&self, name: &str) -> ParameterDescriptor {
        let Some(ParameterInfo { key, built_in, .. }) = self.info(name) else {
            return ParameterDescriptor { name: name.to_owned(), ..ParameterDescriptor::default() };
        };
        // A channel's unit, rad or m, follows from its other parameters.
        let all: Vec<_> = self.infos().copied().collect();
        let unit = match ParameterUnits::of(&all).unit(*key) {
            unit if unit.is_empty() => "a count".to_owned(),
            unit => format!("in {unit}"),
        };
        let read_only = Group::of(*key).is_none();
        let constraints = if read_only {
            format!("takes effect at the board's next start: r4 config set {key} VALUE --save")
        } else {
            format!("lasts until the board restarts; to keep it: r4 config set {key} VALUE --save")
        };
        ParameterDescriptor {
            name: name.to_owned(),
            kind: parameter_type::DOUBLE,
            description: format!("{unit}; built in: {built_in}"),
            additional_constraints: constraints,
            read_only,
            ..ParameterDescriptor::default()
        }
    }

    /// Lists names by the rules of `rclcpp`: a name must be equal to a prefix, or begin with it and a dot and have fewer than `depth` dots
    /// behind that.
    fn list(&self, ListParametersRequest { prefixes, depth }: &ListParametersRequest) -> ListParametersResponse {
        let is_near = |rest: &str| *depth == 0 || (rest.matches('.').count() as u64) < *depth;
        let is_listed = |name: &String| {
            prefixes.is_empty() && is_near(name)
                || prefixes.iter().any(|prefix| {
                    name == prefix
                        || name
                            .strip_prefix(prefix.as_str())
                            .is_some_and(|rest| rest.strip_prefix('.').is_some_and(is_near))
                })
        };
        let names: Vec<String> = self.infos().map(|info| info.key.to_string()).filter(is_listed).collect();
        let scopes: BTreeSet<_> =
            names.iter().filter_map(|name| name.rsplit_once('.')).map(|(scope, _)| scope).collect();
        let prefixes = scopes.into_iter().map(str::to_owned).collect();
        ListParametersResponse { result: ListParametersResult { names, prefixes } }
    }

    /// The list, or only its prefixes where the names are too many for an answer: each prefix can be listed by itself.
    fn short_list(&self, request: &ListParametersRequest) -> ListParametersResponse {
        let mut list = self.list(request);
        if !fits(&list) {
            list.result.names.clear();
        }
        short(list)
    }

    /// Sets all of `parameters` or none. Each group is sent with one request; if the board refuses a group, the groups sent before it get
    /// their old values again.
    ///
    /// # Errors
    /// [`NotSet`] for the first parameter that is invalid, before anything is sent; the board's refusal of a group, with the first
    /// group that could not be restored after it.
    async fn set<C: Clock>(&mut self, board: &Board<C>, parameters: &[Parameter]) -> Result<(), NotSet> {
        let before = self.changed.clone();
        let mut groups: BTreeSet<Group> = BTreeSet::new();
        let mut wanted = before.clone();
        for Parameter { name, value } in parameters {
            let info = self.info(name).ok_or_else(|| NotSet::Unknown(name.clone()))?;
            // The board computes in single precision; a double beyond its range becomes infinite and is refused.
            let number = value.number().ok_or_else(|| NotSet::Type(name.clone()))? as f32;
            if !number.is_finite() {
                return Err(NotSet::NotFinite(name.clone()));
            }
            let group = Group::of(info.key).ok_or(NotSet::AtStart { key: info.key, value: number })?;
            groups.insert(group);
            wanted.insert(info.key, number);
        }
        let mut sent = Vec::new();
        for group in groups {
            self.changed.clone_from(&wanted);
            let result = self.send(board, group).await;
            // The refused group is restored, too: the board may have applied it although its answer was lost.
            sent.push(group);
            if let Err(refused) = result {
                self.changed.clone_from(&before);
                let mut lost = None;
                // The others are restored all the same.
                for group in sent {
                    let result = self.send(board, group).await;
                    lost = lost.or(result.err().map(|source| (group, source)));
                }
                return Err(match lost {
                    Some((group, source)) => NotSet::NotRestored { refused, group, source },
                    None => NotSet::Board(refused),
                });
            }
        }
        self.changed = wanted;
        Ok(())
    }

    /// Sends the values of a group to the board.
    async fn send<C: Clock>(&self, board: &Board<C>, group: Group) -> Result<(), Error> {
        // A parameter of the group that the board does not list counts as 0.
        let number =
            |channel, parameter| self.number(ParameterKey { channel: Some(channel), parameter }).unwrap_or_default();
        let gains = |channel, [kp, ki, kd]: [Number; 3]| PidGains {
            kp: number(channel, kp),
            ki: number(channel, ki),
            kd: number(channel, kd),
        };
        match group {
            Group::Position(channel) => {
                let gains = gains(channel, [Number::PositionKp, Number::PositionKi, Number::PositionKd]);
                board.set_gains(channel, Mode::Position, gains).await
            }
            Group::Speed(channel) => {
                let gains = gains(channel, [Number::SpeedKp, Number::SpeedKi, Number::SpeedKd]);
                board.set_gains(channel, Mode::Speed, gains).await
            }
            Group::Tuning(channel) => {
                let feed_forward = FeedForward {
                    static_duty: number(channel, Number::StaticDuty),
                    duty_per_speed: number(channel, Number::DutyPerSpeed),
                    duty_per_acceleration: number(channel, Number::DutyPerAcceleration),
                };
                let cascade_per_s = number(channel, Number::Cascade);
                board.set_tuning(channel, Tuning { feed_forward, cascade_per_s }).await
            }
        }
    }
}

/// Returns whether other nodes can receive an answer.
fn fits<A: Serialize>(answer: &A) -> bool {
    cdr(answer).is_ok_and(|bytes| bytes.len() <= LONGEST_ANSWER_BYTES)
}

/// Replaces an answer that is too long by an empty one, by which ROS says that a call failed.
fn short<A: Serialize + Default>(answer: A) -> A {
    if fits(&answer) { answer } else { A::default() }
}

fn result(result: Result<(), NotSet>) -> SetParametersResult {
    let reason = result.err().map(|error| error.to_string());
    SetParametersResult { successful: reason.is_none(), reason: reason.unwrap_or_default() }
}

/// Returns the shortest decimal number that is `number` in single precision: 0.1 instead of 0.10000000149.
fn shortest(number: f32) -> f64 {
    number.to_string().parse().unwrap_or(f64::from(number))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use r4_rig::Rig;

    use super::*;

    fn store(keys: &[&str]) -> ParameterStore {
        let info =
            |key: &&str| ParameterInfo { key: key.parse().expect("a key"), active: 0.144, set: 1.0, built_in: 0.5 };
        ParameterStore { known: Some(keys.iter().map(info).collect()), changed: BTreeMap::new() }
    }

    #[test]
    fn names_are_listed_by_prefix_and_depth() {
        let store = store(&["board.link_timeout_ms", "osmc0.position_kp", "osmc0.speed_kp", "osmc1.position_kp"]);
        let list = |prefixes: &[&str], depth| {
            let prefixes = prefixes.iter().map(|prefix| (*prefix).to_owned()).collect();
            store.list(&ListParametersRequest { prefixes, depth }).result
        };
        assert_eq!((list(&[], 0).names.len(), list(&[], 1).names.len(), list(&[], 2).names.len()), (4, 0, 4));
        assert_eq!(list(&["osmc0"], 1).names, ["osmc0.position_kp", "osmc0.speed_kp"]);
        assert_eq!(list(&["osmc0.speed_kp", "board"], 0).names, ["board.link_timeout_ms", "osmc0.speed_kp"]);
        assert_eq!(list(&["osm"], 0), ListParametersResult::default());
        assert_eq!(list(&[], 0).prefixes, ["board", "osmc0", "osmc1"]);
    }

    #[test]
    fn a_group_that_is_not_restored_is_named() {
        let set = |active: f32| {
            let known = ["osmc0.position_kp", "osmc0.speed_kp"].map(|key| ParameterInfo {
                key: key.parse().expect("a key"),
                active,
                set: 1.0,
                built_in: 1.0,
            });
            let mut store = ParameterStore { known: Some(known.to_vec()), changed: BTreeMap::new() };
            let wanted = [("osmc0.position_kp", 1.0), ("osmc0.speed_kp", -1.0)]
                .map(|(name, value)| Parameter { name: name.into(), value: ParameterValue::double(value) });
            let rig = Rig::new("sim:osmc-bench".parse().expect("a board"));
            let set = rig.run(None, async |session| Ok::<_, r4_rig::Error>(store.set(session.board, &wanted).await));
            set.expect("a session").0.expect_err("no board takes a negative gain").to_string()
        };
        let [restored, lost] = [1.0, -2.0].map(set);
        assert!(!restored.contains("restored"), "{restored}");
        // The board refuses these old values, too.
        assert!(lost.starts_with(&restored) && lost.contains("the position gains of osmc0 could not be"), "{lost}");
    }

    /// Channels of the largest built-in board have 38 parameters, with names of up to 25 letters.
    #[test]
    fn what_is_too_long_for_an_answer_is_asked_for_in_parts() {
        let keys: Vec<String> = (0..4).map(|at| format!("osmc{at}.duty_per_acceleration")).collect();
        let all: Vec<&str> = keys.iter().map(String::as_str).cycle().take(60).collect();
        let store = store(&all);
        let whole = store.short_list(&ListParametersRequest::default()).result;
        assert_eq!((whole.names.len(), whole.prefixes.len()), (0, 4));
        let part = store.short_list(&ListParametersRequest { prefixes: vec!["osmc0".into()], depth: 0 }).result;
        assert_eq!(part.names.len(), 15);
        let values = |count| short(GetParametersResponse { values: vec![ParameterValue::double(1.0); count] }).values;
        // A value takes 48 bytes or 52, by its alignment.
        assert_eq!([values(24).len(), values(28).len()], [24, 0]);
    }

    #[test]
    fn values_are_what_the_board_works_with_in_its_units() {
        let store = store(&["osmc0.position_kp", "board.link_timeout_ms"]);
        assert_eq!(store.value("osmc0.position_kp"), ParameterValue::double(0.144));
        for unknown in ["osmc1.position_kp", "osmc0.colour", "use_sim_time", ""] {
            assert_eq!(store.value(unknown).kind, parameter_type::NOT_SET, "{unknown}");
        }
        let gain = store.describe("osmc0.position_kp");
        assert_eq!((gain.kind, gain.read_only, gain.description.as_str()), (3, false, "in duty/rad; built in: 0.5"));
        let timeout = store.describe("board.link_timeout_ms");
        assert!(timeout.read_only && timeout.additional_constraints.contains("next start"), "{timeout:?}");
        assert_eq!(store.describe("elbow").kind, parameter_type::NOT_SET);
    }

    proptest! {
        #[test]
        fn a_number_in_double_precision_is_the_same_in_single(bits in any::<u32>()) {
            let number = f32::from_bits(bits);
            if number.is_finite() {
                prop_assert_eq!(shortest(number) as f32, number);
            }
        }
    }
}
