//! `mirror train self --domain highway`: the self-model from nothing, by ELBO and soft actor-critic (paper §III-A; sizes and
//! schedules from the appendix, "CARLA").
//!
//! An episode is lived (by the expert with probability β, else by the policy), then a number of gradient steps are
//! made. Randomness is drawn anew from (seed, episode), and a checkpoint holds weights, optimiser, targets and replay:
//! stopping and resuming gives the same bytes as not stopping.

use crate::batches::{Drawing, Dropout, Shard};
use crate::config::Checked;
use crate::replay::Replay;
use crate::rollout::{Actor, Rollout, Summary};
use crate::sac::{self, SacSettings, TargetCritics, TargetScratch, Transitions};
use domains::highway::{Scene, modalities};
use models::utterances::UtteranceTable;
use models::{SelfModel, Sizes};
use nn::{Adam, Arena, Gradients, ParamId, Tape, Tensor, noise};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Settings of a training run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Seed of everything: no configuration has it.
    #[serde(default)]
    pub seed: u64,
    /// Episodes lived.
    pub episodes: u32,
    /// Gradient steps after each.
    pub gradient_steps: usize,
    /// Sequences per gradient step.
    pub sequences: usize,
    /// Steps per sequence. Rather than 200 sequences of 3: with as many steps in longer sequences the belief learns to
    /// remember what it no longer sees.
    pub length: usize,
    /// Rate of Adam.
    pub learning_rate: f32,
    /// Longest gradient, per part (world model, critics, actor).
    pub gradient_clip: f32,
    /// Steps that the replay buffer holds.
    pub replay: usize,
    /// Share of imitation at the start.
    pub imitation: f32,
    /// Its factor per episode (the paper's).
    pub imitation_decay: f32,
    /// The actor's share of imitation falls no lower than this, while the expert's share of the driving goes on falling. With
    /// the paper's schedule alone, the few hundred episodes that a training of minutes has end with a policy that keeps
    /// its lane but has not yet found that changing it pays.
    pub imitation_floor: f32,
    /// s: deviation of the expert's action, before tanh, in the imitation term. Fixed: with the policy's own deviation, a
    /// likelihood that sharpens on the many moments of cruising explodes on the few in which the expert taps the brake.
    pub imitation_deviation: f32,
    /// Random actions at the start.
    pub explore: f32,
    /// Their factor per episode.
    pub explore_decay: f32,
    /// Probability that dropout keeps a value.
    pub keep: f32,
    /// Soft actor-critic's.
    pub sac: SacSettings,
}

impl Default for Settings {
    /// What ships ([`crate::config`]).
    fn default() -> Self {
        crate::config::highway().self_model
    }
}

impl Checked for Settings {
    fn problem(&self) -> Option<String> {
        if !(2..=64).contains(&self.length) {
            return Some(format!("length must be from 2 to 64, not {}", self.length));
        }
        if !(crate::SHARDS..=100_000).contains(&self.sequences) {
            return Some(format!(
                "sequences must be from {} to 100000, not {}",
                crate::SHARDS,
                self.sequences
            ));
        }
        if !(1000..=10_000_000).contains(&self.replay) {
            return Some(format!(
                "replay must be from 1000 to 10000000 steps, not {}",
                self.replay
            ));
        }
        let positive = |x: f32| x.is_finite() && x > 0.0;
        if !positive(self.learning_rate)
            || !positive(self.gradient_clip)
            || !positive(self.imitation_deviation)
        {
            return Some(
                "learning_rate, gradient_clip and imitation_deviation must be positive".to_owned(),
            );
        }
        if !self.sac.is_sound() {
            return Some(
                "sac: discount and target_rate lie in [0, 1], initial_temperature is positive"
                    .to_owned(),
            );
        }
        let unit = |x: f32| (0.0..=1.0).contains(&x);
        let shares = [
            self.imitation,
            self.imitation_decay,
            self.imitation_floor,
            self.explore,
            self.explore_decay,
            self.keep,
        ];
        (!shares.into_iter().all(unit))
            .then(|| "imitation, explore, their decays and keep must lie in [0, 1]".to_owned())
    }
}

