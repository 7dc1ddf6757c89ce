//! What the process's loop asks of a renderer and of what it prints, whatever the domain.

use messages::{CommAction, Display, Header, Outcome, Picture, Sensed};
use std::io;

/// For how many steps a decision stays in force when the next is late, in real time.
const IN_FORCE_STEPS: u32 = 2;

/// Turns decisions into what is shown and said.
pub trait Render {
    /// What there is to sense.
    type Sensed: Sensed;

    /// Whether something of this episode was rendered already.
    fn follows(&self, episode: u32) -> bool;

    /// Begins with an episode, at its start or where `shown`, the last that another renderer showed of it, left off.
    fn follow(&mut self, episode: u32, shown: Option<&Display>);

    /// Fills in `display`, all but the header, for the step of what is sensed. Without a decision that is in force
    /// nothing is shown.
    fn render(
        &mut self,
        sensed: &Self::Sensed,
        decision: Option<&CommAction>,
        display: &mut Display,
    );
}

/// Writes what a person at the terminal should notice, one line per event.
pub trait Tell {
    /// What there is to sense.
    type Sensed: Sensed;

    /// The true state, as a text.
    fn picture(&mut self, _: &Picture) {}

    /// What is shown and said now, as far as it is news.
    ///
    /// # Errors
    /// What the terminal gives.
    fn display(&mut self, display: &Display, sensed: &Self::Sensed) -> io::Result<()>;

    /// A collision or the end of an episode.
    ///
    /// # Errors
    /// What the terminal gives.
    fn outcome(&mut self, outcome: &Outcome) -> io::Result<()>;
}

/// Whether a decision is for what is sensed at a step, or for a step shortly before it that no other has followed.
pub fn is_in_force(decision: &CommAction, sensed: &Header) -> bool {
    let age = sensed.step.checked_sub(decision.header.step);
    decision.header.episode == sensed.episode && age.is_some_and(|age| age <= IN_FORCE_STEPS)
}
