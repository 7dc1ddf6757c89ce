//! The robot's belief is the self-model's filter over all that is sensed, and starts anew with every episode.

use belief::{BeliefOptions, Tracker};
use domains::Mask;
use domains::highway::AZIMUTHS;
use domains::highway::modalities::{layout, write_visual};
use messages::{BEAMS, DriverAction, EGO_VALUES, LidarFrame, Message, RobotBelief};
use models::{Filter, Observations, SelfModel, Shape, Sizes};
use nn::Tensor;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use runtime::{ClockMode, RunArguments};

#[global_allocator]
static ALLOCATOR: runtime::CountingAllocator = runtime::CountingAllocator;

fn model() -> SelfModel {
    SelfModel::new(
        Sizes::of(&layout()).with_hidden(32),
        layout(),
        &mut ChaCha8Rng::seed_from_u64(4),
    )
}

fn action([throttle, steer]: [f32; 2]) -> DriverAction {
    DriverAction {
        throttle,
        steer,
        ..DriverAction::ZERO
    }
}

fn frame(rng: &mut ChaCha8Rng, episode: u32, step: u32) -> LidarFrame {
    let mut frame = LidarFrame::ZERO;
    (frame.header.episode, frame.header.step) = (episode, step);
    frame.range = core::array::from_fn(|_| rng.random());
    frame.ego = core::array::from_fn(|_| rng.random_range(-1.0..1.0));
    frame
}

#[test]
fn it_is_the_filter_over_everything_sensed() {
    let shape = Shape::of(&layout());
    let model = model();
    let mut tracker = Tracker::new(model.clone());
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for episode in 0..2 {
        let mut filter = Filter::new(model.sizes.latent, 1);
        for step in 0..4 {
            let frame = frame(&mut rng, episode, step);
            let taken = [rng.random(), rng.random()];
            let mut belief = RobotBelief::ZERO;
            tracker.observe(&frame, Some(&action(taken)), &mut belief);

            let mut sensed = Observations::new(&shape, 1);
            write_visual(&frame.range, &frame.ego, sensed.visual.column_mut(0));
            let mut encoded = Tensor::new(shape.encoded(), 1);
            let (visual, verbal) = (sensed.visual.column(0), sensed.verbal.column(0));
            // Every azimuth and no word.
            let mask = Mask {
                visual: (1 << AZIMUTHS) - 1,
                verbal: 0,
            };
            model
                .view
                .write(visual, verbal, mask, encoded.column_mut(0));
            filter.update(&model, &Tensor::from_slice(2, 1, &taken), &encoded);
            assert_eq!(belief.mean[..], *filter.mean.column(0));
            assert_eq!(belief.deviation[..], *filter.deviation.column(0));
            assert_eq!(belief.latent, 128);
            // What it decodes to stands in the message as what was sensed does: ranges, then ego values.
            let (range, ego) = belief.visual[..BEAMS + EGO_VALUES].split_at(BEAMS);
            let mut decoded = [0.0; BEAMS + EGO_VALUES];
            let (range, ego) = (
                range.try_into().expect("108 beams"),
                ego.try_into().expect("5 values"),
            );
            write_visual(range, ego, &mut decoded);
            let error: f32 = decoded
                .iter()
                .zip(visual)
                .map(|(a, b)| (a - b) * (a - b))
                .sum();
            let error = error / decoded.len() as f32;
            assert!(
                (belief.surprise - error).abs() < 1e-4 * (1.0 + error),
                "{} {error}",
                belief.surprise
            );
            assert!(belief.surprise > 0.0);
        }
    }
}

/// In real time the first frame of an episode may be missed.
#[test]
fn an_episode_starts_anew_even_in_its_middle() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let late = frame(&mut rng, 1, 5);
    let observe = |tracker: &mut Tracker<LidarFrame>| {
        let mut belief = RobotBelief::ZERO;
        tracker.observe(&late, Some(&action([0.3, 0.1])), &mut belief);
        belief
    };
    let mut tracker = Tracker::new(model());
    tracker.observe(
        &frame(&mut rng, 0, 7),
        Some(&action([0.0; 2])),
        &mut RobotBelief::default(),
    );
    let first = observe(&mut tracker);
    assert_eq!(first, observe(&mut Tracker::new(model())));
    assert_ne!(
        first.mean,
        observe(&mut tracker).mean,
        "the second look is no longer the first"
    );
}

#[test]
fn it_allocates_nothing_once_it_is_warm() {
    let mut tracker = Tracker::new(model());
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut before = 0;
    for round in 0..3 {
        if round == 2 {
            before = runtime::alloc_count::allocations();
        }
        for step in 0..3 {
            tracker.observe(
                &frame(&mut rng, round, step),
                Some(&action([0.1; 2])),
                &mut RobotBelief::default(),
            );
        }
    }
    assert_eq!(runtime::alloc_count::allocations(), before);
}

#[test]
fn a_model_that_cannot_be_used_is_an_error_that_names_its_file() {
    let folder = testing::private_directory();
    let path = folder.path().join("broken.safetensors");
    let arguments =
        RunArguments::new(folder.path(), "refused", 1, ClockMode::Lockstep).expect("a good name");
    for bytes in [None, Some(&b"no model"[..]), Some(&[0xff; 64])] {
        if let Some(bytes) = bytes {
            std::fs::write(&path, bytes).expect("written");
        }
        let error = belief::run(
            &arguments,
            &BeliefOptions {
                model: path.clone(),
                scenario: scenario::Scenario::Highway(()),
            },
        )
        .expect_err("refused");
        assert!(
            format!("{error:#}").contains("broken.safetensors"),
            "{error:#}"
        );
    }
}

/// The largest z that a model's file may claim is what a message holds.
#[test]
fn the_largest_belief_fits_a_message() {
    assert_eq!(RobotBelief::ZERO.mean.len(), models::MOST_LATENT);
}
