//! Collisions and sentences of some conditions over rounds of chosen cases: how settings of the planner are chosen and judged,
//! on rounds that no study reports.
//!
//! `cargo run --release -p experiments --example race_oracle -- --conditions silent,ideal --people 1-21 --cases 2,5 --seed 101`

use anyhow::{Context, Result};
use domains::highway::{Case, Scene};
use experiments::drive::{Condition, Rider, RoundResult, Study};
use models::SelfModel;
use planning::items::highway_settings_of;
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

fn main() -> Result<()> {
    let given: Vec<String> = std::env::args().skip(1).collect();
    let option = |name: &str| {
        let at = given.iter().position(|word| word == name);
        at.and_then(|at| given.get(at + 1)).map(String::as_str)
    };
    let list = |name: &str, default: &str| -> Vec<u32> {
        let text = option(name).unwrap_or(default);
        text.split(',')
            .flat_map(|part| {
                let (low, high) = part.split_once('-').unwrap_or((part, part));
                low.parse().unwrap_or(1)..=high.parse().unwrap_or(0)
            })
            .collect()
    };
    let (people, cases, seeds) = (
        list("--people", "1-21"),
        list("--cases", "2,5"),
        list("--seed", "101"),
    );
    let mut settings = highway_settings_of(&Scene::builtin("highway-fog")?);
    let set = |name: &str, value: &mut usize| -> Result<()> {
        if let Some(text) = option(name) {
            *value = text.parse().with_context(|| name.to_owned())?;
        }
        Ok(())
    };
    set("--steps", &mut settings.race.steps)?;
    set("--first", &mut settings.race.first)?;
    set("--futures", &mut settings.race.futures)?;
    if let Some(text) = option("--certainty") {
        settings.race.certainty = text.parse().context("--certainty")?;
    }
    if let Some(problem) = settings.problem() {
        anyhow::bail!("{problem}");
    }
    let path = Path::new("shared/pretrained/highway-self.safetensors");
    let model = Arc::new(SelfModel::load(
        path,
        domains::highway::modalities::layout(),
    )?);
    for name in option("--conditions").unwrap_or("silent,ideal").split(',') {
        let condition = Condition::parse(name).with_context(|| name.to_owned())?;
        let study = Study {
            conditions: vec![condition],
            people: 21,
            seeds: 1,
            planned_seeds: 1,
            seed: 1,
            rounds: 6,
            settings,
        };
        let began = Instant::now();
        let rounds = people
            .par_iter()
            .map(|&id| -> Result<_> {
                let mut rider = Rider::new(&study, Some(&model), condition, id)?;
                let mut rounds = Vec::new();
                for &seed in &seeds {
                    for &case in &cases {
                        let case = Case::new(case).context("a case is 1 to 6")?;
                        let result = rider.round(u64::from(seed), case)?;
                        if given.iter().any(|word| word == "--each") {
                            println!("person {id} case {} seed {seed}: {result:?}", case.number());
                        }
                        rounds.push(result);
                    }
                }
                Ok(rounds)
            })
            .collect::<Result<Vec<_>>>()?
            .concat();
        let count = rounds.len() as f64;
        let sum = |of: fn(&RoundResult) -> f64| rounds.iter().map(of).sum::<f64>();
        let minutes = sum(|r| f64::from(r.steps)) * 0.15 / 60.0;
        let sentences = sum(|r| f64::from(r.utterances));
        println!(
            "{name}: {} of {count} rounds collided; {:.2} sentences a round ({:.2} a minute), {:.1} s of highlights a \
             minute, reward {:.1}; {:.0} s",
            sum(|r| f64::from(u8::from(r.collided))),
            sentences / count,
            sentences / minutes,
            sum(|r| f64::from(r.highlighted_steps)) * 0.15 / minutes,
            sum(|r| r.reward) / count,
            began.elapsed().as_secs_f64(),
        );
    }
    Ok(())
}
