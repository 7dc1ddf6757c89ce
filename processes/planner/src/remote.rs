//! Imagined people who live in the human-model process: questions are written into shared memory, answers read from it.

use messages::{CHOICES, HumanBelief, ImaginePhase, ImagineRequest, ImagineStatus, MAX_GROUP};
use models::imagined::{Futures, Moment};
use models::{Communicated, Observations};
use nn::Tensor;
use planning::planner::GROUPS;
use planning::{ImaginedPeople, PeopleError};
use runtime::{Input, Node, NodeError, PortError, RequestClient, Stamp, Wake, now_ns};

/// Answers that came while another group's was awaited; kept by the loop, so that planning allocates nothing.
pub struct PendingAnswers {
    groups: [PendingAnswer; GROUPS],
}

struct PendingAnswer {
    actions: Tensor,
    rows: usize,
    answered: bool,
}

impl PendingAnswers {
    /// Room for groups of `rows` people, each with so many numbers to an action.
    pub fn new(rows: usize, actions: usize) -> Self {
        Self {
            groups: core::array::from_fn(|_| PendingAnswer {
                actions: Tensor::new(actions, rows),
                rows: 0,
                answered: false,
            }),
        }
    }
}

/// The human-model process during one plan.
pub struct RemotePeople<'a> {
    /// This process.
    pub node: &'a mut Node,
    /// Way to the human-model process.
    pub client: &'a mut RequestClient,
    /// The step that is planned from.
    pub stamp: Stamp,
    /// How long an answer may take; none waits as long as the run lasts (lockstep).
    pub patience_ns: Option<u64>,
    /// Whether people hear words without an assistant.
    pub hears: bool,
    /// Answers not fetched yet.
    pub pending: &'a mut PendingAnswers,
    /// In lockstep, where a human model that has taken the place of a dead one repeats this step's belief.
    pub successor: Option<&'a mut Input<HumanBelief>>,
}

impl RemotePeople<'_> {
    fn send(
        &mut self,
        group: usize,
        rows: usize,
        write: impl FnOnce(&mut ImagineRequest),
    ) -> Result<(), PeopleError> {
        self.pending.groups[group].answered = false;
        self.pending.groups[group].rows = rows;
        let sent = self.client.ask(self.stamp, |question| {
            question.group = group as u32;
            question.rows = rows as u32;
            write(question);
        });
        sent.map_err(unreachable_port)
    }

    /// Waits until the client holds another answer.
    fn next_answer(&mut self, deadline_ns: Option<u64>) -> Result<(), PeopleError> {
        let wake = match &mut self.successor {
            Some(beliefs) => self.client.wait_answer_or(self.node, *beliefs, deadline_ns),
            None => self.client.wait_answer(self.node, deadline_ns),
        };
        match wake.map_err(unreachable_node)? {
            Wake::Message => Ok(()),
            Wake::Passed => Err(PeopleError::Replaced),
            Wake::Stop => Err(PeopleError::Stopped),
            Wake::Deadline => Err(PeopleError::Silent(
                self.patience_ns.unwrap_or_default() / 1_000_000,
            )),
        }
    }

    /// Takes in the answer that the client holds.
    fn keep(&mut self) -> Result<(), PeopleError> {
        let Some(answer) = self.client.answer() else {
            return Ok(());
        };
        let header = &answer.header;
        if (header.episode, header.step) != (self.stamp.episode, self.stamp.step) {
            return Ok(()); // an answer to a plan that was given up
        }
        let Some(place) = self.pending.groups.get_mut(answer.group as usize) else {
            return Ok(());
        };
        let rows = answer.rows as usize;
        if answer.status() != Ok(ImagineStatus::Answered) || rows != place.rows || rows > MAX_GROUP
        {
            return Err(PeopleError::NoBelief);
        }
        let width = place.actions.rows();
        let Some(actions) = answer.action.get(..width * rows) else {
            return Err(PeopleError::NoBelief);
        };
        if !actions.iter().all(|a| a.is_finite()) {
            return Err(PeopleError::NoBelief); // numbers that nobody can act on are no answer
        }
        place.actions.resize_to(width, rows);
        place.actions.data_mut().copy_from_slice(actions);
        place.answered = true;
        Ok(())
    }
}

