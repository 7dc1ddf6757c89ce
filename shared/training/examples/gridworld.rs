//! Trains a gridworld's self-model from nothing and says how well it acts: `cargo run --release -p training --example gridworld --
//! driving|search_rescue|bomb_defusal OUT [PHASES]`. Metrics are JSON lines on standard output.

use domains::discrete::{Discrete, Domain, Scene, Setting, Words, World};
use training::discrete::{Actor, Rollout, Settings, Trainer};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let usage = "usage: gridworld driving|search_rescue|bomb_defusal OUT [PHASES]";
    let domain = arguments.first().and_then(|name| Domain::from_name(name));
    let (Some(domain), Some(out)) = (domain, arguments.get(1)) else {
        eprintln!("{usage}");
        std::process::exit(2);
    };
    let scene = Scene::of(domain, Setting::Original);
    let words = Words::indicator(scene.sentences().len());
    let world = World::new(&scene, &words).expect("as many words as sentences");
    let mut settings = Settings::of(domain);
    if let Some(phases) = arguments.get(2).and_then(|n| n.parse().ok()) {
        settings.phases = phases;
    }
    let mut trainer = Trainer::new(world.clone(), settings);
    let start = std::time::Instant::now();
    while !trainer.is_done() {
        let metrics = trainer.phase();
        if trainer.phase.is_multiple_of(10) || trainer.is_done() {
            println!(
                "{} {:.1} s",
                serde_json::to_string(&metrics).unwrap_or_default(),
                start.elapsed().as_secs_f32()
            );
        }
    }
    let mut rollout = Rollout::new(world.clone(), &trainer.model);
    let rounds = 40 * world.scenarios();
    for (name, actor) in [
        ("expert", Actor::Expert),
        (
            "greedy",
            Actor::Greedy {
                explore: 0.0,
                limited: false,
            },
        ),
        (
            "limited",
            Actor::Greedy {
                explore: 0.0,
                limited: true,
            },
        ),
        (
            "random",
            Actor::Greedy {
                explore: 1.0,
                limited: false,
            },
        ),
    ] {
        let (mut reward, mut steps) = (0.0, 0);
        for round in 0..rounds {
            let lived = rollout
                .episode(&trainer.model, actor, 999, round % rounds)
                .0;
            reward += lived.reward;
            steps += lived.steps;
        }
        let n = rounds as f32;
        println!(
            "{name}: {:.3} a round of {:.1} steps",
            reward / n,
            steps as f32 / n
        );
    }
    trainer
        .model
        .save(out.as_ref(), "example gridworld")
        .expect("the file can be written");
}
