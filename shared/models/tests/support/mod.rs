//! What the suites share: domains with plausible observations, models with random weights, a count of allocations.
#![allow(dead_code)] // every test program uses its own part

use domains::discrete::{
    Discrete, Domain as Gridworld, Scene, Setting, SimulatedPerson, Words, World,
};
use domains::highway::{BEAMS, LIDAR_RANGE_M, modalities};
use domains::{ActionSpace, Layout};
use models::{
    ActionDistribution, Beliefs, Communicated, Features, HumanModel, IdealHuman, Kind,
    Observations, Posterior, RecurrentHuman, RecurrentPolicy, RecurrentSizes, SelfHuman, SelfModel,
    Shape, Sizes,
};
use nn::Tensor;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::alloc::{GlobalAlloc, System};
use std::cell::Cell;
use std::sync::Arc;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: everything is passed on to `System`; the counter is thread-local and without a destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: std::alloc::Layout) -> *mut u8 {
        let _ = ALLOCATIONS.try_with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's promise, passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: std::alloc::Layout) {
        // SAFETY: the caller's promise, passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations that this thread made so far.
pub fn allocations() -> u64 {
    ALLOCATIONS.with(Cell::get)
}

/// A domain that models are tested in.
#[derive(Clone)]
pub struct Domain {
    pub layout: Arc<Layout>,
    /// Its world, if it is a gridworld.
    pub gridworld: Option<Gridworld>,
}

impl Domain {
    /// The highway.
    pub fn highway() -> Self {
        Self {
            layout: modalities::layout(),
            gridworld: None,
        }
    }

    /// A gridworld, in the setting that people need help in.
    pub fn gridworld(domain: Gridworld) -> Self {
        Self {
            layout: Arc::new(world(domain).layout().clone()),
            gridworld: Some(domain),
        }
    }

    /// All of them. A new domain gets its line here, and with it the suite.
    pub fn all() -> Vec<Self> {
        let gridworlds = Gridworld::ALL.into_iter().map(Self::gridworld);
        std::iter::once(Self::highway()).chain(gridworlds).collect()
    }

    pub fn name(&self) -> &'static str {
        self.layout.domain
    }

    pub fn shape(&self) -> Shape {
        Shape::of(&self.layout)
    }

    /// An untrained self-model, on the highway small enough to be quick.
    pub fn self_model(&self, seed: u64) -> SelfModel {
        let mut sizes = Sizes::of(&self.layout);
        if self.gridworld.is_none() {
            sizes = sizes.with_hidden(48);
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        SelfModel::new(sizes, Arc::clone(&self.layout), &mut rng)
    }

    /// Limits of sight, each about in the middle.
    pub fn limits(&self) -> Vec<f32> {
        let perception = self.layout.perception;
        (0..perception.limits())
            .map(|k| perception.largest() * (0.2 + 0.6 * ((k * 11 % 17) as f32 / 16.0)))
            .collect()
    }

    /// An untrained policy.
    pub fn policy(&self, layers: usize, seed: u64) -> RecurrentPolicy {
        let sizes = RecurrentSizes {
            hidden: 48,
            ..RecurrentSizes::of(&self.layout, layers)
        };
        RecurrentPolicy::new(sizes, &self.layout, &mut ChaCha8Rng::seed_from_u64(seed))
    }

    /// A simulated person of a gridworld and their own model.
    pub fn ideal(&self) -> Option<(SimulatedPerson, IdealHuman)> {
        let (scene, words) = scene(self.gridworld?);
        let person = SimulatedPerson::builtin(&scene, 1, &words).expect("ships");
        let human = IdealHuman::new(person.clone(), self.layout.actions.rows());
        Some((person, human))
    }

    /// A model of this kind with random weights, the same each time; none where the domain has none. A new kind gets its
    /// line here, and with it the suite.
    pub fn human(&self, kind: Kind) -> Option<Box<dyn HumanModel>> {
        let model = self.self_model(20);
        let implants = |with_policy| Some(implants(&model, with_policy));
        let of_self = |implants| -> Option<Box<dyn HumanModel>> {
            let model = Arc::new(model.clone());
            Some(Box::new(SelfHuman::new(model, implants, 0)))
        };
        let recurrent = |seed| -> Option<Box<dyn HumanModel>> {
            let policy = Arc::new(self.policy(2, seed));
            let (layout, limits) = (&self.layout, self.limits());
            Some(Box::new(RecurrentHuman::new(
                kind, policy, layout, limits, 0,
            )))
        };
        match kind {
            Kind::Mirror => of_self(implants(true)),
            Kind::MirrorP => of_self(implants(false)),
            Kind::Myself => of_self(None),
            Kind::Bc => recurrent(22),
            Kind::Sqil => recurrent(23),
            Kind::Ideal => self
                .ideal()
                .map(|(_, human)| -> Box<dyn HumanModel> { Box::new(human) }),
        }
    }

    /// Steps of a batch of people: plausible observations at random actions, some items shown or said.
    pub fn steps(
        &self,
        model: &dyn HumanModel,
        batch: usize,
        count: usize,
        seed: u64,
    ) -> Vec<Step> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let latent = model.latent();
        let mut worlds: Vec<World> = match self.gridworld {
            Some(domain) => (0..batch).map(|_| world(domain)).collect(),
            None => Vec::new(),
        };
        for (j, world) in worlds.iter_mut().enumerate() {
            world.reset(seed, j as u32, rng.random_range(0..9));
        }
        let possible = Communicated::items(self.layout.communicable);
        let mut step = || {
            let mut step = Step {
                actions: Tensor::new(self.layout.actions.rows(), batch),
                observations: Observations::new(&self.shape(), batch),
                communicated: vec![Communicated::default(); batch],
                noise: Tensor::new(latent, batch),
                chance: Tensor::new(model.noise_rows() - latent, batch),
            };
            for j in 0..batch {
                let action = step.actions.column_mut(j);
                let mut choice = 0;
                match self.layout.actions {
                    ActionSpace::Continuous(_) => {
                        action.fill_with(|| rng.random_range(-1.0..1.0));
                    }
                    ActionSpace::Discrete(n) => {
                        choice = rng.random_range(0..n);
                        action[choice] = 1.0;
                    }
                }
                let Observations { visual, verbal } = &mut step.observations;
                let (visual, verbal) = (visual.column_mut(j), verbal.column_mut(j));
                match worlds.get_mut(j) {
                    Some(world) => {
                        world.step(choice);
                        world.observe(visual, verbal);
                    }
                    None => drive(visual, verbal, &mut rng),
                }
                let (shown, said) = possible.bits();
                step.communicated[j] =
                    Communicated::new(shown & rng.random::<u32>(), said & rng.random::<u32>());
            }
            nn::noise::fill(step.noise.data_mut(), rng.random(), 1);
            nn::noise::fill(step.chance.data_mut(), rng.random(), 1);
            step
        };
        (0..count).map(|_| step()).collect()
    }

    /// Another number in the place of a visual one that is beyond the limit of its region: still beyond it.
    pub fn elsewhere(&self, number: usize, x: f32, limits: &[f32]) -> f32 {
        match self.gridworld {
            // Distances are read from what is hidden, too.
            None => {
                let limit = limits[number % self.layout.regions];
                let beyond = 0.9 * (1.0 - limit / LIDAR_RANGE_M);
                beyond * (number as f32 + 1.0) / (BEAMS + 1) as f32
            }
            Some(Gridworld::Driving) => x.signum(),
            Some(Gridworld::SearchRescue | Gridworld::BombDefusal) => f32::NAN,
        }
    }
}

