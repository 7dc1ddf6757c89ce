//! `mirror train self` of a gridworld: the self-model from nothing, by ELBO and deep Q-learning on its latent states (paper §III-A
//! and appendix, "Model Architectures and Training").
//!
//! ```text
//! L_Q = E[(Q_ψ(z_t, a_t) − G_t)²]                                      ψ' ← ψ' + rate (ψ − ψ')
//! G_t = r_{t+1} + γ (1 − end_{t+1}) [(1 − λ_{t+1}) Q_ψ'(z_{t+1}, a*_{t+1}) + λ_{t+1} G_{t+1}]     a* = argmax_a Q_ψ(z, a)
//! ```
//!
//! Two refinements of the paper's DQN. The action is chosen by ψ and valued by ψ' (double Q-learning): the plain maximum
//! overestimates, and likelihoods and plans rest on the values themselves. And returns are followed along the sequence for as
//! long as the action taken is the best one (Watkins' Q(λ); λ_t = 0 elsewhere): a rescue lies 24 steps ahead, and a training of
//! minutes has no time to pass its value back step by step.
//!
//! A phase lives some rounds (each by the expert with probability β, else ε-greedily) and then makes gradient steps on both
//! losses at once; z is a constant to L_Q. Randomness is drawn anew from (seed, phase), and a checkpoint holds weights, target,
//! optimiser and replay: stopping and resuming gives the same bytes as not stopping.

use super::batch::{Drawing, Dropout, Shard};
use super::replay::{NO_ACTION, Replay};
use super::rollout::{Actor, Rollout};
use domains::discrete::{Discrete, Domain, World};
use models::discrete::{DiscreteModel, DiscreteScratch, Sizes};
use models::policy::largest;
use nn::{Adam, Arena, Gradients, ParamId, Parameters, Tape, Tensor};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Settings of a training run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Seed of everything.
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
    /// Rate of Adam: the paper's.
    pub learning_rate: f32,
    /// Longest gradient of the world model, and of the Q-network.
    pub gradient_clip: f32,
    /// Observations that the replay buffer holds.
    pub replay: usize,
    /// β at the start: the paper's.
    pub expert: f32,
    /// Its factor per phase.
    pub expert_decay: f32,
    /// ε at the start: the paper's.
    pub explore: f32,
    /// Its factor per phase.
    pub explore_decay: f32,
    /// Probability that dropout keeps a value, as on the highway.
    pub keep: f32,
    /// γ.
    pub discount: f32,
    /// Rate at which the target follows.
    pub target_rate: f32,
    /// λ where the best action was taken.
    pub trace: f32,
}

impl Settings {
    /// The paper's schedules for a domain, with lengths of training that keep DESIGN §9's budgets.
    pub fn of(domain: Domain) -> Self {
        let driving = Self {
            seed: 0,
            phases: 60,
            rounds: 16,
            gradient_steps: 150,
            sequences: 32,
            length: 16,
            learning_rate: 3e-4,
            gradient_clip: 100.0,
            replay: 100_000,
            expert: 0.5,
            expert_decay: 0.8,
            explore: 0.5,
            explore_decay: 0.75,
            keep: 0.35,
            discount: 0.95,
            target_rate: 0.01,
            trace: 0.8,
        };
        match domain {
            Domain::Driving => driving,
            // Short phases: what an expert never does is valued by extrapolation until the policy has tried it, so that the policy
            // has to act often.
            Domain::SearchRescue | Domain::BombDefusal => Self {
                phases: 600,
                rounds: 9,
                gradient_steps: 60,
                expert: 1.0,
                expert_decay: 0.98,
                explore_decay: 0.9,
                ..driving
            },
        }
    }

    /// A reason why these settings make no sense, if there is one.
    pub fn problem(&self) -> Option<String> {
        if !(2..=256).contains(&self.length) {
            return Some(format!("length must be from 2 to 256, not {}", self.length));
        }
        if !(crate::SHARDS..=100_000).contains(&self.sequences) {
            let (least, found) = (crate::SHARDS, self.sequences);
            return Some(format!(
                "sequences must be from {least} to 100000, not {found}"
            ));
        }
        if self.rounds == 0 || self.replay < 1000 {
            return Some("rounds must be at least 1 and replay at least 1000".to_owned());
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
            self.discount,
            self.target_rate,
            self.trace,
        ];
        (!shares.iter().all(|x| (0.0..=1.0).contains(x))).then(|| {
            "expert, explore, their decays, keep, discount, target_rate and trace must lie in [0, 1]"
                .to_owned()
        })
    }
}

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
    /// β.
    pub expert: f32,
    /// ε.
    pub explore: f32,
}

/// A training run that can be stopped after any phase.
pub struct Trainer {
    /// The model being trained.
    pub model: DiscreteModel,
    /// Settings.
    pub settings: Settings,
    /// Phases done.
    pub phase: u32,
    /// ψ', with everything else beside it, unused.
    pub(super) target: DiscreteModel,
    pub(super) adam: Adam,
    pub(super) replay: Replay,
    rollout: Rollout,
    drawing: Drawing,
    workers: Vec<Worker>,
    world_ids: Vec<ParamId>,
    q_ids: Vec<ParamId>,
}

