//! What was seen of every step: the headers of its messages, and of the questions and answers of its plan.

use crate::graph::{GraphTopic, TOPICS};
use messages::{CommAction, DecisionReason, Header};
use std::collections::{BTreeMap, VecDeque};

/// On which of them a world lets itself be sensed.
const SENSED: [GraphTopic; 2] = [GraphTopic::Lidar, GraphTopic::Observation];

/// Steps kept at most; at 8,000 steps a second, half a minute.
pub const MOST_STEPS: usize = 200_000;
/// A message so many steps from all others of its episode does not belong to it.
const FARTHEST: u32 = 10_000;

/// The times in a message's header, in ns of the monotonic clock; all zeros where no message was seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SendMark {
    /// When it was sent.
    pub sent: u64,
    /// What its sender computed for it.
    pub compute: u64,
    /// When its newest cause was sensed.
    pub cause: u64,
}

impl SendMark {
    /// Of a header.
    pub fn of(header: &Header) -> Self {
        Self {
            sent: header.sent_ns,
            compute: header.compute_ns,
            cause: header.cause_ns,
        }
    }

    /// Whether there is one.
    pub fn is_seen(&self) -> bool {
        self.sent != 0
    }
}

/// What planner and human model said to each other for one plan, in order.
#[derive(Clone, Debug, Default)]
pub struct ImaginationMarks {
    /// The planner's questions: group, mark.
    pub questions: Vec<(u32, SendMark)>,
    /// The human model's answers: group, mark.
    pub answers: Vec<(u32, SendMark)>,
}

/// A step.
#[derive(Clone, Debug, Default)]
pub struct StepMarks {
    marks: [SendMark; TOPICS],
    /// Whether the decision *for* this step was planned, rather than sent by a planner that never says anything.
    pub planned: bool,
    /// The plan that started *from* this step.
    pub imagination: Option<Box<ImaginationMarks>>,
}

impl StepMarks {
    /// The step's message on a topic.
    pub fn mark(&self, topic: GraphTopic) -> Option<&SendMark> {
        Some(&self.marks[topic as usize]).filter(|mark| mark.is_seen())
    }

    /// What could be sensed: a frame, or a gridworld's observation.
    pub fn sensed(&self) -> Option<&SendMark> {
        SENSED.iter().find_map(|topic| self.mark(*topic))
    }

    /// On which topic that was.
    pub fn sensed_on(&self) -> Option<GraphTopic> {
        SENSED.into_iter().find(|topic| self.mark(*topic).is_some())
    }
}

struct EpisodeSteps {
    first: u32,
    steps: VecDeque<StepMarks>,
}

/// All steps, by episode and step.
#[derive(Default)]
pub struct StepTable {
    episodes: BTreeMap<u32, EpisodeSteps>,
    len: usize,
    /// Second messages of a step on a topic: in real time, a late decision is shown again.
    pub repeated: u64,
    /// Messages whose step was out of every order.
    pub unplaced: u64,
    /// What was imagined for all decisions.
    pub plans: PlanEffort,
}

/// What was imagined for decisions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlanEffort {
    /// Decisions that were planned.
    pub plans: u64,
    /// Futures that they rest on, summed.
    pub futures: u64,
    /// Candidates × futures imagined for them, summed.
    pub samples: u64,
}

impl StepTable {
    /// Steps of which something was seen.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Episodes of which something was seen.
    pub fn episodes(&self) -> usize {
        self.episodes.len()
    }

    /// Takes note of a message.
    pub fn add(&mut self, topic: GraphTopic, header: &Header) {
        let Some(step) = self.at(header) else { return };
        let mark = &mut step.marks[topic as usize];
        if mark.is_seen() {
            self.repeated += 1;
        } else {
            *mark = SendMark::of(header);
        }
    }

    /// Takes note of a decision.
    pub fn add_decision(&mut self, decision: &CommAction) {
        let planned = decision.reason() != Ok(DecisionReason::NoPlanner);
        self.add(GraphTopic::Decision, &decision.header);
        if let Some(step) = self.at(&decision.header) {
            step.planned = planned;
        }
        if decision.is_decided() {
            self.plans.plans += 1;
            self.plans.futures += u64::from(decision.futures);
            self.plans.samples += u64::from(decision.samples);
        }
    }

