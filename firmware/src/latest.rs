//! Cells in which a value crosses between two priorities. Only the latest one counts; nobody waits.

use core::cell::Cell;

use critical_section::Mutex;

/// The latest value of something. Reading and writing copy it with interrupts masked, which takes as
/// long as copying `T`; keep `T` small.
#[derive(Debug)]
pub struct Latest<T: Copy>(Mutex<Cell<T>>);

impl<T: Copy> Latest<T> {
    /// A cell that starts with `value`.
    #[must_use]
    pub const fn new(value: T) -> Self {
        Self(Mutex::new(Cell::new(value)))
    }

    /// Replaces the value.
    pub fn put(&self, value: T) {
        critical_section::with(|token| self.0.borrow(token).set(value));
    }

    /// Replaces the value and gives the one before.
    pub fn replace(&self, value: T) -> T {
        critical_section::with(|token| self.0.borrow(token).replace(value))
    }

    /// The value.
    #[must_use]
    pub fn get(&self) -> T {
        critical_section::with(|token| self.0.borrow(token).get())
    }
}

impl<T: Copy> Latest<Option<T>> {
    /// The value, if one was put since the last call.
    #[must_use]
    pub fn take(&self) -> Option<T> {
        critical_section::with(|token| self.0.borrow(token).take())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_value_wins_and_is_taken_once() {
        let cell = Latest::new(None);
        assert_eq!(cell.take(), None);
        cell.put(Some(1));
        cell.put(Some(2));
        assert_eq!(cell.get(), Some(2));
        assert_eq!(cell.take(), Some(2));
        assert_eq!(cell.take(), None);
    }
}
