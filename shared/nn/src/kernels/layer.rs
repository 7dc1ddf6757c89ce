//! Loops with more than one output or more than one rule: a layer's bias and activation, and Adam's update.

use super::vectorised;
use crate::math::{elu as elu_of, larger, softplus as softplus_of, tanh as tanh_of};
use pulp::{Simd, WithSimd};

/// Adam's update of one tensor; `rate` already has both bias corrections' ratio in it, `eps` the second's.
#[allow(clippy::too_many_arguments)]
pub(crate) fn adam(
    value: &mut [f32],
    first: &mut [f32],
    second: &mut [f32],
    gradient: &[f32],
    beta1: f32,
    beta2: f32,
    rate: f32,
    second_correction: f32,
    eps: f32,
) {
    struct Work<'k> {
        value: &'k mut [f32],
        first: &'k mut [f32],
        second: &'k mut [f32],
        gradient: &'k [f32],
        numbers: [f32; 5],
    }
    #[inline(always)]
    fn run(p: &mut [f32], m: &mut [f32], v: &mut [f32], g: &[f32], numbers: [f32; 5]) {
        let [beta1, beta2, rate, correction, eps] = numbers;
        let n = p.len();
        let (m, v, g) = (&mut m[..n], &mut v[..n], &g[..n]);
        for i in 0..n {
            m[i] = (g[i] - m[i]).mul_add(1.0 - beta1, m[i]);
            v[i] = beta2.mul_add(v[i], (1.0 - beta2) * (g[i] * g[i]));
            let denominator = v[i].sqrt().mul_add(correction, eps);
            p[i] -= rate * m[i] / denominator;
        }
    }
    impl WithSimd for Work<'_> {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) {
            run(
                self.value,
                self.first,
                self.second,
                self.gradient,
                self.numbers,
            )
        }
    }
    vectorised(Work {
        value,
        first,
        second,
        gradient,
        numbers: [beta1, beta2, rate, second_correction, eps],
    })
}

/// What follows a product: adds a bias to every column and applies an activation.
pub(crate) fn bias_activation(out: &mut [f32], bias: &[f32], activation: crate::Activation) {
    use crate::{Activation, SMALLEST_DEVIATION};
    trait Function {
        fn of(x: f32) -> f32;
    }
    struct Identity;
    struct Elu;
    struct Tanh;
    struct Softplus;
    impl Function for Identity {
        #[inline(always)]
        fn of(x: f32) -> f32 {
            x
        }
    }
    impl Function for Elu {
        #[inline(always)]
        fn of(x: f32) -> f32 {
            elu_of(x)
        }
    }
    impl Function for Tanh {
        #[inline(always)]
        fn of(x: f32) -> f32 {
            tanh_of(x)
        }
    }
    impl Function for Softplus {
        #[inline(always)]
        fn of(x: f32) -> f32 {
            larger(softplus_of(x), SMALLEST_DEVIATION)
        }
    }
    struct Work<'k, F> {
        out: &'k mut [f32],
        bias: &'k [f32],
        function: std::marker::PhantomData<F>,
    }
    #[inline(always)]
    fn column<F: Function>(out: &mut [f32], bias: &[f32]) {
        let n = out.len();
        let bias = &bias[..n];
        for i in 0..n {
            out[i] = F::of(out[i] + bias[i]);
        }
    }
    impl<F: Function> WithSimd for Work<'_, F> {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) {
            for out in self.out.chunks_exact_mut(self.bias.len()) {
                column::<F>(out, self.bias);
            }
        }
    }
    fn go<F: Function>(out: &mut [f32], bias: &[f32]) {
        vectorised(Work {
            out,
            bias,
            function: std::marker::PhantomData::<F>,
        })
    }
    if bias.is_empty() {
        return;
    }
    match activation {
        Activation::Identity => go::<Identity>(out, bias),
        Activation::Elu => go::<Elu>(out, bias),
        Activation::Tanh => go::<Tanh>(out, bias),
        Activation::Softplus => go::<Softplus>(out, bias),
    }
}
