//! The two conditions that fog, traffic and people are calibrated on, and nothing else: clear weather and fog, both
//! without any assistance. `cargo run --release -p domains --example calibrate [-- --everything]`
//!
//! `--everything` adds a reference: all that can be shown and said, always. It was first run after calibration was over.

use std::sync::Arc;

use domains::highway::episode::run;
use domains::highway::speech::{displayable, utterances};
use domains::highway::{
    Case, Cockpit, End, Fog, Observation, Person, Scene, Shown, SimulatedDriver, World,
};

const SEEDS: u64 = 3;

type Result = std::result::Result<(), Box<dyn std::error::Error>>;

#[derive(Default)]
struct Tally {
    rounds: u32,
    collisions: u32,
    late: u32,
    steps: u64,
    reward: f64,
}

/// Wilson's 95 % interval of a share, in percent.
fn interval(hits: u32, rounds: u32) -> (f64, f64) {
    let (n, z) = (f64::from(rounds), 1.96f64);
    let share = f64::from(hits) / n;
    let middle = (share + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z * (share * (1.0 - share) / n + z * z / (4.0 * n * n)).sqrt() / (1.0 + z * z / n);
    (100.0 * (middle - half), 100.0 * (middle + half))
}

fn everything(observation: &Observation, speak: bool) -> Shown {
    let mut shown = Shown {
        highlighted: 0b10_0011,
        ..Shown::default()
    };
    let mut place = 0;
    for (azimuth, object) in observation.object.iter().enumerate() {
        if displayable(azimuth)
            && *object >= 0
            && place < 16
            && !shown.highlighted_objects.contains(object)
        {
            shown.highlighted_objects[place] = *object;
            place += 1;
        }
    }
    if speak {
        shown.utterances = utterances(observation).map(Some);
    }
    shown
}

fn condition(name: &str, fog: Fog, show: impl Fn(u32, &Observation) -> Shown) -> Result {
    let scene = Arc::new(Scene::builtin("highway-fog")?);
    let mut world = World::new(Arc::clone(&scene))?;
    let mut tallies: [Tally; 6] = Default::default();
    let mut people = [0u32; 21];
    for id in 1..=Person::COUNT {
        let person = Person::builtin(id)?;
        let cockpit = Cockpit::new(&scene, world.road(), scene.ego.start_s_m);
        let mut driver = SimulatedDriver::new(&person, &fog, cockpit);
        for seed in 1..=SEEDS {
            for (index, case) in Case::ALL.into_iter().enumerate() {
                let episode = id * 6 + index as u32;
                world.reset_case(seed, episode, case);
                driver.reset(seed, episode);
                let round = run(&mut world, &mut driver, &show, None);
                let tally = &mut tallies[index];
                tally.rounds += 1;
                tally.collisions += u32::from(round.collided);
                people[id as usize - 1] += u32::from(round.collided);
                tally.late += u32::from(round.end == End::OutOfTime);
                tally.steps += u64::from(round.steps);
                tally.reward += round.reward;
            }
        }
    }
    let sum = |of: &dyn Fn(&Tally) -> f64| tallies.iter().map(of).sum::<f64>();
    let (rounds, hits) = (
        sum(&|t| f64::from(t.rounds)) as u32,
        sum(&|t| f64::from(t.collisions)) as u32,
    );
    let (low, high) = interval(hits, rounds);
    println!(
        "{name}: {hits} of {rounds} rounds end in a collision: {:.1} % (95 %: {low:.1} to {high:.1}); \
         out of time {:.1} %; {:.0} steps and {:.1} reward a round",
        100.0 * f64::from(hits) / f64::from(rounds),
        100.0 * sum(&|t| f64::from(t.late)) / f64::from(rounds),
        sum(&|t| t.steps as f64) / f64::from(rounds),
        sum(&|t| t.reward) / f64::from(rounds),
    );
    for (case, tally) in Case::ALL.iter().zip(&tallies) {
        println!(
            "  case {} (ego {}, {:?}): {} of {}",
            case.number(),
            if case.ego_left() { "left" } else { "right" },
            case.misbehaviour(),
            tally.collisions,
            tally.rounds
        );
    }
    println!("  by person, of {}: {people:?}", 6 * SEEDS);
    Ok(())
}

fn main() -> Result {
    let fog = Scene::builtin("highway-fog")?.fog();
    condition("clear weather", Fog::clear(), |_, _| Shown::default())?;
    condition("fog", fog, |_, _| Shown::default())?;
    if std::env::args().any(|argument| argument == "--everything") {
        // As the renderer speaks: one utterance at a time, every 3.5 s (24 steps), the sectors in turn.
        condition(
            "fog, everything shown, one utterance every 3.5 s",
            fog,
            |step, observation| {
                let mut shown = everything(observation, false);
                if step % 24 == 0 {
                    let sector = [3, 2, 4, 0, 1, 5][(step / 24 % 6) as usize];
                    shown.utterances[sector] = Some(utterances(observation)[sector]);
                }
                shown
            },
        )?;
        condition(
            "fog, everything shown and said in every step",
            fog,
            |_, observation| everything(observation, true),
        )?;
    }
    Ok(())
}
