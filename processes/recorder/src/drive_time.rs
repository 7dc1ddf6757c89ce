//! When a message happened in the drive: the wall clock at the drive's start, and from there on simulated time, a step
//! length per step, however fast or slow the machine was. Episodes follow one another.
//!
//! The world's messages say where the drive is. What others send belongs to the step that it names, as far as the world
//! has come. The step that ends an episode has an outcome but nothing to be sensed; the next episode begins a step
//! after it.

use crate::topics::{Recorded, TOPICS};
use messages::{Header, topic};
use runtime::now_ns;
use std::collections::VecDeque;
use std::time::{SystemTime, UNIX_EPOCH};

/// Topics of the world, whose steps are the drive's.
const WORLD: [&str; 5] = [
    topic::LIDAR,
    topic::OBSERVATION,
    topic::PICTURE,
    topic::SCENE,
    topic::OUTCOME,
];
/// Of these, what is sensed: the step that ends an episode has none.
const SENSED: [&str; 2] = [topic::LIDAR, topic::OBSERVATION];
/// A first message that was sent longer ago than this does not say when the drive began: its sender has another clock.
const TRUSTED_AGE_NS: u64 = 10_000_000_000;
/// Episodes that are remembered: more than the recorder's ports hold messages of.
const MOST_BEFORE: usize = 1024;
/// Step length where nobody said what it is.
const DEFAULT_STEP_NS: u64 = 1_000_000_000;

/// Whether a topic is one of the world's.
pub fn is_world(topic: &str) -> bool {
    WORLD.contains(&topic)
}

/// A place in a drive whose time is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Anchor {
    /// Episode.
    pub episode: u32,
    /// Step.
    pub step: u32,
    /// Nanoseconds since 1970.
    pub time_ns: u64,
}

/// Follows a drive's messages.
#[derive(Clone, Debug)]
pub struct DriveTime {
    step_ns: u64,
    /// None before the first message of the world.
    now: Option<EpisodeTimes>,
    /// Episodes before, the latest last: of what waits in the recorder's ports, the world's share is taken first.
    before: VecDeque<EpisodeTimes>,
}

#[derive(Clone, Copy, Debug)]
struct EpisodeTimes {
    number: u32,
    /// When its step 0 is, in nanoseconds since 1970.
    begin_ns: u64,
    /// The newest step of the world.
    step: u32,
    /// The newest step at which something was sensed.
    sensed: Option<u32>,
}

impl EpisodeTimes {
    fn time_ns(&self, step: u32, step_ns: u64) -> u64 {
        // Readers take times for signed numbers.
        (self.begin_ns)
            .saturating_add(u64::from(step).saturating_mul(step_ns))
            .min(i64::MAX as u64)
    }

    /// The step with the last outcome, for all that is known: whoever has sensed something acts, and sees what it led
    /// to.
    fn last_step(&self) -> u32 {
        let after_sensed = self.sensed.map_or(0, |step| step.saturating_add(1));
        self.step.max(after_sensed)
    }
}

impl DriveTime {
    /// Of a drive whose steps last `step_ns`; 0 for unknown, which counts as a second.
    pub fn new(step_ns: u64) -> Self {
        Self {
            step_ns: if step_ns == 0 {
                DEFAULT_STEP_NS
            } else {
                step_ns
            },
            now: None,
            before: VecDeque::new(),
        }
    }

    /// Begins with a step whose time is known, of an earlier part of the same recording.
    pub fn go_on_from(&mut self, anchor: Anchor) {
        let elapsed = u64::from(anchor.step).saturating_mul(self.step_ns);
        self.now = Some(EpisodeTimes {
            number: anchor.episode,
            begin_ns: anchor.time_ns.saturating_sub(elapsed),
            step: anchor.step,
            sensed: None,
        });
    }

