//! Worlds as learning sees them: whatever people do there, an action is a column of numbers.

use domains::discrete::{
    Discrete, Domain, End, Mind, Scene, Setting, SimulatedPerson, Words, WordsError, World,
};
use domains::highway::modalities::{self, VISUAL, write_visual};
use domains::highway::road::RoadError;
use domains::highway::{self, Expert, FileError, LIDAR_RANGE_M, Observation, speech};
use domains::search_rescue::{self, count_transitions};
use domains::{ActionSpace, Layout, Mask};
use models::utterances::{Said, UtteranceTable};
use std::sync::Arc;
use thiserror::Error;

/// A world that rounds are lived in.
pub trait Environment: Send {
    /// What its numbers mean.
    fn layout(&self) -> &Arc<Layout>;

    /// Starts round `episode` of `seed`; where there are scenarios, the scenario is taken modulo their number.
    fn reset(&mut self, seed: u64, episode: u32, scenario: u32);

    /// Writes all that the robot senses: `visual` and `verbal` have as many numbers as the layout says.
    fn observe(&mut self, visual: &mut [f32], verbal: &mut [f32]);

    /// What somebody would do who knows the whole state; zeros once the round of a gridworld is over.
    fn expert(&mut self, action: &mut [f32]);

    /// What an expert would do who perceives no more than `perceived` says, and so did since the round began; zeros where there is
    /// no such expert.
    fn peer(&mut self, _perceived: Perceived, action: &mut [f32]) {
        action.fill(0.0);
    }

    /// Whether there is one.
    fn has_peer(&self) -> bool {
        false
    }

    /// Does `action` (for a choice: zeros with a one); what it earned.
    fn step(&mut self, action: &[f32]) -> f32;

    /// How the round stands.
    fn end(&self) -> End;
}

/// What somebody perceives of an observation.
#[derive(Clone, Copy, Debug)]
pub struct Perceived<'a> {
    /// What limits their sight, in the order of the domain's [`domains::Perception`]; the same throughout a round.
    pub limits: &'a [f32],
    /// What they see and hear of the two modalities that follow.
    pub mask: Mask,
    /// x^visual.
    pub visual: &'a [f32],
    /// x^verbal.
    pub verbal: &'a [f32],
}

