//! Matrix products for batches of small networks: Y ← (Y +) A B, without packing.
//!
//! Every element of the result is one chain of fused multiply-adds over the inner dimension in its order, whatever the
//! shapes, the instruction set, and the element's place. So a batch gives bit for bit what its columns give one by one,
//! and an input given in blocks gives what it gives whole. At the sizes here (inner dimensions up to some hundreds)
//! this kernel also outruns general products that pack their operands (`benches/speed.rs` measures one beside it).

use crate::vectors::{self, Vectors};
use pulp::{Scalar128b, Scalar256b, Scalar512b, Simd, WithSimd};

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
    product(Product {
        first,
        y,
        a: weight,
        b: x,
        rows: output,
        depth: input,
        cols: batch,
        b_down: 1,
        b_right: input,
    });
}

/// dW ← dW + dy xᵀ for dy out × batch and x in × batch.
pub(crate) fn add_outer(
    dw: &mut [f32],
    dy: &[f32],
    x: &[f32],
    output: usize,
    input: usize,
    batch: usize,
) {
    product(Product {
        first: false,
        y: dw,
        a: dy,
        b: x,
        rows: output,
        depth: batch,
        cols: input,
        b_down: input,
        b_right: 1,
    });
}

/// out ← xᵀ for x rows × cols.
pub(crate) fn transpose(out: &mut [f32], x: &[f32], rows: usize, cols: usize) {
    /// Small squares keep both sides' cache lines at hand.
    const SQUARE: usize = 16;
    let (out, x) = (&mut out[..rows * cols], &x[..rows * cols]);
    for j0 in (0..cols).step_by(SQUARE) {
        for i0 in (0..rows).step_by(SQUARE) {
            for i in i0..rows.min(i0 + SQUARE) {
                for j in j0..cols.min(j0 + SQUARE) {
                    out[i * cols + j] = x[j * rows + i];
                }
            }
        }
    }
}

/// Y (rows × cols) ← (Y +) A B with A (rows × depth) column-major; B's element (k, j) lies at k · b_down + j · b_right.
struct Product<'a> {
    first: bool,
    y: &'a mut [f32],
    a: &'a [f32],
    b: &'a [f32],
    rows: usize,
    depth: usize,
    cols: usize,
    b_down: usize,
    b_right: usize,
}

fn product(p: Product) {
    product_with(vectors::chosen(), p);
}

fn product_with(vectors: Vectors, p: Product) {
    if p.rows == 0 || p.cols == 0 {
        return;
    }
    if p.depth == 0 {
        if p.first {
            p.y[..p.rows * p.cols].fill(0.0);
        }
        return;
    }
    // The kernel works with pointers: these bounds are what its safety rests on.
    assert!(p.y.len() >= p.rows * p.cols, "result of a product");
    assert!(p.a.len() >= p.rows * p.depth, "left side of a product");
    let last = (p.depth - 1) * p.b_down + (p.cols - 1) * p.b_right;
    assert!(p.b.len() > last, "right side of a product");
    let arch = vectors::arch(vectors);
    match vectors {
        Vectors::Lanes4 => arch.dispatch(Emulated(Scalar128b, p)),
        Vectors::Lanes8 if !vectors::has_lanes(8) => arch.dispatch(Emulated(Scalar256b, p)),
        Vectors::Lanes16 if !vectors::has_lanes(16) => arch.dispatch(Emulated(Scalar512b, p)),
        _ => arch.dispatch(p),
    }
}

/// Inner dimension taken at a time, so that a panel of A (64 × 128 numbers, 32 KiB) stays in the first-level cache. The
/// sums go on from what lies in Y, so that blocks do not change the result.
const DEPTH: usize = 128;

impl WithSimd for Product<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        run(simd, self)
    }
}

/// A product with vectors of a width that the machine may not have.
struct Emulated<'a, E>(E, Product<'a>);

impl<E: Simd> WithSimd for Emulated<'_, E> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        run(self.0, self.1)
    }
}

#[inline(always)]
fn run<S: Simd>(simd: S, p: Product) {
    // As many sums as registers hold, beside MR numbers of A and one of B: with AVX2 there are 16, else 32.
    if S::F32_LANES == 8 {
        panels::<S, 3, 4>(simd, p);
    } else {
        panels::<S, 4, WIDTH>(simd, p);
    }
}

