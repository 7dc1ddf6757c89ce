//! Trains a gridworld's self-model from nothing and says how well it acts and foresees: `cargo run --release -p training --example
//! gridworld -- driving|search_rescue|bomb_defusal OUT [SETTING=VALUE…]`, or `-- DOMAIN MODEL measure` for a model that exists.
//! Metrics are JSON lines on standard output.

use domains::Mask;
use domains::bomb_defusal::{LIVE, TERMINALS, read_terminal};
use domains::discrete::{Discrete, Domain, Scene, Setting, World};
use models::WorldModel;
use models::policy::largest;
use models::{Filter, Scratch, SelfModel};
use nn::{Tensor, noise};
use std::sync::Arc;
use training::config::Checked;
use training::environment::Gridworld;
use training::replay::Episode;
use training::rollout::{Actor, Rollout};
use training::self_model::{SelfModelSettings, Trainer};

const USAGE: &str =
    "usage: gridworld driving|search_rescue|bomb_defusal OUT [SETTING=VALUE…|measure]";
/// Seed of the rounds that measure: none that training lives.
const MEASURED: u64 = 999;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let domain = arguments.first().and_then(|name| Domain::from_name(name));
    let domain = domain.ok_or(USAGE)?;
    let out = arguments.get(1).ok_or(USAGE)?;
    let scene = Scene::of(domain, Setting::Original);
    let words = models::words::shipped(domain)?;
    let world = World::new(&scene, &words)?;
    if arguments.get(2).is_some_and(|word| word == "measure") {
        let layout = Arc::new(world.layout().clone());
        let model = SelfModel::load(out.as_ref(), layout)?;
        measure(&model, &world);
        return Ok(());
    }
    let settings = settings(domain, &arguments[2..])?;
    let mut trainer = Trainer::new(Box::new(Gridworld::from(world.clone())), settings);
    println!("{}", serde_json::to_string(&trainer.settings)?);
    let start = std::time::Instant::now();
    let every = (trainer.settings.phases / 20).max(1);
    while !trainer.is_done() {
        let metrics = trainer.phase();
        if trainer.phase.is_multiple_of(every) || trainer.is_done() {
            let seconds = start.elapsed().as_secs_f32();
            println!("{} {seconds:.1} s", serde_json::to_string(&metrics)?);
            let rounds = 4 * world.scenarios();
            let rewards = rewards(&trainer.model, &world, Actor::Mode, rounds);
            println!("  greedy {:.3}: {rewards:.2?}", mean(&rewards));
        }
    }
    measure(&trainer.model, &world);
    trainer.model.save(out.as_ref(), "example gridworld")?;
    Ok(())
}

/// A domain's settings with some of them replaced.
fn settings(
    domain: Domain,
    given: &[String],
) -> Result<SelfModelSettings, Box<dyn std::error::Error>> {
    let mut settings = serde_json::to_value(SelfModelSettings::of(domain.name()))?;
    for word in given {
        let (name, value) = word.split_once('=').ok_or(USAGE)?;
        let place = match name.strip_prefix("dqn.") {
            Some(name) => &mut settings["dqn"][name],
            None => &mut settings[name],
        };
        *place = serde_json::from_str(value)?;
    }
    let settings: SelfModelSettings = serde_json::from_value(settings)?;
    settings.problem().map_or(Ok(settings), |p| Err(p.into()))
}

fn mean(x: &[f32]) -> f32 {
    x.iter().sum::<f32>() / x.len().max(1) as f32
}

/// Mean reward of each scenario's rounds.
fn rewards(model: &SelfModel, world: &World, actor: Actor, rounds: u32) -> Vec<f32> {
    let mut rollout = Rollout::new(Box::new(Gridworld::from(world.clone())), model);
    let scenarios = world.scenarios();
    let mut sums = vec![0.0; scenarios as usize];
    for round in 0..rounds {
        let (lived, _) = rollout.episode(model, actor, MEASURED, round);
        sums[(round % scenarios) as usize] += lived.reward;
    }
    for sum in &mut sums {
        *sum /= (rounds / scenarios) as f32;
    }
    sums
}

