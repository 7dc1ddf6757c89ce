//! Elementary functions on single numbers, free of branches and calls so that the compiler turns loops over them into
//! vector code: exp, expm1, ln, log1p, sine and cosine. Polynomials after Cephes (S. Moshier), errors about 1–2 ulp.
//!
//! Comparisons are written so that NaN passes through. Every multiplication that feeds an addition is an explicit
//! `mul_add`: the result is the same on every machine, vectorised or not.

use std::f32::consts::{LN_2, LOG2_E};

/// Adding this rounds a small number to an integer in the low bits of the significand.
const ROUNDER: f32 = 12_582_912.0; // 1.5 · 2²³
const LN_2_HIGH: f32 = 0.693_359_4; // 355/512, exact in few bits
const LN_2_LOW: f32 = -2.121_944_4e-4;

#[inline(always)]
pub(crate) fn larger(a: f32, b: f32) -> f32 {
    if a < b { b } else { a }
}

#[inline(always)]
pub(crate) fn smaller(a: f32, b: f32) -> f32 {
    if a > b { b } else { a }
}

/// eʳ − 1 for |r| ≤ ln2/2.
#[inline(always)]
fn expm1_core(r: f32) -> f32 {
    let p = 1.987_569_1e-4_f32
        .mul_add(r, 1.398_199_9e-3)
        .mul_add(r, 8.333_452e-3)
        .mul_add(r, 4.166_579_6e-2)
        .mul_add(r, 1.666_666_5e-1)
        .mul_add(r, 0.5);
    (p * r).mul_add(r, r)
}

/// x = n ln2 + r: gives (n + ROUNDER, r).
#[inline(always)]
fn reduce(x: f32) -> (f32, f32) {
    let shifted = x.mul_add(LOG2_E, ROUNDER);
    let n = shifted - ROUNDER;
    let r = n.mul_add(-LN_2_HIGH, x);
    (shifted, n.mul_add(-LN_2_LOW, r))
}

/// 2ⁿ from n + ROUNDER, for −126 ≤ n ≤ 127.
#[inline(always)]
fn power_of_two(shifted: f32) -> f32 {
    f32::from_bits((shifted.to_bits() << 23).wrapping_add(0x3F80_0000))
}

/// eˣ over the whole range: 0 and ∞ where f32 under- and overflows.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    let x = smaller(larger(x, -104.0), 89.0);
    let (shifted, r) = reduce(x);
    let n = shifted.to_bits().wrapping_sub(ROUNDER.to_bits()) as i32;
    // In two factors, since 2ⁿ itself may leave the range although the product does not.
    let half = n >> 1;
    let first = f32::from_bits(((half + 127) << 23) as u32);
    let second = f32::from_bits(((n - half + 127) << 23) as u32);
    let p = expm1_core(r) + 1.0;
    p * first * second
}

/// eˣ for x ≤ 0; below −87 it stays at e⁻⁸⁷.
#[inline(always)]
pub(crate) fn exp_nonpositive(x: f32) -> f32 {
    let (shifted, r) = reduce(larger(x, -87.0));
    let scale = power_of_two(shifted);
    scale.mul_add(expm1_core(r), scale)
}

/// eˣ − 1 for x ≤ 0, without cancellation near 0.
#[inline(always)]
pub(crate) fn expm1_nonpositive(x: f32) -> f32 {
    let (shifted, r) = reduce(larger(x, -87.0));
    let scale = power_of_two(shifted);
    scale.mul_add(expm1_core(r), scale - 1.0)
}

/// ln(1 + f) for √½ − 1 ≤ f ≤ √2 − 1, plus e ln2.
#[inline(always)]
fn ln_core(f: f32, e: f32) -> f32 {
    let p = 7.037_683_6e-2_f32
        .mul_add(f, -1.151_461e-1)
        .mul_add(f, 1.167_699_9e-1)
        .mul_add(f, -1.242_014_1e-1)
        .mul_add(f, 1.424_932_3e-1)
        .mul_add(f, -1.666_805_8e-1)
        .mul_add(f, 2.000_071_5e-1)
        .mul_add(f, -2.499_999_4e-1)
        .mul_add(f, 3.333_333e-1);
    let square = f * f;
    let mut y = f * square * p;
    y = e.mul_add(LN_2_LOW, y);
    y = square.mul_add(-0.5, y);
    e.mul_add(LN_2_HIGH, f + y)
}

