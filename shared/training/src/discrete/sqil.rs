//! Soft-Q imitation learning (Reddy et al., the paper's SQIL) over deep Q-learning: reward 1 for what the person did, 0 for what
//! the policy does in the world by itself, and soft Bellman errors on equal parts of both.
//!
//! ```text
//! L = E_demonstrations[(Q(h_t, a_t) − 1 − γ V(h_{t+1}))²] + E_rollouts[(Q(h_t, a_t) − γ V(h_{t+1}))²]
//! V(h) = log Σ_a exp Q'(h, a),   π(a | h) = exp(Q(h, a) − V(h))
//! ```
//!
//! The policy sees what the person would perceive. Learning stops early by the likelihood of validation rounds.

use super::cloning::{Perceived, split};
use super::rounds::{Round, Rounds};
use crate::config::{self, Checked};
use domains::discrete::{Discrete, World};
use models::{ActionDistribution, Beliefs, HumanModel, Kind, Observations};
use models::{RecurrentHuman, RecurrentPolicy, RecurrentSizes};
use nn::{Adam, Arena, Gradients, Tape, Tensor, noise};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Adam's rate.
    pub learning_rate: f32,
    /// Most phases; each lives some rounds, makes some gradient steps and is validated.
    pub phases: usize,
    /// Rounds lived in a phase.
    pub rounds: u32,
    /// Gradient steps in a phase.
    pub gradient_steps: usize,
    /// Rounds of each kind in a gradient step.
    pub batch: usize,
    /// Lived rounds that are remembered.
    pub remembered: usize,
    /// Reward for what the person did, in units of the soft policy's temperature.
    pub reward: f32,
    /// γ.
    pub discount: f32,
    /// Rate at which the target follows.
    pub target_rate: f32,
    /// Phases without a new best after which learning stops.
    pub patience: usize,
    /// Dense layers: the paper's 3.
    pub layers: usize,
    /// Seed of weights and rounds.
    #[serde(default)]
    pub seed: u64,
}

/// Chosen by the likelihood of one person's validation rounds in each domain (person 2, rounds that no study uses): with a reward of 1,
/// a discount of 0.9 and a third of the gradient steps, what was learned in search and rescue knew no more than chance.
impl Default for Settings {
    /// What ships ([`crate::config`]).
    fn default() -> Self {
        Self::of("driving")
    }
}

impl Settings {
    /// What ships for a domain.
    pub fn of(domain: &str) -> Self {
        config::gridworld(domain).sqil
    }
}

impl Checked for Settings {
    fn problem(&self) -> Option<String> {
        (!(1..=8).contains(&self.layers)
            || self.batch == 0
            || self.rounds == 0
            || self.learning_rate <= 0.0
            || !(0.0..=1.0).contains(&self.discount)
            || !(0.0..=1.0).contains(&self.target_rate))
        .then(|| {
            "layers from 1 to 8; rounds and batch at least 1; learning_rate positive; discount and target_rate in [0, 1]"
                .to_owned()
        })
    }
}

/// What learning gave.
#[derive(Clone, Debug)]
pub struct Imitated {
    /// The policy, as it was when it did best on the validation rounds.
    pub policy: RecurrentPolicy,
    /// Its mean negative log-likelihood there.
    pub validation: f32,
}

/// Learns a policy of `sizes`, but for its layers, from `rounds` and in `places` by turns, worlds with what limits the person's sight there and what they hear: the same settings as the rounds' (at
/// least one). Stops by `validation`, or by every fifth of `rounds` where there is none. `progress` hears of each phase and its validation.
///
/// # Panics
/// Without a place.
pub fn learn(
    mut places: Vec<(World, (Vec<f32>, u32))>,
    sizes: RecurrentSizes,
    rounds: &Rounds,
    validation: &Rounds,
    settings: &Settings,
    progress: &mut dyn FnMut(usize, f32),
) -> Imitated {
    let layout = places[0].0.layout().clone();
    let (train, held) = split(rounds, validation);
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let sizes = sizes.with_layers(settings.layers);
    let mut policy = RecurrentPolicy::new(sizes, &layout, &mut rng);
    let mut target = policy.clone();
    let held = Perceived::new(&policy, &held);
    let mut arena = Arena::new();
    let mut target_arena = Arena::new();
    let mut gradients = Gradients::for_params(&policy.parameters);
    let ids = policy.parameters.ids().collect();
    let mut adam = Adam::new(&policy.parameters, ids, settings.learning_rate);
    let mut lived: Vec<Round> = Vec::new();
    let mut best = policy.parameters.clone();
    let mut least = held.nll(&policy, &mut arena, None);
    let mut waited = 0;
    for phase in 0..settings.phases {
        for round in 0..settings.rounds {
            let number = phase as u32 * settings.rounds + round;
            let turn = number as usize % places.len();
            let scenario = number / places.len() as u32;
            let (world, sight) = &mut places[turn];
            let round = live(world, &policy, sight, settings.seed, [number, scenario]);
            if lived.len() >= settings.remembered.max(1) {
                lived.remove(0);
            }
            lived.push(round);
        }
        for _ in 0..settings.gradient_steps {
            gradients.zero();
            let of_person: Vec<&Round> = pick(&train, settings.batch, &mut rng);
            let own: Vec<&Round> = lived.iter().collect();
            let own = pick(&own, settings.batch, &mut rng);
            for (rounds, reward) in [(of_person, settings.reward), (own, 0.0)] {
                let batch = Perceived::new(&policy, &rounds);
                soft_error(
                    &policy,
                    &target,
                    &batch,
                    reward,
                    settings.discount,
                    [&mut arena, &mut target_arena],
                    &mut gradients,
                );
            }
            adam.step(&mut policy.parameters, &gradients);
            target
                .parameters
                .lerp_from(&policy.parameters, settings.target_rate);
        }
        let validation = held.nll(&policy, &mut arena, None);
        progress(phase + 1, validation);
        if validation < least {
            least = validation;
            best.copy_from(&policy.parameters);
            waited = 0;
        } else {
            waited += 1;
            if waited >= settings.patience {
                break;
            }
        }
    }
    policy.parameters = best;
    Imitated {
        policy,
        validation: least,
    }
}

