//! A whole ELBO step and a whole look ahead against PyTorch's autograd, on identical weights and inputs. The fixtures
//! and the script that makes them are in `tools/` (`make_fixtures.py`).

use domains::highway::modalities::layout;
use models::self_model::Batch;
use models::{SelfModel, Sizes};
use nn::checkpoint::{self, Checkpoint};
use nn::{Arena, Gradients, Parameters, Tape, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::Path;

fn fixture(name: &str) -> Checkpoint {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/fixtures");
    checkpoint::load(&folder.join(format!("{name}.safetensors"))).unwrap()
}

fn number(file: &Checkpoint, key: &str) -> usize {
    file.metadata_value(key).unwrap().parse().unwrap()
}

/// Random weights first, so that a parameter that the fixture does not fill would show.
fn model_of(file: &Checkpoint) -> SelfModel {
    let sizes = Sizes {
        latent: number(file, "latent"),
        ..Sizes::of(&layout()).with_hidden(number(file, "hidden"))
    };
    let mut model = SelfModel::new(sizes, layout(), &mut ChaCha8Rng::seed_from_u64(0));
    file.read("weight", &mut model.parameters).unwrap();
    model
}

fn input(file: &Checkpoint, step: usize, name: &str) -> Tensor {
    file.tensor(&format!("input.{step}.{name}")).unwrap()
}

/// The fixture's steps side by side.
fn joined(file: &Checkpoint, name: &str, out: &mut Tensor) {
    let mut at = 0;
    for step in 0..number(file, "steps") {
        let part = input(file, step, name);
        assert_eq!(part.rows(), out.rows(), "{name}");
        let length = part.data().len();
        out.data_mut()[at..at + length].copy_from_slice(part.data());
        at += length;
    }
    assert_eq!(at, out.data().len(), "{name}");
}

/// A parameter's name in the fixtures, where a driver's limits of sight are called thresholds.
fn in_fixture(name: &str) -> &str {
    match name {
        "implant.limits" => "implant.thresholds",
        name => name,
    }
}

fn assert_term(file: &Checkpoint, name: &str, found: f32) {
    let expected = file.f32s(&format!("expected.{name}")).unwrap()[0];
    assert!(
        (found - expected).abs() <= 2e-5 * expected.abs().max(1.0),
        "{name}: {found}, PyTorch finds {expected}"
    );
}

/// Every gradient in the file, to 1e-4 of its tensor's own size; and none elsewhere.
fn assert_gradients(file: &Checkpoint, parameters: &Parameters, gradients: &Gradients) {
    let wanted: Vec<&str> = file
        .names()
        .filter_map(|name| name.strip_prefix("gradient."))
        .collect();
    assert!(!wanted.is_empty());
    for (id, name, _) in parameters.iter() {
        let (found, name) = (gradients.get(id).data(), in_fixture(name));
        if !wanted.contains(&name) {
            assert!(found.iter().all(|g| *g == 0.0), "{name} has a gradient");
            continue;
        }
        let expected = file.tensor(&format!("gradient.{name}")).unwrap();
        let size = expected.data().iter().map(|g| g * g).sum::<f32>().sqrt();
        let difference = found
            .iter()
            .zip(expected.data())
            .map(|(a, b)| (a - b) * (a - b))
            .sum::<f32>()
            .sqrt();
        assert!(
            difference <= 1e-4 * size,
            "{name}: off by {difference} of {size}"
        );
    }
    for name in wanted {
        let mut ours = parameters.iter().map(|(_, ours, _)| in_fixture(ours));
        assert!(ours.any(|ours| ours == name), "no parameter {name}");
    }
}

fn batch_of(file: &Checkpoint, model: &SelfModel) -> Batch {
    let mut batch = Batch::new(model, number(file, "steps"), number(file, "batch"));
    joined(file, "observed", &mut batch.observed);
    joined(file, "visual", &mut batch.visual);
    joined(file, "verbal", &mut batch.verbal);
    joined(file, "action", &mut batch.action);
    joined(file, "reward", &mut batch.reward);
    joined(file, "ended", &mut batch.ended);
    joined(file, "noise", &mut batch.noise);
    batch.weight.fill(1.0);
    batch
}

#[test]
fn a_whole_elbo_step_agrees_with_pytorch() {
    let file = fixture("elbo_step");
    let model = model_of(&file);
    let batch = batch_of(&file, &model);
    let mut arena = Arena::default();
    let mut gradients = Gradients::for_params(&model.parameters);
    let mut tape = Tape::new(&model.parameters, &mut arena);
    let terms = model.negative_elbo(&mut tape, &batch);
    for (name, var) in [
        ("loss", terms.loss),
        ("reconstruction", terms.reconstruction),
        ("reward", terms.reward),
        ("ending", terms.ending),
        ("divergence", terms.divergence),
    ] {
        assert_term(&file, name, tape.value(var)[0]);
    }
    tape.backward(terms.loss, &mut gradients, &|_| true);
    assert_gradients(&file, &model.parameters, &gradients);
}

#[test]
fn a_whole_look_ahead_agrees_with_pytorch() {
    let file = fixture("foresight");
    let model = model_of(&file);
    let batch = batch_of(&file, &model);
    let mut arena = Arena::default();
    let mut gradients = Gradients::for_params(&model.parameters);
    let mut tape = Tape::new(&model.parameters, &mut arena);
    let z = model.negative_elbo(&mut tape, &batch).z;
    let loss = model.foresight(&mut tape, &batch, z, number(&file, "start"));
    assert_term(&file, "loss", tape.value(loss)[0]);
    tape.backward(loss, &mut gradients, &|_| true);
    assert_gradients(&file, &model.parameters, &gradients);
}
