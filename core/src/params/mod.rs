//! Parameters.

pub mod table;
