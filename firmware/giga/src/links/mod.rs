//! Byte links to hosts, and the UART connectors.
//!
//! | number | link |
//! | --- | --- |
//! | 0 | USART1, the debug header: 1 Mbaud 8N1 |

pub(crate) mod uart;
