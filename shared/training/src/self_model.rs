//! `mirror train self`: the self-model from nothing, by ELBO, with policy and values on its latent states beside it (paper §III-A
//! and appendix): soft actor-critic where actions are numbers ([`crate::sac`]), deep Q-learning where they are choices
//! ([`crate::dqn`]).
//!
//! A phase lives some rounds, each by the expert with probability β, else by the policy, most of which see as people do, and
//! then makes gradient steps. Randomness is drawn anew from (seed, phase), and a checkpoint ([`crate::checkpoint`]) holds
//! weights, optimiser, targets and replay: stopping and resuming gives the same bytes as not stopping.

use crate::batches::{Drawing, Shard};
use crate::config::{self, Checked};
use crate::dqn::{Dqn, DqnScratch, DqnSettings};
use crate::environment::Environment;
use crate::replay::Replay;
use crate::rollout::{Actor, EpisodeSummary, Rollout};
use crate::sac::{Sac, SacScratch, SacSettings};
use domains::ActionSpace;
use models::{SelfModel, Sizes};
use nn::{Adam, Arena, Gradients, ParamId, Parameters};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Settings of a training run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SelfModelSettings {
    /// Seed of everything: no configuration has it.
    #[serde(default)]
    pub seed: u64,
    /// Phases.
    pub phases: u32,
    /// Rounds lived in a phase.
    pub rounds: u32,
    /// Gradient steps in a phase.
    pub gradient_steps: usize,
    /// Sequences per gradient step.
    pub sequences: usize,
    /// Observations per sequence.
    pub length: usize,
    /// Rate of Adam.
    pub learning_rate: f32,
    /// Longest gradient, per part: world model, policy, values.
    pub gradient_clip: f32,
    /// Observations that the replay buffer holds.
    pub replay: usize,
    /// β at the start: the expert's share of the rounds.
    pub expert: f32,
    /// Its factor per phase.
    pub expert_decay: f32,
    /// ε at the start: probability of a random action.
    pub explore: f32,
    /// Its factor per phase.
    pub explore_decay: f32,
    /// Probability that dropout keeps a value.
    pub keep: f32,
    /// Weight of foresight ([`SelfModel::foresight`]) against the ELBO.
    pub foresight: f32,
    /// Share of the phases, the first ones, over which the weight of the ELBO's divergence grows from 0 to 1.
    pub warming: f32,
    /// Share of the phases, the last ones, over which the learning rate falls to nothing.
    pub cooling: f32,
    /// Soft actor-critic's, where actions are numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sac: Option<SacSettings>,
    /// Deep Q-learning's, where they are choices.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dqn: Option<DqnSettings>,
}

impl SelfModelSettings {
    /// What ships for a domain ([`crate::config`]).
    pub fn of(domain: &str) -> Self {
        config::self_model(domain)
    }

    /// The weight of the divergence in a phase.
    pub fn divergence_at(&self, phase: u32) -> f32 {
        let warming = (self.warming * self.phases as f32).max(1.0);
        ((phase + 1) as f32 / warming).min(1.0)
    }

    /// The learning rate of a phase.
    pub fn rate_at(&self, phase: u32) -> f32 {
        let left = self.phases.saturating_sub(phase) as f32;
        let cooling = (self.cooling * self.phases as f32).max(1.0);
        self.learning_rate * (left / cooling).min(1.0)
    }

    /// β of a phase.
    pub fn expert_at(&self, phase: u32) -> f32 {
        self.expert * self.expert_decay.powi(phase as i32)
    }

    /// ε of a phase.
    pub fn explore_at(&self, phase: u32) -> f32 {
        self.explore * self.explore_decay.powi(phase as i32)
    }
}

