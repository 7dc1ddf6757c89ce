//! The suite that every human model has to pass (DESIGN §5), over every kind of human model of every gridworld.

mod support;

use domains::discrete::{
    Discrete, Domain, Layout, Mask, Mind, Scene, Setting, SimulatedPerson, Words, World,
};
use models::discrete::human_file::{load_human, load_policy, save_policy};
use models::discrete::{
    ChooserSizes, DiscreteHuman, DiscreteModel, IdealHuman, Implants, Perceiver, RecurrentChooser,
    RecurrentHuman, Sizes, limits_of,
};
use models::policy::largest;
use models::{Beliefs, Communicated, HumanModel, Kind, Observations, WorldModel};
use nn::Tensor;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use support::allocations;

/// The kinds, by name.
const KINDS: [&str; 6] = ["mirror", "mirror-p", "self", "bc", "sqil", "ideal"];

fn scene(domain: Domain) -> (Scene, Words) {
    let scene = Scene::of(domain, Setting::Transfer);
    let words = Words::indicator(scene.sentences().len());
    (scene, words)
}

fn world(domain: Domain) -> World {
    let (scene, words) = scene(domain);
    World::new(&scene, &words).unwrap()
}

fn layout(domain: Domain) -> Arc<Layout> {
    Arc::new(world(domain).layout().clone())
}

fn self_model(domain: Domain) -> DiscreteModel {
    let layout = layout(domain);
    let mut rng = ChaCha8Rng::seed_from_u64(30);
    DiscreteModel::new(Sizes::of(&layout), layout, &mut rng)
}

/// A model of this kind with random weights, the same each time.
fn human(kind: &'static str, domain: Domain) -> Box<dyn HumanModel> {
    let mut rng = ChaCha8Rng::seed_from_u64(31);
    if kind == "ideal" {
        return Box::new(ideal(domain).1);
    }
    if kind == "bc" || kind == "sqil" {
        let (scene, words) = scene(domain);
        let person = SimulatedPerson::builtin(&scene, 1, &words).unwrap();
        let layout = layout(domain);
        let policy = RecurrentChooser::new(ChooserSizes::of(&layout, 2), &layout, &mut rng);
        return Box::new(RecurrentHuman::new(
            kind,
            Arc::new(policy),
            &layout,
            person.sight(),
        ));
    }
    let model = self_model(domain);
    let implants = (kind != "self").then(|| {
        let mut implants = Implants::new(&model, kind == "mirror", &mut rng);
        // As if learned: limits in the middle, and a residual that does something.
        for id in implants.parameters.ids() {
            for x in implants.parameters.get_mut(id).data_mut() {
                *x += rng.random_range(-0.5..0.5);
            }
        }
        implants
    });
    Box::new(DiscreteHuman::new(Arc::new(model), implants, 0))
}

/// A person and their own model.
fn ideal(domain: Domain) -> (SimulatedPerson, IdealHuman) {
    let (scene, words) = scene(domain);
    let person = SimulatedPerson::builtin(&scene, 1, &words).unwrap();
    let human = IdealHuman::new(person.clone(), layout(domain).actions);
    (person, human)
}

fn every_kind(check: impl Fn(&mut dyn HumanModel, Domain)) {
    for domain in Domain::ALL {
        for kind in KINDS {
            let mut model = human(kind, domain);
            assert_eq!(model.kind(), kind);
            check(&mut *model, domain);
        }
    }
}

struct Step {
    actions: Tensor,
    observations: Observations,
    communicated: Vec<Communicated>,
    noise: Tensor,
    chance: Tensor,
}

impl Step {
    fn noise(&self) -> Vec<f32> {
        [self.noise.data(), self.chance.data()].concat()
    }
}

