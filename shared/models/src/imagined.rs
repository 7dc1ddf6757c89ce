//! Answers the planner's one question, "if this group of imagined people saw this, what would they do?", with any human
//! model. The same code runs in the human-model process and inside experiments; an answer is a pure function of the
//! belief, the question and its seed.

use crate::human::{Beliefs, HumanModel};
use crate::observation::{Communicated, Observations, Shape};
use crate::policy::ActionDistribution;
use nn::{Tensor, noise};

/// Which future each person of a group lives in: row j in future `first + j mod count`. What is left to chance in a future
/// is the same for everybody in it, so that two rows of one future differ by what they were told alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Futures {
    /// Number of the group's first future, counted over all groups of a plan.
    pub first: usize,
    /// Futures of the group.
    pub count: usize,
}

impl Futures {
    /// Every one of `rows` people in a future of their own.
    pub const fn each_their_own(rows: usize) -> Self {
        Self {
            first: 0,
            count: rows,
        }
    }

    /// The future that row `j` lives in.
    pub const fn of(self, j: usize) -> usize {
        self.first + j % self.count
    }
}

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
    futures: Futures,
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
            futures: Futures::each_their_own(rows),
            started: false,
        };
        Self {
            groups: (0..groups).map(|_| group()).collect(),
            compared: Beliefs::new(latent, rows),
            noise: vec![0.0; model.noise_rows() * rows],
            distribution: ActionDistribution::new(actions, rows),
        }
    }

    /// Makes the memory that questions about up to `rows` people take, the model's own included, so that no later question
    /// allocates, whatever the sizes of its groups. Group 0 is forgotten.
    pub fn warm(&mut self, model: &mut dyn HumanModel, shape: &Shape, rows: usize) {
        let person = Beliefs::new(model.latent(), 1);
        let observations = Observations::new(shape, rows);
        let communicated = vec![Communicated::default(); rows];
        let futures = Futures::each_their_own(rows);
        let started = self.start(model, &person, 0, rows, futures, 0, None);
        if started.is_ok() {
            // The first step has no step before it, and may have a network of its own.
            for seed in 0..2 {
                let _ = self.step(model, 0, &observations, &communicated, seed);
            }
        }
        self.forget(0);
    }

    /// Makes a group of `rows` people out of the person's present belief and lets them act: `known_action` is what the
    /// person really does now, where that is known already (step 1 of forward imagination). `futures`: which future each
    /// lives in.
    #[allow(clippy::too_many_arguments)] // the question's own
    pub fn start(
        &mut self,
        model: &mut dyn HumanModel,
        person: &Beliefs,
        group: usize,
        rows: usize,
        futures: Futures,
        seed: u64,
        known_action: Option<&[f32]>,
    ) -> Result<&Tensor, UnknownGroup> {
        let Some(Group {
            beliefs,
            actions,
            futures: own,
            started,
        }) = self.groups.get_mut(group)
        else {
            return Err(UnknownGroup(group));
        };
        if futures.count == 0 {
            return Err(UnknownGroup(group));
        }
        *own = futures;
        let width = person.mean.rows();
        self.noise.resize(width * rows, 0.0);
        fill(&mut self.noise, &[width], futures, seed, stream::BELIEF);
        // Who the person is, is left to chance like everything else: it is the future's.
        beliefs.spread(person, rows, &self.noise, |j| futures.of(j));
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
                (futures, seed),
                &mut self.noise,
                &mut self.distribution,
                actions,
            ),
        }
        Ok(actions)
    }

    /// Lets a group perceive (steps 4 to 7) and act again (step 1 of the next time step). Where more people are asked about
    /// than the group has, the others have been as the first of the same future until now: row j as row j mod
    /// [`Futures::count`].
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
            futures,
            started: true,
        }) = self.groups.get_mut(group)
        else {
            return Err(UnknownGroup(group));
        };
        let (rows, count) = (observations.batch(), futures.count);
        for tensor in [
            &mut beliefs.mean,
            &mut beliefs.deviation,
            &mut beliefs.z,
            &mut *actions,
        ] {
            repeat_columns(tensor, count, rows);
        }
        beliefs.repeat_hypotheses(count, rows);
        self.noise.resize(model.noise_rows() * rows, 0.0);
        let widths = [model.latent(), model.noise_rows() - model.latent()];
        fill(&mut self.noise, &widths, *futures, seed, stream::BELIEF);
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
            (*futures, seed),
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
        // Versions of one moment differ in nothing but what is communicated.
        let column = person.most_probable();
        self.compared.spread_as(person, rows, noise, |_| column);
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

