//! Rounds for learning the self-model, and for measuring what was learned: what the robot lives through, with what the expert
//! would do beside it.

use crate::batches::limits_m;
use crate::environment::Environment;
use crate::replay::Episode;
use domains::discrete::End;
use domains::highway::modalities;
use domains::{ActionSpace, Layout, Mask, bomb_defusal};
use models::policy::largest;
use models::{ActionDistribution, Filter, Scratch, SelfModel};
use nn::{Tensor, noise};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Who acts in a round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Actor {
    /// The domain's expert, who knows the state.
    Expert {
        /// Probability, in a gridworld, of doing anything at all instead.
        slips: f32,
    },
    /// The policy, sampled on the highway and greedy in a gridworld, with this probability of a random action instead.
    Policy {
        /// ε.
        explore: f32,
        /// Whether it sees only as a person with limits drawn for the round would, and hears nothing.
        limited: bool,
    },
    /// The policy's mode.
    Mode,
}

/// How a round went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EpisodeSummary {
    /// Steps.
    pub steps: usize,
    /// Sum of rewards.
    pub reward: f32,
    /// How it ended.
    pub end: End,
}

/// A world with everything that an actor needs, reused over rounds.
pub struct Rollout {
    environment: Box<dyn Environment>,
    layout: Arc<Layout>,
    policy: PolicyActor,
    /// The highway's expert is pushed aside: for so many steps more, and how hard.
    push: (u32, f32),
    expert: Vec<f32>,
    episode: Episode,
}

/// The policy, and what it perceives and believes.
struct PolicyActor {
    limits: Vec<f32>,
    chance: Vec<f32>,
    filter: Filter,
    observed: Tensor,
    /// a_{t−1}.
    previous: Tensor,
    distribution: ActionDistribution,
    noise: Vec<f32>,
    q: Tensor,
    scratch: Scratch,
}

/// How often the highway's expert is pushed aside, for how many steps, and how hard at most (steer).
const PUSH_PROBABILITY: f32 = 0.04;
const PUSH_STEPS: u32 = 4;
const PUSH: f32 = 0.6;

impl Rollout {
    /// A rollout in `environment`.
    pub fn new(environment: Box<dyn Environment>, model: &SelfModel) -> Self {
        let layout = Arc::clone(environment.layout());
        let (perception, actions) = (layout.perception, layout.actions.rows());
        Self {
            policy: PolicyActor {
                limits: vec![0.0; perception.limits()],
                chance: vec![0.0; perception.noise_rows()],
                filter: Filter::new(model.sizes.latent, 1),
                observed: Tensor::new(model.view.rows(), 1),
                previous: Tensor::new(actions, 1),
                distribution: ActionDistribution::new(layout.actions, 1),
                noise: vec![0.0; actions],
                q: Tensor::default(),
                scratch: Scratch::default(),
            },
            push: (0, 0.0),
            expert: vec![0.0; actions],
            episode: Episode::default(),
            environment,
            layout,
        }
    }

    /// Lives round `episode` of `seed` and gives it back. Scenarios take turns.
    pub fn episode(
        &mut self,
        model: &SelfModel,
        actor: Actor,
        seed: u64,
        episode: u32,
    ) -> (EpisodeSummary, &Episode) {
        let mut rng = self.begin(actor, seed, episode);
        let (visual, verbal) = (self.layout.visual, self.layout.verbal);
        let mut lived = EpisodeSummary::default();
        let mut reward = 0.0;
        loop {
            let (seen, said) = (self.episode.visual.len(), self.episode.verbal.len());
            self.episode.visual.resize(seen + visual, 0.0);
            self.episode.verbal.resize(said + verbal, 0.0);
            self.environment.observe(
                &mut self.episode.visual[seen..],
                &mut self.episode.verbal[said..],
            );
            let previous = self.policy.previous.column(0);
            self.episode.action.extend_from_slice(previous);
            self.episode.reward.push(reward);
            self.environment.expert(&mut self.expert);
            self.episode.expert.extend_from_slice(&self.expert);
            lived.end = self.environment.end();
            if !lived.end.is_running() {
                break;
            }
            let at = [seen, said];
            let action = match self.layout.actions {
                ActionSpace::Continuous(_) => self.drive(model, actor, at, &mut rng),
                ActionSpace::Discrete(n) => self.play(model, actor, at, n, &mut rng),
            };
            self.policy.previous.data_mut().copy_from_slice(&action);
            reward = self.environment.step(&action);
            lived.steps += 1;
            lived.reward += reward;
        }
        self.episode.terminal = is_terminal(self.layout.domain, lived.end);
        (lived, &self.episode)
    }

