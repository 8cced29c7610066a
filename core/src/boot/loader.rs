//! The bootloader's node: management channel, identity and updater; no engine, dialect or parameters.
//!
//! [`start`] decides at every reset what runs. If the bootloader stays, the platform drives a [`Loader`]
//! the way it drives a [`Node`](crate::node::Node): frames go to [`Loader::on_frame`], frames to send come
//! from [`Loader::poll_tx`]. What takes flash operations is done in [`Loader::work`], which the platform
//! calls after each frame: flash stops the processor for up to two seconds, and only the platform knows
//! what has to be fed before.

use core::borrow::BorrowMut;

use embedded_storage::nor_flash::NorFlash;

use super::image::{PAGE_SIZE, Page};
use super::slots::{Booted, Slots, Start, boot};
use super::status::Reason;
use super::trust::{KEY_LENGTH, SIGNED_KEY_LENGTH, Trust};
use super::updater::{TRANSFER_SIZE, Updater};
use crate::dialect::DialectKind;
use crate::engine::command::Neutral;
use crate::frame::Frame;
use crate::led::{self, IDENTIFY_TIME, Indication, Leds, Style};
use crate::management::vendor::{CommandCode, Descriptor};
use crate::management::wire::{FirmwareVersions, ImageType};
use crate::management::{
    Answer, Decoded, ENUMERATION_ATTEMPTS, Identity, Management, Request, SessionIds,
};
use crate::node::{Attempts, Counters, Handover, Tag, Transmission, TxOutcome};
use crate::params::journal::{Change, Journal, Key, VALUE_CAPACITY};
use crate::params::table::ParameterId;
use crate::time::Instant;

/// The memory that the bootloader works on, each part a flash region of its own. The bootloader's own
/// region is not among them: no command can reach it.
#[derive(Debug)]
pub struct Memory<'a, A, F, J> {
    /// Application and fallback.
    pub slots: &'a mut Slots<A, F>,
    /// The settings journal.
    pub journal: &'a mut Journal,
    /// Its region.
    pub settings: &'a mut J,
}

impl<A: NorFlash, F: NorFlash, J: NorFlash> Memory<'_, A, F, J> {
    fn save(&mut self, key: Key, value: &[u8]) -> CommandCode {
        let change = Change {
            key,
            value: Some(value),
        };
        match self.journal.save(self.settings, &change, true) {
            Ok(_) => CommandCode::NoError,
            Err(_) => CommandCode::FlashWriteFailed,
        }
    }

    /// See [`Journal::read`].
    fn read(&mut self, key: Key, value: &mut [u8]) -> Option<usize> {
        self.journal.read(self.settings, key, value)
    }

    fn number(&mut self, identity: &Identity) -> u8 {
        let mut number = [0];
        match (self.read(Key::NUMBER, &mut number), number) {
            (Some(1), [number]) => identity.number(number),
            _ => 0,
        }
    }

    /// The stored dialect, or the default.
    fn dialect(&mut self) -> DialectKind {
        let mut code = [0];
        self.read(Key::Parameter(ParameterId::Dialect.code()), &mut code);
        let [code] = code;
        DialectKind::from_code(code.into()).unwrap_or(DialectKind::Dmc60c)
    }

    fn rollback(&mut self) -> u32 {
        let mut counter = [0; 4];
        match self.read(Key::ROLLBACK, &mut counter) {
            Some(4) => u32::from_le_bytes(counter),
            _ => 0,
        }
    }

    fn key(&mut self) -> Option<[u8; KEY_LENGTH]> {
        let mut key = [0; KEY_LENGTH];
        if self.read(Key::SIGNING_KEY, &mut key)? < KEY_LENGTH {
            // A key of another length can sign nothing, and that is what it shall do.
            key = [0; KEY_LENGTH];
        }
        Some(key)
    }
}

/// Decides what runs, see [`boot`], and keeps the anti-rollback counter of a confirmed image.
pub fn start<A: NorFlash, F: NorFlash, J: NorFlash>(
    memory: &mut Memory<'_, A, F, J>,
    start: &Start,
) -> Booted {
    let booted = boot(memory.slots, start);
    if let (Ok(header), true) = (booted.start, booted.confirmed) {
        let rollback = header.identity.rollback;
        if rollback > memory.rollback() {
            // If that fails, the next boot tries again.
            let _ = memory.save(Key::ROLLBACK, &rollback.to_le_bytes());
        }
    }
    booted
}

