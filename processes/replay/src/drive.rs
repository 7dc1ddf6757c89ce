//! A recorded drive, step by step: what was sensed, shown and done, and what was believed and decided then.

use messages::{
    CommAction, Display, DriverAction, EpisodeEnd, Header, HumanBelief, LidarFrame, Message,
    Observation, Outcome, RobotBelief, topic,
};
use recorder::parts::{parts_of, read_parts};
use recorder::read::{Ending, Found, ReadError, run_of};
use recorder::topics::{PerTopic, Recorded, TOPICS};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Topics that a recording must have for a replay.
const NEEDED: [&str; 5] = [
    topic::DISPLAY,
    topic::DRIVER_ACTION,
    topic::ROBOT_BELIEF,
    topic::HUMAN_BELIEF,
    topic::COMM_ACTION,
];

/// Of these, one.
const SENSED: [&str; 2] = [topic::LIDAR, topic::OBSERVATION];

/// Topics of the processes that a replay asks again.
const ASKED: [&str; 3] = [topic::ROBOT_BELIEF, topic::HUMAN_BELIEF, topic::COMM_ACTION];

/// Most episodes in a row that are listed as missing.
const MOST_ABSENT: usize = 1000;

/// Why a drive cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// No message of ours is in it.
    #[error("{}: holds no message of a run ({ending})", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// How the file ends.
        ending: Ending,
    },
    /// It was not recorded from a whole set, or breaks off before all topics had a message.
    #[error("{}: no message on {topics} ({ending})", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The topics.
        topics: String,
        /// How the file ends.
        ending: Ending,
    },
    /// Messages of all topics are there, but no step has what is needed.
    #[error("{}: no step has what was sensed and a display ({ending})", path.display())]
    NoStep {
        /// The file.
        path: PathBuf,
        /// How the file ends.
        ending: Ending,
    },
}

/// What comparing needs of a message that it has no other use for: all its bytes but the header's.
pub type Digest = [u8; 32];

/// BLAKE3 of a message without its header, which holds what differs between equal runs: run identity, sequence number,
/// times and compute time.
pub fn digest_of<M: Message>(message: &M) -> Digest {
    // `message!` puts the header first.
    *blake3::hash(&message.bytes()[size_of::<Header>()..]).as_bytes()
}

/// What the human model said about a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HumanSaid {
    /// Its message.
    pub digest: Digest,
    /// Log-likelihood of the action before this step.
    pub log_likelihood: f32,
}

impl From<&HumanBelief> for HumanSaid {
    fn from(belief: &HumanBelief) -> Self {
        Self {
            digest: digest_of(belief),
            log_likelihood: belief.log_likelihood,
        }
    }
}

/// What was sensed at a step.
#[derive(Clone, Debug, PartialEq)]
pub enum Seen {
    /// On the highway.
    Lidar(Box<LidarFrame>),
    /// In a gridworld.
    Grid(Box<Observation>),
}

/// A recorded step; whatever is missing in the recording is missing here.
#[derive(Clone, Debug, Default)]
pub struct RecordedStep {
    /// What was sensed.
    pub seen: Option<Seen>,
    /// What the step before led to.
    pub outcome: Option<Outcome>,
    /// What was shown and said. In real time a step may be shown twice, when its decision comes late: the last display
    /// counts, with the words of the one that had words.
    pub display: Option<Box<Display>>,
    /// What the person did.
    pub action: Option<DriverAction>,
    /// What the robot believed.
    pub robot: Option<Digest>,
    /// What the human model said.
    pub human: Option<HumanSaid>,
    /// What was decided for this step, one step before.
    pub decision: Option<CommAction>,
}

impl RecordedStep {
    /// Whether the step can be replayed; a missing action is filled in.
    pub fn is_whole(&self) -> bool {
        self.seen.is_some() && self.display.is_some()
    }

    /// Whether anything was sensed, shown or done: a decision comes before its step does.
    fn has_begun(&self) -> bool {
        self.seen.is_some() || self.display.is_some() || self.action.is_some()
    }

    fn is_empty(&self) -> bool {
        self.seen.is_none()
            && self.outcome.is_none()
            && self.display.is_none()
            && self.action.is_none()
            && self.robot.is_none()
            && self.human.is_none()
            && self.decision.is_none()
    }

