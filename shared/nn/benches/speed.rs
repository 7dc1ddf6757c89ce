//! Speeds: networks over batches (elements per second are floating-point operations per second), a learning step,
//! elementwise functions, and random numbers.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use matrixmultiply::sgemm;
use nn::{
    Activation, Adam, Arena, Gradients, Gru, GruScratch, Mlp, MlpScratch, Parameters, Tape, Tensor,
    noise,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::hint::black_box;

fn normal(rows: usize, cols: usize) -> Tensor {
    let mut t = Tensor::new(rows, cols);
    noise::fill(t.data_mut(), 3, 4);
    t
}

/// Multiplications and additions of a network.
fn operations(sizes: &[usize], batch: usize) -> u64 {
    sizes
        .windows(2)
        .map(|w| 2 * w[0] * w[1] * batch)
        .sum::<usize>() as u64
}

fn inference(c: &mut Criterion) {
    let mut group = c.benchmark_group("inference");
    let rng = &mut ChaCha8Rng::seed_from_u64(1);
    let sizes = [128, 128, 128, 128];
    let mut p = Parameters::new();
    let net = Mlp::new(&mut p, "net", &sizes, Activation::Identity, rng);
    for batch in [1000, 500, 100, 32, 8, 1] {
        let x = normal(128, batch);
        let (mut scratch, mut out) = (MlpScratch::default(), Tensor::default());
        group.throughput(Throughput::Elements(operations(&sizes, batch)));
        group.bench_function(BenchmarkId::new("three layers of 128", batch), |b| {
            b.iter(|| net.infer(&p, black_box(&x), &mut scratch, &mut out));
        });
    }
    let (x, w, mut y) = (normal(128, 1000), normal(128, 128), Tensor::new(128, 1000));
    group.throughput(Throughput::Elements(operations(&[128, 128], 1000)));
    group.bench_function("a general product alone/1000", |b| {
        b.iter(|| {
            let (w, x) = (w.data().as_ptr(), black_box(&x).data().as_ptr());
            let y = y.data_mut().as_mut_ptr();
            // SAFETY: column-major matrices of 128 × 128, 128 × 1000 and 128 × 1000 numbers.
            unsafe { sgemm(128, 128, 1000, 1.0, w, 1, 128, x, 1, 128, 0.0, y, 1, 128) };
        });
    });
    let gru = Gru::new(&mut p, "gru", 128, 128, rng);
    let (h, mut scratch, mut out) = (normal(128, 1000), GruScratch::default(), Tensor::default());
    group.throughput(Throughput::Elements(12 * 128 * 128 * 1000));
    group.bench_function("gru 128/1000", |b| {
        b.iter(|| gru.infer(&p, black_box(&x), &h, &mut scratch, &mut out));
    });
    group.finish();
}

/// A latent model over a sequence: posterior, prior, sample, decoder, KL.
fn elbo(c: &mut Criterion) {
    let mut group = c.benchmark_group("elbo");
    // Sizes of the gridworld's and the highway's self-models (paper, appendix).
    for (name, latent, [wide, narrow], observed, batch, steps) in [
        ("gridworld, batch 32, 16 steps", 48, [64, 32], 60, 32, 16),
        ("highway, batch 200, 3 steps", 128, [128, 128], 348, 200, 3),
    ] {
        let rng = &mut ChaCha8Rng::seed_from_u64(1);
        let mut p = Parameters::new();
        let heads = 2 * latent;
        let encoder = [latent + observed, wide, wide, heads];
        let transition = [latent, narrow, narrow, heads];
        let generator = [latent, narrow, narrow, observed];
        let encode = Mlp::new(&mut p, "encode", &encoder, Activation::Identity, rng);
        let prior = Mlp::new(&mut p, "prior", &transition, Activation::Identity, rng);
        let decode = Mlp::new(&mut p, "decode", &generator, Activation::Identity, rng);
        let ids: Vec<_> = p.ids().collect();
        let mut adam = Adam::new(&p, ids, 1e-4);
        let mut gradients = Gradients::for_params(&p);
        let (mut arena, x, e) = (Arena::new(), normal(observed, batch), normal(latent, batch));
        let flops: u64 = [&encoder, &transition, &generator]
            .iter()
            .map(|s| operations(&s[..], batch))
            .sum();
        group.throughput(Throughput::Elements(3 * flops * steps as u64));
        group.bench_function(name, |b| {
            b.iter(|| {
                gradients.zero();
                let mut t = Tape::new(&p, &mut arena);
                let x = t.input(&x);
                let e = t.input(&e);
                let one = t.constant(observed, batch, 1.0);
                let mut z = t.constant(latent, batch, 0.0);
                let mut total = t.constant(1, batch, 0.0);
                for _ in 0..steps {
                    let both = t.concat(&[z, x]);
                    let mut halves = [both, z];
                    for (v, net) in halves.iter_mut().zip([&encode, &prior]) {
                        *v = t.mlp(net, *v);
                    }
                    let [q, r] = halves;
                    let [qm, rm] = [q, r].map(|v| t.rows(v, 0..latent));
                    let [qs, rs] = [q, r].map(|v| {
                        let s = t.rows(v, latent..2 * latent);
                        let s = t.softplus(s);
                        t.offset(s, 1e-4)
                    });
                    z = t.gaussian_sample(qm, qs, e);
                    let kl = t.gaussian_kl(qm, qs, rm, rs);
                    let y = t.mlp(&decode, z);
                    let fit = t.gaussian_log_density(x, y, one);
                    let term = t.sub(kl, fit);
                    total = t.add(total, term);
                }
                let loss = t.mean(total);
                t.backward(loss, &mut gradients, &|_| true);
                adam.step(&mut p, &gradients);
            });
        });
    }
    group.finish();
}

fn elementwise(c: &mut Criterion) {
    let mut group = c.benchmark_group("elementwise");
    let x = normal(128, 100);
    let p = Parameters::new();
    group.throughput(Throughput::Elements(12_800));
    type Function = fn(&mut Tape, nn::Var) -> nn::Var;
    let functions: [(&str, Function); 6] = [
        ("offset", |t, v| t.offset(v, 1.0)),
        ("exp", |t, v| t.exp(v)),
        ("elu", |t, v| t.elu(v)),
        ("tanh", |t, v| t.tanh(v)),
        ("softplus", |t, v| t.softplus(v)),
        ("sum_rows", |t, v| t.sum_rows(v)),
    ];
    for (name, f) in functions {
        let mut arena = Arena::new();
        group.bench_function(name, |b| {
            b.iter(|| {
                let mut t = Tape::new(&p, &mut arena);
                let v = t.input(&x);
                for _ in 0..10 {
                    f(&mut t, v);
                }
            });
        });
    }
    let mut out = vec![0.0; 128_000];
    group.throughput(Throughput::Elements(128_000));
    group.bench_function("normal numbers", |b| b.iter(|| noise::fill(&mut out, 1, 2)));
    group.finish();
}

criterion_group!(benches, inference, elbo, elementwise);
criterion_main!(benches);
