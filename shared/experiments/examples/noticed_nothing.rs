//! What a bomb's self-model expects of each action at a round's start, having noticed nothing: a check that it knows that it does not
//! know. Pressing at random earns a right press one time in three, and costs a wrong one twice.
//!
//! `cargo run --release -p experiments --example noticed_nothing [FILE.safetensors]`

use domains::Mask;
use domains::discrete::{Discrete, Domain, Scene, Setting, World};
use models::{Filter, Scratch, SelfModel, words};
use nn::Tensor;
use std::path::PathBuf;
use std::sync::Arc;

fn main() -> anyhow::Result<()> {
    let shipped = models::shipped::path(models::shipped::BOMB_DEFUSAL);
    let file = std::env::args_os().nth(1).map_or(shipped, PathBuf::from);
    let scene = Scene::of(Domain::BombDefusal, Setting::Original);
    let mut world = World::new(&scene, &words::shipped(Domain::BombDefusal)?)?;
    world.reset(1, 0, 0);
    let layout = Arc::new(world.layout().clone());
    let model = SelfModel::load(&file, Arc::clone(&layout))?;
    let (mut visual, mut verbal) = (vec![0.0; layout.visual], vec![0.0; layout.verbal]);
    let mut filter = Filter::new(model.sizes.latent, 1);
    let mut observed = Tensor::new(model.view.rows(), 1);
    let before = Tensor::new(model.sizes.shape.action, 1);
    world.observe(&mut visual, &mut verbal);
    let column = observed.column_mut(0);
    model.view.write(&visual, &verbal, Mask::NONE, column);
    filter.update(&model, &before, &observed);
    let (mut scratch, mut values) = (Scratch::default(), Tensor::default());
    model.q_values(&mut scratch, &filter.mean, &mut values);
    for (name, value) in layout.action_names.iter().zip(values.column(0)) {
        println!("{name:>8}: {value:.2}");
    }
    Ok(())
}