/// A world could not be made.
#[derive(Debug, Error)]
pub enum EnvironmentError {
    /// The domain is none of ours.
    #[error("domain `{0}` has no world of its own to act in")]
    NoWorld(&'static str),
    /// The scene cannot be read.
    #[error(transparent)]
    Scene(#[from] FileError),
    /// Its road cannot be built.
    #[error(transparent)]
    Road(#[from] RoadError),
    /// The utterances cannot be read.
    #[error(transparent)]
    Utterances(#[from] models::utterances::TableError),
    /// The words cannot be read.
    #[error(transparent)]
    Table(#[from] models::words::TableError),
    /// They do not fit.
    #[error(transparent)]
    Words(#[from] WordsError),
}

/// A searcher without habits: of all places that may still hold the victim each is as likely to be next, and no step slips.
fn searcher(scene: &Scene, words: &Words) -> Result<Option<SimulatedPerson>, WordsError> {
    let Scene::SearchRescue(scene) = scene else {
        return Ok(None);
    };
    let (searching, returning) = count_transitions(std::iter::empty());
    let person = search_rescue::Person {
        id: 0,
        slip: 0.0,
        searching,
        returning,
    };
    let searcher = search_rescue::Searcher::new(&person, scene, words)?;
    Ok(Some(SimulatedPerson::SearchRescue(searcher)))
}

/// The default world of a domain in a setting. On the highway, fog is in the person's eyes: the traffic is the same.
///
/// # Errors
/// If there is none, or what ships is damaged.
pub fn shipped(
    domain: &'static str,
    setting: Setting,
) -> Result<Box<dyn Environment>, EnvironmentError> {
    if domain == modalities::NAME {
        let scene = highway::Scene::builtin("highway-clear")?;
        return Ok(Box::new(Highway::new(
            Arc::new(scene),
            UtteranceTable::shipped()?,
        )?));
    }
    let domain = Domain::from_name(domain).ok_or(EnvironmentError::NoWorld(domain))?;
    let words = models::words::shipped(domain)?;
    let scene = Scene::of(domain, setting);
    let world = Gridworld::from(World::new(&scene, &words)?);
    let peer = searcher(&scene, &words)?;
    Ok(Box::new(Gridworld { peer, ..world }))
}

/// Whether nothing can follow a round's end. The rounds of gridworlds are played to their end; a drive that did not end in a
/// collision was cut short.
pub(crate) fn is_whole(actions: ActionSpace, end: End) -> bool {
    matches!(actions, ActionSpace::Discrete(_)) || end == End::Collision
}

/// A gridworld.
#[derive(Clone, Debug)]
pub struct Gridworld {
    /// The world.
    pub world: World,
    layout: Arc<Layout>,
    /// An expert who knows no more than what they perceived, where there is one; and as they will be if their advice is taken.
    peer: Option<SimulatedPerson>,
    advised: Option<(usize, SimulatedPerson)>,
}

impl From<World> for Gridworld {
    fn from(world: World) -> Self {
        let layout = Arc::new(world.layout().clone());
        Self {
            world,
            layout,
            peer: None,
            advised: None,
        }
    }
}

impl Environment for Gridworld {
    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn reset(&mut self, seed: u64, episode: u32, scenario: u32) {
        self.world.reset(seed, episode, scenario);
        self.advised = None;
        if let Some(peer) = &mut self.peer {
            peer.reset(seed, episode);
        }
    }

    fn observe(&mut self, visual: &mut [f32], verbal: &mut [f32]) {
        self.world.observe(visual, verbal);
    }

    fn expert(&mut self, action: &mut [f32]) {
        action.fill(0.0);
        if self.world.end().is_running() {
            action[self.world.expert()] = 1.0;
        }
    }

    fn peer(&mut self, perceived: Perceived, action: &mut [f32]) {
        action.fill(0.0);
        let Some(peer) = &mut self.peer else {
            return;
        };
        peer.perceive(perceived.visual, perceived.verbal, perceived.mask);
        if self.world.end().is_running() {
            let mut advised = peer.clone();
            let choice = advised.act();
            action[choice] = 1.0;
            self.advised = Some((choice, advised));
        }
    }

    fn has_peer(&self) -> bool {
        self.peer.is_some()
    }

    fn step(&mut self, action: &[f32]) -> f32 {
        let done = models::policy::largest(action);
        match (&mut self.peer, self.advised.take()) {
            (Some(peer), Some((choice, advised))) if choice == done => *peer = advised,
            (Some(peer), _) => peer.observed(done),
            (None, _) => {}
        }
        self.world.step(done).reward
    }

    fn end(&self) -> End {
        self.world.end()
    }
}

/// The highway, with what can truly be said of each sector as the verbal modality.
pub struct Highway {
    /// The world.
    pub world: highway::World,
    expert: Expert,
    peer: Expert,
    table: UtteranceTable,
    layout: Arc<Layout>,
    observation: Observation,
}

impl Highway {
    /// The highway of a scene.
    ///
    /// # Errors
    /// If its road cannot be built.
    pub fn new(scene: Arc<highway::Scene>, table: UtteranceTable) -> Result<Self, RoadError> {
        let world = highway::World::new(scene)?;
        Ok(Self {
            expert: Expert::new(&world),
            peer: Expert::new(&world),
            world,
            table,
            layout: modalities::layout(),
            observation: Observation::default(),
        })
    }
}

impl Environment for Highway {
    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn reset(&mut self, seed: u64, episode: u32, _scenario: u32) {
        self.world.reset(seed, episode);
        self.expert.reset(&self.world);
        self.peer.reset(&self.world);
    }

    fn observe(&mut self, visual: &mut [f32], verbal: &mut [f32]) {
        self.world.observe(&mut self.observation);
        visual.copy_from_slice(&visual_of(&self.observation));
        for (sector, heard) in speech::utterances(&self.observation).iter().enumerate() {
            let said = match heard.kind as u8 {
                0 => Said::Nothing,
                1 => Said::Slow,
                _ => Said::Fast,
            };
            let share = (heard.range_m / LIDAR_RANGE_M).clamp(0.0, 1.0);
            self.table
                .encode(sector, said, share * LIDAR_RANGE_M, verbal);
        }
    }

    fn expert(&mut self, action: &mut [f32]) {
        action.copy_from_slice(&self.expert.act(&self.world));
    }

    fn peer(&mut self, perceived: Perceived, action: &mut [f32]) {
        let visible_m = core::array::from_fn(|azimuth| perceived.limits[azimuth]);
        action.copy_from_slice(&self.peer.act_within(&self.world, &visible_m));
    }

    fn has_peer(&self) -> bool {
        true
    }

    fn step(&mut self, action: &[f32]) -> f32 {
        self.world.step([action[0], action[1]]).reward
    }

    fn end(&self) -> End {
        match self.world.end() {
            highway::End::Running => End::Running,
            highway::End::Goal => End::Success,
            highway::End::Collision => End::Collision,
            highway::End::OutOfTime => End::OutOfTime,
        }
    }
}

/// x^visual of what was sensed on the highway.
pub fn visual_of(observation: &Observation) -> [f32; VISUAL] {
    let mut visual = [0.0; VISUAL];
    write_visual(&observation.range, &observation.ego, &mut visual);
    visual
}
