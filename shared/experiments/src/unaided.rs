//! What the self-model does when it perceives no more than a person: the policy behind every implant, in the person's place. Somebody
//! who knows that they do not know is careful; a policy that imitated experts who see everything is not, and a person modelled by it
//! would seem to need no help.

use crate::gridworld::subject::Place;
use crate::results::with_interval;
use crate::statistics::{Interval, over_people};
use domains::Mask;
use domains::discrete::{Discrete, Domain, End, Mind, Setting, SimulatedPerson};
use domains::highway::{Cockpit, Person, Scene, SimulatedDriver, World, episode};
use models::{ActionDistribution, Filter, Scratch, SelfModel};
use nn::{Tensor, noise};
use rayon::prelude::*;
use serde::Serialize;
use std::sync::Arc;
use training::environment::{Environment, shipped};

/// What to run.
#[derive(Clone, Copy, Debug)]
pub struct Study {
    /// A gridworld in its transfer setting, or the highway in fog.
    pub domain: Option<Domain>,
    /// Persons 1 to this number.
    pub people: u32,
    /// Seeds.
    pub seeds: u64,
    /// First seed.
    pub seed: u64,
    /// Rounds of a seed.
    pub rounds: u32,
}

/// How rounds went: shares and means over them.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Outcome {
    /// Share that ended in a collision.
    pub collided: f64,
    /// Share that ended in success.
    pub succeeded: f64,
    /// Mean reward of a round.
    pub reward: f64,
}

/// One person's rounds, and the same rounds in the self-model's hands.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct OfPerson {
    /// Person.
    pub person: u32,
    /// The person, without an assistant.
    pub themselves: Outcome,
    /// The self-model's policy, which perceives what the person would.
    pub with_their_sight: Outcome,
    /// The self-model's policy, which perceives all that the robot senses.
    pub with_full_sight: Outcome,
}

/// What the study found.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Everybody.
    pub people: Vec<OfPerson>,
    /// Means over people of the three, in this order: themselves, with their sight, with full sight.
    pub collided: [Interval; 3],
    /// Share of the rounds that succeeded.
    pub succeeded: [Interval; 3],
    /// Mean reward of a round.
    pub reward: [Interval; 3],
}

/// Who acts, in the order of [`Report`]'s arrays.
const WHO: [&str; 3] = [
    "the person",
    "self-model, sight of the person",
    "self-model, sees everything",
];

impl Report {
    /// Lines for a terminal.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![format!(
            "{:<34}{:>24}{:>24}{:>26}",
            "without an assistant (95 % intervals)", "collisions (%)", "success (%)", "reward"
        )];
        for (i, who) in WHO.iter().enumerate() {
            lines.push(format!(
                "{who:<34}{:>27}{:>24}{:>26}",
                with_interval(&self.collided[i], 100.0, 1),
                with_interval(&self.succeeded[i], 100.0, 1),
                with_interval(&self.reward[i], 1.0, 2),
            ));
        }
        lines
    }
}

/// Runs the study, one person per core.
///
/// # Errors
/// If a person, the scene or the words cannot be read.
pub fn run(
    study: &Study,
    model: &Arc<SelfModel>,
    progress: &(dyn Fn(u32) + Sync),
) -> anyhow::Result<Report> {
    let people = (1..=study.people).into_par_iter().map(|person| {
        let found = of_person(study, model, person);
        progress(person);
        found
    });
    let people = people.collect::<anyhow::Result<Vec<_>>>()?;
    let over = |value: &dyn Fn(&Outcome) -> f64| {
        let of = |who: &dyn Fn(&OfPerson) -> Outcome| {
            over_people(&people.iter().map(|p| value(&who(p))).collect::<Vec<f64>>())
        };
        [
            of(&|p| p.themselves),
            of(&|p| p.with_their_sight),
            of(&|p| p.with_full_sight),
        ]
    };
    Ok(Report {
        collided: over(&|o| o.collided),
        succeeded: over(&|o| o.succeeded),
        reward: over(&|o| o.reward),
        people,
    })
}

fn of_person(study: &Study, model: &Arc<SelfModel>, id: u32) -> anyhow::Result<OfPerson> {
    let mut subject: Box<dyn Subject> = match study.domain {
        Some(domain) => Box::new(Player::new(domain, id)?),
        None => Box::new(Driver::new(id)?),
    };
    let mut actor = Actor::new(model);
    let mut found = [Outcome::default(); 3];
    let rounds = (study.seed..study.seed + study.seeds)
        .flat_map(|seed| (0..study.rounds).map(move |round| (seed, round)));
    let mut count = 0.0;
    for (seed, round) in rounds {
        count += 1.0;
        let lived = [
            subject.themselves(seed, round),
            actor.live(model, subject.as_mut(), true, (seed, round)),
            actor.live(model, subject.as_mut(), false, (seed, round)),
        ];
        for (sum, (end, reward)) in found.iter_mut().zip(lived) {
            sum.collided += f64::from(u8::from(end == End::Collision));
            sum.succeeded += f64::from(u8::from(end == End::Success));
            sum.reward += f64::from(reward);
        }
    }
    let [themselves, with_their_sight, with_full_sight] = found.map(|sum| Outcome {
        collided: sum.collided / count,
        succeeded: sum.succeeded / count,
        reward: sum.reward / count,
    });
    Ok(OfPerson {
        person: id,
        themselves,
        with_their_sight,
        with_full_sight,
    })
}

