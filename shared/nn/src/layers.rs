//! Dense layers and multi-layer perceptrons: construction, and inference without a tape.

use crate::{ParamId, Parameters, Tensor, kernels, product};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Least standard deviation that [`Activation::Softplus`] gives; 1/σ² stays well within `f32`.
pub const SMALLEST_DEVIATION: f32 = 1e-4;

/// What a layer applies to its weighted sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// x
    Identity,
    /// x where positive, eˣ − 1 elsewhere.
    Elu,
    /// tanh x
    Tanh,
    /// max(ln(1 + eˣ), 1e-4): for standard deviations.
    Softplus,
}

/// y = f(W x + b).
#[derive(Clone, Copy, Debug)]
pub struct Dense {
    /// W, outputs × inputs.
    pub weight: ParamId,
    /// b, outputs × 1.
    pub bias: ParamId,
    /// f.
    pub activation: Activation,
}

/// Numbers from U(±1/√inputs), PyTorch's start for linear layers and GRU cells alike.
pub(crate) fn uniform(rows: usize, cols: usize, inputs: usize, rng: &mut ChaCha8Rng) -> Tensor {
    let bound = 1.0 / (inputs.max(1) as f32).sqrt();
    let mut tensor = Tensor::new(rows, cols);
    for value in tensor.data_mut() {
        *value = (2.0 * rng.random::<f32>() - 1.0) * bound;
    }
    tensor
}

impl Dense {
    /// A layer with parameters `prefix.weight` and `prefix.bias`, both from U(±1/√inputs).
    pub fn new(
        parameters: &mut Parameters,
        prefix: &str,
        inputs: usize,
        outputs: usize,
        activation: Activation,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let weight = uniform(outputs, inputs, inputs, rng);
        let bias = uniform(outputs, 1, inputs, rng);
        Self {
            weight: parameters.add(format!("{prefix}.weight"), weight),
            bias: parameters.add(format!("{prefix}.bias"), bias),
            activation,
        }
    }

    /// y = f(W x + b) without a tape: x inputs × batch, out becomes outputs × batch.
    pub fn infer(&self, parameters: &Parameters, x: &Tensor, out: &mut Tensor) {
        self.infer_stacked(parameters, &[x], out);
    }

    /// y = f(W [a; b; …] + b) with the input given as blocks of rows, as a sum of products.
    ///
    /// # Panics
    /// If the blocks' rows do not add up to the layer's inputs, or their columns differ.
    pub fn infer_stacked(&self, parameters: &Parameters, blocks: &[&Tensor], out: &mut Tensor) {
        let weight = parameters.get(self.weight);
        let bias = parameters.get(self.bias);
        let outputs = weight.rows();
        let batch = blocks[0].cols();
        let inputs: usize = blocks.iter().map(|block| block.rows()).sum();
        assert_eq!(inputs, weight.cols(), "inputs of a dense layer");
        out.resize_to(outputs, batch);
        let mut from = 0;
        for (i, block) in blocks.iter().enumerate() {
            assert_eq!(block.cols(), batch, "blocks of different batch");
            product::weight_times(
                i == 0,
                out.data_mut(),
                &weight.data()[from * outputs..(from + block.rows()) * outputs],
                block.data(),
                outputs,
                block.rows(),
                batch,
            );
            from += block.rows();
        }
        kernels::bias_activation(out.data_mut(), bias.data(), self.activation);
    }
}

/// A chain of dense layers.
#[derive(Clone, Debug)]
pub struct Mlp {
    /// First to last.
    pub layers: Vec<Dense>,
    input: usize,
    output: usize,
}

/// Memory for [`Mlp::infer`], reused from call to call.
#[derive(Clone, Debug, Default)]
pub struct MlpScratch {
    hidden: [Tensor; 2],
}

impl Mlp {
    /// Layers of the given sizes (inputs, hidden…, outputs), ELU between them, `last` at the end; parameters
    /// `prefix.0.weight`, `prefix.0.bias`, `prefix.1.weight`, …
    ///
    /// # Panics
    /// If there are fewer than two sizes, or a name is taken.
    pub fn new(
        parameters: &mut Parameters,
        prefix: &str,
        sizes: &[usize],
        last: Activation,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        assert!(sizes.len() >= 2, "a network needs input and output sizes");
        let count = sizes.len() - 1;
        let layers = (0..count)
            .map(|i| {
                let activation = if i + 1 == count {
                    last
                } else {
                    Activation::Elu
                };
                Dense::new(
                    parameters,
                    &format!("{prefix}.{i}"),
                    sizes[i],
                    sizes[i + 1],
                    activation,
                    rng,
                )
            })
            .collect();
        Self {
            layers,
            input: sizes[0],
            output: sizes[count],
        }
    }

    /// Inputs of the first layer.
    pub fn input(&self) -> usize {
        self.input
    }

    /// Outputs of the last layer.
    pub fn output(&self) -> usize {
        self.output
    }

    /// The parameters of all layers.
    pub fn ids(&self) -> impl Iterator<Item = ParamId> + '_ {
        self.layers.iter().flat_map(|l| [l.weight, l.bias])
    }

    /// The network's output for x (inputs × batch) without a tape; allocates nothing once the scratch has grown.
    pub fn infer(
        &self,
        parameters: &Parameters,
        x: &Tensor,
        scratch: &mut MlpScratch,
        out: &mut Tensor,
    ) {
        self.infer_stacked(parameters, &[x], scratch, out);
    }

    /// As [`Mlp::infer`], with the input as blocks of rows: x = [a; b; …] without copying them together.
    pub fn infer_stacked(
        &self,
        parameters: &Parameters,
        blocks: &[&Tensor],
        scratch: &mut MlpScratch,
        out: &mut Tensor,
    ) {
        let [a, b] = &mut scratch.hidden;
        let count = self.layers.len();
        if count == 1 {
            self.layers[0].infer_stacked(parameters, blocks, out);
            return;
        }
        self.layers[0].infer_stacked(parameters, blocks, a);
        let (mut from, mut to) = (a, b);
        for layer in &self.layers[1..count - 1] {
            layer.infer(parameters, from, to);
            std::mem::swap(&mut from, &mut to);
        }
        self.layers[count - 1].infer(parameters, from, out);
    }
}
