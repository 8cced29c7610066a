//! The boards that firmware is built for.

use crate::error::Error;

/// The board that is built unless another one is asked for.
pub(crate) const DEFAULT: &str = "f405-devkit";

/// Memory map of the default board.
const DEFAULT_MAP: &str = "memory.x";

/// The board that runs in QEMU.
pub(crate) const EMULATED: &str = "qemu";

/// One board.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Board {
    /// Name on the command line; the feature of the firmware package is `board-` and this name.
    pub(crate) name: &'static str,
    /// What it is.
    pub(crate) about: &'static str,
    /// True if the budgets of real boards hold for its image: the emulated one carries a plant.
    pub(crate) budgeted: bool,
    /// Its memory map, from the workspace's root.
    pub(crate) map: &'static str,
    /// Its interrupt handlers by priority, lowest first: one handler of each priority can be active.
    pub(crate) handlers: &'static [&'static [&'static str]],
    /// The chip's name for probe-rs; none for an emulated board.
    pub(crate) probe_chip: Option<&'static str>,
    /// True if its bootloader is to check signatures.
    pub(crate) signed: bool,
}

impl Board {
    /// The board with a bootloader that checks signatures, or with one that does not.
    pub(crate) const fn with_signatures(self, signed: bool) -> Self {
        Self { signed, ..self }
    }
}

/// Every board.
pub(crate) const BOARDS: [Board; 4] = [
    Board {
        name: "f405-devkit",
        about: "STM32F405RG with CAN transceiver, H-bridge and encoder",
        budgeted: true,
        map: DEFAULT_MAP,
        handlers: &[&["CAN1_RX0", "CAN1_TX"], &["TIM2"], &["TIM7"], &["PVD"]],
        probe_chip: Some("STM32F405RGTx"),
        signed: false,
    },
    Board {
        name: "b-g431b-esc1",
        about: "ST's three-phase motor board with an STM32G431CB, two phases used as H-bridge",
        budgeted: true,
        map: "firmware/memory/stm32g431cb.x",
        handlers: &[
            &["FDCAN1_IT0"],
            &["TIM4"],
            &["TIM7"],
            &["PVD_PVM"],
            &["NonMaskableInt"],
        ],
        probe_chip: Some("STM32G431CBUx"),
        signed: false,
    },
    Board {
        name: "nucleo-g474re",
        about: "NUCLEO-G474RE with CAN transceiver, H-bridge and encoder",
        budgeted: true,
        map: "firmware/memory/stm32g474re.x",
        handlers: &[
            &["FDCAN1_IT0"],
            &["TIM2"],
            &["TIM7_DAC"],
            &["PVD_PVM"],
            &["NonMaskableInt"],
        ],
        probe_chip: Some("STM32G474RETx"),
        signed: false,
    },
    Board {
        name: "qemu",
        about: "STM32F405 in QEMU's netduinoplus2, with the plant in the image",
        budgeted: false,
        map: "firmware/memory/qemu.x",
        handlers: &[&["PendSV"], &["USART1", "USART2"], &["SysTick"]],
        probe_chip: None,
        signed: false,
    },
];

/// The board with this name.
pub(crate) fn find(name: &str) -> Result<Board, Error> {
    BOARDS
        .into_iter()
        .find(|board| board.name == name)
        .ok_or_else(|| Error::UnknownBoard(name.to_owned()))
}

/// All names, for messages.
pub(crate) fn names() -> String {
    BOARDS.map(|board| board.name).join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_board_exists_and_an_unknown_one_lists_all() {
        assert!(find(DEFAULT).is_ok());
        let message = find("uno").map(|board| board.name).unwrap_err().to_string();
        assert!(message.contains("`uno`"), "{message}");
        for board in BOARDS {
            assert!(message.contains(board.name), "{message}");
        }
    }
}
