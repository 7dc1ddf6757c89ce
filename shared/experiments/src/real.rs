//! Real drivers: how well do human models that learned from some recorded people predict what others did? The
//! negative log-likelihood of recorded actions against the number of drivers learned from, drivers split, never frames.

mod drivers;
mod report;

pub use drivers::{Driver, Drivers, Rule, read_drivers};
pub use report::{Point, Report};

use crate::table::{Table, ensure_same};
use anyhow::{Context, ensure};
use domains::discrete::Setting;
use domains::highway::{AZIMUTHS, Scene, modalities};
use models::{
    Communicated, FollowedPerson, HumanModel, Kind, PersonalPolicy, RecurrentSizes, SelfHuman,
    SelfModel, Shape, View,
};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use training::cloning::{self, CloningSettings};
use training::implants::{self, ImplantSettings};
use training::rounds::{Round, Rounds};
use training::trajectory::{Trajectory, hold_out};

/// Models that are compared.
pub const MODELS: [Kind; 4] = [Kind::Mirror, Kind::MirrorP, Kind::Bc, Kind::Myself];
/// Steps at a drive's start that only build up the belief, and are not scored.
pub const WARM_UP: usize = 5;

/// What to run.
#[derive(Clone, Debug)]
pub struct Study {
    /// A CommonRoad file, or a folder of them.
    pub data: PathBuf,
    /// Splits of the drivers into those learned from and those tested.
    pub splits: u64,
    /// Seed of the splits and of learning.
    pub seed: u64,
    /// Fog in which one sees this far ahead, in metres; none: perception is unlimited.
    pub fog_m: Option<f64>,
    /// Only some numbers of drivers.
    pub quick: bool,
    /// Who is left out.
    pub rule: Rule,
}

/// A share of one third of the drivers is tested.
const TESTED: usize = 3;

impl Study {
    /// The split: drivers to learn from, in the order in which they are added, and drivers to test.
    pub fn split(&self, drivers: usize, split: u64) -> (Vec<usize>, Vec<usize>) {
        let mut order: Vec<usize> = (0..drivers).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(split + 1);
        order.shuffle(&mut rng);
        let tested = order.split_off(drivers - drivers / TESTED);
        (order, tested)
    }

    /// Numbers of drivers to learn from, of `most`: powers of two and all.
    pub fn counts(&self, most: usize) -> Vec<usize> {
        let mut counts: Vec<usize> = (1..).map(|n| 1 << n).take_while(|n| *n < most).collect();
        counts.push(most);
        if self.quick {
            let middle = counts[counts.len() / 2];
            counts.retain(|n| *n == 2 || *n == middle || *n == most);
        }
        counts
    }
}

const HEADER: &str = "model,split,drivers,tested,nll,nll_median";