/// Observations of real rounds at random actions, some items shown or said.
fn steps(
    model: &dyn HumanModel,
    domain: Domain,
    batch: usize,
    count: usize,
    seed: u64,
) -> Vec<Step> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let layout = layout(domain);
    let shape = self_model(domain).shape();
    let latent = model.latent();
    let mut worlds: Vec<World> = (0..batch).map(|_| world(domain)).collect();
    for (j, world) in worlds.iter_mut().enumerate() {
        world.reset(seed, j as u32, rng.random_range(0..9));
    }
    (0..count)
        .map(|_| {
            let mut step = Step {
                actions: Tensor::new(shape.action, batch),
                observations: Observations::new(&shape, batch),
                communicated: vec![Communicated::default(); batch],
                noise: Tensor::new(latent, batch),
                chance: Tensor::new(model.noise_rows() - latent, batch),
            };
            for (j, world) in worlds.iter_mut().enumerate() {
                let action = rng.random_range(0..layout.actions);
                world.step(action);
                step.actions.column_mut(j)[action] = 1.0;
                let Observations { visual, verbal } = &mut step.observations;
                world.observe(visual.column_mut(j), verbal.column_mut(j));
                let all = layout.communicable;
                step.communicated[j] = Mask {
                    visual: all.visual & rng.random::<u32>(),
                    verbal: all.verbal & rng.random::<u32>(),
                }
                .into();
            }
            nn::noise::fill(step.noise.data_mut(), rng.random(), 1);
            nn::noise::fill(step.chance.data_mut(), rng.random(), 1);
            step
        })
        .collect()
}

/// Beliefs and log-probabilities after each step, one long row of numbers a person.
fn follow(model: &mut dyn HumanModel, steps: &[Step]) -> Vec<Vec<f32>> {
    let batch = steps[0].communicated.len();
    let mut beliefs = Beliefs::new(model.latent(), batch);
    let mut distribution = model.distribution(batch);
    let mut rows = vec![Vec::new(); batch];
    for step in steps {
        let noise = step.noise();
        let (actions, observations) = (&step.actions, &step.observations);
        model.perceive(
            &mut beliefs,
            actions,
            observations,
            &step.communicated,
            Some(&noise),
        );
        model.act(&beliefs, &mut distribution);
        for (j, row) in rows.iter_mut().enumerate() {
            let log = distribution.log_probability.column(j);
            let total: f32 = log.iter().map(|x| x.exp()).sum();
            assert!(
                (total - 1.0).abs() < 1e-4,
                "probabilities add up to {total}"
            );
            for tensor in [&beliefs.mean, &beliefs.deviation, &beliefs.z] {
                row.extend_from_slice(tensor.column(j));
            }
            row.extend_from_slice(log);
        }
    }
    rows
}

fn alone(step: &Step, j: usize) -> Step {
    let one = |t: &Tensor| Tensor::from_slice(t.rows(), 1, t.column(j));
    Step {
        actions: one(&step.actions),
        observations: Observations {
            visual: one(&step.observations.visual),
            verbal: one(&step.observations.verbal),
        },
        communicated: vec![step.communicated[j]],
        noise: one(&step.noise),
        chance: one(&step.chance),
    }
}

#[test]
fn a_batch_is_the_same_as_one_by_one() {
    every_kind(|model, domain| {
        let steps = steps(model, domain, 7, 3, 1);
        let together = follow(model, &steps);
        for (j, row) in together.iter().enumerate() {
            let own: Vec<Step> = steps.iter().map(|step| alone(step, j)).collect();
            let own = follow(model, &own);
            for (a, b) in own[0].iter().zip(row) {
                assert!(
                    (a - b).abs() <= 2e-5 * (1.0 + a.abs()),
                    "{} {a} {b}",
                    model.kind()
                );
            }
        }
    });
}

#[test]
fn same_inputs_same_bytes_and_nothing_left_over() {
    every_kind(|model, domain| {
        let steps = steps(model, domain, 5, 4, 2);
        let first = follow(model, &steps);
        let others = self::steps(model, domain, 9, 2, 3);
        follow(model, &others);
        assert_eq!(first, follow(model, &steps));
        let kind = KINDS.iter().find(|kind| **kind == model.kind()).unwrap();
        assert_eq!(first, follow(&mut *human(kind, domain), &steps));
        let different = self::steps(model, domain, 5, 4, 4);
        assert_ne!(first, follow(model, &different));
    });
}

