//! Between messages and the planning library: where a plan starts, and what its decision looks like on the topic.

use crate::{Options, reason};
use messages::{CommAction, RobotBelief, SECTORS};
use models::SelfModel;
use nn::Tensor;
use planning::planner::{From, Settings};
use planning::{Chooser, Decision, ImaginedPeople, PeopleError};

/// The planner with what it keeps from step to step. Allocates nothing after its first plan.
pub struct Desk {
    planner: Chooser,
    settings: Settings,
    mean: Tensor,
    deviation: Tensor,
    seed: u64,
    step_s: f32,
}

impl Desk {
    /// A planner that has planned nothing yet; settings must have no problem.
    pub fn new(options: &Options, model: &SelfModel) -> Self {
        let latent = model.sizes.latent;
        Self {
            planner: Chooser::new(options.method.chooser(), options.settings, model),
            settings: options.settings,
            mean: Tensor::new(latent, 1),
            deviation: Tensor::new(latent, 1),
            seed: options.seed,
            step_s: options.step_s,
        }
    }

    /// Nanoseconds of a control step.
    pub fn step_ns(&self) -> u64 {
        (f64::from(self.step_s) * 1e9) as u64
    }

    /// Decides what to communicate one step after `belief`. `speech_ready_s`: seconds until an utterance may start, seen
    /// from the belief's step.
    ///
    /// # Errors
    /// What the imagined people answer.
    pub fn plan(
        &mut self,
        model: &SelfModel,
        belief: &RobotBelief,
        known_action: Option<[f32; 2]>,
        speech_ready_s: f32,
        people: &mut dyn ImaginedPeople,
    ) -> Result<Decision, PeopleError> {
        let latent = self.mean.rows();
        self.mean
            .column_mut(0)
            .copy_from_slice(&belief.mean[..latent]);
        self.deviation
            .column_mut(0)
            .copy_from_slice(&belief.deviation[..latent]);
        // A whole number of steps must not become one more by rounding. The decision is for the step after this one.
        let ready_steps = (speech_ready_s / self.step_s - 1e-3).ceil().max(0.0) as usize;
        let from = From {
            mean: &self.mean,
            deviation: &self.deviation,
            known_action,
            speech_ready_steps: ready_steps.saturating_sub(1),
            seed: self.seed,
            episode: belief.header.episode,
            step: belief.header.step,
        };
        self.planner.plan(model, from, people)
    }

    /// Writes a decision, all but the header.
    pub fn write(&self, decision: &Decision, late: bool, out: &mut CommAction) {
        out.visual = decision.communicated.visual_bits();
        out.verbal = decision.communicated.verbal_bits();
        let (visual, verbal) = decision.probability.split_at(SECTORS);
        out.visual_probability[..SECTORS].copy_from_slice(visual);
        out.verbal_probability[..SECTORS].copy_from_slice(verbal);
        out.value = decision.value;
        out.value_silent = decision.value_silent;
        out.cost = decision.cost;
        out.samples = self.settings.samples as u32;
        out.iterations = self.settings.iterations as u32;
        out.reason = if late { reason::LATE } else { reason::PLANNED };
    }
}
