//! Snapshot tests of screens: they are compared with the files in `snapshots/`, which people can read.
//!
//! After an intended change, `R4_UPDATE_SCREENS=1 cargo test -p r4 --bin r4` rewrites the files.

use std::{env, fs, path::PathBuf};

use ratatui::{Frame, Terminal, backend::TestBackend};

/// Screen as text, without trailing spaces.
pub(crate) fn text(width: u16, height: u16, draw: impl FnOnce(&mut Frame<'_>)) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a buffer can be drawn on");
    terminal.draw(draw).expect("a buffer can be drawn on");
    let buffer = terminal.backend().buffer();
    let rows = buffer.content().chunks(usize::from(width));
    rows.map(|row| row.iter().map(|cell| cell.symbol()).collect::<String>().trim_end().to_owned() + "\n").collect()
}

/// Asserts that the screen equals `snapshots/<name>-<width>x<height>.txt`.
pub(crate) fn assert_is(name: &str, width: u16, height: u16, draw: impl FnOnce(&mut Frame<'_>)) {
    let file = format!("src/screen/snapshots/{name}-{width}x{height}.txt");
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(&file);
    let ours = text(width, height, draw);
    if env::var_os("R4_UPDATE_SCREENS").is_some() {
        fs::write(&path, &ours).expect("the screen can be written");
    }
    let stored = fs::read_to_string(&path).unwrap_or_default();
    assert!(stored == ours, "{file} is another screen:\n{stored}\nand now it is\n{ours}");
}
