//! Dialects: how a controller is spoken to.
//!
//! A dialect decodes frames into intents and encodes status frames from the snapshot. It holds only what
//! its protocol needs to remember; it never touches the engine, and the engine never names a dialect.
//! `docs/new-dialect.md` adds one step by step.

use crate::engine::command::{DriveOpts, PositionOf, Setpoint};
use crate::engine::settings::{Policy, Settings};
use crate::engine::snapshot::{Faults, Snapshot};
use crate::frame::Frame;
use crate::led::Style;
use crate::management::Identity;
use crate::params::{Params, SaveRule};
use crate::time::Instant;
use crate::units::Duty;

pub mod schedule;

/// Why a frame that was meant for this device was not obeyed. Each reason has its counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bad {
    /// The data length is not the one that the protocol demands.
    Length,
    /// A remote frame where a data frame is expected.
    Remote,
    /// The session id is not the present one.
    Session,
    /// Data that no command has asked for.
    Unexpected,
}

/// What a driving frame asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Intent {
    /// Drive like this from now on; restarts the heartbeat, or switches off with [`Setpoint::Off`]. Where
    /// the permission is separate this gives it too.
    Drive(Setpoint, DriveOpts),
    /// Drive like this as soon and as long as there is permission.
    Prepare(Setpoint, DriveOpts),
    /// Gives permission to drive for the policy's time, or withdraws it at once.
    Enable(bool),
    /// The followed controller reports its duty cycle.
    MasterReport(Duty),
    /// Overwrites a position.
    SetPosition(PositionOf, i32),
    /// Overwrites the sum of errors of the closed loop.
    SetAccumulator(i32),
    /// Clears what is asked for.
    Clear {
        /// The selected sensor's position.
        position: bool,
        /// The sticky faults and limits.
        sticky: bool,
    },
}

/// A question about a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Read the parameter with this number.
    Read(u8),
    /// Write the parameter with this number.
    Write(u8, u32),
}

/// The answer to a [`Request`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// Number of the parameter.
    pub parameter: u8,
    /// Value in force, or why there is none.
    pub result: Result<u32, crate::management::vendor::ParameterError>,
}

/// What a frame turned out to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decoded {
    /// Nothing for this device.
    Ignored,
    /// Handled by the dialect itself.
    Done,
    /// A driving frame.
    Intent(Intent),
    /// A question about a parameter.
    Request(Request),
    /// A frame for this device that changes nothing.
    Bad(Bad),
}

/// A frame to send, with what it is for: that decides how often it is tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outgoing {
    /// Somebody waits for it.
    Answer(Frame),
    /// A periodic frame, which the next period replaces.
    Status(Frame),
}

/// The device apart from its drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Device {
    /// Faults since they were last cleared.
    pub sticky: Faults,
    /// Version of the application, major and minor byte.
    pub version: u16,
    /// Restarts since power-on.
    pub reset_count: u16,
    /// Code of the [cause](crate::reset::ResetCause) of the last reset.
    pub reset_flags: u16,
    /// Settings have been changed and not yet been kept.
    pub unsaved: bool,
}

/// What a dialect may look at when it encodes.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// This device's number.
    pub number: u8,
    /// Parameters.
    pub params: &'a Params,
    /// What the control tick was told of the parameters.
    pub settings: &'a Settings,
    /// State of the drive.
    pub snapshot: &'a Snapshot,
    /// The device.
    pub device: Device,
}

/// A driving dialect.
pub trait Dialect {
    /// Name for people and for the command line.
    const NAME: &'static str;

    /// When the drive stops and resumes under this dialect.
    const POLICY: Policy;

    /// When changed settings are written under this dialect.
    const SAVE_RULE: SaveRule = SaveRule::AfterQuiet;

    /// How the LEDs show the state under this dialect.
    const LED_STYLE: Style = Style::Running;

    /// As what the controller is discovered and managed under this dialect.
    const IDENTITY: Identity = Identity::DMC60C;

    /// Reads one frame; [`Decoded::Ignored`] unless it is for device `number` or from whom it follows. Most frames
    /// of a bus are for others, so this is to be told first, by the identifier alone.
    fn decode(&mut self, number: u8, frame: &Frame) -> Decoded;

    /// Takes the outcome of a [`Decoded::Request`], to be answered by [`Dialect::encode`].
    fn answer(&mut self, outcome: Outcome);

    /// The bus has appeared: periodic frames start.
    fn start(&mut self, now: Instant, params: &Params);

    /// The bus is lost: nothing is owed to anybody any more.
    fn stop(&mut self);

