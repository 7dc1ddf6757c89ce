//! What the process's loop asks of a person, whatever the domain.

use messages::{Display, DriverAction, Sensed};

/// Somebody who senses, is shown and told things, and acts.
pub trait ActingPerson {
    /// What there is to sense.
    type Sensed: Sensed;

    /// What [`Sensed::measure`] must be for this person.
    fn measure(&self) -> [u32; 3];

    /// Begins an episode.
    fn reset(&mut self, episode: u32);

    /// Looks at a display: what it shows replaces what was shown, what it says is heard at the next step.
    fn see(&mut self, display: &Display);

    /// Writes what the person does, having seen the displays since the last step; all but the header.
    fn act(&mut self, sensed: &Self::Sensed, out: &mut DriverAction);
}
