//! Recording demonstrations: simulated people at play and at the wheel without an assistant, and experts.

use crate::environment::{Environment, is_whole, visual_of};
use crate::rounds::{Round, Rounds, one_hot};
use domains::Mask;
use domains::discrete::{Discrete, Mind, Setting, World};
use domains::highway::road::RoadError;
use domains::highway::{self, Cockpit, Shown, SimulatedDriver, modalities};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

impl Rounds {
    /// Lets a person play rounds `first`, `first + 1`, … of `seed` in a gridworld without an assistant; scenarios take turns.
    pub fn record(
        world: &mut World,
        person: &mut dyn Mind,
        seed: u64,
        first: u32,
        rounds: u32,
    ) -> Self {
        let layout = world.layout().clone();
        let mut all = Self::new(&layout, world.setting(), person.sight().heard);
        all.limits = Some(person.sight().limits.to_vec());
        let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
        for episode in first..first + rounds {
            world.reset(seed, episode, episode);
            person.reset(seed, episode);
            let mut round = Round::default();
            while world.end().is_running() {
                world.observe(&mut visual, &mut verbal);
                let perceived = person.look(&visual);
                person.perceive(&visual, &verbal, perceived);
                let choice = person.act();
                let action: Vec<f32> = one_hot(choice, layout.actions.rows()).collect();
                let reward = world.step(choice).reward;
                round.push([&visual, &verbal], perceived, &action, reward);
            }
            round.ended = true;
            all.rounds.push(round);
        }
        all
    }

    /// Lets a simulated driver drive rounds `first`, `first + 1`, … of `seed` without an assistant.
    pub fn record_drives(
        world: &mut highway::World,
        driver: &mut SimulatedDriver,
        seed: u64,
        first: u32,
        rounds: usize,
    ) -> Self {
        let layout = modalities::layout();
        let setting = match world.scene().fog {
            None => Setting::Original,
            Some(_) => Setting::Transfer,
        };
        let mut all = Self::new(&layout, setting, 0);
        let limits = driver.visible_m().to_vec();
        let mut trace = Vec::new();
        for episode in first..first + rounds as u32 {
            world.reset(seed, episode);
            driver.reset(seed, episode);
            trace.clear();
            let silent = |_, _: &highway::Observation| Shown::default();
            let ended = highway::episode::run(world, driver, silent, Some(&mut trace));
            let mut round = Round {
                ended: ended.collided,
                ..Round::default()
            };
            for step in &trace {
                round.visual.extend(visual_of(&step.observation));
                round.action.extend(step.action);
                round.reward.push(step.outcome.reward);
            }
            round.perceive_within(&layout, &limits);
            all.rounds.push(round);
        }
        all.limits = Some(limits);
        all
    }

    /// [`Self::record_drives`] of a person in a scene of its own.
    ///
    /// # Errors
    /// If the scene's road cannot be built.
    pub fn record_drives_in(
        scene: Arc<highway::Scene>,
        person: &highway::Person,
        seed: u64,
        first: u32,
        rounds: usize,
    ) -> Result<Self, RoadError> {
        let mut world = highway::World::new(scene.clone())?;
        let cockpit = Cockpit::new(&scene, world.road(), scene.ego.start_s_m);
        let mut driver = SimulatedDriver::new(person, &scene.fog(), cockpit);
        Ok(Self::record_drives(
            &mut world,
            &mut driver,
            seed,
            first,
            rounds,
        ))
    }

    /// Rounds 0, 1, … of an expert who sees everything, cut after `longest` steps. Words are heard as in the self-model's
    /// training ([`words`]), so that a policy has met language before it is spoken to.
    pub fn of_expert(
        environment: &mut dyn Environment,
        seed: u64,
        rounds: u32,
        longest: usize,
    ) -> Self {
        let layout = Arc::clone(environment.layout());
        let mut all = Self::new(&layout, Setting::Original, 0);
        let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
        let mut action = vec![0.0; layout.actions.rows()];
        for episode in 0..rounds {
            let mut rng = ChaCha8Rng::seed_from_u64(seed ^ u64::from(episode) << 32 ^ WORDS);
            environment.reset(seed, episode, episode);
            let mut round = Round::default();
            while environment.end().is_running() && round.len() < longest {
                environment.observe(&mut visual, &mut verbal);
                let perceived = Mask {
                    verbal: words(layout.utterances, &mut rng),
                    ..layout.everything()
                };
                environment.expert(&mut action);
                let reward = environment.step(&action);
                round.push([&visual, &verbal], perceived, &action, reward);
            }
            round.ended = is_whole(layout.actions, environment.end());
            all.rounds.push(round);
        }
        all
    }
}

/// Mixed into the seed of which words are heard.
const WORDS: u64 = 0x6c65_7373;
/// Probability that an utterance is heard in a step with words; the self-model's dropout.
const SPOKEN: f32 = 0.35;

/// Utterances that are heard in a step of somebody who is spoken to at random: none in every other step.
pub(crate) fn words(utterances: usize, rng: &mut ChaCha8Rng) -> u32 {
    let talks = rng.random::<bool>();
    (0..utterances).fold(0, |heard, utterance| {
        let spoken = rng.random::<f32>() < SPOKEN && talks;
        heard | u32::from(spoken) << utterance
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn experts_hear_of_half_of_what_they_see() {
        let mut highway =
            crate::environment::shipped(modalities::NAME, Setting::Original).expect("it ships");
        let rounds = Rounds::of_expert(&mut *highway, 3, 1, 400);
        let masks = &rounds.rounds[0].perceived;
        let spoken = masks.iter().filter(|mask| mask.verbal != 0).count();
        let share = spoken as f32 / masks.len() as f32;
        // 1 − (1 − 0.35)⁶ of every other step
        assert!((0.3..0.6).contains(&share), "{share}");
    }
}
