//! The planner's state from step to step: between messages and the planning library, where a plan starts, and what its
//! decision looks like on the topic.

use crate::PlannerOptions;
use domains::Layout;
use messages::{CommAction, DecisionReason, DriverAction, RobotBelief};
use models::SelfModel;
use nn::Tensor;
use planning::planner::{From, Plan, Settings};
use planning::{Chooser, ImaginedPeople, Items, PeopleError};
use scenario::Scenario;
use std::sync::Arc;
use std::time::Instant;

/// The planner with what it keeps from step to step. Allocates nothing after its first plan.
pub struct PlannerState {
    planner: DomainPlanner,
    settings: Settings,
    mean: Tensor,
    std: Tensor,
    /// What the person does, as models take it.
    action: Tensor,
    seed: u64,
    step_s: f32,
    real_step_s: f32,
    plan: Plan,
    /// Probability of each item in the last plan: visual, then verbal.
    probability: Vec<f32>,
    /// So many of them are visual.
    visual_items: usize,
    /// Whether people hear words without an assistant.
    hears: bool,
}

/// A planner and its world model.
type DomainPlanner =
    Scenario<(SelfModel, Chooser), (Arc<SelfModel>, Chooser<SelfModel, Arc<Layout>>)>;

impl PlannerState {
    /// The highway's planner, which has planned nothing yet; settings must have no problem.
    pub fn highway(options: &PlannerOptions, model: SelfModel) -> Self {
        let chooser = Chooser::new(options.method.chooser(), options.settings, &model);
        let (latent, actions) = (model.sizes.latent, model.sizes.shape.action);
        let planner = Scenario::Highway((model, chooser));
        Self::new(options, planner, latent, actions, &planning::items::Sectors)
    }

    /// A gridworld's planner.
    pub fn gridworld(options: &PlannerOptions, model: Arc<SelfModel>) -> Self {
        let layout = Arc::clone(&model.layout);
        let method = options.method.chooser();
        let items = Arc::clone(&layout);
        let planner = Chooser::with_items(method, options.settings, &*model, items);
        let (latent, actions) = (model.sizes.latent, model.sizes.shape.action);
        let planner = Scenario::Gridworld((model, planner));
        Self::new(options, planner, latent, actions, &layout)
    }

    fn new(
        options: &PlannerOptions,
        planner: DomainPlanner,
        latent: usize,
        actions: usize,
        items: &dyn Items,
    ) -> Self {
        Self {
            planner,
            settings: options.settings,
            mean: Tensor::new(latent, 1),
            std: Tensor::new(latent, 1),
            action: Tensor::new(actions, 1),
            seed: options.seed,
            step_s: options.step_s,
            real_step_s: options.real_step_s.unwrap_or(options.step_s),
            plan: Plan::default(),
            probability: vec![0.0; items.count()],
            visual_items: items.visual_items(),
            hears: items.hears(),
        }
    }

    /// Whether people hear words without an assistant.
    pub fn hears(&self) -> bool {
        self.hears
    }

    /// Dimensions of a belief.
    pub fn latent(&self) -> usize {
        self.mean.rows()
    }

    /// Numbers of an action.
    pub fn actions(&self) -> usize {
        self.action.rows()
    }

    /// Nanoseconds of a control step where the world does not wait.
    pub fn step_ns(&self) -> u64 {
        (f64::from(self.real_step_s) * 1e9) as u64
    }

    /// Nanoseconds after a step is sensed at which the decision about the next has to stand.
    pub fn budget_ns(&self) -> u64 {
        (self.step_ns() as f64 * f64::from(self.settings.race.budget)) as u64
    }

    /// Decides what to communicate one step after `belief`, knowing what the person does now where that is given.
    /// `speech_ready_s`: seconds until an utterance may start, seen from the belief's step; `until`: when the decision
    /// has to stand, in real time.
    ///
    /// # Errors
    /// What the imagined people answer.
    pub fn plan(
        &mut self,
        belief: &RobotBelief,
        acted: Option<&DriverAction>,
        speech_ready_s: f32,
        until: Option<Instant>,
        people: &mut dyn ImaginedPeople,
    ) -> Result<(), PeopleError> {
        let latent = self.latent();
        self.mean
            .column_mut(0)
            .copy_from_slice(&belief.mean[..latent]);
        self.std
            .column_mut(0)
            .copy_from_slice(&belief.deviation[..latent]);
        // A whole number of steps must not become one more by rounding. The decision is for the step after this one.
        let ready_steps = (speech_ready_s / self.step_s - 1e-3).ceil().max(0.0) as usize;
        let choice = acted.and_then(DriverAction::discrete);
        let choice = choice.map(|choice| choice as usize);
        let choice = choice.filter(|choice| *choice < self.action.rows());
        self.action.fill(0.0);
        if let Some(choice) = choice {
            self.action.column_mut(0)[choice] = 1.0;
        }
        let from = From {
            mean: &self.mean,
            deviation: &self.std,
            known_action: choice.map(|_| self.action.column(0)),
            speech_ready_steps: ready_steps.saturating_sub(1),
            seed: self.seed,
            episode: belief.header.episode,
            step: belief.header.step,
            until,
        };
        let probability = self.probability.iter_mut().enumerate();
        match &mut self.planner {
            Scenario::Highway((model, planner)) => {
                let from = from.knowing(acted.map(|acted| [acted.throttle, acted.steer]));
                self.plan = planner.search(model, &from, people)?;
                probability.for_each(|(item, p)| *p = planner.probability(item));
            }
            Scenario::Gridworld((model, planner)) => {
                self.plan = planner.search(model, &from, people)?;
                probability.for_each(|(item, p)| *p = planner.probability(item));
            }
        }
        Ok(())
    }

    /// Writes the last plan's decision, all but the header.
    pub fn write(&self, late: bool, out: &mut CommAction) {
        let plan = &self.plan;
        out.visual = plan.communicated.visual_bits();
        out.verbal = plan.communicated.verbal_bits();
        let (visual, verbal) = self.probability.split_at(self.visual_items);
        out.visual_probability[..visual.len()].copy_from_slice(visual);
        out.verbal_probability[..verbal.len()].copy_from_slice(verbal);
        out.value = plan.value;
        out.value_silent = plan.value_silent;
        out.cost = plan.cost;
        let reasons = plan.reasons;
        (out.gain_now, out.gain_later) = (reasons.gain_now, reasons.gain_later);
        out.gain_error = reasons.gain_error;
        (out.samples, out.iterations) = (reasons.rows, reasons.rounds);
        out.futures = reasons.futures;
        let reason = match late {
            true => DecisionReason::Late,
            false => DecisionReason::Planned,
        };
        out.reason = reason.wire();
    }
}
