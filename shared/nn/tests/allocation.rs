//! No allocation after the first steps, and the same bytes from the same work.

use nn::{
    Activation, Adam, Arena, Gradients, Gru, GruScratch, Mlp, MlpScratch, Parameters, Tape, Tensor,
    noise,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Counting;

thread_local! {
    // Per thread, so that tests that run beside each other do not count each other's.
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: passes every call on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = ALLOCATIONS.try_with(|n| n.set(n.get() + 1));
        // SAFETY: the caller keeps `alloc`'s contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps `dealloc`'s contract.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

fn allocations() -> usize {
    ALLOCATIONS.with(Cell::get)
}

struct Model {
    p: Parameters,
    encoder: Mlp,
    deviation: Mlp,
    decoder: Mlp,
    gru: Gru,
    adam: Adam,
    gradients: Gradients,
    arena: Arena,
    noise: Tensor,
}

impl Model {
    fn new() -> Self {
        let mut p = Parameters::new();
        let rng = &mut ChaCha8Rng::seed_from_u64(3);
        let encoder = Mlp::new(&mut p, "mean", &[20, 33, 16], Activation::Identity, rng);
        let deviation = Mlp::new(
            &mut p,
            "deviation",
            &[20, 33, 16],
            Activation::Softplus,
            rng,
        );
        let decoder = Mlp::new(&mut p, "decoder", &[32, 33, 20], Activation::Identity, rng);
        let gru = Gru::new(&mut p, "gru", 16, 16, rng);
        let ids = p.ids().collect();
        Self {
            adam: Adam::new(&p, ids, 1e-3),
            gradients: Gradients::for_params(&p),
            arena: Arena::new(),
            noise: Tensor::new(16, 24),
            p,
            encoder,
            deviation,
            decoder,
            gru,
        }
    }

    /// A step that touches every kind of operation; gives its loss.
    fn step(&mut self, x: &Tensor, classes: &[u32], number: u64) -> f32 {
        noise::fill(self.noise.data_mut(), 1, number);
        self.gradients.zero();
        let mut t = Tape::new(&self.p, &mut self.arena);
        let x = t.input(x);
        let mut h = t.constant(16, 24, 0.0);
        let mut total = t.constant(1, 24, 0.0);
        for _ in 0..3 {
            let mean = t.mlp(&self.encoder, x);
            let deviation = t.mlp(&self.deviation, x);
            let noise = t.input(&self.noise);
            let z = t.gaussian_sample(mean, deviation, noise);
            let z = t.tanh(z);
            let (zeros, ones) = (t.constant(16, 24, 0.0), t.constant(16, 24, 1.0));
            let kl = t.gaussian_kl(mean, deviation, zeros, ones);
            h = t.gru(&self.gru, z, h);
            let both = t.concat(&[z, h]);
            let y = t.mlp(&self.decoder, both);
            let unit = t.constant(20, 24, 1.0);
            let fit = t.gaussian_log_density(x, y, unit);
            let part = t.rows(y, 3..9);
            let logp = t.log_softmax(part);
            let chosen = t.select_log_prob(logp, classes);
            let seen = t.min(x, y);
            let seen = t.sum_rows(seen);
            let spread = t.spread(seen, 2);
            let spread = t.sum_rows(spread);
            let correction = t.tanh_log_det(h);
            for (term, weight) in [
                (kl, 1.0),
                (fit, -1.0),
                (chosen, -0.1),
                (spread, 0.01),
                (correction, 0.1),
            ] {
                let term = t.scale(term, weight);
                total = t.add(total, term);
            }
        }
        let loss = t.mean(total);
        let value = t.scalar(loss);
        t.backward(loss, &mut self.gradients, &|_| true);
        self.gradients.clip(self.adam.ids(), 1.0);
        self.adam.step(&mut self.p, &self.gradients);
        value
    }
}

fn data() -> (Tensor, Vec<u32>) {
    let mut x = Tensor::new(20, 24);
    noise::fill(x.data_mut(), 6, 6);
    (x, (0..24).map(|i| i % 6).collect())
}

#[test]
fn learning_allocates_nothing_after_its_first_step() {
    let (mut model, (x, classes)) = (Model::new(), data());
    let first = model.step(&x, &classes, 0);
    model.step(&x, &classes, 1);
    let before = allocations();
    let mut last = 0.0;
    for number in 2..60 {
        last = model.step(&x, &classes, number);
    }
    assert_eq!(allocations() - before, 0);
    assert!(last < first, "the loss went from {first} to {last}");
}

#[test]
fn the_same_steps_give_the_same_bytes() {
    let (x, classes) = data();
    let run = move || {
        let mut model = Model::new();
        let losses: Vec<u32> = (0..10)
            .map(|n| model.step(&x, &classes, n).to_bits())
            .collect();
        (losses, model.p, model.gradients)
    };
    let here = run.clone()();
    let there = std::thread::spawn(run).join().unwrap();
    assert!(here == there);
}

#[test]
fn inference_allocates_nothing_after_its_first_call() {
    let model = Model::new();
    let (x, _) = data();
    let one = Tensor::from_slice(20, 1, x.column(0));
    let mut scratch = MlpScratch::default();
    let mut gru = GruScratch::default();
    let (mut mean, mut z, mut h) = (Tensor::default(), Tensor::new(16, 24), Tensor::default());
    let mut run = || {
        for x in [&x, &one] {
            model.encoder.infer(&model.p, x, &mut scratch, &mut mean);
            z.resize_to(16, x.cols());
            z.fill(0.5);
            model.gru.infer(&model.p, &mean, &z, &mut gru, &mut h);
            model
                .decoder
                .infer_stacked(&model.p, &[&mean, &h], &mut scratch, &mut z);
        }
    };
    run();
    let before = allocations();
    for _ in 0..20 {
        run();
    }
    assert_eq!(allocations() - before, 0);
}
