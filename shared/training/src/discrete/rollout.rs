//! Rounds in a gridworld for learning and for measuring what was learned.

use super::replay::{Episode, NO_ACTION};
use domains::discrete::{Discrete, End, World};
use domains::{Mask, Perception};
use models::policy::largest;
use models::{Filter, Scratch, SelfModel};
use nn::{Tensor, noise};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Who acts in a round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Actor {
    /// The domain's expert, who knows the state.
    Expert {
        /// Probability of doing anything at all instead.
        slips: f32,
    },
    /// The Q-network's best action, with this probability of a random one instead.
    Greedy {
        /// ε.
        explore: f32,
        /// Whether it sees only as a person with limits drawn for the round would, and hears nothing.
        limited: bool,
    },
}

/// How a round went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lived {
    /// Steps.
    pub steps: usize,
    /// Sum of rewards.
    pub reward: f32,
    /// How it ended.
    pub end: End,
}

/// A world with everything that an actor needs, reused over rounds.
pub struct Rollout {
    world: World,
    filter: Filter,
    perception: &'static dyn Perception,
    limits: Vec<f32>,
    chance: Vec<f32>,
    observed: Tensor,
    action: Tensor,
    q: Tensor,
    scratch: Scratch,
    episode: Episode,
}

impl Rollout {
    /// A rollout in `world`.
    pub fn new(world: World, model: &SelfModel) -> Self {
        let perception = model.layout.perception;
        Self {
            world,
            filter: Filter::new(model.sizes.latent, 1),
            limits: vec![0.0; perception.limits()],
            chance: vec![0.0; perception.noise_rows()],
            perception,
            observed: Tensor::new(model.view.rows(), 1),
            action: Tensor::new(model.sizes.shape.action, 1),
            q: Tensor::default(),
            scratch: Scratch::default(),
            episode: Episode::default(),
        }
    }

    /// Lives round `episode` of `seed` and gives it back. Scenarios take turns.
    pub fn episode(
        &mut self,
        model: &SelfModel,
        actor: Actor,
        seed: u64,
        episode: u32,
    ) -> (Lived, &Episode) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream((1 << 40) + u64::from(episode));
        let world = &mut self.world;
        world.reset(seed, episode, episode);
        let layout = world.layout().clone();
        let everything = layout.everything();
        self.filter.reset();
        self.episode.clear();
        let share: f32 = rng.random_range(0.0..1.0);
        self.limits.fill(share * self.perception.largest());
        let mut lived = Lived::default();
        let (mut taken, mut reward) = (NO_ACTION, 0.0);
        loop {
            let at = self.episode.visual.len();
            self.episode.visual.resize(at + layout.visual, 0.0);
            let spoken = self.episode.verbal.len();
            self.episode.verbal.resize(spoken + layout.verbal, 0.0);
            let (visual, verbal) = (
                &mut self.episode.visual[at..],
                &mut self.episode.verbal[spoken..],
            );
            world.observe(visual, verbal);
            self.episode.action.push(taken);
            self.episode.reward.push(reward);
            if !world.end().is_running() {
                self.episode.expert.push(NO_ACTION);
                break;
            }
            let expert = world.expert();
            self.episode.expert.push(expert as u8);
            let choice = match actor {
                Actor::Expert { slips } if slips > 0.0 && rng.random::<f32>() < slips => {
                    rng.random_range(0..layout.actions.rows())
                }
                Actor::Expert { .. } => expert,
                Actor::Greedy { explore, limited } => {
                    let mask = if limited {
                        noise::fill(&mut self.chance, rng.random(), 0);
                        let chance = (!self.chance.is_empty()).then_some(&self.chance[..]);
                        Mask {
                            visual: self.perception.seen(&self.limits, visual, chance),
                            verbal: 0,
                        }
                    } else {
                        everything
                    };
                    model
                        .view
                        .write(visual, verbal, mask, self.observed.column_mut(0));
                    self.filter.update(model, &self.action, &self.observed);
                    model.q_values(&mut self.scratch, &self.filter.mean, &mut self.q);
                    if rng.random::<f32>() < explore {
                        rng.random_range(0..layout.actions.rows())
                    } else {
                        largest(self.q.column(0))
                    }
                }
            };
            self.action.fill(0.0);
            self.action.column_mut(0)[choice] = 1.0;
            let outcome = world.step(choice);
            (taken, reward) = (choice as u8, outcome.reward);
            lived.steps += 1;
            lived.reward += reward;
        }
        lived.end = world.end();
        self.episode.terminal = is_terminal(layout.domain, lived.end);
        (lived, &self.episode)
    }
}

/// Whether a state has no future. A searcher's time cannot be seen coming and merely stops the round; a bomb's clock is part of
/// what is seen. The end of the road comes unseen too, but after so few steps that values without it, which nothing would
/// hold down, grow beyond what can be earned.
fn is_terminal(domain: &str, end: End) -> bool {
    match end {
        End::Running => false,
        End::Collision => true,
        End::Success => true,
        End::OutOfTime => domain == domains::bomb_defusal::NAME,
    }
}