/// What a bootloader is made from.
#[derive(Clone, Copy, Debug)]
pub struct LoaderConfig {
    /// Product that images have to be for.
    pub product_id: u32,
    /// Hardware that images have to be for.
    pub hardware: u32,
    /// Bootloader version (`fwverBoot`).
    pub bootloader_version: u16,
    /// Differs from board to board.
    pub seed: u32,
    /// Left by the image before, if it restarted on purpose.
    pub handover: Option<Handover>,
    /// Why the bootloader stays.
    pub reason: Reason,
}

/// What a transfer of data is for.
#[derive(Clone, Copy, Debug)]
enum Purpose {
    Page(u8),
    Key(usize),
}

/// The bootloader on the bus.
#[derive(Clone, Debug)]
pub struct Loader<P = Page> {
    bootloader_version: u16,
    reason: Reason,
    management: Management<1>,
    updater: Updater<P>,
    trust: Trust,
    number: u8,
    style: Style,
    purpose: Purpose,
    /// Asked for by the last frame, and done with the memory.
    work: Option<Request>,
    reset: Option<Handover>,
    identify_since: Option<Instant>,
    sessions: SessionIds,
    counters: Counters,
}

impl Loader {
    /// A bootloader that stays.
    #[must_use]
    pub fn new<A: NorFlash, F: NorFlash, J: NorFlash>(
        config: &LoaderConfig,
        memory: &mut Memory<'_, A, F, J>,
    ) -> Self {
        let mut loader = Self::blank(config, memory.dialect(), [0; PAGE_SIZE]);
        loader.recall(memory, config.handover);
        loader
    }
}

