//! What the process's loops ask of a world, whatever its domain.

use anyhow::Result;
use messages::{DriverAction, Outcome, Sensed};
use runtime::Stamp;

/// A world that holds the truth.
pub trait Truth {
    /// What it lets be sensed.
    type Sensed: Sensed;

    /// Nanoseconds of a step where the world does not wait.
    fn step_ns(&self) -> u64;

    /// Starts an episode.
    fn reset(&mut self, seed: u64, episode: u32);

    /// Moves by step `step`. `action` is the newest of this episode, which may be of an earlier step, or none.
    fn step(&mut self, step: u32, action: Option<&DriverAction>);

    /// Ticks of a step at which the action may change, where a person is at the wheel.
    fn ticks(&self) -> u32 {
        1
    }

    /// Moves by one tick of step `step`, as [`Truth::step`] by all of them; true after the step's last.
    fn tick(&mut self, step: u32, action: Option<&DriverAction>) -> bool {
        self.step(step, action);
        true
    }

    /// Sends where everybody is between two steps, for the person at the wheel.
    ///
    /// # Errors
    /// When the port fails.
    fn show_motion(&mut self, _stamp: Stamp) -> Result<()> {
        Ok(())
    }

    /// The episode is given up: nobody is at the wheel any more.
    fn give_up(&mut self);

    /// Whether the episode goes on.
    fn is_running(&self) -> bool;

    /// Writes what the last step led to, all but the header.
    fn tell(&self, out: &mut Outcome);

    /// Writes what can be sensed, all but the header.
    fn sense(&mut self, out: &mut Self::Sensed);

    /// Sends what is true, for display and scoring only.
    ///
    /// # Errors
    /// When the port fails.
    fn show(&mut self, stamp: Stamp) -> Result<()>;
}
