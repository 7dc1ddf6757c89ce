//! From headers to work: when a process began the step that ended with a message, and how long its inputs had waited.
//!
//! Three things are known exactly, because the sender's port wrote them into the header from one clock: when a message
//! was sent, how long its sender had computed since its last step ended, and when its cause was sensed. Everything else
//! follows:
//!
//! - A process *began* at `sent − compute`. That is exact when it computed in one piece. Where it computed a little,
//!   waited for another input and computed on, the last piece began later than that by what it had computed before: the
//!   waits stated here are then too short by as much (about a microsecond for a look at the first input). They are too
//!   long only by what passes between the port's two readings of the clock, for what was computed and for when it was
//!   sent.
//! - A message *waited* from its sending to the moment when the receiver began. With several inputs only the newest
//!   made the receiver wait; the others lay there meanwhile. Both are reported.
//! - Where `sent − compute` lies before the newest input was sent, the process must have computed before it came. The
//!   wait is then stated as zero, and counted as clamped.
//! - The planner waits within its step for the human model's answers. Its questions carry its compute time so far,
//!   which gives the pieces in between. The human model's compute time since its last step includes the answers that it
//!   gave; the last answer's header says how much that was.

use crate::graph::{EDGES, Edge, GraphTopic, HUMAN, PLANNER};
use crate::table::{ImaginationMarks, SendMark, StepTable};
use runtime::ClockMode;

/// In real time, an input of another step than the output's is looked for so many steps back.
const LOOK_BACK: u32 = 64;

/// Answers since the human model's last step belong to plans at most so many steps back.
const BEHIND: u32 = 3;

/// An input that a step used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Used {
    /// Place in [`EDGES`].
    pub edge: usize,
    /// The input's step.
    pub step: u32,
    /// When it was sent.
    pub sent: u64,
}

/// A stretch of a process's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stretch {
    /// The process: a place in [`PROCESSES`](messages::PROCESSES).
    pub process: usize,
    /// What happened.
    pub kind: StretchKind,
    /// From, in ns of the monotonic clock.
    pub from: u64,
    /// To.
    pub to: u64,
}

/// What happens in a stretch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum StretchKind {
    /// It computes the message that ends its step.
    Compute(GraphTopic),
    /// It could begin, for its newest input is there, but has not: it is being woken, does something else, or has no
    /// core.
    Wait(GraphTopic),
    /// The planner waits for answers.
    AwaitAnswers,
    /// The human model answers a question.
    Answer,
    /// A message of this path was not seen.
    Unknown,
}

/// A process's step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StepWork {
    /// What it sent.
    pub output: GraphTopic,
    /// The output's step.
    pub step: u32,
    /// When it began; see the module.
    pub began: u64,
    /// When the output was sent.
    pub sent: u64,
    /// What it computed for the output.
    pub compute: u64,
    /// What it waited for, within the step, for answers.
    pub awaited: u64,
    /// What it used.
    pub inputs: Vec<Used>,
    /// Whether `sent − compute` lay before the newest input.
    pub clamped: bool,
}

impl StepWork {
    /// The input that came last.
    pub fn newest(&self) -> Option<&Used> {
        self.inputs.iter().max_by_key(|used| used.sent)
    }
}

/// Reads work out of a table of headers.
#[derive(Clone, Copy)]
pub struct StepReader<'a> {
    /// The headers.
    pub table: &'a StepTable,
    /// How time passes in the run.
    pub clock: ClockMode,
}

