//! Elementwise functions on a tensor's own memory, for inference.

use crate::{SMALLEST_DEVIATION, Tensor, kernels};

/// Makes standard deviations of a network's raw outputs: max(ln(1 + eˣ), 1e-4).
pub fn softplus_in_place(tensor: &mut Tensor) {
    kernels::softplus_floor(tensor.data_mut(), SMALLEST_DEVIATION);
}