/// What one episode and its gradient steps gave: a line of the metrics file.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Metrics {
    /// Episode, from 0.
    pub episode: u32,
    /// Steps of the episode.
    pub steps: usize,
    /// Sum of its rewards.
    pub episode_reward: f32,
    /// Whether it ended in a collision.
    pub collided: bool,
    /// Whether the expert drove.
    pub expert: bool,
    /// Whether the policy drove with limited sight.
    pub limited: bool,
    /// −ELBO.
    pub loss: f32,
    /// Reconstruction term.
    pub reconstruction: f32,
    /// Reward term.
    pub reward: f32,
    /// KL term.
    pub divergence: f32,
    /// L_Q.
    pub critic: f32,
    /// L_π.
    pub actor: f32,
    /// α.
    pub temperature: f32,
    /// β.
    pub imitation: f32,
}

/// A training run that can be stopped after any episode.
pub struct Trainer {
    /// The model being trained.
    pub model: SelfModel,
    /// Settings.
    pub settings: Settings,
    /// Episodes done.
    pub episode: u32,
    pub(crate) targets: TargetCritics,
    pub(crate) adam: Adam,
    pub(crate) log_temperature: f32,
    /// Adam's moments of log α: first, second, steps.
    pub(crate) temperature_moments: [f32; 3],
    pub(crate) replay: Replay,
    sac: SacSettings,
    table: UtteranceTable,
    rollout: Rollout,
    drawing: Drawing,
    workers: Vec<Worker>,
    parts: Parts,
}

/// The parameters of each part, clipped apart.
struct Parts {
    world: Vec<ParamId>,
    critics: Vec<ParamId>,
    actor: Vec<ParamId>,
}

/// One shard's memory.
struct Worker {
    arena: Arena,
    gradients: Gradients,
    transitions: Transitions,
    targets: TargetScratch,
}

/// A shard's losses.
#[derive(Clone, Copy, Default)]
struct Losses {
    loss: f32,
    reconstruction: f32,
    reward: f32,
    divergence: f32,
    critic: f32,
    actor: f32,
    log_density: f32,
}

impl Trainer {
    /// A run from nothing, with the networks that ship.
    ///
    /// # Errors
    /// If the scene's road cannot be built.
    pub fn new(
        scene: Arc<Scene>,
        table: UtteranceTable,
        settings: Settings,
    ) -> Result<Self, domains::highway::road::RoadError> {
        let sizes = Sizes::of(&modalities::layout());
        Self::with_sizes(scene, table, settings, sizes)
    }

    /// A run from nothing.
    ///
    /// # Errors
    /// If the scene's road cannot be built.
    pub fn with_sizes(
        scene: Arc<Scene>,
        table: UtteranceTable,
        settings: Settings,
        sizes: Sizes,
    ) -> Result<Self, domains::highway::road::RoadError> {
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        let model = SelfModel::new(sizes, modalities::layout(), &mut rng);
        let ids = |prefixes: &[&str]| -> Vec<ParamId> {
            model
                .parameters
                .iter()
                .filter(|(_, name, _)| prefixes.iter().any(|p| name.starts_with(p)))
                .map(|(id, _, _)| id)
                .collect()
        };
        let parts = Parts {
            world: ids(&[
                "transition",
                "first",
                "encoder",
                "visual",
                "verbal",
                "reward",
            ]),
            critics: ids(&["critic"]),
            actor: ids(&["policy"]),
        };
        let all: Vec<ParamId> = model.parameters.iter().map(|(id, _, _)| id).collect();
        let drawing = Drawing::new(&model, settings.sequences, settings.length);
        let workers = drawing
            .shards
            .iter()
            .map(|shard| {
                let transitions = shard.batch.columns * (settings.length - 1);
                Worker {
                    arena: Arena::new(),
                    gradients: Gradients::for_params(&model.parameters),
                    transitions: Transitions::new(
                        model.sizes.latent,
                        model.sizes.shape.action,
                        transitions,
                    ),
                    targets: TargetScratch::new(model.sizes.shape.action, transitions),
                }
            })
            .collect();
        let sac = settings.sac;
        Ok(Self {
            rollout: Rollout::new(scene, &model)?,
            targets: TargetCritics::new(&model.parameters, model.policy.actor_critic().1),
            adam: Adam::new(&model.parameters, all, settings.learning_rate),
            log_temperature: sac.initial_temperature.ln(),
            temperature_moments: [0.0; 3],
            replay: Replay::new(settings.replay),
            episode: 0,
            model,
            settings,
            sac,
            table,
            drawing,
            workers,
            parts,
        })
    }

