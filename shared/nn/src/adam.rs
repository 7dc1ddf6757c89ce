//! The Adam optimiser (Kingma and Ba 2015), with PyTorch's arithmetic.

use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::{Gradients, ParamId, Parameters, Tensor, kernels};

/// Adam over some of the parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    /// α
    pub learning_rate: f32,
    /// β₁, 0.9 at first.
    pub beta1: f32,
    /// β₂, 0.999 at first.
    pub beta2: f32,
    /// ε, 1e-8 at first.
    pub eps: f32,
    /// Steps made.
    pub step: u64,
    ids: Vec<ParamId>,
    /// `first.NAME` and `second.NAME` for every parameter, in turn.
    moments: Parameters,
}

impl Adam {
    /// An optimiser of these parameters that has made no step.
    pub fn new(parameters: &Parameters, ids: Vec<ParamId>, learning_rate: f32) -> Self {
        let mut moments = Parameters::new();
        for &id in &ids {
            let tensor = parameters.get(id);
            for order in ["first", "second"] {
                let zeros = Tensor::new(tensor.rows(), tensor.cols());
                moments.add(format!("{order}.{}", parameters.name(id)), zeros);
            }
        }
        Self {
            learning_rate,
            beta1: 0.9,
            beta2: 0.999,
            eps: 1e-8,
            step: 0,
            ids,
            moments,
        }
    }

    /// The parameters that it moves.
    pub fn ids(&self) -> &[ParamId] {
        &self.ids
    }

    /// One step: m ← β₁ m + (1 − β₁) g, v ← β₂ v + (1 − β₂) g², p ← p − α m̂/(√v̂ + ε).
    pub fn step(&mut self, parameters: &mut Parameters, gradients: &Gradients) {
        self.step += 1;
        let step = self.step as f64;
        let first_correction = 1.0 - f64::from(self.beta1).powf(step);
        let second_correction = (1.0 - f64::from(self.beta2).powf(step)).sqrt();
        for (i, &id) in self.ids.iter().enumerate() {
            let (first, second) = self.moments.pair_mut(2 * i);
            kernels::adam(
                parameters.get_mut(id).data_mut(),
                first.data_mut(),
                second.data_mut(),
                gradients.get(id).data(),
                self.beta1,
                self.beta2,
                (f64::from(self.learning_rate) / first_correction) as f32,
                (1.0 / second_correction) as f32,
                self.eps,
            );
        }
    }

    /// Both moments as named tensors, for [`crate::checkpoint::save`] under a prefix of the caller's choice; `step` is
    /// to be saved beside them as the u64 tensor `PREFIX.step`.
    pub fn moments(&self) -> &Parameters {
        &self.moments
    }

    /// Takes moments and step back from a checkpoint that holds them under `prefix`.
    ///
    /// # Errors
    /// If a tensor is missing or of another shape; the optimiser is then unchanged.
    pub fn load(&mut self, checkpoint: &Checkpoint, prefix: &str) -> Result<(), CheckpointError> {
        let step = checkpoint.u64s(&format!("{prefix}.step"), 1)?[0];
        checkpoint.read(prefix, &mut self.moments)?;
        self.step = step;
        Ok(())
    }
}
