//! Remembers when a self-test was made, so that a second one in quick succession is known as such
//! (manual 2.4.1) although each is a process of its own.

use std::fs;
use std::path::PathBuf;
use std::time::SystemTime;

use crate::client::talon::QUICK_SUCCESSION;

/// The file that stands for a self-test of one device; its time is what counts.
pub(super) struct Press(Option<PathBuf>);

impl Press {
    /// The file for device `number` on `transport`, in the user's run-time or cache folder. Without either,
    /// every self-test counts as the first.
    pub(super) fn of(transport: &str, number: u8) -> Self {
        let folder = std::env::var_os("XDG_RUNTIME_DIR")
            .or_else(|| std::env::var_os("XDG_CACHE_HOME"))
            .map(PathBuf::from)
            .or_else(|| std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".cache")))
            .filter(|folder| folder.is_absolute());
        let bus: String = transport
            .chars()
            .map(|letter| {
                if letter.is_ascii_alphanumeric() {
                    letter
                } else {
                    '-'
                }
            })
            .collect();
        Self(folder.map(|folder| {
            folder
                .join("windlass")
                .join(format!("self-test-{bus}-{number}"))
        }))
    }

    /// True if the one before was made in the last three seconds.
    pub(super) fn is_again(&self) -> bool {
        let made = self.0.as_ref().and_then(|path| fs::metadata(path).ok());
        let made = made.and_then(|data| data.modified().ok());
        let age = made.and_then(|made| SystemTime::now().duration_since(made).ok());
        age.is_some_and(|age| age <= QUICK_SUCCESSION)
    }

    /// A self-test is made now. Where it cannot be remembered the next one counts as the first.
    pub(super) fn remember(&self) {
        if let Some(path) = &self.0
            && let Some(folder) = path.parent()
            && fs::create_dir_all(folder).is_ok()
        {
            let _ = fs::write(path, b"");
        }
    }
}
