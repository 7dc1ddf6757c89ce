//! The policy implant where actions are choices: its most probable value given what the person believed, and the evidence.
//!
//! ```text
//! p(a | z) = (1 − ε) softmax_a(β ℓ_a(z) + θ_a · x(z)) + ε/|A|,   x = (1, φ(z)),  θ_a = (b_a, w_a),  ℓ = ln softmax(Q/T)
//! ```
//!
//! Lapses, and which sample of what was noticed is right, are latent: EM gives each column a responsibility r. θ moves by the bound of
//! Böhning (1992): the curvature of a softmax is nowhere more than ½ (I − 1 1ᵀ/|A|) ⊗ Σ r x xᵀ, so that one factored matrix serves
//! every step. ln β moves by Newton's method. The evidence is Laplace's, with the curvature of each action by itself.

use super::{Followed, ImplantSettings, Weighed};
use crate::linear::{Cholesky, add_outer};
use models::{Features, PolicyImplant};

/// Most steps of EM.
const STEPS: usize = 60;
/// The objective gained in a step below which it is over.
const ENOUGH: f64 = 0.01;
/// Strength of ε's prior, as a number of actions seen.
const LAPSE_STRENGTH: f64 = 30.0;
/// Of a sample's weight, the share that is spread evenly over all in every step: the person notices anew.
const REJUVENATED: f64 = 0.01;

/// The parameters.
#[derive(Clone, Debug)]
struct Theta {
    log_gain: f64,
    /// θ_a, action by action: bias, then the residual's weights.
    rows: Vec<f64>,
    lapse: f64,
}

/// What does not change while θ is looked for.
struct Problem<'a> {
    followed: &'a Followed,
    actions: usize,
    /// Numbers of x.
    width: usize,
    /// x of every column.
    x: Vec<f64>,
    /// ℓ of every column.
    log: Vec<f64>,
    taken: Vec<usize>,
    settings: &'a ImplantSettings,
}

/// Finds the best policy implant, where there is one, and weighs the evidence.
pub(super) fn weigh(
    followed: &Followed,
    features: &Features,
    with_policy: bool,
    settings: &ImplantSettings,
) -> Weighed {
    let problem = Problem::new(followed, features, settings);
    let mut theta = Theta {
        log_gain: 0.0,
        rows: vec![0.0; problem.actions * problem.width],
        lapse: f64::from(settings.lapse),
    };
    if !with_policy {
        let (rounds, _) = problem.pass(&theta);
        return Weighed {
            policy: None,
            rounds,
            occam: 0.0,
        };
    }
    theta.log_gain = f64::from(settings.log_gain[0]);
    problem.climb(&mut theta);
    let (rounds, responsible) = problem.pass(&theta);
    let occam = problem.log_prior(&theta) - 0.5 * problem.log_curvature(&theta, &responsible);
    let count = features.count();
    let split = |part: core::ops::Range<usize>| -> Vec<f32> {
        let rows = theta.rows.chunks_exact(problem.width);
        rows.flat_map(|row| row[part.clone()].iter().map(|x| *x as f32))
            .collect()
    };
    Weighed {
        policy: Some(PolicyImplant {
            log_gain: theta.log_gain as f32,
            bias: split(0..1),
            residual: split(1..1 + count),
            noise: Vec::new(),
            lapse: theta.lapse as f32,
        }),
        rounds,
        occam,
    }
}

impl<'a> Problem<'a> {
    fn new(followed: &'a Followed, features: &Features, settings: &'a ImplantSettings) -> Self {
        let (actions, count) = (followed.actions, features.count());
        let width = 1 + count;
        let columns = followed.steps() * followed.samples;
        let latent = followed.z.len() / columns.max(1);
        let mut x = Vec::with_capacity(columns * width);
        let mut phi = vec![0.0; count];
        for z in followed.z.chunks_exact(latent.max(1)) {
            features.write(z, &mut phi);
            x.push(1.0);
            x.extend(phi.iter().map(|phi| f64::from(*phi)));
        }
        Self {
            followed,
            actions,
            width,
            x,
            log: followed.robot.iter().map(|l| f64::from(*l)).collect(),
            taken: followed
                .taken
                .chunks_exact(actions)
                .map(models::policy::largest)
                .collect(),
            settings,
        }
    }