impl<P: BorrowMut<Page>> Loader<P> {
    /// A bootloader that stays, with a page buffer of its owner's, for as long as `run` runs. It is made where it
    /// remains: it takes half a kilobyte, and a value that is given back would take that twice.
    pub fn run<A: NorFlash, F: NorFlash, J: NorFlash, R>(
        config: &LoaderConfig,
        memory: &mut Memory<'_, A, F, J>,
        page: P,
        run: impl FnOnce(&mut Self, &mut Memory<'_, A, F, J>) -> R,
    ) -> R {
        let mut loader = Self::blank(config, memory.dialect(), page);
        loader.recall(memory, config.handover);
        run(&mut loader, memory)
    }

    /// A loader that has not read yet what is stored.
    fn blank(config: &LoaderConfig, dialect: DialectKind, page: P) -> Self {
        Self {
            bootloader_version: config.bootloader_version,
            reason: config.reason,
            management: Management::new(ImageType::Bootloader, dialect.identity()),
            updater: Updater::new(page),
            trust: Trust::new(config.product_id, config.hardware),
            number: 0,
            style: dialect.led_style(),
            purpose: Purpose::Page(0),
            work: None,
            reset: None,
            identify_since: None,
            sessions: SessionIds::new(config.seed),
            counters: Counters::default(),
        }
    }

    /// Reads what is stored.
    #[inline(never)]
    fn recall<A: NorFlash, F: NorFlash, J: NorFlash>(
        &mut self,
        memory: &mut Memory<'_, A, F, J>,
        handover: Option<Handover>,
    ) {
        self.updater.look(memory.slots);
        self.trust.rollback = memory.rollback();
        self.trust.key = memory.key();
        self.number = memory.number(self.management.identity());
        if let Some(handover) = handover {
            self.management.start(handover.session);
            // A reset that ends in the bootloader because there is no application is not answered.
            if handover.stay_in_bootloader {
                self.management.finish(CommandCode::InBootloader);
            }
        }
    }

    /// Every frame that the controller receives, whomever it is for.
    #[inline(never)]
    pub fn on_frame(&mut self, now: Instant, frame: &Frame) {
        self.counters.received = self.counters.received.wrapping_add(1);
        if self.management.session().is_none() {
            let session = self.sessions.draw(now);
            self.management.start(session);
        }
        match self.management.decode(self.number, frame) {
            Decoded::NotMine => self.counters.ignored = self.counters.ignored.wrapping_add(1),
            Decoded::Done => {}
            Decoded::Request(request) => self.execute(now, request),
            Decoded::Bad(bad) => self.counters.count_bad(bad),
        }
    }

    fn execute(&mut self, now: Instant, request: Request) {
        match request {
            Request::Enumerate => self.management.enumerate(now, self.number),
            Request::Identify => {
                self.identify_since = Some(now);
                self.management.finish(CommandCode::NoError);
            }
            Request::GetVersions => {
                let versions = self.versions();
                self.management.send_versions(versions);
            }
            Request::SoftReset => {
                let stay_in_bootloader = false;
                self.reset = self.management.session().map(|session| Handover {
                    session,
                    stay_in_bootloader,
                });
            }
            Request::WritePage { image, page } => match Updater::expect(image, page) {
                Ok(page) => self.expect(Purpose::Page(page), TRANSFER_SIZE),
                Err(code) => self.management.finish(code),
            },
            Request::InstallKey(length) => self.expect_key(usize::from(length)),
            Request::Data(chunk) => {
                self.updater.take(chunk.offset, chunk.frame.data());
                if chunk.is_last {
                    self.work = Some(request);
                }
            }
            // Neither answered by a bootloader nor decoded by its management channel.
            Request::Parameter(_) | Request::EnterBootloader => {}
            // The bootloader knows no parameters, and there are no pins to test.
            Request::FactoryReset { .. } | Request::PinTest(_) => {
                self.management.finish(CommandCode::NotSupported);
            }
            _ => self.work = Some(request),
        }
    }

    fn expect(&mut self, purpose: Purpose, length: usize) {
        self.purpose = purpose;
        self.management.expect_data(length);
    }

    fn expect_key(&mut self, length: usize) {
        match length {
            _ if !cfg!(feature = "signed") => self.management.finish(CommandCode::NotSupported),
            KEY_LENGTH | SIGNED_KEY_LENGTH => self.expect(Purpose::Key(length), length),
            _ => self.management.finish(CommandCode::BadParameter),
        }
    }

    /// True if [`Loader::work`] has something to do.
    #[must_use]
    pub const fn has_work(&self) -> bool {
        self.work.is_some()
    }

    /// True if the loader does anything with this frame beside seeing that there is a bus: what a hardware
    /// filter has to let through.
    #[must_use]
    pub fn accepts(&self, frame: &Frame) -> bool {
        self.management.accepts(self.number, frame)
    }

    /// Does what the last frame has asked for; true if it was anything. May take as long as the flash needs
    /// to erase the largest unit.
    #[inline(never)]
    pub fn work<A: NorFlash, F: NorFlash, J: NorFlash>(
        &mut self,
        memory: &mut Memory<'_, A, F, J>,
    ) -> bool {
        let Some(request) = self.work.take() else {
            return false;
        };
        let code = match request {
            Request::Data(_) => match self.purpose {
                Purpose::Page(page) => self.updater.write(memory.slots, &self.trust, page),
                Purpose::Key(length) => self.install_key(memory, length),
            },
            Request::SetNumber(number) => {
                let code = memory.save(Key::NUMBER, &[number]);
                if code == CommandCode::NoError {
                    self.number = number;
                }
                code
            }
            Request::SetDescriptor(which) => {
                let text = self.management.text();
                memory.save(Key::text(which), clipped(which, text))
            }
            Request::RestoreFallback => self.updater.restore(memory.slots),
            _ => {
                self.tell(memory, request);
                return true;
            }
        };
        self.management.finish(code);
        true
    }

    /// Answers a question.
    #[inline(never)]
    fn tell<A: NorFlash, F: NorFlash, J: NorFlash>(
        &mut self,
        memory: &mut Memory<'_, A, F, J>,
        request: Request,
    ) {
        let answer = self.management.clear();
        match request {
            Request::GetDescriptors => {
                for which in Descriptor::ALL {
                    describe(answer, memory, which);
                }
            }
            Request::GetSequence => {
                answer.put(&memory.journal.sequence().to_le_bytes());
            }
            Request::GetPageCrcs => put_crcs(answer, memory.slots),
            Request::GetBootStatus => {
                let reason = self.reason;
                let status = self.updater.status(memory.slots, &self.trust, reason);
                answer.put(&status);
            }
            _ => return,
        }
        answer.send();
    }

    fn install_key<A: NorFlash, F: NorFlash, J: NorFlash>(
        &mut self,
        memory: &mut Memory<'_, A, F, J>,
        length: usize,
    ) -> CommandCode {
        let order = self.updater.data().get(..length).unwrap_or(&[]);
        let Some(key) = self.trust.admits_key(order) else {
            return CommandCode::KeyRefused;
        };
        let code = memory.save(Key::SIGNING_KEY, &key);
        if code == CommandCode::NoError {
            self.trust.key = Some(key);
        }
        code
    }

    /// The controller has become error passive or bus-off and has flushed its transmit queue.
    pub fn on_bus_lost(&mut self) {
        if self.management.session().is_some() {
            self.management.stop();
            self.counters.bus_losses = self.counters.bus_losses.wrapping_add(1);
        }
    }

    /// The next frame to send; see [`Node::poll_tx`](crate::node::Node::poll_tx).
    #[inline(never)]
    pub fn poll_tx(&mut self, now: Instant) -> Option<Transmission> {
        let versions = self.versions();
        let (frame, answer) = self.management.encode(now, self.number, versions)?;
        let attempts = match answer {
            Answer::Enumerate0 => Attempts::AtMost(ENUMERATION_ATTEMPTS),
            Answer::Other | Answer::Dialect => Attempts::UntilSent,
        };
        Some(Transmission {
            frame,
            tag: Tag(answer),
            attempts,
        })
    }

    /// A transmission has ended.
    pub fn on_transmitted(&mut self, now: Instant, tag: Tag, outcome: TxOutcome) {
        match (tag.0, outcome) {
            (Answer::Enumerate0, TxOutcome::Sent) => self.management.enumerate_0_sent(),
            (Answer::Enumerate0, TxOutcome::Failed) => {
                let session = self.sessions.draw(now);
                self.management.enumerate_0_destroyed(now, session);
            }
            (Answer::Other | Answer::Dialect, _) => {}
        }
    }

    /// When [`Loader::poll_tx`] has something to send next, apart from new frames.
    #[must_use]
    pub fn next_deadline(&self) -> Option<Instant> {
        self.management.next_deadline()
    }

    /// The restart that was asked for, to be carried out with this handover.
    pub fn take_reset(&mut self) -> Option<Handover> {
        self.reset.take()
    }

    fn versions(&self) -> FirmwareVersions {
        FirmwareVersions {
            image: ImageType::Bootloader,
            application: self.updater.version(),
            bootloader: self.bootloader_version,
        }
    }

    /// What the LEDs show. The bridge floats while the bootloader runs.
    #[must_use]
    pub fn leds(&self, now: Instant) -> Leds {
        let indication = match self.identify_since {
            Some(since) if now.since(since) < IDENTIFY_TIME => {
                Indication::IdentifyInBootloader(now.since(since))
            }
            _ => Indication::Bootloader,
        };
        led::leds(now, self.style, indication, Neutral::Coast)
    }

    /// Frames by what became of them.
    #[must_use]
    pub const fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Device number, 0 = none assigned.
    #[must_use]
    pub const fn number(&self) -> u8 {
        self.number
    }

    /// Session id; none while no bus is seen.
    #[must_use]
    pub const fn session(&self) -> Option<u16> {
        self.management.session()
    }
}

/// Adds a descriptor to an answer. Not inlined, like the next one: what is read is on the stack only meanwhile.
#[inline(never)]
fn describe<A: NorFlash, F: NorFlash, J: NorFlash>(
    answer: &mut Management<1>,
    memory: &mut Memory<'_, A, F, J>,
    which: Descriptor,
) {
    let mut text = [0; VALUE_CAPACITY];
    let length = memory.read(Key::text(which), &mut text);
    let stored = length.and_then(|length| text.get(..length));
    answer.put_descriptor(which, stored.map(|text| clipped(which, text)));
}

/// Adds the CRCs of the stored pages to an answer.
#[inline(never)]
fn put_crcs<A: NorFlash, F: NorFlash>(answer: &mut Management<1>, slots: &mut Slots<A, F>) {
    for crc in slots.application.stored_crcs() {
        answer.put(&crc.to_le_bytes());
    }
}

/// A descriptor as far as it counts.
fn clipped(which: Descriptor, text: &[u8]) -> &[u8] {
    text.get(..which.capacity()).unwrap_or(text)
}
