//! CAN1 (bxCAN, 32) as the node's bus. Its interrupts move frames and repeat what was destroyed; nothing
//! is parsed in them.

use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use embedded_can::{ExtendedId, Id, StandardId};
use heapless::Deque;
use stm32_metapac::can::vals::{Ide, Lec, Rtr};
use stm32_metapac::{CAN1, GPIOB, Interrupt, interrupt};
use windlass_core::frame::Frame;
use windlass_core::node::{Attempts, Transmission, TxOutcome};
use windlass_core::time::Instant;

use super::{PRIORITY_CAN, alternate, enable, pulled_up};
use crate::latest::Latest;
use crate::port::{Bus, BusEvent};

/// Frames that thread mode has not taken yet.
static RECEIVED: Mutex<RefCell<Deque<Frame, 32>>> = Mutex::new(RefCell::new(Deque::new()));
/// Frames that found no place, there or in the controller.
static DROPPED: AtomicU32 = AtomicU32::new(0);
/// The transmission on its way: how often it may still be destroyed.
static ON_THE_WAY: Latest<Option<Attempts>> = Latest::new(None);
/// How the latest transmission ended.
static ENDED: Latest<Option<TxOutcome>> = Latest::new(None);

/// The bus; there is one.
#[derive(Debug, Default)]
pub struct Can {
    lost: bool,
}

impl Can {
    /// Starts the controller on PB8 and PB9 with 1 Mbit/s.
    pub fn start(nvic: &mut NVIC) -> Self {
        pulled_up(GPIOB, 8);
        alternate(GPIOB, 8, 9);
        alternate(GPIOB, 9, 9);
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
        CAN1.ier().write(|enable| {
            enable.set_fmpie(0, true);
            enable.set_tmeie(true);
        });
        enable(nvic, Interrupt::CAN1_RX0, PRIORITY_CAN);
        enable(nvic, Interrupt::CAN1_TX, PRIORITY_CAN);
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
            ON_THE_WAY.put(None);
            CAN1.tsr().write(|status| status.set_abrq(0, true));
            ENDED.put(None);
            return Some(BusEvent::Lost);
        }
        if let Some(outcome) = ENDED.take() {
            return Some(BusEvent::Ended(outcome));
        }
        critical_section::with(|token| RECEIVED.borrow_ref_mut(token).pop_front())
            .map(BusEvent::Received)
    }

    fn transmit(&mut self, _: Instant, transmission: &Transmission) {
        let frame = &transmission.frame;
        ON_THE_WAY.put(Some(transmission.attempts));
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
        DROPPED.load(Ordering::Relaxed)
    }
}

#[interrupt]
fn CAN1_RX0() {
    while CAN1.rfr(0).read().fmp() > 0 {
        if let Some(frame) = read_mailbox() {
            let kept =
                critical_section::with(|token| RECEIVED.borrow_ref_mut(token).push_back(frame));
            if kept.is_err() {
                count_drop();
            }
        }
        if CAN1.rfr(0).read().fovr() {
            count_drop();
        }
        CAN1.rfr(0).write(|fifo| {
            fifo.set_rfom(true);
            fifo.set_fovr(true);
        });
        // The FIFO shows its next frame when the release is done (32.9.2, RFOM).
        while CAN1.rfr(0).read().rfom() {}
    }
}

fn count_drop() {
    let dropped = DROPPED.load(Ordering::Relaxed);
    DROPPED.store(dropped.wrapping_add(1), Ordering::Relaxed);
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

#[interrupt]
fn CAN1_TX() {
    let status = CAN1.tsr().read();
    if !status.rqcp(0) {
        return;
    }
    // Writing a one clears the request's flags.
    CAN1.tsr().write(|clear| clear.set_rqcp(0, true));
    let Some(attempts) = ON_THE_WAY.get() else {
        return;
    };
    if status.txok(0) {
        end(TxOutcome::Sent);
        return;
    }
    // Lost arbitration and a missing acknowledge are no attempts: the one is only waiting, the other
    // ends with the loss of the bus.
    let destroyed = !status.alst(0) && CAN1.esr().read().lec() != Lec::ACK;
    let left = match attempts {
        Attempts::AtMost(left) if destroyed => Attempts::AtMost(left.saturating_sub(1)),
        other => other,
    };
    if left == Attempts::AtMost(0) {
        end(TxOutcome::Failed);
    } else {
        ON_THE_WAY.put(Some(left));
        CAN1.tx(0)
            .tir()
            .modify(|identifier| identifier.set_txrq(true));
    }
}

fn end(outcome: TxOutcome) {
    ON_THE_WAY.put(None);
    ENDED.put(Some(outcome));
}
