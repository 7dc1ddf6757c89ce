//! Forward imagination: the paper's seven steps (§III-C), for a group of imagined futures at once.
//!
//! Steps 1 and 4 to 7 are the human model's and lie behind [`ImaginedPeople`]; steps 2 and 3 are the robot's.
//!
//! 1. ǎ^H_{t−1} ~ h_π(π(z^H_{t−1}))
//! 2. z^R_t ~ p(z^R_t | f(z^R_{t−1}, ǎ^H_{t−1}))
//! 3. x̂_t ~ p(x̂_t | d(z^R_t)), of which we take the mean
//! 4. x̌_t = h_p(x̂_t)
//! 5. û_t = w_ω(x̂_t)
//! 6. x̊_t = v(x̌_t, û_t)
//! 7. z^H_t ~ q(z^H_t | z^H_{t−1}, ǎ^H_{t−1}, x̊_t)

use crate::people::{ImaginedPeople, PeopleError};
use models::{Communicated, Observations, SelfModel, WorldModel};
use nn::{Tensor, noise};

/// One group's imagined futures.
pub struct Imagination<M: WorldModel = SelfModel> {
    group: usize,
    rows: usize,
    /// Whether people hear words without an assistant.
    hears: bool,
    z: Tensor,
    actions: Tensor,
    observations: Observations,
    reward: Tensor,
    noise: Vec<f32>,
    scratch: M::Scratch,
    /// Discounted sum of rewards so far, one per future.
    pub returns: Vec<f32>,
}

/// How the futures are valued.
#[derive(Clone, Copy, Debug)]
pub struct Stage {
    /// γ^t of this step.
    pub discount: f32,
    /// Weight of the task reward.
    pub reward_weight: f32,
    /// Seed of this step's noise.
    pub seed: u64,
}

impl<M: WorldModel> Imagination<M> {
    /// Room for `rows` futures; `hears`: whether people hear words without an assistant.
    pub fn new(model: &M, group: usize, rows: usize, hears: bool) -> Self {
        let (latent, shape) = (model.latent(), model.shape());
        Self {
            group,
            rows,
            hears,
            z: Tensor::new(latent, rows),
            actions: Tensor::new(shape.action, rows),
            observations: Observations::new(&shape, rows),
            reward: Tensor::new(1, rows),
            noise: vec![0.0; latent * rows],
            scratch: model.scratch(),
            returns: vec![0.0; rows],
        }
    }

    /// Futures in the group.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Samples z^R_{t−1} from the robot's belief and starts the group of imagined people.
    pub fn start(
        &mut self,
        mean: &Tensor,
        deviation: &Tensor,
        seed: u64,
        known_action: Option<&[f32]>,
        people: &mut dyn ImaginedPeople,
    ) -> Result<(), PeopleError> {
        people.start(self.group, self.rows, seed, known_action)?;
        noise::fill(&mut self.noise, seed, ROBOT_STREAM);
        let (mean, deviation) = (mean.column(0), deviation.column(0));
        for j in 0..self.rows {
            let noise = &self.noise[j * mean.len()..(j + 1) * mean.len()];
            for (((z, mean), deviation), noise) in self
                .z
                .column_mut(j)
                .iter_mut()
                .zip(mean)
                .zip(deviation)
                .zip(noise)
            {
                *z = mean + deviation * noise;
            }
        }
        self.returns.fill(0.0);
        Ok(())
    }

    /// One time step. The people's actions are awaited (step 1), the robot's world moves on (2), what it would sense is
    /// imagined (3) and shown to the people with `communicated` (4 to 7), whose answer is awaited by the next call: the
    /// other group can be advanced meanwhile. The reward is decoded while they think.
    pub fn step(
        &mut self,
        model: &M,
        stage: Stage,
        communicated: &[Communicated],
        last: bool,
        people: &mut dyn ImaginedPeople,
    ) -> Result<(), PeopleError> {
        people.answer(self.group, &mut self.actions)?;
        noise::fill(&mut self.noise, stage.seed, ROBOT_STREAM);
        model.advance(&mut self.scratch, &mut self.z, &self.actions, &self.noise);
        if !last {
            let Observations { visual, verbal } = &mut self.observations;
            model.visual(&mut self.scratch, &self.z, visual);
            // What nobody is told need not be imagined: the mask hides what stands there from an earlier step.
            if self.hears || communicated.iter().any(|c| c.verbal_bits() != 0) {
                model.verbal(&mut self.scratch, &self.z, verbal);
            }
            people.ask(self.group, &self.observations, communicated, stage.seed)?;
        }
        model.reward(&mut self.scratch, &self.z, &mut self.reward);
        let weight = stage.discount * stage.reward_weight;
        for (sum, reward) in self.returns.iter_mut().zip(self.reward.data()) {
            *sum += weight * reward;
        }
        Ok(())
    }

    /// Adds what the critic expects after the horizon, of the last action the people chose: `γ^T · w · Q(z^R_T, ǎ_T)`.
    pub fn finish(
        &mut self,
        model: &M,
        stage: Stage,
        people: &mut dyn ImaginedPeople,
    ) -> Result<(), PeopleError> {
        people.answer(self.group, &mut self.actions)?;
        model.value(&mut self.scratch, &self.z, &self.actions, &mut self.reward);
        let weight = stage.discount * stage.reward_weight;
        for (sum, value) in self.returns.iter_mut().zip(self.reward.data()) {
            *sum += weight * value;
        }
        Ok(())
    }
}

/// Noise stream of the robot's side; the human side has its own.
const ROBOT_STREAM: u64 = 11;