    fn show(&mut self, display: &Display) {
        let mut display = *display;
        if let Some(before) = &self.display
            && display.utterance_count == 0
        {
            display.utterances = before.utterances;
            display.utterance_count = before.utterance_count;
        }
        self.display = Some(Box::new(display));
    }
}

/// One file of a recording, as it was found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// The file.
    pub file: PathBuf,
    /// Messages read from it, all topics together.
    pub messages: u64,
    /// Where and why it breaks off, if it does.
    pub cut: Option<String>,
    /// What in it is damaged and was passed over: where and why.
    pub damage: Vec<String>,
    /// Messages that it says it has, and that are not in it any more.
    pub gone: u64,
    /// Whether it has all that was sent, as far as it can tell.
    pub complete: bool,
    /// Messages lost before they reached it, as it says itself; a part that was cut cannot say.
    pub counted_lost: Option<u64>,
}

/// Steps that a recording should have and has not, or not with all that a replay needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct MissingSteps {
    /// The episode.
    pub episode: u32,
    /// The first.
    pub from: u32,
    /// The last; none for the episode's last, whichever that was.
    pub to: Option<u32>,
}

impl core::fmt::Display for MissingSteps {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { episode, from, to } = self;
        match to {
            None if *from == 0 => write!(f, "all of episode {episode}"),
            None => write!(f, "episode {episode} from step {from} on"),
            Some(to) if to == from => write!(f, "episode {episode} step {from}"),
            Some(to) => write!(f, "episode {episode} steps {from} to {to}"),
        }
    }
}

/// A recorded drive.
#[derive(Clone, Debug, Default)]
pub struct Drive {
    /// By episode and step.
    pub steps: BTreeMap<(u32, u32), RecordedStep>,
    /// The files that it was read from.
    pub parts: Vec<Part>,
    /// What stood at the first part's head and end.
    pub found: Found,
    /// Messages missing inside the recording, by topic: gaps in the sequence numbers.
    pub gaps: BTreeMap<&'static str, u64>,
    /// Places at which another process took over from the one that had spoken on a topic: swapped, or started again. It
    /// may have begun with another belief than one that had been there all the time.
    pub successions: Vec<(&'static str, (u32, u32))>,
}

impl Drive {
    /// Reads a recording with all its parts.
    ///
    /// # Errors
    /// [`DriveError`] with the file's name and the place in it. A recording that breaks off, or has gaps, is no error.
    pub fn read(path: &Path) -> Result<Self, DriveError> {
        let mut reading = Reading::default();
        let mut parts = run_of(path).map_or_else(Vec::new, |run_id| parts_of(path, run_id));
        if parts.is_empty() {
            parts.push(path.to_owned());
        }
        let found = read_parts(&parts, |message| reading.take(message))?;
        for (part, found) in parts.iter().zip(&found) {
            reading.drive.parts.push(Part {
                file: part.clone(),
                messages: found.messages.iter().sum(),
                cut: match &found.ending {
                    Ending::Closed => None,
                    cut => Some(cut.to_string()),
                },
                damage: found.damage.iter().map(ToString::to_string).collect(),
                gone: found.gone(),
                complete: found.is_complete(),
                counted_lost: found.counted_lost(),
            });
        }
        reading.drive.found = found.into_iter().next().unwrap_or_default();
        reading.finish(path)
    }
}

impl Drive {
    /// Whether the recording has all that was sent, as far as it can tell. Of another, a replay shows nothing about the
    /// drive as a whole.
    pub fn is_complete(&self) -> bool {
        self.gaps.is_empty() && self.parts.iter().all(|part| part.complete)
    }

    /// Which steps are missing in an incomplete recording, in order. Messages may be missing in others.
    pub fn missing_steps(&self) -> Vec<MissingSteps> {
        let mut missing = Vec::new();
        let episodes: BTreeSet<u32> = self.steps.keys().map(|(episode, _)| *episode).collect();
        let last = episodes.last().copied();
        let mut all = |episode, from, to| missing.push(MissingSteps { episode, from, to });
        let mut expected = 0;
        for &episode in &episodes {
            // Of a run that went mad there may be billions.
            for absent in (expected..episode).take(MOST_ABSENT) {
                all(absent, 0, None);
            }
            expected = episode.saturating_add(1);
            let steps = || self.steps.range((episode, 0)..=(episode, u32::MAX));
            let ended = steps().find(|(_, step)| {
                step.outcome
                    .is_some_and(|o| o.end() != Ok(EpisodeEnd::Running))
            });
            let begun = steps().rev().find(|(_, step)| step.has_begun());
            let next = begun.map_or(0, |((_, step), _)| step.saturating_add(1));
            let end = ended.map_or(next, |((_, step), _)| *step);
            let mut from = 0;
            for ((_, step), _) in steps().filter(|(_, step)| step.is_whole()) {
                if from < *step {
                    all(episode, from, Some(step - 1));
                }
                from = step.saturating_add(1);
            }
            let is_cut = ended.is_none() && (Some(episode) != last || self.is_cut_at_the_end());
            match (from < end, is_cut) {
                (_, true) => all(episode, from, None),
                (true, false) => all(episode, from, Some(end - 1)),
                (false, false) => {}
            }
        }
        missing
    }

