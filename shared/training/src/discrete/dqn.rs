//! `mirror train self` of a gridworld: the self-model from nothing, by ELBO and deep Q-learning on its latent states (paper §III-A
//! and appendix, "Model Architectures and Training").
//!
//! ```text
//! L   = −L_e + L_Q + w L_m
//! L_Q = E[(Q_ψ(z_t, a_t) − G_t)²]                                      ψ' ← ψ' + rate (ψ − ψ')
//! G_t = r_{t+1} + γ (1 − end_{t+1}) [(1 − λ_{t+1}) Q_ψ'(z_{t+1}, a*_{t+1}) + λ_{t+1} G_{t+1}]     a* = argmax_a Q_ψ(z, a)
//! L_m = E[max_a (Q_ψ(z_t, a) + m [a ≠ a^E_t]) − Q_ψ(z_t, a^E_t)]
//! ```
//!
//! Refinements of the paper's DQN, each with its reason:
//!
//! - The action is chosen by ψ and valued by ψ' (double Q-learning, van Hasselt et al. 2016): the plain maximum overestimates, and
//!   likelihoods and plans rest on the values themselves.
//! - Returns are followed along the sequence for as long as the action taken is the best one (Watkins' Q(λ); λ_t = 0 elsewhere):
//!   a rescue lies 24 steps ahead, and a training of minutes has no time to pass its value back step by step.
//! - L_m values the expert's action a^E above every other by a margin m (Hester et al. 2018, DQfD), in every state lived, whoever
//!   acted in it, so that the policy also learns the way back from where it strayed (Ross et al. 2011). Two actions' values often
//!   differ by less than the network's error: without L_m, now this, now that scenario of search and rescue ended between two cells
//!   of a corridor. Together with the cooling of the rate and sequences that end where rounds end, it gives the expert's return;
//!   which of the three does how much was not measured. The expert sees everything, so that what it does is a demonstration only to those who do: L_m counts where nothing was
//!   dropped, and what to do on partial sight is left to L_Q. (On the highway, SAC's loss is mixed with imitation, too.)
//! - Where there are images, q_φ learns from L_Q and L_m beside the ELBO (as in Yarats et al. 2021, SAC+AE). What matters of bomb
//!   defusal's image is one of six terminals, a sixth of what there is to reconstruct: z alone did not come to hold it within 2,500
//!   gradient steps; with their help it did in 1,800. Without images, z is a constant to L_Q.
//! - There, too, the ELBO's divergence counts little at first (Bowman et al. 2016): z begins as noise, and would be given up before
//!   it is of use. (Bomb defusal's terminals were read after 1,900 steps, without this not within 3,000.)
//! - At the end the learning rate falls to nothing, so that what is kept does not depend on the last few batches.
//!
//! A phase lives some rounds (each by the expert with probability β, else ε-greedily; in bomb defusal both slip now and then,
//! see [`Settings::slips`]) and then makes gradient steps on all
//! losses at once. Randomness is drawn anew from (seed, phase), and a checkpoint holds weights, target, optimiser and replay:
//! stopping and resuming gives the same bytes as not stopping.

use super::batch::{Drawing, Dropout};
use super::losses::{Losses, Worker};
use super::replay::Replay;
use super::rollout::{Actor, Rollout};
use super::settings::Settings;
use domains::discrete::{Discrete, World};
use models::{SelfModel, Sizes};
use nn::{Adam, ParamId, Parameters};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::sync::Arc;

/// What one phase gave: a line of the metrics file.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Metrics {
    /// Phase, from 0.
    pub phase: u32,
    /// Mean reward of the rounds that the expert lived; absent where there was none.
    pub expert_reward: Option<f32>,
    /// Mean reward of the policy's rounds with full sight.
    pub policy_reward: Option<f32>,
    /// Mean reward of the policy's rounds with limited sight.
    pub limited_reward: Option<f32>,
    /// −ELBO.
    pub loss: f32,
    /// Reconstruction term.
    pub reconstruction: f32,
    /// Reward term.
    pub reward: f32,
    /// KL term.
    pub divergence: f32,
    /// L_Q.
    pub q: f32,
    /// L_m.
    pub imitation: f32,
    /// β.
    pub expert: f32,
    /// ε.
    pub explore: f32,
}

/// A training run that can be stopped after any phase.
pub struct Trainer {
    /// The model being trained.
    pub model: SelfModel,
    /// Settings.
    pub settings: Settings,
    /// Phases done.
    pub phase: u32,
    /// ψ', with everything else beside it, unused.
    pub(super) target: SelfModel,
    pub(super) adam: Adam,
    pub(super) replay: Replay,
    rollout: Rollout,
    drawing: Drawing,
    workers: Vec<Worker>,
    world_ids: Vec<ParamId>,
    q_ids: Vec<ParamId>,
}

