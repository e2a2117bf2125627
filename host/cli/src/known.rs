//! Cache of the channels of boards at the other end of links, as last seen, for shell completion only.
//!
//! The file `r4/channels` in the user's cache folder has a line per board: address and channels, separated by tabs. An
//! unreadable or unwritable cache counts as empty.

use std::{env, fs, path::PathBuf, process};

use r4_links::Address;
use r4_protocol::{ChannelId, ChannelInfo};

/// Most boards in the file; those seen longest ago are dropped.
const MOST: usize = 16;

fn path() -> Option<PathBuf> {
    let absolute = |name: &str| env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let folder = absolute("XDG_CACHE_HOME").or_else(|| Some(absolute("HOME")?.join(".cache")))?;
    Some(folder.join("r4").join("channels"))
}

fn lines() -> Vec<String> {
    let text = path().and_then(|path| fs::read_to_string(path).ok()).unwrap_or_default();
    text.lines().map(str::to_owned).collect()
}

/// Stores the channels of the board at `address`.
pub(crate) fn remember(address: &Address, channels: &[ChannelInfo]) {
    let Some(path) = path() else { return };
    let address = address.to_string();
    // A tab or a line break would break the file's format.
    if address.contains(char::is_control) {
        return;
    }
    let ids = channels.iter().map(|info| format!("\t{}", info.id));
    let line = address.clone() + &ids.collect::<String>();
    let before = lines();
    // Usual case: the same board again, so nothing to write.
    if before.first() == Some(&line) {
        return;
    }
    let others = before.iter().filter(|other| other.split('\t').next() != Some(&address)).take(MOST - 1);
    let text: String = [&line].into_iter().chain(others).map(|line| line.clone() + "\n").collect();
    // Write a file of this process and rename it: shells and other commands may read meanwhile.
    let beside = path.with_extension(process::id().to_string());
    let made = path.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(&beside, text));
    if made.and_then(|()| fs::rename(&beside, &path)).is_err() {
        let _ = fs::remove_file(beside);
    }
}

/// Channels of the board at `address` when it was last seen; empty if unknown.
pub(crate) fn channels(address: &Address) -> Vec<ChannelId> {
    let address = address.to_string();
    let lines = lines();
    let of = lines.iter().find_map(|line| line.split_once('\t').filter(|(known, _)| *known == address));
    of.map_or_else(Vec::new, |(_, ids)| ids.split('\t').filter_map(|id| id.parse().ok()).collect())
}

/// Addresses of all boards in the file.
pub(crate) fn boards() -> Vec<String> {
    lines().iter().filter_map(|line| line.split('\t').next().map(str::to_owned)).collect()
}