    /// Whether the last of the run may be missing.
    fn is_cut_at_the_end(&self) -> bool {
        self.parts
            .last()
            .is_some_and(|part| part.cut.is_some() || !part.damage.is_empty() || part.gone > 0)
    }
}

/// A drive being read.
#[derive(Default)]
struct Reading {
    drive: Drive,
    received: PerTopic,
    /// Sequence number expected next.
    next: PerTopic,
}

impl Reading {
    fn take(&mut self, message: &Recorded) {
        let (topic, header) = (message.topic(), message.header());
        if TOPICS[topic].is_repeatable() {
            let name = TOPICS[topic].name;
            if header.sequence < self.next[topic] && ASKED.contains(&name) {
                let at = (header.episode, header.step);
                self.drive.successions.push((name, at));
            }
            // A sender that took another's place counts from 0 again.
            let lost = header.sequence.saturating_sub(self.next[topic]);
            let gap = self.drive.gaps.entry(name).or_default();
            *gap = gap.saturating_add(lost);
            self.next[topic] = header.sequence.saturating_add(1);
        }
        self.received[topic] += 1;
        self.keep(message);
    }

    fn keep(&mut self, message: &Recorded) {
        let header = message.header();
        if header.step == u32::MAX {
            return; // no run comes that far, and the step after it has no number
        }
        let at = (header.episode, header.step);
        let step = self.drive.steps.entry(at).or_default();
        match message {
            Recorded::LidarFrame(frame) => step.seen = Some(Seen::Lidar(Box::new(*frame))),
            Recorded::Observation(seen) => step.seen = Some(Seen::Grid(Box::new(*seen))),
            Recorded::Outcome(outcome) => step.outcome = Some(*outcome),
            Recorded::Display(display) => step.show(display),
            Recorded::DriverAction(action) => step.action = Some(*action),
            Recorded::RobotBelief(belief) => step.robot = Some(digest_of::<RobotBelief>(belief)),
            Recorded::HumanBelief(belief) => {
                step.human = Some(belief.into());
            }
            Recorded::CommAction(decision) => step.decision = Some(*decision),
            // These are no part of a step, and must not begin one.
            Recorded::Picture(_)
            | Recorded::Scene(_)
            | Recorded::Cockpit(_)
            | Recorded::Control(_)
            | Recorded::Report(_) => {
                if step.is_empty() {
                    self.drive.steps.remove(&at);
                }
            }
        }
    }

    fn finish(mut self, path: &Path) -> Result<Drive, DriveError> {
        self.drive.gaps.retain(|_, lost| *lost > 0);
        let path = path.to_owned();
        let ending = self.drive.found.ending.clone();
        if self.received.iter().sum::<u64>() == 0 {
            return Err(DriveError::Empty { path, ending });
        }
        let is_missing = |name: &&str| {
            let mut topics = TOPICS.iter().zip(self.received);
            topics.any(|(topic, count)| topic.name == *name && count == 0)
        };
        let missing = NEEDED.iter().filter(|name| is_missing(name));
        let mut missing: Vec<_> = missing.map(|name| format!("/{name}")).collect();
        if SENSED.iter().all(is_missing) {
            missing.insert(0, format!("/{}", SENSED.join(" or /")));
        }
        if !missing.is_empty() {
            let topics = missing.join(", ");
            return Err(DriveError::Missing {
                path,
                topics,
                ending,
            });
        }
        if !self.drive.steps.values().any(RecordedStep::is_whole) {
            return Err(DriveError::NoStep { path, ending });
        }
        Ok(self.drive)
    }
}
