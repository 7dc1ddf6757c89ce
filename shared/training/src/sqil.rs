//! Soft-Q imitation learning (`sqil`; Reddy et al. 2019): what the person did earns a reward, what the policy does in the world
//! by itself earns none, and a recurrent policy learns to earn by soft Bellman errors on equal parts of both (paper §IV-A).
//!
//! ```text
//! y   = r + γ (1 − end) V(h_{t+1}),   r = reward if demonstrated, else 0
//! L_Q = E[Σ_i (Q_i(h_t, a_t) − y)²]
//! choices:  Q is the dense layers' output, π(a | h) = exp((Q(h, a) − V(h)) / α),   V(h) = α log Σ_a exp(Q'(h, a) / α)
//! numbers:  π and twin critics as in [`crate::sac`],   V(h) = min_i Q'_i(h, a) − α log π(a | h),  a ~ π
//!           L_π = E[α log π(a | h) − min_i Q_i(h, a)]   moves the policy's dense layers, L_Q all else
//! ```
//!
//! The policy perceives as the person would. Learning stops early by the likelihood of validation rounds, or after a number of
//! phases.

use crate::cloning::mean_nll;
use crate::config::{self, Checked};
use crate::environment::{Environment, is_whole};
use crate::record::words;
use crate::rounds::Round;
use crate::sac::{SoftValues, TargetCritics, soft_policy_terms};
use crate::trajectory::{Sequences, Trajectory};
use domains::{ActionSpace, Layout};
use models::policy::HeadScratch;
use models::{
    ActionDistribution, Beliefs, Communicated, HumanModel, Kind, Observations, RecurrentHuman,
    RecurrentPolicy, RecurrentSizes,
};
use nn::{Activation, Adam, Arena, Gradients, Mlp, ParamId, Tape, Tensor, noise};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SqilSettings {
    /// Adam's rate.
    pub learning_rate: f32,
    /// Largest norm of a gradient.
    pub gradient_clip: f32,
    /// Most phases; each lives some rounds, makes some gradient steps and is validated.
    pub phases: usize,
    /// Rounds lived in a phase.
    pub rounds: u32,
    /// Gradient steps in a phase.
    pub gradient_steps: usize,
    /// Windows of each kind in a gradient step: demonstrated, and lived.
    pub batch: usize,
    /// Steps of a window.
    pub window: usize,
    /// Steps of it that only build up h.
    pub burn_in: usize,
    /// EpisodeSummary rounds that are remembered.
    pub remembered: usize,
    /// Reward for what the person did.
    pub reward: f32,
    /// α of the soft policy.
    pub temperature: f32,
    /// γ.
    pub discount: f32,
    /// Rate at which the target follows.
    pub target_rate: f32,
    /// Phases without a new best after which learning stops; with 0 nothing is held out, and the last phase's policy is kept.
    pub patience: usize,
    /// Dense layers of the policy, and of its critics.
    pub layers: usize,
    /// Seed of weights and rounds.
    #[serde(default)]
    pub seed: u64,
}

impl SqilSettings {
    /// What ships for a domain ([`crate::config`]).
    pub fn of(domain: &str) -> Self {
        config::policies(domain).sqil
    }
}

impl Checked for SqilSettings {
    fn problem(&self) -> Option<String> {
        let positive = [self.learning_rate, self.gradient_clip, self.temperature];
        let shares = [self.discount, self.target_rate];
        let counts = [self.batch, self.remembered, self.rounds as usize];
        (!(1..=8).contains(&self.layers)
            || !(self.burn_in + 2..=100_000).contains(&self.window)
            || !counts.iter().all(|n| (1..=100_000).contains(n))
            || !positive.iter().all(|x| *x > 0.0)
            || !shares.iter().all(|x| (0.0..=1.0).contains(x)))
        .then(|| {
            "layers from 1 to 8; rounds, batch and remembered at least 1; window at least burn_in + 2; learning_rate, \
             gradient_clip and temperature positive; discount and target_rate in [0, 1]"
                .to_owned()
        })
    }
}

