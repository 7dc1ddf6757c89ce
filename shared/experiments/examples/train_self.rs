//! Trains a highway self-model and writes it: `self_model SEED EPISODES OUT`.

use std::sync::Arc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, seed, episodes, out] = arguments.as_slice() else {
        return Err("usage: self_model SEED EPISODES OUT".into());
    };
    let settings = training::self_model::Settings {
        seed: seed.parse()?,
        episodes: episodes.parse()?,
        length: std::env::var("LENGTH").map_or(Ok(8), |s| s.parse())?,
        sequences: std::env::var("SEQUENCES").map_or(Ok(75), |s| s.parse())?,
        imitation_decay: std::env::var("DECAY").map_or(Ok(0.995), |s| s.parse())?,
        keep: std::env::var("KEEP").map_or(Ok(0.35), |s| s.parse())?,
        ..Default::default()
    };
    let scene = Arc::new(domains::highway::Scene::builtin("highway-clear")?);
    let table = models::utterances::UtteranceTable::shipped()?;
    let mut trainer = training::self_model::Trainer::new(scene, table, settings)?;
    let started = std::time::Instant::now();
    for _ in 0..settings.episodes {
        let metrics = trainer.episode();
        println!(
            "{:.1} {}",
            started.elapsed().as_secs_f32(),
            serde_json::to_string(&metrics)?
        );
        let limit: f32 = std::env::var("SECONDS_LIMIT").map_or(Ok(1e9), |s| s.parse())?;
        if started.elapsed().as_secs_f32() > limit {
            break;
        }
        if trainer.episode % 50 == 0 {
            println!("evaluate {:?}", trainer.evaluate(30));
            models::checkpoint::save_self_model(out.as_ref(), &trainer.model, "unfinished")?;
        }
    }
    models::checkpoint::save_self_model(out.as_ref(), &trainer.model, &arguments.join(" "))?;
    Ok(())
}