/// What a person of these limits does not see, hear or get told may be anything.
#[test]
fn what_is_masked_cannot_change_a_belief() {
    for domain in Domain::ALL {
        let layout = layout(domain);
        let perceiver = Perceiver::new(&layout);
        let model = Arc::new(self_model(domain));
        for with_policy in [false, true] {
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let mut implants = Implants::new(&model, with_policy, &mut rng);
            // Everything is out of sight.
            implants.set_limits(&vec![0.0; perceiver.limits()]);
            let limits = implants.limits();
            let mut human = DiscreteHuman::new(Arc::clone(&model), Some(implants), 0);
            let original = steps(&human, domain, 4, 4, 6);
            let mut changed = steps(&human, domain, 4, 4, 6);
            let mut hidden = 0;
            for step in &mut changed {
                for j in 0..4 {
                    let visual = step.observations.visual.column(j).to_vec();
                    let chance = (step.chance.rows() > 0).then(|| step.chance.column(j));
                    let seen = perceiver.seen(&limits, &visual, chance)
                        | step.communicated[j].visual_bits();
                    let mask = Mask {
                        visual: seen,
                        verbal: step.communicated[j].verbal_bits(),
                    };
                    for (i, x) in step
                        .observations
                        .visual
                        .column_mut(j)
                        .iter_mut()
                        .enumerate()
                    {
                        if !layout.is_seen(i, mask) {
                            // Driving's distances are themselves read from what is hidden: stay beyond the limit.
                            *x = if domain == Domain::Driving {
                                -*x
                            } else {
                                f32::NAN
                            };
                            hidden += 1;
                        }
                    }
                    for (i, x) in step
                        .observations
                        .verbal
                        .column_mut(j)
                        .iter_mut()
                        .enumerate()
                    {
                        if !mask.hears(layout.verbal_utterance[i].into()) {
                            *x = f32::NAN;
                            hidden += 1;
                        }
                    }
                }
            }
            assert!(hidden > 0);
            assert_eq!(follow(&mut human, &original), follow(&mut human, &changed));
        }
    }
}

#[test]
fn what_is_communicated_changes_a_belief() {
    every_kind(|model, domain| {
        let layout = layout(domain);
        let mut quiet = steps(model, domain, 2, 1, 7);
        quiet[0].communicated.fill(Communicated::default());
        let before = follow(model, &quiet);
        for utterance in 0..layout.utterances {
            let mut spoken = steps(model, domain, 2, 1, 7);
            spoken[0].communicated.fill(Communicated::default());
            spoken[0].communicated[1] = Communicated::new(0, 1 << utterance);
            let after = follow(model, &spoken);
            assert_ne!(before[1], after[1], "{} {utterance}", model.kind());
            assert_eq!(before[0], after[0]);
        }
    });
}

#[test]
fn outputs_are_finite_at_extreme_inputs() {
    every_kind(|model, domain| {
        for value in [0.0, -0.0, 1.0, 1e6, -1e6, 1e-30] {
            let mut extreme = steps(model, domain, 2, 3, 8);
            for step in &mut extreme {
                step.observations.visual.fill(value);
                step.observations.verbal.fill(value);
                step.communicated.fill(Communicated(u32::MAX));
            }
            for row in follow(model, &extreme) {
                assert!(
                    row.iter().all(|x| x.is_finite()),
                    "{} at {value}",
                    model.kind()
                );
            }
        }
    });
}

