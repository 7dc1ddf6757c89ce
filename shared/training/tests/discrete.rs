//! The gridworlds' learning: stopping and resuming gives the same bytes as not stopping, implants move nothing else, the
//! loss of shared rounds has the gradient of its slope, policies learn more than chance, and files give back what was saved.

use domains::discrete::{Discrete, Domain, Mind, Scene, Setting, SimulatedPerson, Words, World};
use models::{Implants, RecurrentSizes, SelfModel, Sizes};
use nn::Parameters;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use training::cloning::{self, CloningSettings};
use training::environment::{Environment, Gridworld};
use training::implants_discrete as implants;
use training::rounds::Rounds;
use training::self_model::{SelfModelSettings, Trainer};
use training::sqil::{self, Place, SqilSettings};
use training::trajectory::Trajectory;

fn scene(domain: Domain, setting: Setting) -> (Scene, Words) {
    let scene = Scene::of(domain, setting);
    let words = models::words::shipped(domain).unwrap();
    (scene, words)
}

fn world(domain: Domain, setting: Setting) -> World {
    let (scene, words) = scene(domain, setting);
    World::new(&scene, &words).unwrap()
}

fn rounds(domain: Domain, setting: Setting, count: u32) -> (Rounds, SimulatedPerson) {
    let (scene, words) = scene(domain, setting);
    let mut world = World::new(&scene, &words).unwrap();
    let mut person = SimulatedPerson::builtin(&scene, 1, &words).unwrap();
    let rounds = Rounds::record(&mut world, &mut person, 3, 100, count);
    (rounds, person)
}

fn trainer(domain: Domain) -> Trainer {
    let settings = SelfModelSettings {
        seed: 5,
        phases: 4,
        rounds: 3,
        gradient_steps: 2,
        sequences: 4,
        length: 5,
        // Expert's and policy's rounds, both sights, and every phase's weights are to be in it.
        expert: 0.3,
        ..SelfModelSettings::of(domain.name())
    };
    Trainer::new(environment(domain), settings)
}

fn environment(domain: Domain) -> Box<dyn Environment> {
    Box::new(Gridworld::from(world(domain, Setting::Original)))
}

fn bits(parameters: &Parameters) -> Vec<u32> {
    let tensors = parameters.iter().map(|(_, _, tensor)| tensor);
    tensors
        .flat_map(|tensor| tensor.data().iter().map(|x| x.to_bits()))
        .collect()
}

#[test]
fn the_same_seed_gives_the_same_bytes_stopped_or_not() {
    for domain in Domain::ALL {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.safetensors");
        let mut whole = trainer(domain);
        let start = bits(&whole.model.parameters);
        for _ in 0..4 {
            whole.phase();
        }
        assert!(whole.is_done());
        let mut again = trainer(domain);
        while !again.is_done() {
            again.phase();
        }
        assert_eq!(bits(&again.model.parameters), bits(&whole.model.parameters));
        let mut first = trainer(domain);
        first.phase();
        first.phase();
        first.save(&path, "test").unwrap();
        drop(first);
        let mut second = Trainer::resume(&path, environment(domain)).unwrap();
        assert_eq!(second.phase, 2);
        second.phase();
        second.phase();
        assert_ne!(bits(&whole.model.parameters), start);
        assert_eq!(
            bits(&whole.model.parameters),
            bits(&second.model.parameters)
        );
        let other = folder.path().join("whole.safetensors");
        whole.save(&other, "test").unwrap();
        second.save(&path, "test").unwrap();
        assert_eq!(
            std::fs::read(&other).unwrap(),
            std::fs::read(&path).unwrap()
        );
        // What was cut short is an error that names the file.
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 7]).unwrap();
        let error = Trainer::resume(&path, environment(domain)).err().unwrap();
        assert!(error.to_string().contains("run.safetensors"), "{error}");
        // A round in which something impossible was done: learning from it would look for that action's place.
        second.save(&path, "test").unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        let checkpoint = nn::checkpoint::load(&path).unwrap();
        let replay = checkpoint.u8s("replay").unwrap();
        let start = bytes.windows(replay.len()).position(|part| part == replay);
        // After the round's length, its end and its rewards: the first observation's missing action.
        let start = start.unwrap();
        let length = u32::from_le_bytes(bytes[start..start + 4].try_into().unwrap()) as usize;
        let at = start + 5 + 4 * length;
        bytes[at..at + 4].copy_from_slice(&1.0_f32.to_le_bytes());
        std::fs::write(&path, &bytes).unwrap();
        let error = Trainer::resume(&path, environment(domain)).err().unwrap();
        assert!(
            error
                .to_string()
                .contains("run.safetensors: tensor \"replay\""),
            "{error}"
        );
    }
}

