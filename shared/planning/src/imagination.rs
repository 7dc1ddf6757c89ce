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
use models::imagined::{Futures, repeat, repeat_columns};
use models::{Communicated, Observations, SelfModel, WorldModel};
use nn::{Tensor, noise};

/// One group's imagined futures.
pub struct Imagination<M: WorldModel = SelfModel> {
    group: usize,
    /// Room for so many people.
    most_rows: usize,
    /// Which future each of them lives in.
    futures: Futures,
    /// Whether people hear words without an assistant.
    hears: bool,
    z: Tensor,
    actions: Tensor,
    observations: Observations,
    reward: Tensor,
    ended: Tensor,
    noise: Vec<f32>,
    scratch: M::Scratch,
    /// z and words of those who are told something.
    told: Tensor,
    words: Tensor,
    /// Discounted sum of rewards so far, one per person.
    pub returns: Vec<f32>,
    /// Probability that the round goes on, one per person: what has ended earns nothing.
    going: Vec<f32>,
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
    /// Room for `rows` people; `hears`: whether they hear words without an assistant.
    pub fn new(model: &M, group: usize, rows: usize, hears: bool) -> Self {
        let (latent, shape) = (model.latent(), model.shape());
        Self {
            group,
            most_rows: rows,
            futures: Futures::each_their_own(rows),
            hears,
            z: Tensor::new(latent, rows),
            actions: Tensor::new(shape.action, rows),
            observations: Observations::new(&shape, rows),
            reward: Tensor::new(1, rows),
            ended: Tensor::new(1, rows),
            noise: Vec::with_capacity(latent * rows),
            scratch: model.scratch(),
            told: Tensor::new(latent, rows),
            words: Tensor::new(shape.verbal, rows),
            returns: Vec::with_capacity(rows),
            going: Vec::with_capacity(rows),
        }
    }

    /// Makes the memory that a step of the most people takes, so that no later step allocates, whatever its size.
    pub fn warm(&mut self, model: &M) {
        let rows = self.most_rows;
        self.z.resize_to(model.latent(), rows);
        self.z.fill(0.0);
        self.actions.fill(0.0);
        self.fill_noise(rows, 0);
        let (s, z) = (&mut self.scratch, &mut self.z);
        model.advance(s, z, &self.actions, &self.noise);
        model.visual(s, z, &mut self.observations.visual);
        model.verbal(s, z, &mut self.words);
        model.reward(s, z, &mut self.reward);
        model.ended(s, z, &mut self.ended);
    }

    /// The most people that there is room for.
    pub fn most_rows(&self) -> usize {
        self.most_rows
    }