/// As [`rewards`], greedy with full sight of everything visual by somebody who hears nothing.
fn deaf_rewards(model: &SelfModel, world: &World, rounds: u32) -> Vec<f32> {
    let (mut world, layout) = (world.clone(), &model.layout);
    let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
    let mut observed = Tensor::new(model.view.rows(), 1);
    let mut action = Tensor::new(layout.actions.rows(), 1);
    let mut filter = Filter::new(model.sizes.latent, 1);
    let (mut scratch, mut q) = (Scratch::default(), Tensor::default());
    let mask = Mask {
        visual: layout.everything().visual,
        verbal: 0,
    };
    let scenarios = world.scenarios();
    let mut sums = vec![0.0; scenarios as usize];
    for round in 0..rounds {
        world.reset(MEASURED, round, round);
        filter.reset();
        while world.end().is_running() {
            world.observe(&mut visual, &mut verbal);
            let column = observed.column_mut(0);
            model.view.write(&visual, &verbal, mask, column);
            filter.update(model, &action, &observed);
            model.q_values(&mut scratch, &filter.mean, &mut q);
            let choice = largest(q.column(0));
            action.fill(0.0);
            action.column_mut(0)[choice] = 1.0;
            sums[(round % scenarios) as usize] += world.step(choice).reward;
        }
    }
    for sum in &mut sums {
        *sum /= (rounds / scenarios) as f32;
    }
    sums
}

/// What is live in a decoded image of bomb defusal: how many terminals, and whether the true one is among them.
fn live(image: &[f32], truth: &[f32]) -> (usize, bool) {
    let live = |x: &[f32], terminal| read_terminal(x, terminal) == LIVE;
    let count = (0..TERMINALS).filter(|t| live(image, *t)).count();
    let found = (0..TERMINALS).any(|t| live(image, t) && live(truth, t));
    (count, found)
}

fn measure(model: &SelfModel, world: &World) {
    let greedy = |explore, limited| Actor::Policy { explore, limited };
    for (name, actor) in [
        ("expert", Actor::Expert { slips: 0.0 }),
        ("greedy", greedy(0.0, false)),
        ("limited", greedy(0.0, true)),
        ("random", greedy(1.0, false)),
    ] {
        let rewards = rewards(model, world, actor, 40 * world.scenarios());
        println!("{name}: {:.3} a round; {rewards:.2?}", mean(&rewards));
    }
    let deaf = deaf_rewards(model, world, 40 * world.scenarios());
    println!("deaf: {:.3} a round; {deaf:.2?}", mean(&deaf));
    for (name, actor) in [
        ("expert's", Actor::Expert { slips: 0.0 }),
        ("own", greedy(0.0, false)),
    ] {
        let mut rollout = Rollout::new(Box::new(Gridworld::from(world.clone())), model);
        let mut measured = Measured::default();
        for round in 0..8 * world.scenarios() {
            let (_, episode) = rollout.episode(model, actor, MEASURED, round);
            measured.add(model, episode);
        }
        measured.print(name);
    }
}

/// What a model thinks along rounds that it sees whole.
#[derive(Default)]
struct Measured {
    steps: usize,
    agreed: usize,
    least_margins: Vec<f32>,
    value_error: f32,
    /// By steps ahead (0, 1, 4, 8): squared errors of image, other visual numbers, words, reward, and how many.
    ahead: [([f32; 4], usize); 4],
    /// In bomb defusal: decoded images that show a single live terminal, the right one, at 0 and at 1 step ahead.
    live: [[usize; 2]; 2],
}

const AHEAD: [usize; 4] = [0, 1, 4, 8];

