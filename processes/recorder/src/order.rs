//! Brings messages into the drive's order: the recorder empties one topic after the other, so that in what it hands
//! over, the frames of many steps come before the first display. A file whose times run backwards is slow to read for
//! everybody, and what is drawn from it would show one step's cars in another step's colours.
//!
//! A message is held until every topic has come past its time. A topic that is silent for too long is not waited for.
//! Whatever comes after that is written as of the time that the file has reached: within a file no time runs backwards.

use crate::topics::{PerTopic, Recorded, TOPICS};
use messages::topic;

/// Messages held at most, 45 MB: more than all of the recorder's ports hold, which it empties one after the other.
const MOST: usize = 16 << 10;
/// How long a message is held for topics that are silent, between two moments of sending …
const PATIENCE_NS: u64 = 500_000_000;
/// … and how many rounds through all topics: what waits in a port is not silent.
const PATIENCE_ROUNDS: u64 = 2;

/// Topics of which a world has one or the other pair.
const HIGHWAY: [&str; 2] = [topic::LIDAR, topic::SCENE];
const GRIDWORLD: [&str; 2] = [topic::OBSERVATION, topic::PICTURE];

/// What decides about a message that is held.
#[derive(Clone, Copy)]
struct Held {
    time_ns: u64,
    sent_ns: u64,
    round: u64,
    topic: usize,
    /// Where it lies.
    slot: usize,
}

/// Messages that wait for their place.
pub struct Order {
    held: Vec<Held>,
    /// The earliest of them.
    first: Option<Held>,
    slots: Vec<Recorded>,
    free: Vec<usize>,
    /// Time of each topic's newest message.
    newest: PerTopic,
    awaited: [bool; TOPICS.len()],
    /// Time of the newest message that was handed out.
    out_ns: u64,
    /// When the newest message was sent.
    sent_ns: u64,
    /// Rounds through the topics so far, and the topic at which this one is.
    round: u64,
    topic: usize,
}

impl Default for Order {
    fn default() -> Self {
        Self {
            held: Vec::new(),
            first: None,
            slots: Vec::new(),
            free: Vec::new(),
            newest: [0; TOPICS.len()],
            awaited: core::array::from_fn(|topic| TOPICS[topic].is_repeatable()),
            out_ns: 0,
            sent_ns: 0,
            round: 0,
            topic: 0,
        }
    }
}

impl Order {
    /// Holds a message of this time.
    pub fn push(&mut self, time_ns: u64, message: &Recorded) {
        let (topic, sent_ns) = (message.topic(), message.header().sent_ns);
        let time_ns = time_ns.max(self.newest[topic]).max(self.out_ns);
        self.newest[topic] = time_ns;
        self.awaited[topic] = TOPICS[topic].is_repeatable();
        self.await_one_world(topic);
        self.sent_ns = self.sent_ns.max(sent_ns);
        self.round += u64::from(topic < self.topic);
        self.topic = topic;
        let slot = match self.free.pop() {
            Some(slot) => {
                self.slots[slot] = *message;
                slot
            }
            None => {
                self.slots.push(*message);
                self.slots.len() - 1
            }
        };
        let held = Held {
            time_ns,
            sent_ns,
            round: self.round,
            topic,
            slot,
        };
        if self.first.is_none_or(|first| time_ns < first.time_ns) {
            self.first = Some(held);
        }
        self.held.push(held);
    }

    /// Where one world's topics are heard, the other's are not waited for.
    fn await_one_world(&mut self, topic: usize) {
        let other = match TOPICS[topic].name {
            name if HIGHWAY.contains(&name) => GRIDWORLD,
            name if GRIDWORLD.contains(&name) => HIGHWAY,
            _ => return,
        };
        for (topic, known) in TOPICS.iter().enumerate() {
            if other.contains(&known.name) {
                self.awaited[topic] &= self.newest[topic] > 0;
            }
        }
    }

    /// Messages held.
    pub fn len(&self) -> usize {
        self.held.len()
    }

    /// Whether none is held.
    pub fn is_empty(&self) -> bool {
        self.held.is_empty()
    }

