//! `--foxglove`: what a log would hold, while it happens, to Foxglove and other programs that speak its WebSocket protocol.

use std::net::SocketAddr;

use r4_log::Live;

/// Serves who looks on at an address of this machine.
///
/// # Errors
/// Where the address is none of this machine's own or taken, or this program was built without.
pub(crate) fn serve(address: SocketAddr) -> anyhow::Result<Box<dyn Live>> {
    if !address.ip().is_loopback() {
        return Err(Open(address).into());
    }
    server::serve(address)
}

/// Whoever reaches it would see all that the board does: the protocol has no key.
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

    /// A topic that changes rarely is told again after this time, for those who have come since, ns of the log.
    const AGAIN_NS: u64 = 1_000_000_000;
    /// Topics that hold until they change.
    const HOLDING: [&str; 1] = ["/state"];

    /// Topics, and who looks on.
    struct Server {
        context: Arc<Context>,
        topics: BTreeMap<u16, Topic>,
        /// Until it is dropped.
        _server: WebSocketServerHandle,
    }

    struct Topic {
        /// `None` where the library does not take it, of which was told.
        channel: Option<Arc<RawChannel>>,
        /// The last message and when it was told, of one that holds.
        held: Option<(Vec<u8>, u64)>,
        holds: bool,
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
        Ok(Box::new(Server { context, topics: BTreeMap::new(), _server: server }))
    }

    impl Live for Server {
        fn topic(&mut self, topic: &LiveTopic<'_>) {
            let schema = Schema::new(topic.schema, "jsonschema", topic.json_schema.as_bytes().to_vec());
            let builder =
                ChannelBuilder::new(topic.name).context(&self.context).message_encoding("json").schema(schema);
            let channel =
                builder.build_raw().inspect_err(|why| eprintln!("r4: {} is not live: {why}", topic.name)).ok();
            let holds = HOLDING.contains(&topic.name);
            self.topics.insert(topic.number, Topic { channel, held: None, holds });
        }

        fn message(&mut self, topic: u16, log_time_ns: u64, json: &[u8]) {
            let at = || PartialMetadata { log_time: Some(log_time_ns) };
            if let Some(Topic { channel: Some(channel), held, holds }) = self.topics.get_mut(&topic) {
                channel.log_with_meta(json, at());
                *held = holds.then(|| (json.to_vec(), log_time_ns));
            }
            for Topic { channel, held, .. } in self.topics.values_mut() {
                if let (Some(channel), Some((message, told_ns))) = (channel, held)
                    && log_time_ns.saturating_sub(*told_ns) >= AGAIN_NS
                {
                    channel.log_with_meta(message, at());
                    *told_ns = log_time_ns;
                }
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
