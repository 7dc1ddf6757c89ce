//! Foresight: what the self-model imagines, open loop, against what then happens. From the robot's belief at a moment of a round
//! without an assistant, the world model is run on with the actions that the person then took, and what it decodes is compared
//! with what the LIDAR then measured of every car that comes near.

use crate::results::with_interval;
use crate::statistics::{Interval, over_people};
use domains::highway::modalities::range_of;
use domains::highway::{
    AZIMUTHS, Case, Cockpit, End, LIDAR_RANGE_M, Person, Scene, Shown, SimulatedDriver, World,
};
use models::{Filter, Observations, SelfModel, WorldModel};
use nn::{Tensor, noise};
use serde::Serialize;
use std::sync::Arc;
use training::environment::visual_of;

/// Cars count that come within this range within the horizon.
const NEAR_M: f32 = 20.0;
/// Horizons, in control steps of 0.15 s: what is believed now, then 1.2, 2.4 and 3.6 s.
pub const HORIZONS: [usize; 4] = [0, 8, 16, 24];
/// Seconds of a control step.
const STEP_S: f64 = 0.15;
/// Futures imagined from a moment; what is foreseen is their mean.
const FUTURES: usize = 16;
/// Steps from one moment to the next, and before the first.
const EVERY: usize = 4;
/// A car behind rushes if it comes nearer by at least this much within the longest horizon.
const RUSHES_M: f32 = 5.0;

/// What to run.
#[derive(Clone, Copy, Debug)]
pub struct Study {
    /// Persons 1 to this number, in fog.
    pub people: u32,
    /// Seeds; each has the six cases.
    pub seeds: u64,
    /// First seed.
    pub seed: u64,
}

/// One person's rounds.
#[derive(Clone, Debug, Default, Serialize)]
pub struct OfPerson {
    /// Person.
    pub person: u32,
    /// Comparisons at each horizon.
    pub count: [usize; 4],
    /// Mean |foreseen − true| range in metres, at each horizon.
    pub error_m: [f64; 4],
    /// The same of foreseeing that every range stays as it is.
    pub error_of_staying_m: [f64; 4],
    /// Moments at which a car rushes up from behind.
    pub rushers: usize,
    /// Mean foreseen change of its range over the longest horizon; negative: it comes nearer.
    pub rusher_foreseen_m: f64,
    /// Mean true change.
    pub rusher_true_m: f64,
    /// Least and greatest reward imagined.
    pub imagined_reward: [f32; 2],
    /// Least and greatest reward lived.
    pub lived_reward: [f32; 2],
}

/// What the study found, over people.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Everybody.
    pub people: Vec<OfPerson>,
    /// Mean |foreseen − true| range in metres, at each horizon.
    pub error_m: [Interval; 4],
    /// The same of foreseeing that every range stays as it is.
    pub error_of_staying_m: [Interval; 4],
    /// Mean foreseen change of a rusher's range over the longest horizon.
    pub rusher_foreseen_m: Interval,
    /// Mean true change.
    pub rusher_true_m: Interval,
}

impl Report {
    /// Lines for a terminal.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![
            "ranges of cars that come within 20 m, mean absolute error in m, with 95 % intervals over people"
                .to_owned(),
            format!(
                "{:>9}   {:>20}   {:>24}",
                "ahead (s)", "foreseen", "taken to stay as it is"
            ),
        ];
        for (h, steps) in HORIZONS.iter().enumerate() {
            lines.push(format!(
                "{:>9.1}   {:>20}   {:>24}",
                *steps as f64 * STEP_S,
                with_interval(&self.error_m[h], 1.0, 2),
                with_interval(&self.error_of_staying_m[h], 1.0, 2),
            ));
        }
        lines.push(format!(
            "a car that rushes up from behind comes nearer by {} m in {:.1} s; foreseen: by {} m",
            with_interval(&self.rusher_true_m, -1.0, 1),
            HORIZONS[2] as f64 * STEP_S,
            with_interval(&self.rusher_foreseen_m, -1.0, 1),
        ));
        let range = |of: &dyn Fn(&OfPerson) -> [f32; 2]| {
            let all = self.people.iter().map(of);
            all.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], [l, h]| {
                [low.min(l), high.max(h)]
            })
        };
        let [lived, imagined] = [range(&|p| p.lived_reward), range(&|p| p.imagined_reward)];
        lines.push(format!(
            "rewards lived: {:.2} to {:.2}; imagined: {:.2} to {:.2}",
            lived[0], lived[1], imagined[0], imagined[1]
        ));
        lines
    }
}

