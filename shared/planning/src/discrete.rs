//! The assistant of a gridworld in one process: belief, human model and planner in the order in which a step needs them.

use crate::chooser::{Chooser, Method};
use crate::items::Items;
use crate::people::{ImaginedPeople, LocalPeople, PeopleError};
use crate::planner::{From, GROUPS, Plan, Settings};
use domains::discrete::{Layout, Mask, Planning};
use models::discrete::{DiscreteFilter, DiscreteModel};
use models::human::following;
use models::imagined::ImaginedGroups;
use models::policy::ActionDistribution;
use models::{Beliefs, Communicated, HumanModel, Observations};
use nn::Tensor;
use std::sync::Arc;

impl Items for Arc<Layout> {
    fn visual_items(&self) -> usize {
        self.regions
    }

    fn verbal_items(&self) -> usize {
        self.utterances
    }

    fn possible(&self) -> Communicated {
        self.communicable.into()
    }

    fn hears(&self) -> bool {
        self.heard != 0
    }

    /// All of them: a step of a gridworld is long.
    fn spoken_at_once(&self) -> u32 {
        self.utterances as u32
    }

    /// The domain's costs, quadratic in the number of items of each modality (paper, Table "Communication Modalities and
    /// Costs").
    fn cost(&self, _: &Settings, communicated: Communicated) -> f32 {
        Layout::cost(self, communicated.into())
    }
}

/// A scene's planning settings as the planner takes them.
pub fn settings_of(planning: &Planning) -> Settings {
    Settings {
        horizon: planning.horizon as usize,
        hold: planning.repeat as usize,
        samples: planning.samples as usize,
        futures: planning.futures as usize,
        iterations: planning.iterations as usize,
        elites: planning.elites as usize,
        smoothing: planning.smoothing as f32,
        first_probability: planning.first_probability as f32,
        warm_start: planning.warm_start as f32,
        discount: planning.discount as f32,
        reward_weight: planning.reward_weight as f32,
        terminal_value: planning.terminal_value,
        visual_threshold: planning.visual_threshold as f32,
        verbal_threshold: planning.verbal_threshold as f32,
        ..Settings::default()
    }
}

/// The planner of a gridworld.
pub type DiscretePlanner = Chooser<DiscreteModel, Arc<Layout>>;

/// A robot's self-model, a human model and a planner.
pub struct DiscreteAssistant {
    model: Arc<DiscreteModel>,
    human: Box<dyn HumanModel>,
    planner: DiscretePlanner,
    filter: DiscreteFilter,
    beliefs: Beliefs,
    expected: ActionDistribution,
    observations: Observations,
    observed: Tensor,
    action: Tensor,
    groups: ImaginedGroups,
    pending: Vec<Tensor>,
    noise: Vec<f32>,
}

impl DiscreteAssistant {
    /// An assistant that observed nothing yet. Settings must have no [`Settings::problem`].
    pub fn new(model: Arc<DiscreteModel>, human: Box<dyn HumanModel>, settings: Settings) -> Self {
        Self::with_method(model, human, settings, Method::Ce)
    }

    /// As [`Self::new`], deciding by `method`.
    pub fn with_method(
        model: Arc<DiscreteModel>,
        human: Box<dyn HumanModel>,
        settings: Settings,
        method: Method,
    ) -> Self {
        let shape = model.sizes.shape;
        let rows = settings.samples / GROUPS;
        let layout = Arc::clone(&model.layout);
        Self {
            planner: Chooser::with_items(method, settings, &*model, layout),
            filter: DiscreteFilter::new(model.sizes.latent, 1),
            beliefs: Beliefs::new(human.latent(), 1),
            expected: human.distribution(1),
            observations: Observations::new(&shape, 1),
            observed: Tensor::new(model.view.rows(), 1),
            action: Tensor::new(shape.action, 1),
            groups: ImaginedGroups::for_model(&*human, GROUPS, rows),
            pending: vec![Tensor::new(shape.action, rows); GROUPS],
            noise: vec![0.0; human.noise_rows()],
            model,
            human,
        }
    }

    /// An episode begins.
    pub fn reset(&mut self) {
        self.filter.reset();
        self.beliefs.reset();
    }

    /// Step k is sensed: updates z^R and z^H. `told`: what the person was shown and told for this step; `taken`: what they did
    /// at k − 1, none at first; `at`: seed, episode and step, which decide what the person is taken to notice by chance.
    pub fn observe(
        &mut self,
        visual: &[f32],
        verbal: &[f32],
        told: Mask,
        taken: Option<usize>,
        at: [u64; 3],
    ) {
        self.set_action(taken);
        let everything = self.model.layout.everything();
        let out = self.observed.column_mut(0);
        self.model.view.write(visual, verbal, everything, out);
        self.filter
            .update(&self.model, &self.action, &self.observed);
        let Observations {
            visual: seen,
            verbal: said,
        } = &mut self.observations;
        seen.column_mut(0).copy_from_slice(visual);
        said.column_mut(0).copy_from_slice(verbal);
        let noise = following(&*self.human, at, &mut self.noise);
        self.human.perceive(
            &mut self.beliefs,
            &self.action,
            &self.observations,
            &[told.into()],
            noise,
        );
    }

    fn set_action(&mut self, taken: Option<usize>) {
        self.action.fill(0.0);
        if let Some(taken) = taken {
            self.action.column_mut(0)[taken] = 1.0;
        }
    }

    /// The distribution of the person's action at step k.
    pub fn expected_action(&mut self) -> &ActionDistribution {
        self.human.act(&self.beliefs, &mut self.expected);
        &self.expected
    }

    /// Probability of an item in the last plan's first decision: visual items, then verbal ones.
    pub fn probability(&self, item: usize) -> f32 {
        self.planner.probability(item)
    }

    /// What the robot believes: mean and deviation of z^R, `latent × 1`.
    pub fn belief(&self) -> &DiscreteFilter {
        &self.filter
    }

    /// Decides what to communicate at step k + 1, knowing what the person does at step k where `known_action` says so.
    ///
    /// # Errors
    /// None that a human model in the same process could cause.
    pub fn decide(
        &mut self,
        known_action: Option<usize>,
        seed: u64,
        episode: u32,
        step: u32,
    ) -> Result<Plan, PeopleError> {
        self.set_action(known_action);
        let mut people = LocalPeople {
            model: self.human.as_mut(),
            person: &self.beliefs,
            groups: &mut self.groups,
            pending: &mut self.pending,
        };
        let known_action = known_action.map(|_| self.action.column(0));
        let from = From {
            mean: &self.filter.mean,
            deviation: &self.filter.deviation,
            known_action,
            speech_ready_steps: 0,
            seed,
            episode,
            step,
        };
        self.planner.search(&self.model, &from, &mut people)
    }

    /// [`Self::decide`] with imagined people of the caller's, in place of the human model.
    ///
    /// # Errors
    /// What the people answer.
    pub fn decide_with(
        &mut self,
        people: &mut dyn ImaginedPeople,
        known_action: Option<usize>,
        seed: u64,
        episode: u32,
        step: u32,
    ) -> Result<Plan, PeopleError> {
        self.set_action(known_action);
        let from = From {
            mean: &self.filter.mean,
            deviation: &self.filter.deviation,
            known_action: known_action.map(|_| self.action.column(0)),
            speech_ready_steps: 0,
            seed,
            episode,
            step,
        };
        self.planner.search(&self.model, &from, people)
    }
}