    /// β now.
    pub fn imitation(&self) -> f32 {
        self.settings.imitation * self.settings.imitation_decay.powi(self.episode as i32)
    }

    /// Lives one episode and learns from the buffer.
    pub fn episode(&mut self) -> Metrics {
        let Settings { seed, .. } = self.settings;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(u64::from(self.episode) + 1);
        let imitation = self.imitation();
        let expert = rng.random::<f32>() < imitation;
        let limited = !expert && rng.random::<bool>();
        let actor = if expert {
            Actor::Expert
        } else {
            Actor::Policy {
                explore: self.settings.explore
                    * self.settings.explore_decay.powi(self.episode as i32),
                limited,
            }
        };
        let replay = &mut self.replay;
        let lived = self
            .rollout
            .episode(&self.model, actor, seed, self.episode, |step| {
                replay.push(step);
            });
        let mut sums = Losses::default();
        let mut done = 0;
        for _ in 0..self.settings.gradient_steps {
            let dropout = Dropout {
                keep: self.settings.keep,
            };
            let (model, replay) = (&self.model, &self.replay);
            if !self
                .drawing
                .draw(model, replay, &self.table, dropout, &mut rng)
            {
                break;
            }
            let losses = self.gradient_step(imitation.max(self.settings.imitation_floor), &mut rng);
            sums.accumulate(losses);
            done += 1;
        }
        let mean = |sum: f32| sum / done.max(1) as f32;
        let metrics = Metrics {
            episode: self.episode,
            steps: lived.steps,
            episode_reward: lived.reward,
            collided: lived.collided,
            expert,
            limited,
            loss: mean(sums.loss),
            reconstruction: mean(sums.reconstruction),
            reward: mean(sums.reward),
            divergence: mean(sums.divergence),
            critic: mean(sums.critic),
            actor: mean(sums.actor),
            temperature: self.log_temperature.exp(),
            imitation,
        };
        self.episode += 1;
        metrics
    }