impl Checked for SelfModelSettings {
    fn problem(&self) -> Option<String> {
        if !(2..=256).contains(&self.length) {
            return Some(format!("length must be from 2 to 256, not {}", self.length));
        }
        if !(crate::SHARDS..=100_000).contains(&self.sequences) {
            let (least, found) = (crate::SHARDS, self.sequences);
            return Some(format!(
                "sequences must be from {least} to 100000, not {found}"
            ));
        }
        if self.rounds == 0 || !(1000..=10_000_000).contains(&self.replay) {
            return Some("rounds must be at least 1, replay from 1000 to 10000000".to_owned());
        }
        let positive = |x: f32| x.is_finite() && x > 0.0;
        if !positive(self.learning_rate) || !positive(self.gradient_clip) {
            return Some("learning_rate and gradient_clip must be positive".to_owned());
        }
        let shares = [
            self.expert,
            self.expert_decay,
            self.explore,
            self.explore_decay,
            self.keep,
            self.warming,
            self.cooling,
        ];
        if !shares.iter().all(|x| (0.0..=1.0).contains(x)) {
            let names = "expert, explore, their decays, keep, warming and cooling";
            return Some(format!("{names} must lie in [0, 1]"));
        }
        if !(self.foresight.is_finite() && self.foresight >= 0.0) {
            return Some("foresight must not be negative".to_owned());
        }
        match (&self.sac, &self.dqn) {
            (Some(sac), None) => sac.problem(),
            (None, Some(dqn)) => dqn.problem(),
            _ => Some("there has to be one of sac and dqn".to_owned()),
        }
    }
}

/// What one phase gave: a line of the metrics file.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Metrics {
    /// Phase, from 0.
    pub phase: u32,
    /// Steps lived.
    pub steps: usize,
    /// Rounds that ended in a collision.
    pub collisions: u32,
    /// Mean reward of the rounds that the expert lived; absent where there was none.
    pub expert_reward: Option<f32>,
    /// Mean reward of the policy's rounds with full sight.
    pub policy_reward: Option<f32>,
    /// Mean reward of rounds with limited sight.
    pub limited_reward: Option<f32>,
    /// What was minimised.
    #[serde(flatten)]
    pub losses: Losses,
    /// α of soft actor-critic.
    pub temperature: Option<f32>,
    /// β.
    pub expert: f32,
    /// ε.
    pub explore: f32,
}

/// The losses of a gradient step, or their mean over several.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Losses {
    /// −ELBO.
    pub loss: f32,
    /// −Σ_m log p(x^m | z).
    pub reconstruction: f32,
    /// −log p(r | z).
    pub reward: f32,
    /// −log p(e | z).
    pub ending: f32,
    /// KL(q ‖ p).
    pub divergence: f32,
    /// L_f.
    pub foresight: f32,
    /// L_Q.
    pub value: f32,
    /// L_π of soft actor-critic; L_m of deep Q-learning.
    pub policy: f32,
    /// Mean log π of soft actor-critic.
    #[serde(skip)]
    pub log_density: f32,
}

impl Losses {
    /// Adds a share of other losses.
    fn accumulate(&mut self, other: Self, share: f32) {
        self.loss += share * other.loss;
        self.reconstruction += share * other.reconstruction;
        self.reward += share * other.reward;
        self.ending += share * other.ending;
        self.divergence += share * other.divergence;
        self.foresight += share * other.foresight;
        self.value += share * other.value;
        self.policy += share * other.policy;
        self.log_density += share * other.log_density;
    }
}

/// How policy and values are learned.
#[expect(clippy::large_enum_variant, reason = "there is one")]
pub(crate) enum Learner {
    Sac(Sac),
    Dqn(Dqn),
}

/// What of the schedule a gradient step needs.
#[derive(Clone, Copy)]
pub(crate) struct Schedule {
    /// Weight of the ELBO's divergence.
    pub divergence: f32,
    /// Weight of foresight.
    pub foresight: f32,
    /// β.
    pub expert: f32,
}

/// Share of the rounds that are lived with limited sight, where whoever acts can be.
const LIMITED: f32 = 0.7;

/// One shard's memory.
pub(crate) struct Worker {
    pub arena: Arena,
    pub gradients: Gradients,
    scratch: LearnerScratch,
}

#[expect(clippy::large_enum_variant, reason = "there is one for each shard")]
enum LearnerScratch {
    Sac(SacScratch),
    Dqn(DqnScratch),
}

impl Learner {
    /// # Panics
    /// If the settings are another learner's than the actions'.
    fn new(model: &SelfModel, settings: &SelfModelSettings) -> Self {
        match model.layout.actions {
            ActionSpace::Continuous(_) => {
                Self::Sac(Sac::new(model, settings.sac.expect("settings of sac")))
            }
            ActionSpace::Discrete(_) => {
                Self::Dqn(Dqn::new(model, settings.dqn.expect("settings of dqn")))
            }
        }
    }

