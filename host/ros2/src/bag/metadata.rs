//! `metadata.yaml`: the contents of a bag as rosbag2 wants them beside its files.
//!
//! # Source
//! `rosbag2_storage`: `yaml.hpp` and `qos.cpp`, version 9 of the metadata, which Jazzy writes.

use std::fmt::Write as _;

/// Version of the metadata's keys.
const VERSION: u32 = 9;

/// Messages of one topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagTopic {
    /// Absolute name.
    pub name: String,
    /// Type, as in `sensor_msgs/msg/Imu`.
    pub kind: String,
    /// Whether readers that come later get the last message.
    pub is_latched: bool,
    /// How many.
    pub messages: u64,
}

/// Contents of a bag of one file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Contents<'a> {
    /// Name of the file, in the folder of the metadata.
    pub(super) file: &'a str,
    /// Of the first message, ns since 1970.
    pub(super) begin_ns: u64,
    /// From the first to the last, ns.
    pub(super) duration_ns: u64,
    pub(super) topics: &'a [BagTopic],
    /// What was recorded, for people.
    pub(super) about: &'a [(&'a str, &'a str)],
}

impl Contents<'_> {
    /// The file's text.
    pub(super) fn to_yaml(&self) -> String {
        let Self { file, begin_ns, duration_ns, topics, about } = self;
        let messages: u64 = topics.iter().map(|topic| topic.messages).sum();
        let file = quoted(file);
        let mut text = format!(
            "rosbag2_bagfile_information:\n  version: {VERSION}\n  storage_identifier: mcap\n  \
             duration:\n    nanoseconds: {duration_ns}\n  \
             starting_time:\n    nanoseconds_since_epoch: {begin_ns}\n  \
             message_count: {messages}\n  topics_with_message_count:\n"
        );
        for BagTopic { name, kind, is_latched, messages } in *topics {
            let profile = indented(&qos(*is_latched), "        ");
            // Writing to a string does not fail.
            let _ = write!(
                text,
                "    - topic_metadata:\n        name: {name}\n        type: {kind}\n        serialization_format: cdr\n        \
                 offered_qos_profiles:\n{profile}        type_description_hash: \"\"\n      message_count: {messages}\n"
            );
        }
        let _ = write!(
            text,
            "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - {file}\n  \
             files:\n    - path: {file}\n      starting_time:\n        nanoseconds_since_epoch: {begin_ns}\n      \
             duration:\n        nanoseconds: {duration_ns}\n      message_count: {messages}\n  custom_data:\n"
        );
        for (key, value) in *about {
            let _ = writeln!(text, "    {key}: {}", quoted(value));
        }
        text + "  ros_distro: \"\"\n"
    }
}

/// Quality of service that a topic is offered with, as a list in YAML: reliable, as the node offers it.
pub(super) fn qos(is_latched: bool) -> String {
    // Times that never end, as rosbag2 writes them.
    let infinite = "\n    sec: 9223372036\n    nsec: 854775807";
    let (durability, depth) = if is_latched { ("transient_local", 1) } else { ("volatile", 10) };
    format!(
        "- history: keep_last\n  depth: {depth}\n  reliability: reliable\n  durability: {durability}\n  \
         deadline:{infinite}\n  lifespan:{infinite}\n  liveliness: automatic\n  \
         liveliness_lease_duration:{infinite}\n  avoid_ros_namespace_conventions: false\n"
    )
}

fn indented(text: &str, by: &str) -> String {
    text.lines().map(|line| format!("{by}{line}\n")).collect()
}

/// A text as YAML's double-quoted scalar.
fn quoted(text: &str) -> String {
    let escaped = text.chars().map(|letter| match letter {
        '"' | '\\' => format!("\\{letter}"),
        letter if letter.is_control() => format!("\\u{:04x}", u32::from(letter)),
        letter => letter.to_string(),
    });
    format!("\"{}\"", escaped.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_cannot_end_their_quotes() {
        assert_eq!(quoted("a \"b\" \\ c\nd"), r#""a \"b\" \\ c\u000ad""#);
    }
}
