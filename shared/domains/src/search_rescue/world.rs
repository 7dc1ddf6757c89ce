//! The house, its victim, its obstacle and the person in it.

use std::fmt::Write as _;
use std::sync::Arc;

use super::map::{Cell, Obstacle, distances, neighbour, step_towards};
use super::{CELLS, CORRIDORS, IMAGE, PLACES, SENTENCES, SIZE, Scene, UTTERANCES, VISUAL};
use crate::Layout;
use crate::discrete::{Discrete, End, Outcome, Setting, Words, WordsError};

/// Colours of the image: red, green, blue. What is hidden is black, so nothing else is.
pub(super) mod colour {
    pub const FLOOR: [f32; 3] = [0.8, 0.8, 0.8];
    pub const WALL: [f32; 3] = [0.5, 0.1, 0.5];
    pub const OBSTACLE: [f32; 3] = [1.0, 0.0, 0.0];
    pub const VICTIM: [f32; 3] = [0.0, 1.0, 0.0];
    pub const PERSON: [f32; 3] = [0.0, 0.0, 1.0];
    pub const CARRYING: [f32; 3] = [0.0, 1.0, 1.0];
    pub const ENTRANCE: [f32; 3] = [1.0, 1.0, 0.0];
}

/// The world of search and rescue. Nothing in it is random but by scenario.
#[derive(Clone, Debug)]
pub struct World {
    scene: Arc<Scene>,
    layout: Arc<Layout>,
    words: Words,
    scenario: u32,
    person: Cell,
    found: bool,
    steps: u32,
    end: End,
}

impl World {
    /// Scenarios: the victim's place × no obstacle, top blocked, bottom blocked.
    pub const SCENARIOS: u32 = 9;

    /// A scene's world at scenario 0; `words` has a vector for each of [`SENTENCES`].
    ///
    /// # Errors
    /// If there are more or fewer vectors.
    pub fn new(scene: &Arc<Scene>, words: &Words) -> Result<Self, WordsError> {
        words.expect(SENTENCES.len())?;
        Ok(Self {
            scene: Arc::clone(scene),
            layout: Arc::new(super::layout(scene, words.width())),
            words: words.clone(),
            scenario: 0,
            person: Cell::ENTRANCE,
            found: false,
            steps: 0,
            end: End::Running,
        })
    }

    /// Where the person is.
    pub fn person(&self) -> Cell {
        self.person
    }

    /// The place where the victim is, or was until found.
    pub fn place(&self) -> usize {
        (self.scenario % PLACES as u32) as usize
    }

    /// The obstacle.
    pub fn obstacle(&self) -> Obstacle {
        Obstacle::ALL[(self.scenario / PLACES as u32) as usize]
    }

    /// Whether the victim has been found.
    pub fn found(&self) -> bool {
        self.found
    }

    fn colour_of(&self, cell: Cell) -> [f32; 3] {
        if cell == self.person {
            if self.found {
                colour::CARRYING
            } else {
                colour::PERSON
            }
        } else if cell.is_wall() {
            colour::WALL
        } else if self.obstacle().cell() == Some(cell) {
            colour::OBSTACLE
        } else if !self.found && cell == Cell::PLACES[self.place()] {
            colour::VICTIM
        } else if cell == Cell::ENTRANCE {
            colour::ENTRANCE
        } else {
            colour::FLOOR
        }
    }
}

impl Discrete for World {
    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn scenarios(&self) -> u32 {
        Self::SCENARIOS
    }

    fn setting(&self) -> Setting {
        self.scene.setting
    }

    fn reset(&mut self, _seed: u64, _episode: u32, scenario: u32) {
        self.scenario = scenario % Self::SCENARIOS;
        self.person = Cell::ENTRANCE;
        self.found = false;
        self.steps = 0;
        self.end = End::Running;
    }

    fn step(&mut self, action: usize) -> Outcome {
        if !self.end.is_running() {
            return Outcome::new(Default::default(), false, self.end);
        }
        let reward = &self.scene.reward;
        let mut terms = [0.0, 0.0, 0.0, -reward.time as f32];
        let mut collided = false;
        if let Some(next) = neighbour(self.person, action) {
            if self.obstacle().cell() == Some(next) {
                collided = true;
                terms[2] = -reward.obstacle as f32;
            } else {
                self.person = next;
            }
        }
        if !self.found && self.person == Cell::PLACES[self.place()] {
            self.found = true;
            terms[0] = reward.found as f32;
        }
        self.steps += 1;
        if self.found && self.person == Cell::ENTRANCE {
            terms[1] = reward.rescued as f32;
            self.end = End::Success;
        } else if self.steps >= self.scene.episode.max_steps {
            self.end = End::OutOfTime;
        }
        Outcome::new(terms, collided, self.end)
    }

    fn end(&self) -> End {
        self.end
    }

    fn steps(&self) -> u32 {
        self.steps
    }

    fn scenario(&self) -> u32 {
        self.scenario
    }

    fn observe(&self, visual: &mut [f32], verbal: &mut [f32]) {
        assert_eq!(visual.len(), VISUAL, "visual numbers");
        assert_eq!(verbal.len(), self.layout.verbal, "verbal numbers");
        for cell in 0..CELLS {
            let colour = self.colour_of(Cell::from_index(cell));
            for channel in 0..3 {
                visual[channel * CELLS + cell] = colour[channel];
            }
        }
        visual[IMAGE] = (self.person.row() as f32 - 4.0) / 4.0;
        visual[IMAGE + 1] = (self.person.column() as f32 - 4.0) / 4.0;
        visual[IMAGE + 2] = f32::from(u8::from(self.found));
        let width = self.words.width();
        for subject in 0..UTTERANCES {
            let yes = if subject < PLACES {
                !self.found && subject == self.place()
            } else {
                self.obstacle().blocked() >> (subject - PLACES) & 1 == 1
            };
            let vector = self.words.vector(2 * subject + usize::from(yes));
            verbal[subject * width..(subject + 1) * width].copy_from_slice(vector);
        }
    }

    fn legal(&self, action: usize) -> bool {
        neighbour(self.person, action).is_some()
    }

    fn expert(&self) -> usize {
        let target = if self.found {
            Cell::ENTRANCE
        } else {
            Cell::PLACES[self.place()]
        };
        let steps = distances(target, self.obstacle().blocked());
        step_towards(&steps, self.person).trailing_zeros().min(3) as usize
    }

    fn render(&self, out: &mut String) {
        for row in 0..SIZE {
            for column in 0..SIZE {
                let cell = Cell::new(row, column);
                out.push(if cell == self.person {
                    if self.found { '@' } else { 'P' }
                } else if cell.is_wall() {
                    '#'
                } else if self.obstacle().cell() == Some(cell) {
                    'X'
                } else if !self.found && cell == Cell::PLACES[self.place()] {
                    'V'
                } else if cell == Cell::ENTRANCE {
                    'E'
                } else {
                    '.'
                });
            }
            out.push('\n');
        }
        let _ = writeln!(
            out,
            "step {} scenario {} ({:?}): P person, @ with the victim, V victim, X obstacle, E entrance",
            self.steps, self.scenario, self.end
        );
    }
}

const _: () = assert!(CORRIDORS + PLACES == UTTERANCES);
