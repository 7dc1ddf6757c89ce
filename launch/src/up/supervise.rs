//! What the launcher does about processes that end or hang before the run is over.
//!
//! | process | its loss means |
//! | --- | --- |
//! | world | the episode is void; another world starts with the next one |
//! | driver | another person takes the wheel where it was left, and has forgotten what was said in this episode |
//! | belief, human | another one believes what it can from the newest frame on; a plan that was asking begins again |
//! | planner | another one decides from the same step; its last plan is no start for the next |
//! | renderer | another one shows the same step; the pause between two utterances is kept |
//! | recorder | the file ends with its last whole chunk; another recorder writes the next part |
//! | launcher | everybody ends within a second; the next `up` or `doctor --clean` removes what is left |
//!
//! In lockstep everybody else waits meanwhile, and no step is lost; in real time the run goes on, and misses are
//! counted. A process that does not answer for the hang limit ([`patience_ns`]) is killed, and then counts as lost; in
//! lockstep only if it stands still, for one that computes is waited for. One that dies too often without having lived
//! for [`HEALTHY_NS`] ends the run.

use super::ended::{Cause, Ended, signal_name};
use super::heads::Heads;
use crate::process::NAMES;
use runtime::{ClockMode, Position, now_ns};
use serde::Serialize;

const MS: u64 = 1_000_000;
/// How often everybody is asked at the least, and how often during the hang limit.
const ASK_NS: u64 = 400 * MS;
const ASKED: u64 = 5;
/// Longest steps that a process may be silent for.
const LONGEST_STEPS: u64 = 4;
/// Who has lived for so long counts as healthy: earlier deaths are forgotten.
pub const HEALTHY_NS: u64 = 1_000 * MS;
/// Pause before the second restart in a row; doubled with every further one.
const FIRST_PAUSE_NS: u64 = 100 * MS;
/// Longest pause.
const LONGEST_PAUSE_NS: u64 = 5_000 * MS;

/// How often everybody is asked whether they are there.
pub fn ask_ns(hang_limit_ns: u64) -> u64 {
    ASK_NS.min(hang_limit_ns / ASKED)
}

/// How long a process may be silent, though asked several times: the limit, or what a few of its longest steps take.
pub fn patience_ns(hang_limit_ns: u64, longest_step_ns: u64) -> u64 {
    hang_limit_ns.max(longest_step_ns.saturating_mul(LONGEST_STEPS))
}

/// A process that ended before the run did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Death {
    /// The process.
    pub process: String,
    /// Whether it was our own executable, not somebody else's program.
    pub is_ours: bool,
    /// What ended it.
    pub cause: Cause,
    /// The signal's name, or its number where it has none.
    pub signal: Option<String>,
    /// How it ended and, where that is known, why.
    pub how: String,
    /// Newest episode and step that it had spoken of.
    pub position: Option<Position>,
    /// Milliseconds from its end until its successor was told to go on; none if it had no successor.
    pub back_after_ms: Option<f64>,
}

/// A place whose process has died.
#[derive(Clone, Copy, Debug, Default)]
struct Vacancy {
    /// When it is to be filled again.
    due_ns: Option<u64>,
    /// Deaths in a row.
    in_a_row: u32,
    /// When the last process became active; none if it has not yet, however long its start takes.
    since_ns: Option<u64>,
}

/// The launcher's book of the living and the dead.
pub struct Supervisor {
    most_in_a_row: u32,
    places: [Vacancy; NAMES.len()],
    died_ns: [Option<(u64, usize)>; NAMES.len()],
    /// Everyone who died, in order.
    pub deaths: Vec<Death>,
    /// Processes started again.
    pub restarts: u64,
    /// Processes killed because they hung.
    pub hangs: u64,
}

impl Supervisor {
    /// Restarts a process at most so many times in a row.
    pub fn new(most_in_a_row: u32) -> Self {
        Self {
            most_in_a_row,
            places: [Vacancy {
                since_ns: Some(now_ns()),
                ..Vacancy::default()
            }; NAMES.len()],
            died_ns: [None; NAMES.len()],
            deaths: Vec::new(),
            restarts: 0,
            hangs: 0,
        }
    }

    /// Takes note of the death of one whose part nobody has to take.
    pub fn note(&mut self, ended: &Ended, heads: &Heads) {
        let name = NAMES[ended.place];
        let named = |signal| signal_name(signal).map_or(signal.to_string(), str::to_owned);
        self.deaths.push(Death {
            process: name.to_owned(),
            is_ours: ended.is_ours,
            cause: ended.cause,
            signal: ended.signal.map(named),
            how: ended.how.clone(),
            position: heads.newest(ended.place).filter(|_| name != "recorder"),
            back_after_ms: None,
        });
    }

