//! CAN1 (bxCAN, 32) as the node's bus. Its interrupts move frames and repeat what was destroyed; nothing
//! is parsed in them. The bootloader enables none and does the same in each pass.

#[cfg(not(feature = "bootloader"))]
use cortex_m::peripheral::NVIC;
use embedded_can::{ExtendedId, Id, StandardId};
use stm32_metapac::CAN1;
use stm32_metapac::can::vals::{Ide, Lec, Rtr};
#[cfg(not(feature = "bootloader"))]
use stm32_metapac::{Interrupt, interrupt};
use windlass_core::frame::Frame;
use windlass_core::node::Transmission;
use windlass_core::time::Instant;

use crate::chip::stm32::Pin;
#[cfg(not(feature = "bootloader"))]
use crate::chip::stm32::can::MAILBOX;
use crate::chip::stm32::can::{Controller, Transfers};
#[cfg(not(feature = "bootloader"))]
use crate::chip::stm32::{PRIORITY_CAN, enable};
use crate::mailbox::Attempt;
use crate::port::{Bus, BusEvent};

/// Alternate function of every CAN1 pin (data sheet, table 9).
const FUNCTION: u8 = 9;

/// The bus; there is one.
#[derive(Debug, Default)]
pub struct Can {
    lost: bool,
    transfers: Transfers,
}

impl Can {
    /// Starts the controller and its interrupts.
    #[cfg(not(feature = "bootloader"))]
    pub fn start(nvic: &mut NVIC, receive: Pin, transmit: Pin) -> Self {
        let can = Self::join(receive, transmit);
        CAN1.ier().write(|enable| {
            enable.set_fmpie(0, true);
            enable.set_tmeie(true);
            enable.set_lecie(true);
            enable.set_errie(true);
        });
        enable(nvic, Interrupt::CAN1_RX0, PRIORITY_CAN);
        enable(nvic, Interrupt::CAN1_TX, PRIORITY_CAN);
        enable(nvic, Interrupt::CAN1_SCE, PRIORITY_CAN);
        can
    }

    /// Starts the controller with 1 Mbit/s and without interrupts.
    pub fn join(receive: Pin, transmit: Pin) -> Self {
        receive.pulled_up();
        receive.alternate(FUNCTION);
        transmit.alternate(FUNCTION);
        CAN1.mcr().write(|control| {
            control.set_inrq(true);
            // Re-join after bus-off, and leave repetition to the interrupt, which counts.
            control.set_abom(true);
            control.set_nart(true);
        });
        while !CAN1.msr().read().inak() {}
        // 42 MHz / 3 = 14 quanta a bit: 1 + 10 before the sample point at 79 %, 3 after it (32.7.7).
        CAN1.btr().write(|timing| {
            timing.set_brp(3 - 1);
            timing.set_ts(0, 10 - 1);
            timing.set_ts(1, 3 - 1);
            timing.set_sjw(1 - 1);
        });
        accept_everything();
        CAN1.mcr().modify(|control| control.set_inrq(false));
        Self::default()
    }
}

/// One filter bank that lets everything into FIFO 0: any frame shows the node that there is a bus.
fn accept_everything() {
    CAN1.fmr().modify(|filters| filters.set_finit(true));
    CAN1.fs1r().modify(|scale| scale.set_fsc(0, true));
    CAN1.fb(0).fr1().write(|identifier| identifier.0 = 0);
    CAN1.fb(0).fr2().write(|mask| mask.0 = 0);
    CAN1.fa1r().modify(|active| active.set_fact(0, true));
    CAN1.fmr().modify(|filters| filters.set_finit(false));
}

impl Bus for Can {
    fn poll(&mut self, _: Instant) -> Option<BusEvent> {
        let errors = CAN1.esr().read();
        let lost = errors.epvf() || errors.boff();
        let newly = lost && !self.lost;
        self.lost = lost;
        if newly {
            self.transfers.flush();
            CAN1.tsr().write(|status| status.set_abrq(0, true));
            return Some(BusEvent::Lost);
        }
        self.transfers.poll::<Self>()
    }

