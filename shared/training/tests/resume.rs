//! Stopping and resuming gives the same bytes as not stopping; learning implants moves nothing else.

use domains::highway::{Person, Scene};
use models::Kind;
use nn::Parameters;
use std::sync::Arc;
use training::environment::{Environment, Highway};
use training::implants::{self, ImplantSettings};
use training::self_model::{SelfModelSettings, Trainer};

fn trainer() -> Trainer {
    let settings = SelfModelSettings {
        seed: 5,
        phases: 3,
        gradient_steps: 2,
        sequences: 4,
        length: 3,
        ..SelfModelSettings::of("highway")
    };
    Trainer::new(environment(), settings)
}

fn scene() -> Arc<Scene> {
    Arc::new(Scene::builtin("highway-clear").unwrap())
}

fn environment() -> Box<dyn Environment> {
    let table = models::utterances::UtteranceTable::shipped().unwrap();
    Box::new(Highway::new(scene(), table).unwrap())
}

fn bits(parameters: &Parameters) -> Vec<u32> {
    parameters
        .iter()
        .flat_map(|(_, _, tensor)| tensor.data().iter().map(|x| x.to_bits()))
        .collect()
}

#[test]
fn resumed_is_the_same_as_never_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.safetensors");
    let mut whole = trainer();
    let start = bits(&whole.model.parameters);
    for _ in 0..4 {
        whole.phase();
    }
    let mut first = trainer();
    first.phase();
    first.phase();
    first.save(&path, "test").unwrap();
    drop(first);
    let mut second = Trainer::resume(&path, environment()).unwrap();
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
    assert!(std::fs::read(&other).unwrap() == std::fs::read(&path).unwrap());
}

#[test]
fn damaged_checkpoints_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.safetensors");
    let mut run = trainer();
    run.phase();
    run.save(&path, "test").unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for length in [0, 7, 8, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        let error = Trainer::resume(&path, environment()).err().unwrap();
        assert!(error.to_string().contains("run.safetensors"), "{error}");
    }
}

/// Only implants are learned, and the same again.
#[test]
fn learning_implants_moves_nothing_else() {
    let model = Arc::new(trainer().model);
    let before = bits(&model.parameters);
    let person = Person::builtin(1).unwrap();
    let rounds = training::rounds::Rounds::record_drives_in(scene(), &person, 1, 0, 1).unwrap();
    let settings = ImplantSettings {
        points: 6,
        rounds: 1,
        ..ImplantSettings::of("highway")
    };
    let learn = || implants::learn(&model, Kind::Mirror, &rounds, &settings, &mut |_, _| {});
    let learned = learn().unwrap();
    assert_eq!(before, bits(&model.parameters));
    assert_eq!(learned.tried, 12);
    let again = learn().unwrap().posterior;
    assert_eq!(learned.posterior.hypotheses, again.hypotheses);
    assert_eq!(learned.posterior.weights, again.weights);
}

#[test]
fn demonstrations_survive_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rounds.safetensors");
    let person = Person::builtin(2).unwrap();
    let mut rounds = training::rounds::Rounds::record_drives_in(scene(), &person, 3, 0, 2).unwrap();
    rounds.source = "a test".to_owned();
    rounds.save(&path).unwrap();
    let layout = domains::highway::modalities::layout();
    let back = training::rounds::Rounds::load(&path, &layout).unwrap();
    assert_eq!(rounds, back);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() - 10]).unwrap();
    let error = training::rounds::Rounds::load(&path, &layout)
        .err()
        .unwrap();
    assert!(error.to_string().contains("rounds.safetensors"));
}

/// Rounds of the highway as they were written before every domain had the same file.
#[test]
fn demonstrations_of_an_earlier_version_are_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rounds.safetensors");
    let metadata = [
        ("mirror.holds", "demonstrations"),
        ("mirror.domain", "highway"),
        ("mirror.rounds", "1"),
    ];
    let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_owned()));
    let extras = [
        ("length", nn::checkpoint::Extra::U64(&[0])),
        ("collided", nn::checkpoint::Extra::U8(&[1])),
    ];
    nn::checkpoint::save(&path, &[], &extras, &metadata.into()).unwrap();
    let layout = domains::highway::modalities::layout();
    let error = training::rounds::Rounds::load(&path, &layout).unwrap_err();
    let said = error.to_string();
    assert!(
        said.contains("rounds.safetensors") && said.contains("mirror demos"),
        "{said}"
    );
}
