//! `r4 i2c`, `r4 uart`: raw bytes over the external connectors.

use anyhow::ensure;
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::{Args, I2c, Uart},
    output, session,
};

/// Number of connectors of each kind.
const CONNECTORS: u8 = 2;
/// Default receive time of a UART, s.
const RECEIVE_S: f64 = 0.5;
/// Period of the requests for received bytes, s: the board buffers 22 ms of them at 115200 baud.
const FETCH_EVERY_S: f64 = 0.005;

#[derive(Serialize)]
struct Transfer {
    board: String,
    bus: u8,
    address: u8,
    /// Bytes written, in hex.
    written: String,
    /// Bytes read, in hex.
    read: String,
}

#[derive(Serialize)]
struct Exchange {
    board: String,
    port: u8,
    /// Bytes sent, in hex.
    written: String,
    /// Bytes received, in hex; null without `--read`.
    read: Option<String>,
}

pub(crate) fn i2c(args: &Args, i2c: &I2c) -> anyhow::Result<bool> {
    check_connector("I2C", i2c.bus)?;
    let write = i2c.write.as_ref().map_or(&[][..], |bytes| &bytes.0);
    let (read, _) = session::run(args, Pace::Free, async |session| {
        Ok(session.board.i2c_transfer(i2c.bus, i2c.address, write, i2c.read.unwrap_or(0)).await?)
    })?;
    if args.json {
        output::json(&Transfer {
            board: args.board.to_string(),
            bus: i2c.bus,
            address: i2c.address,
            written: hex(write, ""),
            read: hex(&read, ""),
        })?;
    } else if i2c.read.is_some() {
        output::line(hex(&read, " "))?;
    } else {
        output::line(format_args!("wrote {} to {:#04x} on I2C connector {}", bytes(write), i2c.address, i2c.bus))?;
    }
    Ok(true)
}

pub(crate) fn uart(args: &Args, uart: &Uart) -> anyhow::Result<bool> {
    check_connector("UART", uart.port)?;
    let write = uart.write.as_ref().map_or(&[][..], |bytes| &bytes.0);
    let (read, _) = session::run(args, Pace::Free, async |session| {
        let board = session.board;
        board.uart_write(uart.port, write).await?;
        if !uart.read {
            return Ok(None);
        }
        let until_s = board.now_s() + uart.seconds.unwrap_or(RECEIVE_S);
        let mut all = Vec::new();
        loop {
            let received = board.uart_read(uart.port).await?;
            all.extend_from_slice(&received);
            if board.now_s() >= until_s {
                return Ok(Some(all));
            }
            // Fetch at once while bytes are waiting: the board drops what it cannot buffer.
            if received.is_empty() {
                board.sleep_s(FETCH_EVERY_S).await;
            }
        }
    })?;
    if args.json {
        output::json(&Exchange {
            board: args.board.to_string(),
            port: uart.port,
            written: hex(write, ""),
            read: read.as_ref().map(|read| hex(read, "")),
        })?;
    } else if let Some(read) = &read {
        output::line(read.escape_ascii())?;
    } else {
        output::line(format_args!("sent {} out of UART connector {}", bytes(write), uart.port))?;
    }
    Ok(true)
}

fn check_connector(kind: &str, number: u8) -> anyhow::Result<()> {
    ensure!(number < CONNECTORS, "there is no {kind} connector {number}: they are 0 and 1");
    Ok(())
}

fn hex(bytes: &[u8], between: &str) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(between)
}

fn bytes(bytes: &[u8]) -> String {
    if let [_] = bytes { "1 byte".to_owned() } else { format!("{} bytes", bytes.len()) }
}
