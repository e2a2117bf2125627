//! Names of exceptions for the Cortex-M7: those of the architecture, and the interrupts of RM0399's vector table (NVIC
//! chapter) that the models can raise.

use r4_mcu::cpu::number::IRQ0;

/// Position in the vector table, counted from the first interrupt after the system exceptions, and name.
const INTERRUPTS: [(u16, &str); 95] = [
    (4, "FLASH"),
    (5, "RCC"),
    (6, "EXTI0"),
    (7, "EXTI1"),
    (8, "EXTI2"),
    (9, "EXTI3"),
    (10, "EXTI4"),
    (11, "DMA1_STR0"),
    (12, "DMA1_STR1"),
    (13, "DMA1_STR2"),
    (14, "DMA1_STR3"),
    (15, "DMA1_STR4"),
    (16, "DMA1_STR5"),
    (17, "DMA1_STR6"),
    (18, "ADC1_2"),
    (19, "FDCAN1_IT0"),
    (20, "FDCAN2_IT0"),
    (21, "FDCAN1_IT1"),
    (22, "FDCAN2_IT1"),
    (23, "EXTI9_5"),
    (24, "TIM1_BRK"),
    (25, "TIM1_UP"),
    (26, "TIM1_TRG_COM"),
    (27, "TIM1_CC"),
    (28, "TIM2"),
    (29, "TIM3"),
    (30, "TIM4"),
    (31, "I2C1_EV"),
    (32, "I2C1_ER"),
    (33, "I2C2_EV"),
    (34, "I2C2_ER"),
    (35, "SPI1"),
    (36, "SPI2"),
    (37, "USART1"),
    (38, "USART2"),
    (39, "USART3"),
    (40, "EXTI15_10"),
    (43, "TIM8_BRK_TIM12"),
    (44, "TIM8_UP_TIM13"),
    (45, "TIM8_TRG_COM_TIM14"),
    (46, "TIM8_CC"),
    (47, "DMA1_STR7"),
    (48, "FMC"),
    (50, "TIM5"),
    (51, "SPI3"),
    (52, "UART4"),
    (53, "UART5"),
    (54, "TIM6_DAC"),
    (55, "TIM7"),
    (56, "DMA2_STR0"),
    (57, "DMA2_STR1"),
    (58, "DMA2_STR2"),
    (59, "DMA2_STR3"),
    (60, "DMA2_STR4"),
    (63, "FDCAN_CAL"),
    (64, "CM7_SEV"),
    (65, "CM4_SEV"),
    (68, "DMA2_STR5"),
    (69, "DMA2_STR6"),
    (70, "DMA2_STR7"),
    (71, "USART6"),
    (72, "I2C3_EV"),
    (73, "I2C3_ER"),
    (76, "OTG_HS_WKUP"),
    (77, "OTG_HS"),
    (80, "RNG"),
    (81, "FPU"),
    (82, "UART7"),
    (83, "UART8"),
    (84, "SPI4"),
    (85, "SPI5"),
    (86, "SPI6"),
    (87, "SAI1"),
    (91, "SAI2"),
    (95, "I2C4_EV"),
    (96, "I2C4_ER"),
    (100, "OTG_FS_WKUP"),
    (101, "OTG_FS"),
    (102, "DMAMUX1_OV"),
    (116, "TIM15"),
    (117, "TIM16"),
    (118, "TIM17"),
    (122, "MDMA"),
    (125, "HSEM0"),
    (127, "ADC3"),
    (128, "DMAMUX2_OVR"),
    (129, "BDMA_CH0"),
    (130, "BDMA_CH1"),
    (131, "BDMA_CH2"),
    (132, "BDMA_CH3"),
    (133, "BDMA_CH4"),
    (134, "BDMA_CH5"),
    (135, "BDMA_CH6"),
    (136, "BDMA_CH7"),
    (144, "CRS"),
];

/// Formats number and name of an exception, as in `66 TIM5`.
pub(crate) fn name(exception: u16) -> String {
    let name = match exception {
        0 => "thread",
        1 => "Reset",
        2 => "NMI",
        3 => "HardFault",
        4 => "MemManage",
        5 => "BusFault",
        6 => "UsageFault",
        11 => "SVCall",
        12 => "DebugMonitor",
        14 => "PendSV",
        15 => "SysTick",
        _ => {
            let known = INTERRUPTS.iter().find(|(position, _)| position + IRQ0 == exception);
            let Some((_, name)) = known else { return format!("{exception} IRQ{}", exception.saturating_sub(IRQ0)) };
            name
        }
    };
    format!("{exception} {name}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exceptions_have_number_and_name() {
        assert_eq!(name(15), "15 SysTick");
        assert_eq!(name(16 + 50), "66 TIM5");
        assert_eq!(name(16 + 149), "165 IRQ149");
    }

    #[test]
    fn positions_are_in_order_and_occur_once() {
        assert!(INTERRUPTS.windows(2).all(|pair| pair[0].0 < pair[1].0));
    }
}
