//! Every operation gives the same bits with every width of vectors, forwards and backwards, at every size; and nothing
//! depends on what an earlier use left in memory.

mod support;

use nn::vectors::{self, Vectors};
use nn::{
    Activation, Adam, Arena, Conv, Deconv, Dense, Gradients, Gru, GruScratch, Mlp, MlpScratch,
    Parameters, Tape, Tensor, Windows, noise,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::{Mutex, MutexGuard, PoisonError};
use support::{Build, random};

/// The choice of vectors is the process's: one test at a time.
fn alone() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A value, all gradients, and the parameters after a step of Adam, as bits.
fn outcome(arena: &mut Arena, p: &Parameters, leaves: &[Tensor], f: &Build) -> Vec<u32> {
    let mut p = p.clone();
    let mut gradients = Gradients::for_params(&p);
    let mut bits = Vec::new();
    {
        let mut tape = Tape::new(&p, arena);
        let vars: Vec<_> = leaves.iter().map(|leaf| tape.leaf(leaf)).collect();
        let out = f(&mut tape, &vars);
        // Twice, so that gradients are also added to what is there.
        let again = f(&mut tape, &vars);
        let both = tape.mul(out, again);
        let loss = tape.sum(both);
        tape.backward(loss, &mut gradients, &|_| true);
        bits.extend_from_slice(tape.value(out));
        for var in vars {
            bits.extend_from_slice(tape.grad(var));
        }
    }
    let mut adam = Adam::new(&p, p.ids().collect(), 0.1);
    adam.step(&mut p, &gradients);
    for id in p.ids() {
        bits.extend_from_slice(gradients.get(id).data());
        bits.extend_from_slice(p.get(id).data());
    }
    bits.iter().map(|x| x.to_bits()).collect()
}

/// One operation, with all vectors, in fresh memory and in memory in which NaN stood everywhere.
fn check(name: &str, p: &Parameters, leaves: &[Tensor], f: &Build) {
    vectors::choose(Vectors::Single);
    let expected = outcome(&mut Arena::new(), p, leaves, f);
    for choice in Vectors::ALL {
        vectors::choose(choice);
        let mut arena = Arena::new();
        let mut spoilt: Vec<Tensor> = leaves.to_vec();
        spoilt.iter_mut().for_each(|leaf| leaf.fill(f32::NAN));
        outcome(&mut arena, p, &spoilt, f);
        for arena in [&mut Arena::new(), &mut arena] {
            let found = outcome(arena, p, leaves, f);
            assert!(found == expected, "{name} with {choice:?}");
        }
    }
    vectors::choose(Vectors::Widest);
}

/// Numbers, with some extreme ones among them, as many as rows allow.
fn leaf(seed: u64, rows: usize, cols: usize, low: f32, high: f32) -> Tensor {
    random(&mut ChaCha8Rng::seed_from_u64(seed), rows, cols, low, high)
}

#[test]
fn functions_of_numbers() {
    let _alone = alone();
    let p = &Parameters::new();
    for n in 1..=200 {
        let cols = 1 + n % 3;
        let x = &[leaf(n as u64, n, cols, -3.0, 3.0)][..];
        let positive = &[leaf(n as u64, n, cols, 0.1, 4.0)][..];
        let row = &[leaf(n as u64, 1, n, -3.0, 3.0)][..];
        check("scale", p, x, &|t, v| t.scale(v[0], -1.7));
        check("offset", p, x, &|t, v| t.offset(v[0], 0.3));
        check("square", p, x, &|t, v| t.square(v[0]));
        check("exp", p, x, &|t, v| t.exp(v[0]));
        check("ln", p, positive, &|t, v| t.ln(v[0]));
        check("tanh", p, x, &|t, v| t.tanh(v[0]));
        check("sigmoid", p, x, &|t, v| t.sigmoid(v[0]));
        check("softplus", p, x, &|t, v| t.softplus(v[0]));
        check("elu", p, x, &|t, v| t.elu(v[0]));
        check("abs", p, x, &|t, v| t.abs(v[0]));
        check("clamp", p, x, &|t, v| t.clamp(v[0], -1.0, 1.5));
        check("tanh_log_det", p, x, &|t, v| t.tanh_log_det(v[0]));
        check("log_softmax", p, x, &|t, v| t.log_softmax(v[0]));
        check("sum_rows", p, x, &|t, v| t.sum_rows(v[0]));
        check("sum", p, x, &|t, v| t.sum(v[0]));
        check("spread", p, row, &|t, v| t.spread(v[0], 5));
        check("rows", p, x, &|t, v| t.rows(v[0], n / 3..n));
        let classes: Vec<u32> = (0..cols).map(|j| (j * 5 % n) as u32).collect();
        check("select", p, x, &|t, v| t.select_log_prob(v[0], &classes));
    }
}

#[test]
fn functions_of_several_numbers() {
    let _alone = alone();
    let p = &Parameters::new();
    for n in 1..=200 {
        let (seed, cols) = (1_000 * n as u64, 1 + n % 3);
        let leaves = &[
            leaf(seed, n, cols, -2.0, 2.0),
            leaf(seed + 1, n, cols, 0.3, 2.0),
            leaf(seed + 2, n, cols, -2.0, 2.0),
            leaf(seed + 3, n, cols, 0.3, 2.0),
        ][..];
        let column = &[leaf(seed, n, 1, -2.0, 2.0)][..];
        check("broadcast", p, column, &|t, v| t.broadcast(v[0], cols));
        check("add", p, leaves, &|t, v| t.add(v[0], v[2]));
        check("sub", p, leaves, &|t, v| t.sub(v[0], v[2]));
        check("mul", p, leaves, &|t, v| t.mul(v[0], v[2]));
        check("div", p, leaves, &|t, v| t.div(v[0], v[1]));
        check("min", p, leaves, &|t, v| t.min(v[0], v[2]));
        check("max", p, leaves, &|t, v| t.max(v[0], v[2]));
        check("concat", p, leaves, &|t, v| t.concat(&[v[0], v[2], v[1]]));
        check("sample", p, leaves, &|t, v| {
            t.gaussian_sample(v[0], v[1], v[2])
        });
        check("log density", p, leaves, &|t, v| {
            t.gaussian_log_density(v[2], v[0], v[1])
        });
        check("kl", p, leaves, &|t, v| {
            t.gaussian_kl(v[0], v[1], v[2], v[3])
        });
    }
}

/// Sizes of one dimension of a layer while the others stay.
fn shapes() -> impl Iterator<Item = (usize, usize, usize)> {
    (1..=200).flat_map(|n| [(n, 17, 2), (5, n, 3), (9, 20, n)])
}

#[test]
fn layers() {
    let _alone = alone();
    let activations = [
        Activation::Identity,
        Activation::Elu,
        Activation::Tanh,
        Activation::Softplus,
    ];
    for (inputs, outputs, batch) in shapes() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut p = Parameters::new();
        let activation = activations[(inputs + outputs + batch) % activations.len()];
        let layer = Dense::new(&mut p, "layer", inputs, outputs, activation, &mut rng);
        let x = [random(&mut rng, inputs, batch, -1.0, 1.0)];
        let name = format!("dense {inputs} → {outputs}, batch {batch}, {activation:?}");
        check(&name, &p, &x, &|t, v| t.dense(&layer, v[0]));
    }
}

