//! When a process is active: from one step of the run on, until another. Its messages are sent then, and only then.
//!
//! A process that takes over from another first runs beside it in silence. It reads the same messages, and computes,
//! but what it would send is held back; from the handover step on it is active, and its predecessor is silent.
//! Positions are ordered by episode, then step, so that a handover step that an episode's early end leaves out is
//! crossed by the next episode's first step.

use core::cell::Cell;

/// A place in a run: episode, then step.
pub type Position = (u32, u32);

/// Later than every step.
pub const NEVER: Position = (u32::MAX, u32::MAX);

/// From when to when a process is active.
#[derive(Debug)]
pub(crate) struct Turn {
    from: Cell<Position>,
    until: Cell<Position>,
    /// Newest position about which something was sent.
    sent: Cell<Option<Position>>,
    /// Newest position that passed in silence and about which nothing is held back.
    passed: Cell<Option<Position>>,
}

impl Turn {
    /// Active from the beginning, or, on standby, not at all.
    pub(crate) fn new(standby: bool) -> Self {
        Self {
            from: Cell::new(if standby { NEVER } else { (0, 0) }),
            until: Cell::new(NEVER),
            sent: Cell::new(None),
            passed: Cell::new(None),
        }
    }

    pub(crate) fn is_active(&self, position: Position) -> bool {
        self.from.get() <= position && position < self.until.get()
    }

    /// From where on it is active.
    pub(crate) fn from(&self) -> Position {
        self.from.get()
    }

    /// Whether nobody told it yet from when on it is active.
    pub(crate) fn is_standby(&self) -> bool {
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

    /// Active from `handover_step` on. False, and nothing changes, if the handover step has passed in silence already.
    pub(crate) fn take_over(&self, handover_step: Position) -> bool {
        if self.passed.get() >= Some(handover_step) {
            return false;
        }
        self.from.set(handover_step);
        self.until.set(NEVER);
        true
    }

    /// Is silent from `handover_step` on. False, and nothing changes, if something was sent about a later position
    /// already.
    pub(crate) fn hand_over(&self, handover_step: Position) -> bool {
        if self.sent.get() >= Some(handover_step) {
            return false;
        }
        self.until.set(handover_step);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_processes_share_a_run_without_gap_or_overlap() {
        let (old, new) = (Turn::new(false), Turn::new(true));
        let handover_step = (1, 3);
        assert!(old.is_active((0, 0)) && new.is_standby());
        assert!(new.take_over(handover_step) && old.hand_over(handover_step));
        for episode in 0..3 {
            for step in 0..6 {
                let position = (episode, step);
                assert_ne!(
                    old.is_active(position),
                    new.is_active(position),
                    "{position:?}"
                );
                assert_eq!(new.is_active(position), position >= handover_step);
            }
        }
    }

    #[test]
    fn a_handover_step_that_has_passed_is_refused() {
        let turn = Turn::new(false);
        turn.note_sent((2, 7));
        assert!(!turn.hand_over((2, 7)));
        assert!(turn.is_active((2, 7)));
        assert!(turn.hand_over((2, 8)));
        assert!(turn.hand_over(NEVER), "the hand-over is taken back");
        assert!(turn.is_active((2, 8)));
        let late = Turn::new(true);
        late.note_passed((0, 4));
        assert!(!late.take_over((0, 4)));
        assert!(late.is_standby());
        assert!(late.take_over((0, 5)));
    }
}
