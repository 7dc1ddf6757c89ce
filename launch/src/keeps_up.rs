//! Whether this machine keeps up in real time: some plans as `mirror up` makes them by default, against the length of a
//! step.
//!
//! The human model answers from a thread of its own, as its process does in a set.

use crate::console::out;
use crate::place;
use anyhow::{Context, Result};
use models::{Beliefs, Posterior, SelfHuman};
use nn::Tensor;
use planning::planner::From;
use planning::{Chooser, Method, Settings, ThreadedPeople};
use std::time::{Duration, Instant};

/// The scene of `mirror up` without options.
const SCENE: &str = "highway-fog";
/// Plans are made for so long …
const PATIENCE: Duration = Duration::from_secs(3);
/// … but at least so many …
const LEAST_PLANS: usize = 5;
/// … and at most so many.
const MOST_PLANS: usize = 40;
/// Sensing, filtering and showing have to fit into a step as well: plans may take this much of it.
const SHARE: f64 = 0.85;

/// What was measured.
struct Pace {
    /// Each plan, in ms, in ascending order.
    plans_ms: Vec<f64>,
    step_ms: f64,
    settings: Settings,
}

/// Measures, for some seconds, and says what it means.
///
/// # Errors
/// When the scene or the self-model that ship cannot be used.
pub fn report() -> Result<()> {
    out!("Real time (mirror up --clock realtime)");
    let pace = measure()?;
    for line in pace.lines() {
        out!("  {line}");
    }
    Ok(())
}

impl Pace {
    /// The plan that so large a share of plans is not slower than, in ms.
    fn at(&self, quantile: f64) -> f64 {
        let last = self.plans_ms.len() - 1;
        self.plans_ms[(quantile * last as f64).ceil() as usize]
    }

    /// In words.
    fn lines(&self) -> Vec<String> {
        let (p50, p99, step) = (self.at(0.5), self.at(0.99), self.step_ms);
        let mut lines = vec![format!(
            "a plan of the default scene takes {p50:.0} ms (p50), {p99:.0} ms (p99, of {} plans); a step lasts {step:.0} ms",
            self.plans_ms.len()
        )];
        if p99 <= SHARE * step {
            lines.push("this machine keeps up: decisions come in time".to_owned());
            return lines;
        }
        lines.push(match p50 <= SHARE * step {
            true => "this machine keeps up most of the time only: some decisions will rest on fewer futures",
            false => {
                "this machine does NOT keep up: most decisions will rest on fewer futures, and less will be said"
            }
        }
        .to_owned());
        lines.push("in real time a plan stops in time and rests on fewer futures; in lockstep, the default, everybody waits for it".to_owned());
        let futures = (self.settings.race.futures as f64 * SHARE * step / p99) as usize & !1;
        let first = self.settings.race.first.min(futures);
        if first >= 4 {
            lines.push(format!(
                "plans that would be in time as they are: [planning] race_futures = {futures}, race_first = {first} in a scene file, in place of {} and {}",
                self.settings.race.futures, self.settings.race.first
            ));
        }
        lines
    }
}

fn measure() -> Result<Pace> {
    let (scene, _) = place::scene(SCENE, None, "sim:1")?;
    let settings = place::settings(&scene)?;
    let (_, model) = place::self_model(None, &scene.scenario)?;
    let latent = model.sizes.latent;
    let (mut mean, mut std) = (Tensor::new(latent, 1), Tensor::new(latent, 1));
    nn::noise::fill(mean.data_mut(), 5, 0);
    std.fill(0.3);
    let mut person = Beliefs::new(latent, 1);
    person.fresh = false;
    person.mean.copy_from(&mean);
    person.deviation.copy_from(&std);
    let shape = model.sizes.shape;
    // What the implants have learned takes no time: these have learned nothing.
    let implants = Posterior::neutral(&model, true);
    let human = SelfHuman::new(model.clone(), Some(implants), 0);
    let mut people = ThreadedPeople::spawn(human, person, settings.most_rows(), &shape);
    let mut planner = Chooser::new(Method::Race, settings, &model);
    let mut plans_ms = Vec::new();
    let since = Instant::now();
    for step in 0..=MOST_PLANS {
        let from = From {
            mean: &mean,
            deviation: &std,
            known_action: Some([0.4, 0.0]),
            speech_ready_steps: 0,
            seed: 1,
            episode: 0,
            step: step as u32,
            until: None,
        };
        let began = Instant::now();
        planner
            .plan(&model, from, &mut people)
            .context("a plan to measure")?;
        // The first one makes its memory.
        if step > 0 {
            plans_ms.push(began.elapsed().as_secs_f64() * 1e3);
        }
        if plans_ms.len() >= LEAST_PLANS && since.elapsed() > PATIENCE {
            break;
        }
    }
    plans_ms.sort_by(f64::total_cmp);
    Ok(Pace {
        plans_ms,
        step_ms: scene.step_ns() as f64 * 1e-6,
        settings,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pace(plans_ms: &[f64]) -> String {
        let pace = Pace {
            plans_ms: plans_ms.to_vec(),
            step_ms: 150.0,
            settings: Settings::default(),
        };
        pace.lines().join("\n")
    }

    #[test]
    fn what_was_measured_is_said_in_words() {
        assert!(pace(&[70.0, 75.0, 90.0]).contains("this machine keeps up: "));
        assert!(pace(&[100.0, 110.0, 140.0]).contains("most of the time only"));
        let slow = pace(&[318.0, 325.0, 340.0]);
        assert!(slow.contains("does NOT keep up"), "{slow}");
        // 64 × 0.85 × 150 / 340 = 24.
        assert!(slow.contains("race_futures = 24, race_first = 8"), "{slow}");
    }
}
