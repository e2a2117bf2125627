//! A board's parameters, by their keys.

use r4_driver::{Board, Clock};
use r4_protocol::{ChannelId, Parameter, ParameterInfo, ParameterKey};

use crate::Error;

/// The parameters of a board at one moment.
#[derive(Clone, Debug)]
pub(crate) struct Parameters(pub(crate) Vec<ParameterInfo>);

impl Parameters {
    /// Asks the board.
    pub(crate) async fn of<C: Clock>(board: &Board<C>) -> Result<Self, Error> {
        Ok(Self(board.parameters().await?))
    }

    /// One of a channel, or of the board for `None`.
    pub(crate) fn get(&self, channel: Option<ChannelId>, parameter: Parameter) -> Option<&ParameterInfo> {
        self.0.iter().find(|info| info.key == ParameterKey { channel, parameter })
    }

    /// The number in force for one that the channel must have.
    ///
    /// # Errors
    /// [`Error::NotTold`]
    pub(crate) fn active(&self, channel: ChannelId, parameter: Parameter) -> Result<f32, Error> {
        let found = self.get(Some(channel), parameter).map(|info| info.active);
        found.ok_or(Error::NotTold { channel, parameter })
    }
}
