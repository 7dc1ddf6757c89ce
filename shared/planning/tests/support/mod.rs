//! A world whose reward is the last throttle, and people whose reactions are known.
#![allow(dead_code)] // every test program uses its own part

use domains::highway::modalities::layout;
use models::imagined::Futures;
use models::{Communicated, Observations, SelfModel, Sizes};
use nn::{Mlp, Parameters, Tensor};
use planning::planner::{From, GROUPS};
use planning::{ImaginedPeople, PeopleError};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: everything is passed on to `System`; the counter is thread-local and without a destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = ALLOCATIONS.try_with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's promise, passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
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

/// Where a plan starts, beside the belief.
#[derive(Clone, Copy)]
pub struct Start {
    pub throttle: f32,
    pub speech_ready_steps: usize,
    pub seed: u64,
    pub episode: u32,
    pub step: u32,
}

impl Default for Start {
    fn default() -> Self {
        Self {
            throttle: 0.0,
            speech_ready_steps: 0,
            seed: 7,
            episode: 0,
            step: 0,
        }
    }
}

impl Start {
    pub fn from<'a>(self, mean: &'a Tensor, deviation: &'a Tensor) -> From<'a> {
        From {
            mean,
            deviation,
            known_action: Some([self.throttle, 0.0]),
            speech_ready_steps: self.speech_ready_steps,
            seed: self.seed,
            episode: self.episode,
            step: self.step,
            until: None,
        }
    }
}

/// Log-odds of what never happens.
const NEVER: f32 = -40.0;

/// z₀ is the throttle of the step before, and the reward; cars stand all around.
pub struct World {
    pub model: SelfModel,
    mean: Tensor,
    deviation: Tensor,
}

impl World {
    pub fn new() -> Self {
        let sizes = Sizes {
            latent: 2,
            ..Sizes::of(&layout()).with_hidden(3)
        };
        let mut model = SelfModel::new(sizes, layout(), &mut ChaCha8Rng::seed_from_u64(0));
        let (transition, reward) = (model.transition.clone(), model.reward.clone());
        let (visual, ended) = (model.visual.clone(), model.ended.clone());
        let p = &mut model.parameters;
        let ids: Vec<_> = p.iter().map(|(id, _, _)| id).collect();
        for id in ids {
            p.get_mut(id).fill(0.0);
        }
        // Input [z₀; z₁; throttle; steer], output [change of z's mean; deviation of z before softplus]: throttle − z₀.
        carry(p, &transition, 2);
        p.get_mut(transition.layers[0].weight).data_mut()[0] = -1.0;
        let bias = p.get_mut(transition.layers[2].bias).data_mut();
        (bias[2], bias[3]) = (-30.0, -30.0);
        carry(p, &reward, 0);
        p.get_mut(ended.layers[2].bias).data_mut()[0] = NEVER;
        model.note_rewards([-10.0, 10.0]);
        let p = &mut model.parameters;
        // There is a car in every direction, 20 m away.
        p.get_mut(visual.layers[2].bias).fill(0.5);
        Self {
            model,
            mean: Tensor::new(2, 1),
            deviation: Tensor::new(2, 1),
        }
    }

    /// The same, where each step is the last with this probability.
    pub fn ending(probability: f32) -> Self {
        let mut world = Self::new();
        let odds = (probability / (1.0 - probability)).ln();
        let bias = world.model.ended.layers[2].bias;
        world.model.parameters.get_mut(bias).data_mut()[0] = odds;
        world
    }

    /// The same, where no reward was ever more than `most`.
    pub fn earning_at_most(most: f32) -> Self {
        let mut world = Self::new();
        let id = world.model.parameters.id("rewards").expect("is there");
        world.model.parameters.get_mut(id).data_mut()[1] = most;
        world
    }

    /// The same without a car anywhere.
    pub fn empty() -> Self {
        let mut world = Self::new();
        let bias = world.model.visual.layers[2].bias;
        world.model.parameters.get_mut(bias).fill(0.0);
        world
    }

    pub fn from(&self, start: Start) -> From<'_> {
        start.from(&self.mean, &self.deviation)
    }
}

/// Output 0 becomes input `i`: lifted by 9 the hidden neurons stay where ELU is the identity.
fn carry(p: &mut Parameters, network: &Mlp, i: usize) {
    const LIFT: f32 = 9.0;
    let rows = p.get(network.layers[0].weight).rows();
    p.get_mut(network.layers[0].weight).data_mut()[i * rows] = 1.0;
    p.get_mut(network.layers[0].bias).data_mut()[0] = LIFT;
    p.get_mut(network.layers[1].weight).data_mut()[0] = 1.0;
    p.get_mut(network.layers[2].weight).data_mut()[0] = 1.0;
    p.get_mut(network.layers[2].bias).data_mut()[0] = -LIFT;
}