    fn x(&self, column: usize) -> &[f64] {
        &self.x[column * self.width..(column + 1) * self.width]
    }

    /// softmax of one column.
    fn softmax(&self, theta: &Theta, column: usize, out: &mut [f64]) {
        let log = &self.log[column * self.actions..(column + 1) * self.actions];
        let x = self.x(column);
        let gain = theta.log_gain.exp();
        let rows = theta.rows.chunks_exact(self.width);
        for ((out, log), row) in out.iter_mut().zip(log).zip(rows) {
            let tendency: f64 = row.iter().zip(x).map(|(w, x)| w * x).sum();
            *out = gain * log + tendency;
        }
        let most = out.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut sum = 0.0;
        for out in out.iter_mut() {
            *out = (*out - most).exp();
            sum += *out;
        }
        out.iter_mut().for_each(|out| *out /= sum);
    }

    /// log-likelihood of each round, and of each column the probability that it is the right one and no lapse.
    fn pass(&self, theta: &Theta) -> (Vec<f64>, Vec<f64>) {
        let samples = self.followed.samples;
        let mut rounds = vec![0.0; self.followed.rounds()];
        let mut weights = vec![1.0 / samples as f64; rounds.len() * samples];
        let mut responsible = vec![0.0; self.taken.len() * samples];
        let mut p = vec![0.0; self.actions];
        let anything = theta.lapse / self.actions as f64;
        for (t, (taken, round)) in self.taken.iter().zip(&self.followed.round).enumerate() {
            let round = *round as usize;
            let weights = &mut weights[round * samples..(round + 1) * samples];
            let own = &mut responsible[t * samples..(t + 1) * samples];
            let mut sum = 0.0;
            for (k, (weight, responsible)) in weights.iter_mut().zip(own.iter_mut()).enumerate() {
                self.softmax(theta, t * samples + k, &mut p);
                let meant = (1.0 - theta.lapse) * p[*taken];
                *responsible = *weight * meant;
                *weight *= meant + anything;
                sum += *weight;
            }
            let even = REJUVENATED / samples as f64;
            for (weight, responsible) in weights.iter_mut().zip(own) {
                *weight = (1.0 - REJUVENATED) * *weight / sum + even;
                *responsible /= sum;
            }
            rounds[round] += sum.ln();
        }
        (rounds, responsible)
    }

    /// Deviation of the prior of the i-th number of a θ_a.
    fn deviation(&self, i: usize) -> f64 {
        f64::from(match i {
            0 => self.settings.bias,
            _ => self.settings.residual,
        })
    }

    /// log p(θ) relative to its greatest value, where the curvature is measured in the prior's deviations.
    fn log_prior(&self, theta: &Theta) -> f64 {
        let [mean, deviation] = self.settings.log_gain.map(f64::from);
        let mut sum = -0.5 * ((theta.log_gain - mean) / deviation).powi(2);
        for row in theta.rows.chunks_exact(self.width) {
            let own = row.iter().enumerate();
            sum -= own
                .map(|(i, w)| 0.5 * (w / self.deviation(i)).powi(2))
                .sum::<f64>();
        }
        // Beta(s m, s (1 − m)), up to a constant.
        let mean = f64::from(self.settings.lapse);
        sum + LAPSE_STRENGTH * (mean * theta.lapse.ln() + (1.0 - mean) * (1.0 - theta.lapse).ln())
    }

    fn objective(&self, theta: &Theta) -> f64 {
        self.pass(theta).0.iter().sum::<f64>() + self.log_prior(theta)
    }