    /// Hands out, in order, what need not be held any longer.
    ///
    /// # Errors
    /// The first of `take`'s; what was not taken by then is forgotten.
    pub fn release<E>(
        &mut self,
        take: impl FnMut(u64, &Recorded) -> Result<(), E>,
    ) -> Result<(), E> {
        let Some(first) = self.first else {
            return Ok(());
        };
        let mut limit_ns = self.limit_ns();
        while first.time_ns >= limit_ns {
            if self.held.len() < MOST && !self.is_overdue(&first) {
                return Ok(());
            }
            for (topic, awaited) in self.awaited.iter_mut().enumerate() {
                *awaited &= self.newest[topic] > limit_ns;
            }
            limit_ns = self.limit_ns();
        }
        self.release_before(limit_ns, take)
    }

    /// Hands out, in order, all that is held.
    ///
    /// # Errors
    /// As [`Self::release`].
    pub fn release_all<E>(
        &mut self,
        take: impl FnMut(u64, &Recorded) -> Result<(), E>,
    ) -> Result<(), E> {
        self.release_before(u64::MAX, take)
    }

    fn is_overdue(&self, held: &Held) -> bool {
        self.sent_ns.saturating_sub(held.sent_ns) >= PATIENCE_NS
            && self.round - held.round >= PATIENCE_ROUNDS
    }

    /// The time up to which all topics have come.
    fn limit_ns(&self) -> u64 {
        let awaited = self.newest.iter().zip(self.awaited);
        let awaited = awaited.filter_map(|(newest, awaited)| awaited.then_some(*newest));
        awaited.min().unwrap_or(u64::MAX)
    }

