//! What waits to be sent to one page.

use std::collections::VecDeque;
use std::sync::Arc;

/// Bytes of what must arrive in order that may wait for a page.
pub const MOST_WAITING: usize = 8 << 20;

/// What is replaced by its newest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// Where everybody is now.
    Motion = 0,
    /// What a step led to.
    Step,
}

/// A page's mailbox.
#[derive(Debug, Default)]
pub struct Mailbox {
    queue: VecDeque<Arc<str>>,
    waiting: usize,
    newest: [Option<Arc<str>>; 2],
    /// Nobody reads it any more, or it has overflowed.
    pub is_closed: bool,
}

impl Mailbox {
    /// Adds what must arrive, in order. A page that has let too much pile up is let go.
    pub fn tell(&mut self, text: Arc<str>) {
        if self.waiting + text.len() > MOST_WAITING {
            self.close();
        }
        if !self.is_closed {
            self.waiting += text.len();
            self.queue.push_back(text);
        }
    }

    /// Replaces what waits in this slot.
    pub fn publish(&mut self, slot: Slot, text: Arc<str>) {
        if !self.is_closed {
            self.newest[slot as usize] = Some(text);
        }
    }

    /// Nothing more is sent.
    pub fn close(&mut self) {
        *self = Self {
            is_closed: true,
            ..Self::default()
        };
    }

    /// What is to be sent next.
    pub fn next(&mut self) -> Option<Arc<str>> {
        if let Some(text) = self.queue.pop_front() {
            self.waiting -= text.len();
            return Some(text);
        }
        self.newest.iter_mut().find_map(Option::take)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_state_replaces_what_waits() {
        let mut mailbox = Mailbox::default();
        for n in 0..1000 {
            mailbox.publish(Slot::Motion, format!("m{n}").into());
            mailbox.publish(Slot::Step, format!("s{n}").into());
        }
        mailbox.tell("first".into());
        mailbox.tell("second".into());
        let sent: Vec<_> = std::iter::from_fn(|| mailbox.next()).collect();
        let sent: Vec<&str> = sent.iter().map(|text| &**text).collect();
        assert_eq!(sent, ["first", "second", "m999", "s999"]);
    }

    #[test]
    fn a_page_that_lets_it_pile_up_is_let_go() {
        let mut mailbox = Mailbox::default();
        let text: Arc<str> = "x".repeat(MOST_WAITING / 4).into();
        for _ in 0..4 {
            mailbox.tell(text.clone());
        }
        assert!(!mailbox.is_closed);
        mailbox.tell("one more".into());
        assert!(mailbox.is_closed);
        assert_eq!(mailbox.next(), None, "nothing is kept for nobody");
        mailbox.publish(Slot::Motion, "m".into());
        assert_eq!(mailbox.next(), None);
    }

    #[test]
    fn what_was_sent_makes_room() {
        let mut mailbox = Mailbox::default();
        let text: Arc<str> = "x".repeat(MOST_WAITING).into();
        for _ in 0..3 {
            mailbox.tell(text.clone());
            assert!(mailbox.next().is_some());
        }
        assert!(!mailbox.is_closed);
    }
}
