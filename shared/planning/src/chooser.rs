//! The ways of deciding what to communicate, behind one call.

use crate::items::{Items, Sectors};
use crate::matching::Matcher;
use crate::people::{ImaginedPeople, PeopleError};
use crate::planner::{BITS, Decision, From, Plan, Planner, Settings};
use crate::race_planner::RacePlanner;
use models::{SelfModel, WorldModel};

/// How to decide.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// A race of candidates through the same futures.
    #[default]
    Race,
    /// Cross-entropy over imagined futures.
    Ce,
    /// Belief matching, with no regard to reward (MIRROR-KL).
    Kl,
}

impl Method {
    /// Its name on the command line and in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Race => "race",
            Self::Ce => "ce",
            Self::Kl => "kl",
        }
    }
}

/// A planner of any method, in any domain.
pub enum Chooser<M: WorldModel = SelfModel, I: Items = Sectors> {
    /// See [`Method::Race`].
    Race(RacePlanner<M, I>),
    /// See [`Method::Ce`].
    Ce(Planner<M, I>),
    /// See [`Method::Kl`].
    Kl(Matcher<M, I>),
}

impl Chooser {
    /// A planner for the highway that has planned nothing yet. Settings must have no [`Settings::problem`].
    pub fn new(method: Method, settings: Settings, model: &SelfModel) -> Self {
        Self::with_items(method, settings, model, Sectors)
    }

    /// Decides what to communicate on the highway at step k + 1.
    ///
    /// # Errors
    /// What the people answer.
    pub fn plan(
        &mut self,
        model: &SelfModel,
        from: From,
        people: &mut dyn ImaginedPeople,
    ) -> Result<Decision, PeopleError> {
        let plan = self.search(model, &from, people)?;
        Ok(self.decision(plan))
    }

    /// A plan with the probability of each item.
    pub(crate) fn decision(&self, plan: Plan) -> Decision {
        let mut probability = [0.0; BITS];
        for (b, probability) in probability.iter_mut().enumerate() {
            *probability = self.probability(b);
        }
        Decision::of(plan, probability)
    }
}

impl<M: WorldModel, I: Items> Chooser<M, I> {
    /// A planner for this world model and these items. Settings must have no [`Settings::problem`].
    pub fn with_items(method: Method, settings: Settings, model: &M, items: I) -> Self {
        match method {
            Method::Race => Self::Race(RacePlanner::with_items(settings, model, items)),
            Method::Ce => Self::Ce(Planner::with_items(settings, model, items)),
            Method::Kl => Self::Kl(Matcher::with_items(settings, model, items)),
        }
    }

    /// Decides what to communicate at step k + 1.
    ///
    /// # Errors
    /// What the people answer.
    pub fn search<A: AsRef<[f32]>>(
        &mut self,
        model: &M,
        from: &From<A>,
        people: &mut dyn ImaginedPeople,
    ) -> Result<Plan, PeopleError> {
        match self {
            Self::Race(planner) => planner.search(model, from, people),
            Self::Ce(planner) => planner.search(model, from, people),
            Self::Kl(matcher) => matcher.search(model, from, people),
        }
    }

    /// Probability of an item in the last plan's first decision, 0 or 1 but with [`Method::Ce`]: visual items, then verbal ones.
    pub fn probability(&self, item: usize) -> f32 {
        match self {
            Self::Race(planner) => planner.probability(item),
            Self::Ce(planner) => planner.probability(item),
            Self::Kl(matcher) => matcher.probability(item),
        }
    }
}
