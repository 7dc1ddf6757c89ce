//! The assistant in one process: belief, human model and planner in the order in which a step needs them. The process
//! set does the same with messages in between; given the same inputs both decide the same, bit for bit.

use crate::chooser::{Chooser, Method};
use crate::items::{Items, Sectors};
use crate::people::{ImaginedPeople, LocalPeople, PeopleError};
use crate::planner::{Decision, From, GROUPS, Plan, Settings};
use models::imagined::ImaginedGroups;
use models::{ActionDistribution, Communicated, Filter, FollowedPerson, HumanModel, SelfModel};
use nn::Tensor;
use std::sync::Arc;

/// A robot's self-model, a human model and a planner.
pub struct Assistant<I: Items = Sectors> {
    model: Arc<SelfModel>,
    human: Box<dyn HumanModel>,
    planner: Chooser<SelfModel, I>,
    filter: Filter,
    person: FollowedPerson,
    observed: Tensor,
    action: Tensor,
    groups: ImaginedGroups,
    pending: Vec<Tensor>,
}

/// When a plan is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlanMoment {
    /// Seed of the run.
    pub seed: u64,
    /// Episode.
    pub episode: u32,
    /// Step k.
    pub step: u32,
    /// Steps until the next sentence may start.
    pub speech_ready_steps: usize,
}

impl<I: Items> Assistant<I> {
    /// An assistant that observed nothing yet and communicates `items`. Settings must have no [`Settings::problem`].
    pub fn new(
        model: Arc<SelfModel>,
        mut human: Box<dyn HumanModel>,
        settings: Settings,
        method: Method,
        items: I,
    ) -> Self {
        let shape = model.sizes.shape;
        let rows = settings.most_rows();
        let mut groups = ImaginedGroups::new(&*human, GROUPS, rows);
        groups.warm(&mut *human, &shape, rows);
        Self {
            planner: Chooser::with_items(method, settings, &*model, items),
            filter: Filter::new(model.sizes.latent, 1),
            person: FollowedPerson::new(&*human, &shape),
            observed: Tensor::new(model.view.rows(), 1),
            action: Tensor::new(shape.action, 1),
            groups,
            pending: vec![Tensor::new(shape.action, rows); GROUPS],
            model,
            human,
        }
    }

    /// An episode begins.
    pub fn reset(&mut self) {
        self.filter.reset();
        self.person.reset(&*self.human);
    }

    /// Step k is sensed: updates z^R and z^H. `visual`: as sensed; `verbal`: what was, or could be, said; `told`: the items
    /// that are communicated in this step; `taken`: the person's action at k − 1, zeros at first; `at`: seed, episode and
    /// step, which decide what the person is taken to notice by chance.
    pub fn observe(
        &mut self,
        visual: &[f32],
        verbal: &[f32],
        told: Communicated,
        taken: &[f32],
        at: [u64; 3],
    ) {
        self.action.column_mut(0).copy_from_slice(taken);
        let sensed = self.model.layout.sensed;
        let out = self.observed.column_mut(0);
        self.model.view.write(visual, verbal, sensed, out);
        self.filter
            .update(&self.model, &self.action, &self.observed);
        let sensed = (visual, verbal);
        self.person
            .perceive(&mut *self.human, sensed, told, taken, at);
    }

    /// The distribution of the person's action at step k.
    pub fn expected_action(&self) -> &ActionDistribution {
        self.person.expected()
    }

    /// Probability of an item in the last plan's first decision: visual items, then verbal ones.
    pub fn probability(&self, item: usize) -> f32 {
        self.planner.probability(item)
    }

    /// What the robot believes: mean and deviation of z^R, `latent × 1`.
    pub fn belief(&self) -> &Filter {
        &self.filter
    }

    /// Decides what to communicate at step k + 1, knowing what the person does at step k where `known_action` says so.
    ///
    /// # Errors
    /// None that a human model in the same process could cause.
    pub fn search(
        &mut self,
        known_action: Option<&[f32]>,
        moment: PlanMoment,
    ) -> Result<Plan, PeopleError> {
        let mut people = LocalPeople {
            model: self.human.as_mut(),
            person: &self.person.beliefs,
            groups: &mut self.groups,
            pending: &mut self.pending,
        };
        let from = from(&self.filter, known_action, moment);
        self.planner.search(&self.model, &from, &mut people)
    }

    /// [`Self::search`] with imagined people of the caller's, in place of the human model.
    ///
    /// # Errors
    /// What the people answer.
    pub fn search_with(
        &mut self,
        people: &mut dyn ImaginedPeople,
        known_action: Option<&[f32]>,
        moment: PlanMoment,
    ) -> Result<Plan, PeopleError> {
        let from = from(&self.filter, known_action, moment);
        self.planner.search(&self.model, &from, people)
    }
}

impl Assistant {
    /// [`Self::search`] on the highway, with the probability of each item.
    ///
    /// # Errors
    /// None that a human model in the same process could cause.
    pub fn decide(
        &mut self,
        known_action: Option<[f32; 2]>,
        moment: PlanMoment,
    ) -> Result<Decision, PeopleError> {
        let known_action = known_action.as_ref().map(<[f32; 2]>::as_slice);
        let plan = self.search(known_action, moment)?;
        Ok(self.planner.decision(plan))
    }
}

fn from<'a>(
    filter: &'a Filter,
    known_action: Option<&'a [f32]>,
    moment: PlanMoment,
) -> From<'a, &'a [f32]> {
    From {
        mean: &filter.mean,
        deviation: &filter.deviation,
        known_action,
        speech_ready_steps: moment.speech_ready_steps,
        seed: moment.seed,
        episode: moment.episode,
        step: moment.step,
        until: None,
    }
}