/// One shard's memory.
struct Worker {
    arena: Arena,
    gradients: Gradients,
    scratch: DiscreteScratch,
    after: Tensor,
    future: Tensor,
    choices: Tensor,
    goal: Tensor,
    counts: Tensor,
    classes: Vec<u32>,
}

/// A shard's losses.
#[derive(Clone, Copy, Default)]
struct Losses {
    loss: f32,
    reconstruction: f32,
    reward: f32,
    divergence: f32,
    q: f32,
}

impl Losses {
    fn accumulate(&mut self, other: Self, share: f32) {
        self.loss += share * other.loss;
        self.reconstruction += share * other.reconstruction;
        self.reward += share * other.reward;
        self.divergence += share * other.divergence;
        self.q += share * other.q;
    }
}

impl Trainer {
    /// A run from nothing in a world of the original setting.
    pub fn new(world: World, settings: Settings) -> Self {
        let layout = Arc::new(world.layout().clone());
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        let model = DiscreteModel::new(Sizes::of(&layout), layout, &mut rng);
        Self::with_model(world, model, settings)
    }

    /// A run that starts from `model`.
    pub fn with_model(world: World, model: DiscreteModel, settings: Settings) -> Self {
        let drawing = Drawing::new(&model, settings.sequences, settings.length);
        let workers = drawing
            .shards
            .iter()
            .map(|_| Worker {
                arena: Arena::new(),
                gradients: Gradients::for_params(&model.parameters),
                scratch: DiscreteScratch::default(),
                after: Tensor::default(),
                future: Tensor::default(),
                choices: Tensor::default(),
                goal: Tensor::default(),
                counts: Tensor::default(),
                classes: Vec::new(),
            })
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
                0 => Actor::Expert,
                who => Actor::Greedy {
                    explore,
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
            expert,
            explore,
        };
        self.phase += 1;
        metrics
    }

    /// One step of Adam on the batch that was drawn.
    fn gradient_step(&mut self) -> Losses {
        let (model, target, settings) = (&self.model, &self.target, &self.settings);
        let mut losses = Losses::default();
        let share = 1.0 / self.workers.len() as f32;
        std::thread::scope(|scope| {
            let mut jobs = self.workers.iter_mut().zip(&self.drawing.shards);
            let own = jobs.next();
            let others: Vec<_> = jobs
                .map(|(worker, shard)| {
                    scope.spawn(move || worker.step(model, target, shard, settings))
                })
                .collect();
            if let Some((worker, shard)) = own {
                losses.accumulate(worker.step(model, target, shard, settings), share);
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

impl Worker {
    /// Gradients of both losses on one shard.
    fn step(
        &mut self,
        model: &DiscreteModel,
        target: &DiscreteModel,
        shard: &Shard,
        settings: &Settings,
    ) -> Losses {
        let batch = &shard.batch;
        let (columns, all) = (batch.columns, batch.steps * batch.columns);
        let transitions = all - columns;
        self.gradients.zero();
        let mut tape = Tape::new(&model.parameters, &mut self.arena);
        let terms = model.negative_elbo(&mut tape, batch);

        // G_t, from the last step to the first.
        let latent = model.sizes.latent;
        self.after.resize_to(latent, transitions);
        let z = &tape.value(terms.z)[latent * columns..];
        self.after.data_mut().copy_from_slice(z);
        target.q_values(&mut self.scratch, &self.after, &mut self.future);
        model.q_values(&mut self.scratch, &self.after, &mut self.choices);
        self.goal.resize_to(1, transitions);
        self.counts.resize_to(1, transitions);
        self.classes.clear();
        for j in (0..transitions).rev() {
            let next = j + columns;
            let best = largest(self.choices.column(j));
            let mut future = self.future.column(j)[best];
            if usize::from(shard.taken[next]) == best {
                // The last step's action is none, so that there is a G_{t+1} here.
                let followed = self.goal.data()[next];
                future += settings.trace * (followed - future);
            }
            let future = settings.discount * (1.0 - shard.terminal[next]) * future;
            self.goal.data_mut()[j] = batch.reward.data()[next] + future;
        }
        for (taken, counts) in shard.taken.iter().zip(self.counts.data_mut()) {
            let known = *taken != NO_ACTION;
            *counts = f32::from(u8::from(known));
            self.classes.push(if known { (*taken).into() } else { 0 });
        }
        let z = tape.stop(terms.z);
        let before = tape.columns(z, 0..transitions);
        let values = tape.mlp(&model.q, before);
        let chosen = tape.select_log_prob(values, &self.classes);
        let goal = tape.input(&self.goal);
        let error = tape.sub(chosen, goal);
        let squared = tape.square(error);
        let counts = tape.input(&self.counts);
        let counted = tape.mul(squared, counts);
        let sum = tape.sum(counted);
        let number: f32 = self.counts.data().iter().sum();
        let q = tape.scale(sum, 1.0 / number.max(1.0));
        let total = tape.add(terms.loss, q);
        tape.backward(total, &mut self.gradients, &|_| true);
        Losses {
            loss: tape.scalar(terms.loss),
            reconstruction: tape.scalar(terms.reconstruction),
            reward: tape.scalar(terms.reward),
            divergence: tape.scalar(terms.divergence),
            q: tape.scalar(q),
        }
    }
}
