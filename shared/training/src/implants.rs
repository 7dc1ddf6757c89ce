//! Learning implants from a person's rounds, as a posterior (paper §III-B, equation 5, of which this is what a single best χ stands
//! for):
//!
//! ```text
//! p(χ | rounds) ∝ p(χ) Π_t p(a_t | z_t, χ),   z_t ~ q_φ(z_t | z_{t−1}, a_{t−1}, h_p(x_t))
//! ```
//!
//! χ has two parts. Of the limits of sight there are hypotheses ([`sight`]): a grid where one or two numbers are looked for, else
//! points that draw near to where the evidence is. Under each, the rounds are followed through the perception and q_φ
//! ([`follow`]); given what the person then believes at every step, the policy implant has one best value and its evidence
//! ([`choices`], [`hands`]: Laplace's method).
//!
//! The model is wrong about everybody, and successive steps say much the same, so that the plain posterior is far too sure. It is
//! therefore averaged over rounds drawn with replacement (BayesBag; Huggins and Miller 2019): where one lucky round decides, the
//! average stays broad.
//!
//! Only χ moves: the self-model is read, never written.

mod choices;
mod follow;
mod hands;
mod sight;

pub use follow::Followed;

use crate::config::{Checked, Config};
use crate::linear::principal;
use crate::rounds::{Round, Rounds};
use domains::ActionSpace;
use models::{Features, Implants, Kind, PolicyImplant, Posterior, SelfModel};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use sight::Sampler;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use thiserror::Error;

/// ImplantSettings of learning a person's implants.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImplantSettings {
    /// Hypotheses about sight: for each number that is looked for where there are one or two, else of each of [`Self::rounds`].
    pub points: usize,
    /// How often points are drawn anew near to the evidence; of no use with a grid.
    pub rounds: usize,
    /// K: samples of what was noticed, where perception is a matter of chance.
    pub samples: usize,
    /// Steps at a round's start whose actions do not count.
    pub skip: usize,
    /// Directions of z that the residual can follow.
    pub features: usize,
    /// Prior of ln β: mean, deviation.
    pub log_gain: [f32; 2],
    /// Deviation of b's prior.
    pub bias: f32,
    /// Deviation of W's prior.
    pub residual: f32,
    /// Mean of ε's prior, a Beta distribution of strength 30.
    pub lapse: f32,
    /// Draws of rounds that the posterior is averaged over.
    pub bags: usize,
    /// Most hypotheses that are kept.
    pub kept: usize,
    /// Seed of what is drawn.
    #[serde(default)]
    pub seed: u64,
}

impl ImplantSettings {
    /// What ships for a domain ([`crate::config`]).
    pub fn of(domain: &str) -> Self {
        Config::shipped(domain).implants
    }
}

impl Checked for ImplantSettings {
    fn problem(&self) -> Option<String> {
        let counts = [
            (self.points, 1000),
            (self.samples, 1000),
            (self.bags, 10_000),
            (self.kept, 256),
        ];
        if counts.iter().any(|(n, most)| !(1..=*most).contains(n)) {
            return Some(
                "points and samples from 1 to 1000, bags from 1 to 10000, kept from 1 to 256"
                    .to_owned(),
            );
        }
        if self.features > 128 || self.rounds > 100 {
            return Some("at most 128 features and 100 rounds".to_owned());
        }
        let positive = [self.log_gain[1], self.bias, self.residual];
        (!positive.iter().all(|x| x.is_finite() && *x > 0.0)
            || !self.log_gain[0].is_finite()
            || !(1e-4..0.5).contains(&self.lapse))
        .then(|| "deviations of priors must be positive, and lapse from 0.0001 to 0.5".to_owned())
    }
}

/// Learning is impossible.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum ImplantError {
    /// There is no step to learn from.
    #[error(
        "the rounds hold no step to learn from: {rounds} rounds, the longest of {longest} steps, of which the first {skip} do not count"
    )]
    NothingToLearn {
        /// Rounds.
        rounds: usize,
        /// Steps of the longest.
        longest: usize,
        /// Steps left out at each one's start.
        skip: usize,
    },
    /// The kind of human model has no implants.
    #[error("a human model of kind `{0}` has no implants to learn")]
    NoImplants(&'static str),
}

