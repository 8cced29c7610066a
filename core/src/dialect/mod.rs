//! Dialects.

pub mod dmc60c;

/// Number of dialects.
pub const COUNT: usize = 1;
