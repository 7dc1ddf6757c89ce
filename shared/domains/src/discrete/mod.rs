//! What the three gridworlds have in common (paper, Experiments and Appendix): discrete actions, a visual and a verbal
//! modality as plain vectors of numbers, regions of them that can be hidden, shown and said, and people who know only what they
//! perceived.
//!
//! [`Discrete`] is the contract of a world, [`Layout`] says what its numbers mean, [`Mask`] is a set of visual regions and
//! utterances, [`Sight`] is how much of an observation a person perceives by themselves, and [`Mind`] is the contract of a
//! simulated person. [`World`] and [`SimulatedPerson`] are the sums of the three domains, for callers that choose at run time:
//! plain values whose clones allocate nothing but what the type documents.
//!
//! A round of a person without assistance:
//!
//! ```
//! use domains::discrete::{Discrete, Mind, Scene, SimulatedPerson, Words, World};
//! let scene = Scene::builtin("driving-fog").unwrap();
//! let words = Words::indicator(scene.sentences().len()); // or a sentence encoder's vectors
//! let mut world = World::new(&scene, &words).unwrap();
//! let mut person = SimulatedPerson::builtin(&scene, 1, &words).unwrap();
//! let (mut visual, mut verbal) = (vec![0.0; world.layout().visual], vec![0.0; world.layout().verbal]);
//! world.reset(1, 0, 0);
//! person.reset(1, 0);
//! while world.end().is_running() {
//!     world.observe(&mut visual, &mut verbal);
//!     let seen = person.look(&visual); // an assistant would add what it shows and says: `seen | communicated`
//!     person.perceive(&visual, &verbal, seen);
//!     world.step(person.act());
//! }
//! ```

mod draw;
pub(crate) mod file;
pub(crate) mod memory;
mod mind;
mod scene;
mod sight;
mod speech;
mod words;
mod world;

pub use mind::{Acting, Mind, PersonError, SimulatedPerson};
pub use scene::{Clock, Communication, Planning, STEP_S, Scene};
pub use sight::{Limits, Sight};
pub use speech::{sentence, symbols};
pub use words::{Words, WordsError};
pub use world::World;

use crate::Layout;
use serde::{Deserialize, Serialize};

/// Most terms that a domain's reward has.
pub const MAX_TERMS: usize = 4;
/// Most actions that a domain has.
pub const MAX_ACTIONS: usize = 4;

/// The gridworlds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Domain {
    /// Gridworld driving.
    Driving,
    /// Search and rescue.
    SearchRescue,
    /// Bomb defusal.
    BombDefusal,
}

impl Domain {
    /// All of them, in the paper's order.
    pub const ALL: [Self; 3] = [Self::Driving, Self::SearchRescue, Self::BombDefusal];

    /// The name in scene files, on the command line and in file names of people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Driving => "driving",
            Self::SearchRescue => "search_rescue",
            Self::BombDefusal => "bomb_defusal",
        }
    }

    /// The number in messages, where 0 is the highway.
    pub fn number(self) -> u32 {
        1 + self as u32
    }

    /// The domain of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|domain| domain.name() == name)
    }
}

/// The setting that the robot learned its task in, or the one that people then need help in: fog, smoke, newer rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Setting {
    /// Clear weather, clear air, the older rules.
    Original,
    /// Fog, smoke, the newer rules.
    Transfer,
}

impl Setting {
    /// The name in scene files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Original => "original",
            Self::Transfer => "transfer",
        }
    }
}

/// How a round stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum End {
    /// It goes on.
    #[default]
    Running,
    /// The task is done: no collision until the end of the road, the victim at the entrance, the bomb defused.
    Success,
    /// The car hit another one.
    Collision,
    /// Time is up and the task is not done.
    OutOfTime,
}

impl End {
    /// Whether the round goes on.
    pub fn is_running(self) -> bool {
        self == Self::Running
    }
}

/// What a step led to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// Sum of the terms.
    pub reward: f32,
    /// Reward by term, in the order of [`Layout::terms`]; unused places are 0.
    pub terms: [f32; MAX_TERMS],
    /// Whether something was hit in this step: another car, an obstacle. A wrong button is a term, no collision.
    pub collided: bool,
    /// How the round stands after the step.
    pub end: End,
}

impl Outcome {
    /// An outcome of these terms.
    pub(crate) fn new(terms: [f32; MAX_TERMS], collided: bool, end: End) -> Self {
        Self {
            reward: terms.iter().sum(),
            terms,
            collided,
            end,
        }
    }
}

/// A world with discrete actions. Everything is a function of (scene, seed, episode, scenario, actions); `step`, `observe` and
/// `expert` allocate nothing.
pub trait Discrete: Send + Sync {
    /// What the numbers of observations, actions and masks mean; the same for the world's whole life.
    fn layout(&self) -> &Layout;

    /// How many scenarios there are.
    fn scenarios(&self) -> u32;

    /// The setting that the world is in.
    fn setting(&self) -> Setting;

    /// Starts a round. What a scenario leaves open is drawn from (seed, episode); the scenario is taken modulo their number.
    fn reset(&mut self, seed: u64, episode: u32, scenario: u32);

    /// Moves by one step. An action that is not [`legal`](Discrete::legal) leaves the person where they are and costs the time;
    /// after the end of a round nothing happens and the reward is 0.
    fn step(&mut self, action: usize) -> Outcome;

    /// How the round stands.
    fn end(&self) -> End;

    /// Steps done in this round.
    fn steps(&self) -> u32;

    /// The scenario of this round.
    fn scenario(&self) -> u32;

    /// Writes all that the robot senses: `visual` (layout.visual numbers) and `verbal` (layout.verbal numbers), each within
    /// [−1, 1] but for the embeddings of words.
    ///
    /// # Panics
    /// If a slice has another length than the layout says.
    fn observe(&self, visual: &mut [f32], verbal: &mut [f32]);

    /// Whether an action can be done now.
    fn legal(&self, action: usize) -> bool;

    /// What somebody would do who knows the whole state and the rules in force (mixed into Q-learning's rollouts with
    /// probability β).
    fn expert(&self) -> usize;

    /// Appends a picture of the state in text, for people and tests: several lines, each ending in a line feed.
    fn render(&self, out: &mut String);
}

pub(crate) use crate::highway::random;
pub(crate) use draw::{Chance, draw};
