//! A simulated defuser: searches for the live terminal, then presses the button that the rules say for it, guessing the type of
//! the bomb unless told (paper, Appendix, "Simulated Humans Agents").

use super::{
    BUTTONS, LIVE, Person, SENTENCES, Scene, TERMINALS, TYPES, Table, WAIT, read_terminal,
};
use crate::Mask;
use crate::discrete::memory::{of_index, to_index};
use crate::discrete::{Chance, Limits, Mind, Sight, Words, WordsError, draw};

/// Stream of random numbers of defusers.
const STREAM: u64 = 0x6465_6675;

/// A simulated defuser.
#[derive(Clone, Debug)]
pub struct Defuser {
    rules: Table,
    sight: Sight,
    words: Words,
    chance: Chance,
    live: Option<usize>,
    kind: Option<usize>,
}

impl Defuser {
    /// A defuser who knows the rules in force in a scene's setting, at the start of a round; `words` as the world's.
    ///
    /// # Errors
    /// If `words` has more or fewer vectors than there are sentences.
    pub fn new(person: &Person, scene: &Scene, words: &Words) -> Result<Self, WordsError> {
        words.expect(SENTENCES.len())?;
        Ok(Self {
            rules: *scene.rules.in_force(scene.setting),
            sight: Sight {
                limits: Limits::Probabilities([person.notice; TERMINALS]),
                heard: 0,
            },
            words: words.clone(),
            chance: Chance::new(STREAM, person.id),
            live: None,
            kind: None,
        })
    }

    /// The same person by other rules.
    pub fn with_rules(mut self, rules: &Table) -> Self {
        self.rules = *rules;
        self
    }

    /// The live terminal, once they have found it in this stage.
    pub fn live_known(&self) -> Option<usize> {
        self.live
    }

    /// The bomb's type, once they were told.
    pub fn kind_known(&self) -> Option<usize> {
        self.kind
    }
}

impl Mind for Defuser {
    fn reset(&mut self, seed: u64, episode: u32) {
        self.reseed(seed, episode, 0);
        self.live = None;
        self.kind = None;
    }

    fn reseed(&mut self, seed: u64, episode: u32, stream: u64) {
        self.chance.reseed(seed, episode, stream);
    }

    fn sight(&self) -> &Sight {
        &self.sight
    }

    fn look(&mut self, visual: &[f32]) -> Mask {
        self.sight.perceives(visual, &mut self.chance.eyes)
    }

    fn perceive(&mut self, visual: &[f32], verbal: &[f32], perceived: Mask) {
        for terminal in (0..TERMINALS).filter(|terminal| perceived.sees(*terminal)) {
            if read_terminal(visual, terminal) == LIVE {
                self.live = Some(terminal);
            }
        }
        if perceived.hears(0) {
            self.kind = Some(self.words.nearest(0..TYPES, verbal));
        }
    }

    fn probabilities(&mut self, out: &mut [f32]) {
        out.fill(0.0);
        match (self.live, self.kind) {
            (None, _) => out[WAIT] = 1.0,
            (Some(live), Some(kind)) => out[self.rules[kind][live] as usize] = 1.0,
            (Some(live), None) => {
                for kind in 0..TYPES {
                    out[self.rules[kind][live] as usize] += 1.0 / TYPES as f32;
                }
            }
        }
    }

    fn act(&mut self) -> usize {
        let mut probabilities = [0.0; BUTTONS + 1];
        self.probabilities(&mut probabilities);
        let action = draw(&probabilities, &mut self.chance.acts);
        self.acted(action);
        action
    }

    fn acted(&mut self, action: usize) {
        if action < BUTTONS {
            self.live = None; // the terminals change
        }
    }

    fn observed(&mut self, _: usize) {
        self.live = None; // who knows the live terminal presses; who waits does not know it
    }

    fn memory_len(&self) -> usize {
        2
    }

    fn write_memory(&self, out: &mut [f32]) {
        out.copy_from_slice(&[of_index(self.live), of_index(self.kind)]);
    }

    fn read_memory(&mut self, memory: &[f32]) {
        self.live = to_index(memory[0], TERMINALS);
        self.kind = to_index(memory[1], TYPES);
    }
}
