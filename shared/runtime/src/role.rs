//! When a process speaks: from one position of the run on, until another.
//!
//! A process that takes over from another first runs beside it in silence. It reads the same messages, and computes, but
//! what it would send is held back; from the border on it speaks, and its predecessor is silent. Positions are ordered by
//! episode, then step, so that a border which an episode's early end leaves out is crossed by the next episode's first
//! step.

use core::cell::Cell;

/// A place in a run: episode, then step.
pub type Position = (u32, u32);

/// Later than every step.
pub const NEVER: Position = (u32::MAX, u32::MAX);

/// From when to when a process speaks.
#[derive(Debug)]
pub(crate) struct Role {
    from: Cell<Position>,
    until: Cell<Position>,
    /// Newest position about which something was sent.
    sent: Cell<Option<Position>>,
    /// Newest position that passed in silence and about which nothing is held back.
    passed: Cell<Option<Position>>,
}

impl Role {
    /// Speaks from the beginning, or, standing by, not at all.
    pub(crate) fn new(standby: bool) -> Self {
        Self {
            from: Cell::new(if standby { NEVER } else { (0, 0) }),
            until: Cell::new(NEVER),
            sent: Cell::new(None),
            passed: Cell::new(None),
        }
    }

    pub(crate) fn speaks(&self, position: Position) -> bool {
        self.from.get() <= position && position < self.until.get()
    }

    /// From where on it speaks.
    pub(crate) fn from(&self) -> Position {
        self.from.get()
    }

    /// Whether nobody told it yet from when on it shall speak.
    pub(crate) fn stands_by(&self) -> bool {
        self.from.get() == NEVER
    }

    /// Newest position about which something was sent.
    pub(crate) fn sent(&self) -> Option<Position> {
        self.sent.get()
    }

    pub(crate) fn note_sent(&self, position: Position) {
        self.sent.set(self.sent.get().max(Some(position)));
    }

    pub(crate) fn note_passed(&self, position: Position) {
        self.passed.set(self.passed.get().max(Some(position)));
    }

    /// Speaks from `border` on. False, and nothing changes, if the border has passed in silence already.
    pub(crate) fn take_over(&self, border: Position) -> bool {
        if self.passed.get() >= Some(border) {
            return false;
        }
        self.from.set(border);
        self.until.set(NEVER);
        true
    }

    /// Is silent from `border` on. False, and nothing changes, if something was sent about a later position already.
    pub(crate) fn hand_over(&self, border: Position) -> bool {
        if self.sent.get() >= Some(border) {
            return false;
        }
        self.until.set(border);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_processes_share_a_run_without_gap_or_overlap() {
        let (old, new) = (Role::new(false), Role::new(true));
        let border = (1, 3);
        assert!(old.speaks((0, 0)) && new.stands_by());
        assert!(new.take_over(border) && old.hand_over(border));
        for episode in 0..3 {
            for step in 0..6 {
                let position = (episode, step);
                assert_ne!(old.speaks(position), new.speaks(position), "{position:?}");
                assert_eq!(new.speaks(position), position >= border);
            }
        }
    }

    #[test]
    fn a_border_that_has_passed_is_refused() {
        let role = Role::new(false);
        role.note_sent((2, 7));
        assert!(!role.hand_over((2, 7)));
        assert!(role.speaks((2, 7)));
        assert!(role.hand_over((2, 8)));
        assert!(role.hand_over(NEVER), "the hand-over is taken back");
        assert!(role.speaks((2, 8)));
        let late = Role::new(true);
        late.note_passed((0, 4));
        assert!(!late.take_over((0, 4)));
        assert!(late.stands_by());
        assert!(late.take_over((0, 5)));
    }
}
