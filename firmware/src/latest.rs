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

impl<T: Copy> Latest<Maybe<T>> {
    /// A cell into which nothing was put yet.
    #[must_use]
    pub const fn empty() -> Self {
        Self::new(Maybe::Nothing)
    }

    /// Puts a value in, for [`Latest::take`].
    pub fn offer(&self, value: T) {
        self.put(Maybe::Just(value));
    }

    /// The value, if one was put since the last call.
    #[must_use]
    pub fn take(&self) -> Option<T> {
        // Not `replace`, which copies twice with interrupts masked.
        critical_section::with(|token| {
            let cell = self.0.borrow(token);
            let value = cell.get().get()?;
            cell.set(Maybe::Nothing);
            Some(value)
        })
    }
}

/// An option that is all zeros while it is empty: a static made of such takes up no flash. An `Option` uses for that a
/// value that one of its fields does not take, and the whole static then is copied from flash at the start.
#[derive(Clone, Copy, Debug)]
#[repr(u8)]
pub enum Maybe<T> {
    /// Nothing.
    Nothing = 0,
    /// A value.
    Just(T) = 1,
}

impl<T> Maybe<T> {
    /// The value as an option.
    #[must_use]
    #[inline]
    pub fn get(self) -> Option<T> {
        self.into()
    }

    /// The value by reference.
    #[must_use]
    #[inline]
    pub const fn as_ref(&self) -> Option<&T> {
        match self {
            Self::Nothing => None,
            Self::Just(value) => Some(value),
        }
    }

    /// The value, for a change in place.
    #[must_use]
    #[inline]
    pub const fn as_mut(&mut self) -> Option<&mut T> {
        match self {
            Self::Nothing => None,
            Self::Just(value) => Some(value),
        }
    }
}

impl<T> From<Maybe<T>> for Option<T> {
    #[inline]
    fn from(value: Maybe<T>) -> Self {
        match value {
            Maybe::Nothing => None,
            Maybe::Just(value) => Some(value),
        }
    }
}

impl<T> From<Option<T>> for Maybe<T> {
    #[inline]
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Nothing, Self::Just)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_value_wins_and_is_taken_once() {
        let cell = Latest::empty();
        assert_eq!(cell.take(), None);
        cell.offer(1);
        cell.offer(2);
        assert_eq!(cell.get().get(), Some(2));
        assert_eq!(cell.take(), Some(2));
        assert_eq!(cell.take(), None);
    }

    #[test]
    fn nothing_is_told_by_a_zero() {
        // The same of an option would not be: it tells nothing by a value that a boolean does not have.
        let nothing: Maybe<bool> = Maybe::Nothing;
        // SAFETY: the first byte of an enum that is represented by `u8` is its discriminant.
        let first = unsafe { (&raw const nothing).cast::<u8>().read() };
        assert_eq!(first, 0);
    }
}
