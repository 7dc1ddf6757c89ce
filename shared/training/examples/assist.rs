//! Learns implants of simulated people in a gridworld and lets assistants help them: `cargo run --release -p training --example assist --
//! MODEL driving|search_rescue|bomb_defusal [PEOPLE] [ROUNDS] [KIND…]`. Prints learned against true limits, and rewards.

use domains::discrete::{Discrete, Domain, Mind, Scene, Setting, SimulatedPerson, World};
use models::HumanModel;
use models::discrete::{DiscreteHuman, DiscreteModel};
use planning::DiscreteAssistant;
use planning::discrete::settings_of;
use planning::ideal::IdealPeople;
use planning::round::{Advice, RoundResult, play};
use std::sync::Arc;
use training::discrete::{Rounds, implants};

const USAGE: &str = "usage: assist MODEL driving|search_rescue|bomb_defusal [PEOPLE] [ROUNDS]";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, default: u32| {
        let given = arguments.get(i).and_then(|n| n.parse().ok());
        given.unwrap_or(default)
    };
    let domain = arguments.get(1).and_then(|name| Domain::from_name(name));
    let domain = domain.ok_or(USAGE)?;
    let scene = Scene::of(domain, Setting::Transfer);
    let words = models::words::shipped(domain)?;
    let mut world = World::new(&scene, &words)?;
    let layout = Arc::new(world.layout().clone());
    let model = Arc::new(DiscreteModel::load(arguments[0].as_ref(), layout)?);
    let mut planning = settings_of(scene.planning());
    planning.samples = number(4, 1000) as usize;
    planning.elites = planning.samples / 5;
    let rounds = number(3, 24);
    let seed = 5;
    for id in 1..=number(2, 3) {
        let mut person = SimulatedPerson::builtin(&scene, id, &words)?;
        println!("person {id}: {:?}", person.sight());
        let demonstrations = Rounds::record(&mut world, &mut person, seed, 1000, 8);
        let mut assistants: Vec<(&str, Box<dyn HumanModel>)> = Vec::new();
        let heard = demonstrations.heard;
        for (name, with_policy) in [("mirror", true), ("mirror-p", false)] {
            let start = std::time::Instant::now();
            let learned = implants::learn(
                &model,
                with_policy,
                &demonstrations,
                &implants::Settings::default(),
                &mut |_, _| {},
            )?;
            println!(
                "  {name}: loss {:.3} from {:.3}, limits {:.2?}, {:.2} s",
                learned.loss,
                learned.losses[0],
                learned.implants.limits(),
                start.elapsed().as_secs_f32()
            );
            let human = DiscreteHuman::new(Arc::clone(&model), Some(learned.implants), heard);
            assistants.push((name, Box::new(human)));
        }
        let human = DiscreteHuman::new(Arc::clone(&model), None, heard);
        assistants.push(("self", Box::new(human)));
        let print = |name: &str, results: &[RoundResult], seconds: f32| {
            let n = results.len() as f32;
            let mean = |of: fn(&RoundResult) -> f32| results.iter().map(of).sum::<f32>() / n;
            println!(
                "  {name:10} reward {:7.3} cost {:6.3} steps {:5.1} hit {:.3} shown {:5.2} said {:5.2} nll {:.3} ({:.1} ms a step)",
                mean(|r| r.reward),
                mean(|r| r.cost),
                mean(|r| r.steps as f32),
                mean(|r| r.collisions as f32),
                mean(|r| r.visual_items as f32),
                mean(|r| r.verbal_items as f32),
                mean(|r| r.surprise) / mean(|r| r.steps as f32),
                seconds * 1e3 / (n * mean(|r| r.steps as f32)),
            );
        };
        let mut all =
            |advice: &mut dyn FnMut(&mut World, &mut SimulatedPerson, u32) -> RoundResult| {
                let start = std::time::Instant::now();
                let results: Vec<_> = (0..rounds)
                    .map(|round| advice(&mut world, &mut person, round))
                    .collect();
                (results, start.elapsed().as_secs_f32())
            };
        let (silent, t) =
            all(&mut |w, p, i| play(w, p, Advice::Silence, seed, i).unwrap_or_default());
        print("silence", &silent, t);
        let (full, t) =
            all(&mut |w, p, i| play(w, p, Advice::Everything, seed, i).unwrap_or_default());
        print("everything", &full, t);
        let human = DiscreteHuman::new(Arc::clone(&model), None, heard);
        let mut assistant = DiscreteAssistant::new(Arc::clone(&model), Box::new(human), planning);
        let mut ideal = IdealPeople::new(
            &SimulatedPerson::builtin(&scene, id, &words)?,
            &model.layout,
        );
        let (results, t) = all(&mut |w, p, i| {
            let advice = Advice::Ideal(&mut assistant, &mut ideal);
            play(w, p, advice, seed, i).unwrap_or_default()
        });
        print("ideal", &results, t);
        for (name, human) in assistants {
            let mut assistant = DiscreteAssistant::new(Arc::clone(&model), human, planning);
            let (results, t) = all(&mut |w, p, i| {
                play(w, p, Advice::Planned(&mut assistant), seed, i).unwrap_or_default()
            });
            print(name, &results, t);
        }
    }
    Ok(())
}