/// One question.
pub struct Asked {
    /// Which start of the group it belongs to.
    pub start: usize,
    pub group: usize,
    pub step: usize,
    pub seed: u64,
    pub communicated: Vec<Communicated>,
}

/// One start of a group.
pub struct Started {
    pub group: usize,
    pub seed: u64,
    pub rows: usize,
    pub futures: Futures,
}

/// People who brake until they perceive one of the bits that they listen for, and from then on give throttle.
pub struct Answers {
    listens_for: Communicated,
    /// Steps ahead within which they listen.
    pub listens: core::ops::RangeInclusive<usize>,
    warned: [Vec<bool>; GROUPS],
    futures: [Futures; GROUPS],
    known: [Option<f32>; GROUPS],
    step: [usize; GROUPS],
    pub asked: Vec<Asked>,
    pub starts: Vec<Started>,
    /// What every second of them listens for instead.
    pub others_listen_for: Option<Communicated>,
    /// Whether, instead, they do nothing until then, and from then on two in five give throttle and three brake.
    pub gamble: bool,
    /// Answers after which they fall silent.
    pub silent_after: Option<usize>,
}

impl Answers {
    pub fn listening_for(listens_for: Communicated) -> Self {
        Self {
            listens_for,
            listens: 1..=64,
            warned: [Vec::new(), Vec::new()],
            futures: [Futures::each_their_own(1); GROUPS],
            known: [None; GROUPS],
            step: [0; GROUPS],
            asked: Vec::new(),
            starts: Vec::new(),
            others_listen_for: None,
            gamble: false,
            silent_after: None,
        }
    }

    pub fn deaf() -> Self {
        Self::listening_for(Communicated::default())
    }

    /// Whether anybody was told anything `t` steps ahead.
    pub fn spoken_at(&self, t: usize) -> bool {
        let mut at = self.asked.iter().filter(|asked| asked.step == t);
        at.any(|asked| asked.communicated.iter().any(|c| c.verbal_bits() != 0))
    }
}

impl ImaginedPeople for Answers {
    fn start(
        &mut self,
        group: usize,
        rows: usize,
        futures: Futures,
        seed: u64,
        known_action: Option<&[f32]>,
    ) -> Result<(), PeopleError> {
        self.starts.push(Started {
            group,
            seed,
            rows,
            futures,
        });
        self.futures[group] = futures;
        self.warned[group] = vec![false; rows];
        self.known[group] = known_action.map(|a| a[0]);
        self.step[group] = 0;
        Ok(())
    }

    fn ask(
        &mut self,
        group: usize,
        observations: &Observations,
        communicated: &[Communicated],
        seed: u64,
    ) -> Result<(), PeopleError> {
        assert_eq!(observations.batch(), communicated.len());
        assert!(communicated.len() >= self.warned[group].len());
        self.known[group] = None;
        self.step[group] += 1;
        let count = self.futures[group].count;
        for j in self.warned[group].len()..communicated.len() {
            let first = self.warned[group][j % count];
            self.warned[group].push(first);
        }
        let listens = self.listens.contains(&self.step[group]);
        for (j, (warned, told)) in self.warned[group].iter_mut().zip(communicated).enumerate() {
            let other = self
                .others_listen_for
                .filter(|_| self.futures[group].of(j) % 2 == 1);
            let listens_for = other.unwrap_or(self.listens_for);
            *warned |= listens && told.0 & listens_for.0 != 0;
        }
        let start = self
            .starts
            .iter()
            .filter(|start| start.group == group)
            .count();
        let (step, communicated) = (self.step[group], communicated.to_vec());
        self.asked.push(Asked {
            start,
            group,
            step,
            seed,
            communicated,
        });
        Ok(())
    }

    fn answer(&mut self, group: usize, actions: &mut Tensor) -> Result<(), PeopleError> {
        if let Some(left) = &mut self.silent_after {
            *left = left.checked_sub(1).ok_or(PeopleError::NoBelief)?;
        }
        actions.resize_to(2, self.warned[group].len());
        for (j, warned) in self.warned[group].iter().enumerate() {
            let reaction = match (self.gamble, warned) {
                (false, true) => 1.0,
                (false, false) => -1.0,
                (true, false) => 0.0,
                (true, true) if self.futures[group].of(j) % 5 < 2 => 1.0,
                (true, true) => -1.0,
            };
            let throttle = self.known[group].unwrap_or(reaction);
            actions.column_mut(j).copy_from_slice(&[throttle, 0.0]);
        }
        Ok(())
    }
}
