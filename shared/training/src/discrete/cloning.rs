//! Behavioural cloning in the gridworlds (paper §IV-A and appendix): a recurrent policy learned by likelihood from rounds, told what
//! the person perceived. Learning stops early by validation rounds, and the number of layers is varied; the best is kept.

use super::rounds::{Round, Rounds};
use crate::config::{self, Checked};
use domains::Layout;
use models::{RecurrentPolicy, RecurrentSizes};
use nn::{Adam, Arena, Gradients, Tape, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Adam's rate.
    pub learning_rate: f32,
    /// Most steps of Adam.
    pub iterations: usize,
    /// Steps between validations.
    pub every: usize,
    /// Validations without a new best after which learning stops.
    pub patience: usize,
    /// Numbers of dense layers to try.
    pub layers: [usize; 3],
    /// Seed of the first weights.
    #[serde(default)]
    pub seed: u64,
}

impl Default for Settings {
    /// What ships ([`crate::config`]).
    fn default() -> Self {
        Self::of("driving")
    }
}

impl Settings {
    /// What ships for a domain.
    pub fn of(domain: &str) -> Self {
        config::gridworld(domain).cloning
    }
}

impl Checked for Settings {
    fn problem(&self) -> Option<String> {
        (!self.layers.iter().all(|n| (1..=8).contains(n))
            || self.every == 0
            || self.learning_rate <= 0.0)
            .then(|| "layers from 1 to 8; every at least 1; learning_rate positive".to_owned())
    }
}

/// What learning gave.
#[derive(Clone, Debug)]
pub struct Cloned {
    /// The policy, as it was when it did best on the validation rounds.
    pub policy: RecurrentPolicy,
    /// Its mean negative log-likelihood there.
    pub validation: f32,
    /// The best of each number of layers that was tried.
    pub tried: Vec<(usize, f32)>,
}

/// Rounds side by side as a recurrent policy takes them; tensors are `features × (steps · columns)`, step after step.
pub struct Perceived {
    /// Steps of the longest round.
    pub steps: usize,
    /// Rounds.
    pub columns: usize,
    /// What the person perceived.
    pub observed: Tensor,
    /// a_{t−1}.
    pub previous: Tensor,
    /// a_t.
    pub taken: Vec<u32>,
    /// 1 where a step counts.
    pub weight: Tensor,
}

impl Perceived {
    /// Lays rounds side by side.
    pub fn new(policy: &RecurrentPolicy, rounds: &[&Round]) -> Self {
        let shape = policy.sizes.model.shape;
        let steps = rounds.iter().map(|r| r.len()).max().unwrap_or(0);
        let columns = rounds.len();
        let all = steps * columns;
        let mut out = Self {
            steps,
            columns,
            observed: Tensor::new(policy.view.rows(), all),
            previous: Tensor::new(shape.action, all),
            taken: vec![0; all],
            weight: Tensor::new(1, all),
        };
        for (j, round) in rounds.iter().enumerate() {
            for t in 0..round.len() {
                let at = t * columns + j;
                let visual = &round.visual[t * shape.visual..(t + 1) * shape.visual];
                let verbal = &round.verbal[t * shape.verbal..(t + 1) * shape.verbal];
                let observed = out.observed.column_mut(at);
                policy
                    .view
                    .write(visual, verbal, round.perceived[t], observed);
                if t > 0 {
                    out.previous.column_mut(at)[usize::from(round.action[t - 1])] = 1.0;
                }
                out.taken[at] = round.action[t].into();
                out.weight.data_mut()[at] = 1.0;
            }
        }
        out
    }

    /// Steps that count.
    pub fn counted(&self) -> f32 {
        self.weight.data().iter().sum()
    }

    /// Mean negative log-likelihood of the person's actions; adds its gradients where some are given.
    pub fn nll(
        &self,
        policy: &RecurrentPolicy,
        arena: &mut Arena,
        gradients: Option<&mut Gradients>,
    ) -> f32 {
        if self.columns == 0 || self.steps == 0 {
            return 0.0;
        }
        let mut tape = Tape::new(&policy.parameters, arena);
        let logits = policy.on_tape(&mut tape, &self.observed, &self.previous, self.columns);
        let nll = tape.categorical_nll(logits, &self.taken);
        let weight = tape.input(&self.weight);
        let nll = tape.mul(nll, weight);
        let sum = tape.sum(nll);
        let loss = tape.scale(sum, 1.0 / self.counted().max(1.0));
        if let Some(gradients) = gradients {
            tape.backward(loss, gradients, &|_| true);
        }
        tape.scalar(loss)
    }
}

/// Learns a policy of `sizes`, but for its layers, from `rounds` and stops by `validation`; without validation rounds, every
/// fifth of `rounds` is one.
pub fn learn(
    layout: &Layout,
    sizes: RecurrentSizes,
    rounds: &Rounds,
    validation: &Rounds,
    settings: &Settings,
) -> Cloned {
    let (train, held) = split(rounds, validation);
    let mut best: Option<Cloned> = None;
    let mut tried = Vec::new();
    for layers in settings.layers {
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        let policy = RecurrentPolicy::new(sizes.with_layers(layers), layout, &mut rng);
        let cloned = one(policy, &train, &held, settings);
        tried.push((layers, cloned.validation));
        if best
            .as_ref()
            .is_none_or(|best| cloned.validation < best.validation)
        {
            best = Some(cloned);
        }
    }
    // `layers` is an array with at least one entry.
    let mut best = best.expect("a number of layers");
    best.tried = tried;
    best
}

/// Training and validation rounds.
pub(super) fn split<'a>(
    rounds: &'a Rounds,
    validation: &'a Rounds,
) -> (Vec<&'a Round>, Vec<&'a Round>) {
    let used = |rounds: &'a Rounds| rounds.rounds.iter().filter(|r| !r.is_empty());
    let held: Vec<_> = used(validation).collect();
    if !held.is_empty() {
        return (used(rounds).collect(), held);
    }
    let (held, train): (Vec<_>, Vec<_>) = used(rounds).enumerate().partition(|(i, _)| i % 5 == 4);
    let strip = |rounds: Vec<(usize, &'a Round)>| rounds.into_iter().map(|(_, r)| r).collect();
    (strip(train), strip(held))
}

fn one(
    mut policy: RecurrentPolicy,
    train: &[&Round],
    held: &[&Round],
    settings: &Settings,
) -> Cloned {
    let (train, held) = (
        Perceived::new(&policy, train),
        Perceived::new(&policy, held),
    );
    let mut arena = Arena::new();
    let mut gradients = Gradients::for_params(&policy.parameters);
    let ids = policy.parameters.ids().collect();
    let mut adam = Adam::new(&policy.parameters, ids, settings.learning_rate);
    let mut best = policy.parameters.clone();
    let mut least = held.nll(&policy, &mut arena, None);
    let mut waited = 0;
    for iteration in 1..=settings.iterations {
        gradients.zero();
        train.nll(&policy, &mut arena, Some(&mut gradients));
        adam.step(&mut policy.parameters, &gradients);
        if !iteration.is_multiple_of(settings.every) {
            continue;
        }
        let validation = held.nll(&policy, &mut arena, None);
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
    Cloned {
        policy,
        validation: least,
        tried: Vec::new(),
    }
}
