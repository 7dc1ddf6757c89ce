//! Hypotheses about a person's limits of sight: where there are one or two numbers to find, a grid; else points that are drawn nearer and
//! nearer to where the evidence is (adaptive multiple importance sampling; Cornuet et al. 2012). The prior is even.

use super::ImplantSettings;
use domains::Perception;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Most numbers that a grid is laid over.
const GRID: usize = 2;
/// Evidence counts as so much less while points are drawn: the posterior is averaged over fewer rounds than there are, and the proposal
/// has to be wider than what is looked for.
const TEMPERED: f64 = 0.2;
/// Least deviation of a proposal, as a share of the largest limit.
const LEAST_DEVIATION: f64 = 0.04;
/// Of every later draw, the share that comes from the prior again.
const EVEN: f64 = 0.2;

/// A proposal after the first: Gaussians around points.
struct Proposal {
    /// Centres, and how often each is taken.
    centres: Vec<(Vec<f64>, f64)>,
    /// Deviation along each number.
    deviation: Vec<f64>,
}

/// Draws points, and knows what each stands for.
pub(super) struct Sampler {
    /// As shares of the largest limit.
    shares: Vec<Vec<f64>>,
    points: Vec<Vec<f32>>,
    largest: f64,
    numbers: usize,
    per_round: usize,
    rounds_left: usize,
    rounds: usize,
    given: usize,
    proposals: Vec<Proposal>,
    log_importance: Vec<f64>,
    rng: ChaCha8Rng,
}

impl Sampler {
    pub fn new(perception: &dyn Perception, settings: &ImplantSettings) -> Self {
        let numbers = perception.controls();
        let rounds = if numbers > GRID { settings.rounds } else { 0 };
        let mut sampler = Self {
            shares: Vec::new(),
            points: Vec::new(),
            largest: f64::from(perception.largest()),
            numbers,
            per_round: settings.points,
            rounds_left: rounds,
            rounds,
            given: 0,
            proposals: Vec::new(),
            log_importance: Vec::new(),
            rng: ChaCha8Rng::seed_from_u64(settings.seed),
        };
        if numbers > GRID {
            for i in 0..settings.points {
                let share = (0..numbers).map(|n| halton(i + 1, PRIMES[n % PRIMES.len()]));
                sampler.shares.push(share.collect());
            }
        } else {
            let points = settings.points;
            for i in 0..points.pow(numbers as u32) {
                let at = |n: u32| (i / points.pow(n) % points) as f64 + 0.5;
                let share = (0..numbers as u32).map(|n| at(n) / points as f64);
                sampler.shares.push(share.collect());
            }
        }
        sampler.settle();
        sampler
    }

    /// Points in all.
    pub fn total(&self) -> usize {
        match self.numbers > GRID {
            true => self.per_round * (1 + self.rounds),
            false => self.per_round.pow(self.numbers as u32),
        }
    }

    /// The controls of a point.
    pub fn point(&self, i: usize) -> &[f32] {
        &self.points[i]
    }

    /// What was not given out yet.
    pub fn next(&mut self) -> Option<&[Vec<f32>]> {
        let from = self.given;
        self.given = self.points.len();
        (from < self.points.len()).then(|| &self.points[from..])
    }

    /// Log of prior over proposal, of each point.
    pub fn log_importance(&self) -> &[f64] {
        &self.log_importance
    }

    /// Draws the next round of points, where there is one: `scores` has the log evidence of all so far.
    pub fn learn(&mut self, scores: &[f64]) {
        if self.rounds_left == 0 {
            return;
        }
        self.rounds_left -= 1;
        let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut weights: Vec<f64> = scores
            .iter()
            .zip(&self.log_importance)
            .map(|(score, log)| (TEMPERED * (score - most) + log).exp())
            .collect();
        let whole: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= whole);
        let deviation = (0..self.numbers)
            .map(|n| {
                let of = |i: usize| self.shares[i][n];
                let mean: f64 = weights.iter().enumerate().map(|(i, w)| w * of(i)).sum();
                let terms = weights.iter().enumerate();
                let variance: f64 = terms.map(|(i, w)| w * (of(i) - mean).powi(2)).sum();
                (0.7 * variance.sqrt()).max(LEAST_DEVIATION)
            })
            .collect();
        let centres = weights
            .iter()
            .zip(&self.shares)
            .filter(|(weight, _)| **weight > 1e-3)
            .map(|(weight, share)| (share.clone(), *weight))
            .collect();
        let proposal = Proposal { centres, deviation };
        for _ in 0..self.per_round {
            let share = proposal.draw(&mut self.rng, self.numbers);
            self.shares.push(share);
        }
        self.proposals.push(proposal);
        self.settle();
    }

    /// Points of new shares, and everybody's importance.
    fn settle(&mut self) {
        for share in &self.shares[self.points.len()..] {
            let point = share.iter().map(|share| (share * self.largest) as f32);
            self.points.push(point.collect());
        }
        let of_all = 1.0 / (1 + self.proposals.len()) as f64;
        self.log_importance = self
            .shares
            .iter()
            .map(|share| {
                let density: f64 = self.proposals.iter().map(|p| p.density(share)).sum();
                -(of_all * (1.0 + density)).ln()
            })
            .collect();
    }
}

