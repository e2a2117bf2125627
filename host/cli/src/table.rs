//! Tables on a terminal.

use comfy_table::{
    CellAlignment, Table,
    presets::{ASCII_MARKDOWN, UTF8_BORDERS_ONLY},
};

/// New table with these columns; those in `numbers` are flush right.
pub(crate) fn new(header: &[&str], numbers: std::ops::Range<usize>) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_BORDERS_ONLY).set_header(header);
    for index in numbers {
        if let Some(column) = table.column_mut(index) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}

/// Converts a table to Markdown, for a page of documentation.
pub(crate) fn markdown(mut table: Table) -> Table {
    table.load_style(ASCII_MARKDOWN);
    table
}