#[test]
fn learning_implants_moves_nothing_else() {
    for domain in Domain::ALL {
        let model = trainer(domain).model;
        let before = bits(&model.parameters);
        let (rounds, _) = rounds(domain, Setting::Transfer, 4);
        for with_policy in [true, false] {
            let settings = implants::Settings {
                iterations: 5,
                ..implants::Settings::default()
            };
            let learned =
                implants::learn(&model, with_policy, &rounds, &settings, &mut |_, _| {}).unwrap();
            assert!(
                learned.frozen_moved.is_empty(),
                "{:?}",
                learned.frozen_moved
            );
            assert_eq!(bits(&model.parameters), before);
            let fresh = Implants::new(
                &model,
                with_policy,
                &mut <rand_chacha::ChaCha8Rng as rand::SeedableRng>::seed_from_u64(0),
            );
            assert_ne!(bits(&learned.implants.parameters), bits(&fresh.parameters));
            // The same again, byte for byte.
            let again =
                implants::learn(&model, with_policy, &rounds, &settings, &mut |_, _| {}).unwrap();
            assert_eq!(
                bits(&learned.implants.parameters),
                bits(&again.implants.parameters)
            );
        }
    }
}

#[test]
fn rounds_survive_the_trip_and_damage_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rounds.safetensors");
    for domain in Domain::ALL {
        let (mut rounds, _) = rounds(domain, Setting::Transfer, 3);
        rounds.source = "test".to_owned();
        assert!(rounds.steps() > 3);
        rounds.save(&path).unwrap();
        let layout = world(domain, Setting::Transfer).layout().clone();
        assert_eq!(Rounds::load(&path, &layout).unwrap(), rounds);
        for other in Domain::ALL.into_iter().filter(|other| *other != domain) {
            let layout = world(other, Setting::Transfer).layout().clone();
            let error = Rounds::load(&path, &layout).unwrap_err();
            assert!(error.to_string().contains(domain.name()), "{error}");
        }
        let bytes = std::fs::read(&path).unwrap();
        for cut in [1, 10, 100] {
            std::fs::write(&path, &bytes[..bytes.len() - cut]).unwrap();
            assert!(Rounds::load(&path, &layout).is_err());
        }
    }
}

/// Cloning and soft-Q imitation fit a person better than chance does, on rounds that they did not learn from.
#[test]
fn policies_learned_from_rounds_know_more_than_chance() {
    let domain = Domain::Driving;
    let (learned_from, person) = rounds(domain, Setting::Original, 24);
    let held = {
        let (scene, words) = scene(domain, Setting::Original);
        let mut world = World::new(&scene, &words).unwrap();
        let mut person = SimulatedPerson::builtin(&scene, 1, &words).unwrap();
        Rounds::record(&mut world, &mut person, 4, 500, 12)
    };
    let world = world(domain, Setting::Original);
    let layout = world.layout().clone();
    let sizes = RecurrentSizes::of(&layout, 1);
    let perceived = |rounds: &Rounds| -> Vec<Trajectory> {
        let view = models::View::new(&layout);
        let rounds = rounds.rounds.iter();
        rounds
            .map(|r| Trajectory::new(r, &view, layout.actions))
            .collect()
    };
    let (learned_from, held) = (perceived(&learned_from), perceived(&held));
    let clone = || {
        let settings = CloningSettings::of(domain.name());
        let quiet = |_, _, _: f32| {};
        cloning::learn(&layout, sizes, &learned_from, &held, &settings, &quiet).unwrap()
    };
    let cloned = clone();
    let chance = 2.0_f32.ln();
    let best = cloned.best.validation;
    assert!(best < 0.85 * chance, "{best}");
    assert_eq!(cloned.trials.len(), 3);
    let trials = cloned.trials.iter().map(|trial| trial.validation);
    assert_eq!(trials.fold(f32::INFINITY, f32::min), best);
    let settings = SqilSettings {
        phases: 8,
        ..SqilSettings::of(domain.name())
    };
    let sight = person.sight();
    let mut place = Place {
        environment: Box::new(Gridworld::from(world)),
        limits: sight.limits.to_vec(),
        heard: sight.heard,
        words: false,
    };
    let places = std::slice::from_mut(&mut place);
    let imitated = sqil::learn(places, sizes, &learned_from, &held, &settings, &|_, _| {});
    let validation = imitated.progress.validation.unwrap();
    assert!(validation < chance, "{validation}");
    // It depends on nothing but its arguments.
    let again = clone();
    assert_eq!(
        bits(&again.policy.parameters),
        bits(&cloned.policy.parameters)
    );
}