    /// One step of Adam on ELBO, critics, actor and temperature.
    fn gradient_step(&mut self, imitation: f32, rng: &mut ChaCha8Rng) -> Losses {
        let temperature = self.log_temperature.exp();
        for worker in &mut self.workers {
            noise::fill(worker.transitions.noise.data_mut(), rng.random(), 0);
            noise::fill(worker.transitions.next_noise.data_mut(), rng.random(), 0);
        }
        let (model, targets, parts, settings) = (&self.model, &self.targets, &self.parts, self.sac);
        let deviation = self.settings.imitation_deviation;
        let weights = [1.0 - imitation, 0.5 * imitation / (deviation * deviation)];
        let mut losses = Losses::default();
        std::thread::scope(|scope| {
            let jobs: Vec<_> = self
                .workers
                .iter_mut()
                .zip(&self.drawing.shards)
                .map(|(worker, shard)| {
                    scope.spawn(move || {
                        worker.step(model, targets, parts, shard, settings, temperature, weights)
                    })
                })
                .collect();
            let n = jobs.len() as f32;
            for job in jobs {
                match job.join() {
                    Ok(shard) => losses.accumulate(shard.scaled(1.0 / n)),
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
        });
        let (first, rest) = self.workers.split_at_mut(1);
        let gradients = &mut first[0].gradients;
        for other in rest.iter() {
            gradients.add(&other.gradients);
        }
        for part in [&self.parts.world, &self.parts.critics, &self.parts.actor] {
            gradients.scale(part, 1.0 / (rest.len() + 1) as f32);
            gradients.clip(part, self.settings.gradient_clip);
        }
        self.adam.step(&mut self.model.parameters, gradients);
        self.targets
            .follow(&self.model.parameters, self.sac.target_rate);
        self.temperature_step(temperature, losses.log_density);
        losses
    }

    /// Adam on log α, a single number.
    fn temperature_step(&mut self, temperature: f32, mean_log_density: f32) {
        let gradient = sac::temperature_gradient(temperature, mean_log_density, self.sac);
        let [first, second, steps] = &mut self.temperature_moments;
        *steps += 1.0;
        *first = 0.9 * *first + 0.1 * gradient;
        *second = 0.999 * *second + 0.001 * gradient * gradient;
        let mean = *first / (1.0 - 0.9_f32.powf(*steps));
        let square = *second / (1.0 - 0.999_f32.powf(*steps));
        self.log_temperature -= self.settings.learning_rate * mean / (square.sqrt() + 1e-8);
        // Imitation narrows the policy below the entropy that α aims at. Left alone, α would grow until entropy outweighed
        // everything else; so it may only fall.
        self.log_temperature = self.log_temperature.min(self.sac.initial_temperature.ln());
    }

    /// The policy's mode over `episodes` episodes that training never saw: mean reward and collision rate.
    pub fn evaluate(&mut self, episodes: u32) -> (f32, f32) {
        let mut total = Summary::default();
        let mut collisions = 0;
        for episode in 0..episodes {
            let lived = self.rollout.episode(
                &self.model,
                Actor::Mode,
                self.settings.seed ^ 0xe7a1,
                episode,
                |_| {},
            );
            total.reward += lived.reward;
            collisions += u32::from(lived.collided);
        }
        let n = episodes.max(1) as f32;
        (total.reward / n, collisions as f32 / n)
    }
}

impl Losses {
    fn accumulate(&mut self, other: Self) {
        self.loss += other.loss;
        self.reconstruction += other.reconstruction;
        self.reward += other.reward;
        self.divergence += other.divergence;
        self.critic += other.critic;
        self.actor += other.actor;
        self.log_density += other.log_density;
    }

    fn scaled(self, by: f32) -> Self {
        Self {
            loss: self.loss * by,
            reconstruction: self.reconstruction * by,
            reward: self.reward * by,
            divergence: self.divergence * by,
            critic: self.critic * by,
            actor: self.actor * by,
            log_density: self.log_density * by,
        }
    }
}

impl Worker {
    #[expect(
        clippy::too_many_arguments,
        reason = "one call from one place, all of different types"
    )]
    fn step(
        &mut self,
        model: &SelfModel,
        targets: &TargetCritics,
        parts: &Parts,
        shard: &Shard,
        settings: SacSettings,
        temperature: f32,
        weights: [f32; 2],
    ) -> Losses {
        self.gradients.zero();
        let mut losses = Losses::default();
        {
            let mut tape = Tape::new(&model.parameters, &mut self.arena);
            let elbo = model.negative_elbo(&mut tape, &shard.batch);
            losses.loss = tape.scalar(elbo.loss);
            losses.reconstruction = tape.scalar(elbo.reconstruction);
            losses.reward = tape.scalar(elbo.reward);
            losses.divergence = tape.scalar(elbo.divergence);
            collect(&mut self.transitions, tape.value(elbo.z), shard);
            tape.backward(elbo.loss, &mut self.gradients, &|id| {
                parts.world.contains(&id)
            });
        }
        self.targets
            .compute(model, targets, &self.transitions, temperature, settings);
        {
            let mut tape = Tape::new(&model.parameters, &mut self.arena);
            let loss = sac::critic_loss(&mut tape, model, &self.transitions, &self.targets.y);
            losses.critic = tape.scalar(loss);
            tape.backward(loss, &mut self.gradients, &|id| parts.critics.contains(&id));
        }
        let mut tape = Tape::new(&model.parameters, &mut self.arena);
        let (loss, log_density) =
            sac::actor_loss(&mut tape, model, &self.transitions, temperature, weights);
        losses.actor = tape.scalar(loss);
        losses.log_density = tape.scalar(log_density);
        tape.backward(loss, &mut self.gradients, &|id| parts.actor.contains(&id));
        losses
    }
}

/// Gathers (z_t, a_t, r_{t+1}, z_{t+1}) of all steps of a shard, side by side. `z`: `latent × (steps · columns)`.
fn collect(out: &mut Transitions, z: &[f32], shard: &Shard) {
    let (batch, columns) = (&shard.batch, shard.batch.columns);
    let earlier = |to: &mut Tensor, from: &[f32]| {
        let n = to.data().len();
        to.data_mut().copy_from_slice(&from[..n]);
    };
    let later = |to: &mut Tensor, from: &[f32]| {
        let first = to.rows() * columns;
        to.data_mut().copy_from_slice(&from[first..]);
    };
    earlier(&mut out.z, z);
    later(&mut out.next, z);
    later(&mut out.action, batch.action.data());
    later(&mut out.reward, batch.reward.data());
    earlier(&mut out.expert, shard.expert.data());
    later(&mut out.terminal, shard.terminal.data());
}