    fn worker(&self, model: &SelfModel, shard: &Shard) -> Worker {
        Worker {
            arena: Arena::new(),
            gradients: Gradients::for_params(&model.parameters),
            scratch: match self {
                Self::Sac(_) => LearnerScratch::Sac(SacScratch::new(model, shard)),
                Self::Dqn(_) => LearnerScratch::Dqn(DqnScratch::default()),
            },
        }
    }

    /// Parameters that follow the model's.
    pub fn targets(&self) -> &Parameters {
        match self {
            Self::Sac(sac) => &sac.targets.parameters,
            Self::Dqn(dqn) => &dqn.target.parameters,
        }
    }

    /// See [`Self::targets`].
    pub fn targets_mut(&mut self) -> &mut Parameters {
        match self {
            Self::Sac(sac) => &mut sac.targets.parameters,
            Self::Dqn(dqn) => &mut dqn.target.parameters,
        }
    }

    /// Parts whose gradients are clipped apart: the world model first.
    fn parts(&self) -> &[Vec<ParamId>] {
        match self {
            Self::Sac(sac) => &sac.parts,
            Self::Dqn(dqn) => &dqn.parts,
        }
    }

    /// Losses and gradients of one shard.
    fn step(
        &self,
        model: &SelfModel,
        worker: &mut Worker,
        shard: &Shard,
        schedule: Schedule,
    ) -> Losses {
        worker.gradients.zero();
        let (arena, gradients) = (&mut worker.arena, &mut worker.gradients);
        match (self, &mut worker.scratch) {
            (Self::Sac(sac), LearnerScratch::Sac(scratch)) => {
                sac.step(model, shard, schedule, scratch, arena, gradients)
            }
            (Self::Dqn(dqn), LearnerScratch::Dqn(scratch)) => {
                dqn.step(model, shard, schedule, scratch, arena, gradients)
            }
            _ => unreachable!("a worker is made by its learner"),
        }
    }
}

/// A training run that can be stopped after any phase.
pub struct Trainer {
    /// The model being trained.
    pub model: SelfModel,
    /// Settings.
    pub settings: SelfModelSettings,
    /// Phases done.
    pub phase: u32,
    pub(crate) learner: Learner,
    pub(crate) adam: Adam,
    pub(crate) replay: Replay,
    rollout: Rollout,
    drawing: Drawing,
    workers: Vec<Worker>,
}

impl Trainer {
    /// A run from nothing, with networks of the sizes that ship.
    ///
    /// # Panics
    /// If the settings make no sense ([`Checked::problem`]) in this world.
    pub fn new(environment: Box<dyn Environment>, settings: SelfModelSettings) -> Self {
        let sizes = Sizes::of(environment.layout());
        Self::with_sizes(environment, settings, sizes)
    }

