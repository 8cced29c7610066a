//! A tool that speaks as a Talon SRX's host does.

use windlass_core::dialect::talon_srx::wire::{
    Control1, General, ModeSelect, Parameter, ParameterRequest, ParameterValue, Status1, Status2,
    Status3, Status4, id,
};
use windlass_core::frame::Frame;
use windlass_core::frc_id;
use windlass_core::time::Duration;
use windlass_sim::{ParticipantId, Poke, Received, Truth, World, WorldConfig};

/// A world with one tool.
pub(crate) struct Bench {
    pub(crate) world: World,
    pub(crate) tool: ParticipantId,
}

/// What a host says in mode and demand, everything else as it is by default.
pub(crate) fn general(mode: ModeSelect, demand: i32) -> General {
    General {
        mode,
        demand,
        ..General::default()
    }
}

/// A duty cycle in throttle units.
pub(crate) fn duty(throttle: i32) -> General {
    general(ModeSelect::Duty, throttle)
}

/// A gain as 10.22.
pub(crate) fn gain(value: f64) -> u32 {
    (value * f64::from(1 << 22)) as i64 as u32
}

impl Bench {
    pub(crate) fn new(nodes: &[&str]) -> Self {
        let mut world = World::new(WorldConfig::default());
        for node in nodes {
            world.add_node(node.parse().expect("a good node"));
        }
        let tool = world.join("test");
        let mut bench = Self { world, tool };
        // Somebody else's frame shows the nodes that there is a bus.
        bench.send(Frame::extended(0x1FFF_FFFF, []));
        bench.run(50);
        bench.drain();
        bench
    }

    pub(crate) fn run(&mut self, millis: u32) {
        self.world.advance(Duration::from_millis(millis));
    }

    pub(crate) fn send(&mut self, frame: Frame) {
        self.world.send(self.tool, frame);
    }

    pub(crate) fn poke(&mut self, node: usize, poke: Poke) {
        self.world.node_mut(node).expect("the node").poke(poke);
        self.run(1);
    }

    pub(crate) fn truth(&self, node: usize) -> Truth {
        self.world.node(node).expect("the node").truth()
    }

    /// Throttle at the terminals of node 0.
    pub(crate) fn throttle(&self) -> i32 {
        windlass_core::units::Duty::new(self.truth(0).duty).throttle()
    }

    pub(crate) fn control(&mut self, number: u8, told: General) {
        let control = Control1 {
            token: 0,
            general: Some(told),
        };
        self.send(control.emit(number));
    }

    /// Control_1 every 10 ms for `millis`.
    pub(crate) fn drive(&mut self, number: u8, told: General, millis: u32) {
        for _ in 0..millis / 10 {
            self.control(number, told);
            self.run(10);
        }
    }

    pub(crate) fn drain(&mut self) -> Vec<Received> {
        std::iter::from_fn(|| self.world.receive(self.tool)).collect()
    }

    /// The next frame of a kind from a device, within 300 ms.
    pub(crate) fn next(&mut self, base: u32, number: u8) -> Frame {
        self.drain();
        for _ in 0..300 {
            self.run(1);
            let frames = self.drain();
            let wanted = frc_id::with_number(base, number);
            if let Some(received) = frames.iter().find(|at| at.frame.raw_id() == wanted) {
                return received.frame;
            }
        }
        panic!("no frame {base:x} from {number}");
    }

    pub(crate) fn status_1(&mut self, number: u8) -> Status1 {
        Status1::parse(&self.next(id::STATUS_1, number)).expect("a status")
    }

    pub(crate) fn status_2(&mut self, number: u8) -> Status2 {
        Status2::parse(&self.next(id::STATUS_2, number)).expect("a status")
    }

    pub(crate) fn status_3(&mut self, number: u8) -> Status3 {
        Status3::parse(&self.next(id::STATUS_3, number)).expect("a status")
    }

    pub(crate) fn status_4(&mut self, number: u8) -> Status4 {
        Status4::parse(&self.next(id::STATUS_4, number)).expect("a status")
    }

    /// Sets a parameter; gives the answer, which has to come within 4 ms.
    pub(crate) fn set(&mut self, number: u8, parameter: Parameter, value: u32) -> Option<u32> {
        let parameter = parameter.code();
        self.ask(
            number,
            ParameterValue { parameter, value }.emit_set(number),
            parameter,
        )
    }

    /// Reads a parameter.
    pub(crate) fn get(&mut self, number: u8, parameter: Parameter) -> Option<u32> {
        let parameter = parameter.code();
        self.ask(
            number,
            ParameterRequest { parameter }.emit(number),
            parameter,
        )
    }

    pub(crate) fn ask(&mut self, number: u8, question: Frame, parameter: u8) -> Option<u32> {
        self.drain();
        self.send(question);
        self.run(4);
        let wanted = frc_id::with_number(id::PARAMETER_RESPONSE, number);
        self.drain()
            .iter()
            .filter(|received| received.frame.raw_id() == wanted)
            .filter_map(|received| ParameterValue::parse_response(&received.frame))
            .find(|answer| answer.parameter == parameter)
            .map(|answer| answer.value)
    }
}
