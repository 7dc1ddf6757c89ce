//! The ways of deciding what to communicate, behind one call.

use crate::matching::Matcher;
use crate::people::{ImaginedPeople, PeopleError};
use crate::planner::{Decision, From, Planner, Settings};
use models::SelfModel;

/// How to decide.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Cross-entropy over imagined futures.
    #[default]
    Ce,
    /// Belief matching, with no regard to reward (MIRROR-KL).
    Kl,
}

/// A planner of either method.
#[expect(
    clippy::large_enum_variant,
    reason = "there is one, and it lives as long as the run"
)]
pub enum Chooser {
    /// See [`Method::Ce`].
    Ce(Planner),
    /// See [`Method::Kl`].
    Kl(Matcher),
}

impl Chooser {
    /// A planner that has planned nothing yet. Settings must have no [`Settings::problem`].
    pub fn new(method: Method, settings: Settings, model: &SelfModel) -> Self {
        match method {
            Method::Ce => Self::Ce(Planner::new(settings, model)),
            Method::Kl => Self::Kl(Matcher::new(settings, model)),
        }
    }

    /// Decides what to communicate at step k + 1.
    ///
    /// # Errors
    /// What the people answer.
    pub fn plan(
        &mut self,
        model: &SelfModel,
        from: From,
        people: &mut dyn ImaginedPeople,
    ) -> Result<Decision, PeopleError> {
        match self {
            Self::Ce(planner) => planner.plan(model, from, people),
            Self::Kl(matcher) => matcher.plan(model, from, people),
        }
    }
}
