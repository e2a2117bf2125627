//! Definitions of ROS messages as text, which a bag contains for readers that do not know a type.

use std::collections::BTreeMap;

/// Fields and constants of every message type in a bag, and of the types nested in them, one section each.
///
/// # Source
/// The interface files of `common_interfaces` 5.3.6, `rcl_interfaces` 2.0.3 and `geometry2` as of ROS 2 Jazzy: types, names, order and
/// constants, without their comments. The tests compare them with those of `rosbags`.
const INTERFACES: &str = include_str!("interfaces.txt");
/// Start of a section's first line, before the name of its type.
const HEAD: &str = "MSG: ";
/// Line that rosbag2 puts before each nested definition.
const SEPARATOR: &str = "================================================================================";

/// Returns the definition of a type such as `sensor_msgs/Imu`, followed by those of all nested types, in the encoding `ros2msg`; `None`
/// for a type that no bag of this crate contains.
#[must_use]
pub fn definition(kind: &str) -> Option<String> {
    let sections = sections();
    let mut order = vec![kind.to_owned()];
    let mut text = String::new();
    // Depth first: nested types follow directly behind the type that contains them. The tests compare the order with `rosbags`.
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

/// Returns the message type of a field; `None` for numbers, texts and constants.
fn message_of(line: &str) -> Option<String> {
    let kind = line.split_whitespace().next()?;
    let kind = kind.split('[').next()?;
    kind.contains('/').then(|| kind.to_owned())
}

/// Returns the body of each section by the name of its type.
fn sections() -> BTreeMap<&'static str, String> {
    let sections = INTERFACES.split(HEAD).filter_map(|section| section.split_once('\n'));
    sections.map(|(kind, body)| (kind, format!("{}\n", body.trim_end()))).collect()
}
