//! Makes the ten simulated drivers of gridworld driving: `cargo run --release -p training --example draw_drivers`.
//!
//! The paper learned its simulated drivers' rewards from rounds that human beings drove. There are none here: each person is a drawn
//! noisy driver, who drives as many rounds as the paper's participants did (24) in clear weather, and maximum-entropy IRL learns
//! the reward from these rounds. (Not from fog: what a driver does about a car that they cannot see says nothing about what
//! they want.) Writes `shared/domains/people/driving/01.toml` …. Nobody is tuned singly.

use std::path::Path;

use domains::discrete::{Discrete, Domain, Mind, Scene, Setting};
use domains::driving::{Person, Planning, SimulatedDriver, VERBAL, VISUAL, Weights, World};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use training::irl::{IrlError, IrlSettings, driving_lattice, learn};

const SEED: u64 = 10;
const PEOPLE: u32 = 10;
const ROUNDS: u32 = 24;
/// Drawn weights, uniform: lanes to the right of the road's centre, closeness of each car, lane changes.
const OFFSET: (f32, f32) = (-0.5, 0.5);
const CLOSENESS: (f32, f32) = (-10.0, -5.0);
const CHANGE: (f32, f32) = (-2.0, -1.0);
/// Slips, uniform.
const SLIP: (f32, f32) = (0.0, 0.05);
/// How everybody plans: with an eye on the 8 steps ahead.
const PLANNING: Planning = Planning {
    horizon: 8,
    samples: 32,
    iterations: 3,
    elites: 8,
    discount: 0.95,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../domains/people/driving");
    for id in 1..=PEOPLE {
        let mut random = ChaCha8Rng::seed_from_u64(SEED * 3000 + u64::from(id));
        let mut uniform = |(low, high): (f32, f32)| random.random_range(low..high);
        let drawn = Person {
            id,
            slip: uniform(SLIP),
            weights: Weights {
                offset: uniform(OFFSET),
                closeness: std::array::from_fn(|_| uniform(CLOSENESS)),
                change: uniform(CHANGE),
            },
            planning: PLANNING,
        };
        let Scene::Driving(scene) = Scene::of(Domain::Driving, Setting::Original) else {
            unreachable!("asked for driving")
        };
        let mut world = World::new(&scene);
        let mut driver = SimulatedDriver::new(&drawn, &scene);
        let (mut row, mut words) = ([0.0; VISUAL], [0.0; VERBAL]);
        let mut rounds = Vec::new();
        for round in 0..ROUNDS {
            world.reset(SEED + u64::from(id), round, round);
            driver.reset(SEED + u64::from(id), round);
            let (mut visual, mut actions) = (Vec::new(), Vec::new());
            loop {
                world.observe(&mut row, &mut words);
                visual.extend(row);
                if !world.end().is_running() {
                    break;
                }
                let seen = driver.look(&row);
                driver.perceive(&row, &words, seen);
                let action = driver.act();
                actions.push(action);
                world.step(action);
            }
            let lattice = driving_lattice(&visual, &actions);
            rounds.push(lattice.map_err(|reason| IrlError::Round {
                round: round as usize,
                reason,
            })?);
        }
        let settings = IrlSettings {
            discount: f64::from(PLANNING.discount),
            ..IrlSettings::default()
        };
        let learned = learn(&rounds, &settings)?;
        let [offset, a, b, c, d, change] = learned.weights[..] else {
            unreachable!("six features, six weights")
        };
        let was = drawn.weights;
        let text = format!(
            "# Simulated driver {id}: weights learned by maximum-entropy IRL (prior precision {}) from {ROUNDS} rounds in clear weather, {} actions\n\
             # with a mean log-likelihood of {:.4}, of a drawn noisy driver; not of any human being. The drawn driver's own weights: offset\n\
             # {:.3} (uniform from {} to {}), closeness {:.3?} ({} to {}), change {:.3} ({} to {});\n\
             # slip uniform from {} to {} (training/examples/draw_drivers.rs, seed {SEED}).\n\
             id = {id}\nslip = {:.4}\n\n\
             [weights]\noffset = {offset:.4}\ncloseness = [{a:.4}, {b:.4}, {c:.4}, {d:.4}] # front left, front right, rear left, rear right\nchange = {change:.4}\n\n\
             [planning]\nhorizon = {}\nsamples = {}\niterations = {}\nelites = {}\ndiscount = {}\n",
            settings.prior,
            learned.actions,
            learned.log_likelihood,
            was.offset,
            OFFSET.0,
            OFFSET.1,
            was.closeness,
            CLOSENESS.0,
            CLOSENESS.1,
            was.change,
            CHANGE.0,
            CHANGE.1,
            SLIP.0,
            SLIP.1,
            drawn.slip,
            PLANNING.horizon,
            PLANNING.samples,
            PLANNING.iterations,
            PLANNING.elites,
            PLANNING.discount,
        );
        std::fs::write(folder.join(format!("{id:02}.toml")), text)?;
        println!("{id:2}: {:?} → {:.3?}", was.array(), learned.weights);
    }
    Ok(())
}
