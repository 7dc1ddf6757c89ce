//! Who is at the wheel: which page drives, whether the person is there, and since when they are not.

use messages::Presence;
use web::PageId;

/// A page says what its person does ten times a second; one that is silent for so long has gone.
const SILENCE_NS: u64 = 2_500_000_000;

/// The page that drives, and whether somebody sits at it. The page that was opened last drives.
#[derive(Debug)]
pub struct Attendance {
    void_after_ns: u64,
    page: Option<PageId>,
    /// When the page was last heard of.
    heard_ns: u64,
    /// The episode that the person is ready for.
    ready: Option<u32>,
    episode: Option<u32>,
    /// Whether somebody was there in this episode.
    has_begun: bool,
    absent_since_ns: Option<u64>,
    is_given_up: bool,
}

impl Attendance {
    /// Nobody yet.
    pub fn new(void_after_ns: u64) -> Self {
        Self {
            void_after_ns,
            page: None,
            heard_ns: 0,
            ready: None,
            episode: None,
            has_begun: false,
            absent_since_ns: None,
            is_given_up: false,
        }
    }

    /// A page is opened, and drives from now on; the one that drove before.
    pub fn join(&mut self, page: PageId, now_ns: u64) -> Option<PageId> {
        self.heard_ns = now_ns;
        self.ready = None;
        self.page.replace(page)
    }

    /// A page is closed; true if it drove.
    pub fn leave(&mut self, page: PageId) -> bool {
        let drove = self.is_driver(page);
        if drove {
            (self.page, self.ready) = (None, None);
        }
        drove
    }

    /// Whether this page drives.
    pub fn is_driver(&self, page: PageId) -> bool {
        self.page == Some(page)
    }

    /// The page that drives was heard of.
    pub fn hear(&mut self, now_ns: u64) {
        self.heard_ns = now_ns;
    }

    /// The person is ready for this episode, or for going on with it.
    pub fn get_ready(&mut self, episode: u32) {
        self.ready = Some(episode);
    }

    /// The person has turned to something else.
    pub fn go_away(&mut self) {
        self.ready = None;
    }

    /// An episode begins: nobody is there until they say so.
    pub fn begin(&mut self, episode: u32) {
        self.episode = Some(episode);
        (self.has_begun, self.is_given_up) = (false, false);
        self.absent_since_ns = None;
    }

    /// Whether somebody is there.
    pub fn presence(&self, episode: u32, now_ns: u64) -> Presence {
        if self.is_given_up && self.episode == Some(episode) {
            return Presence::GivenUp;
        }
        let is_heard = now_ns.saturating_sub(self.heard_ns) < SILENCE_NS;
        match self.page.is_some() && self.ready == Some(episode) && is_heard {
            true => Presence::Present,
            false => Presence::Absent,
        }
    }

    /// Looks whether somebody is there, and gives up a round that has waited for too long.
    pub fn attend(&mut self, now_ns: u64) -> Presence {
        let Some(episode) = self.episode else {
            return Presence::Absent;
        };
        match self.presence(episode, now_ns) {
            Presence::Present => {
                (self.has_begun, self.absent_since_ns) = (true, None);
            }
            Presence::Absent if self.has_begun => {
                // One that fell silent has to say again that it is ready.
                self.ready = None;
                let since = *self.absent_since_ns.get_or_insert(now_ns);
                self.is_given_up = now_ns.saturating_sub(since) >= self.void_after_ns;
            }
            _ => {}
        }
        self.presence(episode, now_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    #[test]
    fn a_round_waits_for_its_person_and_is_paused_while_they_are_away() {
        let mut attendance = Attendance::new(20 * S);
        attendance.begin(0);
        assert_eq!(attendance.attend(100 * S), Presence::Absent);
        assert_eq!(
            attendance.attend(1000 * S),
            Presence::Absent,
            "nothing has begun"
        );
        assert_eq!(attendance.join(1, 1000 * S), None);
        attendance.get_ready(0);
        assert_eq!(attendance.attend(1001 * S), Presence::Present);
        attendance.go_away();
        assert_eq!(attendance.attend(1001 * S), Presence::Absent);
        attendance.get_ready(0);
        assert_eq!(attendance.attend(1001 * S), Presence::Present);
        attendance.begin(1);
        assert_eq!(
            attendance.attend(1001 * S),
            Presence::Absent,
            "another round"
        );
    }

    #[test]
    fn a_page_that_does_not_come_back_voids_the_round_once() {
        let mut attendance = Attendance::new(20 * S);
        attendance.begin(0);
        attendance.join(1, 0);
        attendance.get_ready(0);
        assert_eq!(attendance.attend(S), Presence::Present);
        assert!(attendance.leave(1));
        assert_eq!(attendance.attend(2 * S), Presence::Absent);
        assert_eq!(attendance.attend(21 * S), Presence::Absent);
        assert_eq!(attendance.attend(22 * S), Presence::GivenUp);
        attendance.join(2, 23 * S);
        attendance.get_ready(0);
        assert_eq!(attendance.attend(23 * S), Presence::GivenUp, "too late");
        attendance.begin(1);
        attendance.get_ready(1);
        assert_eq!(attendance.attend(23 * S), Presence::Present);
    }

    #[test]
    fn a_silent_page_is_as_one_that_is_closed() {
        let mut attendance = Attendance::new(20 * S);
        attendance.begin(0);
        attendance.join(1, 0);
        attendance.get_ready(0);
        assert_eq!(attendance.attend(S), Presence::Present);
        assert_eq!(attendance.attend(3 * S), Presence::Absent);
        attendance.hear(4 * S);
        assert_eq!(
            attendance.attend(4 * S),
            Presence::Absent,
            "not yet ready again"
        );
        attendance.get_ready(0);
        assert_eq!(attendance.attend(4 * S), Presence::Present);
    }

    #[test]
    fn the_page_that_was_opened_last_drives() {
        let mut attendance = Attendance::new(20 * S);
        attendance.begin(0);
        attendance.join(1, 0);
        attendance.get_ready(0);
        assert_eq!(attendance.join(2, 0), Some(1));
        assert!(attendance.is_driver(2) && !attendance.is_driver(1));
        assert_eq!(attendance.attend(0), Presence::Absent);
        assert!(!attendance.leave(1), "it did not drive any more");
        attendance.get_ready(0);
        assert_eq!(attendance.attend(0), Presence::Present);
    }
}