impl Measured {
    fn add(&mut self, model: &SelfModel, episode: &Episode) {
        let shape = model.sizes.shape;
        let mut scratch = Scratch::default();
        let mut filter = Filter::new(model.sizes.latent, 1);
        let (mut observed, mut action) = (
            Tensor::new(model.view.rows(), 1),
            Tensor::new(shape.action, 1),
        );
        let (mut q, mut out) = (Tensor::default(), Tensor::default());
        let mut noise = vec![0.0; model.sizes.latent];
        let part = |x: &[f32], t: usize, width: usize| x[t * width..(t + 1) * width].to_vec();
        for t in 0..episode.len() - 1 {
            let visual = part(&episode.visual, t, shape.visual);
            let verbal = part(&episode.verbal, t, shape.verbal);
            action.column_mut(0).copy_from_slice(episode.action(t));
            let everything = model.layout.everything();
            let column = observed.column_mut(0);
            model.view.write(&visual, &verbal, everything, column);
            filter.update(model, &action, &observed);
            model.q_values(&mut scratch, &filter.mean, &mut q);
            let expert = largest(episode.expert(t));
            let values = q.column(0);
            let other = (0..values.len()).filter(|a| *a != expert);
            let rival = other.map(|a| values[a]).fold(f32::NEG_INFINITY, f32::max);
            self.steps += 1;
            self.agreed += usize::from(largest(values) == expert);
            self.least_margins.push(values[expert] - rival);
            let taken = largest(episode.action(t + 1));
            let future = episode.reward[t + 1..].iter().rev();
            let gained = future.fold(0.0, |sum, r| r + 0.95 * sum);
            self.value_error += (values[taken] - gained).powi(2);
            let mut z = filter.mean.clone();
            for step in 0..=AHEAD[3].min(episode.len() - 1 - t) {
                if step > 0 {
                    let done = episode.action(t + step);
                    action.column_mut(0).copy_from_slice(done);
                    // In samples, as plans imagine, and not their mean.
                    noise::fill(&mut noise, (self.steps * 16 + step) as u64, 0);
                    model.advance(&mut scratch, &mut z, &action, &noise);
                }
                let Some(i) = AHEAD.iter().position(|n| *n == step) else {
                    continue;
                };
                let ([image, numbers, words, reward], count) = &mut self.ahead[i];
                let squared = |a: &[f32], b: &[f32]| -> f32 {
                    let n = a.len().max(1) as f32;
                    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / n
                };
                let pixels = model.sizes.image_numbers();
                let truth = part(&episode.visual, t + step, shape.visual);
                model.visual(&mut scratch, &z, &mut out);
                if model.layout.domain == Domain::BombDefusal.name() && i < 2 {
                    let (count, found) = live(&out.column(0)[..pixels], &truth[..pixels]);
                    self.live[i][0] += usize::from(count == 1);
                    self.live[i][1] += usize::from(found);
                }
                *image += squared(&out.column(0)[..pixels], &truth[..pixels]);
                *numbers += squared(&out.column(0)[pixels..], &truth[pixels..]);
                let truth = part(&episode.verbal, t + step, shape.verbal);
                model.verbal(&mut scratch, &z, &mut out);
                *words += squared(out.column(0), &truth);
                model.reward(&mut scratch, &z, &mut out);
                *reward += (out.data()[0] - episode.reward[t + step]).powi(2);
                *count += 1;
            }
        }
    }

    fn print(&mut self, name: &str) {
        self.least_margins.sort_by(f32::total_cmp);
        let n = self.steps.max(1);
        let at = |share: f32| self.least_margins[((share * n as f32) as usize).min(n - 1)];
        println!(
            "{name} rounds: agrees with the expert in {:.3} of {n} steps; its action valued above the others by {:.2} {:.2} {:.2} \
             (5, 20, 50 %); values off by {:.2}",
            self.agreed as f32 / n as f32,
            at(0.05),
            at(0.2),
            at(0.5),
            (self.value_error / n as f32).sqrt(),
        );
        for (steps, (errors, count)) in AHEAD.iter().zip(&self.ahead) {
            let root = errors.map(|e| (e / (*count).max(1) as f32).sqrt());
            println!("  {steps} ahead: image, numbers, words, reward off by {root:.3?}");
        }
        if self.live[0][0] > 0 {
            println!(
                "  one terminal live, the right one, now and a step ahead: {:?}",
                self.live
            );
        }
    }
}
