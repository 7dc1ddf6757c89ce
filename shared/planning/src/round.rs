//! A round of a simulated person in a gridworld, with an assistant or without, in one process: the same order of a step as the
//! running set has (DESIGN §3).

use crate::discrete::DiscreteAssistant;
use crate::ideal::IdealPeople;
use crate::people::PeopleError;
use domains::discrete::{Discrete, End, MAX_ACTIONS, Mask, Mind, SimulatedPerson, World};

/// Who decides what is communicated.
pub enum Advice<'a> {
    /// Nobody (NC).
    Silence,
    /// All that the channels can carry, in every step.
    Everything,
    /// An assistant that plans.
    Planned(&'a mut DiscreteAssistant),
    /// An assistant that plans with clones of the person themselves (IM).
    Ideal(&'a mut DiscreteAssistant, &'a mut IdealPeople),
}

/// How a round went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RoundResult {
    /// Steps.
    pub steps: u32,
    /// Sum of the task's rewards.
    pub reward: f32,
    /// How it ended.
    pub end: End,
    /// Steps in which something was hit.
    pub collisions: u32,
    /// Visual items shown, one per step and item.
    pub visual_items: u32,
    /// Utterances.
    pub verbal_items: u32,
    /// Sum of communication costs.
    pub cost: f32,
    /// Σ −log of the probability that the assistant gave to what the person did.
    pub surprise: f32,
}

/// Plays round `episode` of `seed`; scenarios take turns. What is decided at step k is shown at step k + 1; at step 0 nothing
/// is.
///
/// # Errors
/// What the planner's imagined people answer.
pub fn play(
    world: &mut World,
    person: &mut SimulatedPerson,
    mut advice: Advice,
    seed: u64,
    episode: u32,
) -> Result<RoundResult, PeopleError> {
    world.reset(seed, episode, episode);
    person.reset(seed, episode);
    let layout = world.layout().clone();
    let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
    let mut told = Mask::NONE;
    let mut taken = None;
    let mut result = RoundResult::default();
    if let Advice::Planned(assistant) | Advice::Ideal(assistant, _) = &mut advice {
        assistant.reset();
    }
    while world.end().is_running() {
        world.observe(&mut visual, &mut verbal);
        let (shown, said) = told.count();
        result.visual_items += shown;
        result.verbal_items += said;
        result.cost += layout.cost(told);
        let seen = person.look(&visual);
        person.perceive(&visual, &verbal, seen | told);
        let mut probabilities = [0.0; MAX_ACTIONS];
        if matches!(advice, Advice::Ideal(..)) {
            // Of a clone: asking takes random numbers.
            let mut clone = person.clone();
            clone.probabilities(&mut probabilities[..layout.actions]);
        }
        let action = person.act();
        let probability = probabilities[action];
        let step = result.steps;
        told = match &mut advice {
            Advice::Silence => Mask::NONE,
            Advice::Everything => layout.communicable,
            Advice::Planned(assistant) => {
                let at = [seed, u64::from(episode), u64::from(step)];
                assistant.observe(&visual, &verbal, told, taken, at);
                let expected = assistant.expected_action();
                result.surprise -= expected.log_probability.column(0)[action];
                let plan = assistant.decide(Some(action), seed, episode, step)?;
                plan.communicated.into()
            }
            Advice::Ideal(assistant, people) => {
                let at = [seed, u64::from(episode), u64::from(step)];
                assistant.observe(&visual, &verbal, told, taken, at);
                result.surprise -= probability.max(f32::MIN_POSITIVE).ln();
                people.follow(person);
                let plan = assistant.decide_with(*people, Some(action), seed, episode, step)?;
                plan.communicated.into()
            }
        };
        let outcome = world.step(action);
        result.reward += outcome.reward;
        result.collisions += u32::from(outcome.collided);
        result.steps += 1;
        taken = Some(action);
    }
    result.end = world.end();
    Ok(result)
}