#[test]
fn a_new_episode_forgets_the_last_and_nothing_allocates_after_the_first() {
    every_kind(|model, domain| {
        let steps = steps(model, domain, 33, 3, 9);
        let noise: Vec<Vec<f32>> = steps.iter().map(Step::noise).collect();
        let mut beliefs = Beliefs::new(model.latent(), 33);
        let mut distribution = model.distribution(33);
        let mut actions = Tensor::new(distribution.shape().0, 33);
        let (mut before, mut first) = (0, None);
        for round in 0..3 {
            if round == 2 {
                before = allocations();
            }
            beliefs.reset();
            for (step, noise) in steps.iter().zip(&noise) {
                let (acted, observations) = (&step.actions, &step.observations);
                let told = &step.communicated;
                model.perceive(&mut beliefs, acted, observations, told, Some(noise));
                model.act(&beliefs, &mut distribution);
                distribution.sample(Some(noise), &mut actions);
            }
            if round < 2 {
                let again = beliefs.mean.clone();
                assert_eq!(first.get_or_insert(again.clone()), &again);
            }
        }
        assert_eq!(allocations() - before, 0, "{}", model.kind());
    });
}

/// What chance does not decide, the ideal model believes as the person does, in every step of their rounds.
#[test]
fn the_ideal_model_follows_the_person() {
    for domain in [Domain::Driving, Domain::SearchRescue] {
        let (mut person, mut model) = ideal(domain);
        let mut world = world(domain);
        let layout = world.layout().clone();
        let shape = self_model(domain).shape();
        let mut observations = Observations::new(&shape, 1);
        let mut beliefs = Beliefs::new(model.latent(), 1);
        let mut noise = Tensor::new(model.noise_rows(), 1);
        let mut rng = ChaCha8Rng::seed_from_u64(12);
        let (mut moments, mut known) = (0, 0);
        for episode in 0..12 {
            world.reset(8, episode, episode);
            person.reset(8, episode);
            beliefs.reset();
            let mut actions = Tensor::new(layout.actions, 1);
            while world.end().is_running() {
                let Observations { visual, verbal } = &mut observations;
                world.observe(visual.column_mut(0), verbal.column_mut(0));
                let all = layout.communicable;
                let told = Mask {
                    visual: all.visual & rng.random::<u32>() & rng.random::<u32>(),
                    verbal: all.verbal & rng.random::<u32>() & rng.random::<u32>(),
                };
                let seen = person.look(visual.column(0));
                person.perceive(visual.column(0), verbal.column(0), seen | told);
                nn::noise::fill(noise.data_mut(), rng.random(), 1);
                let chance = Some(noise.data());
                model.perceive(
                    &mut beliefs,
                    &actions,
                    &observations,
                    &[told.into()],
                    chance,
                );
                let mut memory = vec![0.0; person.memory_len()];
                person.write_memory(&mut memory);
                let mut believed = beliefs.z.column(0)[..memory.len()].to_vec();
                if domain == Domain::SearchRescue {
                    // Where a searcher is heading, and so came from, is in their head.
                    for chance in [2, 3] {
                        (memory[chance], believed[chance]) = (0.0, 0.0);
                    }
                }
                assert_eq!(believed, memory, "{domain:?}, round {episode}");
                known += usize::from(memory.iter().any(|x| *x != 0.0));
                moments += 1;
                let action = person.act();
                actions.fill(0.0);
                actions.column_mut(0)[action] = 1.0;
                world.step(action);
            }
        }
        assert!(moments > 60 && known > 30, "{domain:?}: {moments} {known}");
    }
}

