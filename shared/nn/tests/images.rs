//! Convolution, transposed convolution and categorical heads: values by hand, gradients against central differences, inference
//! against the tape.

mod support;

use nn::{Activation, Arena, Conv, Deconv, Parameters, Tape, Tensor, Windows};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::{check, random};

/// Windows that touch, overlap, leave gaps, and leave pixels over.
const GEOMETRIES: [Windows; 4] = [
    windows(6, 9, 2, 3, 3),
    windows(5, 7, 1, 3, 2),
    windows(4, 4, 3, 2, 2),
    windows(7, 6, 2, 2, 3),
];

const fn windows(
    height: usize,
    width: usize,
    channels: usize,
    kernel: usize,
    stride: usize,
) -> Windows {
    Windows {
        height,
        width,
        channels,
        kernel,
        stride,
    }
}

/// y[o, oy, ox] = b[o] + Σ_{c, ky, kx} W[o, c, ky, kx] x[c, oy s + ky, ox s + kx], as written in books.
#[test]
fn a_convolution_is_its_definition() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for w in GEOMETRIES {
        let mut p = Parameters::new();
        let out_channels = 4;
        let conv = Conv::new(
            &mut p,
            "conv",
            w,
            out_channels,
            Activation::Identity,
            &mut rng,
        );
        let x = random(&mut rng, w.image(), 3, -1.0, 1.0);
        let (mut scratch, mut out) = (Tensor::default(), Tensor::default());
        conv.infer(&p, &x, &mut scratch, &mut out);
        let (down, across) = w.grid();
        assert_eq!((out.rows(), out.cols()), (out_channels * down * across, 3));
        let (weight, bias) = (p.get(conv.layer.weight), p.get(conv.layer.bias));
        for j in 0..3 {
            for oy in 0..down {
                for ox in 0..across {
                    for o in 0..out_channels {
                        let mut sum = f64::from(bias.data()[o]);
                        for ky in 0..w.kernel {
                            for kx in 0..w.kernel {
                                for c in 0..w.channels {
                                    let (y, left) = (oy * w.stride + ky, ox * w.stride + kx);
                                    let at = (c * w.height + y) * w.width + left;
                                    let input = x.column(j)[at];
                                    let at = (c * w.kernel + ky) * w.kernel + kx;
                                    sum += f64::from(weight.column(at)[o]) * f64::from(input);
                                }
                            }
                        }
                        let found = out.column(j)[(oy * across + ox) * out_channels + o];
                        assert!((f64::from(found) - sum).abs() < 1e-5, "{found} {sum}");
                    }
                }
            }
        }
    }
}

/// ⟨conv(x), y⟩ = ⟨x, deconv(y)⟩ with the same weights and no biases: that is what "transposed" says.
#[test]
fn a_transposed_convolution_is_the_transpose() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for w in GEOMETRIES {
        let mut p = Parameters::new();
        let conv = Conv::new(&mut p, "conv", w, 4, Activation::Identity, &mut rng);
        let deconv = Deconv::new(&mut p, "deconv", w, 4, &mut rng);
        p.get_mut(conv.layer.bias).fill(0.0);
        p.get_mut(deconv.bias).fill(0.0);
        for at in 0..w.patch() {
            for o in 0..4 {
                let value = p.get(conv.layer.weight).column(at)[o];
                p.get_mut(deconv.weight).column_mut(o)[at] = value;
            }
        }
        let x = random(&mut rng, w.image(), 1, -1.0, 1.0);
        let y = random(&mut rng, conv.output(), 1, -1.0, 1.0);
        let mut scratch = Tensor::default();
        let (mut there, mut back) = (Tensor::default(), Tensor::default());
        conv.infer(&p, &x, &mut scratch, &mut there);
        deconv.infer(&p, &y, &mut scratch, &mut back);
        let dot = |a: &Tensor, b: &Tensor| -> f64 {
            a.data()
                .iter()
                .zip(b.data())
                .map(|(a, b)| f64::from(*a) * f64::from(*b))
                .sum()
        };
        assert!((dot(&there, &y) - dot(&x, &back)).abs() < 1e-4);
    }
}