    /// Samples z^R_{t−1} from the robot's `belief`, mean and deviation, and starts the group of imagined people, each in their
    /// future.
    pub fn start(
        &mut self,
        belief: [&Tensor; 2],
        rows: usize,
        futures: Futures,
        seed: u64,
        known_action: Option<&[f32]>,
        people: &mut dyn ImaginedPeople,
    ) -> Result<(), PeopleError> {
        people.start(self.group, rows, futures, seed, known_action)?;
        self.futures = futures;
        self.fill_noise(rows, seed);
        let [mean, deviation] = belief.map(|tensor| tensor.column(0));
        self.z.resize_to(mean.len(), rows);
        for j in 0..rows {
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
        self.returns.clear();
        self.returns.resize(rows, 0.0);
        self.going.clear();
        self.going.resize(rows, 1.0);
        Ok(())
    }

    /// Noise of the robot's side for so many people: the future's own, whoever lives in it.
    fn fill_noise(&mut self, rows: usize, seed: u64) {
        let width = self.z.rows();
        self.noise.resize(width * rows, 0.0);
        let own = width * self.futures.count.min(rows);
        noise::fill(&mut self.noise[..own], seed, ROBOT_STREAM);
        repeat(&mut self.noise, own);
    }

    /// Waits for an answer that nobody needs any more.
    ///
    /// # Errors
    /// What the people answer.
    pub fn drain(&mut self, people: &mut dyn ImaginedPeople) -> Result<(), PeopleError> {
        people.answer(self.group, &mut self.actions)
    }

    /// One time step. The people's actions are awaited (step 1), the robot's world moves on (2), what it would sense is
    /// imagined (3) and shown to the people with `communicated` (4 to 7), whose answer is awaited by the next call: the
    /// other group can be advanced meanwhile. The reward is decoded while they think. Where `communicated` is of more people
    /// than there were, the others have been as the first of the same future until now.
    pub fn step(
        &mut self,
        model: &M,
        stage: Stage,
        communicated: &[Communicated],
        last: bool,
        people: &mut dyn ImaginedPeople,
    ) -> Result<(), PeopleError> {
        people.answer(self.group, &mut self.actions)?;
        let (rows, count) = (communicated.len(), self.futures.count);
        repeat_columns(&mut self.actions, count, rows);
        repeat_columns(&mut self.z, count, rows);
        for j in self.returns.len()..rows {
            self.returns.push(self.returns[j % count]);
            self.going.push(self.going[j % count]);
        }
        self.fill_noise(rows, stage.seed);
        model.advance(&mut self.scratch, &mut self.z, &self.actions, &self.noise);
        if !last {
            let visual = &mut self.observations.visual;
            model.visual(&mut self.scratch, &self.z, visual);
            self.imagine_words(model, communicated);
            people.ask(self.group, &self.observations, communicated, stage.seed)?;
        }
        model.reward(&mut self.scratch, &self.z, &mut self.reward);
        model.ended(&mut self.scratch, &self.z, &mut self.ended);
        let weight = stage.discount * stage.reward_weight;
        let earned = self.reward.data().iter().zip(self.ended.data());
        let people = self.returns.iter_mut().zip(&mut self.going);
        for ((sum, going), (reward, ended)) in people.zip(earned) {
            *sum += weight * *going * reward;
            *going *= 1.0 - ended;
        }
        Ok(())
    }

    /// What could be said to those who are told something, or hear others. What nobody is told need not be imagined: the mask
    /// hides what stands there from an earlier step.
    fn imagine_words(&mut self, model: &M, communicated: &[Communicated]) {
        let verbal = &mut self.observations.verbal;
        if self.hears {
            model.verbal(&mut self.scratch, &self.z, verbal);
            return;
        }
        verbal.resize_to(self.words.rows(), communicated.len());
        let told = || (0..communicated.len()).filter(|&j| communicated[j].verbal_bits() != 0);
        let count = told().count();
        if count == 0 {
            return;
        }
        self.told.resize_to(self.z.rows(), count);
        for (place, j) in told().enumerate() {
            self.told
                .column_mut(place)
                .copy_from_slice(self.z.column(j));
        }
        model.verbal(&mut self.scratch, &self.told, &mut self.words);
        for (place, j) in told().enumerate() {
            verbal
                .column_mut(j)
                .copy_from_slice(self.words.column(place));
        }
    }

    /// Adds what the critic expects after the horizon, of the last action the people chose, where the round goes on:
    /// `γ^T · w · Q(z^R_T, ǎ_T)`.
    pub fn finish(
        &mut self,
        model: &M,
        stage: Stage,
        people: &mut dyn ImaginedPeople,
    ) -> Result<(), PeopleError> {
        people.answer(self.group, &mut self.actions)?;
        model.value(&mut self.scratch, &self.z, &self.actions, &mut self.reward);
        let weight = stage.discount * stage.reward_weight;
        let values = self.reward.data().iter().zip(&self.going);
        for (sum, (value, going)) in self.returns.iter_mut().zip(values) {
            *sum += weight * going * value;
        }
        Ok(())
    }
}

/// Noise stream of the robot's side; the human side has its own.
const ROBOT_STREAM: u64 = 11;