/// A tile's operands: pointers to its first elements, and strides.
#[derive(Clone, Copy)]
struct Tile {
    y: *mut f32,
    a: *const f32,
    b: *const f32,
    /// Between columns of Y.
    y_right: usize,
    /// Between columns of A.
    a_right: usize,
    depth: usize,
    b_down: usize,
    b_right: usize,
    replace: bool,
    /// First row of the last vector, which may overlap the one before.
    last: usize,
}

/// Columns of the widest tile.
const WIDTH: usize = 6;
/// Lanes of the widest vectors.
const MOST_LANES: usize = 16;

/// Y in panels of at most MR vectors of rows, each in tiles of at most NR columns.
#[inline(always)]
fn panels<S: Simd, const MR: usize, const NR: usize>(simd: S, p: Product) {
    // Of three vectors or more a panel, spreading leaves none with a single one: `vectors` > MR (count − 1) gives
    // `vectors` ≥ 2 count for every count above 1.
    const { assert!(MR >= 3 && NR <= WIDTH && S::F32_LANES <= MOST_LANES) };
    let lanes = S::F32_LANES;
    if p.rows < lanes {
        return narrow(simd, p);
    }
    // The vectors are spread evenly over the panels, so that a last vector that must overlap its neighbour to end with the
    // matrix has that neighbour in its own panel: both are loaded before either is stored.
    let vectors = p.rows.div_ceil(lanes);
    let count = vectors.div_ceil(MR);
    let mut vector = 0;
    for panel in 0..count {
        let size = (vectors - vector).div_ceil(count - panel);
        let row = vector * lanes;
        let last = ((size - 1) * lanes).min(p.rows - lanes - row);
        assert!(
            row + last + lanes <= p.rows && (size - 1) * lanes < last + lanes,
            "rows {row} + {last} + {lanes} of {}, in {size} vectors",
            p.rows
        );
        let mut k = 0;
        while k < p.depth {
            let depth = DEPTH.min(p.depth - k);
            // SAFETY: rows `row .. row + last + lanes` are within `rows` (asserted above), columns within `cols`, and the
            // inner indices `k .. k + depth` within `depth`; `product_with` has checked that all of these lie in the slices.
            unsafe {
                let tile = Tile {
                    y: p.y.as_mut_ptr().add(row),
                    a: p.a.as_ptr().add(k * p.rows + row),
                    b: p.b.as_ptr().add(k * p.b_down),
                    y_right: p.rows,
                    a_right: p.rows,
                    depth,
                    b_down: p.b_down,
                    b_right: p.b_right,
                    replace: p.first && k == 0,
                    last,
                };
                match size {
                    1 => columns::<S, 1, NR>(simd, tile, p.cols),
                    2 => columns::<S, 2, NR>(simd, tile, p.cols),
                    3 => columns::<S, 3, NR>(simd, tile, p.cols),
                    _ => columns::<S, MR, NR>(simd, tile, p.cols),
                }
            }
            k += depth;
        }
        vector += size;
    }
}

/// Fewer rows than lanes: A and Y go through memory padded to whole vectors.
#[inline(always)]
fn narrow<S: Simd>(simd: S, p: Product) {
    let lanes = S::F32_LANES;
    let mut a = [0.0_f32; MOST_LANES * DEPTH];
    let mut y = [0.0_f32; MOST_LANES * WIDTH];
    let mut k = 0;
    while k < p.depth {
        let depth = DEPTH.min(p.depth - k);
        let source = &p.a[k * p.rows..(k + depth) * p.rows];
        for (to, from) in a.chunks_exact_mut(lanes).zip(source.chunks_exact(p.rows)) {
            to[..p.rows].copy_from_slice(&from[..p.rows]);
        }
        let replace = p.first && k == 0;
        let mut j = 0;
        while j < p.cols {
            let width = WIDTH.min(p.cols - j);
            let out = &mut p.y[j * p.rows..(j + width) * p.rows];
            if !replace {
                for (to, from) in y.chunks_exact_mut(lanes).zip(out.chunks_exact(p.rows)) {
                    to[..p.rows].copy_from_slice(&from[..p.rows]);
                }
            }
            // SAFETY: the padded A and Y hold `depth` and `width` columns of one vector; B is as in `panels`.
            unsafe {
                let tile = Tile {
                    y: y.as_mut_ptr(),
                    a: a.as_ptr(),
                    b: p.b.as_ptr().add(k * p.b_down + j * p.b_right),
                    y_right: lanes,
                    a_right: lanes,
                    depth,
                    b_down: p.b_down,
                    b_right: p.b_right,
                    replace,
                    last: 0,
                };
                columns::<S, 1, WIDTH>(simd, tile, width);
            }
            for (from, to) in y.chunks_exact(lanes).zip(out.chunks_exact_mut(p.rows)) {
                to[..p.rows].copy_from_slice(&from[..p.rows]);
            }
            j += width;
        }
        k += depth;
    }
}