    /// Starts a round, and draws what limits the sight of whoever is limited.
    fn begin(&mut self, actor: Actor, seed: u64, episode: u32) -> ChaCha8Rng {
        self.environment.reset(seed, episode, episode);
        self.policy.filter.reset();
        self.policy.previous.fill(0.0);
        self.episode.clear();
        self.push = (0, 0.0);
        let limited = matches!(actor, Actor::Policy { limited: true, .. });
        let limits = &mut self.policy.limits;
        if self.layout.domain == modalities::NAME {
            let seed = seed ^ (u64::from(episode) << 32) ^ 0x726f_6c6c;
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            limits.fill(f32::INFINITY);
            if limited {
                limits.copy_from_slice(&limits_m(&mut rng));
            }
            return rng;
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream((1 << 40) + u64::from(episode));
        let share: f32 = rng.random_range(0.0..1.0);
        limits.fill(share * self.layout.perception.largest());
        rng
    }

    /// An action on the highway. The policy hears nothing.
    fn drive(
        &mut self,
        model: &SelfModel,
        actor: Actor,
        [seen, said]: [usize; 2],
        rng: &mut ChaCha8Rng,
    ) -> Vec<f32> {
        match actor {
            Actor::Expert { .. } => {
                // Pushed aside now and then, so that the way back is learned too.
                if rng.random::<f32>() < PUSH_PROBABILITY {
                    self.push = (PUSH_STEPS, rng.random_range(-PUSH..PUSH));
                }
                let aside = if self.push.0 > 0 { self.push.1 } else { 0.0 };
                self.push.0 = self.push.0.saturating_sub(1);
                let noise = 0.2 * (rng.random::<f32>() - 0.5);
                let (throttle, steer) = (self.expert[0] + noise, self.expert[1] + aside);
                return [throttle, steer].map(|x| x.clamp(-1.0, 1.0)).to_vec();
            }
            Actor::Policy { explore, .. } if rng.random::<f32>() < explore => {
                return vec![rng.random_range(-1.0..1.0), rng.random_range(-0.3..0.3)];
            }
            Actor::Policy { .. } | Actor::Mode => {}
        }
        let (policy, visual) = (&mut self.policy, &self.episode.visual[seen..]);
        let mask = Mask {
            visual: self.layout.perception.seen(&policy.limits, visual, None),
            verbal: 0,
        };
        policy.believe(model, visual, &self.episode.verbal[said..], mask);
        let z = &policy.filter.mean;
        model.act(&mut policy.scratch, z, &mut policy.distribution);
        let sampled = (actor != Actor::Mode).then(|| {
            noise::fill(&mut policy.noise, rng.random(), 0);
            policy.noise.as_slice()
        });
        let mut action = Tensor::default();
        policy.distribution.sample(sampled, &mut action);
        action.data().to_vec()
    }

    /// A choice in a gridworld, of `n`.
    fn play(
        &mut self,
        model: &SelfModel,
        actor: Actor,
        [seen, said]: [usize; 2],
        n: usize,
        rng: &mut ChaCha8Rng,
    ) -> Vec<f32> {
        let (explore, limited) = match actor {
            Actor::Expert { slips } if slips > 0.0 && rng.random::<f32>() < slips => {
                return chosen(rng.random_range(0..n), n);
            }
            Actor::Expert { .. } => return self.expert.clone(),
            Actor::Policy { explore, limited } => (explore, limited),
            Actor::Mode => (0.0, false),
        };
        let (policy, visual) = (&mut self.policy, &self.episode.visual[seen..]);
        let mask = if limited {
            noise::fill(&mut policy.chance, rng.random(), 0);
            let chance = (!policy.chance.is_empty()).then_some(&policy.chance[..]);
            Mask {
                visual: self.layout.perception.seen(&policy.limits, visual, chance),
                verbal: 0,
            }
        } else {
            self.layout.everything()
        };
        policy.believe(model, visual, &self.episode.verbal[said..], mask);
        model.q_values(&mut policy.scratch, &policy.filter.mean, &mut policy.q);
        if rng.random::<f32>() < explore {
            return chosen(rng.random_range(0..n), n);
        }
        chosen(largest(policy.q.column(0)), n)
    }
}

impl PolicyActor {
    /// Follows the world through a mask.
    fn believe(&mut self, model: &SelfModel, visual: &[f32], verbal: &[f32], mask: Mask) {
        let observed = self.observed.column_mut(0);
        model.view.write(visual, verbal, mask, observed);
        self.filter.update(model, &self.previous, &self.observed);
    }
}

/// A choice as a column.
fn chosen(choice: usize, n: usize) -> Vec<f32> {
    let mut action = vec![0.0; n];
    action[choice] = 1.0;
    action
}

/// Whether a state has no future. A searcher's time cannot be seen coming and merely stops the round; a bomb's clock is part of
/// what is seen. The end of a gridworld's road comes unseen too, but after so few steps that values without it, which nothing
/// would hold down, grow beyond what can be earned; the highway goes on.
fn is_terminal(domain: &str, end: End) -> bool {
    match end {
        End::Running => false,
        End::Collision => true,
        End::Success => domain != modalities::NAME,
        End::OutOfTime => domain == bomb_defusal::NAME,
    }
}
