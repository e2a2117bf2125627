//! `--foxglove`: what a log would hold, while it happens, to Foxglove and other programs that speak its WebSocket protocol.

use std::net::SocketAddr;

use r4_log::Live;

/// Serves viewers at a loopback address.
///
/// # Errors
/// When other machines reach the address, its port is taken, or this program was built without the feature `live`.
pub(crate) fn serve(address: SocketAddr) -> anyhow::Result<Box<dyn Live>> {
    if !address.ip().is_loopback() {
        return Err(Open(address).into());
    }
    server::serve(address)
}

/// The protocol has no key: every program that reaches the address sees all that the board does.
#[derive(Debug, thiserror::Error)]
#[error(
    "{0} can be reached from other machines, and nothing asks those for a key: serve it on 127.0.0.1, and let others in by ssh -L {port}:127.0.0.1:{port}",
    port = .0.port()
)]
struct Open(SocketAddr);

#[cfg(feature = "live")]
mod server {
    use std::{collections::BTreeMap, net::SocketAddr, sync::Arc};

    use anyhow::Context as _;
    use foxglove::{ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServerHandle};
    use r4_log::{Live, LiveTopic};

    /// The last message of a topic that is sent on change only is repeated after this time, ns of the log: a viewer that connects
    /// later has to see it, and the protocol does not latch.
    const REPEAT_NS: u64 = 1_000_000_000;
    /// The topic that is sent on change only.
    const ON_CHANGE: &str = "/state";

    /// WebSocket server, and the log's topics as it has them.
    struct Server {
        context: Arc<Context>,
        /// By their numbers in the log; without those that the library refused.
        topics: BTreeMap<u16, Arc<RawChannel>>,
        /// Last message of [`ON_CHANGE`]: its topic, itself, and when it was sent, ns.
        held: Option<(u16, Vec<u8>, u64)>,
        /// Serves until it is dropped.
        _server: WebSocketServerHandle,
    }

    pub(super) fn serve(address: SocketAddr) -> anyhow::Result<Box<dyn Live>> {
        let context = Context::new();
        let server = context
            .websocket_server()
            .name(concat!("r4 ", env!("CARGO_PKG_VERSION")))
            .bind(address.ip().to_string(), address.port())
            .start_blocking()
            .with_context(|| format!("cannot listen at {address}"))?;
        eprintln!(
            "r4: live at ws://{}:{}: open that connection in Foxglove or Lichtblick",
            address.ip(),
            server.port()
        );
        Ok(Box::new(Server { context, topics: BTreeMap::new(), held: None, _server: server }))
    }

    impl Live for Server {
        fn topic(&mut self, topic: &LiveTopic<'_>) {
            let schema = Schema::new(topic.schema, "jsonschema", topic.json_schema.as_bytes().to_vec());
            let builder =
                ChannelBuilder::new(topic.name).context(&self.context).message_encoding("json").schema(schema);
            match builder.build_raw() {
                Ok(channel) => drop(self.topics.insert(topic.number, channel)),
                Err(why) => eprintln!("r4: {} is not live: {why}", topic.name),
            }
        }

        fn message(&mut self, topic: u16, log_time_ns: u64, json: &[u8]) {
            let at = || PartialMetadata { log_time: Some(log_time_ns) };
            if let Some(channel) = self.topics.get(&topic) {
                channel.log_with_meta(json, at());
                if channel.topic() == ON_CHANGE {
                    self.held = Some((topic, json.to_vec(), log_time_ns));
                }
            }
            if let Some((topic, message, sent_ns)) = &mut self.held
                && log_time_ns.saturating_sub(*sent_ns) >= REPEAT_NS
                && let Some(channel) = self.topics.get(topic)
            {
                channel.log_with_meta(message, at());
                *sent_ns = log_time_ns;
            }
        }
    }
}

#[cfg(not(feature = "live"))]
mod server {
    use std::net::SocketAddr;

    use r4_log::Live;

    /// What this program was not built with.
    #[derive(Debug, thiserror::Error)]
    #[error(
        "this r4 was built without Foxglove's WebSocket. Build one with it, in the repository:\n  \
         cargo install --locked --path host/cli --features live\n\
         or record with --record, and open the file there"
    )]
    struct NotBuilt;

    pub(super) fn serve(_: SocketAddr) -> anyhow::Result<Box<dyn Live>> {
        Err(NotBuilt.into())
    }
}
