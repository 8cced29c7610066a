//! Words for people beside the results, on standard error.

use std::fmt::Arguments;
use std::io::{Write, stderr};

/// Writes one line. That nobody listens any more is no reason to fail: what matters is in the exit code.
pub(crate) fn remark(text: Arguments<'_>) {
    let _ = writeln!(stderr().lock(), "{text}");
}