impl StepReader<'_> {
    /// The work that ended with a message; none if the message was not seen.
    pub fn work(&self, output: GraphTopic, episode: u32, step: u32) -> Option<StepWork> {
        let seen = self.table.step(episode, step)?;
        let mark = *seen.mark(output)?;
        let plan = (output == GraphTopic::Decision && seen.planned)
            .then(|| self.imagination(episode, step.checked_sub(1)?))
            .flatten();
        let first_question = plan.and_then(|plan| plan.questions.first());
        let compute = match output.sender() {
            HUMAN => mark.compute - self.answered_before(episode, step, &mark).min(mark.compute),
            _ => mark.compute,
        };
        let computed_from = match first_question {
            Some((_, question)) => question.sent.saturating_sub(question.compute),
            None => mark.sent.saturating_sub(compute),
        };
        let mut inputs = Vec::with_capacity(4);
        for (place, edge) in EDGES.iter().enumerate() {
            if edge.to == output
                && edge.counts(self.clock, seen.planned)
                && let Some(used) = self.used(place, edge, episode, step, computed_from, &mark)
            {
                inputs.push(used);
            }
        }
        let newest = inputs.iter().map(|used| used.sent).max().unwrap_or(0);
        let mut began = computed_from.max(newest);
        let mut awaited = 0;
        if output.sender() == PLANNER && seen.planned {
            if first_question.is_none() {
                // Its questions were lost: what it waited before them and for answers cannot be told apart.
                began = newest.max(mark.cause);
            }
            awaited = mark.sent.saturating_sub(began).saturating_sub(compute);
        }
        Some(StepWork {
            output,
            step,
            began,
            sent: mark.sent,
            compute,
            awaited,
            clamped: computed_from < newest,
            inputs,
        })
    }

    /// The message that an edge carried.
    fn used(
        &self,
        place: usize,
        edge: &Edge,
        episode: u32,
        step: u32,
        began: u64,
        output: &SendMark,
    ) -> Option<Used> {
        let expected = step.checked_add_signed(edge.step)?;
        let used = |step: u32, mark: &SendMark| Used {
            edge: place,
            step,
            sent: mark.sent,
        };
        if self.clock == ClockMode::Lockstep || edge.stamps {
            let mark = self.table.mark(edge.from, episode, expected)?;
            return (mark.sent < output.sent).then(|| used(expected, mark));
        }
        let steps = expected.saturating_sub(LOOK_BACK)..=expected;
        steps.rev().find_map(|step| {
            let mark = self.table.mark(edge.from, episode, step)?;
            (mark.sent <= began).then(|| used(step, mark))
        })
    }

    /// The imagination of a plan that started from a step.
    pub fn imagination(&self, episode: u32, step: u32) -> Option<&ImaginationMarks> {
        self.table.step(episode, step)?.imagination.as_deref()
    }

    /// What the human model had computed for answers since its step before, which may belong to the episode before.
    fn answered_before(&self, episode: u32, step: u32, belief: &SendMark) -> u64 {
        let table = self.table;
        let last_episode = episode
            .checked_sub(1)
            .filter(|_| step <= BEHIND)
            .and_then(|before| Some((before, table.last_step(before)?)));
        let recent = [Some((episode, step)), last_episode]
            .into_iter()
            .flatten()
            .flat_map(|(episode, step)| {
                (step.saturating_sub(BEHIND)..=step).map(move |step| (episode, step))
            });
        let before = recent
            .clone()
            .filter_map(|(episode, step)| table.mark(GraphTopic::HumanBelief, episode, step))
            .map(|mark| mark.sent)
            .filter(|sent| *sent < belief.sent)
            .max()
            .unwrap_or(0);
        recent
            .filter_map(|(episode, step)| self.imagination(episode, step))
            .flat_map(|plan| &plan.answers)
            .filter(|(_, answer)| answer.sent > before && answer.sent < belief.sent)
            .map(|(_, answer)| answer.compute)
            .max()
            .unwrap_or(0)
    }

    /// When the human model worked on each answer of a plan: from, to. An answer's compute time counts from the human
    /// model's last step, so each is what it adds to the one before.
    pub fn answers(&self, episode: u32, step: u32) -> Vec<(u64, u64)> {
        let Some(plan) = self.imagination(episode, step) else {
            return Vec::new();
        };
        let mut before = 0;
        let stretches = plan.answers.iter().map(|(_, answer)| {
            let own = if answer.compute >= before {
                answer.compute - before
            } else {
                answer.compute
            };
            before = answer.compute;
            (answer.sent.saturating_sub(own), answer.sent)
        });
        stretches.collect()
    }

    /// A step's stretches, in order: the wait for its beginning (if its newest input is known), then computing and, for
    /// the planner, waiting for answers.
    pub fn stretches(&self, episode: u32, work: &StepWork) -> Vec<Stretch> {
        let process = work.output.sender();
        let mut out = Vec::new();
        let mut push = |kind, from: u64, to: u64| {
            if to > from {
                out.push(Stretch {
                    process,
                    kind,
                    from,
                    to,
                });
            }
        };
        if let Some(newest) = work.newest() {
            push(
                StretchKind::Wait(EDGES[newest.edge].from),
                newest.sent,
                work.began,
            );
        }
        let compute = StretchKind::Compute(work.output);
        let plan = (work.awaited > 0)
            .then(|| self.imagination(episode, work.step.checked_sub(1)?))
            .flatten();
        match plan {
            // Where exactly in the time between two questions it waited is not known: first, we say, then it computed.
            Some(plan) if !plan.questions.is_empty() => {
                let (mut at, mut computed) = (work.began, 0);
                let sent = plan.questions.iter().map(|(_, mark)| mark);
                let last = SendMark {
                    sent: work.sent,
                    compute: work.compute,
                    cause: 0,
                };
                for mark in sent.chain([&last]) {
                    let own = mark.compute.saturating_sub(computed);
                    let resumed = mark.sent.saturating_sub(own).max(at);
                    push(StretchKind::AwaitAnswers, at, resumed);
                    push(compute, resumed, mark.sent);
                    (at, computed) = (mark.sent.max(at), mark.compute);
                }
            }
            Some(_) | None if work.awaited > 0 => {
                push(
                    StretchKind::AwaitAnswers,
                    work.began,
                    work.began + work.awaited,
                );
                push(compute, work.began + work.awaited, work.sent);
            }
            _ => push(compute, work.began, work.sent),
        }
        out
    }

    /// What `output` of a step goes back to, as far as `from`: stretches in order, without gaps, clipped to start
    /// there.
    pub fn path(&self, output: GraphTopic, episode: u32, step: u32, from: u64) -> Vec<Stretch> {
        let mut path = Vec::new();
        let (mut output, mut step) = (output, step);
        while let Some(work) = self.work(output, episode, step) {
            let mut stretches = self.stretches(episode, &work);
            stretches.reverse();
            path.extend(stretches.into_iter().filter_map(|stretch| {
                let clipped = Stretch {
                    from: stretch.from.max(from),
                    ..stretch
                };
                (clipped.to > clipped.from).then_some(clipped)
            }));
            match work.newest() {
                Some(newest) if newest.sent > from => {
                    output = EDGES[newest.edge].from;
                    step = newest.step;
                }
                _ => break,
            }
        }
        // Before the earliest that is known.
        if let Some(earliest) = path.last().copied().filter(|stretch| stretch.from > from) {
            path.push(Stretch {
                process: earliest.process,
                kind: StretchKind::Unknown,
                from,
                to: earliest.from,
            });
        }
        path.reverse();
        path
    }
}

#[cfg(test)]
mod tests;
