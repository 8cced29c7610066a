//! FDCAN1 (RM0440, 44) in classic mode as the node's bus. Its interrupt moves frames and repeats what was
//! destroyed; nothing is parsed in it. The bootloader enables none and does the same in each pass.

#[cfg(not(feature = "bootloader"))]
use cortex_m::peripheral::NVIC;
use embedded_can::{ExtendedId, Id, StandardId};
use stm32_metapac::can::vals::{Anfe, Anfs, Lec, Tfqm};
use stm32_metapac::{FDCAN1, FDCANRAM1};
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

/// Alternate function of every FDCAN1 pin (STM32G431 data sheet, table 13).
const FUNCTION: u8 = 9;
/// Words of an element of the message memory (44.3.4).
const ELEMENT: usize = 18;
/// Bits of an element's first word (44.3.8, 44.3.9).
const EXTENDED: u32 = 1 << 30;
const REMOTE: u32 = 1 << 29;
const EXTENDED_MASK: u32 = 0x1FFF_FFFF;
const STANDARD_SHIFT: u32 = 18;
/// Place of the data length code in the second word.
const LENGTH_SHIFT: u32 = 16;

/// The bus; there is one.
#[derive(Debug, Default)]
pub struct Can {
    lost: bool,
    transfers: Transfers,
}

impl Can {
    /// Starts the controller and its interrupt.
    #[cfg(not(feature = "bootloader"))]
    pub fn start(nvic: &mut NVIC, receive: Pin, transmit: Pin) -> Self {
        let can = Self::join(receive, transmit);
        FDCAN1.ie().write(|enable| {
            enable.set_rfne(0, true);
            enable.set_rfle(0, true);
            enable.set_tce(true);
            enable.set_tcfe(true);
            enable.set_peae(true);
        });
        FDCAN1.ile().write(|lines| lines.set_eint0(true));
        enable(nvic, Interrupt::FDCAN1_IT0, PRIORITY_CAN);
        can
    }

    /// Starts the controller with 1 Mbit/s and without interrupts.
    pub fn join(receive: Pin, transmit: Pin) -> Self {
        receive.pulled_up();
        receive.alternate(FUNCTION);
        transmit.alternate(FUNCTION);
        FDCAN1.cccr().modify(|control| control.set_init(true));
        while !FDCAN1.cccr().read().init() {}
        FDCAN1.cccr().modify(|control| control.set_cce(true));
        // Classic frames only, and repetition left to the interrupt, which counts (44.4.5).
        FDCAN1.cccr().modify(|control| {
            control.set_fdoe(false);
            control.set_brse(false);
            control.set_dar(true);
        });
        // 85 MHz / 5 = 17 quanta a bit: 1 + 13 before the sample point at 82 %, 3 after it (44.4.6).
        FDCAN1.nbtp().write(|timing| {
            timing.set_nbrp(5 - 1);
            timing.set_ntseg1(13 - 1);
            timing.set_ntseg2(3 - 1);
            timing.set_nsjw(3 - 1);
        });
        // A queue, whose buffers may be used in any order, so that every frame goes through buffer 0. After a reset it
        // is a FIFO, which takes them in turn: a second request for buffer 0 would wait for the two others (44.3.3).
        FDCAN1.txbc().write(|sending| sending.set_tfqm(Tfqm::QUEUE));
        // Everything into FIFO 0: any frame shows the node that there is a bus.
        FDCAN1.rxgfc().write(|filters| {
            filters.set_anfe(Anfe::ACCEPT_FIFO_0);
            filters.set_anfs(Anfs::ACCEPT_FIFO_0);
        });
        // The ends of a transmission are told in the interrupt register, whether they interrupt or not.
        FDCAN1.txbtie().write(|sent| sent.set_tie(0, true));
        FDCAN1.txbcie().write(|failed| failed.set_cfie(0, true));
        FDCAN1.cccr().modify(|control| control.set_init(false));
        Self::default()
    }
}

impl Bus for Can {
    fn poll(&mut self, _: Instant) -> Option<BusEvent> {
        // Not from PSR: reading it would take the latest error away from the interrupt (44.4.13, LEC).
        let errors = FDCAN1.ecr().read();
        let bus_off = FDCAN1.cccr().read().init();
        let lost = bus_off || errors.rp() || errors.tec() > 127;
        let newly = lost && !self.lost;
        self.lost = lost;
        if newly {
            self.transfers.flush();
            FDCAN1.txbcr().write(|cancel| cancel.set_cr(0, true));
            return Some(BusEvent::Lost);
        }
        if bus_off {
            // Rejoins after 129 times eleven recessive bits (44.3.2, bus-off).
            FDCAN1.cccr().modify(|control| control.set_init(false));
        }
        self.transfers.poll::<Self>()
    }

