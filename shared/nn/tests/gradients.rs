//! Every operation's gradient against central differences, and whole networks'.

mod support;

use nn::{Activation, Arena, Dense, Gradients, Gru, Mlp, ParamId, Parameters, Tape, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::{Build, STEP, check, random};

/// Shapes that meet whole vectors, remainders, single rows and single columns.
const SHAPES: [(usize, usize); 6] = [(1, 1), (3, 1), (1, 7), (5, 4), (16, 3), (35, 2)];

/// Checks an operation on leaves of one shape, each from its own range.
fn check_same(name: &str, ranges: &[(f32, f32)], f: &Build) {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for (rows, cols) in SHAPES {
        let mut leaves: Vec<Tensor> = ranges
            .iter()
            .map(|&(low, high)| random(&mut rng, rows, cols, low, high))
            .collect();
        check(name, &mut Parameters::new(), &mut leaves, f);
    }
}

/// Pushes numbers out of the neighbourhood of a kink, where differences say nothing.
fn avoid(t: &mut Tensor, kinks: &[f32]) {
    for x in t.data_mut() {
        for k in kinks {
            if (*x - k).abs() < 2.0 * STEP {
                *x = k + 3.0 * STEP;
            }
        }
    }
}

fn check_unary(name: &str, range: (f32, f32), kinks: &[f32], f: &Build) {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for (rows, cols) in SHAPES {
        let mut leaf = random(&mut rng, rows, cols, range.0, range.1);
        avoid(&mut leaf, kinks);
        check(name, &mut Parameters::new(), &mut [leaf], f);
    }
}

#[test]
fn functions_of_one_number() {
    let wide = (-3.0, 3.0);
    check_unary("scale", wide, &[], &|t, v| t.scale(v[0], -1.7));
    check_unary("offset", wide, &[], &|t, v| t.offset(v[0], 0.3));
    check_unary("neg", wide, &[], &|t, v| t.neg(v[0]));
    check_unary("square", wide, &[], &|t, v| t.square(v[0]));
    check_unary("exp", (-2.0, 2.0), &[], &|t, v| t.exp(v[0]));
    check_unary("ln", (0.5, 4.0), &[], &|t, v| t.ln(v[0]));
    check_unary("tanh", wide, &[], &|t, v| t.tanh(v[0]));
    check_unary("sigmoid", wide, &[], &|t, v| t.sigmoid(v[0]));
    check_unary("softplus", wide, &[], &|t, v| t.softplus(v[0]));
    check_unary("elu", wide, &[0.0], &|t, v| t.elu(v[0]));
    check_unary("abs", wide, &[0.0], &|t, v| t.abs(v[0]));
    check_unary("clamp", wide, &[-1.0, 1.5], &|t, v| {
        t.clamp(v[0], -1.0, 1.5)
    });
    check_unary("tanh_log", wide, &[], &|t, v| t.tanh_log(v[0]));
    check_unary("tanh_log_det", wide, &[], &|t, v| t.tanh_log_det(v[0]));
    check_unary("log_softmax", wide, &[], &|t, v| t.log_softmax(v[0]));
    check_unary("sum_rows", wide, &[], &|t, v| t.sum_rows(v[0]));
    check_unary("sum", wide, &[], &|t, v| t.sum(v[0]));
    check_unary("mean", wide, &[], &|t, v| t.mean(v[0]));
}

#[test]
fn functions_of_two_numbers() {
    let wide = (-3.0, 3.0);
    check_same("add", &[wide, wide], &|t, v| t.add(v[0], v[1]));
    check_same("sub", &[wide, wide], &|t, v| t.sub(v[0], v[1]));
    check_same("mul", &[wide, wide], &|t, v| t.mul(v[0], v[1]));
    check_same("mul with itself", &[wide], &|t, v| t.mul(v[0], v[0]));
    check_same("div", &[wide, (1.0, 3.0)], &|t, v| t.div(v[0], v[1]));
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for (rows, cols) in SHAPES {
        let a = random(&mut rng, rows, cols, -3.0, 3.0);
        let mut b = random(&mut rng, rows, cols, -3.0, 3.0);
        for (a, b) in a.data().iter().zip(b.data_mut()) {
            if (*a - *b).abs() < 4.0 * STEP {
                *b = *a + 5.0 * STEP;
            }
        }
        let mut leaves = [a, b];
        let p = &mut Parameters::new();
        check("min", p, &mut leaves, &|t, v| t.min(v[0], v[1]));
        check("max", p, &mut leaves, &|t, v| t.max(v[0], v[1]));
    }
}

#[test]
fn ties_share_the_gradient() {
    let p = Parameters::new();
    let mut arena = Arena::new();
    let mut tape = Tape::new(&p, &mut arena);
    let x = Tensor::from_slice(1, 1, &[2.0]);
    let (a, b) = (tape.leaf(&x), tape.leaf(&x));
    let smaller = tape.min(a, b);
    let larger = tape.max(a, b);
    let three = tape.scale(larger, 3.0);
    let loss = tape.add(smaller, three);
    tape.backward(loss, &mut Gradients::for_params(&p), &|_| true);
    assert_eq!((tape.grad(a), tape.grad(b)), (&[2.0][..], &[2.0][..]));
}

#[test]
fn gaussians() {
    let (wide, dev) = ((-2.0, 2.0), (0.7, 2.0));
    check_same("sample", &[wide, dev, wide], &|t, v| {
        t.gaussian_sample(v[0], v[1], v[2])
    });
    check_same("log_density", &[wide, wide, dev], &|t, v| {
        t.gaussian_log_density(v[0], v[1], v[2])
    });
    check_same("kl", &[wide, dev, wide, dev], &|t, v| {
        t.gaussian_kl(v[0], v[1], v[2], v[3])
    });
    check_same("kl terms", &[wide, dev, wide, dev], &|t, v| {
        t.gaussian_kl_terms(v[0], v[1], v[2], v[3])
    });
}

#[test]
fn gaussian_values() {
    let p = Parameters::new();
    let mut arena = Arena::new();
    let mut tape = Tape::new(&p, &mut arena);
    let one = |x: f32| Tensor::from_slice(1, 1, &[x]);
    let [a, b, c, d] = [0.3, 0.8, -0.4, 1.7].map(|x| tape.input(&one(x)));
    let kl = tape.gaussian_kl(a, b, c, d);
    // ln(1.7/0.8) + (0.8² + 0.7²)/(2·1.7²) − ½
    assert!(
        (tape.scalar(kl) - 0.449_273_53).abs() < 1e-6,
        "{}",
        tape.scalar(kl)
    );
    let density = tape.gaussian_log_density(a, c, d);
    // −½ (0.7/1.7)² − ln 1.7 − ½ ln 2π
    assert!(
        (tape.scalar(density) + 1.534_341_9).abs() < 1e-6,
        "{}",
        tape.scalar(density)
    );
    let same = tape.gaussian_kl(a, b, a, b);
    assert!(tape.scalar(same).abs() < 1e-6);
}

#[test]
fn shapes_and_selection() {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let p = &mut Parameters::new();
    for cols in [1, 2, 9] {
        let mut leaves = [
            random(&mut rng, 3, cols, -2.0, 2.0),
            random(&mut rng, 17, cols, -2.0, 2.0),
            random(&mut rng, 1, cols, -2.0, 2.0),
        ];
        check("concat", p, &mut leaves, &|t, v| {
            t.concat(&[v[1], v[0], v[2], v[0]])
        });
        check("rows", p, &mut leaves[1..2], &|t, v| t.rows(v[0], 2..11));
        check("overlapping rows", p, &mut leaves[1..2], &|t, v| {
            let (a, b) = (t.rows(v[0], 0..9), t.rows(v[0], 5..14));
            t.mul(a, b)
        });
        check("spread", p, &mut leaves[2..3], &|t, v| t.spread(v[0], 6));
        let mut column = [random(&mut rng, 19, 1, -2.0, 2.0)];
        check("broadcast", p, &mut column, &|t, v| t.broadcast(v[0], cols));
        let classes: Vec<u32> = (0..cols as u32).map(|j| (5 * j + 2) % 17).collect();
        check("select", p, &mut leaves[1..2], &|t, v| {
            let l = t.log_softmax(v[0]);
            t.select_log_prob(l, &classes)
        });
    }
}

#[test]
fn stopped_and_constant_variables_get_nothing() {
    let p = Parameters::new();
    let mut arena = Arena::new();
    let mut tape = Tape::new(&p, &mut arena);
    let leaf = tape.leaf(&Tensor::from_slice(2, 1, &[1.0, 2.0]));
    let square = tape.square(leaf);
    let stopped = tape.stop(square);
    let product = tape.mul(stopped, leaf);
    let loss = tape.sum(product);
    let mut gradients = Gradients::for_params(&p);
    tape.backward(loss, &mut gradients, &|_| true);
    // d(c·x)/dx with c = x² held fixed.
    assert_eq!(tape.grad(leaf), &[1.0, 4.0]);
    assert!(tape.grad(stopped).is_empty() && tape.grad(square).is_empty());
    let only_stopped = tape.sum(stopped);
    tape.backward(only_stopped, &mut gradients, &|_| true);
    assert!(tape.grad(leaf).is_empty());
}

#[test]
fn dense_layers() {
    let activations = [
        Activation::Identity,
        Activation::Elu,
        Activation::Tanh,
        Activation::Softplus,
    ];
    for activation in activations {
        for (inputs, outputs, batch) in [(1, 1, 1), (3, 5, 1), (7, 2, 4), (18, 33, 3)] {
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            let mut p = Parameters::new();
            let layer = Dense::new(&mut p, "layer", inputs, outputs, activation, &mut rng);
            let mut x = [random(&mut rng, inputs, batch, -1.0, 1.0)];
            if activation == Activation::Elu {
                away_from_elus_kink(&mut p, &layer, &x[0]);
            }
            check(&format!("dense {activation:?}"), &mut p, &mut x, &|t, v| {
                t.dense(&layer, v[0])
            });
        }
    }
}

/// ELU's second derivative jumps at 0, where differences are poor: move biases until no sum is near it.
fn away_from_elus_kink(p: &mut Parameters, layer: &Dense, x: &Tensor) {
    let linear = Dense {
        activation: Activation::Identity,
        ..*layer
    };
    for _ in 0..200 {
        let mut sums = Tensor::default();
        linear.infer(p, x, &mut sums);
        let mut moved = false;
        for j in 0..sums.cols() {
            for (i, sum) in sums.column(j).iter().enumerate() {
                if sum.abs() < 1.5 * STEP {
                    p.get_mut(layer.bias).data_mut()[i] += 2.0 * STEP;
                    moved = true;
                }
            }
        }
        if !moved {
            return;
        }
    }
    panic!("no biases away from the kink");
}

#[test]
fn softplus_deviations_have_a_floor_without_slope() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut p = Parameters::new();
    let layer = Dense::new(&mut p, "layer", 1, 1, Activation::Softplus, &mut rng);
    p.get_mut(layer.bias).fill(-50.0);
    let mut arena = Arena::new();
    let mut tape = Tape::new(&p, &mut arena);
    let x = tape.leaf(&Tensor::from_slice(1, 1, &[1.0]));
    let y = tape.dense(&layer, x);
    assert_eq!(tape.scalar(y), 1e-4);
    let mut gradients = Gradients::for_params(&p);
    tape.backward(y, &mut gradients, &|_| true);
    assert_eq!(gradients.get(layer.bias).data(), &[0.0]);
    assert_eq!(tape.grad(x), &[0.0]);
}

