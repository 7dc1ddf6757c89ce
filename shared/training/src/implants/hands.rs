//! The policy implant where actions are numbers: its most probable value given what the person believed, and the evidence.
//!
//! ```text
//! u − μ(z) = θ · x(z) + e,   x = (1, φ(z)),  θ = (b, W) of one number,   e ~ t₄(0, σ(z)² + ν²)
//! ```
//!
//! Errors are Student's: one moment in which a person brakes a little later than the robot must not outweigh everything they saw.
//! EM weighs each step by τ = 5 / (4 + e²/(σ² + ν²)); θ is then a weighted least-squares solution, and ν moves by its own slope.

use super::{Followed, ImplantSettings, Weighed};
use crate::linear::{Cholesky, add_outer};
use models::policy::unsquash;
use models::{Features, PolicyImplant};

/// Degrees of freedom of the errors.
const FREEDOM: f64 = 4.0;
/// Steps of EM.
const STEPS: usize = 8;
/// Prior of ln ν: mean, deviation.
const LOG_NOISE: [f64; 2] = [-1.5, 1.0];

/// One number of the actions: all that is needed of it.
struct Row<'a> {
    /// x of every step, `width` numbers each.
    x: &'a [f64],
    width: usize,
    /// u − μ(z).
    error: Vec<f64>,
    /// σ(z)².
    variance: Vec<f64>,
    settings: &'a ImplantSettings,
}

/// Finds the best policy implant, where there is one, and weighs the evidence. What is noticed is no matter of chance here: there is one
/// column for each step.
pub(super) fn weigh(
    followed: &Followed,
    features: &Features,
    with_policy: bool,
    settings: &ImplantSettings,
) -> Weighed {
    let (actions, count) = (followed.actions, features.count());
    let width = if with_policy { 1 + count } else { 0 };
    let latent = followed.z.len() / followed.steps().max(1);
    let mut x = Vec::with_capacity(followed.steps() * width);
    if with_policy {
        let mut phi = vec![0.0; count];
        for z in followed.z.chunks_exact(latent.max(1)) {
            features.write(z, &mut phi);
            x.push(1.0);
            x.extend(phi.iter().map(|phi| f64::from(*phi)));
        }
    }
    let mut rounds = vec![0.0; followed.rounds()];
    let mut policy = PolicyImplant::default();
    let mut occam = 0.0;
    for row in 0..actions {
        let taken = followed.taken.chunks_exact(actions);
        let robot = followed.robot.chunks_exact(2 * actions);
        let (error, variance) = taken
            .zip(robot)
            .map(|(taken, robot)| {
                let (u, mean) = (f64::from(unsquash(taken[row])), f64::from(robot[row]));
                (u - mean, f64::from(robot[actions + row]).powi(2))
            })
            .unzip();
        let mut own = Row {
            x: &x,
            width,
            error,
            variance,
            settings,
        };
        let (theta, log_noise, cost) = if with_policy {
            own.fit()
        } else {
            (Vec::new(), f64::NEG_INFINITY, 0.0)
        };
        own.explain(&theta);
        let noise = log_noise.exp();
        for (t, round) in followed.round.iter().enumerate() {
            let scale = own.variance[t] + noise * noise;
            rounds[*round as usize] += log_student(own.error[t], scale);
        }
        occam += cost;
        if let Some((bias, residual)) = theta.split_first() {
            policy.bias.push(*bias as f32);
            policy.residual.extend(residual.iter().map(|w| *w as f32));
            policy.noise.push(noise as f32);
        }
    }
    Weighed {
        policy: with_policy.then_some(policy),
        rounds,
        occam,
    }
}

/// ln t₄(e; 0, scale), without its constant.
fn log_student(error: f64, scale: f64) -> f64 {
    -0.5 * scale.ln() - 0.5 * (FREEDOM + 1.0) * (error * error / (scale * FREEDOM)).ln_1p()
}