impl Trainer {
    /// A run from nothing in a world of the original setting.
    pub fn new(world: World, settings: Settings) -> Self {
        let sizes = Sizes::of(world.layout());
        Self::with_sizes(world, settings, sizes)
    }

    /// As [`Self::new`], with networks of these sizes.
    pub fn with_sizes(world: World, settings: Settings, sizes: Sizes) -> Self {
        let layout = Arc::new(world.layout().clone());
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        let model = SelfModel::new(sizes, layout, &mut rng);
        Self::with_model(world, model, settings)
    }

    /// A run that starts from `model`.
    pub fn with_model(world: World, model: SelfModel, settings: Settings) -> Self {
        let drawing = Drawing::new(&model, settings.sequences, settings.length);
        let workers = drawing
            .shards
            .iter()
            .map(|_| Worker::new(&model.parameters))
            .collect();
        let (q_ids, world_ids): (Vec<_>, Vec<_>) = model
            .parameters
            .ids()
            .partition(|id| model.parameters.name(*id).starts_with("q."));
        let all = model.parameters.ids().collect();
        let shape = model.sizes.shape;
        Self {
            rollout: Rollout::new(world, &model),
            target: model.clone(),
            adam: Adam::new(&model.parameters, all, settings.learning_rate),
            replay: Replay::new(settings.replay, shape.visual, shape.verbal),
            phase: 0,
            settings,
            drawing,
            workers,
            world_ids,
            q_ids,
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
        let decayed = |first: f32, factor: f32| first * factor.powi(self.phase as i32);
        let expert = decayed(settings.expert, settings.expert_decay);
        let explore = decayed(settings.explore, settings.explore_decay);
        // Expert, policy, policy with limited sight: sum of rewards and rounds.
        let mut lived = [(0.0, 0_u32); 3];
        for round in 0..settings.rounds {
            let who = match rng.random::<f32>() < expert {
                true => 0,
                false if rng.random::<bool>() => 1,
                false => 2,
            };
            let actor = match who {
                0 => Actor::Expert {
                    slips: settings.slips,
                },
                who => Actor::Greedy {
                    explore: explore.max(settings.slips),
                    limited: who == 2,
                },
            };
            let number = self.phase * settings.rounds + round;
            let (result, episode) = self
                .rollout
                .episode(&self.model, actor, settings.seed, number);
            self.replay.push(episode.clone());
            lived[who].0 += result.reward;
            lived[who].1 += 1;
        }
        let mut sums = Losses::default();
        self.adam.learning_rate = settings.rate_at(self.phase);
        for _ in 0..settings.gradient_steps {
            let dropout = Dropout {
                keep: settings.keep,
            };
            self.drawing
                .draw(&self.model, &self.replay, dropout, &mut rng);
            let losses = self.gradient_step();
            sums.accumulate(losses, 1.0 / settings.gradient_steps as f32);
        }
        let mean = |who: usize| {
            let (sum, rounds): (f32, u32) = lived[who];
            (rounds > 0).then(|| sum / rounds as f32)
        };
        let metrics = Metrics {
            phase: self.phase,
            expert_reward: mean(0),
            policy_reward: mean(1),
            limited_reward: mean(2),
            loss: sums.loss,
            reconstruction: sums.reconstruction,
            reward: sums.reward,
            divergence: sums.divergence,
            q: sums.q,
            imitation: sums.imitation,
            expert,
            explore,
        };
        self.phase += 1;
        metrics
    }

    /// One step of Adam on the batch that was drawn.
    fn gradient_step(&mut self) -> Losses {
        let (model, target, settings) = (&self.model, &self.target, &self.settings);
        let divergence = settings.divergence_at(self.phase);
        let mut losses = Losses::default();
        let share = 1.0 / self.workers.len() as f32;
        std::thread::scope(|scope| {
            let mut jobs = self.workers.iter_mut().zip(&self.drawing.shards);
            let own = jobs.next();
            let others: Vec<_> = jobs
                .map(|(worker, shard)| {
                    scope.spawn(move || worker.step(model, target, shard, settings, divergence))
                })
                .collect();
            if let Some((worker, shard)) = own {
                losses.accumulate(
                    worker.step(model, target, shard, settings, divergence),
                    share,
                );
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
        for part in [&self.world_ids, &self.q_ids] {
            gradients.scale(part, share);
            gradients.clip(part, self.settings.gradient_clip);
        }
        self.adam.step(&mut self.model.parameters, gradients);
        follow(
            &mut self.target.parameters,
            &self.model.parameters,
            &self.q_ids,
            self.settings.target_rate,
        );
        losses
    }
}

/// ψ' ← ψ' + rate (ψ − ψ') of these parameters.
pub(super) fn follow(target: &mut Parameters, source: &Parameters, ids: &[ParamId], rate: f32) {
    for &id in ids {
        let source = source.get(id).data();
        for (target, source) in target.get_mut(id).data_mut().iter_mut().zip(source) {
            *target += rate * (source - *target);
        }
    }
}
