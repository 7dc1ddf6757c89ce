//! Diagonal Gaussians: reparameterised samples, log-densities and divergences, summed over features.

use super::{Op, Tape, Var};
use crate::kernels;

impl Tape<'_> {
    /// z = μ + σ ⊙ ε, all of one shape.
    pub fn gaussian_sample(&mut self, mean: Var, deviation: Var, noise: Var) -> Var {
        let (rows, cols) = self.shape(mean);
        self.same_shapes(&[mean, deviation, noise]);
        let op = Op::Sample {
            mean,
            deviation,
            noise,
        };
        self.record(op, rows, cols, |before, out| {
            let [m, s, e] = [mean, deviation, noise].map(|v| before.value(v));
            kernels::sample(true, out, m, s, e);
        })
    }

    /// ln N(x; μ, σ) of each feature: rows × batch. A mean or deviation of one column holds for every column.
    pub fn gaussian_log_density_terms(&mut self, x: Var, mean: Var, deviation: Var) -> Var {
        let (rows, cols) = self.shape(x);
        let mean = self.same_columns(mean, cols);
        let deviation = self.same_columns(deviation, cols);
        self.same_shapes(&[x, mean, deviation]);
        let op = Op::LogDensity { x, mean, deviation };
        self.record(op, rows, cols, |before, out| {
            let [x, m, s] = [x, mean, deviation].map(|v| before.value(v));
            kernels::log_density(true, out, x, m, s);
        })
    }

    /// ln N(x; μ, σ) summed over features: 1 × batch.
    pub fn gaussian_log_density(&mut self, x: Var, mean: Var, deviation: Var) -> Var {
        let terms = self.gaussian_log_density_terms(x, mean, deviation);
        self.sum_rows(terms)
    }

    /// KL[N(μq, σq) ‖ N(μp, σp)] of each feature: rows × batch.
    pub fn gaussian_kl_terms(&mut self, mean_q: Var, dev_q: Var, mean_p: Var, dev_p: Var) -> Var {
        let (rows, cols) = self.shape(mean_q);
        self.same_shapes(&[mean_q, dev_q, mean_p, dev_p]);
        let op = Op::Kl {
            mean_q,
            dev_q,
            mean_p,
            dev_p,
        };
        self.record(op, rows, cols, |before, out| {
            let [a, b, c, d] = [mean_q, dev_q, mean_p, dev_p].map(|v| before.value(v));
            kernels::kl(true, out, a, b, c, d);
        })
    }

    /// KL[N(μq, σq) ‖ N(μp, σp)] summed over features: 1 × batch.
    pub fn gaussian_kl(&mut self, mean_q: Var, dev_q: Var, mean_p: Var, dev_p: Var) -> Var {
        let terms = self.gaussian_kl_terms(mean_q, dev_q, mean_p, dev_p);
        self.sum_rows(terms)
    }

    /// Σ ln(1 − tanh²u) over features: 1 × batch, as 2 (ln2 − u − softplus(−2u)).
    pub fn tanh_log_det(&mut self, u: Var) -> Var {
        let terms = self.tanh_log(u);
        self.sum_rows(terms)
    }

    fn same_shapes(&self, vars: &[Var]) {
        for &v in vars {
            assert_eq!(
                self.shape(v),
                self.shape(vars[0]),
                "shapes of a Gaussian's parts"
            );
        }
    }
}
