//! Settings of a gridworld's training run: the paper's schedules, and what we chose beside them.

use domains::discrete::Domain;
use serde::{Deserialize, Serialize};

/// Settings of a training run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Seed of everything.
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
    /// The paper's schedules for a domain, with lengths of training that keep DESIGN §9's budgets.
    pub fn of(domain: Domain) -> Self {
        let driving = Self {
            seed: 0,
            phases: 60,
            rounds: 16,
            gradient_steps: 300,
            sequences: 32,
            length: 16,
            learning_rate: 3e-4,
            gradient_clip: 100.0,
            replay: 100_000,
            expert: 0.5,
            expert_decay: 0.8,
            explore: 0.5,
            explore_decay: 0.75,
            slips: 0.0,
            keep: 0.35,
            discount: 0.95,
            target_rate: 0.01,
            trace: 0.8,
            margin: 0.8,
            joint: false,
            imitation: 1.0,
            warming: 0.0,
            cooling: 0.3,
        };
        match domain {
            Domain::Driving => driving,
            // Short phases: what an expert never does is valued by extrapolation until the policy has tried it, so that the policy
            // has to act often. The paper names no learning rate here; at driving's, images are read after three times as many
            // steps. The world model needs more of them than the policy: after 150 phases of 60, the reward imagined four steps
            // ahead was off by 1.2, after these by 0.1.
            Domain::SearchRescue => Self {
                phases: 200,
                rounds: 9,
                gradient_steps: 100,
                learning_rate: 1e-3,
                expert: 1.0,
                expert_decay: 0.98,
                explore_decay: 0.9,
                joint: true,
                warming: 0.2,
                ..driving
            },
            // Rounds are short: three presses of an expert. More of them, and more sequences of half the length. And more phases:
            // the reward of a right press, imagined a step ahead, was off by 1.6 of 4 after 200, by 0.04 after these.
            Domain::BombDefusal => Self {
                phases: 450,
                rounds: 24,
                slips: 0.4,
                sequences: 64,
                length: 8,
                ..Self::of(Domain::SearchRescue)
            },
        }
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

    /// A reason why these settings make no sense, if there is one.
    pub fn problem(&self) -> Option<String> {
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