#[test]
fn a_whole_network_and_recurrence() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut p = Parameters::new();
    let mut mlp = Mlp::new(&mut p, "net", &[4, 9, 6, 3], Activation::Tanh, &mut rng);
    // Differences are poor at ELU's kink; ELU itself is checked layer by layer.
    for layer in &mut mlp.layers {
        layer.activation = Activation::Tanh;
    }
    let mut leaves = [random(&mut rng, 4, 5, -1.0, 1.0)];
    check("mlp", &mut p, &mut leaves, &|t, v| t.mlp(&mlp, v[0]));

    let mut p = Parameters::new();
    let cell = Gru::new(&mut p, "gru", 3, 5, &mut rng);
    let mut leaves = [
        random(&mut rng, 3, 4, -1.0, 1.0),
        random(&mut rng, 5, 4, -1.0, 1.0),
        random(&mut rng, 3, 4, -1.0, 1.0),
    ];
    check("gru, two steps", &mut p, &mut leaves, &|t, v| {
        let h = t.gru(&cell, v[0], v[1]);
        t.gru(&cell, v[2], h)
    });
}

#[test]
fn frozen_weights_still_pass_the_inputs_gradient() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut p = Parameters::new();
    let mlp = Mlp::new(&mut p, "net", &[4, 9, 6, 3], Activation::Identity, &mut rng);
    let cell = Gru::new(&mut p, "gru", 3, 4, &mut rng);
    let implant = p.add("implant", random(&mut rng, 4, 1, -1.0, 1.0));
    let x = random(&mut rng, 4, 7, -1.0, 1.0);
    let run = |wanted: &dyn Fn(ParamId) -> bool| {
        let mut arena = Arena::new();
        let mut gradients = Gradients::for_params(&p);
        let mut tape = Tape::new(&p, &mut arena);
        let x = tape.input(&x);
        let shift = tape.param(implant);
        let shift = tape.broadcast(shift, 7);
        let moved = tape.add(x, shift);
        let y = tape.mlp(&mlp, moved);
        let h = tape.gru(&cell, y, x);
        let squares = tape.square(h);
        let loss = tape.mean(squares);
        tape.backward(loss, &mut gradients, wanted);
        gradients
    };
    let all = run(&|_| true);
    let one = run(&|id| id == implant);
    assert_eq!(all.get(implant), one.get(implant));
    assert!(one.get(implant).data().iter().all(|g| *g != 0.0));
    for id in p.ids().filter(|id| *id != implant) {
        assert!(
            all.get(id).data().iter().any(|g| *g != 0.0),
            "{}",
            p.name(id)
        );
        assert!(
            one.get(id).data().iter().all(|g| g.to_bits() == 0),
            "{}",
            p.name(id)
        );
    }
}