/// A world to live in, as the person perceives it.
pub struct Place {
    /// The world.
    pub environment: Box<dyn Environment>,
    /// What limits the person's sight there.
    pub limits: Vec<f32>,
    /// Utterances that they hear there without an assistant.
    pub heard: u32,
    /// Whether they are spoken to at random, as an expert is whose rounds are demonstrated.
    pub words: bool,
}

/// What one phase gave.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Mean L_Q.
    pub loss: f32,
    /// Mean negative log-likelihood of the validation rounds, where there are some.
    pub validation: Option<f32>,
}

/// What learning gave.
#[derive(Clone, Debug)]
pub struct Imitated {
    /// The policy, as it was when it did best on the validation rounds; without them, as it was in the end.
    pub policy: RecurrentPolicy,
    /// What its phase gave.
    pub progress: Progress,
}

/// Learns a policy of `sizes`, but for its layers, from `demonstrated` and in `places` by turns, at least one. Stops by `held`,
/// where there is something in it. `progress` hears of each phase, from 1.
///
/// # Panics
/// Without a place.
pub fn learn(
    places: &mut [Place],
    sizes: RecurrentSizes,
    demonstrated: &[Trajectory],
    held: &[Trajectory],
    settings: &SqilSettings,
    progress: &dyn Fn(usize, Progress),
) -> Imitated {
    let layout = Arc::clone(places[0].environment.layout());
    let held = Sequences::whole(held);
    let validated = |learner: &mut Learner| {
        let held = held.as_ref()?;
        Some(mean_nll(&learner.policy, held, &mut learner.arena))
    };
    let mut learner = Learner::new(settings, sizes, &layout);
    let used: Vec<&Trajectory> = demonstrated.iter().filter(|r| r.steps() > 0).collect();
    let mut lived: Vec<Trajectory> = Vec::new();
    let mut best = learner.policy.parameters.clone();
    let mut kept = Progress {
        validation: validated(&mut learner),
        ..Progress::default()
    };
    let mut waited = 0;
    for phase in 0..settings.phases {
        for round in 0..settings.rounds {
            let number = phase as u32 * settings.rounds + round;
            let turn = number as usize % places.len();
            let scenario = number / places.len() as u32;
            let round = learner.live(&mut places[turn], [number, scenario]);
            if lived.len() >= settings.remembered {
                lived.remove(0);
            }
            let policy = &learner.policy;
            lived.push(Trajectory::new(&round, &policy.view, policy.actions));
        }
        let own: Vec<&Trajectory> = lived.iter().filter(|r| r.steps() > 0).collect();
        let mut now = Progress::default();
        for _ in 0..settings.gradient_steps {
            now.loss += learner.step(&used, &own) / settings.gradient_steps as f32;
        }
        now.validation = validated(&mut learner);
        progress(phase + 1, now);
        let better = match (now.validation, kept.validation) {
            (Some(now), Some(least)) => now < least,
            _ => true,
        };
        if better {
            kept = now;
            best.copy_from(&learner.policy.parameters);
            waited = 0;
        } else {
            waited += 1;
            if waited >= settings.patience {
                break;
            }
        }
    }
    learner.policy.parameters = best;
    Imitated {
        policy: learner.without_critics(&layout),
        progress: kept,
    }
}

/// How the value of h, and of an action there, is learned.
enum Value {
    /// The policy's own output.
    Output {
        /// A policy that follows it.
        target: RecurrentPolicy,
        arena: Arena,
    },
    /// Networks beside it, whose parameters stand behind the policy's.
    Critics {
        critics: [Mlp; 2],
        targets: TargetCritics,
        soft: SoftValues,
        head: HeadScratch,
        noise: Tensor,
    },
}

/// Policy and values with all that moves them.
struct Learner {
    settings: SqilSettings,
    policy: RecurrentPolicy,
    value: Value,
    /// What L_Q moves, and what L_π does.
    value_ids: Vec<ParamId>,
    policy_ids: Vec<ParamId>,
    adam: Adam,
    gradients: Gradients,
    arena: Arena,
    rng: ChaCha8Rng,
}