/// Runs a study, or what is left of it, and writes `real.csv` into `out`. `progress` hears of (done, all).
///
/// # Errors
/// If the data cannot be read, are too few, or `out` cannot be written.
pub fn run(
    study: &Study,
    model: &Arc<SelfModel>,
    out: &Path,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> anyhow::Result<Report> {
    let drivers = read_drivers(&study.data, &study.rule)?;
    let kept = drivers.kept.len();
    ensure!(
        kept >= 2 * TESTED,
        "{}: {kept} drivers are left, at least {} are needed. {}",
        study.data.display(),
        2 * TESTED,
        study.rule.words()
    );
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let names: Vec<&str> = drivers.kept.iter().map(|d| d.name.as_str()).collect();
    let about = serde_json::json!({
        "seed": study.seed,
        "fog_m": study.fog_m,
        "rule": study.rule,
        "drivers": names,
        "self_model": model.digest(),
    });
    ensure_same(&out.join("real.settings.json"), &about)?;
    let table = Table::open(&out.join("real.csv"), HEADER, 3)?;
    let counts = study.counts(kept - kept / TESTED);
    let mut jobs = Vec::new();
    for split in 0..study.splits {
        for kind in MODELS {
            for &count in &counts {
                // The unchanged self-model learns from nobody.
                let count = if kind == Kind::Myself { 0 } else { count };
                let job = (kind, split, count);
                if !table.has(&key(job)) && !jobs.contains(&job) {
                    jobs.push(job);
                }
            }
        }
    }
    let done = AtomicUsize::new(0);
    progress(0, jobs.len());
    jobs.par_iter().try_for_each(|&(kind, split, count)| {
        let (learned, tested) = study.split(kept, split);
        let own: Vec<&Driver> = learned[..count].iter().map(|&i| &drivers.kept[i]).collect();
        let mut human = learn(kind, model, &own, study)?;
        let mut scores: Vec<f64> = tested
            .iter()
            .map(|&i| score(&mut *human, &drivers.kept[i].round))
            .collect();
        let nll = scores.iter().sum::<f64>() / scores.len() as f64;
        let median = median(&mut scores);
        table.append(&format!(
            "{},{},{nll:.5},{median:.5}\n",
            key((kind, split, count)),
            tested.len()
        ))?;
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        progress(done, jobs.len());
        anyhow::Ok(())
    })?;
    Ok(Report::new(study, &drivers, &counts, &table.finish()?))
}

fn key((kind, split, count): (Kind, u64, usize)) -> String {
    format!("{},{split},{count}", kind.name())
}

/// The middle one, or the mean of the two in the middle.
fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() % 2 {
        1 => values[middle],
        _ if middle == 0 => f64::NAN,
        _ => (values[middle - 1] + values[middle]) / 2.0,
    }
}

/// What everybody is taken to see.
fn visible_m(fog_m: Option<f64>) -> [f32; AZIMUTHS] {
    fog_m.map_or([f32::INFINITY; AZIMUTHS], |front_m| {
        let mut scene = Scene::default();
        scene.set_fog_m(front_m);
        scene.fog().visible_m
    })
}

fn learn(
    kind: Kind,
    model: &Arc<SelfModel>,
    drivers: &[&Driver],
    study: &Study,
) -> anyhow::Result<Box<dyn HumanModel>> {
    let visible_m = visible_m(study.fog_m);
    match kind {
        Kind::Mirror | Kind::MirrorP => {
            let rounds = Rounds {
                rounds: drivers.iter().map(|d| d.round.clone()).collect(),
                ..Rounds::new(&model.layout, Setting::Original, 0)
            };
            let settings = ImplantSettings {
                skip: WARM_UP,
                seed: study.seed,
                ..ImplantSettings::of(modalities::NAME)
            };
            let learned = implants::learn(model, kind, &rounds, &settings, &mut |_, _| {})?;
            let posterior = Some(learned.posterior);
            Ok(Box::new(SelfHuman::new(model.clone(), posterior, 0)))
        }
        Kind::Bc => {
            let layout = &*model.layout;
            let view = View::new(layout);
            let perceived = drivers.iter().map(|driver| {
                let mut round = driver.round.clone();
                round.perceive_within(layout, &visible_m);
                Trajectory::new(&round, &view, layout.actions)
            });
            let (train, held) = hold_out(perceived.collect());
            let settings = CloningSettings {
                seed: study.seed,
                ..CloningSettings::of(layout.domain)
            };
            let sizes = RecurrentSizes::of(layout, 1);
            // No simulated expert: people on a real motorway drive three times as fast as one in its world.
            let cloned = cloning::learn(layout, sizes, &train, &held, &settings, &|_, _, _| {})?;
            let person = PersonalPolicy {
                policy: cloned.policy,
                limits: visible_m.to_vec(),
                heard: 0,
            };
            Ok(Box::new(person.human(kind, &model.layout)))
        }
        _ => Ok(Box::new(SelfHuman::new(model.clone(), None, 0))),
    }
}