    /// Takes note of a death. Returns why the run cannot go on, if it cannot.
    pub fn bury(&mut self, ended: &Ended, heads: &Heads) -> Option<String> {
        let (now, name) = (now_ns(), NAMES[ended.place]);
        self.died_ns[ended.place].get_or_insert((now, self.deaths.len()));
        self.note(ended, heads);
        let place = &mut self.places[ended.place];
        let lived_ns = place.since_ns.map_or(0, |since| now.saturating_sub(since));
        if lived_ns > HEALTHY_NS {
            place.in_a_row = 0;
        }
        place.in_a_row += 1;
        if place.in_a_row > self.most_in_a_row {
            return Some(match self.most_in_a_row {
                0 => format!("{name} {}", ended.how),
                most => format!("{name} {}, after {most} restarts in a row", ended.how),
            });
        }
        place.due_ns = Some(now + pause_ns(place.in_a_row));
        None
    }

    /// The next place to fill, if it is time; it is this caller's to fill.
    pub fn due(&mut self) -> Option<usize> {
        let now = now_ns();
        let found = self
            .places
            .iter()
            .position(|place| place.due_ns.is_some_and(|due| due <= now))?;
        self.places[found].due_ns = None;
        self.places[found].since_ns = None;
        self.restarts += 1;
        Some(found)
    }

    /// Somebody else will fill the place: the new process of a swap.
    pub fn leave(&mut self, place: usize) {
        self.places[place].due_ns = None;
    }

    /// Nobody else will after all: it is due now.
    pub fn fill(&mut self, place: usize) {
        self.places[place].due_ns = Some(now_ns());
    }

    /// A successor was told to go on.
    pub fn is_back(&mut self, place: usize) {
        let now = now_ns();
        self.places[place].since_ns = Some(now);
        if let Some((died_ns, first)) = self.died_ns[place].take() {
            for death in &mut self.deaths[first..] {
                if death.process == NAMES[place] {
                    death.back_after_ms = Some((now - died_ns) as f64 / MS as f64);
                }
            }
        }
    }

    /// When the next place is to be filled.
    pub fn next_due_ns(&self) -> Option<u64> {
        self.places.iter().filter_map(|place| place.due_ns).min()
    }
}

/// None before the first restart in a row; then doubling.
fn pause_ns(in_a_row: u32) -> u64 {
    match in_a_row {
        0 | 1 => 0,
        more => (FIRST_PAUSE_NS << (more - 2).min(10)).min(LONGEST_PAUSE_NS),
    }
}

/// From where on a process is active whose predecessor died.
pub fn handover_after_death(clock: ClockMode, heads: &Heads, place: usize) -> Position {
    match clock {
        ClockMode::Lockstep => last_words(heads, place),
        ClockMode::RealTime => next_handover(heads, place), // nobody waits for what was missed
    }
}

/// From where on a process is active that was started again in lockstep: it repeats its predecessor's last words, for a
/// process that is killed while it sends has told some and not others. A human model's belief also has a planner that
/// was asking begin again. A world begins a new episode.
fn last_words(heads: &Heads, place: usize) -> Position {
    match (NAMES[place], heads.newest(place)) {
        (_, None) => (0, 0),
        ("world", Some((episode, _))) => (episode + 1, 0),
        (_, Some(position)) => position,
    }
}

/// From where on a process is active that was started again in real time: after its predecessor's last words. A human
/// model repeats its last belief, as above.
pub fn next_handover(heads: &Heads, place: usize) -> Position {
    let newest = heads.newest(place);
    match (NAMES[place], newest) {
        (_, None) => (0, 0),
        ("world", Some((episode, _))) => (episode + 1, 0),
        ("human", Some(position)) => position,
        (_, Some((episode, step))) => (episode, step + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patience_grows_with_the_longest_step() {
        let limit = 2_000 * MS;
        assert_eq!(patience_ns(limit, 3 * MS), limit);
        assert_eq!(patience_ns(limit, 900 * MS), 3_600 * MS);
        assert_eq!(patience_ns(limit, u64::MAX), u64::MAX);
        assert_eq!(ask_ns(limit), ASK_NS);
        assert!(ASKED * ask_ns(100 * MS) <= 100 * MS);
    }

    #[test]
    fn pauses_double_up_to_a_limit() {
        let pauses: Vec<_> = (1..12).map(|n| pause_ns(n) / MS).collect();
        assert_eq!(pauses[..6], [0, 100, 200, 400, 800, 1600]);
        assert_eq!(pauses[10], LONGEST_PAUSE_NS / MS);
    }
}
