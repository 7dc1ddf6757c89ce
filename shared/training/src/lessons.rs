//! What a recurrent policy learns from: rounds as the person perceived them, step by step, with what they did.
//!
//! Participants' rounds are seen through what the person can really see (these models are told, paper §IV-A). Expert
//! demonstrations in clear weather are added to them (paper §V, "Compared Methods"): everything is seen, and words are
//! heard as in the self-model's training, so that the policy has met language before it is spoken to.

use crate::demonstrations::Round;
use crate::rollout::step_of;
use domains::highway::modalities::{VERBAL, layout};
use domains::highway::road::RoadError;
use domains::highway::{AZIMUTHS, End, Expert, Observation, SECTORS, Scene, World};
use domains::{Layout, Mask};
use models::utterances::UtteranceTable;
use models::{RecurrentSizes, Shape, View};
use nn::Tensor;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Probability that a sector is spoken of in a step with words; the self-model's dropout.
const SPOKEN: f32 = 0.35;
/// Control steps after which an expert's round is cut.
const LONGEST: usize = 400;

/// One round as it was perceived.
#[derive(Clone, Debug, PartialEq)]
pub struct Lesson {
    /// What the GRU takes, `input × steps`: masked observation, masks, a_{t−1}.
    pub input: Tensor,
    /// a_t, `2 × steps`.
    pub action: Tensor,
}

impl Lesson {
    /// Steps.
    pub fn steps(&self) -> usize {
        self.action.cols()
    }

    /// A round in which nothing is perceived and nothing done.
    pub fn silent(steps: usize) -> Self {
        let shape = Shape::of(&layout());
        Self {
            input: Tensor::new(shape.encoded() + shape.action, steps),
            action: Tensor::new(shape.action, steps),
        }
    }

    /// What somebody perceived at step t, and did then.
    fn set(&mut self, t: usize, observed: &[f32], action: [f32; 2]) {
        let previous = match t {
            0 => [0.0; 2],
            _ => [self.action.column(t - 1)[0], self.action.column(t - 1)[1]],
        };
        let (seen, before) = self.input.column_mut(t).split_at_mut(observed.len());
        seen.copy_from_slice(observed);
        before.copy_from_slice(&previous);
        self.action.column_mut(t).copy_from_slice(&action);
    }
}

/// A person's round without communication, seen up to `visible_m`.
pub fn of_round(round: &Round, visible_m: &[f32; AZIMUTHS]) -> Lesson {
    let mut lesson = Lesson::silent(round.steps.len());
    let layout = layout();
    let view = View::new(&layout);
    let mut observed = vec![0.0; view.rows()];
    for (t, moment) in round.steps.iter().enumerate() {
        let mask = Mask {
            visual: layout.perception.seen(visible_m, &moment.visual, None),
            verbal: 0,
        };
        view.write(&moment.visual, &[0.0; VERBAL], mask, &mut observed);
        lesson.set(t, &observed, moment.action);
    }
    lesson
}

/// Sizes of a policy of the highway with so many dense layers.
pub(crate) fn sizes(layers: usize) -> RecurrentSizes {
    RecurrentSizes::of(&layout(), layers)
}

/// Seed of which words are heard.
pub(crate) const SPOKEN_SEED: u64 = 0x6c65_7373;

/// Perceives a round as it is driven, and writes down its lesson.
pub struct Perceiver<'a> {
    visible_m: [f32; AZIMUTHS],
    words: Option<&'a UtteranceTable>,
    rng: ChaCha8Rng,
    layout: Arc<Layout>,
    view: View,
    verbal: [f32; VERBAL],
    previous: [f32; 2],
    inputs: Vec<f32>,
    actions: Vec<f32>,
}

impl<'a> Perceiver<'a> {
    /// Somebody who sees each azimuth up to `visible_m` and, with `words`, hears of some sectors at random times.
    pub fn new(visible_m: [f32; AZIMUTHS], words: Option<&'a UtteranceTable>, seed: u64) -> Self {
        Self {
            visible_m,
            words,
            rng: ChaCha8Rng::seed_from_u64(seed),
            view: View::new(&layout()),
            layout: layout(),
            verbal: [0.0; VERBAL],
            previous: [0.0; 2],
            inputs: Vec::new(),
            actions: Vec::new(),
        }
    }