    fn transmit(&mut self, _: Instant, transmission: &Transmission) {
        let frame = &transmission.frame;
        let identifier = match frame.id() {
            Id::Standard(id) => u32::from(id.as_raw()) << STANDARD_SHIFT,
            Id::Extended(id) => EXTENDED | id.as_raw(),
        };
        let remote = if frame.is_remote() { REMOTE } else { 0 };
        let [a, b, c, d, e, f, g, h] = *frame.bytes();
        FDCANRAM1.txbuf(0).write_value(identifier | remote);
        FDCANRAM1
            .txbuf(1)
            .write_value((frame.dlc() as u32) << LENGTH_SHIFT);
        FDCANRAM1
            .txbuf(2)
            .write_value(u32::from_le_bytes([a, b, c, d]));
        FDCANRAM1
            .txbuf(3)
            .write_value(u32::from_le_bytes([e, f, g, h]));
        self.transfers.begin(transmission.attempts);
        Self::request();
    }

    fn dropped(&self) -> u32 {
        self.transfers.dropped()
    }

    fn errors(&self) -> u32 {
        self.transfers.errors()
    }
}

impl Controller for Can {
    /// Starts an attempt; errors from before do not count.
    fn request() {
        let _ = FDCAN1.psr().read();
        FDCAN1.txbar().write(|add| add.set_ar(0, true));
    }

    /// How the attempt has ended, if it has since this was asked last: without automatic repetition every one ends in one
    /// of two flags (44.3.3, table 408).
    fn attempt_ended() -> Option<Attempt> {
        let flags = FDCAN1.ir().read();
        if !flags.tc() && !flags.tcf() {
            return None;
        }
        FDCAN1.ir().write(|seen| {
            seen.set_tc(true);
            seen.set_tcf(true);
        });
        if FDCAN1.txbrp().read().trp(0) {
            return None;
        }
        Some(if FDCAN1.txbto().read().to(0) {
            Attempt::Sent
        } else {
            match FDCAN1.psr().read().lec() {
                Lec::STUFF | Lec::FORM | Lec::BIT_1 | Lec::BIT_0 | Lec::CRC => Attempt::Destroyed,
                // No error: arbitration was lost.
                _ => Attempt::Waiting,
            }
        })
    }

    /// The oldest frame in the FIFO; also none for one that cannot be.
    fn received() -> Option<Frame> {
        let state = FDCAN1.rxfs(0).read();
        if state.ffl() == 0 {
            return None;
        }
        let frame = read_element(usize::from(state.fgi()));
        FDCAN1.rxfa(0).write(|done| done.set_fai(state.fgi()));
        frame
    }
}

#[cfg(not(feature = "bootloader"))]
#[interrupt]
fn FDCAN1_IT0() {
    let flags = FDCAN1.ir().read();
    // Writing ones clears what has been seen, and nothing that came since.
    FDCAN1.ir().write(|seen| {
        seen.set_rfn(0, flags.rfn(0));
        seen.set_rfl(0, flags.rfl(0));
        seen.set_pea(flags.pea());
    });
    while FDCAN1.rxfs(0).read().ffl() > 0 {
        if let Some(frame) = Can::received() {
            MAILBOX.receive(frame);
        }
    }
    if flags.rfl(0) {
        MAILBOX.count_drop();
    }
    // An error of any kind: classic frames have no other phase than that of arbitration (FDCAN_IR, PEA).
    if flags.pea() {
        MAILBOX.count_error();
    }
    if let Some(attempt) = Can::attempt_ended()
        && MAILBOX.ended(attempt)
    {
        Can::request();
    }
}

fn read_element(place: usize) -> Option<Frame> {
    // Three elements; the controller gives no other place.
    let first = ELEMENT * place.min(2);
    // The bound is never reached; without it the register's own check would be a panic path.
    let word = |at: usize| FDCANRAM1.rxfifo0((first + at).min(3 * ELEMENT - 1)).read();
    let (head, control) = (word(0), word(1));
    let length = ((control >> LENGTH_SHIFT) & 0xF).min(8) as usize;
    let id = if head & EXTENDED != 0 {
        Id::Extended(ExtendedId::new(head & EXTENDED_MASK)?)
    } else {
        Id::Standard(StandardId::new(
            ((head & EXTENDED_MASK) >> STANDARD_SHIFT) as u16,
        )?)
    };
    if head & REMOTE != 0 {
        return Frame::remote(id, length);
    }
    let mut data = [0; 8];
    let (low, high) = data.split_at_mut(4);
    low.copy_from_slice(&word(2).to_le_bytes());
    high.copy_from_slice(&word(3).to_le_bytes());
    Frame::new(id, data.get(..length)?)
}
