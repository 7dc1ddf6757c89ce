//! Models with random weights, and a count of allocations.
#![allow(dead_code)] // every test program uses its own part

use models::observation::AZIMUTHS;
use models::self_model::Sizes;
use models::{
    HumanModel, Implants, Kind, RecurrentHuman, RecurrentPolicy, RecurrentSizes, SelfHuman,
    SelfModel,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: everything is passed on to `System`; the counter is thread-local and without a destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = ALLOCATIONS.try_with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's promise, passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise, passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations that this thread made so far.
pub fn allocations() -> u64 {
    ALLOCATIONS.with(Cell::get)
}

/// An untrained self-model of the highway's shape, small enough to be quick.
pub fn self_model(seed: u64) -> SelfModel {
    SelfModel::new(
        Sizes {
            hidden: 48,
            ..Sizes::HIGHWAY
        },
        &mut ChaCha8Rng::seed_from_u64(seed),
    )
}

/// Implants as if learned: thresholds from 2 to 40 m, and a residual that does something.
pub fn implants(model: &SelfModel, with_policy: bool) -> Implants {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let mut implants = Implants::new(
        model.sizes.latent,
        model.sizes.shape.action,
        with_policy,
        &mut rng,
    );
    let ids: Vec<_> = implants.parameters.iter().map(|(id, _, _)| id).collect();
    for (place, id) in ids.into_iter().enumerate() {
        let tensor = implants.parameters.get_mut(id);
        nn::noise::fill(tensor.data_mut(), 30 + place as u64, 0);
    }
    implants
}

/// A model of this kind with random weights, the same each time. A new kind gets its line here, and with it the suite.
pub fn human_model(kind: Kind) -> Box<dyn HumanModel> {
    let model = self_model(20);
    if !kind.is_self_model() {
        return Box::new(recurrent(kind));
    }
    let implants = match kind {
        Kind::Mirror => Some(implants(&model, true)),
        Kind::MirrorP => Some(implants(&model, false)),
        _ => None,
    };
    Box::new(SelfHuman::new(Arc::new(model), implants))
}

/// An untrained recurrent policy of a person who sees from 2 to 40 m, and beyond the LIDAR's range to the front left.
fn recurrent(kind: Kind) -> RecurrentHuman {
    let sizes = RecurrentSizes {
        hidden: 48,
        ..RecurrentSizes::HIGHWAY
    };
    let seed = 22 + u64::from(kind == Kind::Sqil);
    let policy = RecurrentPolicy::new(sizes, &mut ChaCha8Rng::seed_from_u64(seed));
    let visible_m = core::array::from_fn(|azimuth: usize| match azimuth {
        3 => f32::INFINITY,
        _ => 2.0 + (azimuth * 11 % AZIMUTHS) as f32 * 38.0 / 35.0,
    });
    RecurrentHuman::new(kind, Arc::new(policy), visible_m)
}