    /// Expectation–maximisation, each step of which is halved until it gains.
    fn climb(&self, theta: &mut Theta) {
        let mut value = self.objective(theta);
        let mut bound: Option<Cholesky> = None;
        for step in 0..STEPS {
            let (_, responsible) = self.pass(theta);
            // Who is responsible changes where samples vie, and the bound with it.
            if bound.is_none() || (self.followed.samples > 1 && step % 8 == 0) {
                bound = Some(self.bound(&responsible));
            }
            let Some(bound) = &bound else { return };
            let towards = self.towards(theta, &responsible, bound);
            // The bound is cautious: twice its step often gains more.
            let gained = [2.0, 1.0, 0.5, 0.25, 0.06].into_iter().find_map(|scale| {
                let mut next = theta.clone();
                next.log_gain += scale * towards.log_gain;
                next.lapse = towards.lapse;
                for (w, d) in next.rows.iter_mut().zip(&towards.rows) {
                    *w += scale * d;
                }
                let reached = self.objective(&next);
                (reached > value).then_some((next, reached))
            });
            let Some((next, reached)) = gained else {
                return;
            };
            *theta = next;
            let gain = reached - value;
            value = reached;
            if gain < ENOUGH {
                return;
            }
        }
    }

    /// ½ Σ r x xᵀ and the prior, factored.
    fn bound(&self, responsible: &[f64]) -> Cholesky {
        let width = self.width;
        let mut matrix = vec![0.0; width * width];
        for (column, r) in responsible.iter().enumerate().filter(|(_, r)| **r > 1e-4) {
            add_outer(&mut matrix, self.x(column), 0.5 * r);
        }
        for i in 0..width {
            matrix[i * width + i] += self.deviation(i).powi(-2);
        }
        Cholesky::new(matrix, width)
    }

    /// The step, and where ε goes.
    fn towards(&self, theta: &Theta, responsible: &[f64], bound: &Cholesky) -> Theta {
        let (actions, width, samples) = (self.actions, self.width, self.followed.samples);
        let mut rows = vec![0.0; actions * width];
        let (mut slope, mut curvature) = (0.0, 0.0);
        let mut p = vec![0.0; actions];
        let gain = theta.log_gain.exp();
        for (column, r) in responsible.iter().enumerate().filter(|(_, r)| **r > 1e-4) {
            self.softmax(theta, column, &mut p);
            let log = &self.log[column * actions..(column + 1) * actions];
            let taken = self.taken[column / samples];
            let mean: f64 = p.iter().zip(log).map(|(p, l)| p * l).sum();
            let square: f64 = p.iter().zip(log).map(|(p, l)| p * l * l).sum();
            slope += r * gain * (log[taken] - mean);
            curvature += r * gain * gain * (square - mean * mean);
            for (a, (row, p)) in rows.chunks_exact_mut(width).zip(&p).enumerate() {
                let error = r * (f64::from(u8::from(a == taken)) - p);
                for (sum, x) in row.iter_mut().zip(self.x(column)) {
                    *sum += error * x;
                }
            }
        }
        for (row, own) in rows
            .chunks_exact_mut(width)
            .zip(theta.rows.chunks_exact(width))
        {
            for (i, (sum, w)) in row.iter_mut().zip(own).enumerate() {
                *sum -= w / self.deviation(i).powi(2);
            }
            bound.solve(row);
        }
        let [mean, deviation] = self.settings.log_gain.map(f64::from);
        let precision = deviation.powi(-2);
        let slope = slope - (theta.log_gain - mean) * precision;
        let meant: f64 = responsible.iter().sum();
        let steps = self.taken.len() as f64;
        let prior = LAPSE_STRENGTH * f64::from(self.settings.lapse);
        Theta {
            log_gain: (slope / (curvature + precision)).clamp(-1.0, 1.0),
            rows,
            lapse: ((steps - meant + prior) / (steps + LAPSE_STRENGTH)).clamp(1e-4, 0.5),
        }
    }