#[test]
fn nothing_is_learned_from_nothing() {
    let model: SelfModel = trainer(Domain::Driving).model;
    let empty = Rounds::new(&model.layout, Setting::Original, 0);
    let learned = implants::learn(
        &model,
        true,
        &empty,
        &implants::Settings::default(),
        &mut |_, _| {},
    );
    assert_eq!(learned.err(), Some(implants::NothingToLearn));
}

/// The importance-weighted loss's gradient is its slope, though its weights are written as constants; and with one person a round
/// it is the plain mean of log-likelihoods.
#[test]
fn the_gradient_of_a_shared_round_is_its_slope() {
    let domain = Domain::BombDefusal;
    let (lived, _) = rounds(domain, Setting::Transfer, 3);
    let layout = Arc::new(world(domain, Setting::Transfer).layout().clone());
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let model = SelfModel::new(Sizes::of(&layout), layout, &mut rng);
    let mut own = Implants::new(&model, true, &mut rng);
    let ids: Vec<_> = own.parameters.ids().collect();
    for (i, id) in ids.into_iter().enumerate() {
        let weights = own.parameters.get_mut(id).data_mut();
        nn::noise::fill(weights, 5, i as u64);
        weights.iter_mut().for_each(|w| *w *= 0.3);
    }
    let mut parameters = model.parameters.clone();
    let attached = own.attach(&mut parameters);
    let losses = [1, 4].map(|sharing| {
        let settings = implants::Settings {
            sharing,
            least_columns: 3,
            ..implants::Settings::default()
        };
        let mut shards = implants::follow(&model, &lived, &settings);
        let shard = &mut shards[0];
        nn::noise::fill(shard.noise.data_mut(), 7, 0);
        nn::noise::fill(shard.chance.data_mut(), 7, 1);
        let mut arena = nn::Arena::new();
        let mut gradients = nn::Gradients::for_params(&parameters);
        let mut loss = |parameters: &Parameters, gradients: Option<&mut nn::Gradients>| {
            let mut tape = nn::Tape::new(parameters, &mut arena);
            let loss =
                implants::negative_log_posterior(&mut tape, &model, &attached, shard, &settings);
            let plain = {
                let nll = implants::negative_log_likelihood(&mut tape, &model, &attached, shard);
                tape.scalar(nll)
            };
            if let Some(gradients) = gradients {
                tape.backward(loss, gradients, &|id| attached.ids().contains(&id));
            }
            (tape.scalar(loss), plain)
        };
        let (_, bound) = loss(&parameters, Some(&mut gradients));
        for &id in attached.policy_ids() {
            let step = 1e-2;
            for place in [0, parameters.get(id).data().len() - 1] {
                let mut at = |by: f32| {
                    let mut moved = parameters.clone();
                    moved.get_mut(id).data_mut()[place] += by;
                    f64::from(loss(&moved, None).0)
                };
                let slope = (at(step) - at(-step)) / f64::from(2.0 * step);
                let found = f64::from(gradients.get(id).data()[place]);
                assert!(
                    (slope - found).abs() < 2e-3 + 2e-2 * slope.abs(),
                    "{sharing} people, {}[{place}]: slope {slope}, gradient {found}",
                    parameters.name(id)
                );
            }
        }
        bound
    });
    // −log of a mean lies below the mean of −logs.
    assert!(losses[1] < losses[0], "{losses:?}");
}