    /// As [`Self::new`], with networks of these sizes.
    ///
    /// # Panics
    /// See [`Self::new`].
    pub fn with_sizes(
        environment: Box<dyn Environment>,
        settings: SelfModelSettings,
        sizes: Sizes,
    ) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        let model = SelfModel::new(sizes, Arc::clone(environment.layout()), &mut rng);
        Self::with_model(environment, model, settings)
    }

    /// A run that starts from `model`.
    ///
    /// # Panics
    /// See [`Self::new`].
    pub fn with_model(
        environment: Box<dyn Environment>,
        model: SelfModel,
        settings: SelfModelSettings,
    ) -> Self {
        let SelfModelSettings {
            sequences,
            length,
            keep,
            ..
        } = settings;
        let drawing = Drawing::new(&model, sequences, length, keep);
        let learner = Learner::new(&model, &settings);
        let shards = drawing.shards.iter();
        let all = model.parameters.ids().collect();
        Self {
            workers: shards.map(|shard| learner.worker(&model, shard)).collect(),
            rollout: Rollout::new(environment, &model),
            adam: Adam::new(&model.parameters, all, settings.learning_rate),
            replay: Replay::new(settings.replay, &model.layout),
            phase: 0,
            settings,
            learner,
            drawing,
            model,
        }
    }

    /// Whether every phase is done.
    pub fn is_done(&self) -> bool {
        self.phase >= self.settings.phases
    }

    /// Lives some rounds and learns from the buffer.
    pub fn phase(&mut self) -> Metrics {
        let settings = self.settings;
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        rng.set_stream(u64::from(self.phase) + 1);
        let expert = settings.expert_at(self.phase);
        let explore = settings.explore_at(self.phase);
        let slips = settings.dqn.map_or(0.0, |dqn| dqn.slips);
        // Expert, policy, policy with limited sight: sum of rewards and rounds.
        let mut rewards = [(0.0, 0_u32); 3];
        let (mut steps, mut collisions, mut earned) = (0, 0, Vec::new());
        for round in 0..settings.rounds {
            let by_expert = rng.random::<f32>() < expert;
            let limited = rng.random::<f32>() < LIMITED && (!by_expert || self.rollout.has_peer());
            let actor = match by_expert {
                true if limited => Actor::Peer,
                true => Actor::Expert { slips },
                false => Actor::Policy {
                    explore: explore.max(slips),
                    limited,
                },
            };
            let number = self.phase * settings.rounds + round;
            let (lived, episode) = self
                .rollout
                .episode(&self.model, actor, settings.seed, number);
            self.replay.push(episode.clone());
            earned.extend_from_slice(&episode.reward[1..]);
            let who = match (by_expert, limited) {
                (true, false) => 0,
                (false, false) => 1,
                (_, true) => 2,
            };
            rewards[who].0 += lived.reward;
            rewards[who].1 += 1;
            steps += lived.steps;
            collisions += u32::from(lived.end == domains::discrete::End::Collision);
        }
        self.model.note_rewards(earned);
        let mut losses = Losses::default();
        self.adam.learning_rate = settings.rate_at(self.phase);
        let schedule = Schedule {
            divergence: settings.divergence_at(self.phase),
            foresight: settings.foresight,
            expert,
        };
        for _ in 0..settings.gradient_steps {
            if !self.drawing.draw(&self.model, &self.replay, &mut rng) {
                break;
            }
            let step = self.gradient_step(schedule, &mut rng);
            losses.accumulate(step, 1.0 / settings.gradient_steps as f32);
        }
        let mean = |who: usize| {
            let (sum, rounds): (f32, u32) = rewards[who];
            (rounds > 0).then(|| sum / rounds as f32)
        };
        let metrics = Metrics {
            phase: self.phase,
            steps,
            collisions,
            expert_reward: mean(0),
            policy_reward: mean(1),
            limited_reward: mean(2),
            losses,
            temperature: match &self.learner {
                Learner::Sac(sac) => Some(sac.temperature()),
                Learner::Dqn(_) => None,
            },
            expert,
            explore,
        };
        self.phase += 1;
        metrics
    }

    /// One step of Adam on the batch that was drawn.
    fn gradient_step(&mut self, schedule: Schedule, rng: &mut ChaCha8Rng) -> Losses {
        for worker in &mut self.workers {
            if let LearnerScratch::Sac(scratch) = &mut worker.scratch {
                scratch.draw(rng);
            }
        }
        let (model, learner) = (&self.model, &self.learner);
        let mut losses = Losses::default();
        let share = 1.0 / self.workers.len() as f32;
        std::thread::scope(|scope| {
            let mut jobs = self.workers.iter_mut().zip(&self.drawing.shards);
            let own = jobs.next();
            let others: Vec<_> = jobs
                .map(|(worker, shard)| {
                    scope.spawn(move || learner.step(model, worker, shard, schedule))
                })
                .collect();
            if let Some((worker, shard)) = own {
                losses.accumulate(learner.step(model, worker, shard, schedule), share);
            }
            for job in others {
                match job.join() {
                    Ok(shard) => losses.accumulate(shard, share),
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
        });
        let (first, rest) = self.workers.split_at_mut(1);
        let gradients = &mut first[0].gradients;
        for other in rest.iter() {
            gradients.add(&other.gradients);
        }
        for part in self.learner.parts() {
            gradients.scale(part, share);
            gradients.clip(part, self.settings.gradient_clip);
        }
        self.adam.step(&mut self.model.parameters, gradients);
        let online = &self.model.parameters;
        match &mut self.learner {
            Learner::Sac(sac) => {
                sac.follow(online, losses.log_density, self.settings.learning_rate)
            }
            Learner::Dqn(dqn) => dqn.follow(online),
        }
        losses
    }

    /// Rounds 0, 1, … of `seed` by the expert or by what was learned so far.
    pub fn evaluate(&mut self, actor: Actor, seed: u64, rounds: u32) -> Vec<EpisodeSummary> {
        let mut live = |round| self.rollout.episode(&self.model, actor, seed, round).0;
        (0..rounds).map(&mut live).collect()
    }
}