/// One moment of a round: what was sensed, and what the person then did.
struct Moment {
    visual: Vec<f32>,
    /// Identity and range of the nearest car in each azimuth.
    nearest: [(i32, f32); AZIMUTHS],
    /// Reward of getting here.
    reward: f32,
    action: [f32; 2],
}

/// Runs the study.
///
/// # Errors
/// If a person or the scene cannot be read.
pub fn run(
    study: &Study,
    model: &Arc<SelfModel>,
    progress: &mut dyn FnMut(u32),
) -> anyhow::Result<Report> {
    let mut people = Vec::new();
    for person in 1..=study.people {
        people.push(of_person(study, model, person)?);
        progress(person);
    }
    let over = |value: &dyn Fn(&OfPerson) -> f64| {
        over_people(&people.iter().map(value).collect::<Vec<f64>>())
    };
    Ok(Report {
        error_m: [0, 1, 2, 3].map(|h| over(&|p| p.error_m[h])),
        error_of_staying_m: [0, 1, 2, 3].map(|h| over(&|p| p.error_of_staying_m[h])),
        rusher_foreseen_m: over(&|p| p.rusher_foreseen_m),
        rusher_true_m: over(&|p| p.rusher_true_m),
        people,
    })
}

fn of_person(study: &Study, model: &Arc<SelfModel>, id: u32) -> anyhow::Result<OfPerson> {
    let scene = Arc::new(Scene::builtin("highway-fog")?);
    let person = Person::builtin(id)?;
    let mut world = World::new(Arc::clone(&scene))?;
    let cockpit = Cockpit::new(&scene, world.road(), scene.ego.start_s_m);
    let mut driver = SimulatedDriver::new(&person, &scene.fog(), cockpit);
    let mut imagination = Imagination::new(model);
    let mut found = OfPerson {
        person: id,
        imagined_reward: [f32::INFINITY, f32::NEG_INFINITY],
        lived_reward: [f32::INFINITY, f32::NEG_INFINITY],
        ..OfPerson::default()
    };
    for seed in study.seed..study.seed + study.seeds {
        for case in Case::ALL {
            let round = live(&mut world, &mut driver, seed, case);
            for moment in &round {
                let [least, most] = &mut found.lived_reward;
                (*least, *most) = (least.min(moment.reward), most.max(moment.reward));
            }
            imagination.compare(model, &round, &mut found);
        }
    }
    for h in 0..HORIZONS.len() {
        found.error_m[h] /= found.count[h].max(1) as f64;
        found.error_of_staying_m[h] /= found.count[h].max(1) as f64;
    }
    found.rusher_foreseen_m /= found.rushers.max(1) as f64;
    found.rusher_true_m /= found.rushers.max(1) as f64;
    Ok(found)
}

/// A round without an assistant.
fn live(world: &mut World, driver: &mut SimulatedDriver, seed: u64, case: Case) -> Vec<Moment> {
    world.reset_case(seed, case.number(), case);
    driver.reset(seed, case.number());
    let mut round = Vec::new();
    let mut reward = 0.0;
    loop {
        let observation = world.observation();
        let action = driver.act(observation, &Shown::default());
        let nearest = core::array::from_fn(|azimuth| {
            (observation.object[azimuth], observation.nearest_m(azimuth))
        });
        round.push(Moment {
            visual: visual_of(observation).to_vec(),
            nearest,
            reward,
            action,
        });
        if world.end() != End::Running {
            return round;
        }
        reward = world.step(action).reward;
    }
}

/// The robot's belief, and futures that start from it.
struct Imagination {
    filter: Filter,
    observed: Tensor,
    action: Tensor,
    z: Tensor,
    actions: Tensor,
    noise: Vec<f32>,
    observations: Observations,
    reward: Tensor,
    scratch: models::Scratch,
    unheard: Vec<f32>,
}

impl Imagination {
    fn new(model: &SelfModel) -> Self {
        let (latent, shape) = (model.sizes.latent, model.sizes.shape);
        Self {
            filter: Filter::new(latent, 1),
            observed: Tensor::new(model.view.rows(), 1),
            action: Tensor::new(shape.action, 1),
            z: Tensor::new(latent, FUTURES),
            actions: Tensor::new(shape.action, FUTURES),
            noise: vec![0.0; latent * FUTURES],
            observations: Observations::new(&shape, FUTURES),
            reward: Tensor::new(1, FUTURES),
            scratch: model.scratch(),
            unheard: vec![0.0; shape.verbal],
        }
    }

