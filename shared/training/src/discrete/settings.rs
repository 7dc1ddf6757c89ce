//! Settings of a gridworld's training run: the paper's schedules, and what we chose beside them.

use crate::config::{self, Checked};
use serde::{Deserialize, Serialize};

/// Settings of a training run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Seed of everything: no configuration has it.
    #[serde(default)]
    pub seed: u64,
    /// Phases.
    pub phases: u32,
    /// Rounds lived in a phase.
    pub rounds: u32,
    /// Gradient steps in a phase.
    pub gradient_steps: usize,
    /// Sequences per gradient step.
    pub sequences: usize,
    /// Observations per sequence.
    pub length: usize,
    /// Rate of Adam; driving's is the paper's.
    pub learning_rate: f32,
    /// Longest gradient of the world model, and of the Q-network.
    pub gradient_clip: f32,
    /// Observations that the replay buffer holds.
    pub replay: usize,
    /// β at the start: the paper's.
    pub expert: f32,
    /// Its factor per phase.
    pub expert_decay: f32,
    /// ε at the start: the paper's.
    pub explore: f32,
    /// Its factor per phase.
    pub explore_decay: f32,
    /// Probability, in every step and whoever acts, of anything at all instead: who never sees a wrong button pressed cannot imagine what
    /// somebody's mistake costs.
    pub slips: f32,
    /// Probability that dropout keeps a value, as on the highway.
    pub keep: f32,
    /// γ.
    pub discount: f32,
    /// Rate at which the target follows.
    pub target_rate: f32,
    /// λ where the best action was taken.
    pub trace: f32,
    /// m of L_m, the margin of Hester et al.
    pub margin: f32,
    /// Whether q_φ learns from L_Q and L_m beside the ELBO.
    pub joint: bool,
    /// w: weight of L_m.
    pub imitation: f32,
    /// Share of the phases, the first ones, over which the weight of the ELBO's divergence grows from 0 to 1.
    pub warming: f32,
    /// Share of the phases, the last ones, over which the learning rate falls to nothing.
    pub cooling: f32,
}

impl Settings {
    /// What ships for a domain ([`crate::config`]).
    pub fn of(domain: &str) -> Self {
        config::gridworld(domain).self_model
    }

    /// The weight of the divergence in a phase.
    pub fn divergence_at(&self, phase: u32) -> f32 {
        let warming = (self.warming * self.phases as f32).max(1.0);
        ((phase + 1) as f32 / warming).min(1.0)
    }

    /// The learning rate of a phase.
    pub fn rate_at(&self, phase: u32) -> f32 {
        let left = self.phases.saturating_sub(phase) as f32;
        let cooling = (self.cooling * self.phases as f32).max(1.0);
        self.learning_rate * (left / cooling).min(1.0)
    }
}

impl Checked for Settings {
    fn problem(&self) -> Option<String> {
        if !(2..=256).contains(&self.length) {
            return Some(format!("length must be from 2 to 256, not {}", self.length));
        }
        if !(crate::SHARDS..=100_000).contains(&self.sequences) {
            let (least, found) = (crate::SHARDS, self.sequences);
            return Some(format!(
                "sequences must be from {least} to 100000, not {found}"
            ));
        }
        if self.rounds == 0 || self.replay < 1000 {
            return Some("rounds must be at least 1 and replay at least 1000".to_owned());
        }
        let positive = |x: f32| x.is_finite() && x > 0.0;
        if !positive(self.learning_rate) || !positive(self.gradient_clip) {
            return Some("learning_rate and gradient_clip must be positive".to_owned());
        }
        let not_negative = |x: f32| x.is_finite() && x >= 0.0;
        if !not_negative(self.margin) || !not_negative(self.imitation) {
            return Some("margin and imitation must not be negative".to_owned());
        }
        let shares = [
            self.expert,
            self.expert_decay,
            self.explore,
            self.explore_decay,
            self.slips,
            self.keep,
            self.discount,
            self.target_rate,
            self.trace,
            self.warming,
            self.cooling,
        ];
        (!shares.iter().all(|x| (0.0..=1.0).contains(x))).then(|| {
            "expert, explore, their decays, keep, discount, target_rate, trace, warming and cooling must lie in [0, 1]"
                .to_owned()
        })
    }
}
