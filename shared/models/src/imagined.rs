//! Answers the planner's one question, "if this group of imagined people saw this, what would they do?", with any human
//! model. The same code runs in the human-model process and inside experiments; an answer is a pure function of the
//! belief, the question and its seed.

use crate::human::{Beliefs, HumanModel};
use crate::observation::{Communicated, Observations};
use crate::policy::ActionDistribution;
use nn::{Tensor, noise};

/// Groups of imagined people and their beliefs between questions.
pub struct ImaginedGroups {
    groups: Vec<Group>,
    compared: Beliefs,
    noise: Vec<f32>,
    distribution: ActionDistribution,
}

struct Group {
    beliefs: Beliefs,
    actions: Tensor,
    started: bool,
}

/// A question about a group that was never started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("group {0} of imagined people was not started")]
pub struct UnknownGroup(pub usize);

/// A comparison of beliefs with a human model that believes something else than the robot could.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a human model of kind `{0}` has no belief that could be compared with the robot's")]
pub struct Incomparable(pub &'static str);

/// One moment, in as many versions as there are rows, that differ in what is communicated.
#[derive(Clone, Copy)]
pub struct Moment<'a> {
    /// What the person did before.
    pub action: &'a Tensor,
    /// What the robot imagines to sense.
    pub observations: &'a Observations,
    /// What is communicated in each version.
    pub communicated: &'a [Communicated],
    /// Mean of z^R then, one number per dimension.
    pub robot_mean: &'a [f32],
    /// Its deviation.
    pub robot_deviation: &'a [f32],
}

/// Noise streams of one question.
mod stream {
    pub const BELIEF: u64 = 1;
    pub const ACTION: u64 = 2;
}

impl ImaginedGroups {
    /// Room for `groups` groups of at most `rows` people as `model` has them.
    pub fn new(model: &dyn HumanModel, groups: usize, rows: usize) -> Self {
        let (latent, actions) = (model.latent(), model.actions());
        let group = || Group {
            beliefs: Beliefs::new(latent, rows),
            actions: Tensor::new(actions.rows(), rows),
            started: false,
        };
        Self {
            groups: (0..groups).map(|_| group()).collect(),
            compared: Beliefs::new(latent, rows),
            noise: vec![0.0; model.noise_rows() * rows],
            distribution: ActionDistribution::new(actions, rows),
        }
    }

    /// Makes a group of `rows` people out of the person's present belief and lets them act: `known_action` is what the
    /// person really does now, where that is known already (step 1 of forward imagination).
    pub fn start(
        &mut self,
        model: &mut dyn HumanModel,
        person: &Beliefs,
        group: usize,
        rows: usize,
        seed: u64,
        known_action: Option<&[f32]>,
    ) -> Result<&Tensor, UnknownGroup> {
        let Some(Group {
            beliefs,
            actions,
            started,
        }) = self.groups.get_mut(group)
        else {
            return Err(UnknownGroup(group));
        };
        self.noise.resize(person.mean.rows() * rows, 0.0);
        noise::fill(&mut self.noise, seed, stream::BELIEF);
        beliefs.spread(person, rows, &self.noise);
        *started = true;
        match known_action {
            Some(action) => {
                actions.resize_to(action.len(), rows);
                for j in 0..rows {
                    actions.column_mut(j).copy_from_slice(action);
                }
            }
            None => act(
                model,
                beliefs,
                seed,
                &mut self.noise,
                &mut self.distribution,
                actions,
            ),
        }
        Ok(actions)
    }

    /// Lets a group perceive (steps 4 to 7) and act again (step 1 of the next time step).
    pub fn step(
        &mut self,
        model: &mut dyn HumanModel,
        group: usize,
        observations: &Observations,
        communicated: &[Communicated],
        seed: u64,
    ) -> Result<&Tensor, UnknownGroup> {
        let Some(Group {
            beliefs,
            actions,
            started: true,
        }) = self.groups.get_mut(group)
        else {
            return Err(UnknownGroup(group));
        };
        self.noise
            .resize(model.noise_rows() * observations.batch(), 0.0);
        noise::fill(&mut self.noise, seed, stream::BELIEF);
        model.perceive(
            beliefs,
            actions,
            observations,
            communicated,
            Some(&self.noise),
        );
        act(
            model,
            beliefs,
            seed,
            &mut self.noise,
            &mut self.distribution,
            actions,
        );
        Ok(actions)
    }

    /// KL[z^H ‖ z^R] in each version of a moment, had the person believed `person` before it; without chance: z^H follows
    /// from the mean. `out` takes one number per version.
    ///
    /// # Errors
    /// If the model's belief cannot be compared with the robot's.
    pub fn compare(
        &mut self,
        model: &mut dyn HumanModel,
        person: &Beliefs,
        moment: Moment,
        out: &mut [f32],
    ) -> Result<(), Incomparable> {
        if !model.shares_latent() || moment.robot_mean.len() != model.latent() {
            return Err(Incomparable(model.kind()));
        }
        let rows = moment.communicated.len();
        let noise = &mut self.noise;
        noise.resize(model.latent() * rows, 0.0);
        noise.fill(0.0);
        self.compared.spread(person, rows, noise);
        let Moment {
            action,
            observations,
            communicated,
            ..
        } = moment;
        model.perceive(&mut self.compared, action, observations, communicated, None);
        for (j, out) in out[..rows].iter_mut().enumerate() {
            let own = self.compared.mean.column(j).iter();
            let own = own.zip(self.compared.deviation.column(j));
            let robot = moment.robot_mean.iter().zip(moment.robot_deviation);
            *out = own
                .zip(robot)
                .map(|((mean_h, dev_h), (mean_r, dev_r))| {
                    let ratio = dev_h / dev_r;
                    let apart = (mean_h - mean_r) / dev_r;
                    0.5 * (ratio * ratio + apart * apart - 1.0) - ratio.ln()
                })
                .sum();
        }
        Ok(())
    }

    /// Forgets a group.
    pub fn forget(&mut self, group: usize) {
        if let Some(group) = self.groups.get_mut(group) {
            group.started = false;
        }
    }
}

/// 1: ǎ ~ h_π(π(z^H)).
fn act(
    model: &mut dyn HumanModel,
    beliefs: &Beliefs,
    seed: u64,
    spare: &mut Vec<f32>,
    distribution: &mut ActionDistribution,
    actions: &mut Tensor,
) {
    model.act(beliefs, distribution);
    let (rows, cols) = distribution.shape();
    spare.resize(rows * cols, 0.0);
    noise::fill(spare, seed, stream::ACTION);
    distribution.sample(Some(spare), actions);
}
