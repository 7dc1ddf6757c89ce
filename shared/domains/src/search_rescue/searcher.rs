//! A simulated searcher: goes from subgoal to subgoal by shortest paths, searches every place until the victim is known, and never
//! forgets what they saw or heard (paper, Appendix, "Simulated Humans Agents").

use super::map::{Cell, distances, neighbour, step_towards};
use super::person::{SUBGOALS, Transitions, is_transition, subgoal_cell};
use super::world::colour;
use super::{
    CELLS, CORRIDORS, IMAGE, PLACES, Person, SENTENCES, Scene, UTTERANCES, portion_of, position_in,
};
use crate::Mask;
use crate::discrete::memory::{of_index, of_truth, to_index, to_truth};
use crate::discrete::{Chance, Limits, Mind, Setting, Sight, Words, WordsError, draw};

/// Stream of random numbers of searchers.
const STREAM: u64 = 0x7372_6368;
/// The first subgoal that is a place.
const FIRST_PLACE: usize = 1 + CORRIDORS;

/// A simulated searcher.
#[derive(Clone, Debug)]
pub struct Searcher {
    searching: Transitions,
    returning: Transitions,
    slip: f32,
    sight: Sight,
    words: Words,
    chance: Chance,
    position: Cell,
    found: bool,
    /// Of each place: whether the victim is there, if known.
    victim: [Option<bool>; PLACES],
    /// Of each corridor: whether it is blocked, if known.
    blocked: [Option<bool>; CORRIDORS],
    last: usize,
    target: Option<usize>,
}

impl Searcher {
    /// A searcher in a scene's setting, at the start of a round; `words` as the world's.
    ///
    /// # Errors
    /// If `words` has more or fewer vectors than there are sentences.
    pub fn new(person: &Person, scene: &Scene, words: &Words) -> Result<Self, WordsError> {
        words.expect(SENTENCES.len())?;
        let radius = match scene.setting {
            // Farther than any two cells of the map are apart.
            Setting::Original => 2.0 * super::SIZE as f32,
            Setting::Transfer => scene.smoke.radius_cells as f32,
        };
        Ok(Self {
            searching: person.searching,
            returning: person.returning,
            slip: person.slip,
            sight: Sight {
                limits: Limits::Radius(radius),
                heard: super::heard(scene.setting),
            },
            words: words.clone(),
            chance: Chance::new(STREAM, person.id),
            position: Cell::ENTRANCE,
            found: false,
            victim: [None; PLACES],
            blocked: [None; CORRIDORS],
            last: 0,
            target: None,
        })
    }

    /// What they know of the places: whether the victim is there.
    pub fn victim_known(&self) -> &[Option<bool>; PLACES] {
        &self.victim
    }

    /// What they know of the corridors: whether they are blocked.
    pub fn blocked_known(&self) -> &[Option<bool>; CORRIDORS] {
        &self.blocked
    }

    fn blocked_bits(&self) -> u8 {
        let known = self.blocked.iter().enumerate();
        known.fold(0, |bits, (corridor, blocked)| {
            bits | u8::from(*blocked == Some(true)) << corridor
        })
    }

    /// Whether going to a subgoal can be of use, by what they know.
    fn is_useful(&self, subgoal: usize) -> bool {
        match subgoal {
            0 => self.found,
            1..FIRST_PLACE => self.blocked[subgoal - 1] != Some(true),
            _ => {
                let place = subgoal - FIRST_PLACE;
                let elsewhere = self.victim.iter().position(|there| *there == Some(true));
                !self.found
                    && self.victim[place] != Some(false)
                    && elsewhere.is_none_or(|known| known == place)
            }
        }
    }

    /// Probabilities of the next subgoal from the one last reached.
    fn choices(&self) -> [f32; SUBGOALS] {
        let table = if self.found {
            &self.returning
        } else {
            &self.searching
        };
        let mut out = [0.0; SUBGOALS];
        for to in 0..SUBGOALS {
            if is_transition(self.last, to, self.found) && self.is_useful(to) {
                out[to] = table[self.last][to];
            }
        }
        let total: f32 = out.iter().sum();
        if total > 0.0 {
            out.iter_mut().for_each(|p| *p /= total);
        }
        out
    }

    /// Directions that are open, and those of them that lead nearer to a subgoal, a bit each; all, where none does.
    fn ways(&self, target: Option<usize>) -> (u8, u8) {
        let closed = self.blocked_bits();
        let open = |action: usize| {
            neighbour(self.position, action).is_some_and(|next| {
                !(0..CORRIDORS).any(|corridor| {
                    closed >> corridor & 1 == 1 && Cell::CORRIDORS[corridor] == next
                })
            })
        };
        let ways = (0..4).fold(0u8, |bits, action| bits | u8::from(open(action)) << action);
        let mut nearer = match target {
            Some(subgoal) => {
                step_towards(&distances(subgoal_cell(subgoal), closed), self.position) & ways
            }
            None => 0,
        };
        if nearer == 0 {
            nearer = ways; // nothing to go to, by what they know: they wander
        }
        (ways, nearer)
    }

    /// Probabilities of the directions on the way to a subgoal.
    fn directions(&self, target: Option<usize>) -> [f32; 4] {
        let (ways, nearer) = self.ways(target);
        let share = |bits: u8, action: usize| {
            f32::from(bits >> action & 1) / (bits.count_ones().max(1)) as f32
        };
        std::array::from_fn(|action| {
            (1.0 - self.slip) * share(nearer, action) + self.slip * share(ways, action)
        })
    }

