//! What all processes did over some steps, and the messages between them: what a trace and a picture show.

use crate::graph::{EDGES, HUMAN, PLANNER, STEP_ENDS};
use crate::table::SendMark;
use crate::work::{StepReader, Stretch, StretchKind};
use messages::topic::{IMAGINE, IMAGINE_ANSWER};

/// A message that somebody used, on the monotonic clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flow {
    /// Its topic.
    pub topic: &'static str,
    /// Who sent it.
    pub from: usize,
    /// When.
    pub sent: u64,
    /// Who used it.
    pub to: usize,
    /// When they began with it.
    pub used: u64,
}

/// What all processes did over some steps of an episode.
#[derive(Debug, Default)]
pub struct Activity {
    /// Stretches, by process and time; those of a process do not overlap.
    pub stretches: Vec<Stretch>,
    /// Messages.
    pub arrows: Vec<Flow>,
}

impl Activity {
    /// Of these steps.
    pub fn of(reader: &StepReader, episode: u32, steps: std::ops::RangeInclusive<u32>) -> Self {
        let mut activity = Self::default();
        for step in steps {
            for output in STEP_ENDS {
                if let Some(work) = reader.work(output, episode, step) {
                    activity.stretches.extend(reader.stretches(episode, &work));
                    let arrows = work.inputs.iter().map(|used| {
                        let topic = EDGES[used.edge].from;
                        Flow {
                            topic: topic.name(),
                            from: topic.sender(),
                            sent: used.sent,
                            to: output.sender(),
                            used: work.began,
                        }
                    });
                    activity.arrows.extend(arrows);
                }
            }
            activity.add_imagination(reader, episode, step);
        }
        activity.untangle();
        activity
    }

    fn add_imagination(&mut self, reader: &StepReader, episode: u32, step: u32) {
        let Some(plan) = reader.imagination(episode, step) else {
            return;
        };
        let answers = reader.answers(episode, step);
        for (from, to) in &answers {
            self.stretches.push(Stretch {
                process: HUMAN,
                kind: StretchKind::Answer,
                from: *from,
                to: *to,
            });
        }
        let mut open: Vec<&(u32, SendMark)> = plan.questions.iter().collect();
        for ((group, answer), (began, _)) in plan.answers.iter().zip(&answers) {
            let asked = open
                .iter()
                .position(|(asked, mark)| asked == group && mark.sent < answer.sent);
            if let Some(place) = asked {
                let (_, question) = open.remove(place);
                self.arrows.push(Flow {
                    topic: IMAGINE,
                    from: PLANNER,
                    sent: question.sent,
                    to: HUMAN,
                    used: (*began).max(question.sent),
                });
            }
            // The planner goes on with it in the stretch that ends with its next question to this group.
            let next = plan
                .questions
                .iter()
                .find(|(asked, mark)| asked == group && mark.sent > answer.sent);
            if let Some((_, next)) = next {
                self.arrows.push(Flow {
                    topic: IMAGINE_ANSWER,
                    from: HUMAN,
                    sent: answer.sent,
                    to: PLANNER,
                    used: next.sent,
                });
            }
        }
    }

    /// Cuts waits where their process still did something else, and puts everything in order.
    fn untangle(&mut self) {
        self.stretches
            .sort_by_key(|stretch| (stretch.process, stretch.from, stretch.to));
        let busy: Vec<Stretch> = self
            .stretches
            .iter()
            .copied()
            .filter(|stretch| {
                !matches!(
                    stretch.kind,
                    StretchKind::Wait(_) | StretchKind::AwaitAnswers
                )
            })
            .collect();
        let mut out: Vec<Stretch> = Vec::with_capacity(self.stretches.len());
        for stretch in &self.stretches {
            if !matches!(
                stretch.kind,
                StretchKind::Wait(_) | StretchKind::AwaitAnswers
            ) {
                out.push(*stretch);
                continue;
            }
            // What is left of the wait around what the process did meanwhile.
            let mut from = stretch.from;
            let first = busy.partition_point(|other| {
                (other.process, other.to) <= (stretch.process, stretch.from)
            });
            for other in &busy[first..] {
                if other.process != stretch.process || other.from >= stretch.to {
                    break;
                }
                if other.from > from {
                    out.push(Stretch {
                        from,
                        to: other.from,
                        ..*stretch
                    });
                }
                from = from.max(other.to);
            }
            if from < stretch.to {
                out.push(Stretch { from, ..*stretch });
            }
        }
        out.sort_by_key(|stretch| (stretch.process, stretch.from, stretch.to));
        // Whatever still overlaps by a rounding of clocks is cut at the next one's beginning.
        for index in 1..out.len() {
            if out[index].process == out[index - 1].process {
                let end = out[index - 1].to.min(out[index].from);
                out[index - 1].to = end.max(out[index - 1].from);
            }
        }
        out.retain(|stretch| stretch.to > stretch.from);
        self.stretches = out;
    }
}