/// ln x; −∞ at 0, NaN below.
#[inline(always)]
pub(crate) fn ln(x: f32) -> f32 {
    let tiny = x < f32::MIN_POSITIVE;
    let scaled = if tiny { x * 8_388_608.0 } else { x };
    let bits = scaled.to_bits();
    // Exponent such that the significand lies in [√½, √2): 0x3F3504F3 is √½.
    let offset = bits.wrapping_sub(0x3F35_04F3);
    let exponent = (offset as i32) >> 23;
    let significand = f32::from_bits(bits.wrapping_sub((exponent << 23) as u32));
    let e = exponent as f32 - if tiny { 23.0 } else { 0.0 };
    let y = ln_core(significand - 1.0, e);
    let y = if x == f32::INFINITY { x } else { y };
    let y = if x == 0.0 { f32::NEG_INFINITY } else { y };
    // Written so that NaN, too, ends here.
    if x >= 0.0 { y } else { f32::NAN }
}

/// ln(1 + e) for 0 ≤ e ≤ 1, accurate for small e.
#[inline(always)]
pub(crate) fn log1p_unit(e: f32) -> f32 {
    let high = e > std::f32::consts::SQRT_2 - 1.0;
    let f = if high { (e - 1.0) * 0.5 } else { e };
    ln_core(f, if high { 1.0 } else { 0.0 })
}

/// ln(1 + eˣ), without overflow or loss at either end.
#[inline(always)]
pub(crate) fn softplus(x: f32) -> f32 {
    larger(x, 0.0) + log1p_unit(exp_nonpositive(-x.abs()))
}

/// 1/(1 + e⁻ˣ).
#[inline(always)]
pub(crate) fn sigmoid(x: f32) -> f32 {
    let e = exp_nonpositive(-x.abs());
    let d = 1.0 / (1.0 + e);
    if x < 0.0 { e * d } else { d }
}

/// tanh x = −t/(2 + t) with t = e^(−2|x|) − 1, with x's sign.
#[inline(always)]
pub(crate) fn tanh(x: f32) -> f32 {
    let t = expm1_nonpositive(-2.0 * x.abs());
    (-t / (2.0 + t)).copysign(x)
}

/// x where positive, eˣ − 1 elsewhere.
#[inline(always)]
pub(crate) fn elu(x: f32) -> f32 {
    let negative = expm1_nonpositive(smaller(x, 0.0));
    if x > 0.0 { x } else { negative }
}

/// Sine and cosine of 2π · turns, for 0 ≤ turns ≤ 1.
#[inline(always)]
pub(crate) fn sin_cos_turns(turns: f32) -> (f32, f32) {
    let shifted = turns.mul_add(4.0, ROUNDER);
    let quarter = shifted.to_bits() & 3;
    let rest = (shifted - ROUNDER).mul_add(-0.25, turns);
    let a = rest * std::f32::consts::TAU;
    let square = a * a;
    let s = (-1.951_529_6e-4_f32)
        .mul_add(square, 8.332_161e-3)
        .mul_add(square, -1.666_665_5e-1);
    let sine = (s * square).mul_add(a, a);
    let c = 2.443_315_7e-5_f32
        .mul_add(square, -1.388_731_6e-3)
        .mul_add(square, 4.166_664_6e-2);
    let cosine = (c * square).mul_add(square, square.mul_add(-0.5, 1.0));
    let (s, c) = if quarter & 1 == 0 {
        (sine, cosine)
    } else {
        (cosine, sine)
    };
    // Quarters 0..4: (s, c), (c, −s), (−s, −c), (−c, s), as signs and exchanges.
    let sine_sign = (quarter & 2) << 30;
    let cosine_sign = ((quarter + 1) & 2) << 30;
    (
        f32::from_bits(s.to_bits() ^ sine_sign),
        f32::from_bits(c.to_bits() ^ cosine_sign),
    )
}