    /// Takes in that something is, or is not, so.
    fn learn(&mut self, subject: usize, yes: bool) {
        if subject < PLACES {
            if !self.found {
                self.victim[subject] = Some(yes);
            }
            return;
        }
        let corridor = subject - PLACES;
        self.blocked[corridor] = Some(yes);
        if yes {
            self.blocked[1 - corridor] = Some(false); // at most one is blocked
        }
    }
}

/// The colour that a pixel looks most like.
fn colour_at(visual: &[f32], cell: Cell) -> [f32; 3] {
    let seen: [f32; 3] = std::array::from_fn(|channel| visual[channel * CELLS + cell.index()]);
    let colours = [
        colour::FLOOR,
        colour::OBSTACLE,
        colour::VICTIM,
        colour::PERSON,
        colour::CARRYING,
    ];
    let distance = |colour: &[f32; 3]| -> f32 {
        let pairs = colour.iter().zip(&seen);
        pairs.map(|(a, b)| (a - b) * (a - b)).sum()
    };
    let nearest = |a: [f32; 3], b: [f32; 3]| if distance(&b) < distance(&a) { b } else { a };
    colours.into_iter().reduce(nearest).unwrap_or(colour::FLOOR)
}

impl Mind for Searcher {
    fn reset(&mut self, seed: u64, episode: u32) {
        self.reseed(seed, episode, 0);
        self.position = Cell::ENTRANCE;
        self.found = false;
        self.victim = [None; PLACES];
        self.blocked = [None; CORRIDORS];
        self.last = 0;
        self.target = None;
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
        self.position = position_in(visual);
        let found = visual[IMAGE + 2] > 0.5;
        let width = self.words.width();
        for subject in 0..UTTERANCES {
            let cell = subgoal_cell(if subject < PLACES {
                FIRST_PLACE + subject
            } else {
                1 + subject - PLACES
            });
            if perceived.sees(portion_of(cell)) {
                let sign = if subject < PLACES {
                    colour::VICTIM
                } else {
                    colour::OBSTACLE
                };
                self.learn(subject, colour_at(visual, cell) == sign);
            }
            if perceived.hears(subject) {
                let heard = &verbal[subject * width..(subject + 1) * width];
                let sentence = self.words.nearest(2 * subject..2 * subject + 2, heard);
                self.learn(subject, sentence % 2 == 1);
            }
        }
        if found && !self.found {
            self.found = true;
            self.target = None;
        }
        let here = super::subgoal_at(self.position);
        if let Some(subgoal) = here
            && (self.target == Some(subgoal) || (self.found && subgoal >= FIRST_PLACE))
        {
            self.last = subgoal;
            self.target = None;
        }
        if let Some(target) = self.target
            && !self.is_useful(target)
        {
            self.target = None;
        }
    }

    fn probabilities(&mut self, out: &mut [f32]) {
        out.fill(0.0);
        let mut add = |weight: f32, directions: [f32; 4]| {
            for (p, direction) in out.iter_mut().zip(directions) {
                *p += weight * direction;
            }
        };
        if self.target.is_some() {
            add(1.0, self.directions(self.target));
            return;
        }
        let choices = self.choices();
        if choices.iter().all(|p| *p == 0.0) {
            add(1.0, self.directions(None));
        }
        for (subgoal, p) in choices.iter().enumerate().filter(|(_, p)| **p > 0.0) {
            add(*p, self.directions(Some(subgoal)));
        }
    }

    fn act(&mut self) -> usize {
        let mut probabilities = [0.0; 4];
        self.probabilities(&mut probabilities);
        let action = draw(&probabilities, &mut self.chance.acts);
        self.acted(action);
        action
    }

    fn acted(&mut self, action: usize) {
        if self.target.is_none() {
            // Where they are heading shows in what they did: the subgoal is drawn given the action.
            let mut weights = self.choices();
            for (subgoal, weight) in weights.iter_mut().enumerate().filter(|(_, w)| **w > 0.0) {
                *weight *= self.directions(Some(subgoal))[action.min(3)];
            }
            if weights.iter().sum::<f32>() > 0.0 {
                self.target = Some(draw(&weights, &mut self.chance.acts));
            }
        }
    }

    fn observed(&mut self, action: usize) {
        let (_, nearer) = self.ways(self.target);
        if nearer >> action.min(3) & 1 == 0 {
            self.target = None; // they are heading elsewhere
        }
        self.acted(action);
    }

    fn memory_len(&self) -> usize {
        4 + PLACES + CORRIDORS
    }

    fn write_memory(&self, out: &mut [f32]) {
        let (own, things) = out.split_at_mut(4);
        own.copy_from_slice(&[
            self.position.index() as f32,
            f32::from(u8::from(self.found)),
            self.last as f32,
            of_index(self.target),
        ]);
        let known = self.victim.iter().chain(&self.blocked);
        for (out, known) in things.iter_mut().zip(known) {
            *out = of_truth(*known);
        }
    }

    fn read_memory(&mut self, memory: &[f32]) {
        let (own, things) = memory.split_at(4);
        self.position = Cell::from_index((own[0] as usize).min(CELLS - 1));
        self.found = own[1] > 0.5;
        self.last = (own[2] as usize).min(SUBGOALS - 1);
        self.target = to_index(own[3], SUBGOALS);
        let known = self.victim.iter_mut().chain(&mut self.blocked);
        for (known, number) in known.zip(things) {
            *known = to_truth(*number);
        }
    }
}