/// Where chance decides what they notice, and where they are heading is in their head, the model guesses; what they then do corrects it:
/// nobody is long held for impossible.
#[test]
fn the_ideal_model_learns_from_what_people_do() {
    for domain in [Domain::SearchRescue, Domain::BombDefusal] {
        let (mut person, mut model) = ideal(domain);
        let mut world = world(domain);
        let layout = world.layout().clone();
        let mut observations = Observations::new(&self_model(domain).shape(), 1);
        let mut beliefs = Beliefs::new(model.latent(), 1);
        let mut expected = model.distribution(1);
        let mut noise = Tensor::new(model.noise_rows(), 1);
        let (mut moments, mut longest) = (0, 0);
        for episode in 0..30 {
            world.reset(4, episode, episode);
            person.reset(4, episode);
            beliefs.reset();
            let mut in_a_row = 0;
            let mut actions = Tensor::new(layout.actions, 1);
            while world.end().is_running() {
                let Observations { visual, verbal } = &mut observations;
                world.observe(visual.column_mut(0), verbal.column_mut(0));
                let seen = person.look(visual.column(0));
                person.perceive(visual.column(0), verbal.column(0), seen);
                nn::noise::fill(noise.data_mut(), u64::from(episode), moments);
                let nothing = [Communicated::default()];
                let chance = Some(noise.data());
                model.perceive(&mut beliefs, &actions, &observations, &nothing, chance);
                model.act(&beliefs, &mut expected);
                let action = person.act();
                let surprised = expected.log_probability.column(0)[action] < -10.0;
                in_a_row = if surprised { in_a_row + 1 } else { 0 };
                longest = longest.max(in_a_row);
                moments += 1;
                actions.fill(0.0);
                actions.column_mut(0)[action] = 1.0;
                world.step(action);
            }
        }
        // A defuser may be taken to have noticed at one step, and again at the next.
        assert!(
            moments > 100 && longest <= 4,
            "{domain:?}: {longest} of {moments}"
        );
    }
}

/// What the person neither sees nor is told may be anything to their own model, too.
#[test]
fn the_ideal_model_reads_no_more_than_the_person() {
    for domain in [Domain::Driving, Domain::SearchRescue] {
        let (person, mut model) = ideal(domain);
        let layout = layout(domain);
        let (perceiver, limits) = (
            Perceiver::new(&layout),
            limits_of(&person.sight().perception),
        );
        let original = steps(&model, domain, 4, 5, 6);
        let mut changed = steps(&model, domain, 4, 5, 6);
        let mut hidden = 0;
        for step in &mut changed {
            for j in 0..4 {
                let told = Mask::from(step.communicated[j]);
                let visual = step.observations.visual.column_mut(j);
                let seen = told.visual | perceiver.seen(&limits, visual, None);
                let mask = Mask {
                    visual: seen,
                    ..told
                };
                for (i, x) in visual.iter_mut().enumerate() {
                    if !layout.is_seen(i, mask) {
                        // Driving's distances are themselves read from what is hidden: stay beyond the limit.
                        *x = if domain == Domain::Driving {
                            x.signum()
                        } else {
                            f32::NAN
                        };
                        hidden += 1;
                    }
                }
                let verbal = step.observations.verbal.column_mut(j).iter_mut();
                for (x, utterance) in verbal.zip(&layout.verbal_utterance) {
                    if !mask.hears((*utterance).into()) {
                        *x = f32::NAN;
                        hidden += 1;
                    }
                }
            }
        }
        assert!(hidden > 100);
        assert_eq!(follow(&mut model, &original), follow(&mut model, &changed));
    }
}

/// The limits mean to our models what they mean to the domain's people.
#[test]
fn perception_is_the_domains_own() {
    use domains::{driving, search_rescue};
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    for domain in [Domain::Driving, Domain::SearchRescue] {
        let mut world = world(domain);
        let layout = world.layout().clone();
        let perceiver = Perceiver::new(&layout);
        let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
        for episode in 0..60 {
            world.reset(3, episode, episode);
            for _ in 0..6 {
                world.observe(&mut visual, &mut verbal);
                let limits: Vec<f32> = (0..perceiver.limits())
                    .map(|_| rng.random_range(0..10) as f32 + 0.25)
                    .collect();
                let theirs = match domain {
                    Domain::Driving => {
                        driving::visible(&[limits[0], limits[1], limits[2], limits[3]], &visual)
                    }
                    _ => search_rescue::visible(limits[0], &visual),
                };
                assert_eq!(
                    perceiver.seen(&limits, &visual, None),
                    theirs,
                    "{domain:?} {limits:?}"
                );
                world.step(rng.random_range(0..layout.actions));
            }
        }
    }
}

