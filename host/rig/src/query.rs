//! Query of a single sample.

use r4_driver::ChannelSample;
use r4_protocol::ChannelId;

use crate::{Error, Session};

/// Period of a subscription that a query opens, ms: that at which motions are watched.
const QUERY_EVERY_MS: u16 = 10;

impl Session<'_> {
    /// Returns the next sample of a channel, at most one period of its subscription old: the state of a motor, the
    /// reading of an input.
    ///
    /// The first query of a channel subscribes to it every 10 ms, and later ones read that subscription: each takes up to a period and
    /// a round trip of the link.
    ///
    /// # Errors
    /// [`Error::Board`] when the board has no such channel or no room for another subscription, or the link fails.
    pub async fn query(&self, channel: ChannelId) -> Result<ChannelSample, Error> {
        self.board.channel(channel)?;
        let subscribed = self.board.subscriptions().into_iter().find(|(of, _)| *of == channel);
        let period_ms = subscribed.map_or(QUERY_EVERY_MS, |(_, period_ms)| period_ms);
        let mut samples = self.board.samples(channel, period_ms).await?;
        Ok(samples.next().await?)
    }
}
