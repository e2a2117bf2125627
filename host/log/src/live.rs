//! Live view of a log while it is recorded.

/// Topic of a log, with the description of its messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LiveTopic<'a> {
    /// Number of the topic in this log, which its messages refer to.
    pub number: u16,
    /// Name of the topic, as in `/osmc0`.
    pub name: &'a str,
    /// Name of the schema, as in `r4.Motor`.
    pub schema: &'a str,
    /// JSON Schema of the messages.
    pub json_schema: &'a str,
}

/// Receiver of a recording while it is made: the same topics, schemas and times as in the file.
pub trait Live {
    /// Announces a topic before its first message.
    fn topic(&mut self, topic: &LiveTopic<'_>);

    /// Receives a message in JSON. `log_time_ns` is in ns since 1970, or on a virtual board's clock since the
    /// recording began.
    fn message(&mut self, topic: u16, log_time_ns: u64, json: &[u8]);
}
