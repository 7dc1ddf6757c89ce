//! How the gridworlds' simulated people do without an assistant: `cargo run --release -p domains --example measure_gridworlds`.
//!
//! For each domain and setting: the expert, ten people alone, and ten people who are shown and told everything in every step. Means over
//! people with 95 % intervals (Student's, over people).

use domains::Mask;
use domains::discrete::{
    Discrete, Domain, End, Mind, Scene, Setting, SimulatedPerson, Words, World,
};

const ROUNDS: u32 = 72;
const SEED: u64 = 4;
/// Student's t, 9 degrees of freedom, 97.5 %.
const T9: f64 = 2.262;

#[derive(Clone, Copy)]
enum Who {
    Expert,
    Alone,
    ToldAll,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!(
        "domain         setting   who       success           collisions a round  steps            reward"
    );
    for domain in Domain::ALL {
        for setting in [Setting::Original, Setting::Transfer] {
            for (name, who) in [
                ("expert", Who::Expert),
                ("alone", Who::Alone),
                ("told all", Who::ToldAll),
            ] {
                let scene = Scene::of(domain, setting);
                let rows: Vec<[f64; 4]> = (1..=SimulatedPerson::COUNT)
                    .map(|id| play(&scene, id, who))
                    .collect::<Result<_, _>>()?;
                let columns = (0..4).map(|k| interval(rows.iter().map(|row| row[k])));
                let text: Vec<String> =
                    columns.map(|(m, h)| format!("{m:7.3} ± {h:6.3}")).collect();
                println!(
                    "{:14} {:9} {name:9} {}",
                    domain.name(),
                    setting.name(),
                    text.join("  ")
                );
            }
        }
    }
    Ok(())
}

/// Mean and half the width of the interval.
fn interval(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let n = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / n;
    let variance = values.map(|x| (x - mean) * (x - mean)).sum::<f64>() / (n - 1.0);
    (mean, T9 * (variance / n).sqrt())
}

/// Share of rounds that succeed, collisions, steps and reward, per round.
fn play(scene: &Scene, id: u32, who: Who) -> Result<[f64; 4], Box<dyn std::error::Error>> {
    let words = Words::indicator(scene.sentences().len());
    let mut world = World::new(scene, &words)?;
    let mut person = SimulatedPerson::builtin(scene, id, &words)?;
    let layout = world.layout().clone();
    let told = match who {
        Who::ToldAll => layout.communicable,
        _ => Mask::NONE,
    };
    let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
    let mut sums = [0.0; 4];
    for round in 0..ROUNDS {
        world.reset(SEED, round, round);
        person.reset(SEED + u64::from(id), round);
        while world.end().is_running() {
            let action = match who {
                Who::Expert => world.expert(),
                _ => {
                    world.observe(&mut visual, &mut verbal);
                    let seen = person.look(&visual);
                    person.perceive(&visual, &verbal, seen | told);
                    person.act()
                }
            };
            let outcome = world.step(action);
            sums[1] += f64::from(u8::from(outcome.collided));
            sums[2] += 1.0;
            sums[3] += f64::from(outcome.reward);
        }
        sums[0] += f64::from(u8::from(world.end() == End::Success));
    }
    Ok(sums.map(|sum| sum / f64::from(ROUNDS)))
}