/// A third of the beams hit something.
fn drive(visual: &mut [f32], verbal: &mut [f32], rng: &mut ChaCha8Rng) {
    for (i, x) in visual.iter_mut().enumerate() {
        let hit = rng.random::<f32>() < 1.0 / 3.0;
        *x = match i < BEAMS {
            true if hit => rng.random_range(0.1..1.0),
            true => 0.0,
            false => rng.random_range(-1.0..1.0),
        };
    }
    verbal.fill_with(|| rng.random_range(-2.0..2.0));
}

pub fn scene(domain: Gridworld) -> (Scene, Words) {
    let scene = Scene::of(domain, Setting::Transfer);
    let words = Words::indicator(scene.sentences().len());
    (scene, words)
}

pub fn world(domain: Gridworld) -> World {
    let (scene, words) = scene(domain);
    World::new(&scene, &words).expect("they fit")
}

/// Implants as if learned: one hypothesis of limits all over the place, and a residual that does something.
pub fn implants(model: &SelfModel, with_policy: bool) -> Posterior {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let mut posterior = Posterior::neutral(model, with_policy);
    let largest = posterior.perception.largest();
    let latent = model.sizes.latent;
    let mut draw = |n: usize| -> Vec<f32> { (0..n).map(|_| rng.random_range(-1.0..1.0)).collect() };
    if with_policy {
        posterior.features = Features {
            center: draw(latent),
            directions: draw(3 * latent),
        };
    }
    for hypothesis in &mut posterior.hypotheses {
        for (limit, share) in hypothesis.limits.iter_mut().zip(draw(64)) {
            *limit = largest * (0.5 + 0.4 * share);
        }
        if let Some(policy) = &mut hypothesis.policy {
            let rows = policy.bias.len();
            policy.bias = draw(rows);
            policy.residual = draw(3 * rows);
            policy.log_gain = -0.5;
            policy.lapse = match policy.noise.is_empty() {
                true => 0.1,
                false => 0.0,
            };
        }
    }
    posterior
}

