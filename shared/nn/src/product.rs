//! Matrix products through faer, sequential; one-column products by a kernel of our own.

use crate::kernels::vectorised;
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use pulp::{Simd, WithSimd};

fn accumulation(first: bool) -> Accum {
    if first { Accum::Replace } else { Accum::Add }
}

/// y ← (y +) W x for W out × in and x in × batch, all column-major.
pub(crate) fn weight_times(
    first: bool,
    y: &mut [f32],
    weight: &[f32],
    x: &[f32],
    output: usize,
    input: usize,
    batch: usize,
) {
    if batch == 1 {
        vectorised(Column {
            first,
            y: &mut y[..output],
            weight: &weight[..output * input],
            x: &x[..input],
        });
        return;
    }
    matmul(
        MatMut::from_column_major_slice_mut(y, output, batch),
        accumulation(first),
        MatRef::from_column_major_slice(weight, output, input),
        MatRef::from_column_major_slice(x, input, batch),
        1.0,
        Par::Seq,
    );
}

/// dx ← (dx +) Wᵀ dy.
pub(crate) fn weight_transposed_times(
    first: bool,
    dx: &mut [f32],
    weight: &[f32],
    dy: &[f32],
    output: usize,
    input: usize,
    batch: usize,
) {
    matmul(
        MatMut::from_column_major_slice_mut(dx, input, batch),
        accumulation(first),
        MatRef::from_column_major_slice(weight, output, input).transpose(),
        MatRef::from_column_major_slice(dy, output, batch),
        1.0,
        Par::Seq,
    );
}

/// dW ← dW + dy xᵀ.
pub(crate) fn add_outer(
    dw: &mut [f32],
    dy: &[f32],
    x: &[f32],
    output: usize,
    input: usize,
    batch: usize,
) {
    matmul(
        MatMut::from_column_major_slice_mut(dw, output, input),
        Accum::Add,
        MatRef::from_column_major_slice(dy, output, batch),
        MatRef::from_column_major_slice(x, input, batch).transpose(),
        1.0,
        Par::Seq,
    );
}

/// y ← (y +) W x for a single column, summed over inputs in their order as the matrix product does.
struct Column<'a> {
    first: bool,
    y: &'a mut [f32],
    weight: &'a [f32],
    x: &'a [f32],
}

/// Rows whose sums stay in registers: four AVX-512 vectors.
const BLOCK: usize = 64;

#[inline(always)]
fn column_block(sums: &mut [f32; BLOCK], weight: &[f32], x: &[f32], rows: usize, from: usize) {
    for (k, &x) in x.iter().enumerate() {
        let w: &[f32; BLOCK] = weight[k * rows + from..][..BLOCK]
            .try_into()
            .unwrap_or(&[0.0; BLOCK]);
        for i in 0..BLOCK {
            sums[i] = w[i].mul_add(x, sums[i]);
        }
    }
}

impl WithSimd for Column<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            first,
            y,
            weight,
            x,
        } = self;
        let rows = y.len();
        let mut from = 0;
        while from < rows {
            let count = BLOCK.min(rows - from);
            let mut sums = [0.0_f32; BLOCK];
            if count == BLOCK {
                column_block(&mut sums, weight, x, rows, from);
            } else {
                for (k, &x) in x.iter().enumerate() {
                    let w = &weight[k * rows + from..][..count];
                    for (sum, w) in sums[..count].iter_mut().zip(w) {
                        *sum = w.mul_add(x, *sum);
                    }
                }
            }
            for (y, sum) in y[from..from + count].iter_mut().zip(&sums) {
                *y = if first { *sum } else { *y + *sum };
            }
            from += count;
        }
    }
}
