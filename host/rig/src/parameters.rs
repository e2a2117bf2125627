//! Parameters of a board, by their keys.

use r4_driver::{Board, Clock};
use r4_protocol::{ChannelId, Parameter, ParameterInfo, ParameterKey};

use crate::Error;

/// Parameters of a board at one moment.
#[derive(Clone, Debug)]
pub(crate) struct Parameters(pub(crate) Vec<ParameterInfo>);

impl Parameters {
    /// Reads the parameters of a board.
    pub(crate) async fn of<C: Clock>(board: &Board<C>) -> Result<Self, Error> {
        Ok(Self(board.parameters().await?))
    }

    /// Parameter of a channel, or of the board for `None`.
    pub(crate) fn get(&self, channel: Option<ChannelId>, parameter: Parameter) -> Option<&ParameterInfo> {
        self.0.iter().find(|info| info.key == ParameterKey { channel, parameter })
    }

    /// Active value of a parameter that the channel must have.
    ///
    /// # Errors
    /// [`Error::NotTold`] when the board does not report it.
    pub(crate) fn active(&self, channel: ChannelId, parameter: Parameter) -> Result<f32, Error> {
        let found = self.get(Some(channel), parameter).map(|info| info.active);
        found.ok_or(Error::NotTold { channel, parameter })
    }
}