/// With limits as probabilities, a terminal is noticed that often.
#[test]
fn chances_are_probabilities() {
    let layout = layout(Domain::BombDefusal);
    let perceiver = Perceiver::new(&layout);
    let visual = vec![0.0; layout.visual];
    let limits = [0.05, 0.2, 0.5, 0.8, 0.95, 0.0];
    let mut noise = vec![0.0; perceiver.noise_rows()];
    let mut counts = [0_u32; 6];
    for draw in 0..20_000 {
        nn::noise::fill(&mut noise, 11, draw);
        let seen = perceiver.seen(&limits, &visual, Some(&noise));
        for (terminal, count) in counts.iter_mut().enumerate() {
            *count += seen >> terminal & 1;
        }
    }
    for (count, p) in counts.iter().zip(limits) {
        let found = f64::from(*count) / 20_000.0;
        assert!((found - f64::from(p)).abs() < 0.015, "{found} for {p}");
    }
}

#[test]
fn choices_are_drawn_with_their_probabilities() {
    let mut distribution = models::policy::ActionDistribution::categorical(4, 20_000);
    let p = [0.1_f32, 0.6, 0.05, 0.25];
    for column in distribution.log_probability.data_mut().chunks_exact_mut(4) {
        for (log, p) in column.iter_mut().zip(p) {
            *log = p.ln();
        }
    }
    let mut noise = vec![0.0; 80_000];
    nn::noise::fill(&mut noise, 12, 0);
    let mut actions = Tensor::default();
    distribution.sample(Some(&noise), &mut actions);
    for (choice, p) in p.iter().enumerate() {
        let drawn = (0..20_000)
            .filter(|j| actions.column(*j)[choice] == 1.0)
            .count();
        let found = drawn as f32 / 20_000.0;
        assert!((found - p).abs() < 0.015, "{found} for {p}");
    }
    distribution.sample(None, &mut actions);
    assert_eq!(largest(actions.column(0)), 1);
}

#[test]
fn files_give_back_what_was_saved_and_refuse_the_rest() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    for domain in Domain::ALL {
        let model = self_model(domain);
        model.save(&path, "test").unwrap();
        let read = DiscreteModel::load(&path, layout(domain)).unwrap();
        assert_eq!(read.parameters, model.parameters);
        for other in Domain::ALL.into_iter().filter(|other| *other != domain) {
            let error = DiscreteModel::load(&path, layout(other)).unwrap_err();
            assert!(error.to_string().contains("model.safetensors"), "{error}");
        }
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let implants = Implants::new(&model, true, &mut rng);
        let own = folder.path().join("implants.safetensors");
        implants.save(&own, &model, 1, "test").unwrap();
        let (read, heard) = Implants::load(&own, &model).unwrap();
        assert_eq!(read.parameters, implants.parameters);
        assert_eq!(heard, 1);
        let stranger = DiscreteModel::new(model.sizes, layout(domain), &mut rng);
        assert!(Implants::load(&own, &stranger).is_err());
    }
    assert!(models::checkpoint::load_self_model(&path).is_err());
}

