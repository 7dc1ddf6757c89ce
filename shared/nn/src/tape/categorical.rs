//! Categorical distributions from their logits: likelihood and entropy.

use super::{Tape, Var};

impl Tape<'_> {
    /// −ln p of each column's class, p = softmax(logits): 1 × batch.
    ///
    /// # Panics
    /// If there are not as many classes as columns, or one is out of range.
    pub fn categorical_nll(&mut self, logits: Var, classes: &[u32]) -> Var {
        let log = self.log_softmax(logits);
        let chosen = self.select_log_prob(log, classes);
        self.neg(chosen)
    }

    /// −Σ p ln p of each column, p = softmax(logits): 1 × batch.
    pub fn categorical_entropy(&mut self, logits: Var) -> Var {
        let log = self.log_softmax(logits);
        let p = self.exp(log);
        let terms = self.mul(p, log);
        let sum = self.sum_rows(terms);
        self.neg(sum)
    }
}
