//! How the expert drives: `cargo run --release -p domains --example expert`.

use std::sync::Arc;
use std::time::Instant;

use domains::highway::{Case, End, Expert, Scene, World};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut world = World::new(Arc::new(Scene::builtin("highway-clear")?))?;
    let start = Instant::now();
    let mut steps = 0u64;
    for case in Case::ALL {
        let (mut hits, mut late, mut reward, mut changes) = (0, 0, 0.0, 0.0);
        const ROUNDS: u32 = 100;
        for episode in 0..ROUNDS {
            world.reset_case(7, episode, case);
            let mut expert = Expert::new(&world);
            while world.end() == End::Running {
                let action = expert.act(&world);
                let outcome = world.step(action);
                reward += f64::from(outcome.reward);
                changes -= f64::from(outcome.change);
                steps += 1;
            }
            hits += u32::from(world.end() == End::Collision);
            late += u32::from(world.end() == End::OutOfTime);
        }
        println!(
            "case {}: {hits} collisions and {late} out of time in {ROUNDS} rounds, {:.1} lane changes and {:.1} reward a round",
            case.number(),
            changes / f64::from(ROUNDS),
            reward / f64::from(ROUNDS)
        );
    }
    println!(
        "{:.1} us a step",
        start.elapsed().as_secs_f64() * 1e6 / steps as f64
    );
    Ok(())
}
