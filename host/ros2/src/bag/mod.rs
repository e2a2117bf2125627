//! Conversion of a log to a bag of rosbag2: a folder with an MCAP file of the profile `ros2` and `metadata.yaml`, for `ros2 bag play`. The
//! messages are those of the node, by the same conversions.

mod definition;
mod metadata;
mod source;
#[cfg(test)]
mod tests;

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, BufWriter},
    path::{Path, PathBuf},
};

use byteorder::LittleEndian;
use r4_log::{Log, McapMessage, McapTopic, McapWriter};
use r4_rig::GroundDrive;
use serde::Serialize;

use crate::{Namespace, Report, names::Topic, time::Stamp};

pub use definition::definition;
pub use metadata::BagTopic;

/// First bytes of a message: CDR in little-endian order, without options (OMG DDSI-RTPS 2.3, 10.2).
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Reason why a log could not be converted to a bag.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// The path has no last component that is a name in Unicode.
    #[error("{} is no folder name: give the name of a new folder, such as run", path.display())]
    NoName {
        /// Path as the caller gave it.
        path: PathBuf,
    },
    /// The folder exists already.
    #[error("{} exists already: give the name of a new folder, or remove it", path.display())]
    Exists {
        /// Path of the folder.
        path: PathBuf,
    },
    /// A file or folder cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// Path of the file or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The log has no sample and no state that a bag can hold.
    #[error("the log has no data for a ROS 2 topic: record motors, encoders, an IMU, range sensors or supplies")]
    Empty,
    /// A message could not be encoded as CDR.
    #[error("cannot encode a message of {topic} ({why}): report this as a defect")]
    Encode {
        /// Topic of the message.
        topic: String,
        /// Error of the encoder.
        why: String,
    },
}

/// Summary of a written bag.
#[derive(Clone, Debug, PartialEq)]
pub struct Bag {
    /// Folder of the bag.
    pub folder: PathBuf,
    /// Topics of the bag, sorted by name.
    pub topics: Vec<BagTopic>,
    /// Time from the first message to the last, s.
    pub duration_s: f64,
}

/// Writes a log as a bag to the new folder `folder`. `drive` is the robot's drive: without one, and for robots that are not skid-steer,
/// the bag has no `odom` and no `/tf`.
///
/// # Errors
/// [`BagError::NoName`] and [`BagError::Exists`] before anything is written; [`BagError::Io`], [`BagError::Encode`] and
/// [`BagError::Empty`] may leave an incomplete folder behind.
pub fn write_bag(log: &Log, drive: Option<&GroundDrive>, folder: &Path) -> Result<Bag, BagError> {
    let name = folder.file_name().and_then(|name| name.to_str());
    let name = name.ok_or_else(|| BagError::NoName { path: folder.to_owned() })?;
    let file = format!("{name}_0.mcap");
    // `create_dir` fails for an existing folder, so no bag is ever overwritten.
    fs::create_dir(folder).map_err(|source| match source.kind() {
        io::ErrorKind::AlreadyExists => BagError::Exists { path: folder.to_owned() },
        _ => BagError::Io { path: folder.to_owned(), source },
    })?;
    let path = folder.join(&file);
    let failed = |source| BagError::Io { path: path.clone(), source };
    let out = BufWriter::new(File::create(&path).map_err(failed)?);
    let written = write_messages(log, drive, out).map_err(|error| match error {
        WriteError::Io(source) => failed(source),
        WriteError::Encode { topic, why } => BagError::Encode { topic, why },
    })?;
    let (begin_ns, end_ns) = written.span_ns.ok_or(BagError::Empty)?;
    let header = &log.header;
    let recorded_at = header.recorded.as_ref().map(r4_log::Recorded::at).unwrap_or_default();
    let about = [
        ("robot", &header.robot),
        ("board", &header.board),
        ("firmware", &header.firmware),
        ("recorded", &recorded_at),
    ];
    let contents = metadata::Contents {
        file: &file,
        begin_ns,
        duration_ns: end_ns - begin_ns,
        topics: &written.topics,
        about: &about.map(|(key, value)| (key, value.as_str())),
    };
    let path = folder.join("metadata.yaml");
    fs::write(&path, contents.to_yaml()).map_err(|source| BagError::Io { path, source })?;
    let duration_s = (end_ns - begin_ns) as f64 * 1e-9;
    Ok(Bag { folder: folder.to_owned(), topics: written.topics, duration_s })
}

enum WriteError {
    Io(io::Error),
    Encode { topic: String, why: String },
}

