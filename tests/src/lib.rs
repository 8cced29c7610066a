//! A bench for whole-system tests: controllers on a virtual bus and one CAN tool that talks to them, frame by
//! frame, in virtual time.

pub mod boot_bench;
pub mod boot_cuts;
pub mod guide_scheme;
pub mod journal_cuts;
pub mod lossy_updates;
pub mod parallel;
pub mod talon;

use windlass_core::dialect::dmc60c::wire::{
    Control0, ModeSelect, StatusAnalog, StatusEncoder, StatusGeneral, id as status_id,
};
use windlass_core::frame::Frame;
use windlass_core::frc_id::{base, number};
use windlass_core::management::wire::{
    EnumerateResponse0, ParameterResponse, ParameterSet, VendorCommand, VendorStatus, id,
};
use windlass_core::time::{Duration, Instant};
use windlass_sim::{NodeSpec, ParticipantId, Poke, Received, Truth, World, WorldConfig};

/// A virtual bus with a CAN tool.
pub struct Bench {
    /// The world.
    pub world: World,
    /// The tool.
    pub tool: ParticipantId,
    /// Everything the tool has received, oldest first.
    pub log: Vec<Received>,
}

/// A span of milliseconds.
#[must_use]
pub const fn ms(millis: u32) -> Duration {
    Duration::from_millis(millis)
}

/// A 16.16 value as it stands in a parameter.
#[must_use]
pub fn fixed(value: f64) -> u32 {
    (value * 65536.0).round() as i32 as u32
}

/// A control frame.
#[must_use]
pub fn control(mode: ModeSelect, target: i32) -> Control0 {
    Control0 {
        mode,
        target,
        ..Control0::default()
    }
}

impl Bench {
    /// Controllers `dmc60c:NUMBER`, past their self-check.
    #[must_use]
    pub fn new(numbers: &[u8]) -> Self {
        Self::with(WorldConfig::default(), numbers)
    }

    /// The same in a world of one's own.
    #[must_use]
    pub fn with(config: WorldConfig, numbers: &[u8]) -> Self {
        let mut world = World::new(config);
        for number in numbers {
            let spec: NodeSpec = format!("dmc60c:{number}").parse().expect("a good number");
            world.add_node(spec);
        }
        Self::around(world)
    }

    /// A tool in a world, whose controllers get the time for their self-check.
    #[must_use]
    pub fn around(mut world: World) -> Self {
        let tool = world.join("test");
        world.advance(ms(50));
        Self {
            world,
            tool,
            log: Vec::new(),
        }
    }

    /// Lets time pass and collects what the tool receives.
    pub fn run(&mut self, span: Duration) {
        self.world.advance(span);
        while let Some(received) = self.world.receive(self.tool) {
            self.log.push(received);
        }
    }

    /// Sends a frame and lets 1 ms pass.
    pub fn send(&mut self, frame: Frame) {
        self.world.send(self.tool, frame);
        self.run(ms(1));
    }

    /// Sends a control frame every 10 ms for `millis`.
    pub fn drive(&mut self, number: u8, control: &Control0, millis: u32) {
        for _ in 0..millis / 10 {
            self.world.send(self.tool, control.emit(number));
            self.run(ms(10));
        }
    }

    /// Truth of node `index`.
    #[must_use]
    pub fn truth(&self, index: usize) -> Truth {
        self.world.node(index).expect("the node").truth()
    }

    /// Interferes with node `index`.
    pub fn poke(&mut self, index: usize, poke: Poke) {
        self.world.node_mut(index).expect("the node").poke(poke);
    }

    /// Session ids of all answers to one enumeration request, by device number.
    pub fn enumerate(&mut self) -> Vec<(u8, u16)> {
        let from = self.log.len();
        self.world
            .send(self.tool, Frame::extended(id::ENUMERATE, []));
        self.run(ms(100));
        self.log[from..]
            .iter()
            .filter(|received| base(received.frame.raw_id()) == id::ENUMERATE_RESPONSE)
            .filter_map(|received| {
                let response = EnumerateResponse0::parse(&received.frame)?;
                Some((number(received.frame.raw_id()), response.session))
            })
            .collect()
    }

    /// Session id of the one device with this number.
    pub fn session(&mut self, wanted: u8) -> u16 {
        let found: Vec<_> = self
            .enumerate()
            .into_iter()
            .filter(|(n, _)| *n == wanted)
            .collect();
        match found[..] {
            [(_, session)] => session,
            _ => panic!("device {wanted}: {found:?}"),
        }
    }

    /// Sets parameters by number, each acknowledged.
    pub fn set(&mut self, device: u8, values: &[(u8, u32)]) {
        let session = self.session(device);
        for (parameter, value) in values {
            let set = ParameterSet {
                session,
                parameter: *parameter,
                value: *value,
            };
            self.log.clear();
            self.send(set.emit(device));
            let answer = self.log.iter().find_map(|received| {
                let mine = base(received.frame.raw_id()) == id::PARAMETER_RESPONSE;
                mine.then(|| ParameterResponse::parse(&received.frame))?
            });
            let answer = answer.unwrap_or_else(|| panic!("no answer to parameter {parameter}"));
            assert_eq!(
                (answer.parameter, answer.value, answer.code),
                (*parameter, *value, 0)
            );
        }
    }

    /// A vendor command without data and its status.
    pub fn vendor(
        &mut self,
        device: u8,
        session: u16,
        command: u16,
        param1: u16,
    ) -> Option<VendorStatus> {
        self.log.clear();
        self.send(
            VendorCommand {
                session,
                command,
                param1,
                param2: 0,
            }
            .emit(device),
        );
        self.log.iter().find_map(|received| {
            (base(received.frame.raw_id()) == id::VENDOR_STATUS)
                .then(|| VendorStatus::parse(&received.frame))?
        })
    }

    /// Frames with this base identifier from this device, with the times of their ends.
    #[must_use]
    pub fn received(&self, base_id: u32, device: u8) -> Vec<(Instant, Frame)> {
        let mine = |received: &&Received| {
            base(received.frame.raw_id()) == base_id && number(received.frame.raw_id()) == device
        };
        self.log
            .iter()
            .filter(mine)
            .map(|received| (received.at, received.frame))
            .collect()
    }

    /// The latest general status of a device.
    #[must_use]
    pub fn general(&self, device: u8) -> StatusGeneral {
        let frames = self.received(status_id::STATUS_GENERAL, device);
        StatusGeneral::parse(&frames.last().expect("a general status").1).expect("eight bytes")
    }

    /// The latest encoder status of a device.
    #[must_use]
    pub fn encoder(&self, device: u8) -> StatusEncoder {
        let frames = self.received(status_id::STATUS_ENCODER, device);
        StatusEncoder::parse(&frames.last().expect("an encoder status").1).expect("eight bytes")
    }

    /// The latest analog status of a device.
    #[must_use]
    pub fn analog(&self, device: u8) -> StatusAnalog {
        let frames = self.received(status_id::STATUS_ANALOG, device);
        StatusAnalog::parse(&frames.last().expect("an analog status").1).expect("eight bytes")
    }
}
