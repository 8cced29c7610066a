//! What a world and its nodes are made from.

use std::fmt;
use std::str::FromStr;

use windlass_core::dialect::{self, DialectKind};
use windlass_core::time::Duration;

/// Settings of a world.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldConfig {
    /// Seed of everything random.
    pub seed: u64,
    /// Probability that a frame is lost for one receiver, 0 to 1.
    pub loss: f64,
    /// Probability that a frame is destroyed by an error frame and sent again, 0 to 1.
    pub corruption: f64,
    /// Largest delay between handing a frame to a CAN controller and its first attempt; each frame's is
    /// drawn from zero to this.
    pub delay: Duration,
    /// Bits per second.
    pub bit_rate: u32,
}

impl Default for WorldConfig {
    /// An undisturbed bus at the DMC60C's 1 Mbit/s.
    fn default() -> Self {
        Self {
            seed: 1,
            loss: 0.0,
            corruption: 0.0,
            delay: Duration::ZERO,
            bit_rate: 1_000_000,
        }
    }
}

/// A node to be added: driving dialect and device number, written `dmc60c:5`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeSpec {
    /// Driving dialect.
    pub dialect: DialectKind,
    /// Device number, 0 to the largest of the dialect's
    /// [`Identity`](windlass_core::management::Identity).
    pub number: u8,
}

/// Why a text is no [`NodeSpec`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NodeSpecError {
    /// The part before the colon names no dialect; holds it.
    #[error("no dialect is called '{0}'; this build has {names}", names = names())]
    Dialect(String),
    /// The part after the colon is no device number of the dialect.
    #[error(
        "'{text}' is no device number; give 0 to {largest}, for example {name}:5",
        name = dialect.name(),
        largest = dialect.identity().last_number
    )]
    Number {
        /// What was given.
        text: String,
        /// The dialect that was named.
        dialect: DialectKind,
    },
}

fn names() -> String {
    let names: Vec<_> = dialect::ALL.iter().map(|kind| kind.name()).collect();
    names.join(", ")
}

impl FromStr for NodeSpec {
    type Err = NodeSpecError;

    /// Reads `dialect:number`; without a number it is 0.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (name, number) = text.split_once(':').unwrap_or((text, "0"));
        let dialect =
            DialectKind::from_name(name).ok_or_else(|| NodeSpecError::Dialect(name.to_owned()))?;
        let number = number
            .parse()
            .ok()
            .filter(|number| *number <= dialect.identity().last_number)
            .ok_or_else(|| NodeSpecError::Number {
                text: number.to_owned(),
                dialect,
            })?;
        Ok(Self { dialect, number })
    }
}

impl fmt::Display for NodeSpec {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}:{}", self.dialect.name(), self.number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spec_reads_back_as_it_is_written() {
        let spec: NodeSpec = "dmc60c:5".parse().unwrap();
        assert_eq!((spec.dialect, spec.number), (DialectKind::Dmc60c, 5));
        assert_eq!(spec.to_string(), "dmc60c:5");
        assert_eq!("dmc60c".parse::<NodeSpec>().unwrap().number, 0);
    }

    #[test]
    fn errors_name_the_part_and_what_is_allowed() {
        let message = |text: &str| text.parse::<NodeSpec>().unwrap_err().to_string();
        assert!(
            message("vesc:1").starts_with("no dialect is called 'vesc'; this build has dmc60c")
        );
        assert_eq!(
            message("dmc60c:64"),
            "'64' is no device number; give 0 to 63, for example dmc60c:5"
        );
        assert_eq!(
            message("talon:63"),
            "'63' is no device number; give 0 to 62, for example talon:5"
        );
        assert!("talon:0".parse::<NodeSpec>().is_ok() && "talon:62".parse::<NodeSpec>().is_ok());
        assert!(message("dmc60c:").starts_with("'' is no device number"));
        assert!(message("dmc60c:-1").starts_with("'-1' is no device number"));
    }
}
