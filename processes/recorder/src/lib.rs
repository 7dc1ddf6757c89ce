//! The recorder: writes every message of a run to an MCAP file that Foxglove, PlotJuggler and rosbag tools open, and
//! computes the run's digest whether or not there is a file.
//!
//! A recorder that is killed leaves a file that is sound up to its last chunk. One that takes its place in the same run
//! goes on in the next part ([`parts`]) and counts what was sent in between as lost.

pub mod body;
pub mod cdr;
pub mod drive_time;
mod format;
mod found;
mod frames;
mod head;
mod highway_picture;
pub mod order;
mod outcome;
pub mod parts;
mod picture;
mod progress;
pub mod qos;
pub mod queue;
pub mod read;
pub mod recording;
pub mod result;
pub mod ros;
mod schema;
pub mod setup;
pub mod text;
pub mod topics;
pub mod visual;

use anyhow::{Context, Result};
use progress::Teller;
use queue::{BLOCKS, Queue, WhenFull};
use recording::{About, Lost, Recording};
use result::RecorderResult;
use runtime::{ClockMode, Digest, Node, RECORDER_BUFFER, RunArguments, Wake, now_ns, run_process};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Duration;
use topics::{Inputs, PerTopic, Recorded, TOPICS};
use visual::RoadLine;

/// How often the ports are emptied. Their buffers hold a thousand messages each.
const LOOK_NS: u64 = 2_000_000;
/// After the word to stop, the recorder stays until nothing has come for this many looks …
const QUIET_LOOKS: u32 = 10;
/// … but no longer than this many.
const LAST_LOOKS: u32 = 150;

/// What to record, and of what.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecorderOptions {
    /// The recording; without it, messages are counted and digested only.
    pub record: Option<PathBuf>,
    /// Where to write a [`RecorderResult`] at the end.
    pub result: Option<PathBuf>,
    /// For the recording's metadata.
    pub about: About,
    /// For the recording's picture of the road.
    pub road: Vec<RoadLine>,
    /// For tests of a slow disk: how long the writer sleeps after every chunk, in milliseconds.
    pub stall_ms_per_chunk: u64,
    /// For the same tests: messages that the queue to the writer holds; 0 for [`BLOCKS`].
    pub queue_blocks: usize,
}

/// Joins the run and records until it ends.
///
/// # Errors
/// When the file cannot be created, the run cannot be joined or a port fails; the launcher is told.
pub fn run(arguments: &RunArguments, options: &RecorderOptions) -> Result<()> {
    run_process(arguments, |node| {
        let mut recorder = Recorder::new(node, options)?;
        recorder.record(node)?;
        recorder.finish(node, options)
    })
}

struct Recorder {
    inputs: Inputs,
    taken: Taken,
    progress: Teller,
    /// This recorder's file, and those of recorders before it.
    file: Option<PathBuf>,
    before: Vec<PathBuf>,
}

/// What has been done with the messages so far.
struct Taken {
    queue: Option<Queue>,
    digest: Digest,
    received: PerTopic,
    /// Each topic's first message.
    first: [Option<MessageMark>; TOPICS.len()],
    has_complained: bool,
}

/// A topic's message: its sequence number, when it was sent, and whether what was sent before it was counted as lost by
/// the port that received it.
#[derive(Clone, Copy)]
struct MessageMark {
    sequence: u64,
    sent_ns: u64,
    counted: bool,
}

/// What the files of a run's recorders hold together.
#[derive(Default)]
struct Together {
    written: PerTopic,
    last: [Option<MessageMark>; TOPICS.len()],
    /// Messages that none of them holds, by the sequence numbers of those around.
    missing: PerTopic,
    /// Each topic's last sender but one and its last, by the sequence number that is next.
    senders: [[u64; 2]; TOPICS.len()],
    digest: Digest,
}

impl Together {
    /// None if one of them cannot be read.
    fn read(parts: &[PathBuf]) -> Option<Self> {
        let mut together = Self::default();
        let read = parts::read_parts(parts, |message| {
            let topic = message.topic();
            together.written[topic] += 1;
            let header = message.header();
            together.count(topic, header.sequence);
            together.last[topic] = Some(MessageMark {
                sequence: header.sequence,
                sent_ns: header.sent_ns,
                counted: true,
            });
            if TOPICS[topic].is_repeatable() {
                message.digest(&mut together.digest);
            }
        });
        read.ok().map(|_| together)
    }