impl ImaginedPeople for RemotePeople<'_> {
    fn start(
        &mut self,
        group: usize,
        rows: usize,
        futures: Futures,
        seed: u64,
        known_action: Option<&[f32]>,
    ) -> Result<(), PeopleError> {
        self.send(group, rows, |question| {
            question.phase = ImaginePhase::Start.wire();
            question.first_future = futures.first as u32;
            question.futures = futures.count as u32;
            question.seed = seed;
            question.action_known = u32::from(known_action.is_some());
            question.action = [0.0; CHOICES];
            if let Some(action) = known_action {
                question.action[..action.len()].copy_from_slice(action);
            }
        })
    }

    fn ask(
        &mut self,
        group: usize,
        observations: &Observations,
        communicated: &[Communicated],
        seed: u64,
    ) -> Result<(), PeopleError> {
        let rows = observations.batch();
        let hears = self.hears;
        self.send(group, rows, |question| {
            question.phase = ImaginePhase::Perceive.wire();
            question.seed = seed;
            question.action_known = 0;
            for (asked, bits) in question.communicated.iter_mut().zip(communicated) {
                *asked = bits.0;
            }
            let Observations { visual, verbal } = observations;
            show(question, visual);
            question.verbal_width = verbal.rows() as u32;
            if hears {
                say(question, verbal);
                return;
            }
            // What is said to nobody is masked.
            let width = verbal.rows();
            let told = communicated.iter().enumerate();
            for (j, _) in told.filter(|(_, bits)| bits.verbal_bits() != 0) {
                let words = &mut question.verbal[j * width..(j + 1) * width];
                words.copy_from_slice(verbal.column(j));
            }
        })
    }

    fn answer(&mut self, group: usize, actions: &mut Tensor) -> Result<(), PeopleError> {
        let deadline_ns = self.patience_ns.map(|patience| now_ns() + patience);
        while !self.pending.groups[group].answered {
            self.next_answer(deadline_ns)?;
            self.keep()?;
        }
        self.pending.groups[group].answered = false;
        actions.copy_from(&self.pending.groups[group].actions);
        Ok(())
    }

    fn compare(&mut self, moment: Moment, out: &mut [f32]) -> Result<(), PeopleError> {
        let rows = moment.communicated.len();
        let sent = self.client.ask(self.stamp, |question| {
            question.group = 0;
            question.rows = rows as u32;
            question.phase = ImaginePhase::Compare.wire();
            question.seed = 0;
            question.action_known = 1;
            let action = moment.action.column(0);
            question.action[..action.len()].copy_from_slice(action);
            for (asked, bits) in question.communicated.iter_mut().zip(moment.communicated) {
                *asked = bits.0;
            }
            let Observations { visual, verbal } = moment.observations;
            show(question, visual);
            say(question, verbal);
            for (out, belief) in [
                (&mut question.robot_mean, moment.robot_mean),
                (&mut question.robot_deviation, moment.robot_deviation),
            ] {
                let n = belief.len().min(out.len());
                out[..n].copy_from_slice(&belief[..n]);
            }
        });
        sent.map_err(unreachable_port)?;
        let deadline_ns = self.patience_ns.map(|patience| now_ns() + patience);
        loop {
            self.next_answer(deadline_ns)?;
            let Some(answer) = self.client.answer() else {
                continue;
            };
            let header = &answer.header;
            let is_ours = (header.episode, header.step) == (self.stamp.episode, self.stamp.step);
            if !is_ours || answer.phase() != Ok(ImaginePhase::Compare) {
                self.keep()?; // an answer of an earlier question
                continue;
            }
            return match answer.status() {
                Ok(ImagineStatus::Answered) if answer.rows as usize == rows => {
                    let divergence = &answer.divergence[..rows];
                    // A number that cannot be compared is no answer.
                    if divergence.iter().any(|kl| kl.is_nan()) {
                        return Err(PeopleError::NoBelief);
                    }
                    out[..rows].copy_from_slice(divergence);
                    Ok(())
                }
                Ok(ImagineStatus::Incomparable) => Err(PeopleError::Incomparable),
                _ => Err(PeopleError::NoBelief),
            };
        }
    }
}

/// Writes what imagined people see, a person after the other.
fn show(question: &mut ImagineRequest, visual: &Tensor) {
    question.visual_width = visual.rows() as u32;
    question.visual[..visual.data().len()].copy_from_slice(visual.data());
}

/// Writes what could be said to them.
fn say(question: &mut ImagineRequest, verbal: &Tensor) {
    question.verbal_width = verbal.rows() as u32;
    question.verbal[..verbal.data().len()].copy_from_slice(verbal.data());
}

fn unreachable_port(error: PortError) -> PeopleError {
    PeopleError::Unreachable(error.to_string())
}

fn unreachable_node(error: NodeError) -> PeopleError {
    PeopleError::Unreachable(error.to_string())
}