struct Written {
    topics: Vec<BagTopic>,
    /// Times of the first and the last message, ns since 1970; `None` without messages.
    span_ns: Option<(u64, u64)>,
}

/// Writes the messages of a log as an MCAP file.
fn write_messages(log: &Log, drive: Option<&GroundDrive>, out: impl io::Write) -> Result<Written, WriteError> {
    let library = concat!("r4-ros2/", env!("CARGO_PKG_VERSION"));
    let mut mcap = McapWriter::new(out, "ros2", library, None).map_err(WriteError::Io)?;
    let mut topics: BTreeMap<String, (u16, BagTopic)> = BTreeMap::new();
    let mut span_ns = None;
    let mut failed = None;
    source::reports(log, drive, |stamp, report| {
        if failed.is_some() {
            return;
        }
        match write_message(&mut mcap, &mut topics, stamp, &report) {
            Ok(time_ns) => {
                let (first, last) = span_ns.unwrap_or((time_ns, time_ns));
                span_ns = Some((time_ns.min(first), time_ns.max(last)));
            }
            Err(error) => failed = Some(error),
        }
    });
    if let Some(error) = failed {
        return Err(error);
    }
    mcap.finish().map_err(WriteError::Io)?;
    Ok(Written { topics: topics.into_values().map(|(_, topic)| topic).collect(), span_ns })
}

/// Writes a message and returns its time, ns since 1970. The first message of a topic also declares the topic.
fn write_message<W: io::Write>(
    mcap: &mut McapWriter<W>,
    topics: &mut BTreeMap<String, (u16, BagTopic)>,
    stamp: Stamp,
    report: &Report,
) -> Result<u64, WriteError> {
    // MCAP has no times before 1970; they become 0.
    let time_ns = u64::try_from(stamp.as_ns()).unwrap_or_default();
    // Not expected: each report from a log has a topic and a listed type, which the tests check for all of them.
    let unknown = |topic: &str| WriteError::Encode { topic: topic.to_owned(), why: "no such topic".into() };
    let Topic { name, kind, is_latched } = report.topic().ok_or_else(|| unknown("a channel"))?;
    let name = Namespace::root().resolve(&name);
    let encode = |why: cdr_encoding::Error| WriteError::Encode { topic: name.clone(), why: why.to_string() };
    let data = to_cdr(report).map_err(encode)?;
    let (id, topic) = match topics.get_mut(&name) {
        Some(topic) => topic,
        None => {
            let full = kind.replace('/', "/msg/");
            let id = mcap.topic(&McapTopic {
                name: &name,
                schema: &full,
                schema_encoding: "ros2msg",
                schema_text: &definition(kind).ok_or_else(|| unknown(&name))?,
                encoding: "cdr",
                metadata: &[("offered_qos_profiles", metadata::qos(is_latched).as_str())],
            });
            let topic = BagTopic { name: name.clone(), kind: full, is_latched, messages: 0 };
            topics.entry(name).or_insert((id.map_err(WriteError::Io)?, topic))
        }
    };
    // The sequence number of a topic wraps to 0 after 2^32 messages.
    let sequence = topic.messages as u32;
    topic.messages += 1;
    let header = McapMessage { channel_id: *id, sequence, log_time: time_ns, publish_time: time_ns };
    mcap.message(&header, &data).map_err(WriteError::Io)?;
    Ok(time_ns)
}

/// Encodes a message as CDR behind its encapsulation header.
fn to_cdr(report: &Report) -> cdr_encoding::Result<Vec<u8>> {
    match report {
        Report::Odometry(message) => cdr(message),
        Report::Transform(message) => cdr(message),
        Report::Joints(message) => cdr(message),
        Report::Imu(_, message) => cdr(message),
        Report::Range(_, message) => cdr(message),
        Report::Battery(_, message) => cdr(message),
        Report::Diagnostics(message) => cdr(message),
        Report::State(message) => cdr(message),
        Report::Clock(message) => cdr(message),
        Report::Commanded(message) => cdr(message),
        // It has no topic, so `write_message` has refused it already.
        Report::Deactivated => Ok(Vec::new()),
    }
}

/// Encodes a message as CDR with its encapsulation header.
pub(crate) fn cdr<M: Serialize>(message: &M) -> cdr_encoding::Result<Vec<u8>> {
    let mut bytes = ENCAPSULATION.to_vec();
    // CDR aligns numbers relative to the end of the encapsulation header, not to the start of the buffer.
    cdr_encoding::to_writer::<M, LittleEndian, _>(&mut bytes, message)?;
    Ok(bytes)
}
