//! `--plant`, `--body` and `--blind`: physics of a virtual board's motors and body that replace those of its files.

use std::{path::PathBuf, str::FromStr};

use r4_protocol::ChannelId;

/// Plant file, with the channel of a board, or without for `identify`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct OtherPlant {
    pub(crate) channel: Option<ChannelId>,
    pub(crate) file: PathBuf,
}

/// Syntax of `--plant` for a board, for error messages.
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