    /// Counts what is missing before a message. A sender that takes another's place counts from 0 again; the last words
    /// of the one may stand after the first of the other.
    fn count(&mut self, topic: usize, sequence: u64) {
        let [before, now] = &mut self.senders[topic];
        if sequence == *before && sequence > 0 {
            *before += 1;
        } else if sequence >= *now {
            self.missing[topic] += sequence - *now;
            *now = sequence + 1;
        } else {
            self.missing[topic] += sequence;
            (*before, *now) = (*now, sequence + 1);
        }
    }

    /// Messages between the last of these and the first that another recorder received, by topic.
    fn lost_before(&self, first: &[Option<MessageMark>; TOPICS.len()]) -> PerTopic {
        core::array::from_fn(|topic| match (self.last[topic], first[topic]) {
            // On these, every process counts for itself.
            _ if !TOPICS[topic].is_repeatable() => 0,
            (Some(last), Some(first)) if first.sent_ns <= last.sent_ns => 0,
            (Some(last), Some(first)) if first.sequence > last.sequence => {
                first.sequence - last.sequence - 1
            }
            // A sender that took another's place counts from 0 again.
            (_, Some(first)) if !first.counted => first.sequence,
            _ => 0,
        })
    }
}

impl Recorder {
    fn new(node: &Node, options: &RecorderOptions) -> Result<Self> {
        let when_full = match node.arguments().clock {
            ClockMode::Lockstep => WhenFull::Grow,
            ClockMode::RealTime => WhenFull::Drop,
        };
        let (mut queue, mut file, mut before) = (None, None, Vec::new());
        if let Some(path) = &options.record {
            before = parts::parts_of(path, options.about.run_id);
            let part = parts::part_path(path, before.len() + 1);
            queue = Some(start_writer(&part, &before, when_full, options)?);
            file = Some(part);
        }
        let taken = Taken {
            queue,
            digest: Digest::new(),
            received: [0; TOPICS.len()],
            first: [None; TOPICS.len()],
            has_complained: false,
        };
        Ok(Self {
            inputs: Inputs::new(node)?,
            taken,
            progress: Teller::new(node)?,
            file,
            before,
        })
    }

    fn record(&mut self, node: &mut Node) -> Result<()> {
        let mut wake = node.ready()?;
        while wake != Wake::Stop {
            // Where the disk falls behind, a lockstep world waits: meanwhile, what it sent stays in the ports.
            let looked = match self.taken.has_room() {
                true => self.look()?,
                false => self
                    .inputs
                    .drain_run(|message, lost| self.taken.take(message, lost))?,
            };
            if looked > 0 {
                self.progress.tell()?;
                self.taken.complain_once(node)?;
                node.end_step();
            }
            wake = node.wait(&mut [], Some(now_ns() + LOOK_NS))?;
        }
        // Those who were told to stop at the same time may still be saying their last words.
        let mut quiet = 0;
        for _ in 0..LAST_LOOKS {
            quiet = if self.look()? > 0 { 0 } else { quiet + 1 };
            if quiet == QUIET_LOOKS {
                break;
            }
            std::thread::sleep(Duration::from_nanos(LOOK_NS));
        }
        Ok(())
    }

    fn look(&mut self) -> Result<u64> {
        let (taken, progress) = (&mut self.taken, &mut self.progress);
        Ok(self.inputs.drain(|message, lost| {
            progress.note(message);
            taken.take(message, lost);
        })?)
    }

