//! A round of a simulated person in a gridworld, with an assistant or without, in one process: the same order of a step as the
//! running set has.

use crate::assistant::{Assistant, PlanMoment};
use crate::ideal::IdealPeople;
use crate::people::PeopleError;
use domains::discrete::{Discrete, End, MAX_ACTIONS, Mind, SimulatedPerson, World};
use domains::{Layout, Mask};
use models::Communicated;
use std::sync::Arc;

/// Who decides what is communicated.
pub enum Advice<'a> {
    /// Nobody (NC).
    Silence,
    /// All that the channels can carry, in every step.
    Everything,
    /// An assistant that plans.
    Planned(&'a mut Assistant<Arc<Layout>>),
    /// An assistant that plans with clones of the person themselves (IM).
    Ideal(&'a mut Assistant<Arc<Layout>>, &'a mut IdealPeople),
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
    let mut taken = vec![0.0; layout.actions.rows()];
    let mut known = taken.clone();
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
            clone.probabilities(&mut probabilities[..layout.actions.rows()]);
        }
        let action = person.act();
        let probability = probabilities[action];
        let step = result.steps;
        known.fill(0.0);
        known[action] = 1.0;
        let items = Communicated::items(told);
        let at = [seed, u64::from(episode), u64::from(step)];
        let moment = PlanMoment {
            seed,
            episode,
            step,
            speech_ready_steps: 0,
        };
        told = match &mut advice {
            Advice::Silence => Mask::NONE,
            Advice::Everything => layout.communicable,
            Advice::Planned(assistant) => {
                assistant.observe(&visual, &verbal, items, &taken, at);
                let expected = assistant.expected_action();
                result.surprise -= expected.log_density(0, &known);
                let plan = assistant.search(Some(&known), moment)?;
                plan.communicated.mask()
            }
            Advice::Ideal(assistant, people) => {
                assistant.observe(&visual, &verbal, items, &taken, at);
                result.surprise -= probability.max(f32::MIN_POSITIVE).ln();
                people.follow(person);
                let plan = assistant.search_with(*people, Some(&known), moment)?;
                plan.communicated.mask()
            }
        };
        let outcome = world.step(action);
        result.reward += outcome.reward;
        result.collisions += u32::from(outcome.collided);
        result.steps += 1;
        taken.copy_from_slice(&known);
    }
    result.end = world.end();
    Ok(result)
}
