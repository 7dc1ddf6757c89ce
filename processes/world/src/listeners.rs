//! Those who only take in what is sent, the recorder and the launcher: in lockstep the world does not run ahead of what
//! their ports hold, so that neither a slow disk nor a busy machine loses a message.
//!
//! Both say how far they have come ([`Progress`]). Nobody is waited for who never did; the launcher says which recorder
//! counts, so that one that died is waited for until another has taken its place, and somebody else's program in the
//! recorder's place, which may know nothing of this, is not.

use anyhow::Result;
use messages::{Progress, topic};
use runtime::{Input, Node, Position, RECORDER_BUFFER, Receive, Wake};

/// Steps that they may be behind. A topic carries about a message a step, and their ports hold more.
const MOST_BEHIND: usize = RECORDER_BUFFER * 5 / 8;

/// The recorder and the launcher, as the world knows them.
pub struct Listeners {
    progress: Input<Progress>,
    launcher: Option<Position>,
    recorder: Option<(u32, Position)>,
    /// The latest steps, the oldest at `next`; before there are so many, steps that are in the past for everybody.
    steps: [Position; MOST_BEHIND],
    next: usize,
}

impl Listeners {
    /// Listens to what they say.
    pub fn new(node: &Node) -> Result<Self> {
        Ok(Self {
            progress: node.input(topic::PROGRESS, Receive::InOrder)?.uncounted(),
            launcher: None,
            recorder: None,
            steps: [(0, 0); MOST_BEHIND],
            next: 0,
        })
    }

    /// Waits until whoever listens has come within reach of this step, which begins now.
    pub fn wait(&mut self, node: &mut Node, now: Position) -> Result<Wake> {
        self.hear(now)?;
        while self.are_behind() {
            if node.wait(&mut [&mut self.progress], None)? == Wake::Stop {
                return Ok(Wake::Stop);
            }
            self.hear(now)?;
        }
        self.steps[self.next] = now;
        self.next = (self.next + 1) % MOST_BEHIND;
        Ok(Wake::Message)
    }

    fn are_behind(&self) -> bool {
        let oldest = self.steps[self.next];
        self.launcher.is_some_and(|at| at < oldest)
            || self.recorder.is_some_and(|(_, at)| at < oldest)
    }

    fn hear(&mut self, now: Position) -> Result<()> {
        while self.progress.take()? {
            let Some(progress) = self.progress.message() else {
                break;
            };
            let at = (progress.header.episode, progress.header.step);
            if progress.process == Progress::LAUNCHER {
                self.launcher = self.launcher.max(Some(at));
                let known = self.recorder.map(|(index, _)| index);
                if known != Some(progress.recorder) {
                    // From here on: what was sent before it came is not its to take.
                    self.recorder = (progress.recorder != Progress::NO_RECORDER)
                        .then_some((progress.recorder, now));
                }
            } else if let Some((index, newest)) = &mut self.recorder
                && *index == progress.process
            {
                *newest = at.max(*newest);
            }
        }
        Ok(())
    }
}