    fn release_before<E>(
        &mut self,
        limit_ns: u64,
        mut take: impl FnMut(u64, &Recorded) -> Result<(), E>,
    ) -> Result<(), E> {
        // Stable: messages of one topic stay in the order in which they came.
        self.held.sort_by_key(|held| (held.time_ns, held.topic));
        let released = self.held.partition_point(|held| held.time_ns < limit_ns);
        let mut result = Ok(());
        for held in self.held.drain(..released) {
            self.free.push(held.slot);
            if result.is_ok() {
                self.out_ns = self.out_ns.max(held.time_ns);
                result = take(held.time_ns, &self.slots[held.slot]);
            }
        }
        self.first = self.held.first().copied();
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{
        CommAction, Display, DriverAction, HumanBelief, LidarFrame, Message, Outcome, Report,
        RobotBelief, Scene,
    };

    fn message<M: Message>(step: u32) -> Recorded
    where
        for<'a> Recorded: From<&'a M>,
    {
        let mut message = M::ZERO;
        if let Some(header) = message.header_mut() {
            header.step = step;
            header.sent_ns = u64::from(step) * 1_000;
        }
        (&message).into()
    }

    fn push<M: Message>(order: &mut Order, steps: core::ops::Range<u32>)
    where
        for<'a> Recorded: From<&'a M>,
    {
        for step in steps {
            order.push(u64::from(step) + 1, &message::<M>(step));
        }
    }

    /// What is released: time and topic.
    fn released(order: &mut Order) -> Vec<(u64, &'static str)> {
        let mut out = Vec::new();
        let result = order.release(|time_ns, message| {
            out.push((time_ns, TOPICS[message.topic()].name));
            Ok::<_, ()>(())
        });
        result.expect("nothing fails");
        out
    }

    #[test]
    fn topics_that_come_one_after_the_other_are_interleaved() {
        let mut order = Order::default();
        push::<LidarFrame>(&mut order, 0..9);
        assert_eq!(released(&mut order), []);
        push::<Scene>(&mut order, 0..9);
        push::<Outcome>(&mut order, 1..9);
        push::<RobotBelief>(&mut order, 0..9);
        push::<HumanBelief>(&mut order, 0..9);
        push::<CommAction>(&mut order, 1..10);
        push::<Display>(&mut order, 0..5);
        push::<Report>(&mut order, 8..9);
        assert_eq!(released(&mut order), []);
        push::<DriverAction>(&mut order, 0..9);
        let out = released(&mut order);
        // The display has come to step 4, whose time is 5.
        assert_eq!(out.len(), 4 * 8 - 2);
        assert!(out.is_sorted_by_key(|(time_ns, _)| *time_ns));
        assert_eq!(out[0], (1, topic::LIDAR));
        assert_eq!(out.last(), Some(&(4, topic::DRIVER_ACTION)));
        push::<Display>(&mut order, 5..9);
        assert_eq!(released(&mut order).len(), 4 * 8);
        let mut rest = 0;
        let result = order.release_all(|_, _| {
            rest += 1;
            Ok::<_, ()>(())
        });
        result.expect("nothing fails");
        assert_eq!((rest, order.len()), (8 + 2, 0));
    }

    #[test]
    fn a_topic_that_stays_silent_is_not_waited_for_for_ever() {
        let mut order = Order::default();
        let steps = PATIENCE_NS as u32 / 1_000;
        push::<LidarFrame>(&mut order, 0..2);
        push::<DriverAction>(&mut order, 0..2);
        assert_eq!(released(&mut order), []);
        push::<LidarFrame>(&mut order, steps + 1..steps + 2);
        push::<DriverAction>(&mut order, steps + 1..steps + 2);
        // What comes of the others may have been in their ports all the while.
        assert_eq!(released(&mut order), []);
        push::<LidarFrame>(&mut order, steps + 2..steps + 3);
        assert_eq!(released(&mut order).len(), 4);
        // It comes back: what is of old steps stands where the file is.
        push::<Display>(&mut order, 0..2);
        push::<Display>(&mut order, steps + 1..steps + 3);
        push::<DriverAction>(&mut order, steps + 2..steps + 3);
        let out = released(&mut order);
        assert_eq!(out[..2], [(2, topic::DISPLAY), (2, topic::DISPLAY)]);
        assert_eq!(out.len(), 5);
    }

    /// A recorder that got no time for ten seconds finds a thousand messages on every topic.
    #[test]
    fn a_recorder_that_was_kept_waiting_loses_no_times() {
        const STEP_NS: u64 = 10_000_000;
        let mut order = Order::default();
        let mut out = Vec::new();
        let mut look = |order: &mut Order| {
            let result = order.release(|time_ns, message| {
                assert_eq!(time_ns, u64::from(message.header().step) + 1);
                out.push(time_ns);
                Ok::<_, ()>(())
            });
            result.expect("nothing fails");
        };
        for round in 0..2 {
            for topic in 0..TOPICS.len() {
                if [topic::OBSERVATION, topic::PICTURE].contains(&TOPICS[topic].name)
                    || !TOPICS[topic].is_repeatable()
                {
                    continue;
                }
                for step in round * 1000..(round + 1) * 1000 {
                    let bytes = vec![0; TOPICS[topic].size];
                    let mut message = Recorded::from_bytes(topic, &bytes).expect("its size");
                    message.header_mut().step = step;
                    message.header_mut().sent_ns = u64::from(step) * STEP_NS;
                    order.push(u64::from(step) + 1, &message);
                    look(&mut order);
                }
            }
        }
        assert!(out.len() > 1000 * 8, "{}", out.len());
        assert!(out.is_sorted());
    }

    #[test]
    fn no_more_is_held_than_there_is_room_for() {
        let mut order = Order::default();
        push::<LidarFrame>(&mut order, 0..MOST as u32 - 1);
        assert_eq!(released(&mut order), []);
        push::<LidarFrame>(&mut order, MOST as u32..MOST as u32 + 1);
        assert_eq!(released(&mut order).len(), MOST - 1);
    }

    /// Within a topic, nothing changes places: sequence numbers tell losses.
    #[test]
    fn a_topic_that_runs_backwards_keeps_its_order_and_loses_its_time() {
        let mut order = Order::default();
        for step in [5, 6, 0, 1, 7] {
            order.push(u64::from(step), &message::<LidarFrame>(step));
        }
        let mut out = Vec::new();
        let result = order.release_all(|time_ns, message| {
            out.push((time_ns, message.header().step));
            Ok::<_, ()>(())
        });
        result.expect("nothing fails");
        assert_eq!(out, [(5, 5), (6, 6), (6, 0), (6, 1), (7, 7)]);
    }
}
