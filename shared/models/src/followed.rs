//! A real person as a human model follows them: what they believe by each hypothesis about them, and how probable each is.

use crate::human::{Beliefs, HumanModel};
use crate::observation::{Communicated, Observations, Shape};
use crate::policy::ActionDistribution;
use nn::{Tensor, noise};

/// Noise of the real person's belief, as opposed to imagined people's.
const FOLLOWING: u64 = 21;
/// The least share of a hypothesis's probability that one of its samples keeps: what nothing explains must not decide for good.
const LEAST: f32 = 0.02;

/// One person, followed. Allocates nothing after [`FollowedPerson::new`].
pub struct FollowedPerson {
    /// A column for each sample of each hypothesis.
    pub beliefs: Beliefs,
    observations: Observations,
    told: Vec<Communicated>,
    action: Tensor,
    /// What they would do by each column.
    each: ActionDistribution,
    /// What they are expected to do.
    expected: ActionDistribution,
    noise: Vec<f32>,
}

impl FollowedPerson {
    /// A person who perceived nothing yet; `shape` is the domain's.
    pub fn new(model: &dyn HumanModel, shape: &Shape) -> Self {
        let beliefs = Beliefs::of_person(model);
        let columns = beliefs.hypothesis.len();
        let actions = model.actions();
        Self {
            beliefs,
            observations: Observations::new(shape, columns),
            told: vec![Communicated::default(); columns],
            action: Tensor::new(actions.rows(), columns),
            each: ActionDistribution::new(actions, columns),
            expected: ActionDistribution::new(actions, 1),
            noise: vec![0.0; model.noise_rows() * columns],
        }
    }

    /// An episode begins.
    pub fn reset(&mut self, model: &dyn HumanModel) {
        self.beliefs.reset();
        self.beliefs.weigh(model.weights());
    }

    /// The person, who did `taken` one step before, perceives (steps 4 to 7 of forward imagination): `visual` and `verbal` as the
    /// robot senses them, `told` what is communicated. `at`: seed, episode and step, which decide what they are taken to notice
    /// by chance.
    pub fn perceive(
        &mut self,
        model: &mut dyn HumanModel,
        (visual, verbal): (&[f32], &[f32]),
        told: Communicated,
        taken: &[f32],
        at: [u64; 3],
    ) {
        if !self.beliefs.fresh && model.samples() > 1 {
            self.weigh(taken, model.samples());
        }
        for j in 0..self.told.len() {
            self.observations
                .visual
                .column_mut(j)
                .copy_from_slice(visual);
            self.observations
                .verbal
                .column_mut(j)
                .copy_from_slice(verbal);
            self.action.column_mut(j).copy_from_slice(taken);
        }
        self.told.fill(told);
        // Where perception is a matter of chance, so is the belief; elsewhere its mean is carried.
        let by_chance = model.noise_rows() > model.latent();
        if by_chance {
            noise::fill(&mut self.noise, noise::mix(&at), FOLLOWING);
        }
        model.perceive(
            &mut self.beliefs,
            &self.action,
            &self.observations,
            &self.told,
            by_chance.then_some(&self.noise[..]),
        );
        model.act(&self.beliefs, &mut self.each);
        self.each.mix(&self.beliefs.weight, &mut self.expected);
    }

    /// The distribution of what they do next, `actions × 1`.
    pub fn expected(&self) -> &ActionDistribution {
        &self.expected
    }

    /// Mean and deviation of z^H over all hypotheses, `latent` numbers each, as far as there is room.
    pub fn moments(&self, mean: &mut [f32], deviation: &mut [f32]) {
        let own = &self.beliefs;
        if own.weight.len() == 1 {
            let count = mean.len();
            mean.copy_from_slice(&own.mean.column(0)[..count]);
            deviation.copy_from_slice(&own.deviation.column(0)[..count]);
            return;
        }
        for (i, (mean, deviation)) in mean.iter_mut().zip(deviation).enumerate() {
            let (mut sum, mut square) = (0.0, 0.0);
            for (j, weight) in own.weight.iter().enumerate() {
                let (m, s) = (own.mean.column(j)[i], own.deviation.column(j)[i]);
                sum += weight * m;
                square += weight * (s * s + m * m);
            }
            (*mean, *deviation) = (sum, (square - sum * sum).max(0.0).sqrt());
        }
    }

    /// What was done tells which of a hypothesis's samples are right: Bayes' rule within each hypothesis, whose own probability
    /// stays.
    fn weigh(&mut self, taken: &[f32], samples: usize) {
        for (h, weights) in self.beliefs.weight.chunks_exact_mut(samples).enumerate() {
            let whole: f32 = weights.iter().sum();
            let columns = h * samples..(h + 1) * samples;
            for (weight, j) in weights.iter_mut().zip(columns) {
                *weight *= self.each.log_density(j, taken).exp();
            }
            let sum: f32 = weights.iter().sum();
            let even = whole / samples as f32;
            for weight in weights {
                let share = match sum > 0.0 {
                    true => *weight / sum * whole,
                    false => even,
                };
                *weight =
                    (1.0 - LEAST * samples as f32).max(0.0) * share + LEAST * samples as f32 * even;
            }
        }
    }
}