#[test]
fn recurrence() {
    let _alone = alone();
    for n in 1..=200 {
        for (inputs, hidden, batch) in [(n, 9, 2), (4, n, 3), (5, 11, n)] {
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            let mut p = Parameters::new();
            let cell = Gru::new(&mut p, "gru", inputs, hidden, &mut rng);
            let leaves = [
                random(&mut rng, inputs, batch, -1.0, 1.0),
                random(&mut rng, hidden, batch, -1.0, 1.0),
            ];
            let name = format!("gru {inputs} → {hidden}, batch {batch}");
            check(&name, &p, &leaves, &|t, v| t.gru(&cell, v[0], v[1]));
        }
    }
}

#[test]
fn images() {
    let _alone = alone();
    for n in 3..=40 {
        let windows = Windows {
            height: n,
            width: 3 + n % 5,
            channels: 1 + n % 3,
            kernel: 3,
            stride: 1 + n % 2,
        };
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut p = Parameters::new();
        let conv = Conv::new(&mut p, "conv", windows, n, Activation::Elu, &mut rng);
        let x = [random(&mut rng, windows.image(), 2, -1.0, 1.0)];
        check(&format!("convolution {n}"), &p, &x, &|t, v| {
            t.conv(&conv, v[0])
        });
        let mut p = Parameters::new();
        let deconv = Deconv::new(&mut p, "deconv", windows, n, &mut rng);
        let (down, across) = windows.grid();
        let x = [random(&mut rng, n * down * across, 2, -1.0, 1.0)];
        let name = format!("transposed convolution {n}");
        check(&name, &p, &x, &|t, v| t.deconv(&deconv, v[0]));
    }
}

#[test]
fn inference_and_noise() {
    let _alone = alone();
    for n in 1..=200 {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut p = Parameters::new();
        let sizes = [n, 33, n, 7];
        let mlp = Mlp::new(&mut p, "net", &sizes, Activation::Softplus, &mut rng);
        let cell = Gru::new(&mut p, "gru", 7, n, &mut rng);
        let x = random(&mut rng, n, 3, -1.0, 1.0);
        let run = |spoilt: bool| {
            let (mut mlp_scratch, mut gru_scratch) = (MlpScratch::default(), GruScratch::default());
            let (mut y, mut h) = (Tensor::default(), Tensor::default());
            if spoilt {
                let mut nan = x.clone();
                nan.fill(f32::NAN);
                mlp.infer(&p, &nan, &mut mlp_scratch, &mut y);
                cell.infer(&p, &y, &nan, &mut gru_scratch, &mut h);
            }
            mlp.infer(&p, &x, &mut mlp_scratch, &mut y);
            cell.infer(&p, &y, &x, &mut gru_scratch, &mut h);
            let mut normal = vec![0.0; 5 * n];
            noise::fill(&mut normal, n as u64, 1);
            (y, h, Tensor::from_slice(5 * n, 1, &normal))
        };
        vectors::choose(Vectors::Single);
        let expected = run(false);
        for choice in Vectors::ALL {
            vectors::choose(choice);
            for spoilt in [false, true] {
                assert!(run(spoilt) == expected, "size {n}, {choice:?}, {spoilt}");
            }
        }
    }
    vectors::choose(Vectors::Widest);
}