/// All columns of a panel.
///
/// # Safety
/// As for [`tile`], for `cols` columns.
#[inline(always)]
unsafe fn columns<S: Simd, const MR: usize, const NR: usize>(simd: S, at: Tile, cols: usize) {
    let mut j = 0;
    while j < cols {
        // SAFETY: `j < cols`, and the tile's width is at most `cols - j`.
        unsafe {
            let here = Tile {
                y: at.y.add(j * at.y_right),
                b: at.b.add(j * at.b_right),
                ..at
            };
            match cols - j {
                1 => tile::<S, MR, 1>(simd, here),
                2 => tile::<S, MR, 2>(simd, here),
                3 => tile::<S, MR, 3>(simd, here),
                4 if NR > 4 => tile::<S, MR, 4>(simd, here),
                5 if NR > 5 => tile::<S, MR, 5>(simd, here),
                _ => tile::<S, MR, NR>(simd, here),
            }
        }
        j += NR;
    }
}

/// MR vectors × NR columns of the result, kept in registers over the inner dimension.
///
/// # Safety
/// A (MR vectors × depth), B (depth × NR) and Y (MR vectors × NR) must be valid from the tile's pointers at its strides,
/// the last vector starting at row `last`.
#[inline(always)]
unsafe fn tile<S: Simd, const MR: usize, const NR: usize>(simd: S, at: Tile) {
    let row = |i: usize| {
        if i == MR - 1 {
            at.last
        } else {
            i * S::F32_LANES
        }
    };
    // SAFETY: see above; unaligned accesses are done as such.
    let load =
        |from: *const f32, i: usize| unsafe { from.add(row(i)).cast::<S::f32s>().read_unaligned() };
    let mut sums = [[simd.splat_f32s(0.0); MR]; NR];
    if !at.replace {
        for j in 0..NR {
            for i in 0..MR {
                // SAFETY: see above.
                sums[j][i] = load(unsafe { at.y.add(j * at.y_right) }, i);
            }
        }
    }
    let (mut a, mut b) = (at.a, at.b);
    for _ in 0..at.depth {
        let mut column = [simd.splat_f32s(0.0); MR];
        for i in 0..MR {
            column[i] = load(a, i);
        }
        for j in 0..NR {
            // SAFETY: see above.
            let x = simd.splat_f32s(unsafe { *b.add(j * at.b_right) });
            for i in 0..MR {
                sums[j][i] = simd.mul_add_f32s(column[i], x, sums[j][i]);
            }
        }
        // The last step leaves the pointers past the end, unused.
        a = a.wrapping_add(at.a_right);
        b = b.wrapping_add(at.b_down);
    }
    for j in 0..NR {
        for i in 0..MR {
            // SAFETY: see above.
            unsafe {
                let to = at.y.add(j * at.y_right + row(i)).cast::<S::f32s>();
                to.write_unaligned(sums[j][i]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers without pattern.
    fn numbers(count: usize, seed: u64) -> Vec<f32> {
        let mut x = vec![0.0; count];
        crate::noise::fill(&mut x, seed, 0);
        x
    }

    /// The product as it is defined: one chain of fused multiply-adds for each element.
    fn chain(p: &Product) -> Vec<f32> {
        let mut y = p.y.to_vec();
        for j in 0..p.cols {
            for i in 0..p.rows {
                let start = if p.first { 0.0 } else { y[j * p.rows + i] };
                y[j * p.rows + i] = (0..p.depth).fold(start, |sum, k| {
                    p.a[k * p.rows + i].mul_add(p.b[k * p.b_down + j * p.b_right], sum)
                });
            }
        }
        y
    }

    /// Numbers between guards: what reads past them takes in a NaN, what writes past them is found out.
    struct Guarded(Vec<f32>);

    impl Guarded {
        const GUARD: usize = 64;
        const PATTERN: u32 = 0x7fc0_dead;

        fn new(numbers: &[f32]) -> Self {
            let guard = [f32::from_bits(Self::PATTERN); Self::GUARD];
            Self([&guard[..], numbers, &guard[..]].concat())
        }

        fn numbers(&mut self) -> &mut [f32] {
            let end = self.0.len() - Self::GUARD;
            &mut self.0[Self::GUARD..end]
        }

        fn is_whole(&self) -> bool {
            let end = self.0.len() - Self::GUARD;
            let guards = self.0[..Self::GUARD].iter().chain(&self.0[end..]);
            guards.map(|x| x.to_bits()).all(|x| x == Self::PATTERN)
        }
    }

    /// A product of this shape with all vectors, added and replaced, from B and from its transpose.
    fn check(rows: usize, depth: usize, cols: usize) {
        let mut a = Guarded::new(&numbers(rows * depth, 1));
        let mut b = Guarded::new(&numbers(depth * cols, 2));
        let before = numbers(rows * cols, 3);
        for (first, transposed) in [(true, false), (false, false), (false, true)] {
            let (b_down, b_right) = if transposed { (cols, 1) } else { (1, depth) };
            let mut y = Guarded::new(&before);
            let p = Product {
                first,
                y: y.numbers(),
                a: a.numbers(),
                b: b.numbers(),
                rows,
                depth,
                cols,
                b_down,
                b_right,
            };
            let expected = chain(&p);
            for vectors in Vectors::ALL {
                let mut y = Guarded::new(&before);
                let p = Product {
                    first,
                    y: y.numbers(),
                    a: a.numbers(),
                    b: b.numbers(),
                    rows,
                    depth,
                    cols,
                    b_down,
                    b_right,
                };
                product_with(vectors, p);
                let shape = format!("{rows}×{depth}×{cols}, {first}, {transposed}, {vectors:?}");
                assert!(y.is_whole(), "wrote past the result: {shape}");
                assert_eq!(y.numbers(), expected, "{shape}");
            }
        }
        assert!(a.is_whole() && b.is_whole());
    }

    #[test]
    fn every_number_of_rows_gives_the_defined_chains_bit_for_bit() {
        for rows in (1..=200).chain([348, 513]) {
            for cols in [1, 4, 7, 13] {
                for depth in [0, 1, 9, 129] {
                    check(rows, depth, cols);
                }
            }
        }
    }

    #[test]
    fn every_number_of_columns_gives_the_defined_chains_bit_for_bit() {
        for cols in 1..=200 {
            for rows in [1, 7, 17, 33, 113] {
                for depth in [1, 10] {
                    check(rows, depth, cols);
                }
            }
        }
    }

    #[test]
    fn every_inner_dimension_gives_the_defined_chains_bit_for_bit() {
        for depth in (0..=200).chain([255, 256, 257, 300]) {
            for rows in [3, 8, 17, 50] {
                for cols in [1, 6, 11] {
                    check(rows, depth, cols);
                }
            }
        }
    }

    #[test]
    fn transposes() {
        let shapes = (1..=200).flat_map(|n| [(n, 3), (17, n), (n, n)]);
        for (rows, cols) in shapes {
            let x = numbers(rows * cols, 5);
            let mut guarded = Guarded::new(&vec![0.0; rows * cols]);
            let out = guarded.numbers();
            transpose(out, &x, rows, cols);
            for i in 0..rows {
                for j in 0..cols {
                    assert_eq!(out[i * cols + j], x[j * rows + i]);
                }
            }
            assert!(guarded.is_whole());
        }
    }
}