/// Some of the rounds, each drawn by itself.
fn pick<'a>(rounds: &[&'a Round], count: usize, rng: &mut ChaCha8Rng) -> Vec<&'a Round> {
    if rounds.is_empty() {
        return Vec::new();
    }
    (0..count)
        .map(|_| rounds[rng.random_range(0..rounds.len())])
        .collect()
}

/// The mean squared soft Bellman error of a batch; adds its gradients. The last step of a round has no future.
fn soft_error(
    policy: &RecurrentPolicy,
    target: &RecurrentPolicy,
    batch: &Perceived,
    reward: f32,
    discount: f32,
    [arena, target_arena]: [&mut Arena; 2],
    gradients: &mut Gradients,
) -> f32 {
    let (columns, all) = (batch.columns, batch.steps * batch.columns);
    if all == 0 {
        return 0.0;
    }
    let actions = policy.sizes.model.shape.action;
    let mut goal = Tensor::new(1, all);
    {
        let mut tape = Tape::new(&target.parameters, target_arena);
        let q = target.on_tape(&mut tape, &batch.observed, &batch.previous, columns);
        let q = tape.value(q);
        let weight = batch.weight.data();
        for (j, goal) in goal.data_mut().iter_mut().enumerate() {
            let next = j + columns;
            let goes_on = next < all && weight[next] > 0.0;
            let future = if goes_on {
                let q = &q[next * actions..(next + 1) * actions];
                let largest = q.iter().copied().fold(f32::NEG_INFINITY, f32::max);
                largest + q.iter().map(|q| (q - largest).exp()).sum::<f32>().ln()
            } else {
                0.0
            };
            *goal = reward + discount * future;
        }
    }
    let mut tape = Tape::new(&policy.parameters, arena);
    let q = policy.on_tape(&mut tape, &batch.observed, &batch.previous, columns);
    let chosen = tape.select_log_prob(q, &batch.taken);
    let goal = tape.input(&goal);
    let error = tape.sub(chosen, goal);
    let squared = tape.square(error);
    let weight = tape.input(&batch.weight);
    let counted = tape.mul(squared, weight);
    let sum = tape.sum(counted);
    let loss = tape.scale(sum, 1.0 / batch.counted().max(1.0));
    tape.backward(loss, gradients, &|_| true);
    tape.scalar(loss)
}

/// A round of the policy itself, perceiving as the person would.
fn live(
    world: &mut World,
    policy: &RecurrentPolicy,
    (limits, heard): &(Vec<f32>, u32),
    seed: u64,
    [episode, scenario]: [u32; 2],
) -> Round {
    let layout = Arc::new(world.layout().clone());
    let mut human = RecurrentHuman::new(
        Kind::Sqil,
        Arc::new(policy.clone()),
        &layout,
        limits.clone(),
        *heard,
    );
    let shape = policy.sizes.model.shape;
    let mut beliefs = Beliefs::new(human.latent(), 1);
    let mut distribution = ActionDistribution::new(human.actions(), 1);
    let mut observations = Observations::new(&shape, 1);
    let mut action = Tensor::new(shape.action, 1);
    let mut chance = vec![0.0; human.noise_rows()];
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream((1 << 41) + u64::from(episode));
    let mut round = Round::default();
    world.reset(seed, episode, scenario);
    while world.end().is_running() {
        let Observations { visual, verbal } = &mut observations;
        world.observe(visual.column_mut(0), verbal.column_mut(0));
        noise::fill(&mut chance, rng.random(), 0);
        let told = [Default::default()];
        human.perceive(&mut beliefs, &action, &observations, &told, Some(&chance));
        human.act(&beliefs, &mut distribution);
        let draws: [f32; 8] = {
            let mut draws = [0.0; 8];
            noise::fill(&mut draws, rng.random(), 0);
            draws
        };
        distribution.sample(Some(&draws), &mut action);
        let taken = models::policy::largest(action.column(0));
        round
            .visual
            .extend_from_slice(observations.visual.column(0));
        round
            .verbal
            .extend_from_slice(observations.verbal.column(0));
        round.perceived.push(human.perceived());
        round.action.push(taken as u8);
        round.reward.push(world.step(taken).reward);
    }
    round
}
