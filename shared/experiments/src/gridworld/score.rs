//! How well a model predicts what a person did: −log of the probability that it gave to their actions, in nats a step.
//!
//! BC and SQIL hear what the person truly perceived, and so does the ideal model; MIRROR's models and the unchanged self-model have
//! the robot's observation and their own idea of what the person sees of it. Where that is a matter of chance (bomb defusal), the
//! probability is the mean over [`IMAGINED`] imagined people. For every model, probabilities below [`LEAST`] count as that.

use domains::discrete::{MAX_ACTIONS, Mind, SimulatedPerson};
use models::{Communicated, FollowedPerson, HumanModel, RecurrentPolicy, SelfModel};
use nn::{Arena, Tape, Tensor};
use training::rounds::Rounds;
use training::trajectory::{Sequences, Trajectory};

/// Imagined people where perception is a matter of chance.
pub const IMAGINED: usize = 32;
/// The least probability that counts: one action that a model holds for impossible must not outweigh all others.
pub const LEAST: f64 = 1e-3;

/// Surprise at an action of this probability.
fn surprise(probability: f64) -> f64 {
    -probability.max(LEAST).ln()
}

/// Mean surprise of a human model that perceives by itself, in nats a step.
pub fn of_model(human: &mut dyn HumanModel, model: &SelfModel, rounds: &Rounds) -> f64 {
    let shape = model.sizes.shape;
    let (mut sum, mut counted) = (0.0, 0_usize);
    // Models that follow one sample where perception is a matter of chance are asked about many imagined people.
    let views = match human.noise_rows() > human.latent() && human.samples() == 1 {
        true => IMAGINED,
        false => 1,
    };
    let mut people: Vec<FollowedPerson> = (0..views)
        .map(|_| FollowedPerson::new(human, &shape))
        .collect();
    for (number, round) in rounds.rounds.iter().enumerate() {
        let mut taken = vec![0.0; shape.action];
        people.iter_mut().for_each(|person| person.reset(human));
        for t in 0..round.len() {
            let sensed = (round.visual(t), round.verbal(t));
            let mut probability = 0.0;
            for (view, person) in people.iter_mut().enumerate() {
                let at = [view as u64, number as u64, t as u64];
                person.perceive(human, sensed, Communicated::default(), &taken, at);
                let log = person.expected().log_probability().expect("choices");
                probability += f64::from(log.column(0)[round.choice(t)]).exp() / views as f64;
            }
            sum += surprise(probability);
            counted += 1;
            taken.copy_from_slice(round.action(t));
        }
    }
    sum / counted.max(1) as f64
}

/// Mean surprise of a recurrent policy that is told what the person truly perceived.
pub fn of_policy(policy: &RecurrentPolicy, rounds: &Rounds) -> f64 {
    let trajectory = |round| Trajectory::new(round, &policy.view, policy.actions);
    let perceived: Vec<_> = rounds.rounds.iter().map(trajectory).collect();
    let Some(perceived) = Sequences::whole(&perceived) else {
        return 0.0;
    };
    let mut arena = Arena::new();
    let mut tape = Tape::new(&policy.parameters, &mut arena);
    let before = Tensor::new(policy.sizes.hidden, perceived.columns);
    let h = policy.follow(&mut tape, &perceived.observed, &perceived.previous, &before);
    let logits = tape.mlp(&policy.head, h);
    let nll = tape.categorical_nll(logits, &perceived.taken);
    let nll = tape.value(nll);
    let counted = nll.iter().zip(perceived.weight.data());
    let sum: f64 = counted
        .filter(|(_, weight)| **weight > 0.0)
        .map(|(nll, _)| surprise((-f64::from(*nll)).exp()))
        .sum();
    sum / f64::from(perceived.counted().max(1.0))
}

/// Clones of the person who stand for what they may have in mind.
const MINDS: usize = 64;

