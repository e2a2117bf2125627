//! A log while it is recorded, for live views.

/// Topic of a log, with what describes its messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LiveTopic<'a> {
    /// Number in this log, by which its messages come.
    pub number: u16,
    /// Name in the log, as in `/osmc0`.
    pub name: &'a str,
    /// Name of the schema, as in `r4.Motor`.
    pub schema: &'a str,
    /// The schema, a JSON Schema.
    pub json_schema: &'a str,
}

/// Receiver of what a recording holds, while it is recorded: the same topics, schemas and times.
pub trait Live {
    /// A topic begins. Each comes before its first message.
    fn topic(&mut self, topic: &LiveTopic<'_>);

    /// A message of a topic, in JSON, at `log_time_ns` (ns since 1970, or of a virtual board's clock from the recording's beginning on).
    fn message(&mut self, topic: u16, log_time_ns: u64, json: &[u8]);
}