/// A person in their world.
trait Subject {
    /// The world, for somebody else to act in.
    fn environment(&mut self) -> &mut dyn Environment;

    /// What they would perceive of `visual`; they are told nothing.
    fn perceives(&mut self, model: &SelfModel, visual: &[f32]) -> Mask;

    /// A round of theirs: how it ended, and what it earned.
    fn themselves(&mut self, seed: u64, round: u32) -> (End, f32);

    /// Another round begins: what they notice by chance is the round's.
    fn begin(&mut self, seed: u64, round: u32);
}

/// Somebody on the highway in fog.
struct Driver {
    environment: Box<dyn Environment>,
    world: World,
    driver: SimulatedDriver,
}

impl Driver {
    fn new(id: u32) -> anyhow::Result<Self> {
        let scene = Arc::new(Scene::builtin("highway-fog")?);
        let world = World::new(Arc::clone(&scene))?;
        let cockpit = Cockpit::new(&scene, world.road(), scene.ego.start_s_m);
        Ok(Self {
            environment: shipped("highway", Setting::Transfer)?,
            driver: SimulatedDriver::new(&Person::builtin(id)?, &scene.fog(), cockpit),
            world,
        })
    }
}

impl Subject for Driver {
    fn environment(&mut self) -> &mut dyn Environment {
        self.environment.as_mut()
    }

    fn perceives(&mut self, model: &SelfModel, visual: &[f32]) -> Mask {
        let limits = self.driver.visible_m();
        Mask {
            visual: model.layout.perception.seen(limits, visual, None),
            verbal: 0,
        }
    }

    fn themselves(&mut self, seed: u64, round: u32) -> (End, f32) {
        let lived = episode::run_silent(&mut self.world, &mut self.driver, seed, round);
        let end = match lived.end {
            _ if lived.collided => End::Collision,
            domains::highway::End::Goal => End::Success,
            _ => End::OutOfTime,
        };
        (end, lived.reward as f32)
    }

    fn begin(&mut self, _seed: u64, _round: u32) {}
}

/// Somebody in a gridworld's transfer setting.
struct Player {
    environment: Box<dyn Environment>,
    place: Place,
    person: SimulatedPerson,
}

impl Player {
    fn new(domain: Domain, id: u32) -> anyhow::Result<Self> {
        let place = Place::new(domain, Setting::Transfer)?;
        Ok(Self {
            environment: shipped(domain.name(), Setting::Transfer)?,
            person: place.person(id)?,
            place,
        })
    }
}

impl Subject for Player {
    fn environment(&mut self) -> &mut dyn Environment {
        self.environment.as_mut()
    }

    fn perceives(&mut self, _model: &SelfModel, visual: &[f32]) -> Mask {
        self.person.look(visual)
    }

    fn themselves(&mut self, seed: u64, round: u32) -> (End, f32) {
        let world = &mut self.place.world;
        world.reset(seed, round, round);
        self.person.reset(seed, round);
        let layout = world.layout();
        let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
        let mut reward = 0.0;
        loop {
            world.observe(&mut visual, &mut verbal);
            let seen = self.person.look(&visual);
            self.person.perceive(&visual, &verbal, seen);
            if !world.end().is_running() {
                return (world.end(), reward);
            }
            reward += world.step(self.person.act()).reward;
        }
    }

    fn begin(&mut self, seed: u64, round: u32) {
        self.person.reset(seed, round);
    }
}

/// The self-model's belief and policy.
struct Actor {
    filter: Filter,
    observed: Tensor,
    action: Tensor,
    visual: Vec<f32>,
    verbal: Vec<f32>,
    noise: Vec<f32>,
    distribution: ActionDistribution,
    scratch: Scratch,
}

impl Actor {
    fn new(model: &SelfModel) -> Self {
        let (layout, actions) = (&model.layout, model.layout.actions);
        Self {
            filter: Filter::new(model.sizes.latent, 1),
            observed: Tensor::new(model.view.rows(), 1),
            action: Tensor::new(actions.rows(), 1),
            visual: vec![0.0; layout.visual],
            verbal: vec![0.0; layout.verbal],
            noise: vec![0.0; actions.rows()],
            distribution: ActionDistribution::new(actions, 1),
            scratch: Scratch::default(),
        }
    }

    /// A round in the subject's place, with their sight or with the robot's; actions are drawn from the policy, as those of imagined
    /// people are.
    fn live(
        &mut self,
        model: &SelfModel,
        subject: &mut dyn Subject,
        limited: bool,
        (seed, round): (u64, u32),
    ) -> (End, f32) {
        self.filter.reset();
        self.action.fill(0.0);
        subject.environment().reset(seed, round, round);
        subject.begin(seed, round);
        let mut reward = 0.0;
        for step in 0_u64.. {
            let environment = subject.environment();
            environment.observe(&mut self.visual, &mut self.verbal);
            let end = environment.end();
            if !end.is_running() {
                return (end, reward);
            }
            let mask = match limited {
                true => subject.perceives(model, &self.visual),
                false => model.layout.sensed,
            };
            let observed = self.observed.column_mut(0);
            model.view.write(&self.visual, &self.verbal, mask, observed);
            self.filter.update(model, &self.action, &self.observed);
            let z = &self.filter.mean;
            model.act(&mut self.scratch, z, &mut self.distribution);
            noise::fill(&mut self.noise, seed ^ u64::from(round) << 32, step);
            self.distribution
                .sample(Some(&self.noise), &mut self.action);
            reward += subject.environment().step(self.action.data());
        }
        unreachable!("a round ends")
    }
}