/// Σ log(1 − tanh²u) term by term: 2 (ln2 − u − softplus(−2u)).
#[inline(always)]
pub(crate) fn tanh_log_slope(u: f32) -> f32 {
    // Symmetric in u: ln2 − |u| − log1p(e^(−2|u|)) has no cancellation for large |u| of either sign.
    let a = u.abs();
    2.0 * (LN_2 - a - log1p_unit(exp_nonpositive(-2.0 * a)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Distance in units of the reference's last place (of the smallest normal number, below that).
    fn ulps(value: f32, exact: f64) -> f64 {
        let place = (exact.abs() as f32).max(f32::MIN_POSITIVE);
        let ulp = f64::from(f32::from_bits(place.to_bits() + 1)) - f64::from(place);
        (f64::from(value) - exact).abs() / ulp
    }

    /// The largest error over numbers spread evenly, and over numbers spread evenly in magnitude.
    fn worst(low: f32, high: f32, f: impl Fn(f32) -> f32, exact: impl Fn(f64) -> f64) -> f64 {
        let count = 200_000;
        let even = (0..=count).map(|i| low + (high - low) * i as f32 / count as f32);
        let magnitudes = (0..=count)
            .map(|i| 1e-9_f32 * 1e12_f32.powf(i as f32 / count as f32))
            .flat_map(|x| [x, -x])
            .filter(|x| (low..=high).contains(x));
        even.chain(magnitudes)
            .map(|x| ulps(f(x), exact(f64::from(x))))
            .fold(0.0, f64::max)
    }

    #[test]
    fn exponentials_and_logarithms_are_within_two_ulp() {
        assert!(worst(-87.0, 88.7, exp, f64::exp) < 2.0);
        assert!(worst(-87.0, 0.0, exp_nonpositive, f64::exp) < 2.0);
        assert!(worst(-20.0, 0.0, expm1_nonpositive, f64::exp_m1) < 2.0);
        assert!(worst(1e-9, 1e3, ln, f64::ln) < 2.0);
        assert!(worst(0.0, 1.0, log1p_unit, f64::ln_1p) < 2.0);
    }

    #[test]
    fn activations_are_within_a_few_ulp() {
        let exact_sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
        let exact_softplus = |x: f64| x.max(0.0) + (-x.abs()).exp().ln_1p();
        let exact_elu = |x: f64| if x > 0.0 { x } else { x.exp_m1() };
        assert!(worst(-80.0, 80.0, sigmoid, exact_sigmoid) < 4.0);
        assert!(worst(-80.0, 80.0, softplus, exact_softplus) < 4.0);
        assert!(worst(-20.0, 20.0, tanh, f64::tanh) < 4.0);
        assert!(worst(-20.0, 20.0, elu, exact_elu) < 2.0);
        let exact_slope = |u: f64| 2.0 * (2.0_f64.ln() - u.abs() - (-2.0 * u.abs()).exp().ln_1p());
        let errors = (-40_000..=40_000).map(|i| {
            let u = i as f32 * 1e-3;
            f64::from(tanh_log_slope(u)) - exact_slope(f64::from(u))
        });
        // Absolute where it passes zero, relative for large |u|.
        assert!(errors.map(f64::abs).fold(0.0, f64::max) < 8e-6);
    }

    #[test]
    fn extreme_inputs() {
        assert_eq!(exp(1000.0), f32::INFINITY);
        assert_eq!(exp(-1000.0), 0.0);
        assert_eq!(exp(f32::NEG_INFINITY), 0.0);
        assert_eq!(ln(0.0), f32::NEG_INFINITY);
        assert_eq!(ln(f32::INFINITY), f32::INFINITY);
        assert!(ln(-1.0).is_nan());
        assert!(ulps(ln(1e-40), f64::from(1e-40_f32).ln()) < 2.0);
        assert_eq!(softplus(1e30), 1e30);
        assert!(softplus(-1e30) >= 0.0 && softplus(-1e30) < 1e-30);
        assert_eq!((sigmoid(1e30), tanh(1e30), tanh(-1e30)), (1.0, 1.0, -1.0));
        assert_eq!((elu(1e30), elu(-1e30)), (1e30, -1.0));
        assert!(tanh_log_slope(1e10).is_finite());
        for f in [exp, ln, softplus, sigmoid, tanh, elu, tanh_log_slope] {
            assert!(f(f32::NAN).is_nan());
        }
    }

    #[test]
    fn sine_and_cosine() {
        for i in 0..=1_000_000 {
            let turns = i as f32 / 1_000_000.0;
            let (s, c) = sin_cos_turns(turns);
            let (es, ec) = (std::f64::consts::TAU * f64::from(turns)).sin_cos();
            assert!((f64::from(s) - es).abs() < 1.5e-7, "sine of {turns} turns");
            assert!(
                (f64::from(c) - ec).abs() < 1.5e-7,
                "cosine of {turns} turns"
            );
        }
    }
}
