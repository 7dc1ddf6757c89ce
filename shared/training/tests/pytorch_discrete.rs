//! Whole ELBO steps of the gridworlds' self-models against PyTorch's autograd, on identical weights and inputs: states at the
//! paper's sizes, and images with words. The fixtures and the script that makes them are in `tools/` (`make_discrete_fixtures.py`).

use domains::discrete::{Discrete, Domain, Scene, Setting, Words, World};
use models::self_model::Batch;
use models::{ImageSizes, SelfModel, Sizes};
use nn::checkpoint::{self, Checkpoint};
use nn::{Arena, Gradients, Tape, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::sync::Arc;

fn fixture(name: &str) -> Checkpoint {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/fixtures");
    checkpoint::load(&folder.join(format!("{name}.safetensors"))).unwrap()
}

fn number(file: &Checkpoint, key: &str) -> usize {
    file.metadata_value(key).unwrap().parse().unwrap()
}

/// The fixture's steps side by side.
fn joined(file: &Checkpoint, name: &str, out: &mut Tensor) {
    let mut at = 0;
    for step in 0..number(file, "steps") {
        let part = file.tensor(&format!("input.{step}.{name}")).unwrap();
        assert_eq!(part.rows(), out.rows(), "{name}");
        let length = part.data().len();
        out.data_mut()[at..at + length].copy_from_slice(part.data());
        at += length;
    }
    assert_eq!(at, out.data().len(), "{name}");
}

fn check(domain: Domain, name: &str) {
    let file = fixture(name);
    let scene = Scene::of(domain, Setting::Original);
    let words = Words::indicator(scene.sentences().len());
    let world = World::new(&scene, &words).unwrap();
    let layout = Arc::new(world.layout().clone());
    let sizes = Sizes {
        latent: number(&file, "latent"),
        transition_hidden: number(&file, "transition_hidden"),
        encoder_hidden: number(&file, "encoder_hidden"),
        decoder_hidden: number(&file, "decoder_hidden"),
        policy_hidden: number(&file, "q_hidden"),
        image: Sizes::of(&layout).image.map(|image| ImageSizes {
            patterns: file.tensor("weight.draw.weight").unwrap().cols(),
            ..image
        }),
        ..Sizes::of(&layout)
    };
    if domain == Domain::Driving {
        assert_eq!(sizes, Sizes::of(&layout), "the paper's sizes");
    }
    // Random weights first, so that a parameter that the fixture does not fill would show.
    let mut model = SelfModel::new(sizes, layout, &mut ChaCha8Rng::seed_from_u64(0));
    file.read("weight", &mut model.parameters).unwrap();
    let mut batch = Batch::new(&model, number(&file, "steps"), number(&file, "batch"));
    joined(&file, "observed", &mut batch.observed);
    joined(&file, "visual", &mut batch.visual);
    joined(&file, "verbal", &mut batch.verbal);
    joined(&file, "action", &mut batch.action);
    joined(&file, "reward", &mut batch.reward);
    joined(&file, "ended", &mut batch.ended);
    joined(&file, "noise", &mut batch.noise);
    joined(&file, "weight", &mut batch.weight);
    assert!(batch.weight.data().contains(&0.0));

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
        let expected = file.f32s(&format!("expected.{name}")).unwrap()[0];
        let found = tape.scalar(var);
        assert!(
            (found - expected).abs() <= 2e-5 * expected.abs().max(1.0),
            "{name}: {found}, PyTorch finds {expected}"
        );
    }
    tape.backward(terms.loss, &mut gradients, &|_| true);
    for (id, name, _) in model.parameters.iter() {
        let found = gradients.get(id).data();
        let Ok(expected) = file.tensor(&format!("gradient.{name}")) else {
            let learned_apart = name.starts_with("q.") || name == "rewards";
            assert!(learned_apart, "{name} is missing");
            assert!(found.iter().all(|g| *g == 0.0), "{name} has a gradient");
            continue;
        };
        let pairs = || found.iter().zip(expected.data());
        let size = pairs().map(|(_, e)| e * e).sum::<f32>().sqrt();
        let off = pairs().map(|(a, e)| (a - e) * (a - e)).sum::<f32>().sqrt();
        assert!(off <= 1e-4 * size, "{name}: off by {off} of {size}");
    }
}

#[test]
fn a_whole_driving_step_agrees_with_pytorch() {
    check(Domain::Driving, "elbo_driving");
}

#[test]
fn a_whole_step_with_images_agrees_with_pytorch() {
    check(Domain::SearchRescue, "elbo_search_rescue");
}