/// Mean −log π(a_t | what they perceived up to t) of a drive, in nats a step, after the warm-up.
pub fn score(human: &mut dyn HumanModel, round: &Round) -> f64 {
    let layout = modalities::layout();
    let shape = Shape::of(&layout);
    let mut person = FollowedPerson::new(human, &shape);
    let mut taken = vec![0.0; shape.action];
    let unheard = vec![0.0; shape.verbal];
    let (mut sum, mut counted) = (0.0, 0);
    for t in 0..round.len() {
        let sensed = (round.visual(t), &unheard[..]);
        let silent = Communicated::default();
        person.perceive(human, sensed, silent, &taken, [0, 0, t as u64]);
        if t >= WARM_UP {
            sum -= f64::from(person.expected().log_density(0, round.action(t)));
            counted += 1;
        }
        taken.copy_from_slice(round.action(t));
    }
    sum / f64::from(counted.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use models::Sizes;
    use rand::RngExt;

    fn study(quick: bool) -> Study {
        Study {
            data: PathBuf::new(),
            splits: 2,
            seed: 5,
            fog_m: None,
            quick,
            rule: Rule::default(),
        }
    }

    #[test]
    fn drivers_are_split_and_learned_from_in_a_fixed_order() {
        for drivers in [6, 20, 43] {
            let (learned, tested) = study(false).split(drivers, 1);
            assert_eq!(tested.len(), drivers / 3);
            let mut all: Vec<usize> = learned.iter().chain(&tested).copied().collect();
            all.sort_unstable();
            assert_eq!(all, (0..drivers).collect::<Vec<_>>());
            assert_eq!(study(true).split(drivers, 1), (learned.clone(), tested));
            assert_ne!(study(false).split(drivers, 0).0, learned);
        }
    }

    #[test]
    fn the_median_is_in_the_middle() {
        assert_eq!(median(&mut [9.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&mut [9.0, 1.0, 2.0, 4.0]), 3.0);
        assert!(median(&mut []).is_nan());
    }

    #[test]
    fn counts_end_with_everybody() {
        assert_eq!(study(false).counts(27), [2, 4, 8, 16, 27]);
        assert_eq!(study(false).counts(16), [2, 4, 8, 16]);
        assert_eq!(study(true).counts(27), [2, 8, 27]);
        assert_eq!(study(true).counts(4), [2, 4]);
    }

    /// A drive of `steps` steps at random, the same for the same seed.
    fn driver(seed: u64, steps: usize) -> Round {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let numbers = steps * modalities::VISUAL;
        Round {
            visual: (0..numbers).map(|_| rng.random_range(0.0..1.0)).collect(),
            action: [0.2, 0.01].repeat(steps),
            reward: vec![0.0; steps],
            ..Round::default()
        }
    }

    #[test]
    fn a_score_is_the_mean_of_what_follows_the_warm_up() {
        let layout = modalities::layout();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let model = SelfModel::new(Sizes::of(&layout), layout, &mut rng);
        let mut human = SelfHuman::new(Arc::new(model), None, 0);
        let round = driver(3, 12);
        let whole = score(&mut human, &round);
        // The same, summed from drives that end earlier: each adds its last step's share.
        let mut sum = 0.0;
        let mut before = 0.0;
        for end in WARM_UP + 1..=12 {
            let part = Round {
                visual: round.visual[..end * modalities::VISUAL].to_vec(),
                action: round.action[..end * 2].to_vec(),
                reward: round.reward[..end].to_vec(),
                ..Round::default()
            };
            let total = score(&mut human, &part) * (end - WARM_UP) as f64;
            sum += total - before;
            before = total;
        }
        assert!(whole.is_finite() && (whole - sum / 7.0).abs() < 1e-9);
        let mut early = round.clone();
        early.action[..2].copy_from_slice(&[0.9, -0.9]);
        assert_ne!(
            score(&mut human, &early),
            whole,
            "what was done early is remembered"
        );
    }
}