impl Proposal {
    /// A point within (0, 1); what falls outside is drawn again.
    fn draw(&self, rng: &mut ChaCha8Rng, numbers: usize) -> Vec<f64> {
        if rng.random::<f64>() < EVEN {
            return (0..numbers).map(|_| rng.random()).collect();
        }
        let whole: f64 = self.centres.iter().map(|(_, weight)| weight).sum();
        let mut left = rng.random::<f64>() * whole;
        let found = self.centres.iter().find(|(_, weight)| {
            left -= weight;
            left <= 0.0
        });
        let Some((centre, _)) = found.or(self.centres.last()) else {
            return (0..numbers).map(|_| rng.random()).collect();
        };
        let near = |centre: f64, deviation: f64, rng: &mut ChaCha8Rng| {
            let mut x = -1.0;
            while !(0.0..1.0).contains(&x) {
                let draw: f64 = StandardNormal.sample(rng);
                x = centre + deviation * draw;
            }
            x
        };
        let centre = centre.iter().zip(&self.deviation);
        centre.map(|(c, d)| near(*c, *d, rng)).collect()
    }

    /// Density at a point, as drawn by [`Self::draw`], but for what is drawn again at the edges.
    fn density(&self, share: &[f64]) -> f64 {
        let whole: f64 = self.centres.iter().map(|(_, weight)| weight).sum();
        let near: f64 = self
            .centres
            .iter()
            .map(|(centre, weight)| {
                let along = centre.iter().zip(share).zip(&self.deviation);
                let log: f64 = along
                    .map(|((c, x), d)| -0.5 * ((x - c) / d).powi(2) - (d * ROOT_TAU).ln())
                    .sum();
                weight / whole * log.exp()
            })
            .sum();
        EVEN + (1.0 - EVEN) * near
    }
}

/// √(2π).
const ROOT_TAU: f64 = 2.506_628_274_631_000_7;
const PRIMES: [usize; 8] = [2, 3, 5, 7, 11, 13, 17, 19];

/// The i-th number of Halton's sequence: evenly spread over (0, 1).
fn halton(mut i: usize, base: usize) -> f64 {
    let (mut sum, mut place) = (0.0, 1.0 / base as f64);
    while i > 0 {
        sum += (i % base) as f64 * place;
        i /= base;
        place /= base as f64;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::implants::tests::settings;
    use domains::highway::modalities;

    /// Of a narrow bump in five dimensions, importance sampling finds the mean.
    #[test]
    fn points_gather_where_the_evidence_is() {
        let layout = modalities::layout();
        let settings = ImplantSettings {
            points: 300,
            rounds: 4,
            ..settings()
        };
        let mut sampler = Sampler::new(layout.perception, &settings);
        let truth = [30.0_f32, 12.0, 20.0, 8.0, 15.0];
        let score = |point: &[f32]| -> f64 {
            let off = point.iter().zip(&truth);
            off.map(|(x, t)| -0.5 * f64::from((x - t) / 3.0).powi(2))
                .sum()
        };
        let mut scores: Vec<f64> = Vec::new();
        while let Some(points) = sampler.next() {
            scores.extend(points.iter().map(|point| score(point)));
            sampler.learn(&scores);
        }
        assert_eq!(scores.len(), sampler.total());
        let log = scores.iter().zip(sampler.log_importance());
        let weights: Vec<f64> = log
            .map(|(score, importance)| (score + importance).exp())
            .collect();
        let whole: f64 = weights.iter().sum();
        for (n, truth) in truth.iter().enumerate() {
            let terms = weights.iter().enumerate();
            let mean = terms
                .map(|(i, w)| w * f64::from(sampler.point(i)[n]))
                .sum::<f64>()
                / whole;
            assert!(
                (mean - f64::from(*truth)).abs() < 1.0,
                "number {n}: {mean}, truth {truth}"
            );
        }
    }
}