    fn finish(self, node: &mut Node, options: &RecorderOptions) -> Result<()> {
        let Self {
            inputs,
            taken,
            file,
            before,
            ..
        } = self;
        let mut lost = Lost {
            ports: inputs.lost(),
            ..Lost::default()
        };
        let earlier = match before.is_empty() {
            true => Some(Together::default()),
            false => Together::read(&before),
        };
        // Without a file, what an earlier recorder heard is gone, and nobody asked to keep it.
        let joined_late = node.arguments().standby && file.is_none();
        if let Some(earlier) = earlier.as_ref().filter(|_| !joined_late) {
            lost.restart = earlier.lost_before(&taken.first);
            // Those that were killed could not say what they had lost, nor what was sent between two of them.
            for (topic, lost) in lost.restart.iter_mut().enumerate() {
                if TOPICS[topic].is_repeatable() {
                    *lost += earlier.missing[topic];
                }
            }
            // A port that was there before the start counts all that was sent before its first message as lost; what
            // an earlier recorder has of it is not, and what it has not is counted above.
            for (topic, first) in taken.first.iter().enumerate() {
                if let Some(first) = first.filter(|first| first.counted && !before.is_empty()) {
                    lost.ports[topic] = lost.ports[topic].saturating_sub(first.sequence);
                }
            }
        }
        let written = taken
            .queue
            .map(|queue| queue.finish(&lost.ports, &lost.restart));
        let mut digest = Some(taken.digest);
        let mut result = RecorderResult::new(
            &taken.received,
            &lost,
            file.as_deref().zip(written.as_ref()),
        );
        if !before.is_empty() {
            let parts: Vec<_> = before.iter().chain(&file).cloned().collect();
            let together = Together::read(&parts);
            result.join(&parts, together.as_ref().map(|together| &together.written));
            // All was received, but not by this process: the files hold it together.
            digest = together.map(|together| together.digest);
        }
        let digest = digest.filter(|_| lost.total() == 0 && !joined_late);
        result.digest = digest.as_ref().map(Digest::hex).unwrap_or_default();
        node.set_digest(digest.map_or([0; 32], |digest| digest.finish()));
        if let Some(path) = &options.result {
            result.save(path).context("recorder's result")?;
        }
        if !result.complete {
            let lost: u64 = result.topics.values().map(result::TopicResult::lost).sum();
            let reason = result
                .error
                .unwrap_or_else(|| "messages were lost".to_owned());
            node.say(&format!(
                "recording incomplete, {lost} messages missing: {reason}"
            ))?;
        }
        Ok(())
    }
}

fn start_writer(
    part: &Path,
    before: &[PathBuf],
    when_full: WhenFull,
    options: &RecorderOptions,
) -> Result<Queue> {
    // Another run's file of that name stays, under another; `mirror up` has seen to the first part's.
    let _of_another_run = files::set_aside(part)?;
    let mut recording = Recording::create(part, &options.about, &options.road)?;
    if let Some(anchor) = before.iter().rev().find_map(|part| read::end_of(part)) {
        recording.go_on_from(anchor);
    }
    recording.stall(Duration::from_millis(options.stall_ms_per_chunk));
    let blocks = match options.queue_blocks {
        0 => BLOCKS,
        blocks => blocks,
    };
    Queue::start(recording, when_full, blocks).context("starting the writer thread")
}

impl Taken {
    /// `lost`: messages that the topic's port has lost so far, those before its first message included if it was there
    /// when the run began.
    fn take(&mut self, message: &Recorded, lost: u64) {
        let topic = message.topic();
        self.received[topic] += 1;
        let header = message.header();
        self.first[topic].get_or_insert(MessageMark {
            sequence: header.sequence,
            sent_ns: header.sent_ns,
            counted: lost >= header.sequence,
        });
        if TOPICS[topic].is_repeatable() {
            message.digest(&mut self.digest);
        }
        if let Some(queue) = &mut self.queue {
            queue.push(message);
        }
    }

    /// Whether all that the ports may hold finds room without waiting for the disk; always in real time, where what
    /// finds none is dropped and counted.
    fn has_room(&self) -> bool {
        let most = TOPICS.len() * RECORDER_BUFFER;
        self.queue.as_ref().is_none_or(|queue| queue.has_room(most))
    }

    /// Tells the launcher, once, that the file takes no more; the run goes on.
    fn complain_once(&mut self, node: &mut Node) -> Result<()> {
        if !self.has_complained
            && let Some(error) = self.queue.as_ref().and_then(Queue::error)
        {
            node.say(error)?;
            self.has_complained = true;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn missing(sequences: &[u64]) -> u64 {
        let mut together = Together::default();
        for sequence in sequences {
            together.count(0, *sequence);
        }
        together.missing[0]
    }

    #[test]
    fn what_is_missing_is_counted_by_sender() {
        assert_eq!(missing(&[0, 1, 2, 3]), 0);
        assert_eq!(missing(&[0, 1, 5, 6]), 3, "a gap");
        assert_eq!(missing(&[0, 1, 2, 0, 1]), 0, "another sender");
        assert_eq!(
            missing(&[7, 8, 9, 0, 1, 10, 2, 11]),
            7,
            "last words come late"
        );
        assert_eq!(
            missing(&[0, 1, 2, 3, 2, 3]),
            2,
            "another sender's first two are missing"
        );
    }
}
