//! The planner's only view of a human model: a group of imagined people that can be started, shown something, and
//! asked what they do. Asking and answering are apart, so that two groups keep two processes busy at once.

use models::imagined::{Futures, ImaginedGroups, Moment};
use models::{Beliefs, Communicated, HumanModel, Observations};
use nn::Tensor;
use thiserror::Error;

/// No answer from the human model.
#[derive(Debug, Error)]
pub enum PeopleError {
    /// The human model did not answer in time.
    #[error("the human model did not answer within {0} ms")]
    Silent(u64),
    /// The human model has no belief for the step that is planned from, or lost the group.
    #[error("the human model has no belief to start from")]
    NoBelief,
    /// The question could not be sent, or the answer not be received.
    #[error("the human model cannot be reached: {0}")]
    Unreachable(String),
    /// Another human model has taken the place of the one that was asked: ask again from the beginning.
    #[error("the human model was replaced while it was asked")]
    Replaced,
    /// The human model believes nothing that could be compared with the robot's belief.
    #[error("the human model has no belief that could be compared with the robot's")]
    Incomparable,
    /// The process was asked to stop while it waited.
    #[error("stopped while waiting for the human model")]
    Stopped,
}

/// Groups of imagined people.
pub trait ImaginedPeople {
    /// Starts `group` with `rows` people who believe what the person believes now; their first action is `known_action`
    /// where the person's present action is known. `futures`: which future each lives in; what is left to chance in one is the
    /// same for everybody in it.
    fn start(
        &mut self,
        group: usize,
        rows: usize,
        futures: Futures,
        seed: u64,
        known_action: Option<&[f32]>,
    ) -> Result<(), PeopleError>;

    /// Shows `group` what it would observe and be told. Where it has fewer people than that, the others have been as the first of
    /// the same future until now.
    fn ask(
        &mut self,
        group: usize,
        observations: &Observations,
        communicated: &[Communicated],
        seed: u64,
    ) -> Result<(), PeopleError>;

    /// The group's answer to the last `start` or `ask`: `2 × rows`.
    fn answer(&mut self, group: usize, actions: &mut Tensor) -> Result<(), PeopleError>;

    /// KL[z^H ‖ z^R] in each version of the next moment. People who believe nothing that could be compared with the
    /// robot's belief have no answer.
    fn compare(&mut self, moment: Moment, out: &mut [f32]) -> Result<(), PeopleError> {
        let _ = (moment, out);
        Err(PeopleError::Incomparable)
    }
}

/// A human model in the same process, for experiments and tests.
pub struct LocalPeople<'a> {
    /// The model.
    pub model: &'a mut dyn HumanModel,
    /// What the person believes now.
    pub person: &'a Beliefs,
    /// Groups kept between questions.
    pub groups: &'a mut ImaginedGroups,
    /// Answers not yet fetched, one place per group.
    pub pending: &'a mut [Tensor],
}

impl ImaginedPeople for LocalPeople<'_> {
    fn start(
        &mut self,
        group: usize,
        rows: usize,
        futures: Futures,
        seed: u64,
        known_action: Option<&[f32]>,
    ) -> Result<(), PeopleError> {
        let (model, person) = (&mut *self.model, self.person);
        let actions = self
            .groups
            .start(model, person, group, rows, futures, seed, known_action)
            .map_err(|_| PeopleError::NoBelief)?;
        self.pending[group].resize_to(actions.rows(), actions.cols());
        self.pending[group].copy_from(actions);
        Ok(())
    }

    fn ask(
        &mut self,
        group: usize,
        observations: &Observations,
        communicated: &[Communicated],
        seed: u64,
    ) -> Result<(), PeopleError> {
        let actions = self
            .groups
            .step(self.model, group, observations, communicated, seed)
            .map_err(|_| PeopleError::NoBelief)?;
        self.pending[group].resize_to(actions.rows(), actions.cols());
        self.pending[group].copy_from(actions);
        Ok(())
    }

    fn answer(&mut self, group: usize, actions: &mut Tensor) -> Result<(), PeopleError> {
        let pending = &self.pending[group];
        actions.resize_to(pending.rows(), pending.cols());
        actions.copy_from(pending);
        Ok(())
    }

    fn compare(&mut self, moment: Moment, out: &mut [f32]) -> Result<(), PeopleError> {
        self.groups
            .compare(self.model, self.person, moment, out)
            .map_err(|_| PeopleError::Incomparable)
    }
}
