//! Writer of `metadata.yaml`, which lists the contents of a bag for rosbag2.
//!
//! # Source
//! `rosbag2_storage`: `yaml.hpp` and `qos.cpp`, version 9 of the metadata, which Jazzy writes.

use std::fmt::Write as _;

/// Version of the metadata's format.
const VERSION: u32 = 9;

/// Topic of a bag with its number of messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagTopic {
    /// Absolute name of the topic.
    pub name: String,
    /// Type of its messages, as in `sensor_msgs/msg/Imu`.
    pub kind: String,
    /// True when readers that subscribe later receive the last message.
    pub is_latched: bool,
    /// Number of messages in the bag.
    pub messages: u64,
}

/// Contents of a bag with a single file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Contents<'a> {
    /// Name of the file, relative to the folder of the metadata.
    pub(super) file: &'a str,
    /// Time of the first message, ns since 1970.
    pub(super) begin_ns: u64,
    /// Time from the first message to the last, ns.
    pub(super) duration_ns: u64,
    pub(super) topics: &'a [BagTopic],
    /// Facts about the recording, as keys and values for people.
    pub(super) about: &'a [(&'a str, &'a str)],
}

impl Contents<'_> {
    /// Returns the text of `metadata.yaml`.
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

/// Returns the quality of service with which the node offers a topic, as a YAML list with one element: reliable.
pub(super) fn qos(is_latched: bool) -> String {
    // rosbag2 writes an infinite duration as i64::MAX nanoseconds.
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

/// Returns a text as a double-quoted scalar of YAML.
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