    /// The next frame to send, an answer owed or a periodic frame that is due.
    fn encode(&mut self, now: Instant, view: &View<'_>) -> Option<Outgoing>;

    /// When [`Dialect::encode`] has something to send next.
    fn next_deadline(&self) -> Option<Instant>;
}

/// Declares the modules, the enums and the dispatch of all dialects, so that a new one is one file and
/// one entry in the list below. The position in the list is the value of the dialect parameter.
macro_rules! dialects {
    ($( $(#[$meta:meta])* $module:ident :: $dialect:ident ),* $(,)?) => {
        $( $(#[$meta])* pub mod $module; )*

        /// The dialects of this build. The discriminant is the value of `paramDialect`.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum DialectKind {
            $(
                $(#[$meta])*
                #[doc = concat!("See [`", stringify!($module), "`].")]
                $dialect,
            )*
        }

        /// Every dialect of this build.
        pub const ALL: &[DialectKind] = &[ $( $(#[$meta])* DialectKind::$dialect, )* ];

        impl DialectKind {
            /// The dialect's name.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $( $(#[$meta])* Self::$dialect => <$module::$dialect as Dialect>::NAME, )*
                }
            }

            /// The dialect's stopping and resuming rules.
            #[must_use]
            pub const fn policy(self) -> Policy {
                match self {
                    $( $(#[$meta])* Self::$dialect => <$module::$dialect as Dialect>::POLICY, )*
                }
            }

            /// When changed settings are written.
            #[must_use]
            pub const fn save_rule(self) -> SaveRule {
                match self {
                    $( $(#[$meta])* Self::$dialect => <$module::$dialect as Dialect>::SAVE_RULE, )*
                }
            }

            /// As what the controller is discovered and managed.
            #[must_use]
            pub const fn identity(self) -> &'static Identity {
                match self {
                    $( $(#[$meta])* Self::$dialect => &<$module::$dialect as Dialect>::IDENTITY, )*
                }
            }

            /// How the LEDs show the state.
            #[must_use]
            pub const fn led_style(self) -> Style {
                match self {
                    $( $(#[$meta])* Self::$dialect => <$module::$dialect as Dialect>::LED_STYLE, )*
                }
            }
        }

        /// Any dialect, chosen at run time.
        // One of them lives in each node, and nothing here allocates.
        #[allow(clippy::large_enum_variant)]
        #[derive(Clone, Debug)]
        pub enum AnyDialect {
            $(
                $(#[$meta])*
                #[doc = concat!("See [`", stringify!($module), "`].")]
                $dialect($module::$dialect),
            )*
        }

        impl AnyDialect {
            /// A dialect before the bus has appeared.
            #[must_use]
            pub fn new(kind: DialectKind) -> Self {
                match kind {
                    $( $(#[$meta])* DialectKind::$dialect => Self::$dialect($module::$dialect::default()), )*
                }
            }

            /// Which one it is.
            #[must_use]
            pub const fn kind(&self) -> DialectKind {
                match self {
                    $( $(#[$meta])* Self::$dialect(_) => DialectKind::$dialect, )*
                }
            }

            /// See [`Dialect::decode`].
            pub fn decode(&mut self, number: u8, frame: &Frame) -> Decoded {
                match self { $( $(#[$meta])* Self::$dialect(inner) => inner.decode(number, frame), )* }
            }

            /// See [`Dialect::answer`].
            pub fn answer(&mut self, outcome: Outcome) {
                match self { $( $(#[$meta])* Self::$dialect(inner) => inner.answer(outcome), )* }
            }

            /// See [`Dialect::start`].
            pub fn start(&mut self, now: Instant, params: &Params) {
                match self { $( $(#[$meta])* Self::$dialect(inner) => inner.start(now, params), )* }
            }

            /// See [`Dialect::stop`].
            pub fn stop(&mut self) {
                match self { $( $(#[$meta])* Self::$dialect(inner) => inner.stop(), )* }
            }

            /// See [`Dialect::encode`].
            pub fn encode(&mut self, now: Instant, view: &View<'_>) -> Option<Outgoing> {
                match self { $( $(#[$meta])* Self::$dialect(inner) => inner.encode(now, view), )* }
            }

            /// See [`Dialect::next_deadline`].
            #[must_use]
            pub fn next_deadline(&self) -> Option<Instant> {
                match self { $( $(#[$meta])* Self::$dialect(inner) => inner.next_deadline(), )* }
            }
        }
    };
}

dialects! {
    dmc60c::Dmc60c,
    talon_srx::TalonSrx,
    #[cfg(feature = "example-dialect")]
    minimal::Minimal,
}

/// Number of dialects of this build.
pub const COUNT: usize = ALL.len();

impl DialectKind {
    /// The dialect with this value of `paramDialect`.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Self> {
        ALL.get(usize::try_from(code).ok()?).copied()
    }

    /// The value of `paramDialect`.
    #[must_use]
    pub const fn code(self) -> u32 {
        self as u32
    }

    /// The dialect with this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        ALL.iter().copied().find(|kind| kind.name() == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_and_names_find_their_dialect() {
        for kind in ALL {
            assert_eq!(DialectKind::from_code(kind.code()), Some(*kind));
            assert_eq!(DialectKind::from_name(kind.name()), Some(*kind));
        }
        assert_eq!(DialectKind::from_code(COUNT as u32), None);
        assert_eq!(DialectKind::from_name("no such dialect"), None);
        assert_eq!(DialectKind::Dmc60c.code(), 0);
    }
}