    /// Perceives the next step; `input` takes what the GRU takes.
    pub fn perceive(&mut self, observation: &Observation, input: &mut [f32]) {
        let step = step_of(observation);
        let mut mask = Mask {
            visual: self
                .layout
                .perception
                .seen(&self.visible_m, &step.visual, None),
            verbal: 0,
        };
        if let Some(table) = self.words {
            step.write_verbal(table, &mut self.verbal);
            let talks = self.rng.random::<bool>();
            for sector in 0..SECTORS {
                let spoken = self.rng.random::<f32>() < SPOKEN && talks;
                mask.verbal |= u32::from(spoken) << sector;
            }
        }
        let (observed, before) = input.split_at_mut(self.view.rows());
        self.view.write(&step.visual, &self.verbal, mask, observed);
        before.copy_from_slice(&self.previous);
        self.inputs.extend_from_slice(input);
    }

    /// What was done then.
    pub fn acted(&mut self, action: [f32; 2]) {
        self.previous = action;
        self.actions.extend_from_slice(&action);
    }

    /// The round so far.
    pub fn lesson(&self) -> Lesson {
        let actions = self.layout.actions.rows();
        let (rows, steps) = (self.view.rows() + actions, self.actions.len() / actions);
        Lesson {
            input: Tensor::from_slice(rows, steps, &self.inputs[..steps * rows]),
            action: Tensor::from_slice(actions, steps, &self.actions),
        }
    }
}

/// Rounds of the expert in `scene`, who sees everything.
///
/// # Errors
/// If the scene's road cannot be built.
pub fn of_expert(
    scene: Arc<Scene>,
    table: &UtteranceTable,
    seed: u64,
    rounds: usize,
) -> Result<Vec<Lesson>, RoadError> {
    let mut world = World::new(scene)?;
    let mut expert = Expert::new(&world);
    let mut observation = Observation::default();
    let mut input = vec![0.0; sizes(1).input()];
    let mut lessons = Vec::with_capacity(rounds);
    for round in 0..rounds as u32 {
        world.reset(seed, round);
        expert.reset(&world);
        let everything = [f32::INFINITY; AZIMUTHS];
        let seed = seed ^ u64::from(round) << 32 ^ SPOKEN_SEED;
        let mut perceiver = Perceiver::new(everything, Some(table), seed);
        for _ in 0..LONGEST {
            world.observe(&mut observation);
            perceiver.perceive(&observation, &mut input);
            let action = expert.act(&world);
            perceiver.acted(action);
            if world.step(action).end != End::Running {
                break;
            }
        }
        lessons.push(perceiver.lesson());
    }
    Ok(lessons)
}

/// Holds out a quarter of the rounds, at least one of two or more, for validation: (to learn from, to validate on).
pub fn hold_out(lessons: Vec<Lesson>) -> (Vec<Lesson>, Vec<Lesson>) {
    let n = lessons.len();
    let held = if n < 2 { 0 } else { n.div_ceil(4) };
    // Evenly spread, the last one among them.
    let is_held = |i: usize| held > 0 && (i + 1) * held / n > i * held / n;
    let (mut learn, mut validate) = (Vec::new(), Vec::new());
    for (i, lesson) in lessons.into_iter().enumerate() {
        if is_held(i) {
            validate.push(lesson);
        } else {
            learn.push(lesson);
        }
    }
    (learn, validate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_of_the_rounds_is_held_out() {
        for (rounds, held) in [(1, 0), (2, 1), (4, 1), (6, 2), (20, 5)] {
            let lessons = (0..rounds).map(|n| Lesson::silent(n + 1)).collect();
            let (learn, validate) = hold_out(lessons);
            assert_eq!((learn.len(), validate.len()), (rounds - held, held));
            let mut all: Vec<usize> = learn.iter().chain(&validate).map(Lesson::steps).collect();
            all.sort_unstable();
            assert_eq!(all, (1..=rounds).collect::<Vec<_>>());
        }
    }

    #[test]
    fn experts_hear_of_half_of_what_they_see() {
        let scene = Arc::new(Scene::builtin("highway-clear").expect("a scene"));
        let table = UtteranceTable::shipped().expect("utterances");
        let lessons = of_expert(scene, &table, 3, 1).expect("a road");
        let mask_row = Shape::of(&layout()).encoded() - SECTORS;
        let spoken = (0..lessons[0].steps())
            .filter(|&t| lessons[0].input.column(t)[mask_row..mask_row + SECTORS].contains(&1.0))
            .count();
        let share = spoken as f32 / lessons[0].steps() as f32;
        // 1 − (1 − 0.35)⁶ of every other step
        assert!((0.3..0.6).contains(&share), "{share}");
    }
}