impl Learner {
    fn new(settings: &SqilSettings, sizes: RecurrentSizes, layout: &Layout) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        let sizes = sizes.with_layers(settings.layers);
        let mut policy = RecurrentPolicy::new(sizes, layout, &mut rng);
        let value = match policy.actions {
            ActionSpace::Discrete(_) => Value::Output {
                target: policy.clone(),
                arena: Arena::new(),
            },
            ActionSpace::Continuous(actions) => {
                let mut widths = vec![sizes.hidden + actions];
                widths.extend(vec![sizes.dense; sizes.layers - 1]);
                widths.push(1);
                let critics = ["critic_1", "critic_2"].map(|name| {
                    let p = &mut policy.parameters;
                    Mlp::new(p, name, &widths, Activation::Identity, &mut rng)
                });
                Value::Critics {
                    targets: TargetCritics::new(&policy.parameters, &critics),
                    critics,
                    soft: SoftValues::new(actions),
                    head: HeadScratch::default(),
                    noise: Tensor::default(),
                }
            }
        };
        let all: Vec<ParamId> = policy.parameters.ids().collect();
        let of_policy = |id: &ParamId| policy.parameters.name(*id).starts_with("head");
        let (policy_ids, value_ids) = match &value {
            Value::Output { .. } => (Vec::new(), all.clone()),
            Value::Critics { .. } => all.iter().copied().partition(of_policy),
        };
        Self {
            settings: *settings,
            adam: Adam::new(&policy.parameters, all, settings.learning_rate),
            gradients: Gradients::for_params(&policy.parameters),
            policy,
            value,
            value_ids,
            policy_ids,
            arena: Arena::new(),
            rng,
        }
    }

    /// The policy by itself.
    fn without_critics(self, layout: &Layout) -> RecurrentPolicy {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut policy = RecurrentPolicy::new(self.policy.sizes, layout, &mut rng);
        let ids: Vec<ParamId> = policy.parameters.ids().collect();
        for id in ids {
            // Created first, in the same order.
            let source = self.policy.parameters.get(id);
            policy.parameters.get_mut(id).copy_from(source);
        }
        policy
    }

    /// A round of the policy itself, perceiving as the person would.
    fn live(&mut self, place: &mut Place, [episode, scenario]: [u32; 2]) -> Round {
        let environment = &mut *place.environment;
        let layout = Arc::clone(environment.layout());
        let mut human = RecurrentHuman::new(
            Kind::Sqil,
            Arc::new(self.policy.clone()),
            &layout,
            place.limits.clone(),
            place.heard,
        );
        let shape = self.policy.sizes.model.shape;
        let mut beliefs = Beliefs::new(human.latent(), 1);
        let mut distribution = ActionDistribution::new(human.actions(), 1);
        let mut observations = Observations::new(&shape, 1);
        let mut action = Tensor::new(shape.action, 1);
        let mut chance = vec![0.0; human.noise_rows()];
        let mut draws = [0.0; 8];
        let seed = self.settings.seed;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream((1 << 41) + u64::from(episode));
        let mut round = Round::default();
        environment.reset(seed, episode, scenario);
        while environment.end().is_running() {
            let Observations { visual, verbal } = &mut observations;
            environment.observe(visual.column_mut(0), verbal.column_mut(0));
            noise::fill(&mut chance, rng.random(), 0);
            let told = match place.words {
                true => Communicated::new(0, words(layout.utterances, &mut rng)),
                false => Communicated::default(),
            };
            human.perceive(&mut beliefs, &action, &observations, &[told], Some(&chance));
            human.act(&beliefs, &mut distribution);
            noise::fill(&mut draws, rng.random(), 0);
            distribution.sample(Some(&draws), &mut action);
            let taken = action.column(0);
            let reward = environment.step(taken);
            let seen = [observations.visual.column(0), observations.verbal.column(0)];
            round.push(seen, human.perceived(), taken, reward);
        }
        round.ended = is_whole(layout.actions, environment.end());
        round
    }

    /// Some windows of rounds, each drawn by itself.
    fn draw(&mut self, rounds: &[&Trajectory]) -> Option<Sequences> {
        if rounds.is_empty() {
            return None;
        }
        let (window, rng) = (self.settings.window, &mut self.rng);
        let mut draw = |_| {
            let round = rounds[rng.random_range(0..rounds.len())];
            let start = match round.steps().checked_sub(window) {
                None | Some(0) => 0,
                Some(latest) => rng.random_range(0..=latest),
            };
            (round, start)
        };
        let drawn: Vec<_> = (0..self.settings.batch).map(&mut draw).collect();
        Some(Sequences::new(&drawn, window))
    }

    /// One step of Adam; L_Q.
    fn step(&mut self, demonstrated: &[&Trajectory], own: &[&Trajectory]) -> f32 {
        let settings = self.settings;
        self.gradients.zero();
        let batches = [self.draw(demonstrated), self.draw(own)];
        let mut loss = 0.0;
        for (batch, reward) in batches.iter().zip([settings.reward, 0.0]) {
            // Nothing may have been lived yet.
            loss += batch
                .as_ref()
                .map_or(0.0, |batch| self.soft_error(batch, reward));
        }
        for ids in [&self.value_ids, &self.policy_ids] {
            self.gradients.clip(ids, settings.gradient_clip);
        }
        self.adam.step(&mut self.policy.parameters, &self.gradients);
        let online = &self.policy.parameters;
        match &mut self.value {
            Value::Output { target, .. } => {
                target.parameters.lerp_from(online, settings.target_rate);
            }
            Value::Critics { targets, .. } => targets.follow(online, settings.target_rate),
        }
        loss
    }

    /// L_Q of a batch; adds its gradients, and those of L_π.
    fn soft_error(&mut self, batch: &Sequences, reward: f32) -> f32 {
        let SqilSettings {
            discount,
            temperature,
            burn_in,
            ..
        } = self.settings;
        let (columns, all) = (batch.columns, batch.steps * batch.columns);
        let first = (burn_in * columns).min(all);
        let count = all - first;
        let policy = &self.policy;
        let (hidden, actions) = (policy.sizes.hidden, policy.actions.rows());
        let before = Tensor::new(hidden, columns);
        let mut tape = Tape::new(&policy.parameters, &mut self.arena);
        let h = policy.follow(&mut tape, &batch.observed, &batch.previous, &before);
        let h = tape.columns(h, first..all);
        let mut states = Tensor::default();
        let values = match &mut self.value {
            Value::Output { target, arena } => {
                let mut tape = Tape::new(&target.parameters, arena);
                let h = target.follow(&mut tape, &batch.observed, &batch.previous, &before);
                let q = tape.mlp(&target.head, h);
                let q = tape.value(q)[first * actions..].chunks_exact(actions);
                q.map(|q| soft_maximum(q, temperature)).collect()
            }
            Value::Critics {
                targets,
                soft,
                head,
                noise,
                ..
            } => {
                states = Tensor::from_slice(hidden, count, tape.value(h));
                noise.resize_to(actions, count);
                noise::fill(noise.data_mut(), self.rng.random(), 0);
                let p = &policy.parameters;
                soft.distribution.infer(&policy.head, 1.0, p, &states, head);
                soft.compute(&states, targets, noise.data(), temperature);
                std::mem::take(&mut soft.values)
            }
        };
        // A step counts where what follows it is known, or nothing does.
        let (there, last) = (&batch.weight.data()[first..], &batch.last.data()[first..]);
        let mut goal = Tensor::new(1, count);
        let mut weight = Tensor::new(1, count);
        for j in 0..count {
            let next = j + columns;
            let goes_on = next < count && there[next] > 0.0;
            if goes_on || last[j] > 0.0 {
                let future = if goes_on { values[next] } else { 0.0 };
                goal.data_mut()[j] = reward + discount * future;
                weight.data_mut()[j] = 1.0;
            }
        }
        let counted = weight.data().iter().sum::<f32>().max(1.0);
        let q = match &self.value {
            Value::Output { .. } => {
                let output = tape.mlp(&policy.head, h);
                vec![tape.select_log_prob(output, &batch.taken[first..])]
            }
            Value::Critics { critics, .. } => {
                let taken = tape.input_with(actions, count, |out| {
                    out.copy_from_slice(&batch.action.data()[first * actions..]);
                });
                let input = tape.concat(&[h, taken]);
                let critics = critics.iter();
                critics.map(|critic| tape.mlp(critic, input)).collect()
            }
        };
        let goal = tape.input(&goal);
        let weights = tape.input(&weight);
        let mut loss = None;
        for q in q {
            let error = tape.sub(q, goal);
            let squared = tape.square(error);
            let counts = tape.mul(squared, weights);
            let sum = tape.sum(counts);
            loss = Some(loss.map_or(sum, |loss| tape.add(loss, sum)));
        }
        let loss = tape.scale(loss.expect("there is a Q"), 1.0 / counted);
        let value_ids = &self.value_ids;
        tape.backward(loss, &mut self.gradients, &|id| value_ids.contains(&id));
        let critic_loss = tape.scalar(loss);
        if let Value::Critics { critics, noise, .. } = &mut self.value {
            noise::fill(noise.data_mut(), self.rng.random(), 1);
            let mut tape = Tape::new(&policy.parameters, &mut self.arena);
            let states = tape.input(&states);
            let output = tape.mlp(&policy.head, states);
            let soft = soft_policy_terms(&mut tape, (states, output), critics, noise, temperature);
            let weights = tape.input(&weight);
            let counts = tape.mul(soft.loss, weights);
            let sum = tape.sum(counts);
            let loss = tape.scale(sum, 1.0 / counted);
            let policy_ids = &self.policy_ids;
            tape.backward(loss, &mut self.gradients, &|id| policy_ids.contains(&id));
        }
        critic_loss
    }
}