    /// Begins at once, at a moment of the monotonic clock, where no message of the world has come and none is waited
    /// for.
    pub fn begin(&mut self, sent_ns: u64) {
        self.now.get_or_insert_with(|| EpisodeTimes {
            number: 0,
            begin_ns: wall_clock_ns(sent_ns),
            step: 0,
            sensed: None,
        });
    }

    /// When a message happened, in nanoseconds since 1970; none before the drive has begun.
    pub fn of(&mut self, message: &Recorded) -> Option<u64> {
        let topic = &TOPICS[message.topic()];
        let header = message.header();
        if is_world(topic.name) {
            self.follow(header, SENSED.contains(&topic.name));
        }
        let now = self.now?;
        let now_ns = now.time_ns(now.step, self.step_ns);
        if !topic.is_repeatable() {
            return Some(now_ns); // orders and reports are of no step
        }
        let limit_ns = now_ns.saturating_add(self.step_ns);
        let time_ns = match self.episode(header.episode) {
            Some(episode) => episode.time_ns(header.step, self.step_ns),
            None => now_ns,
        };
        // A decision is for the next step; nobody knows more of what is to come.
        Some(time_ns.min(limit_ns))
    }

    fn episode(&self, number: u32) -> Option<&EpisodeTimes> {
        let now = self.now.iter();
        let mut episodes = now.chain(self.before.iter().rev());
        // They are in order, so that most are found at once, and none is looked for in vain for long.
        let found = episodes.find(|episode| episode.number <= number);
        found.filter(|episode| episode.number == number)
    }

    fn follow(&mut self, header: &Header, is_sensed: bool) {
        let (number, step) = (header.episode, header.step);
        match &mut self.now {
            Some(now) if number < now.number => {} // last words of the episode before
            Some(now) if number == now.number => {
                now.step = now.step.max(step);
                if is_sensed {
                    now.sensed = now.sensed.max(Some(step));
                }
            }
            now => {
                let begin_ns = now.map_or_else(
                    || {
                        let elapsed = u64::from(step).saturating_mul(self.step_ns);
                        wall_clock_ns(header.sent_ns).saturating_sub(elapsed)
                    },
                    |before| {
                        let end = before.last_step().saturating_add(1);
                        before.time_ns(end, self.step_ns)
                    },
                );
                let before = now.replace(EpisodeTimes {
                    number,
                    begin_ns,
                    step,
                    sensed: is_sensed.then_some(step),
                });
                self.before.extend(before);
                if self.before.len() > MOST_BEFORE {
                    self.before.pop_front();
                }
            }
        }
    }
}

