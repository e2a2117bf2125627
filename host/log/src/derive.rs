//! Messages that a program derives from telemetry while it is recorded.

use r4_protocol::{ChannelInfo, Telemetry};

/// Topic of derived messages.
#[derive(Clone, Copy, Debug)]
pub struct DerivedTopic {
    /// Name of the topic, as in `/tf`. Names of channels and of the log's own topics are taken.
    pub name: &'static str,
    /// Name of the schema, as in `foxglove.FrameTransforms`.
    pub schema: &'static str,
    /// Builds the JSON Schema of the messages; called once per recording.
    pub json_schema: fn() -> String,
}

/// Source of derived messages, which are recorded and shown live beside the telemetry. Readers of logs skip them.
pub trait Derive {
    /// Derives the messages of a frame and passes each as JSON to `give`.
    ///
    /// `channels` describes the board's channels; `log_time_ns` is the time of the frame as the log counts it, ns.
    fn derive(
        &mut self,
        channels: &[ChannelInfo],
        telemetry: &Telemetry,
        log_time_ns: u64,
        give: &mut dyn FnMut(DerivedTopic, Vec<u8>),
    );
}