/// α log Σ exp(q / α).
fn soft_maximum(q: &[f32], temperature: f32) -> f32 {
    let largest = q.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let sum: f32 = q.iter().map(|q| ((q - largest) / temperature).exp()).sum();
    largest + temperature * sum.ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::shipped;
    use domains::discrete::Setting;
    use domains::highway::modalities::{NAME, layout};
    use models::View;
    use models::policy::unsquash;

    fn few() -> SqilSettings {
        SqilSettings {
            layers: 2,
            phases: 6,
            gradient_steps: 120,
            batch: 4,
            window: 8,
            burn_in: 2,
            learning_rate: 3e-3,
            ..SqilSettings::of(NAME)
        }
    }

    /// Learned on the highway from people who always do the same, whatever there is to see.
    fn learned(action: [f32; 2], settings: &SqilSettings) -> RecurrentPolicy {
        let layout = layout();
        let mut place = Place {
            environment: shipped(NAME, Setting::Original).expect("it ships"),
            limits: vec![f32::INFINITY; layout.perception.limits()],
            heard: 0,
            words: false,
        };
        let demonstrated = Trajectory {
            observed: Tensor::new(View::new(&layout).rows(), 40),
            action: Tensor::from_slice(2, 40, &action.repeat(40)),
            ended: false,
        };
        let sizes = RecurrentSizes {
            hidden: 24,
            dense: 24,
            ..RecurrentSizes::of(&layout, 1)
        };
        let places = std::slice::from_mut(&mut place);
        learn(places, sizes, &[demonstrated], &[], settings, &|_, _| {}).policy
    }

    /// Mean of u after a few steps of nothing to see.
    fn habit(policy: &RecurrentPolicy) -> f32 {
        let nothing = |rows| Tensor::new(rows, 6);
        let (observed, previous) = (nothing(policy.view.rows()), nothing(2));
        let mut arena = Arena::new();
        let mut tape = Tape::new(&policy.parameters, &mut arena);
        let before = Tensor::new(policy.sizes.hidden, 1);
        let h = policy.follow(&mut tape, &observed, &previous, &before);
        let output = tape.mlp(&policy.head, h);
        tape.value(output)[5 * 4]
    }

    #[test]
    fn it_does_as_people_do() {
        let (slow, fast) = (learned([-0.7, 0.0], &few()), learned([0.7, 0.0], &few()));
        let apart = unsquash(0.7) - unsquash(-0.7);
        let ours = habit(&fast) - habit(&slow);
        assert!(ours > 0.3 * apart, "{ours} of {apart}");
    }

    #[test]
    fn same_seed_same_bytes() {
        let once = SqilSettings {
            phases: 2,
            gradient_steps: 3,
            ..few()
        };
        let (a, b) = (learned([0.2, 0.1], &once), learned([0.2, 0.1], &once));
        assert_eq!(a.parameters, b.parameters);
        assert_ne!(a.parameters, learned([0.1, 0.1], &once).parameters);
    }
}
