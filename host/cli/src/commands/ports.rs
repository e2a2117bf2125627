//! `r4 ports`: serial ports of this machine, and which of them are boards.

use r4_links::ports::{self, Port};
use serde::Serialize;

use crate::{args::Args, output, table};

#[derive(Serialize)]
struct Ports {
    ports: Vec<Row>,
}

#[derive(Serialize)]
struct Row {
    /// Address, as a value for `--board`.
    board: String,
    is_board: bool,
    product: Option<String>,
    serial: Option<String>,
    /// USB vendor and product identifiers, in hex.
    usb: Option<String>,
}

impl From<Port> for Row {
    fn from(port: Port) -> Self {
        let usb = port.usb.as_ref();
        Self {
            board: format!("serial:{}", port.path.display()),
            is_board: port.is_board(),
            product: usb.and_then(|usb| usb.product.clone()),
            serial: usb.and_then(|usb| usb.serial.clone()),
            usb: usb.map(|usb| format!("{:04x}:{:04x}", usb.id.0, usb.id.1)),
        }
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<bool> {
    let ports: Vec<Row> = ports::list()?.into_iter().map(Row::from).collect();
    if args.json {
        output::json(&Ports { ports })?;
        return Ok(true);
    }
    if ports.is_empty() {
        eprintln!("r4: this machine has no serial ports: is the board's USB cable plugged in?");
        return Ok(true);
    }
    let mut rows = table::new(&["--board", "a board", "USB", "product", "serial number"], 0..0);
    for port in ports {
        let is_board = if port.is_board { "yes" } else { "" };
        let or_empty = |text: Option<String>| text.unwrap_or_default();
        rows.add_row([port.board, is_board.into(), or_empty(port.usb), or_empty(port.product), or_empty(port.serial)]);
    }
    output::line(rows)?;
    Ok(true)
}
