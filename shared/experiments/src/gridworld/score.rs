//! How well a model predicts what a person did: −log of the probability that it gave to their actions, in nats a step.
//!
//! BC and SQIL hear what the person truly perceived, and so does the ideal model; MIRROR's models and the unchanged self-model have
//! the robot's observation and their own idea of what the person sees of it. Where that is a matter of chance (bomb defusal), the
//! probability is the mean over [`IMAGINED`] imagined people. For every model, probabilities below [`LEAST`] count as that.

use domains::discrete::{Mind, SimulatedPerson};
use models::discrete::{DiscreteModel, RecurrentChooser};
use models::{Beliefs, Communicated, HumanModel, Observations};
use nn::{Arena, Tape, Tensor, noise};
use training::discrete::cloning::Perceived;
use training::discrete::{Round, Rounds};

/// Imagined people where perception is a matter of chance.
pub const IMAGINED: usize = 32;
/// The least probability that counts: one action that a model holds for impossible must not outweigh all others.
pub const LEAST: f64 = 1e-3;

/// Surprise at an action of this probability.
fn surprise(probability: f64) -> f64 {
    -probability.max(LEAST).ln()
}

/// Mean surprise of a human model that perceives by itself, in nats a step.
pub fn of_model(human: &mut dyn HumanModel, model: &DiscreteModel, rounds: &Rounds) -> f64 {
    let shape = model.sizes.shape;
    let by_chance = human.noise_rows() > human.latent();
    let batch = if by_chance { IMAGINED } else { 1 };
    let mut noise = vec![0.0; human.noise_rows() * batch];
    let mut observations = Observations::new(&shape, batch);
    let mut distribution = human.distribution(batch);
    let told = vec![Communicated::default(); batch];
    let (mut sum, mut counted) = (0.0, 0_usize);
    for (number, round) in rounds.rounds.iter().enumerate() {
        let mut beliefs = Beliefs::new(human.latent(), batch);
        let mut action = Tensor::new(shape.action, batch);
        for t in 0..round.len() {
            for j in 0..batch {
                let at = |x: &[f32], width: usize| x[t * width..(t + 1) * width].to_vec();
                let (visual, verbal) = (
                    at(&round.visual, shape.visual),
                    at(&round.verbal, shape.verbal),
                );
                observations.visual.column_mut(j).copy_from_slice(&visual);
                observations.verbal.column_mut(j).copy_from_slice(&verbal);
            }
            noise::fill(&mut noise, number as u64, t as u64);
            let noise = by_chance.then_some(&noise[..]);
            human.perceive(&mut beliefs, &action, &observations, &told, noise);
            human.act(&beliefs, &mut distribution);
            let taken = usize::from(round.action[t]);
            let p = |j: usize| f64::from(distribution.log_probability.column(j)[taken]).exp();
            sum += surprise((0..batch).map(p).sum::<f64>() / batch as f64);
            counted += 1;
            action.fill(0.0);
            for j in 0..batch {
                action.column_mut(j)[taken] = 1.0;
            }
        }
    }
    sum / counted.max(1) as f64
}

/// Mean surprise of a recurrent policy that is told what the person truly perceived.
pub fn of_policy(policy: &RecurrentChooser, rounds: &Rounds) -> f64 {
    let used: Vec<&Round> = rounds.rounds.iter().filter(|r| !r.is_empty()).collect();
    if used.is_empty() {
        return 0.0;
    }
    let perceived = Perceived::new(policy, &used);
    let mut arena = Arena::new();
    let mut tape = Tape::new(&policy.parameters, &mut arena);
    let logits = policy.on_tape(
        &mut tape,
        &perceived.observed,
        &perceived.previous,
        perceived.columns,
    );
    let nll = tape.categorical_nll(logits, &perceived.taken);
    let nll = tape.value(nll);
    let counted = nll.iter().zip(perceived.weight.data());
    let sum: f64 = counted
        .filter(|(_, weight)| **weight > 0.0)
        .map(|(nll, _)| surprise((-f64::from(*nll)).exp()))
        .sum();
    sum / f64::from(perceived.counted().max(1.0))
}

/// Mean surprise of the person themselves (IM), who perceives again what they perceived and is told what they did.
/// `actions`: how many there are, `first`: number of the first of the rounds, `seed`: what they were lived with.
pub fn of_person(
    person: &mut SimulatedPerson,
    actions: usize,
    rounds: &Rounds,
    seed: u64,
    first: u32,
) -> f64 {
    let [visual, verbal] = rounds.sizes;
    let (mut sum, mut counted) = (0.0, 0_usize);
    for (number, round) in rounds.rounds.iter().enumerate() {
        person.reset(seed, first + number as u32);
        for t in 0..round.len() {
            let visual = &round.visual[t * visual..(t + 1) * visual];
            let verbal = &round.verbal[t * verbal..(t + 1) * verbal];
            person.perceive(visual, verbal, round.perceived[t]);
            let mut probabilities = [0.0; domains::discrete::MAX_ACTIONS];
            // Of a clone: asking takes random numbers.
            person.clone().probabilities(&mut probabilities[..actions]);
            let taken = usize::from(round.action[t]);
            sum += surprise(f64::from(probabilities[taken]));
            counted += 1;
            person.acted(taken);
        }
    }
    sum / counted.max(1) as f64
}
