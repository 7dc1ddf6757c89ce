//! A simulated person and their rounds, split as the paper's appendix does ("Simulated Humans Agents"): 40 rounds in each setting, of
//! which the first 20 are to learn from and, of the last 20, ten to validate and the others to test. (The paper tests on six of
//! the others; all ten are used here.)

use domains::discrete::{Domain, Scene, Setting, SimulatedPerson, Words, World};
use models::words::shipped;
use training::rounds::Rounds;

/// Rounds to learn from.
pub const LEARNING: usize = 20;
/// Rounds that say when learning has to stop.
pub const VALIDATION: usize = 10;
/// Rounds that nobody learns from.
pub const TEST: usize = 10;
/// Seed of everybody's 40 rounds; apart from the seeds of demonstrations, of training and of the rounds that assistants are
/// judged by.
const ROUNDS_SEED: u64 = 0x6c65_7373_6f6e_0000;

/// A domain in one setting.
pub struct Place {
    /// The scene.
    pub scene: Scene,
    /// Its words.
    pub words: Words,
    /// Its world.
    pub world: World,
}

impl Place {
    /// The default scene of a domain in a setting, with the words that ship.
    ///
    /// # Errors
    /// If the words that ship are damaged.
    pub fn new(domain: Domain, setting: Setting) -> anyhow::Result<Self> {
        let scene = Scene::of(domain, setting);
        let words = shipped(domain)?;
        let world = World::new(&scene, &words)?;
        Ok(Self {
            scene,
            words,
            world,
        })
    }

    /// A person who lives here.
    ///
    /// # Errors
    /// When there is none of that number.
    pub fn person(&self, id: u32) -> anyhow::Result<SimulatedPerson> {
        Ok(SimulatedPerson::builtin(&self.scene, id, &self.words)?)
    }
}

/// A person's rounds in one setting.
pub struct SplitRounds {
    /// To learn from; the first so many of them where less is learned from.
    pub learning: Rounds,
    /// To validate.
    pub validation: Rounds,
    /// To test.
    pub test: Rounds,
    /// Seed that the rounds were lived with, for whoever lives them again.
    pub seed: u64,
}

impl SplitRounds {
    /// Lets a person live their 40 rounds of a study's seed without an assistant.
    ///
    /// # Errors
    /// When there is no person of that number.
    pub fn record(place: &mut Place, setting: Setting, id: u32, seed: u64) -> anyhow::Result<Self> {
        let seed = ROUNDS_SEED + 2 * seed + u64::from(setting == Setting::Transfer);
        let mut person = place.person(id)?;
        let all = (LEARNING + VALIDATION + TEST) as u32;
        let rounds = Rounds::record(&mut place.world, &mut person, seed, 0, all);
        Ok(Self {
            learning: rounds.part(0..LEARNING),
            validation: rounds.part(LEARNING..LEARNING + VALIDATION),
            test: rounds.part(LEARNING + VALIDATION..all as usize),
            seed,
        })
    }

    /// The first `rounds` rounds to learn from.
    pub fn first(&self, rounds: usize) -> Rounds {
        self.learning.part(0..rounds)
    }
}

/// Rounds that a percentage of the 20 is, at least one.
pub fn rounds_of(percent: u32) -> usize {
    (LEARNING * percent as usize)
        .div_ceil(100)
        .clamp(1, LEARNING)
}
