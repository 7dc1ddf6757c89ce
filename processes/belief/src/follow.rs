//! What the process's loop asks of a belief, whatever the domain.

use messages::{DriverAction, RobotBelief, Sensed};

/// The robot's belief from step to step.
pub trait Follow {
    /// What there is to sense.
    type Sensed: Sensed;

    /// What [`Sensed::measure`] must be for this model.
    fn measure(&self) -> [u32; 3];

    /// Whether there is a belief about this episode yet.
    fn follows(&self, episode: u32) -> bool;

    /// Updates z^R with what is sensed, given what the person did one step before (ignored at an episode's start), and writes
    /// what is believed into `out`, all but the header.
    fn observe(
        &mut self,
        sensed: &Self::Sensed,
        previous: Option<&DriverAction>,
        out: &mut RobotBelief,
    );
}
