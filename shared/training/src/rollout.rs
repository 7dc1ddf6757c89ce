//! Rounds for learning the self-model, and for measuring what was learned: what the robot lives through, with what the expert
//! would do beside it.

use crate::environment::{Environment, Perceived};
use crate::replay::Episode;
use crate::sighted::Sighted;
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
    /// An expert who sees only so far, drawn for the round, and may be late; where there is one ([`Environment::has_peer`]).
    Peer,
    /// The policy, sampled on the highway and greedy in a gridworld, with this probability of a random action instead.
    Policy {
        /// ε.
        explore: f32,
        /// Whether it perceives only as much as a person drawn for the round would.
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
    sighted: Sighted,
    /// The newest actions of a peer, and by how many steps this round's is late.
    before: [Vec<f32>; LATEST + 1],
    late: usize,
    /// The highway's expert is pushed aside: for so many steps more, and how hard.
    push: (u32, f32),
    expert: Vec<f32>,
    peer: Vec<f32>,
    episode: Episode,
}

/// The policy, and what it perceives and believes.
struct PolicyActor {
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
/// The latest reaction of a peer, in steps.
const LATEST: usize = 5;

impl Rollout {
    /// A rollout in `environment`.
    pub fn new(environment: Box<dyn Environment>, model: &SelfModel) -> Self {
        let layout = Arc::clone(environment.layout());
        let actions = layout.actions.rows();
        Self {
            policy: PolicyActor {
                filter: Filter::new(model.sizes.latent, 1),
                observed: Tensor::new(model.view.rows(), 1),
                previous: Tensor::new(actions, 1),
                distribution: ActionDistribution::new(layout.actions, 1),
                noise: vec![0.0; actions],
                q: Tensor::default(),
                scratch: Scratch::default(),
            },
            sighted: Sighted::new(&layout),
            before: core::array::from_fn(|_| vec![0.0; actions]),
            late: 0,
            push: (0, 0.0),
            expert: vec![0.0; actions],
            peer: vec![0.0; actions],
            episode: Episode::default(),
            environment,
            layout,
        }
    }

    /// Whether [`Actor::Peer`] can act.
    pub fn has_peer(&self) -> bool {
        self.environment.has_peer()
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
            let now = [&self.episode.visual[seen..], &self.episode.verbal[said..]];
            let perceived = self.sighted.perceive(now[0], &mut rng);
            let theirs = Perceived {
                limits: &self.sighted.limits,
                mask: perceived,
                visual: now[0],
                verbal: now[1],
            };
            self.environment.peer(theirs, &mut self.peer);
            self.episode.peer.extend_from_slice(&self.peer);
            self.episode.perceived.push(perceived);
            lived.end = self.environment.end();
            if !lived.end.is_running() {
                break;
            }
            let at = [seen, said];
            let action = match self.layout.actions {
                ActionSpace::Continuous(_) => self.drive(model, actor, at, perceived, &mut rng),
                ActionSpace::Discrete(n) => self.play(model, actor, at, perceived, n, &mut rng),
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
        let limited = matches!(actor, Actor::Peer | Actor::Policy { limited: true, .. });
        let mut rng = match self.layout.domain == modalities::NAME {
            true => ChaCha8Rng::seed_from_u64(seed ^ (u64::from(episode) << 32) ^ 0x726f_6c6c),
            false => {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                rng.set_stream((1 << 40) + u64::from(episode));
                rng
            }
        };
        self.sighted.draw(limited, &mut rng);
        // Every other peer is late.
        let late = rng.random_range(0..2 * LATEST + 2);
        self.late = late.saturating_sub(LATEST + 1);
        self.before.iter_mut().for_each(|action| action.fill(0.0));
        rng
    }

    /// An action on the highway. The policy hears nothing.
    fn drive(
        &mut self,
        model: &SelfModel,
        actor: Actor,
        [seen, said]: [usize; 2],
        perceived: Mask,
        rng: &mut ChaCha8Rng,
    ) -> Vec<f32> {
        match actor {
            Actor::Expert { .. } | Actor::Peer => {
                self.before.rotate_right(1);
                self.before[0].copy_from_slice(&self.peer);
                let meant = match actor {
                    Actor::Peer => &self.before[self.late],
                    _ => &self.expert,
                };
                // Pushed aside now and then, so that the way back is learned too.
                if rng.random::<f32>() < PUSH_PROBABILITY {
                    self.push = (PUSH_STEPS, rng.random_range(-PUSH..PUSH));
                }
                let aside = if self.push.0 > 0 { self.push.1 } else { 0.0 };
                self.push.0 = self.push.0.saturating_sub(1);
                let noise = 0.2 * (rng.random::<f32>() - 0.5);
                let (throttle, steer) = (meant[0] + noise, meant[1] + aside);
                return [throttle, steer].map(|x| x.clamp(-1.0, 1.0)).to_vec();
            }
            Actor::Policy { explore, .. } if rng.random::<f32>() < explore => {
                return vec![rng.random_range(-1.0..1.0), rng.random_range(-0.3..0.3)];
            }
            Actor::Policy { .. } | Actor::Mode => {}
        }
        let (policy, episode) = (&mut self.policy, &self.episode);
        policy.believe(
            model,
            &episode.visual[seen..],
            &episode.verbal[said..],
            perceived,
        );
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
        perceived: Mask,
        n: usize,
        rng: &mut ChaCha8Rng,
    ) -> Vec<f32> {
        let explore = match actor {
            Actor::Expert { slips } if slips > 0.0 && rng.random::<f32>() < slips => {
                return chosen(rng.random_range(0..n), n);
            }
            Actor::Expert { .. } => return self.expert.clone(),
            Actor::Peer => return self.peer.clone(),
            Actor::Policy { explore, .. } => explore,
            Actor::Mode => 0.0,
        };
        let (policy, episode) = (&mut self.policy, &self.episode);
        policy.believe(
            model,
            &episode.visual[seen..],
            &episode.verbal[said..],
            perceived,
        );
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
