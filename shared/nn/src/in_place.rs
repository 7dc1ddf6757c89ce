//! Elementwise functions on a tensor's own memory, for inference.

use crate::{SMALLEST_DEVIATION, Tensor, kernels};

/// Makes standard deviations of a network's raw outputs: max(ln(1 + eˣ), 1e-4).
pub fn softplus_in_place(tensor: &mut Tensor) {
    kernels::softplus_floor(tensor.data_mut(), SMALLEST_DEVIATION);
}

/// Makes probabilities of log-odds: 1 / (1 + e⁻ˣ).
pub fn sigmoid_in_place(tensor: &mut Tensor) {
    kernels::sigmoid_all(tensor.data_mut());
}

/// Makes log-probabilities of logits, column by column: x − ln Σ eˣ.
pub fn log_softmax_in_place(tensor: &mut Tensor) {
    let rows = tensor.rows();
    for column in tensor.data_mut().chunks_exact_mut(rows.max(1)) {
        let largest = column.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let sum: f32 = column.iter().map(|x| (x - largest).exp()).sum();
        let log = largest + sum.ln();
        column.iter_mut().for_each(|x| *x -= log);
    }
}
