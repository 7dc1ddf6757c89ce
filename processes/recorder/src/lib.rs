//! The recorder: writes every message of a run to an MCAP file that Foxglove, PlotJuggler and rosbag tools open, and
//! computes the run's digest whether or not there is a file.

pub mod cdr;
pub mod queue;
pub mod recording;
pub mod result;
pub mod ros;
pub mod topics;
pub mod visual;

use anyhow::{Context, Result};
use queue::{BLOCKS, Queue, WhenFull};
use recording::{About, Recording};
use result::RecorderResult;
use runtime::{ClockMode, Digest, Node, RunArguments, Wake, now_ns};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
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
pub struct Options {
    /// The recording; without it, messages are counted and digested only.
    pub record: Option<PathBuf>,
    /// Where to write a [`RecorderResult`] at the end.
    pub result: Option<PathBuf>,
    /// For the recording's metadata.
    pub about: About,
    /// For the recording's picture of the road.
    pub road: Vec<RoadLine>,
}

/// Joins the run and records until it ends.
///
/// # Errors
/// When the file cannot be created, the run cannot be joined or a port fails; the launcher is told.
pub fn run(arguments: &RunArguments, options: &Options) -> Result<()> {
    let mut node = Node::join(arguments)?;
    let result = Recorder::new(&node, options).and_then(|mut recorder| {
        recorder.record(&mut node)?;
        recorder.finish(&mut node, options)
    });
    let told = match &result {
        Ok(()) => node.finish(),
        Err(error) => node.fail(&format!("{error:#}")),
    };
    // Why the process failed matters more than that the launcher could not be told.
    result.and(told.map_err(Into::into))
}

struct Recorder {
    inputs: Inputs,
    taken: Taken,
}

/// What has been done with the messages so far.
struct Taken {
    queue: Option<Queue>,
    digest: Digest,
    received: PerTopic,
    has_complained: bool,
}

impl Recorder {
    fn new(node: &Node, options: &Options) -> Result<Self> {
        let when_full = match node.arguments().clock {
            ClockMode::Lockstep => WhenFull::Grow,
            ClockMode::RealTime => WhenFull::Drop,
        };
        let mut queue = None;
        if let Some(path) = &options.record {
            let recording = Recording::create(path, &options.about, &options.road)?;
            queue = Some(
                Queue::start(recording, when_full, BLOCKS).context("starting the writer thread")?,
            );
        }
        let received = [0; TOPICS.len()];
        let taken = Taken {
            queue,
            digest: Digest::new(),
            received,
            has_complained: false,
        };
        Ok(Self {
            inputs: Inputs::new(node)?,
            taken,
        })
    }

    fn record(&mut self, node: &mut Node) -> Result<()> {
        let mut wake = node.ready()?;
        while wake != Wake::Stop {
            if self.look()? > 0 {
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
        let taken = &mut self.taken;
        Ok(self.inputs.drain(|message| taken.take(message))?)
    }

    fn finish(self, node: &mut Node, options: &Options) -> Result<()> {
        let Self { inputs, taken } = self;
        let ports = inputs.lost();
        let written = taken.queue.map(|queue| queue.finish(&ports));
        let written = options.record.as_deref().zip(written.as_ref());
        let result = RecorderResult::new(taken.digest.hex(), &taken.received, &ports, written);
        node.set_digest(taken.digest.finish());
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

impl Taken {
    fn take(&mut self, message: &Recorded) {
        let topic = message.topic();
        self.received[topic] += 1;
        if TOPICS[topic].is_repeatable() {
            message.digest(&mut self.digest);
        }
        if let Some(queue) = &mut self.queue {
            queue.push(message);
        }
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
