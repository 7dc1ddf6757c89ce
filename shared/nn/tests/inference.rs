//! Inference without a tape: against f64 arithmetic, against the tape, in blocks, and column by column.

use nn::{Activation, Arena, Dense, Gru, GruScratch, Mlp, MlpScratch, Parameters, Tape, Tensor};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn random(rng: &mut ChaCha8Rng, rows: usize, cols: usize) -> Tensor {
    let mut t = Tensor::new(rows, cols);
    for x in t.data_mut() {
        *x = 2.0 * rng.random::<f32>() - 1.0;
    }
    t
}

/// W x + b in f64.
fn affine(p: &Parameters, w: nn::ParamId, b: nn::ParamId, x: &[f64]) -> Vec<f64> {
    let (w, b) = (p.get(w), p.get(b));
    (0..w.rows())
        .map(|i| {
            let sum: f64 = (0..w.cols())
                .map(|k| f64::from(w.column(k)[i]) * x[k])
                .sum();
            sum + f64::from(b.data()[i])
        })
        .collect()
}

fn exact_layer(p: &Parameters, layer: &Dense, x: &[f64]) -> Vec<f64> {
    let mut y = affine(p, layer.weight, layer.bias, x);
    for v in &mut y {
        *v = match layer.activation {
            Activation::Identity => *v,
            Activation::Elu if *v > 0.0 => *v,
            Activation::Elu => v.exp_m1(),
            Activation::Tanh => v.tanh(),
            Activation::Softplus => (v.max(0.0) + (-v.abs()).exp().ln_1p()).max(1e-4),
        };
    }
    y
}

fn wide(x: &[f32]) -> Vec<f64> {
    x.iter().map(|v| f64::from(*v)).collect()
}

fn assert_close(found: &[f32], exact: &[f64]) {
    assert_eq!(found.len(), exact.len());
    for (f, e) in found.iter().zip(exact) {
        assert!((f64::from(*f) - e).abs() < 3e-6, "{f} against {e}");
    }
}

#[test]
fn networks_match_exact_arithmetic_and_the_tape() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for last in [
        Activation::Identity,
        Activation::Tanh,
        Activation::Softplus,
        Activation::Elu,
    ] {
        for batch in [1, 2, 3, 17, 130] {
            let mut p = Parameters::new();
            let net = Mlp::new(&mut p, "net", &[37, 128, 65, 9], last, &mut rng);
            assert_eq!((net.input(), net.output()), (37, 9));
            let x = random(&mut rng, 37, batch);
            let mut out = Tensor::default();
            net.infer(&p, &x, &mut MlpScratch::default(), &mut out);
            for j in 0..batch {
                let mut exact = wide(x.column(j));
                for layer in &net.layers {
                    exact = exact_layer(&p, layer, &exact);
                }
                assert_close(out.column(j), &exact);
            }
            let mut arena = Arena::new();
            let mut tape = Tape::new(&p, &mut arena);
            let v = tape.input(&x);
            let v = tape.mlp(&net, v);
            assert_eq!(tape.value(v), out.data());
        }
    }
}

#[test]
fn stacked_blocks_equal_their_concatenation() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for batch in [1, 5, 64] {
        let mut p = Parameters::new();
        let net = Mlp::new(&mut p, "net", &[12, 31, 4], Activation::Identity, &mut rng);
        let blocks = [7, 1, 4].map(|rows| random(&mut rng, rows, batch));
        let mut x = Tensor::new(12, batch);
        for j in 0..batch {
            let mut from = 0;
            for block in &blocks {
                x.column_mut(j)[from..from + block.rows()].copy_from_slice(block.column(j));
                from += block.rows();
            }
        }
        let (mut whole, mut stacked) = (Tensor::default(), Tensor::default());
        let mut scratch = MlpScratch::default();
        net.infer(&p, &x, &mut scratch, &mut whole);
        let [a, b, c] = &blocks;
        net.infer_stacked(&p, &[a, b, c], &mut scratch, &mut stacked);
        assert_eq!(stacked, whole);
    }
}