/// What the wall clock showed at a moment of the monotonic clock, in nanoseconds since 1970.
fn wall_clock_ns(sent_ns: u64) -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    let now = now.map_or(0, |since| since.as_nanos() as u64);
    let age = now_ns().checked_sub(sent_ns);
    now - age
        .filter(|age| *age <= TRUSTED_AGE_NS)
        .unwrap_or(0)
        .min(now)
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{CommAction, Display, LidarFrame, Message, Outcome, Report, Scene};

    const STEP_NS: u64 = 150_000_000;

    fn of<M: Message>(time: &mut DriveTime, episode: u32, step: u32) -> u64
    where
        for<'a> Recorded: From<&'a M>,
    {
        let mut message = M::ZERO;
        if let Some(header) = message.header_mut() {
            (header.episode, header.step, header.sent_ns) = (episode, step, now_ns());
        }
        time.of(&(&message).into()).expect("the drive has begun")
    }

    #[test]
    fn what_comes_before_the_drive_has_no_time() {
        let mut time = DriveTime::new(STEP_NS);
        assert_eq!(time.of(&(&Report::ZERO).into()), None);
        assert_eq!(time.of(&(&Display::ZERO).into()), None);
        let start = of::<LidarFrame>(&mut time, 0, 0);
        assert_eq!(of::<Report>(&mut time, 0, 0), start);
    }

    #[test]
    fn a_step_lasts_as_long_as_in_the_drive() {
        let mut time = DriveTime::new(STEP_NS);
        let before = wall_clock_ns(now_ns());
        let start = of::<LidarFrame>(&mut time, 0, 0);
        assert!((before..=wall_clock_ns(now_ns())).contains(&start));
        for step in 1..145 {
            let now = of::<LidarFrame>(&mut time, 0, step);
            assert_eq!(now, start + u64::from(step) * STEP_NS);
            assert_eq!(of::<Display>(&mut time, 0, step), now);
            assert_eq!(of::<CommAction>(&mut time, 0, step + 1), now + STEP_NS);
            assert_eq!(of::<Report>(&mut time, 0, 0), now);
        }
        // What is late stands where it belongs, and a step may be said twice.
        assert_eq!(of::<Display>(&mut time, 0, 100), start + 100 * STEP_NS);
        assert_eq!(of::<Display>(&mut time, 0, 100), start + 100 * STEP_NS);
        // Nobody but the world moves time on.
        let soon = start + 145 * STEP_NS;
        assert_eq!(of::<Display>(&mut time, 0, u32::MAX), soon);
        assert_eq!(of::<Display>(&mut time, 7, 3), start + 144 * STEP_NS);
    }

    #[test]
    fn episodes_follow_one_another() {
        for outcome_first in [true, false] {
            let mut time = DriveTime::new(STEP_NS);
            let start = of::<LidarFrame>(&mut time, 3, 0);
            of::<LidarFrame>(&mut time, 3, 9);
            let end = start + 10 * STEP_NS;
            if outcome_first {
                assert_eq!(of::<Scene>(&mut time, 3, 10), end);
                assert_eq!(of::<Outcome>(&mut time, 3, 10), end);
            }
            let next = of::<LidarFrame>(&mut time, 4, 0);
            assert_eq!(next, end + STEP_NS, "{outcome_first}");
            // The recorder empties one topic after the other.
            assert_eq!(of::<Outcome>(&mut time, 3, 10), end);
            assert_eq!(of::<Display>(&mut time, 3, 9), end - STEP_NS);
            assert_eq!(of::<LidarFrame>(&mut time, 4, 1), next + STEP_NS);
        }
    }

    /// The recorder empties one topic after the other: many episodes of one before the first of the next.
    #[test]
    fn many_short_episodes_are_told_apart() {
        let mut time = DriveTime::new(STEP_NS);
        let begins: Vec<u64> = (0..200)
            .map(|episode| {
                let begin = of::<LidarFrame>(&mut time, episode, 0);
                of::<LidarFrame>(&mut time, episode, 4);
                begin
            })
            .collect();
        for (episode, begin) in (0..).zip(&begins) {
            assert_eq!(*begin, begins[0] + u64::from(episode) * 6 * STEP_NS);
            assert_eq!(of::<Display>(&mut time, episode, 3), begin + 3 * STEP_NS);
            assert_eq!(of::<Outcome>(&mut time, episode, 5), begin + 5 * STEP_NS);
        }
    }

    #[test]
    fn another_part_goes_on_where_the_one_before_it_broke_off() {
        let mut time = DriveTime::new(STEP_NS);
        time.go_on_from(Anchor {
            episode: 2,
            step: 40,
            time_ns: 1_000 + 40 * STEP_NS,
        });
        assert_eq!(of::<Display>(&mut time, 2, 41), 1_000 + 41 * STEP_NS);
        assert_eq!(of::<LidarFrame>(&mut time, 2, 80), 1_000 + 80 * STEP_NS);
        assert_eq!(of::<LidarFrame>(&mut time, 3, 0), 1_000 + 82 * STEP_NS);
    }

    #[test]
    fn no_number_is_too_large() {
        let mut time = DriveTime::new(u64::MAX);
        for (episode, step) in [(0, 0), (0, u32::MAX), (u32::MAX, u32::MAX), (0, 1)] {
            let now = of::<LidarFrame>(&mut time, episode, step);
            assert!(now <= i64::MAX as u64);
        }
    }
}
