//! Gradients of anything on a tape against central differences.
#![allow(dead_code)] // Each test program uses its own part.

use nn::{Arena, Gradients, Parameters, Tape, Tensor, Var};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Step of the differences. With Richardson's extrapolation from two steps the error of truncation is O(h⁴), so that
/// the step can be wide enough for f32's rounding.
pub const STEP: f32 = 1.0 / 32.0;

/// Uniform numbers.
pub fn random(rng: &mut ChaCha8Rng, rows: usize, cols: usize, low: f32, high: f32) -> Tensor {
    let mut t = Tensor::new(rows, cols);
    for x in t.data_mut() {
        *x = low + (high - low) * rng.random::<f32>();
    }
    t
}

/// Loss = Σ weights ⊙ f(leaves), in f64 outside of the tape.
fn loss(p: &Parameters, leaves: &[Tensor], weights: &[f64], f: &Build) -> f64 {
    let mut arena = Arena::new();
    let mut tape = Tape::new(p, &mut arena);
    let vars: Vec<Var> = leaves.iter().map(|l| tape.leaf(l)).collect();
    let out = f(&mut tape, &vars);
    tape.value(out)
        .iter()
        .zip(weights)
        .map(|(a, w)| f64::from(*a) * w)
        .sum()
}

/// A computation on a tape, from leaves.
pub type Build<'f> = dyn Fn(&mut Tape, &[Var]) -> Var + 'f;

/// d loss / d number, by central differences at two steps.
fn difference(mut at: impl FnMut(f32) -> f64) -> f64 {
    let mut central = |h: f32| (at(h) - at(-h)) / (2.0 * f64::from(h));
    let (wide, narrow) = (central(STEP), central(STEP / 2.0));
    (4.0 * narrow - wide) / 3.0
}

/// `size`: the largest |weight · output|, whose rounding the differences divide by the step.
pub fn close(what: &str, found: f32, expected: f64, size: f64) {
    let error = (f64::from(found) - expected).abs();
    let rounding = 4.0 * size * f64::from(f32::EPSILON) / f64::from(STEP);
    assert!(
        error < 1e-3 * expected.abs() + 1e-4 + rounding,
        "{what}: gradient {found}, by differences {expected}"
    );
}

/// Compares all gradients of `f` with differences. The operation appears twice on the tape (the second time at half
/// weight), so that both the first and the later contributions to each gradient are exercised.
pub fn check(name: &str, p: &mut Parameters, leaves: &mut [Tensor], f: &Build) {
    let mut rng = ChaCha8Rng::seed_from_u64(77);
    let mut arena = Arena::new();
    let mut gradients = Gradients::for_params(p);
    let (weights, leaf_gradients, size) = {
        let mut tape = Tape::new(p, &mut arena);
        let vars: Vec<Var> = leaves.iter().map(|l| tape.leaf(l)).collect();
        let out = f(&mut tape, &vars);
        let (rows, cols) = tape.shape(out);
        let weights = random(&mut rng, rows, cols, -1.0, 1.0);
        let w = tape.input(&weights);
        let once = tape.mul(out, w);
        let again = f(&mut tape, &vars);
        let half = tape.scale(again, 0.5);
        let twice = tape.mul(half, w);
        let both = tape.add(once, twice);
        let total = tape.sum(both);
        tape.backward(total, &mut gradients, &|_| true);
        let grads: Vec<Vec<f32>> = vars.iter().map(|&v| tape.grad(v).to_vec()).collect();
        let weights: Vec<f64> = weights.data().iter().map(|w| 1.5 * f64::from(*w)).collect();
        let sizes = tape.value(out).iter().zip(&weights);
        let size = sizes
            .map(|(y, w)| (f64::from(*y) * w).abs())
            .fold(0.0, f64::max);
        (weights, grads, size)
    };
    for l in 0..leaves.len() {
        let length = leaves[l].data().len();
        assert_eq!(
            leaf_gradients[l].len(),
            length,
            "{name}: leaf {l} without gradient"
        );
        for i in 0..length {
            let old = leaves[l].data()[i];
            let expected = difference(|h| {
                leaves[l].data_mut()[i] = old + h;
                loss(p, leaves, &weights, f)
            });
            leaves[l].data_mut()[i] = old;
            close(
                &format!("{name}, leaf {l}, number {i}"),
                leaf_gradients[l][i],
                expected,
                size,
            );
        }
    }
    for id in p.ids() {
        for i in 0..p.get(id).data().len() {
            let old = p.get(id).data()[i];
            let expected = difference(|h| {
                p.get_mut(id).data_mut()[i] = old + h;
                loss(p, leaves, &weights, f)
            });
            p.get_mut(id).data_mut()[i] = old;
            let what = format!("{name}, {}, number {i}", p.name(id));
            close(&what, gradients.get(id).data()[i], expected, size);
        }
    }
}
