//! Draws the ten simulated people of search and rescue and of bomb defusal:
//! `cargo run --release -p domains --example draw_gridworld_people`.
//!
//! The paper learned its simulated people from rounds that human beings played. There are none here: each person is a drawn one,
//! who plays as many rounds as the paper's participants did (36 in each setting), and what the paper learned from people's rounds
//! is learned from theirs: transition probabilities between subgoals by counting, the probability of noticing a terminal by
//! maximum likelihood. Writes `people/search_rescue/01.toml` … and `people/bomb_defusal/01.toml` …. Nobody is tuned singly.
//! (Drivers: `cargo run --release -p training --example draw_drivers`.)

use std::fmt::Write as _;
use std::path::Path;

use domains::Mask;
use domains::discrete::{Discrete, Domain, Mind, Scene, Setting, Words};
use domains::{bomb_defusal, search_rescue};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Gamma};
use search_rescue::{SUBGOALS, Transitions, count_transitions, is_transition};

const SEED: u64 = 10;
const PEOPLE: u32 = 10;
/// Rounds in each setting.
const ROUNDS: u32 = 36;
/// Every row of a drawn searcher's transition probabilities: a Dirichlet distribution with this in every possible place.
const CONCENTRATION: f32 = 2.0;
/// Slips of searchers: uniform.
const SLIP: (f32, f32) = (0.0, 0.05);
/// Drawn probabilities of noticing a terminal within a step: uniform.
const NOTICE: (f32, f32) = (0.03, 0.12);

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("people");
    for id in 1..=PEOPLE {
        let file = |domain: Domain| folder.join(domain.name()).join(format!("{id:02}.toml"));
        std::fs::write(file(Domain::SearchRescue), searcher(id)?)?;
        std::fs::write(file(Domain::BombDefusal), defuser(id)?)?;
    }
    println!(
        "wrote {PEOPLE} searchers and {PEOPLE} defusers under {}",
        folder.display()
    );
    Ok(())
}

fn drawn_transitions(random: &mut ChaCha8Rng, found: bool) -> Result<Transitions, Failure> {
    let gamma = Gamma::new(CONCENTRATION, 1.0)?;
    let mut table = [[0.0; SUBGOALS]; SUBGOALS];
    for (from, row) in table.iter_mut().enumerate() {
        for (to, p) in row.iter_mut().enumerate() {
            if is_transition(from, to, found) {
                *p = f32::max(gamma.sample(random), 1e-3);
            }
        }
        let total: f32 = row.iter().sum();
        if total > 0.0 {
            row.iter_mut().for_each(|p| *p /= total);
        }
    }
    Ok(table)
}

fn searcher(id: u32) -> Result<String, Failure> {
    let mut random = ChaCha8Rng::seed_from_u64(SEED * 1000 + u64::from(id));
    let drawn = search_rescue::Person {
        id,
        slip: random.random_range(SLIP.0..SLIP.1),
        searching: drawn_transitions(&mut random, false)?,
        returning: drawn_transitions(&mut random, true)?,
    };
    let words = Words::indicator(search_rescue::SENTENCES.len());
    let mut rounds = Vec::new();
    for setting in [Setting::Original, Setting::Transfer] {
        let Scene::SearchRescue(scene) = Scene::of(Domain::SearchRescue, setting) else {
            unreachable!("asked for search and rescue")
        };
        let mut world = search_rescue::World::new(&scene, &words)?;
        let mut person = search_rescue::Searcher::new(&drawn, &scene, &words)?;
        let mut visual = vec![0.0; world.layout().visual];
        let mut verbal = vec![0.0; world.layout().verbal];
        for round in 0..ROUNDS {
            world.reset(SEED, round, round);
            person.reset(SEED + u64::from(id), round);
            let mut trace = vec![(world.person(), world.found())];
            while world.end().is_running() {
                world.observe(&mut visual, &mut verbal);
                let seen = person.look(&visual);
                person.perceive(&visual, &verbal, seen);
                world.step(person.act());
                trace.push((world.person(), world.found()));
            }
            rounds.push(trace);
        }
    }
    let (searching, returning) = count_transitions(rounds.iter().map(Vec::as_slice));
    let mut text = format!(
        "# Simulated searcher {id}: transition probabilities counted (one added to each) from {ROUNDS} rounds in clear air and {ROUNDS} in smoke\n\
         # of a drawn searcher, whose rows are Dirichlet({CONCENTRATION}) and whose slip is uniform from {} to {}\n\
         # (examples/draw_gridworld_people.rs, seed {SEED}); not modelled on any human being.\n\
         # Rows and columns: entrance, top corridor, bottom corridor, top right, middle right, bottom right.\n\
         id = {id}\nslip = {:.4}\n",
        SLIP.0, SLIP.1, drawn.slip
    );
    for (name, table) in [("searching", &searching), ("returning", &returning)] {
        let _ = writeln!(text, "{name} = [");
        for row in table {
            let numbers: Vec<String> = row.iter().map(|p| format!("{p:.4}")).collect();
            let _ = writeln!(text, "    [{}],", numbers.join(", "));
        }
        text.push_str("]\n");
    }
    Ok(text)
}

fn defuser(id: u32) -> Result<String, Failure> {
    let mut random = ChaCha8Rng::seed_from_u64(SEED * 2000 + u64::from(id));
    let drawn = bomb_defusal::Person {
        id,
        notice: random.random_range(NOTICE.0..NOTICE.1),
    };
    let words = Words::indicator(bomb_defusal::SENTENCES.len());
    let (mut trials, mut finds) = (0u32, 0u32);
    let Scene::BombDefusal(scene) = Scene::of(Domain::BombDefusal, Setting::Transfer) else {
        unreachable!("asked for bomb defusal")
    };
    let mut world = bomb_defusal::World::new(&scene, &words)?;
    let mut person = bomb_defusal::Defuser::new(&drawn, &scene, &words)?;
    let mut visual = vec![0.0; world.layout().visual];
    let mut verbal = vec![0.0; world.layout().verbal];
    // As the paper's participants, they are told the type.
    let told = Mask {
        visual: 0,
        verbal: 1,
    };
    for round in 0..ROUNDS {
        world.reset(SEED + u64::from(id), round, round);
        person.reset(SEED + u64::from(id), round);
        while world.end().is_running() {
            world.observe(&mut visual, &mut verbal);
            let seen = person.look(&visual);
            person.perceive(&visual, &verbal, seen | told);
            trials += 1; // a press follows at once, so that each step begins with a search
            finds += u32::from(person.live_known().is_some());
            world.step(person.act());
        }
    }
    let notice = f64::from(finds) / f64::from(trials);
    Ok(format!(
        "# Simulated defuser {id}: probability of noticing a terminal within a step, estimated from {ROUNDS} rounds ({finds} finds in {trials} steps)\n\
         # of a drawn defuser, whose own is uniform from {} to {} and was {:.4}\n\
         # (examples/draw_gridworld_people.rs, seed {SEED}); not modelled on any human being.\n\
         id = {id}\nnotice = {notice:.4}\n",
        NOTICE.0, NOTICE.1, drawn.notice
    ))
}