/// Mean surprise of the person themselves (IM), who perceives again what they perceived and is told what they did. What they have in
/// mind (where a searcher is heading, how a driver's plan came out) does not show, so that [`MINDS`] clones guess it, weighed by the
/// actions so far: a particle filter. `actions`: how many there are, `first`: number of the first of the rounds, `seed`: what the
/// clones are drawn with.
pub fn of_person(
    person: &SimulatedPerson,
    actions: usize,
    rounds: &Rounds,
    seed: u64,
    first: u32,
) -> f64 {
    let (mut sum, mut counted) = (0.0, 0_usize);
    let mut minds = vec![person.clone(); MINDS];
    for (number, round) in rounds.rounds.iter().enumerate() {
        let episode = first + number as u32;
        let mut stream = 0;
        let mut other = |mind: &mut SimulatedPerson| {
            stream += 1;
            mind.reseed(seed, episode, stream);
        };
        for mind in &mut minds {
            mind.reset(seed, episode);
            other(mind);
        }
        let mut weights = vec![1.0 / MINDS as f64; MINDS];
        for t in 0..round.len() {
            let (visual, verbal) = (round.visual(t), round.verbal(t));
            let taken = round.choice(t);
            let mut expected = 0.0;
            for (mind, weight) in minds.iter_mut().zip(&mut weights) {
                mind.perceive(visual, verbal, round.perceived[t]);
                let mut probabilities = [0.0; MAX_ACTIONS];
                mind.probabilities(&mut probabilities[..actions]);
                *weight *= f64::from(probabilities[taken]);
                expected += *weight;
                mind.acted(taken);
            }
            sum += surprise(expected);
            counted += 1;
            if expected > 0.0 {
                weights.iter_mut().for_each(|weight| *weight /= expected);
            } else {
                weights.fill(1.0 / MINDS as f64);
            }
            let effective = 1.0 / weights.iter().map(|w| w * w).sum::<f64>();
            if effective < MINDS as f64 / 2.0 {
                resample(&mut minds, &mut weights);
                minds.iter_mut().for_each(&mut other);
            }
        }
    }
    sum / counted.max(1) as f64
}

/// Keeps minds as often as they weigh, evenly (systematic resampling without chance).
fn resample(minds: &mut Vec<SimulatedPerson>, weights: &mut [f64]) {
    let count = minds.len() as f64;
    let mut kept = Vec::with_capacity(minds.len());
    let mut reached = 0.0;
    for (mind, weight) in minds.iter().zip(&*weights) {
        reached += weight * count;
        while (kept.len() as f64 + 0.5) < reached && kept.len() < minds.len() {
            kept.push(mind.clone());
        }
    }
    // What rounding left out.
    while let (true, Some(last)) = (kept.len() < minds.len(), minds.last()) {
        kept.push(last.clone());
    }
    weights.fill(1.0 / count);
    *minds = kept;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gridworld::subject::{LEARNING, Place, SplitRounds};
    use domains::discrete::{Discrete, Domain, Setting};
    use models::{RecurrentSizes, SelfHuman, Sizes};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use std::sync::Arc;

    /// Nobody knows a person better than they themselves; an untrained network knows about nothing.
    #[test]
    fn the_ideal_model_is_never_far_off() {
        for domain in Domain::ALL {
            let mut place = Place::new(domain, Setting::Transfer).expect("ships");
            let lived = SplitRounds::record(&mut place, Setting::Transfer, 3, 2).expect("lived");
            let layout = place.world.layout().clone();
            let person = place.person(3).expect("ships");
            let first = LEARNING as u32;
            let own = of_person(
                &person,
                layout.actions.rows(),
                &lived.test,
                lived.seed,
                first,
            );
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let policy = RecurrentPolicy::new(RecurrentSizes::of(&layout, 2), &layout, &mut rng);
            let chance = (layout.actions.rows() as f64).ln();
            let untrained = of_policy(&policy, &lived.test);
            assert!(
                (untrained - chance).abs() < 0.3,
                "{untrained}, chance {chance}"
            );
            assert!(own < 0.75 * chance, "{domain:?}: {own}, chance {chance}");
        }
    }

    /// Where perception is certain, a policy that perceives by itself is scored as one that is told what was perceived.
    #[test]
    fn perceiving_and_being_told_are_the_same() {
        let (domain, setting) = (Domain::SearchRescue, Setting::Transfer);
        let mut place = Place::new(domain, setting).expect("ships");
        let lived = SplitRounds::record(&mut place, setting, 2, 2).expect("lived");
        let layout = Arc::new(place.world.layout().clone());
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let model = SelfModel::new(Sizes::of(&layout), Arc::clone(&layout), &mut rng);
        let policy = RecurrentPolicy::new(RecurrentSizes::of(&layout, 2), &layout, &mut rng);
        let told = of_policy(&policy, &lived.test);
        let person = place.person(2).expect("ships");
        let sight = person.sight();
        let mut human = models::RecurrentHuman::new(
            models::Kind::Bc,
            Arc::new(policy),
            &layout,
            sight.limits.to_vec(),
            sight.heard,
        );
        let perceived = of_model(&mut human, &model, &lived.test);
        assert!((told - perceived).abs() < 1e-4, "{told} and {perceived}");
        let mut own = SelfHuman::new(Arc::new(model.clone()), None, 0);
        assert!(of_model(&mut own, &model, &lived.test).is_finite());
    }
}