impl Row<'_> {
    fn x(&self, t: usize) -> &[f64] {
        &self.x[t * self.width..(t + 1) * self.width]
    }

    fn deviation(&self, i: usize) -> f64 {
        f64::from(match i {
            0 => self.settings.bias,
            _ => self.settings.residual,
        })
    }

    /// Takes out of the errors what θ explains.
    fn explain(&mut self, theta: &[f64]) {
        if theta.is_empty() {
            return;
        }
        for t in 0..self.error.len() {
            let explained: f64 = self.x(t).iter().zip(theta).map(|(x, w)| x * w).sum();
            self.error[t] -= explained;
        }
    }

    /// θ, ln ν, and log prior with Occam factor.
    fn fit(&self) -> (Vec<f64>, f64, f64) {
        let (steps, width) = (self.error.len(), self.width);
        let mut theta = vec![0.0; width];
        let mut log_noise = LOG_NOISE[0];
        let mut log_determinant = 0.0;
        let mut matrix = vec![0.0; width * width];
        let mut left = self.error.clone();
        for _ in 0..STEPS {
            let noise = (2.0 * log_noise).exp();
            matrix.fill(0.0);
            let mut target = vec![0.0; width];
            for t in 0..steps {
                let scale = self.variance[t] + noise;
                let weight = (FREEDOM + 1.0) / (FREEDOM + left[t] * left[t] / scale) / scale;
                add_outer(&mut matrix, self.x(t), weight);
                for (sum, x) in target.iter_mut().zip(self.x(t)) {
                    *sum += weight * self.error[t] * x;
                }
            }
            for i in 0..width {
                matrix[i * width + i] += self.deviation(i).powi(-2);
            }
            let factor = Cholesky::new(matrix.clone(), width);
            factor.solve(&mut target);
            theta.copy_from_slice(&target);
            log_determinant = factor.log_determinant();
            for (t, left) in left.iter_mut().enumerate() {
                let explained: f64 = self.x(t).iter().zip(&theta).map(|(x, w)| x * w).sum();
                *left = self.error[t] - explained;
            }
            log_noise = self.noise_of(&left, log_noise);
        }
        let mut occam = -0.5 * log_determinant;
        for (i, w) in theta.iter().enumerate() {
            let deviation = self.deviation(i);
            occam -= 0.5 * (w / deviation).powi(2) + deviation.ln();
        }
        occam -= 0.5 * ((log_noise - LOG_NOISE[0]) / LOG_NOISE[1]).powi(2);
        (theta, log_noise, occam)
    }

    /// Newton's steps on ln ν with θ as it is.
    fn noise_of(&self, left: &[f64], start: f64) -> f64 {
        let mut log_noise = start;
        for _ in 0..4 {
            let noise = (2.0 * log_noise).exp();
            let (mut slope, mut curvature) = (0.0, 0.0);
            for (error, variance) in left.iter().zip(&self.variance) {
                let scale = variance + noise;
                let share = noise / scale;
                let weight = (FREEDOM + 1.0) / (FREEDOM + error * error / scale);
                slope += share * (weight * error * error / scale - 1.0);
                // Expected, not observed: never negative.
                curvature += 2.0 * share * share * FREEDOM / (FREEDOM + 3.0);
            }
            slope -= (log_noise - LOG_NOISE[0]) / LOG_NOISE[1].powi(2);
            curvature += LOG_NOISE[1].powi(-2);
            log_noise = (log_noise + (slope / curvature).clamp(-1.0, 1.0)).clamp(-8.0, 2.0);
        }
        log_noise
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::implants::tests::settings;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// A habit, a tendency and hands that shake are found out, whatever one step in fifty does.
    #[test]
    fn finds_bias_residual_and_noise_among_outliers() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut normal = || -> f32 { StandardNormal.sample(&mut rng) };
        let mut followed = Followed {
            samples: 1,
            actions: 1,
            ..Followed::default()
        };
        for t in 0..3000_u32 {
            let (z, mean, own) = (normal(), normal() * 0.2, 0.05);
            let mut u = mean + 0.1 - 0.15 * z.clamp(-2.5, 2.5) + f32::hypot(own, 0.2) * normal();
            if t.is_multiple_of(50) {
                u += 1.5;
            }
            followed.robot.extend_from_slice(&[mean, own]);
            followed.z.push(z);
            followed.taken.push(u.tanh());
            followed.round.push(t / 300);
        }
        let features = Features {
            center: vec![0.0],
            directions: vec![1.0],
        };
        let found = weigh(&followed, &features, true, &settings());
        let found = found.policy.expect("there is a policy implant");
        assert!((found.bias[0] - 0.1).abs() < 0.03, "{found:?}");
        assert!((found.residual[0] + 0.15).abs() < 0.02, "{found:?}");
        // Of a normal error, t₄'s best scale is somewhat smaller than the deviation.
        assert!((0.13..0.24).contains(&found.noise[0]), "{found:?}");
    }
}
