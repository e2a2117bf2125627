//! `--plant`, `--body` and `--blind`: other physics for the motors and the body of a virtual board than its files say.

use std::{path::PathBuf, str::FromStr};

use r4_protocol::ChannelId;

/// A plant file, for a channel of a board, or for `identify` without one.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct OtherPlant {
    pub(crate) channel: Option<ChannelId>,
    pub(crate) file: PathBuf,
}

/// What a board needs.
pub(crate) const EXAMPLE: &str = "a channel, = and a plant file, as in osmc0=plant.toml";

impl FromStr for OtherPlant {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some((channel, file)) = text.split_once('=') else {
            return if text.is_empty() { Err(EXAMPLE.into()) } else { Ok(Self { channel: None, file: text.into() }) };
        };
        if file.is_empty() {
            return Err(EXAMPLE.into());
        }
        let channel = channel.parse().map_err(|error| format!("{error}; write {EXAMPLE}"))?;
        Ok(Self { channel: Some(channel), file: file.into() })
    }
}
