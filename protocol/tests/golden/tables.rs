//! Golden tables of the versions that are no longer spoken, for tests of a board and of a host, which both include this
//! file by `#[path]`.

/// Frames of every message of versions 1 to 11, a row for each: direction, name and bytes.
pub(crate) const GOLDEN: [&str; 11] = [
    include_str!("v1.txt"),
    include_str!("v2.txt"),
    include_str!("v3.txt"),
    include_str!("v4.txt"),
    include_str!("v5.txt"),
    include_str!("v6.txt"),
    include_str!("v7.txt"),
    include_str!("v8.txt"),
    include_str!("v9.txt"),
    include_str!("v10.txt"),
    include_str!("v11.txt"),
];

/// Session of a host of version 4 with a board: sender and bytes of each frame.
pub(crate) const SESSION: &str = include_str!("v4-session.txt");

/// Returns the bytes of the rows of a table that begin with `who`.
pub(crate) fn rows(table: &str, who: &str) -> Vec<Vec<u8>> {
    let rows = table.lines().filter(|line| line.starts_with(who)).filter_map(|line| line.rsplit(' ').next());
    rows.map(|hex| (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).expect("hex")).collect())
        .collect()
}
