//! A round without processes: world, driver and whatever decides what is shown, in one loop.

use super::Observation;
use super::driver::{Shown, SimulatedDriver};
use super::world::{End, Outcome, World};

/// A step of a round.
#[derive(Clone, Debug, PartialEq)]
pub struct TraceStep {
    /// What could be sensed.
    pub observation: Observation,
    /// What was shown and said.
    pub shown: Shown,
    /// What the person did.
    pub action: [f32; 2],
    /// What that led to.
    pub outcome: Outcome,
}

/// How a round went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Round {
    /// Control steps.
    pub steps: u32,
    /// Whether it ended in a collision.
    pub collided: bool,
    /// What was touched; see [`Outcome::other`].
    pub other: i32,
    /// Sum of the rewards.
    pub reward: f64,
    /// How it ended.
    pub end: End,
}

/// Drives one round. `show` decides, from the world's observation at each step, what the person is shown and told; it gets
/// the step's number. With `trace`, every step is kept.
///
/// The world and the driver must have been reset for the round.
pub fn run(
    world: &mut World,
    driver: &mut SimulatedDriver,
    mut show: impl FnMut(u32, &Observation) -> Shown,
    mut trace: Option<&mut Vec<TraceStep>>,
) -> Round {
    let mut round = Round::default();
    loop {
        let shown = show(round.steps, world.observation());
        let action = driver.act(world.observation(), &shown);
        let before = trace.is_some().then(|| world.observation().clone());
        let outcome = world.step(action);
        round.steps += 1;
        round.reward += f64::from(outcome.reward);
        if let (Some(trace), Some(observation)) = (trace.as_deref_mut(), before) {
            trace.push(TraceStep {
                observation,
                shown,
                action,
                outcome,
            });
        }
        if outcome.end != End::Running {
            round.collided = outcome.collided;
            round.other = outcome.other;
            round.end = outcome.end;
            return round;
        }
    }
}

/// A round of a case for a person: resets both, then drives without communication.
pub fn run_silent(
    world: &mut World,
    driver: &mut SimulatedDriver,
    seed: u64,
    episode: u32,
) -> Round {
    world.reset(seed, episode);
    driver.reset(seed, episode);
    run(world, driver, |_, _| Shown::default(), None)
}