/// Grows a tensor to `columns`: a new column j is column j mod `count`.
pub fn repeat_columns(tensor: &mut Tensor, count: usize, columns: usize) {
    let (rows, held) = (tensor.rows(), tensor.cols());
    if columns <= held {
        return;
    }
    tensor.resize_to(rows, columns);
    for j in held..columns {
        let from = (j % count) * rows;
        tensor.data_mut().copy_within(from..from + rows, j * rows);
    }
}

/// Standard normal numbers for a batch, in blocks of `widths` numbers a row, one block after the other; what a row gets
/// depends on its future alone.
fn fill(out: &mut [f32], widths: &[usize], futures: Futures, seed: u64, stream: u64) {
    let width: usize = widths.iter().sum();
    let rows = out.len().checked_div(width).unwrap_or(0);
    let count = futures.count.min(rows);
    // All blocks of the futures first, so that rows with a future each get what they always got.
    noise::fill(&mut out[..width * count], seed, stream);
    if count == rows {
        return;
    }
    // Spread the blocks out, the last first, and repeat each.
    let mut begin = width;
    for &width in widths.iter().rev() {
        begin -= width;
        let block = begin * rows;
        out.copy_within(begin * count..(begin + width) * count, block);
        repeat(&mut out[block..block + width * rows], width * count);
    }
}

/// Repeats the first `period` numbers to the end.
pub fn repeat(out: &mut [f32], period: usize) {
    let mut done = period.max(1);
    while done < out.len() {
        let more = done.min(out.len() - done);
        out.copy_within(..more, done);
        done += more;
    }
}

/// 1: ǎ ~ h_π(π(z^H)).
fn act(
    model: &mut dyn HumanModel,
    beliefs: &Beliefs,
    (futures, seed): (Futures, u64),
    spare: &mut Vec<f32>,
    distribution: &mut ActionDistribution,
    actions: &mut Tensor,
) {
    model.act(beliefs, distribution);
    let (rows, cols) = distribution.shape();
    spare.resize(rows * cols, 0.0);
    fill(spare, &[rows], futures, seed, stream::ACTION);
    distribution.sample(Some(spare), actions);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_the_futures_not_the_rows() {
        let futures = Futures { first: 6, count: 3 };
        let widths = [4, 2];
        let (rows, width) = (11, 6);
        let mut own = vec![0.0; width * 3];
        fill(&mut own, &widths, Futures::each_their_own(3), 5, 1);
        let mut plain = vec![0.0; width * 3];
        noise::fill(&mut plain, 5, 1);
        assert_eq!(own, plain);
        let mut shared = vec![0.0; width * rows];
        fill(&mut shared, &widths, futures, 5, 1);
        let (mut wide, mut narrow) = (0, 0);
        for j in 0..rows {
            let i = j % 3;
            assert_eq!(futures.of(j), 6 + i);
            assert_eq!(shared[4 * j..4 * (j + 1)], own[4 * i..4 * (i + 1)]);
            let (block, block_of_three) = (4 * rows + 2 * j, 4 * 3 + 2 * i);
            assert_eq!(
                shared[block..block + 2],
                own[block_of_three..block_of_three + 2]
            );
            wide += 4;
            narrow += 2;
        }
        assert_eq!(wide + narrow, shared.len());
    }

    #[test]
    fn new_columns_are_the_first_of_their_future() {
        let mut tensor = Tensor::from_slice(2, 3, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        repeat_columns(&mut tensor, 2, 6);
        let expected = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 3.0, 4.0, 1.0, 2.0, 3.0, 4.0];
        assert_eq!(tensor.data(), expected);
        repeat_columns(&mut tensor, 2, 4);
        assert_eq!(tensor.cols(), 6, "nobody leaves");
    }
}