#[test]
fn recurrent_cell_matches_exact_arithmetic_and_the_tape() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut p = Parameters::new();
    let cell = Gru::new(&mut p, "gru", 6, 20, &mut rng);
    for batch in [1, 4, 50] {
        let (x, h) = (random(&mut rng, 6, batch), random(&mut rng, 20, batch));
        let mut out = Tensor::default();
        cell.infer(&p, &x, &h, &mut GruScratch::default(), &mut out);
        for j in 0..batch {
            let gi = affine(&p, cell.input_weight, cell.input_bias, &wide(x.column(j)));
            let gh = affine(&p, cell.hidden_weight, cell.hidden_bias, &wide(h.column(j)));
            let sigmoid = |v: f64| 1.0 / (1.0 + (-v).exp());
            let exact: Vec<f64> = (0..20)
                .map(|i| {
                    let r = sigmoid(gi[i] + gh[i]);
                    let z = sigmoid(gi[20 + i] + gh[20 + i]);
                    let n = (gi[40 + i] + r * gh[40 + i]).tanh();
                    (1.0 - z) * n + z * f64::from(h.column(j)[i])
                })
                .collect();
            assert_close(out.column(j), &exact);
        }
        let mut arena = Arena::new();
        let mut tape = Tape::new(&p, &mut arena);
        let (xv, hv) = (tape.input(&x), tape.input(&h));
        let v = tape.gru(&cell, xv, hv);
        assert_eq!(tape.value(v), out.data());
    }
}

#[test]
fn a_batch_equals_its_columns_one_by_one() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut p = Parameters::new();
    let net = Mlp::new(
        &mut p,
        "net",
        &[108, 128, 128, 18],
        Activation::Tanh,
        &mut rng,
    );
    let x = random(&mut rng, 108, 77);
    let (mut all, mut one) = (Tensor::default(), Tensor::default());
    let mut scratch = MlpScratch::default();
    net.infer(&p, &x, &mut scratch, &mut all);
    for j in 0..77 {
        let column = Tensor::from_slice(108, 1, x.column(j));
        net.infer(&p, &column, &mut scratch, &mut one);
        assert_eq!(one.data(), all.column(j));
    }
}

#[test]
fn initial_weights_are_uniform_and_follow_the_seed() {
    let make = |seed| {
        let mut p = Parameters::new();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        Mlp::new(
            &mut p,
            "net",
            &[100, 200, 5],
            Activation::Identity,
            &mut rng,
        );
        p
    };
    let p = make(7);
    assert_eq!(p, make(7));
    assert_ne!(p, make(8));
    assert_eq!(p.scalars(), 100 * 200 + 200 + 200 * 5 + 5);
    let names: Vec<&str> = p.iter().map(|(_, name, _)| name).collect();
    assert_eq!(
        names,
        ["net.0.weight", "net.0.bias", "net.1.weight", "net.1.bias"]
    );
    let first = p.get(p.id("net.0.weight").unwrap());
    assert_eq!((first.rows(), first.cols()), (200, 100));
    let bound = 0.1;
    assert!(first.data().iter().all(|w| w.abs() <= bound));
    let mean: f32 = first.data().iter().sum::<f32>() / 20_000.0;
    let square: f32 = first.data().iter().map(|w| w * w).sum::<f32>() / 20_000.0;
    // Standard errors: 0.1/√3/√20000 ≈ 4e-4; of the mean square 0.01·√(4/45)/√20000 ≈ 2e-5.
    assert!(mean.abs() < 2e-3 && (square - bound * bound / 3.0).abs() < 1e-4);
}

#[test]
fn target_networks_move_towards_their_source() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut source = Parameters::new();
    let id = source.add("w", random(&mut rng, 19, 3));
    let mut target = Parameters::new();
    target.add("w", random(&mut rng, 19, 3));
    let before = target.get(id).clone();
    target.lerp_from(&source, 0.25);
    for i in 0..57 {
        let expected = 0.75 * before.data()[i] + 0.25 * source.get(id).data()[i];
        assert!((target.get(id).data()[i] - expected).abs() < 1e-6);
    }
    target.lerp_from(&source, 1.0);
    for (t, s) in target.get(id).data().iter().zip(source.get(id).data()) {
        assert!((t - s).abs() < 1e-6);
    }
    target.copy_from(&source);
    assert_eq!(target, source);
}

#[test]
fn tensors_keep_their_memory() {
    let mut t = Tensor::new(40, 30);
    assert_eq!(t.data().as_ptr() as usize % 64, 0);
    let before = t.data().as_ptr();
    t.resize_to(3, 2);
    assert_eq!(t.data().len(), 6);
    t.resize_to(30, 40);
    assert_eq!((t.data().as_ptr(), t.column(39).len()), (before, 30));
}

#[test]
fn deviations_in_place_match_the_layers() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut p = Parameters::new();
    let layer = Dense::new(&mut p, "d", 5, 1100, Activation::Softplus, &mut rng);
    let raw = Dense {
        activation: Activation::Identity,
        ..layer
    };
    p.get_mut(layer.bias).data_mut()[7] = -40.0;
    let x = random(&mut rng, 5, 3);
    let (mut direct, mut two_steps) = (Tensor::default(), Tensor::default());
    layer.infer(&p, &x, &mut direct);
    raw.infer(&p, &x, &mut two_steps);
    nn::softplus_in_place(&mut two_steps);
    assert_eq!(direct, two_steps);
    assert_eq!(direct.data()[7], 1e-4);
}
