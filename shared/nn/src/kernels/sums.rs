//! Sums over rows, columns and everything, and what needs them; in a fixed order, the same for every instruction set.

use super::vectorised;
use crate::math::{exp as exp_of, larger, ln as ln_of};
use crate::tensor::LANES;
use pulp::{Simd, WithSimd};

/// Σ x in a fixed order: 16 interleaved sums, then pairwise.
#[inline(always)]
fn sum_lanes(x: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    let chunks = x.chunks_exact(LANES);
    for (lane, value) in lanes.iter_mut().zip(chunks.remainder()) {
        *lane = *value;
    }
    for chunk in chunks {
        for l in 0..LANES {
            lanes[l] += chunk[l];
        }
    }
    let mut width = LANES / 2;
    while width > 0 {
        for l in 0..width {
            lanes[l] += lanes[l + width];
        }
        width /= 2;
    }
    lanes[0]
}

/// out[j] ← Σᵢ x[i, j], for a rows × out.len() matrix.
pub(crate) fn column_sums(out: &mut [f32], x: &[f32], rows: usize) {
    struct Work<'k>(&'k mut [f32], &'k [f32], usize);
    impl WithSimd for Work<'_> {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) {
            for (out, column) in self.0.iter_mut().zip(self.1.chunks_exact(self.2)) {
                *out = sum_lanes(column);
            }
        }
    }
    if rows == 0 {
        out.fill(0.0);
    } else {
        vectorised(Work(out, x, rows));
    }
}

/// out[i] ← (out[i] +) Σⱼ x[i, j], for an out.len() × cols matrix.
pub(crate) fn row_sums(first: bool, out: &mut [f32], x: &[f32]) {
    struct Work<'k>(&'k mut [f32], &'k [f32]);
    #[inline(always)]
    fn four(out: &mut [f32], x: &[f32]) {
        let n = out.len();
        let (a, rest) = x.split_at(n);
        let (b, rest) = rest.split_at(n);
        let (c, d) = rest.split_at(n);
        let d = &d[..n];
        for i in 0..n {
            out[i] += (a[i] + b[i]) + (c[i] + d[i]);
        }
    }
    #[inline(always)]
    fn one(out: &mut [f32], x: &[f32]) {
        let n = out.len();
        let x = &x[..n];
        for i in 0..n {
            out[i] += x[i];
        }
    }
    impl WithSimd for Work<'_> {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) {
            let Work(out, x) = self;
            if out.len() == 1 {
                out[0] += sum_lanes(x);
                return;
            }
            let blocks = x.chunks_exact(4 * out.len());
            let rest = blocks.remainder();
            for block in blocks {
                four(out, block);
            }
            for column in rest.chunks_exact(out.len()) {
                one(out, column);
            }
        }
    }
    if first {
        out.fill(0.0);
    }
    if !out.is_empty() {
        vectorised(Work(out, x));
    }
}

/// out[i, j] ← (out +) s · x[j]: a row repeated over all rows.
pub(crate) fn spread_row(first: bool, out: &mut [f32], x: &[f32], rows: usize) {
    if rows == 0 {
        return;
    }
    for (column, &value) in out.chunks_exact_mut(rows).zip(x) {
        if first {
            column.fill(value);
        } else {
            column.iter_mut().for_each(|y| *y += value);
        }
    }
}

/// Σ x over everything, in f64 between blocks.
pub(crate) fn sum_all(x: &[f32]) -> f64 {
    struct Work<'k>(&'k [f32]);
    impl WithSimd for Work<'_> {
        type Output = f64;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> f64 {
            self.0
                .chunks(256)
                .map(|block| f64::from(sum_lanes(block)))
                .sum()
        }
    }
    vectorised(Work(x))
}

/// Σ x² over everything, in f64 between blocks.
pub(crate) fn sum_of_squares(x: &[f32]) -> f64 {
    struct Work<'k>(&'k [f32]);
    impl WithSimd for Work<'_> {
        type Output = f64;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> f64 {
            let mut squares = [0.0_f32; 256];
            self.0
                .chunks(256)
                .map(|block| {
                    let squares = &mut squares[..block.len()];
                    for i in 0..block.len() {
                        squares[i] = block[i] * block[i];
                    }
                    f64::from(sum_lanes(squares))
                })
                .sum()
        }
    }
    vectorised(Work(x))
}

/// One column's log-softmax: out ← x − max − ln Σ e^(x − max).
pub(crate) fn log_softmax(out: &mut [f32], x: &[f32], rows: usize) {
    struct Work<'k>(&'k mut [f32], &'k [f32], usize);
    #[inline(always)]
    fn column(out: &mut [f32], x: &[f32]) {
        let largest = x.iter().fold(f32::NEG_INFINITY, |a, &b| larger(a, b));
        let n = out.len();
        let x = &x[..n];
        for i in 0..n {
            out[i] = exp_of(x[i] - largest);
        }
        let log = ln_of(sum_lanes(out));
        for i in 0..n {
            out[i] = x[i] - largest - log;
        }
    }
    impl WithSimd for Work<'_> {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) {
            let Work(out, x, rows) = self;
            for (out, x) in out.chunks_exact_mut(rows).zip(x.chunks_exact(rows)) {
                column(out, x);
            }
        }
    }
    if rows > 0 {
        vectorised(Work(out, x, rows));
    }
}
