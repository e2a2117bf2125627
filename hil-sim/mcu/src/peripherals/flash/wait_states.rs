//! Wait states and programming delay required by the AXI clock (RM0399, 4.3.8, table of recommended values).

use crate::peripherals::pwr::VoltageScale;

/// Row of the table: highest frequency, Hz, with its LATENCY and WRHIGHFREQ.
type Row = (u64, u32, u32);

const HIGH: [Row; 6] = [
    (70_000_000, 0, 0),
    (140_000_000, 1, 1),
    (185_000_000, 2, 1),
    (210_000_000, 2, 2),
    (225_000_000, 3, 2),
    (240_000_000, 4, 2),
];
const VOS2: [Row; 4] = [(55_000_000, 0, 0), (110_000_000, 1, 1), (165_000_000, 2, 1), (225_000_000, 3, 2)];
const VOS3: [Row; 5] =
    [(45_000_000, 0, 0), (90_000_000, 1, 1), (135_000_000, 2, 1), (180_000_000, 3, 2), (225_000_000, 4, 2)];

/// Returns the least LATENCY and WRHIGHFREQ; `None` if no setting suffices.
pub(super) fn needed(axi_hz: u64, scale: VoltageScale) -> Option<(u32, u32)> {
    let table: &[Row] = match scale {
        VoltageScale::Vos0 => &HIGH,
        VoltageScale::Vos1 => &HIGH[..5],
        VoltageScale::Vos2 => &VOS2,
        VoltageScale::Vos3 => &VOS3,
    };
    table.iter().find(|(highest, ..)| axi_hz <= *highest).map(|(_, latency, delay)| (*latency, *delay))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_giga_s_clocks_need_what_the_manual_says() {
        assert_eq!(needed(240_000_000, VoltageScale::Vos0), Some((4, 2)));
        assert_eq!(needed(200_000_000, VoltageScale::Vos1), Some((2, 2)));
        assert_eq!(needed(64_000_000, VoltageScale::Vos3), Some((1, 1)), "after a reset");
        assert_eq!(needed(240_000_000, VoltageScale::Vos1), None);
    }
}
