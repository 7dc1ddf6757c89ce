//! The cross-entropy method over independent Bernoulli bits (paper §III-C, "Planning").
//!
//! ```text
//! ω_i ~ Π_b Bernoulli(p_b)        i = 1 … candidates
//! p_b ← α · mean over elites of ω_{i,b} + (1 − α) · p_b
//! ```

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The distribution over bit strings, and a population drawn from it.
pub struct Population {
    /// p_b.
    pub probability: Vec<f32>,
    /// Bits whose value is fixed at 0 for this plan.
    pub forbidden: Vec<bool>,
    bits: Vec<bool>,
    order: Vec<u32>,
    candidates: usize,
}

impl Population {
    /// `candidates` strings of `bits` bits.
    pub fn new(candidates: usize, bits: usize) -> Self {
        Self {
            probability: vec![0.0; bits],
            forbidden: vec![false; bits],
            bits: vec![false; candidates * bits],
            order: (0..candidates as u32).collect(),
            candidates,
        }
    }

    /// The bits of candidate `i`.
    pub fn candidate(&self, i: usize) -> &[bool] {
        let n = self.probability.len();
        &self.bits[i * n..(i + 1) * n]
    }

    /// Draws the population anew; the first `silent` candidates stay all zero, as a measure of saying nothing.
    pub fn draw(&mut self, rng: &mut ChaCha8Rng, silent: usize) {
        let n = self.probability.len();
        for i in 0..self.candidates {
            for b in 0..n {
                let drawn = rng.random::<f32>() < self.probability[b];
                self.bits[i * n + b] = drawn && i >= silent && !self.forbidden[b];
            }
        }
    }

    /// Moves p_b towards the elites, the candidates of highest value, and returns the elites' mean value.
    pub fn update(&mut self, values: &[f32], elites: usize, smoothing: f32) -> f32 {
        let elites = elites.clamp(1, self.candidates);
        // Ties and order are settled by index, so that the result depends on nothing but the values.
        self.order.sort_unstable_by(|&a, &b| {
            values[b as usize]
                .total_cmp(&values[a as usize])
                .then(a.cmp(&b))
        });
        let n = self.probability.len();
        let chosen = &self.order[..elites];
        for b in 0..n {
            let ones = chosen
                .iter()
                .filter(|&&i| self.bits[i as usize * n + b])
                .count();
            let mean = ones as f32 / elites as f32;
            self.probability[b] = smoothing * mean + (1.0 - smoothing) * self.probability[b];
        }
        chosen.iter().map(|&i| values[i as usize]).sum::<f32>() / elites as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    /// On a separable objective the method has to find the best bit string.
    #[test]
    fn finds_the_best_bits() {
        let weights = [3.0, -2.0, 0.5, -0.1, 1.0, -4.0];
        let mut population = Population::new(400, weights.len());
        population.probability.fill(0.35);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut values = vec![0.0; 400];
        for _ in 0..12 {
            population.draw(&mut rng, 0);
            for (i, value) in values.iter_mut().enumerate() {
                *value = population
                    .candidate(i)
                    .iter()
                    .zip(&weights)
                    .map(|(&bit, w)| if bit { *w } else { 0.0 })
                    .sum();
            }
            population.update(&values, 80, 0.8);
        }
        for (p, w) in population.probability.iter().zip(&weights) {
            assert_eq!(*p > 0.5, *w > 0.0, "p {p} for weight {w}");
        }
    }

    #[test]
    fn forbidden_and_silent_stay_zero() {
        let mut population = Population::new(50, 4);
        population.probability.fill(1.0);
        population.forbidden[2] = true;
        population.draw(&mut ChaCha8Rng::seed_from_u64(0), 5);
        for i in 0..50 {
            let bits = population.candidate(i);
            assert!(!bits[2]);
            assert_eq!(bits[0], i >= 5);
        }
    }

    #[test]
    fn ties_are_settled_by_index() {
        let mut population = Population::new(4, 1);
        population.probability[0] = 0.5;
        population.bits = vec![true, false, true, false];
        population.update(&[1.0; 4], 2, 1.0);
        assert_eq!(population.probability[0], 0.5);
    }
}