/// What learning gave.
#[derive(Clone, Debug)]
pub struct Learned {
    /// What is now known of the person.
    pub posterior: Posterior,
    /// −log p(a_t) a step under the most probable hypothesis.
    pub loss: f32,
    /// Hypotheses that were tried.
    pub tried: usize,
}

/// The evidence for one hypothesis about sight.
struct Weighed {
    policy: Option<PolicyImplant>,
    /// log p(actions | hypothesis) of each round under the best policy implant.
    rounds: Vec<f64>,
    /// What the choice of the policy implant costs: log prior and Occam factor.
    occam: f64,
}

/// Learns the implants of one person: `mirror`, or `mirror-p` without a policy implant. `progress` hears of hypotheses tried, out of
/// how many. The result does not depend on the number of threads.
///
/// # Errors
/// [`ImplantError`].
pub fn learn(
    model: &Arc<SelfModel>,
    kind: Kind,
    rounds: &Rounds,
    settings: &ImplantSettings,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Learned, ImplantError> {
    let with_policy = match kind {
        Kind::Mirror => true,
        Kind::MirrorP => false,
        _ => return Err(ImplantError::NoImplants(kind.name())),
    };
    if counted(rounds, settings.skip) == 0 {
        return Err(ImplantError::NothingToLearn {
            rounds: rounds.rounds.len(),
            longest: longest(rounds),
            skip: settings.skip,
        });
    }
    let perception = model.layout.perception;
    let features = match with_policy {
        true => features_of(model, rounds, settings),
        false => Features::default(),
    };
    let mut sampler = Sampler::new(perception, settings);
    let all = sampler.total();
    let mut tried: Vec<Weighed> = Vec::new();
    while let Some(points) = sampler.next() {
        let weighed = weigh_all(model, points, rounds, &features, with_policy, settings);
        tried.extend(weighed);
        progress(tried.len(), all);
        let scores: Vec<f64> = tried
            .iter()
            .map(|w| w.rounds.iter().sum::<f64>() + w.occam)
            .collect();
        sampler.learn(&scores);
    }
    let weights = bagged(&tried, sampler.log_importance(), settings);
    let mut order: Vec<usize> = (0..tried.len()).collect();
    order.sort_by(|a, b| weights[*b].total_cmp(&weights[*a]).then(a.cmp(b)));
    order.truncate(settings.kept);
    order.retain(|i| weights[*i] > weights[order_first(&weights)] * 1e-4);
    order.sort_unstable();
    let kept: f64 = order.iter().map(|i| weights[*i]).sum();
    let best = order_first(&weights);
    let steps = counted(rounds, settings.skip) as f64;
    let loss = -tried[best].rounds.iter().sum::<f64>() / steps;
    let posterior = Posterior {
        perception,
        hypotheses: order
            .iter()
            .map(|i| Implants {
                limits: perception.limits_of(sampler.point(*i)),
                policy: tried[*i].policy.clone(),
            })
            .collect(),
        weights: order.iter().map(|i| (weights[*i] / kept) as f32).collect(),
        features,
    };
    Ok(Learned {
        posterior,
        loss: loss as f32,
        tried: tried.len(),
    })
}

/// Steps that count, where the first `skip` of each round do not.
fn counted(rounds: &Rounds, skip: usize) -> usize {
    let own = |round: &Round| round.len().saturating_sub(skip);
    rounds.rounds.iter().map(own).sum()
}

/// Steps of the longest round.
fn longest(rounds: &Rounds) -> usize {
    rounds.rounds.iter().map(Round::len).max().unwrap_or(0)
}

/// Place of the largest, the first among equals.
fn order_first(weights: &[f64]) -> usize {
    let mut best = 0;
    for (i, weight) in weights.iter().enumerate() {
        if *weight > weights[best] {
            best = i;
        }
    }
    best
}

/// φ: what z varied by in the rounds, had the person seen everything.
fn features_of(model: &Arc<SelfModel>, rounds: &Rounds, settings: &ImplantSettings) -> Features {
    let perception = model.layout.perception;
    let everything = vec![perception.largest(); perception.controls()];
    let followed = follow::follow(model, &[&everything], rounds, 1, settings.skip).remove(0);
    let latent = model.sizes.latent;
    let (center, directions) = principal(&followed.z, latent, settings.features.min(latent));
    Features { center, directions }
}

/// Weighs hypotheses on as many threads as there are cores, in the order of `points`.
fn weigh_all(
    model: &Arc<SelfModel>,
    points: &[Vec<f32>],
    rounds: &Rounds,
    features: &Features,
    with_policy: bool,
    settings: &ImplantSettings,
) -> Vec<Weighed> {
    let samples = match model.layout.perception.noise_rows() {
        0 => 1,
        _ => settings.samples,
    };
    // So many hypotheses are followed at once that the networks have a batch worth having.
    let together = (64 / (rounds.rounds.len() * samples).max(1)).clamp(1, 16);
    let chunks: Vec<&[Vec<f32>]> = points.chunks(together).collect();
    let next = AtomicUsize::new(0);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut done: Vec<Vec<Weighed>> = chunks.iter().map(|_| Vec::new()).collect();
    std::thread::scope(|scope| {
        let work = || {
            let mut own = Vec::new();
            loop {
                let at = next.fetch_add(1, Ordering::Relaxed);
                let Some(chunk) = chunks.get(at) else {
                    return own;
                };
                let controls: Vec<&[f32]> = chunk.iter().map(Vec::as_slice).collect();
                let followed = follow::follow(model, &controls, rounds, samples, settings.skip);
                let weighed = followed
                    .iter()
                    .map(|f| weigh(model, f, features, with_policy, settings));
                own.push((at, weighed.collect::<Vec<_>>()));
            }
        };
        let workers: Vec<_> = (0..threads.min(chunks.len()))
            .map(|_| scope.spawn(work))
            .collect();
        for worker in workers {
            match worker.join() {
                Ok(own) => own.into_iter().for_each(|(at, weighed)| done[at] = weighed),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
    });
    done.into_iter().flatten().collect()
}

fn weigh(
    model: &SelfModel,
    followed: &Followed,
    features: &Features,
    with_policy: bool,
    settings: &ImplantSettings,
) -> Weighed {
    match model.layout.actions {
        ActionSpace::Discrete(_) => choices::weigh(followed, features, with_policy, settings),
        ActionSpace::Continuous(_) => hands::weigh(followed, features, with_policy, settings),
    }
}

/// The bagged posterior over what was tried. `log_importance`: what each point stands for beyond its evidence.
fn bagged(tried: &[Weighed], log_importance: &[f64], settings: &ImplantSettings) -> Vec<f64> {
    let rounds = tried[0].rounds.len();
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    rng.set_stream(1);
    let mut sum = vec![0.0; tried.len()];
    let mut counts = vec![0_u32; rounds];
    let mut log = vec![0.0; tried.len()];
    for _ in 0..settings.bags {
        counts.fill(0);
        for _ in 0..rounds {
            counts[rng.random_range(0..rounds)] += 1;
        }
        for (log, (weighed, importance)) in log.iter_mut().zip(tried.iter().zip(log_importance)) {
            let drawn = weighed.rounds.iter().zip(&counts);
            let evidence: f64 = drawn.map(|(own, count)| own * f64::from(*count)).sum();
            *log = evidence + weighed.occam + importance;
        }
        let most = log.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let whole: f64 = log.iter().map(|log| (log - most).exp()).sum();
        for (sum, log) in sum.iter_mut().zip(&log) {
            *sum += (log - most).exp() / whole / settings.bags as f64;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ImplantSettings under which little is believed beforehand.
    pub(super) fn settings() -> ImplantSettings {
        ImplantSettings {
            points: 1,
            rounds: 0,
            samples: 1,
            skip: 0,
            features: 2,
            log_gain: [-0.5, 1.0],
            bias: 2.0,
            residual: 1.0,
            lapse: 0.03,
            bags: 1,
            kept: 1,
            seed: 0,
        }
    }
}
