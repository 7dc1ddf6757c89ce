//! The gridworlds' learning: stopping and resuming gives the same bytes as not stopping, implants move nothing else,
//! policies learn more than chance, and files give back what was saved.

use domains::discrete::{Discrete, Domain, Mind, Scene, Setting, SimulatedPerson, Words, World};
use models::{Kind, RecurrentSizes};
use nn::Parameters;
use std::sync::Arc;
use training::cloning::{self, CloningSettings};
use training::environment::{Environment, Gridworld};
use training::implants::{self, ImplantError, ImplantSettings};
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
        let model = Arc::new(trainer(domain).model);
        let before = bits(&model.parameters);
        let (rounds, _) = rounds(domain, Setting::Transfer, 4);
        for kind in [Kind::Mirror, Kind::MirrorP] {
            let settings = ImplantSettings {
                points: 4,
                samples: 4,
                ..ImplantSettings::of(domain.name())
            };
            let learn = || implants::learn(&model, kind, &rounds, &settings, &mut |_, _| {});
            let learned = learn().unwrap().posterior;
            assert_eq!(bits(&model.parameters), before);
            assert_eq!(learned.has_policy(), kind == Kind::Mirror);
            assert!((learned.weights.iter().sum::<f32>() - 1.0).abs() < 1e-5);
            // The same again, byte for byte.
            let again = learn().unwrap().posterior;
            assert_eq!(learned.hypotheses, again.hypotheses);
            assert_eq!(learned.weights, again.weights);
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
    let model = Arc::new(trainer(Domain::Driving).model);
    let empty = Rounds::new(&model.layout, Setting::Original, 0);
    let settings = ImplantSettings::of("driving");
    let learned = implants::learn(&model, Kind::Mirror, &empty, &settings, &mut |_, _| {});
    let nothing = ImplantError::NothingToLearn {
        rounds: 0,
        longest: 0,
        skip: 0,
    };
    assert_eq!(learned.err(), Some(nothing));
}
