//! A lockstep tick of the whole set without planning (at most 500 µs): `cargo bench -p mirror --bench tick`.
//!
//! Runs `mirror up --planner none --human self` over the six cases again and again, with the self-model that ships or,
//! where none does, one of its sizes that learned nothing (which costs the same), and divides.

use domains::highway::modalities::layout;
use models::{SelfModel, Sizes};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::error::Error;
use std::process::Command;

const RUNS: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    let directory = tempfile::tempdir()?;
    let shipped = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../shared/pretrained/highway-self.safetensors"
    );
    let mut model = std::path::PathBuf::from(shipped);
    if !model.exists() {
        model = directory.path().join("self.safetensors");
        let untrained = SelfModel::new(
            Sizes::of(&layout()),
            layout(),
            &mut ChaCha8Rng::seed_from_u64(1),
        );
        untrained.save(&model, "cargo bench -p mirror --bench tick")?;
    }
    let file = directory.path().join("summary.json");
    let mut ticks = Vec::new();
    for run in 0..RUNS {
        let output = Command::new(env!("CARGO_BIN_EXE_mirror"))
            .args([
                "up",
                "--planner",
                "none",
                "--human",
                "self",
                "--quiet",
                "--episodes",
                "30",
                "--seed",
            ])
            .arg(run.to_string())
            .args([
                "--self-model".as_ref(),
                model.as_os_str(),
                "--summary".as_ref(),
                file.as_os_str(),
            ])
            .output()?;
        if !output.status.success() {
            return Err(String::from_utf8_lossy(&output.stderr).into_owned().into());
        }
        let summary: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&file)?)?;
        let number = |key: &str| summary[key].as_f64().unwrap_or(f64::NAN);
        let tick_us = 1e6 * number("wall_seconds") / number("steps");
        println!(
            "run {run}: {} steps, {tick_us:.1} µs per tick",
            number("steps")
        );
        if run + 1 == RUNS {
            println!("compute time per step (µs)    p50     p99");
            for (process, times) in summary["compute_us"].as_object().into_iter().flatten() {
                let at = |quantile: &str| times[quantile].as_f64().unwrap_or(f64::NAN);
                println!("  {process:<22}{:>9.1}{:>8.1}", at("p50"), at("p99"));
            }
        }
        ticks.push(tick_us);
    }
    ticks.sort_by(f64::total_cmp);
    println!(
        "lockstep tick: median {:.1} µs, best {:.1} µs of {RUNS} runs",
        ticks[RUNS / 2],
        ticks[0]
    );
    Ok(())
}