/// What was learned of a person comes back as the model that it was, and nothing else does.
#[test]
fn learned_people_are_read_as_what_they_are() {
    let folder = tempfile::tempdir().unwrap();
    for domain in Domain::ALL {
        let (scene, words) = scene(domain);
        let person = SimulatedPerson::builtin(&scene, 1, &words).unwrap();
        let model = Arc::new(self_model(domain));
        let layout = layout(domain);
        let path = |kind: &str| folder.path().join(format!("{kind}.safetensors"));
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for (kind, with_policy) in [("mirror", true), ("mirror-p", false)] {
            let implants = Implants::new(&model, with_policy, &mut rng);
            implants.save(&path(kind), &model, 0, "test").unwrap();
        }
        let mut policies = Vec::new();
        for (kind, layers) in [(Kind::Bc, 2), (Kind::Sqil, 3)] {
            let sizes = ChooserSizes::of(&layout, layers);
            let policy = RecurrentChooser::new(sizes, &layout, &mut rng);
            let (at, sight) = (path(kind.name()), person.sight());
            save_policy(
                &at,
                kind,
                &policy,
                sight,
                "test",
                &[("mirror.note", "x".into())],
            )
            .unwrap();
            let (read, seen) = load_policy(&at, kind, &layout).unwrap();
            assert_eq!(read.parameters, policy.parameters);
            assert_eq!((&seen, read.sizes), (sight, sizes));
            policies.push((kind, policy));
        }
        for kind in Kind::ALL {
            let file = path(kind.name());
            let file = kind.learns().then_some(file.as_path());
            match load_human(file, kind, &model) {
                Ok(human) => assert_eq!(human.kind(), kind.name()),
                // Made of the person, not of a file.
                Err(error) => assert_eq!(kind, Kind::Ideal, "{error}"),
            }
            let others = Kind::ALL.into_iter().filter(|other| *other != kind);
            for other in others.filter(|other| file.is_some() || other.learns()) {
                let error = match load_human(file, other, &model) {
                    Err(error) => error.to_string(),
                    Ok(_) => panic!("{file:?} was read as {other:?}"),
                };
                let named = file.map_or(other.name(), |f| f.file_name().unwrap().to_str().unwrap());
                assert!(error.contains(named), "{error}");
            }
        }
        // The same person as before: policy and sight, step by step.
        let (kind, policy) = policies.swap_remove(0);
        let mut made = RecurrentHuman::new("bc", Arc::new(policy), &layout, person.sight());
        let mut read = load_human(Some(&path("bc")), kind, &model).unwrap();
        let steps = steps(&made, domain, 2, 4, 3);
        assert_eq!(follow(&mut made, &steps), follow(&mut *read, &steps));
        // Damaged files name themselves and the place.
        let whole = std::fs::read(path("bc")).unwrap();
        std::fs::write(path("cut"), &whole[..whole.len() - 40]).unwrap();
        let error = load_policy(&path("cut"), Kind::Bc, &layout).unwrap_err();
        assert!(error.to_string().contains("cut.safetensors"), "{error}");
        let limits = |numbers: &[f32]| {
            let sizes = ChooserSizes::of(&layout, 1);
            let policy = RecurrentChooser::new(sizes, &layout, &mut ChaCha8Rng::seed_from_u64(8));
            let metadata = nn::checkpoint::load(&path("bc"))
                .unwrap()
                .metadata()
                .clone();
            let metadata = metadata
                .into_iter()
                .map(|(k, v)| match k.as_str() {
                    "mirror.sizes" => (k, serde_json::to_string(&sizes).unwrap()),
                    _ => (k, v),
                })
                .collect();
            let extras = [("limits", nn::checkpoint::Extra::F32(numbers))];
            nn::checkpoint::save(
                &path("limits"),
                &[("", &policy.parameters)],
                &extras,
                &metadata,
            )
            .unwrap();
            load_policy(&path("limits"), Kind::Bc, &layout)
        };
        let many = vec![0.5; Perceiver::new(&layout).limits()];
        assert!(limits(&many).is_ok());
        for wrong in [
            &many[1..],
            &[-1.0; 6][..many.len()],
            &[f32::NAN; 6][..many.len()],
        ] {
            let error = limits(wrong).unwrap_err().to_string();
            let names = ["limits.safetensors", "\"limits\""];
            assert!(names.iter().all(|name| error.contains(name)), "{error}");
        }
        for other in Domain::ALL.into_iter().filter(|other| *other != domain) {
            let other = Arc::new(self_model(other));
            for kind in [Kind::Bc, Kind::Mirror] {
                let error = load_human(Some(&path(kind.name())), kind, &other)
                    .err()
                    .unwrap();
                assert!(error.to_string().contains(domain.name()), "{error}");
            }
        }
    }
}
