//! Elementwise loops, compiled for AVX2 and AVX-512 beside the portable version and chosen at run time.
//!
//! `first` says whether a kernel replaces its output or adds to it: the first contribution to a gradient replaces, so
//! that gradients need not be zeroed. Sums run in a fixed order, the same for every instruction set.

mod layer;
mod sums;

pub(crate) use layer::{adam, bias_activation};
pub(crate) use sums::{column_sums, log_softmax, row_sums, spread_row, sum_all, sum_of_squares};

use crate::math::{
    elu as elu_of, exp as exp_of, expm1_nonpositive, larger, ln as ln_of, sigmoid as sigmoid_of,
    smaller, softplus as softplus_of, tanh as tanh_of, tanh_log_slope,
};
use crate::vectors;
use pulp::{Simd, WithSimd};

/// Runs a loop with the vectors chosen, usually the widest that the machine has.
#[inline]
pub(crate) fn vectorised<W: WithSimd>(work: W) -> W::Output {
    vectors::arch(vectors::chosen()).dispatch(work)
}

/// `fn name(first, out, inputs…, scalars…)`: out ← (out +) body, element by element.
macro_rules! elementwise {
    ($( $(#[$doc:meta])* $name:ident ( $($x:ident),* ; $($s:ident),* ) $body:expr; )*) => { $(
        $(#[$doc])*
        #[allow(clippy::too_many_arguments)]
        pub(crate) fn $name(first: bool, out: &mut [f32], $($x: &[f32],)* $($s: f32,)*) {
            struct Work<'k> { first: bool, out: &'k mut [f32], $($x: &'k [f32],)* $($s: f32,)* }
            #[inline(always)]
            #[allow(clippy::too_many_arguments)]
            fn replace(out: &mut [f32], $($x: &[f32],)* $($s: f32,)*) {
                let n = out.len();
                $(let $x = &$x[..n];)*
                for i in 0..n {
                    $(let $x = $x[i];)*
                    out[i] = $body;
                }
            }
            #[inline(always)]
            #[allow(clippy::too_many_arguments)]
            fn add(out: &mut [f32], $($x: &[f32],)* $($s: f32,)*) {
                let n = out.len();
                $(let $x = &$x[..n];)*
                for i in 0..n {
                    $(let $x = $x[i];)*
                    out[i] += $body;
                }
            }
            impl WithSimd for Work<'_> {
                type Output = ();
                #[inline(always)]
                fn with_simd<S: Simd>(self, _: S) {
                    if self.first {
                        replace(self.out, $(self.$x,)* $(self.$s,)*)
                    } else {
                        add(self.out, $(self.$x,)* $(self.$s,)*)
                    }
                }
            }
            vectorised(Work { first, out, $($x,)* $($s,)* })
        }
    )* };
}

/// `fn name(out, inputs…, scalars…)`: out ← body, where the body reads out's old element under the given name.
macro_rules! in_place {
    ($( $(#[$doc:meta])* $name:ident [$old:ident] ( $($x:ident),* ; $($s:ident),* ) $body:expr; )*) => { $(
        $(#[$doc])*
        pub(crate) fn $name(out: &mut [f32], $($x: &[f32],)* $($s: f32,)*) {
            struct Work<'k> { out: &'k mut [f32], $($x: &'k [f32],)* $($s: f32,)* }
            #[inline(always)]
            fn run(out: &mut [f32], $($x: &[f32],)* $($s: f32,)*) {
                let n = out.len();
                $(let $x = &$x[..n];)*
                for i in 0..n {
                    let $old = out[i];
                    $(let $x = $x[i];)*
                    out[i] = $body;
                }
            }
            impl WithSimd for Work<'_> {
                type Output = ();
                #[inline(always)]
                fn with_simd<S: Simd>(self, _: S) {
                    run(self.out, $(self.$x,)* $(self.$s,)*)
                }
            }
            vectorised(Work { out, $($x,)* $($s,)* })
        }
    )* };
}

/// ln √(2π).
const HALF_LN_TAU: f32 = 0.918_938_5;

elementwise! {
    copy(x;) x;
    scale(x; s) x * s;
    offset(x; s) x + s;
    square(x;) x * x;
    exp(x;) exp_of(x);
    ln(x;) ln_of(x);
    tanh(x;) tanh_of(x);
    sigmoid(x;) sigmoid_of(x);
    softplus(x;) softplus_of(x);
    elu(x;) elu_of(x);
    abs(x;) x.abs();
    clamp(x; low, high) smaller(larger(x, low), high);
    tanh_log(x;) tanh_log_slope(x);

    // Derivatives: g is the output's gradient, x the input, y the output.
    square_d(g, x;) 2.0 * x * g;
    exp_d(g, y;) g * y;
    ln_d(g, x;) g / x;
    tanh_d(g, y;) g * (1.0 - y * y);
    sigmoid_d(g, y;) g * y * (1.0 - y);
    softplus_d(g, x;) g * sigmoid_of(x);
    elu_d(g, y;) if y > 0.0 { g } else { g * (y + 1.0) };
    abs_d(g, x;) if x > 0.0 { g } else if x < 0.0 { -g } else { 0.0 };
    clamp_d(g, x; low, high) if x >= low && x <= high { g } else { 0.0 };
    tanh_log_d(g, x;) -2.0 * g * tanh_of(x);

    sum2(a, b;) a + b;
    difference(a, b;) a - b;
    product(a, b;) a * b;
    quotient(a, b;) a / b;
    minimum(a, b;) smaller(a, b);
    maximum(a, b;) larger(a, b);
    quotient_d_below(g, y, b;) -g * y / b;
    // At a tie each side gets half, as in PyTorch.
    minimum_d(g, a, b;) if a < b { g } else if a > b { 0.0 } else { 0.5 * g };
    maximum_d(g, a, b;) if a > b { g } else if a < b { 0.0 } else { 0.5 * g };

    // z = μ + σ ε
    sample(mean, deviation, noise;) deviation.mul_add(noise, mean);

    // ln N(x; μ, σ) of one feature.
    log_density(x, mean, deviation;) {
        let u = (x - mean) / deviation;
        (-0.5 * u).mul_add(u, -ln_of(deviation)) - HALF_LN_TAU
    };
    log_density_d_mean(g, x, mean, deviation; sign) {
        sign * g * (x - mean) / (deviation * deviation)
    };
    log_density_d_deviation(g, x, mean, deviation;) {
        let u = (x - mean) / deviation;
        g * u.mul_add(u, -1.0) / deviation
    };

    // KL[N(μq, σq) ‖ N(μp, σp)] of one feature: ln(σp/σq) + (σq² + (μq − μp)²)/(2 σp²) − ½.
    kl(mean_q, dev_q, mean_p, dev_p;) {
        let inverse = 1.0 / dev_p;
        let ratio = dev_q * inverse;
        let u = (mean_q - mean_p) * inverse;
        0.5 * ratio.mul_add(ratio, u.mul_add(u, -1.0)) - ln_of(ratio)
    };
    kl_d_mean(g, mean_q, mean_p, dev_p; sign) sign * g * (mean_q - mean_p) / (dev_p * dev_p);
    kl_d_dev_q(g, dev_q, dev_p;) g * (dev_q / (dev_p * dev_p) - 1.0 / dev_q);
    kl_d_dev_p(g, mean_q, dev_q, mean_p, dev_p;) {
        let inverse = 1.0 / dev_p;
        let ratio = dev_q * inverse;
        let u = (mean_q - mean_p) * inverse;
        -g * inverse * ratio.mul_add(ratio, u.mul_add(u, -1.0))
    };

    // log-softmax: dx = g − eʸ Σg
    log_softmax_d(g, y; total) exp_of(y).mul_add(-total, g);

    // GRU (see gru.rs): h' = (1 − z) n + z h
    gru_mix(z, n, h;) (h - n).mul_add(z, n);
    gru_d_candidate(g, z, n;) g * (1.0 - z) * (1.0 - n * n);
    gru_d_update(g, z, n, h;) g * (h - n) * z * (1.0 - z);
    gru_d_reset(dn, hn, r;) dn * hn * r * (1.0 - r);
}

in_place! {
    /// p ← p + rate (q − p)
    lerp[p](q; rate) (q - p).mul_add(rate, p);
    multiply_by[x](; factor) x * factor;
    /// Gradients through an activation, from its output.
    elu_back[g](y;) if y > 0.0 { g } else { g * (y + 1.0) };
    tanh_back[g](y;) g * (1.0 - y * y);
    /// softplus' (x) = 1 − e^(−softplus x); nothing where the floor holds.
    softplus_back[g](y; floor) {
        // With y > 15 the slope is 1 to f32's precision; `expm1` itself saturates.
        if y > floor { -g * expm1_nonpositive(-y) } else { 0.0 }
    };
    /// max(ln(1 + eˣ), floor)
    softplus_floor[x](; floor) larger(softplus_of(x), floor);
    sigmoid_add[a](b;) sigmoid_of(a + b);
    sigmoid_all[x](;) sigmoid_of(x);
    /// n = tanh(a + r · hn)
    gru_candidate[a](r, hn;) tanh_of(r.mul_add(hn, a));
}
