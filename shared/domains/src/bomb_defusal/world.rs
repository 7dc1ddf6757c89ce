//! The bomb: its type, its terminals, its stages.

use std::fmt::Write as _;
use std::sync::Arc;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::glyph::{GLYPHS, LIVE, draw};
use super::{BUTTONS, IMAGE, SENTENCES, STAGES, Scene, TERMINALS, TYPES, Table, VISUAL, WAIT};
use crate::Layout;
use crate::discrete::{Discrete, End, Outcome, Setting, Words, WordsError, random};

/// Stream of random numbers of the terminals.
const STREAM: u64 = 0x626f_6d62;

/// The world of bomb defusal.
#[derive(Clone, Debug)]
pub struct World {
    scene: Arc<Scene>,
    layout: Arc<Layout>,
    words: Words,
    rules: Table,
    random: ChaCha8Rng,
    kind: usize,
    live: usize,
    glyphs: [u8; TERMINALS],
    stage: usize,
    steps: u32,
    end: End,
}

impl World {
    /// Scenarios: the two types.
    pub const SCENARIOS: u32 = TYPES as u32;

    /// A scene's world at scenario 0, with the rules that its setting puts in force; `words` has a vector for each of
    /// [`SENTENCES`].
    ///
    /// # Errors
    /// If there are more or fewer vectors.
    pub fn new(scene: &Arc<Scene>, words: &Words) -> Result<Self, WordsError> {
        words.expect(SENTENCES.len())?;
        let mut world = Self {
            scene: Arc::clone(scene),
            layout: Arc::new(super::layout(scene, words.width())),
            words: words.clone(),
            rules: *scene.rules.in_force(scene.setting),
            random: random(0, 0, STREAM),
            kind: 0,
            live: 0,
            glyphs: [0; TERMINALS],
            stage: 0,
            steps: 0,
            end: End::Running,
        };
        world.reset(0, 0, 0);
        Ok(world)
    }

    /// The same world under other rules.
    pub fn with_rules(mut self, rules: &Table) -> Self {
        self.rules = *rules;
        self
    }

    /// The type of the bomb.
    pub fn kind(&self) -> usize {
        self.kind
    }

    /// The terminal that matters in this stage.
    pub fn live(&self) -> usize {
        self.live
    }

    /// The stage, [`STAGES`] once defused.
    pub fn stage(&self) -> usize {
        self.stage
    }

    /// What each terminal shows.
    pub fn glyphs(&self) -> &[u8; TERMINALS] {
        &self.glyphs
    }

    /// The right button.
    pub fn button(&self) -> usize {
        self.rules[self.kind][self.live] as usize
    }

    fn change_terminals(&mut self) {
        self.live = self.random.random_range(0..TERMINALS);
        for terminal in 0..TERMINALS {
            let dead = self.random.random_range(LIVE + 1..GLYPHS.len());
            let glyph = if terminal == self.live { LIVE } else { dead };
            self.glyphs[terminal] = glyph as u8;
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

    fn reset(&mut self, seed: u64, episode: u32, scenario: u32) {
        self.random = random(seed, episode, STREAM);
        self.kind = (scenario % Self::SCENARIOS) as usize;
        self.stage = 0;
        self.steps = 0;
        self.end = End::Running;
        self.change_terminals();
    }

    fn step(&mut self, action: usize) -> Outcome {
        if !self.end.is_running() {
            return Outcome::new(Default::default(), false, self.end);
        }
        let reward = &self.scene.reward;
        let mut terms = [0.0, 0.0, -reward.time as f32, 0.0];
        if action < BUTTONS {
            if action == self.button() {
                terms[0] = reward.right as f32;
                self.stage += 1;
            } else {
                terms[1] = -reward.wrong as f32;
            }
            self.change_terminals();
        }
        self.steps += 1;
        if self.stage == STAGES {
            self.end = End::Success;
        } else if self.steps >= self.scene.episode.max_steps {
            self.end = End::OutOfTime;
        }
        Outcome::new(terms, false, self.end)
    }

    fn end(&self) -> End {
        self.end
    }

    fn steps(&self) -> u32 {
        self.steps
    }

    fn scenario(&self) -> u32 {
        self.kind as u32
    }

    fn observe(&self, visual: &mut [f32], verbal: &mut [f32]) {
        assert_eq!(visual.len(), VISUAL, "visual numbers");
        assert_eq!(verbal.len(), self.layout.verbal, "verbal numbers");
        visual.fill(0.0);
        for (terminal, glyph) in self.glyphs.iter().enumerate() {
            draw(&mut visual[..IMAGE], terminal, *glyph as usize);
        }
        visual[IMAGE + self.stage.min(STAGES - 1)] = 1.0;
        visual[IMAGE + STAGES] = 1.0 - self.steps as f32 / self.scene.episode.max_steps as f32;
        verbal.copy_from_slice(self.words.vector(self.kind));
    }

    fn legal(&self, action: usize) -> bool {
        action <= WAIT
    }

    fn expert(&self) -> usize {
        self.button()
    }

    fn render(&self, out: &mut String) {
        for line in 0..super::HEIGHT {
            for column in 0..super::WIDTH {
                let (row, y) = (line / 6, line % 6);
                let (slot, x) = (column / 6, column % 6);
                out.push(if x == 5 || y == 5 {
                    ' '
                } else {
                    GLYPHS[self.glyphs[row * 3 + slot] as usize][y * 5 + x] as char
                });
            }
            out.push('\n');
        }
        let _ = writeln!(
            out,
            "step {} stage {} type {} ({:?}): terminal {} is live, button {} is right",
            self.steps,
            self.stage + 1,
            ["A", "B"][self.kind],
            self.end,
            self.live + 1,
            self.button() + 1
        );
    }
}
