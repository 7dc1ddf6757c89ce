//! The gated recurrent unit, with the equations of PyTorch's GRUCell.
//!
//! r = σ(W_ir x + b_ir + W_hr h + b_hr), z = σ(W_iz x + b_iz + W_hz h + b_hz),
//! n = tanh(W_in x + b_in + r ⊙ (W_hn h + b_hn)), h' = (1 − z) ⊙ n + z ⊙ h.
//! The three gates' weights are stacked in the order r, z, n.

use crate::layers::uniform;
use crate::{Activation, ParamId, Parameters, Tensor, kernels, product};
use rand_chacha::ChaCha8Rng;

/// A GRU cell's parameters.
#[derive(Clone, Copy, Debug)]
pub struct Gru {
    /// W_i, 3·hidden × inputs.
    pub input_weight: ParamId,
    /// W_h, 3·hidden × hidden.
    pub hidden_weight: ParamId,
    /// b_i, 3·hidden × 1.
    pub input_bias: ParamId,
    /// b_h, 3·hidden × 1.
    pub hidden_bias: ParamId,
    inputs: usize,
    hidden: usize,
}

/// Memory for [`Gru::infer`], reused from call to call.
#[derive(Clone, Debug, Default)]
pub struct GruScratch {
    from_input: Tensor,
    from_hidden: Tensor,
}

impl Gru {
    /// A cell with parameters `prefix.weight_ih`, `.weight_hh`, `.bias_ih`, `.bias_hh`, all from U(±1/√hidden).
    pub fn new(
        parameters: &mut Parameters,
        prefix: &str,
        inputs: usize,
        hidden: usize,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let input_weight = uniform(3 * hidden, inputs, hidden, rng);
        let hidden_weight = uniform(3 * hidden, hidden, hidden, rng);
        let input_bias = uniform(3 * hidden, 1, hidden, rng);
        let hidden_bias = uniform(3 * hidden, 1, hidden, rng);
        Self {
            input_weight: parameters.add(format!("{prefix}.weight_ih"), input_weight),
            hidden_weight: parameters.add(format!("{prefix}.weight_hh"), hidden_weight),
            input_bias: parameters.add(format!("{prefix}.bias_ih"), input_bias),
            hidden_bias: parameters.add(format!("{prefix}.bias_hh"), hidden_bias),
            inputs,
            hidden,
        }
    }

    /// Features of x.
    pub fn input(&self) -> usize {
        self.inputs
    }

    /// Features of h.
    pub fn hidden(&self) -> usize {
        self.hidden
    }

    /// The cell's parameters.
    pub fn ids(&self) -> [ParamId; 4] {
        [
            self.input_weight,
            self.hidden_weight,
            self.input_bias,
            self.hidden_bias,
        ]
    }

    /// h' from x (inputs × batch) and h (hidden × batch) without a tape.
    pub fn infer(
        &self,
        parameters: &Parameters,
        x: &Tensor,
        h: &Tensor,
        scratch: &mut GruScratch,
        out: &mut Tensor,
    ) {
        assert_eq!(x.rows(), self.inputs, "inputs of a GRU");
        assert_eq!(h.rows(), self.hidden, "hidden features of a GRU");
        assert_eq!(x.cols(), h.cols(), "batch of a GRU");
        let batch = x.cols();
        out.resize_to(self.hidden, batch);
        scratch.from_input.resize_to(3 * self.hidden, batch);
        scratch.from_hidden.resize_to(3 * self.hidden, batch);
        self.forward(
            parameters,
            x.data(),
            h.data(),
            scratch.from_input.data_mut(),
            scratch.from_hidden.data_mut(),
            out.data_mut(),
            batch,
        );
    }

    /// The equations. Afterwards `gates` holds [r; z; n] and `hidden_part`'s third block W_hn h + b_hn.
    #[allow(clippy::too_many_arguments)]
    pub(crate) fn forward(
        &self,
        parameters: &Parameters,
        x: &[f32],
        h: &[f32],
        gates: &mut [f32],
        hidden_part: &mut [f32],
        out: &mut [f32],
        batch: usize,
    ) {
        let n = self.hidden;
        for (result, weight, bias, source, inputs) in [
            (
                &mut *gates,
                self.input_weight,
                self.input_bias,
                x,
                self.inputs,
            ),
            (
                &mut *hidden_part,
                self.hidden_weight,
                self.hidden_bias,
                h,
                n,
            ),
        ] {
            product::weight_times(
                true,
                result,
                parameters.get(weight).data(),
                source,
                3 * n,
                inputs,
                batch,
            );
            kernels::bias_activation(result, parameters.get(bias).data(), Activation::Identity);
        }
        for j in 0..batch {
            let gates = &mut gates[3 * n * j..3 * n * (j + 1)];
            let hidden_part = &hidden_part[3 * n * j..3 * n * (j + 1)];
            let columns = n * j..n * (j + 1);
            let (reset_update, candidate) = gates.split_at_mut(2 * n);
            kernels::sigmoid_add(reset_update, &hidden_part[..2 * n]);
            let (reset, update) = reset_update.split_at(n);
            kernels::gru_candidate(candidate, reset, &hidden_part[2 * n..]);
            kernels::gru_mix(
                true,
                &mut out[columns.clone()],
                update,
                candidate,
                &h[columns],
            );
        }
    }

    /// From dh' the gradients of both weighted sums, each 3·hidden × batch; and z ⊙ dh' into `dh`, if wanted.
    #[allow(clippy::too_many_arguments)]
    pub(crate) fn backward(
        &self,
        gates: &[f32],
        hidden_part: &[f32],
        h: &[f32],
        g: &[f32],
        d_input_part: &mut [f32],
        d_hidden_part: &mut [f32],
        mut dh: Option<(bool, &mut [f32])>,
        batch: usize,
    ) {
        let n = self.hidden;
        for j in 0..batch {
            let three = 3 * n * j..3 * n * (j + 1);
            let one = n * j..n * (j + 1);
            let (reset, rest) = gates[three.clone()].split_at(n);
            let (update, candidate) = rest.split_at(n);
            let hn = &hidden_part[three.clone()][2 * n..];
            let (g, h) = (&g[one.clone()], &h[one.clone()]);
            let d_in = &mut d_input_part[three.clone()];
            let (d_gates, d_candidate) = d_in.split_at_mut(2 * n);
            let (d_reset, d_update) = d_gates.split_at_mut(n);
            kernels::gru_d_candidate(true, d_candidate, g, update, candidate);
            kernels::gru_d_update(true, d_update, g, update, candidate, h);
            kernels::gru_d_reset(true, d_reset, d_candidate, hn, reset);
            let d_hid = &mut d_hidden_part[three];
            d_hid[..2 * n].copy_from_slice(&d_in[..2 * n]);
            kernels::product(true, &mut d_hid[2 * n..], &d_in[2 * n..], reset);
            if let Some((first, dh)) = &mut dh {
                kernels::product(*first, &mut dh[one], g, update);
            }
        }
    }
}