/// [`implants`], and as many hypotheses more as make `count`, which differ in everything and in probability.
pub fn posterior(model: &SelfModel, with_policy: bool, count: usize) -> Posterior {
    let mut posterior = implants(model, with_policy);
    let first = posterior.hypotheses[0].clone();
    for h in 1..count {
        let mut other = first.clone();
        let share = (h + 1) as f32 / (count + 1) as f32;
        other.limits.iter_mut().for_each(|limit| *limit *= share);
        if let Some(policy) = &mut other.policy {
            policy.bias.iter_mut().for_each(|b| *b += share);
        }
        posterior.hypotheses.push(other);
    }
    let whole: f32 = (1..=count).map(|h| h as f32).sum();
    posterior.weights = (1..=count).map(|h| h as f32 / whole).collect();
    posterior
}

/// One step's inputs for a batch of people.
pub struct Step {
    pub actions: Tensor,
    pub observations: Observations,
    pub communicated: Vec<Communicated>,
    pub noise: Tensor,
    pub chance: Tensor,
}

impl Step {
    /// As [`HumanModel::perceive`] takes it.
    pub fn noise(&self) -> Vec<f32> {
        [self.noise.data(), self.chance.data()].concat()
    }

    /// The step as one of its people sees it.
    pub fn alone(&self, j: usize) -> Self {
        let one = |t: &Tensor| Tensor::from_slice(t.rows(), 1, t.column(j));
        Self {
            actions: one(&self.actions),
            observations: Observations {
                visual: one(&self.observations.visual),
                verbal: one(&self.observations.verbal),
            },
            communicated: vec![self.communicated[j]],
            noise: one(&self.noise),
            chance: one(&self.chance),
        }
    }
}

/// Beliefs and action distributions after each step, as one long row of numbers a person.
pub fn follow(model: &mut dyn HumanModel, steps: &[Step]) -> Vec<Vec<f32>> {
    let batch = steps[0].communicated.len();
    let mut beliefs = Beliefs::new(model.latent(), batch);
    let mut distribution = ActionDistribution::new(model.actions(), batch);
    let mut rows = vec![Vec::new(); batch];
    for step in steps {
        let noise = step.noise();
        let (actions, observations) = (&step.actions, &step.observations);
        let told = &step.communicated;
        model.perceive(&mut beliefs, actions, observations, told, Some(&noise));
        model.act(&beliefs, &mut distribution);
        for (j, row) in rows.iter_mut().enumerate() {
            for tensor in [&beliefs.mean, &beliefs.deviation, &beliefs.z] {
                row.extend_from_slice(tensor.column(j));
            }
            match &distribution {
                ActionDistribution::Gaussian { mean, deviation } => {
                    assert!(deviation.column(j).iter().all(|std| *std > 0.0));
                    row.extend_from_slice(mean.column(j));
                    row.extend_from_slice(deviation.column(j));
                }
                ActionDistribution::Categorical { log_probability } => {
                    let log = log_probability.column(j);
                    let total: f32 = log.iter().map(|x| x.exp()).sum();
                    assert!((total - 1.0).abs() < 1e-4, "probabilities sum to {total}");
                    row.extend_from_slice(log);
                }
            }
        }
    }
    rows
}
