//! The brake/coast button.

/// Counts a press once, when the level has been low for 20 ms.
#[derive(Clone, Copy, Debug, Default)]
pub struct Button {
    low_ticks: u8,
}

impl Button {
    const LOW_TICKS: u8 = 40;

    /// Takes the level of a tick; true once for every press.
    pub fn pressed(&mut self, high: bool) -> bool {
        if high {
            self.low_ticks = 0;
            return false;
        }
        let before = self.low_ticks;
        self.low_ticks = before.saturating_add(1).min(Self::LOW_TICKS);
        before + 1 == Self::LOW_TICKS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_press_counts_once_and_a_bounce_does_not() {
        let mut button = Button::default();
        for _ in 0..10 {
            let bounces = (0..39).filter(|_| button.pressed(false)).count();
            assert_eq!(bounces, 0);
            assert!(!button.pressed(true));
        }
        let presses = (0..1000).filter(|_| button.pressed(false)).count();
        assert_eq!(presses, 1);
    }
}