    fn transmit(&mut self, _: Instant, transmission: &Transmission) {
        let frame = &transmission.frame;
        self.transfers.begin(transmission.attempts);
        let mailbox = CAN1.tx(0);
        mailbox
            .tdtr()
            .write(|length| length.set_dlc(frame.dlc() as u8));
        let [a, b, c, d, e, f, g, h] = *frame.bytes();
        mailbox
            .tdlr()
            .write(|data| data.0 = u32::from_le_bytes([a, b, c, d]));
        mailbox
            .tdhr()
            .write(|data| data.0 = u32::from_le_bytes([e, f, g, h]));
        mailbox.tir().write(|identifier| {
            match frame.id() {
                Id::Standard(id) => identifier.set_stid(id.as_raw()),
                Id::Extended(id) => {
                    identifier.set_ide(Ide::EXTENDED);
                    identifier.set_stid((id.as_raw() >> 18) as u16);
                    identifier.set_exid(id.as_raw() & 0x3_FFFF);
                }
            }
            identifier.set_rtr(if frame.is_remote() {
                Rtr::REMOTE
            } else {
                Rtr::DATA
            });
            identifier.set_txrq(true);
        });
    }

    fn dropped(&self) -> u32 {
        self.transfers.dropped()
    }

    fn errors(&self) -> u32 {
        self.transfers.errors()
    }
}

impl Controller for Can {
    /// Starts the attempt to send what stands in the mailbox.
    fn request() {
        CAN1.tx(0)
            .tir()
            .modify(|identifier| identifier.set_txrq(true));
    }

    /// How the attempt has ended, if it has since this was asked last.
    fn attempt_ended() -> Option<Attempt> {
        let status = CAN1.tsr().read();
        if !status.rqcp(0) {
            return None;
        }
        // Writing a one clears the request's flags.
        CAN1.tsr().write(|clear| clear.set_rqcp(0, true));
        // Waiting for a busy bus shows as lost arbitration; a missing acknowledge ends with the loss of the bus.
        Some(if status.txok(0) {
            Attempt::Sent
        } else if status.alst(0) || CAN1.esr().read().lec() == Lec::ACK {
            Attempt::Waiting
        } else {
            Attempt::Destroyed
        })
    }

    /// The oldest frame in the FIFO; also none for one that cannot be.
    fn received() -> Option<Frame> {
        if CAN1.rfr(0).read().fmp() == 0 {
            return None;
        }
        let frame = read_mailbox();
        CAN1.rfr(0).write(|fifo| {
            fifo.set_rfom(true);
            fifo.set_fovr(true);
        });
        // The FIFO shows its next frame when the release is done (32.9.2, RFOM).
        while CAN1.rfr(0).read().rfom() {}
        frame
    }
}

#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn CAN1_RX0() {
    while CAN1.rfr(0).read().fmp() > 0 {
        if CAN1.rfr(0).read().fovr() {
            MAILBOX.count_drop();
        }
        if let Some(frame) = Can::received() {
            MAILBOX.receive(frame);
        }
    }
}

#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn CAN1_TX() {
    if let Some(attempt) = Can::attempt_ended()
        && MAILBOX.ended(attempt)
    {
        Can::request();
    }
}

/// An error was detected (32.8, CAN interrupts). Its code stays in ESR, where the other interrupt reads it.
#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn CAN1_SCE() {
    // Writing a one clears the flag; ones at the other flags would clear those.
    CAN1.msr().write(|clear| clear.set_erri(true));
    MAILBOX.count_error();
}

fn read_mailbox() -> Option<Frame> {
    let mailbox = CAN1.rx(0);
    let identifier = mailbox.rir().read();
    let length = usize::from(mailbox.rdtr().read().dlc()).min(8);
    let id = if identifier.ide() == Ide::EXTENDED {
        Id::Extended(ExtendedId::new(
            u32::from(identifier.stid()) << 18 | identifier.exid(),
        )?)
    } else {
        Id::Standard(StandardId::new(identifier.stid())?)
    };
    if identifier.rtr() == Rtr::REMOTE {
        return Frame::remote(id, length);
    }
    let mut data = [0; 8];
    let (low, high) = data.split_at_mut(4);
    low.copy_from_slice(&mailbox.rdlr().read().0.to_le_bytes());
    high.copy_from_slice(&mailbox.rdhr().read().0.to_le_bytes());
    Frame::new(id, data.get(..length)?)
}