    /// Follows a round and compares from every so many of its moments.
    fn compare(&mut self, model: &SelfModel, round: &[Moment], found: &mut OfPerson) {
        self.filter.reset();
        self.action.fill(0.0);
        for (t, moment) in round.iter().enumerate() {
            let out = self.observed.column_mut(0);
            model
                .view
                .write(&moment.visual, &self.unheard, model.layout.sensed, out);
            self.filter.update(model, &self.action, &self.observed);
            self.action.column_mut(0).copy_from_slice(&moment.action);
            if t >= 2 * EVERY && t % EVERY == 0 && t + HORIZONS[1] < round.len() {
                self.foresee(model, &round[t..], t as u64, found);
            }
        }
    }

    /// Compares futures with what came, from the first moment of `coming` on.
    fn foresee(&mut self, model: &SelfModel, coming: &[Moment], at: u64, found: &mut OfPerson) {
        let latent = model.sizes.latent;
        noise::fill(&mut self.noise, at, 0);
        for j in 0..FUTURES {
            let noise = &self.noise[j * latent..(j + 1) * latent];
            let (mean, deviation) = (self.filter.mean.column(0), self.filter.deviation.column(0));
            let z = self.z.column_mut(j).iter_mut().zip(noise);
            for ((z, noise), (mean, deviation)) in z.zip(mean.iter().zip(deviation)) {
                *z = mean + deviation * noise;
            }
        }
        // Which cars come near, and where they are now.
        let last = HORIZONS[3].min(coming.len() - 1);
        let nears = |id: i32| {
            let returns = coming[..=last].iter().flat_map(|moment| &moment.nearest);
            returns
                .into_iter()
                .any(|(i, range)| *i == id && *range < NEAR_M)
        };
        let now = &coming[0].nearest;
        for step in 0..=last {
            if step > 0 {
                let taken = &coming[step - 1].action;
                for j in 0..FUTURES {
                    self.actions.column_mut(j).copy_from_slice(taken);
                }
                noise::fill(&mut self.noise, at, step as u64);
                model.advance(&mut self.scratch, &mut self.z, &self.actions, &self.noise);
                model.reward(&mut self.scratch, &self.z, &mut self.reward);
                for reward in self.reward.data() {
                    let [least, most] = &mut found.imagined_reward;
                    (*least, *most) = (least.min(*reward), most.max(*reward));
                }
            }
            let Some(h) = HORIZONS.iter().position(|horizon| *horizon == step) else {
                continue;
            };
            model.visual(&mut self.scratch, &self.z, &mut self.observations.visual);
            let mut seen = Vec::new();
            for (azimuth, (id, range)) in coming[step].nearest.iter().enumerate() {
                let nearest_now = now.iter().filter(|(i, _)| i == id);
                let before = nearest_now.map(|(_, r)| *r).fold(f32::INFINITY, f32::min);
                // A car is as far as its nearest return, and is looked for there.
                let nearest = coming[step].nearest.iter().filter(|(i, _)| i == id);
                let is_nearest = nearest.into_iter().all(|(_, r)| range <= r);
                if *id < 0
                    || !is_nearest
                    || seen.contains(id)
                    || before > LIDAR_RANGE_M
                    || !nears(*id)
                {
                    continue;
                }
                seen.push(*id);
                let foreseen = self.range(azimuth);
                found.count[h] += 1;
                found.error_m[h] += f64::from((foreseen - range).abs());
                found.error_of_staying_m[h] += f64::from((before - range).abs());
                let behind = (AZIMUTHS / 2 - 2..=AZIMUTHS / 2 + 2).contains(&azimuth);
                if h == 2 && behind && before - range > RUSHES_M {
                    found.rushers += 1;
                    found.rusher_foreseen_m += f64::from(foreseen - before);
                    found.rusher_true_m += f64::from(range - before);
                }
            }
        }
    }

    /// Mean over futures of the nearest return within 10° of an azimuth.
    fn range(&self, azimuth: usize) -> f32 {
        let around = [azimuth + AZIMUTHS - 1, azimuth, azimuth + 1];
        let of = |j: usize| {
            let visual = self.observations.visual.column(j);
            let ranges = around.iter().map(|a| range_of(visual, a % AZIMUTHS));
            ranges.fold(LIDAR_RANGE_M, f32::min)
        };
        (0..FUTURES).map(of).sum::<f32>() / FUTURES as f32
    }
}