    /// ln det of the curvature in units of the prior's: what the data tell of θ beyond it.
    fn log_curvature(&self, theta: &Theta, responsible: &[f64]) -> f64 {
        let (actions, width) = (self.actions, self.width);
        let mut p = vec![0.0; actions];
        let mut matrices = vec![vec![0.0; width * width]; actions];
        let mut of_gain = 0.0;
        let gain = theta.log_gain.exp();
        for (column, r) in responsible.iter().enumerate().filter(|(_, r)| **r > 1e-4) {
            self.softmax(theta, column, &mut p);
            let log = &self.log[column * actions..(column + 1) * actions];
            let mean: f64 = p.iter().zip(log).map(|(p, l)| p * l).sum();
            let square: f64 = p.iter().zip(log).map(|(p, l)| p * l * l).sum();
            of_gain += r * gain * gain * (square - mean * mean);
            for (matrix, p) in matrices.iter_mut().zip(&p) {
                add_outer(matrix, self.x(column), r * p * (1.0 - p));
            }
        }
        let mut sum = (1.0 + of_gain * f64::from(self.settings.log_gain[1]).powi(2)).ln();
        for mut matrix in matrices {
            for i in 0..width {
                for j in 0..=i {
                    matrix[i * width + j] *= self.deviation(i) * self.deviation(j);
                }
                matrix[i * width + i] += 1.0;
            }
            sum += Cholesky::new(matrix, width).log_determinant();
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::implants::tests::settings;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Somebody half as sure as the robot, with a habit and lapses, is found out from 4000 choices.
    #[test]
    fn finds_gain_bias_residual_and_lapses() {
        let truth = PolicyImplant {
            log_gain: 0.5_f32.ln(),
            bias: vec![0.8, -0.3, -0.5],
            residual: vec![0.6, 0.0, -0.6, 0.4, 0.0, -0.4],
            noise: Vec::new(),
            lapse: 0.06,
        };
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut followed = Followed {
            samples: 1,
            actions: 3,
            ..Followed::default()
        };
        for round in 0..40 {
            for _ in 0..100 {
                let z: [f32; 2] = core::array::from_fn(|_| rng.random_range(-1.7..1.7));
                let mut log: Vec<f32> = (0..3).map(|_| rng.random_range(-4.0..4.0)).collect();
                followed.robot.extend_from_slice(&log);
                followed.z.extend_from_slice(&z);
                truth.choose(&mut log, &z);
                let draw: f32 = rng.random();
                let mut below = 0.0;
                let taken = log[..2].iter().take_while(|l| {
                    below += l.exp();
                    below < draw
                });
                let mut one = [0.0; 3];
                one[taken.count()] = 1.0;
                followed.taken.extend_from_slice(&one);
                followed.round.push(round);
            }
        }
        let features = Features {
            center: vec![0.0; 2],
            directions: vec![1.0, 0.0, 0.0, 1.0],
        };
        let weighed = weigh(&followed, &features, true, &settings());
        let found = weighed.policy.clone();
        let found = found.expect("there is a policy implant");
        assert!((found.log_gain - truth.log_gain).abs() < 0.15, "{found:?}");
        assert!((found.lapse - truth.lapse).abs() < 0.03, "{found:?}");
        for (found, truth) in found.bias.iter().zip(&truth.bias) {
            assert!((found - truth).abs() < 0.2, "bias {found}, truth {truth}");
        }
        for (found, truth) in found.residual.iter().zip(&truth.residual) {
            assert!(
                (found - truth).abs() < 0.2,
                "residual {found}, truth {truth}"
            );
        }
        let without = weigh(&followed, &features, false, &settings());
        let sum = |w: &Weighed| w.rounds.iter().sum::<f64>() + w.occam;
        assert!(sum(&weighed) > sum(&without) + 100.0);
    }
}