#[test]
fn gradients_of_convolutions() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for w in GEOMETRIES {
        let mut p = Parameters::new();
        let conv = Conv::new(&mut p, "conv", w, 3, Activation::Tanh, &mut rng);
        let mut x = [random(&mut rng, w.image(), 2, -1.0, 1.0)];
        check(&format!("conv {w:?}"), &mut p, &mut x, &|t, v| {
            t.conv(&conv, v[0])
        });
        let mut p = Parameters::new();
        let deconv = Deconv::new(&mut p, "deconv", w, 3, &mut rng);
        let mut x = [random(&mut rng, deconv.input(), 2, -1.0, 1.0)];
        check(&format!("deconv {w:?}"), &mut p, &mut x, &|t, v| {
            t.deconv(&deconv, v[0])
        });
    }
    let mut x = [random(&mut rng, 6, 4, -1.0, 1.0)];
    check("columns", &mut Parameters::new(), &mut x, &|t, v| {
        let (a, b) = (t.columns(v[0], 0..3), t.columns(v[0], 1..4));
        let product = t.mul(a, b);
        t.join(&[product, v[0], a])
    });
    check("reshape", &mut Parameters::new(), &mut x, &|t, v| {
        let y = t.reshape(v[0], 3, 8);
        t.mul(y, y)
    });
}

#[test]
fn inference_is_the_tapes() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for w in GEOMETRIES {
        let mut p = Parameters::new();
        let conv = Conv::new(&mut p, "conv", w, 4, Activation::Elu, &mut rng);
        let deconv = Deconv::new(&mut p, "deconv", w, 4, &mut rng);
        let x = random(&mut rng, w.image(), 5, -1.0, 1.0);
        let mut scratch = Tensor::default();
        let (mut features, mut back) = (Tensor::default(), Tensor::default());
        conv.infer(&p, &x, &mut scratch, &mut features);
        deconv.infer(&p, &features, &mut scratch, &mut back);
        let mut arena = Arena::new();
        let mut tape = Tape::new(&p, &mut arena);
        let on_tape = tape.input(&x);
        let on_tape = tape.conv(&conv, on_tape);
        assert_eq!(tape.value(on_tape), features.data());
        let on_tape = tape.deconv(&deconv, on_tape);
        assert_eq!(tape.value(on_tape), back.data());
        // And a batch is its columns.
        for j in 0..5 {
            let one = Tensor::from_slice(w.image(), 1, x.column(j));
            let mut alone = Tensor::default();
            conv.infer(&p, &one, &mut scratch, &mut alone);
            assert_eq!(alone.data(), features.column(j));
        }
    }
}

#[test]
fn categorical_heads() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for (choices, cols) in [(2, 1), (4, 5), (7, 3)] {
        let classes: Vec<u32> = (0..cols as u32).map(|j| (3 * j + 1) % choices).collect();
        let mut logits = [random(&mut rng, choices as usize, cols, -2.0, 2.0)];
        let p = &mut Parameters::new();
        check("nll", p, &mut logits, &|t, v| {
            t.categorical_nll(v[0], &classes)
        });
        check("entropy", p, &mut logits, &|t, v| {
            t.categorical_entropy(v[0])
        });
        let mut arena = Arena::new();
        let mut tape = Tape::new(p, &mut arena);
        let v = tape.input(&logits[0]);
        let (nll, entropy) = (
            tape.categorical_nll(v, &classes),
            tape.categorical_entropy(v),
        );
        let mut log = logits[0].clone();
        nn::log_softmax_in_place(&mut log);
        for j in 0..cols {
            let log = log.column(j);
            let total: f64 = log.iter().map(|l| f64::from(*l).exp()).sum();
            assert!((total - 1.0).abs() < 1e-6);
            let found = tape.value(nll)[j];
            assert!((found + log[classes[j] as usize]).abs() < 1e-6);
            let expected: f64 = -log
                .iter()
                .map(|l| f64::from(*l).exp() * f64::from(*l))
                .sum::<f64>();
            assert!((f64::from(tape.value(entropy)[j]) - expected).abs() < 1e-6);
        }
    }
}