    /// Takes note of a question or an answer of imagination.
    pub fn add_imagination(&mut self, header: &Header, group: u32, is_answer: bool) {
        let Some(step) = self.at(header) else { return };
        let imagination = step.imagination.get_or_insert_default();
        let list = if is_answer {
            &mut imagination.answers
        } else {
            &mut imagination.questions
        };
        list.push((group, SendMark::of(header)));
    }

    /// The step of a header, made if it is new.
    fn at(&mut self, header: &Header) -> Option<&mut StepMarks> {
        let episode = self
            .episodes
            .entry(header.episode)
            .or_insert_with(|| EpisodeSteps {
                first: header.step,
                steps: VecDeque::new(),
            });
        let end = episode.first + episode.steps.len() as u32;
        if header.step > end.saturating_add(FARTHEST)
            || header.step.saturating_add(FARTHEST) < episode.first
        {
            self.unplaced += 1;
            return None;
        }
        while header.step < episode.first {
            episode.steps.push_front(StepMarks::default());
            episode.first -= 1;
            self.len += 1;
        }
        while header.step >= episode.first + episode.steps.len() as u32 {
            episode.steps.push_back(StepMarks::default());
            self.len += 1;
        }
        let place = (header.step - episode.first) as usize;
        episode.steps.get_mut(place)
    }

    /// A step.
    pub fn step(&self, episode: u32, step: u32) -> Option<&StepMarks> {
        let episode = self.episodes.get(&episode)?;
        let place = step.checked_sub(episode.first)?;
        episode.steps.get(place as usize)
    }

    /// The last step of an episode.
    pub fn last_step(&self, episode: u32) -> Option<u32> {
        let episode = self.episodes.get(&episode)?;
        (episode.first + episode.steps.len() as u32).checked_sub(1)
    }

    /// A message of a step.
    pub fn mark(&self, topic: GraphTopic, episode: u32, step: u32) -> Option<&SendMark> {
        self.step(episode, step)?.mark(topic)
    }

    /// What could be sensed at a step.
    pub fn sensed(&self, episode: u32, step: u32) -> Option<&SendMark> {
        self.step(episode, step)?.sensed()
    }

    /// All steps in order: episode, step, what was seen.
    pub fn iter(&self) -> impl Iterator<Item = (u32, u32, &StepMarks)> {
        self.episodes.iter().flat_map(|(number, episode)| {
            let first = episode.first;
            let steps = episode.steps.iter().enumerate();
            steps.map(move |(place, step)| (*number, first + place as u32, step))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(episode: u32, step: u32, sent_ns: u64) -> Header {
        Header {
            episode,
            step,
            sent_ns,
            ..Header::default()
        }
    }

    #[test]
    fn steps_are_found_whatever_the_order_in_which_topics_are_emptied() {
        let mut table = StepTable::default();
        table.add(GraphTopic::Lidar, &header(3, 10, 100));
        table.add(GraphTopic::Lidar, &header(4, 0, 300));
        table.add(GraphTopic::Action, &header(3, 9, 90));
        table.add(GraphTopic::Action, &header(3, 10, 110));
        table.add(GraphTopic::Action, &header(3, 10, 120));
        table.add(GraphTopic::Action, &header(3, 4_000_000_000, 130));
        assert_eq!((table.len(), table.episodes()), (3, 2));
        assert_eq!((table.repeated, table.unplaced), (1, 1));
        assert_eq!(table.mark(GraphTopic::Action, 3, 10).unwrap().sent, 110);
        assert_eq!(table.mark(GraphTopic::Action, 3, 9).unwrap().sent, 90);
        assert!(table.mark(GraphTopic::Lidar, 3, 9).is_none());
        assert!(table.mark(GraphTopic::Lidar, 3, 8).is_none());
        let order: Vec<_> = table
            .iter()
            .map(|(episode, step, _)| (episode, step))
            .collect();
        assert_eq!(order, [(3, 9), (3, 10), (4, 0)]);
    }
}
