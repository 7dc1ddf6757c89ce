//! The assistant in one process: belief, human model and planner in the order in which a step needs them. The process
//! set does the same with messages in between; given the same inputs both decide the same, bit for bit.

use crate::chooser::{Chooser, Method};
use crate::people::{LocalPeople, PeopleError};
use crate::planner::{Decision, From, GROUPS, Settings};
use models::imagined::ImaginedGroups;
use models::observation::{AZIMUTHS, Encoded, SECTORS};
use models::policy::ActionDistribution;
use models::{Beliefs, Communicated, Filter, HumanModel, Observations, SelfModel};
use nn::Tensor;
use std::sync::Arc;

/// A robot's self-model, a human model and a planner.
pub struct Assistant {
    model: Arc<SelfModel>,
    human: Box<dyn HumanModel>,
    planner: Chooser,
    filter: Filter,
    beliefs: Beliefs,
    expected: ActionDistribution,
    observations: Observations,
    encoded: Encoded,
    action: Tensor,
    groups: ImaginedGroups,
    pending: Vec<Tensor>,
}

impl Assistant {
    /// An assistant that observed nothing yet. Settings must have no [`Settings::problem`].
    pub fn new(model: Arc<SelfModel>, human: Box<dyn HumanModel>, settings: Settings) -> Self {
        Self::with_method(model, human, settings, Method::Ce)
    }

    /// As [`Self::new`], deciding by `method`.
    pub fn with_method(
        model: Arc<SelfModel>,
        human: Box<dyn HumanModel>,
        settings: Settings,
        method: Method,
    ) -> Self {
        let sizes = model.sizes;
        let actions = sizes.shape.action;
        let rows = settings.samples / GROUPS;
        Self {
            planner: Chooser::new(method, settings, &model),
            filter: Filter::new(sizes.latent, 1),
            beliefs: Beliefs::new(human.latent(), 1),
            expected: ActionDistribution::new(actions, 1),
            observations: Observations::new(&sizes.shape, 1),
            encoded: Encoded::new(sizes.shape, 1),
            action: Tensor::new(actions, 1),
            groups: ImaginedGroups::new(human.latent(), actions, GROUPS, rows),
            pending: vec![Tensor::new(actions, rows); GROUPS],
            model,
            human,
        }
    }

    /// An episode begins.
    pub fn reset(&mut self) {
        self.filter.reset();
        self.beliefs.reset();
    }

    /// Step k is sensed: updates z^R and z^H. `visual`: 113 numbers as sensed; `verbal`: 120, of what was really spoken;
    /// `shown`: the sectors highlighted and spoken about; `taken`: the person's action at k − 1 (ignored at first).
    pub fn observe(
        &mut self,
        visual: &[f32],
        verbal: &[f32],
        shown: Communicated,
        taken: [f32; 2],
    ) {
        self.action.column_mut(0).copy_from_slice(&taken);
        self.encoded
            .set(0, visual, verbal, &[1.0; AZIMUTHS], &[0.0; SECTORS]);
        self.filter.update(&self.model, &self.action, &self.encoded);
        self.observations
            .visual
            .column_mut(0)
            .copy_from_slice(visual);
        self.observations
            .verbal
            .column_mut(0)
            .copy_from_slice(verbal);
        self.human.perceive(
            &mut self.beliefs,
            &self.action,
            &self.observations,
            &[shown],
            None,
        );
    }

    /// The distribution of the person's action at step k.
    pub fn expected_action(&mut self) -> &ActionDistribution {
        self.human.act(&self.beliefs, &mut self.expected);
        &self.expected
    }

    /// Decides what to communicate at step k + 1, knowing what the person does at step k.
    ///
    /// # Errors
    /// None that a human model in the same process could cause.
    pub fn decide(
        &mut self,
        known_action: Option<[f32; 2]>,
        speech_ready_steps: usize,
        seed: u64,
        episode: u32,
        step: u32,
    ) -> Result<Decision, PeopleError> {
        let mut people = LocalPeople {
            model: self.human.as_mut(),
            person: &self.beliefs,
            groups: &mut self.groups,
            pending: &mut self.pending,
        };
        let from = From {
            mean: &self.filter.mean,
            deviation: &self.filter.deviation,
            known_action,
            speech_ready_steps,
            seed,
            episode,
            step,
        };
        self.planner.plan(&self.model, from, &mut people)
    }
}
