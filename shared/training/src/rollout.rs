//! Episodes on the highway for learning: what the robot lives through, with what the expert would do beside it.

use crate::replay::Step;
use domains::Mask;
use domains::highway::modalities::{VERBAL, VISUAL, write_visual};
use domains::highway::{AZIMUTHS, Expert, LIDAR_RANGE_M, Observation, Scene, World, speech};
use models::{ActionDistribution, Filter, Scratch, SelfModel};
use nn::{Tensor, noise};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Who acts in an episode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Actor {
    /// The expert.
    Expert,
    /// The policy, sampled, with this probability of a random action instead.
    Policy {
        /// ε.
        explore: f32,
        /// Whether it sees only up to thresholds drawn for the episode, as people in fog do.
        limited: bool,
    },
    /// The policy's mode, for evaluation.
    Mode,
}

/// How an episode went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Summary {
    /// Steps.
    pub steps: usize,
    /// Sum of rewards.
    pub reward: f32,
    /// Whether the car touched something.
    pub collided: bool,
}

/// How often the expert is pushed aside, for how many steps, and how hard at most (steer).
const PUSH_PROBABILITY: f32 = 0.04;
const PUSH_STEPS: u32 = 4;
const PUSH: f32 = 0.6;

/// A world with everything an actor needs, reused over episodes.
pub struct Rollout {
    world: World,
    expert: Expert,
    observation: Observation,
    observed: Tensor,
    scratch: Scratch,
    filter: Filter,
    distribution: ActionDistribution,
    previous: Tensor,
    noise: Vec<f32>,
}

impl Rollout {
    /// A rollout in `scene`.
    ///
    /// # Errors
    /// If the scene's road cannot be built.
    pub fn new(
        scene: Arc<Scene>,
        model: &SelfModel,
    ) -> Result<Self, domains::highway::road::RoadError> {
        let world = World::new(scene)?;
        let shape = model.sizes.shape;
        Ok(Self {
            expert: Expert::new(&world),
            world,
            observation: Observation::default(),
            observed: Tensor::new(model.view.rows(), 1),
            scratch: Scratch::default(),
            filter: Filter::new(model.sizes.latent, 1),
            distribution: ActionDistribution::new(model.layout.actions, 1),
            previous: Tensor::new(shape.action, 1),
            noise: vec![0.0; shape.action],
        })
    }

    /// Lives through one episode and hands every step to `keep`.
    pub fn episode(
        &mut self,
        model: &SelfModel,
        actor: Actor,
        seed: u64,
        episode: u32,
        mut keep: impl FnMut(Step),
    ) -> Summary {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ (u64::from(episode) << 32) ^ 0x726f_6c6c);
        self.world.reset(seed, episode);
        self.expert.reset(&self.world);
        self.filter.reset();
        self.previous.fill(0.0);
        let thresholds_m = match actor {
            Actor::Policy { limited: true, .. } => crate::batches::limits_m(&mut rng),
            _ => [f32::INFINITY; AZIMUTHS],
        };
        let mut summary = Summary::default();
        let (mut reward, mut terminal, mut done) = (0.0, false, false);
        let mut push = (0_u32, 0.0_f32);
        loop {
            self.world.observe(&mut self.observation);
            let mut step = step_of(&self.observation);
            step.expert = self.expert.act(&self.world);
            step.action = [self.previous.data()[0], self.previous.data()[1]];
            step.reward = reward;
            step.first = u8::from(summary.steps == 0);
            step.terminal = u8::from(terminal);
            keep(step);
            if done {
                return summary;
            }
            let action = match actor {
                Actor::Expert => {
                    // Pushed aside now and then, so that the way back is learned too.
                    if rng.random::<f32>() < PUSH_PROBABILITY {
                        push = (PUSH_STEPS, rng.random_range(-PUSH..PUSH));
                    }
                    let aside = if push.0 > 0 { push.1 } else { 0.0 };
                    push.0 = push.0.saturating_sub(1);
                    let [throttle, steer] = step.expert;
                    let noise = 0.2 * (rng.random::<f32>() - 0.5);
                    [
                        (throttle + noise).clamp(-1.0, 1.0),
                        (steer + aside).clamp(-1.0, 1.0),
                    ]
                }
                Actor::Policy { explore, .. } if rng.random::<f32>() < explore => {
                    [rng.random_range(-1.0..1.0), rng.random_range(-0.3..0.3)]
                }
                _ => self.act(model, &step, &thresholds_m, actor, &mut rng),
            };
            self.previous.data_mut().copy_from_slice(&action);
            let outcome = self.world.step(action);
            reward = outcome.reward;
            summary.reward += reward;
            summary.steps += 1;
            summary.collided |= outcome.collided;
            terminal = outcome.collided;
            done = outcome.end != domains::highway::End::Running;
        }
    }

    /// The policy's action after filtering what is seen within `thresholds_m`.
    fn act(
        &mut self,
        model: &SelfModel,
        step: &Step,
        thresholds_m: &[f32; AZIMUTHS],
        actor: Actor,
        rng: &mut ChaCha8Rng,
    ) -> [f32; 2] {
        let mask = Mask {
            visual: model
                .layout
                .perception
                .seen(thresholds_m, &step.visual, None),
            verbal: 0,
        };
        let unheard = [0.0; VERBAL];
        let observed = self.observed.column_mut(0);
        model.view.write(&step.visual, &unheard, mask, observed);
        self.filter.update(model, &self.previous, &self.observed);
        let (z, out) = (&self.filter.mean, &mut self.distribution);
        model.act(&mut self.scratch, z, out);
        let sampled = match actor {
            Actor::Mode => None,
            _ => {
                noise::fill(&mut self.noise, rng.random(), 0);
                Some(self.noise.as_slice())
            }
        };
        let mut action = Tensor::new(2, 1);
        self.distribution.sample(sampled, &mut action);
        [action.data()[0], action.data()[1]]
    }
}

/// What can be learned from one observation: the modalities, before anything was done.
pub fn step_of(observation: &Observation) -> Step {
    let mut visual = [0.0; VISUAL];
    write_visual(&observation.range, &observation.ego, &mut visual);
    let heard = speech::utterances(observation);
    Step {
        visual,
        said: heard.map(|h| h.kind as u8),
        said_range: heard.map(|h| (h.range_m / LIDAR_RANGE_M).clamp(0.0, 1.0)),
        action: [0.0; 2],
        expert: [0.0; 2],
        reward: 0.0,
        first: 0,
        terminal: 0,
    }
}
