//! Definitions of ROS messages as text, which a bag has for readers that do not know a type.

use std::collections::BTreeMap;

/// Fields and constants of every message in a bag and of those inside them, one section each.
///
/// # Source
/// The interface files of `common_interfaces` 5.3.6, `rcl_interfaces` 2.0.3 and `geometry2` as of ROS 2 Jazzy: types, names, order and
/// constants, without their comments. The tests compare them with those of `rosbags`.
const INTERFACES: &str = include_str!("interfaces.txt");
/// First line of a section, before the name of its type.
const HEAD: &str = "MSG: ";
/// Line between a definition and those of the messages inside it, as rosbag2 has it.
const SEPARATOR: &str = "================================================================================";

/// Definition of a type such as `sensor_msgs/Imu` with those of all messages inside it behind it, as the encoding `ros2msg` has them;
/// `None` for a type that no bag of ours has.
#[must_use]
pub fn definition(kind: &str) -> Option<String> {
    let sections = sections();
    let mut order = vec![kind.to_owned()];
    let mut text = String::new();
    // Depth first: what a message contains stands right behind it.
    let mut at = 0;
    while let Some(next) = order.get(at).cloned() {
        let body = sections.get(next.as_str())?;
        if at > 0 {
            text += &format!("{SEPARATOR}\n{HEAD}{next}\n");
        }
        text += body;
        at += 1;
        let mut place = at;
        for message in body.lines().filter_map(message_of) {
            if !order.contains(&message) {
                order.insert(place, message);
                place += 1;
            }
        }
    }
    Some(text)
}

/// Type of the message that a field contains; `None` for numbers, texts and constants.
fn message_of(line: &str) -> Option<String> {
    let kind = line.split_whitespace().next()?;
    let kind = kind.split('[').next()?;
    kind.contains('/').then(|| kind.to_owned())
}

fn sections() -> BTreeMap<&'static str, String> {
    let sections = INTERFACES.split(HEAD).filter_map(|section| section.split_once('\n'));
    sections.map(|(kind, body)| (kind, format!("{}\n", body.trim_end()))).collect()
}
