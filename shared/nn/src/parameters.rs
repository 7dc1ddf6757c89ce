//! Named parameters in creation order, and gradients of the same shapes.

use crate::Tensor;
use crate::kernels;

/// Which parameter: its place in the order of creation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ParamId(pub(crate) u32);

impl ParamId {
    /// Place in the order of creation.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// Named tensors in creation order. Equality compares names, shapes and bytes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    names: Vec<String>,
    tensors: Vec<Tensor>,
}

impl Parameters {
    /// No parameters yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a parameter under a name.
    ///
    /// # Panics
    /// If the name is taken.
    pub fn add(&mut self, name: impl Into<String>, tensor: Tensor) -> ParamId {
        let name = name.into();
        assert!(self.id(&name).is_none(), "parameter {name} exists already");
        self.names.push(name);
        self.tensors.push(tensor);
        ParamId(self.names.len() as u32 - 1)
    }

    /// The tensor.
    pub fn get(&self, id: ParamId) -> &Tensor {
        &self.tensors[id.index()]
    }

    /// The tensor.
    pub fn get_mut(&mut self, id: ParamId) -> &mut Tensor {
        &mut self.tensors[id.index()]
    }

    /// Two neighbours at once.
    pub(crate) fn pair_mut(&mut self, index: usize) -> (&mut Tensor, &mut Tensor) {
        let (a, b) = self.tensors[index..].split_at_mut(1);
        (&mut a[0], &mut b[0])
    }

    /// The name it was added under.
    pub fn name(&self, id: ParamId) -> &str {
        &self.names[id.index()]
    }

    /// The parameter of that name.
    pub fn id(&self, name: &str) -> Option<ParamId> {
        self.names
            .iter()
            .position(|n| n == name)
            .map(|i| ParamId(i as u32))
    }

    /// Ids, names and tensors in creation order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (ParamId, &str, &Tensor)> {
        self.names
            .iter()
            .zip(&self.tensors)
            .enumerate()
            .map(|(i, (name, tensor))| (ParamId(i as u32), name.as_str(), tensor))
    }

    /// Ids in creation order.
    pub fn ids(&self) -> impl ExactSizeIterator<Item = ParamId> + use<> {
        (0..self.names.len() as u32).map(ParamId)
    }

    /// Ids of the parameters whose name starts with `prefix`, in creation order.
    pub fn ids_with_prefix(&self, prefix: &str) -> Vec<ParamId> {
        self.iter()
            .filter(|(_, name, _)| name.starts_with(prefix))
            .map(|(id, _, _)| id)
            .collect()
    }

    /// How many tensors.
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// How many numbers in all.
    pub fn scalars(&self) -> usize {
        self.tensors.iter().map(|t| t.data().len()).sum()
    }

    /// Moves every number towards the other's: p ← p + rate · (other − p), as target networks do.
    ///
    /// # Panics
    /// If the shapes differ.
    pub fn lerp_from(&mut self, other: &Parameters, rate: f32) {
        assert_eq!(self.len(), other.len(), "parameters of different structure");
        for (mine, theirs) in self.tensors.iter_mut().zip(&other.tensors) {
            assert_eq!(mine.rows(), theirs.rows());
            assert_eq!(mine.cols(), theirs.cols());
            kernels::lerp(mine.data_mut(), theirs.data(), rate);
        }
    }

    /// Takes the other's numbers.
    ///
    /// # Panics
    /// If the shapes differ.
    pub fn copy_from(&mut self, other: &Parameters) {
        assert_eq!(self.len(), other.len(), "parameters of different structure");
        for (mine, theirs) in self.tensors.iter_mut().zip(&other.tensors) {
            mine.data_mut().copy_from_slice(theirs.data());
        }
    }
}

/// Gradients of every parameter, of the same shapes.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    tensors: Vec<Tensor>,
}

impl Gradients {
    /// Zero gradients for these parameters.
    pub fn for_params(parameters: &Parameters) -> Self {
        Self {
            tensors: parameters
                .iter()
                .map(|(_, _, t)| Tensor::new(t.rows(), t.cols()))
                .collect(),
        }
    }

    /// Sets all to zero.
    pub fn zero(&mut self) {
        for tensor in &mut self.tensors {
            tensor.fill(0.0);
        }
    }

    /// Sets the chosen ones to zero (cheaper than all where most parameters are frozen).
    pub fn zero_only(&mut self, ids: &[ParamId]) {
        for id in ids {
            self.tensors[id.index()].fill(0.0);
        }
    }

    /// Adds another shard's gradients.
    pub fn add(&mut self, other: &Gradients) {
        for (mine, theirs) in self.tensors.iter_mut().zip(&other.tensors) {
            kernels::copy(false, mine.data_mut(), theirs.data());
        }
    }

    /// Adds the chosen ones of another shard's gradients.
    pub fn add_only(&mut self, other: &Gradients, ids: &[ParamId]) {
        for id in ids {
            let theirs = other.tensors[id.index()].data();
            kernels::copy(false, self.tensors[id.index()].data_mut(), theirs);
        }
    }

    /// Multiplies the chosen ones by a factor.
    pub fn scale(&mut self, ids: &[ParamId], factor: f32) {
        for id in ids {
            kernels::multiply_by(self.tensors[id.index()].data_mut(), factor);
        }
    }

    /// Euclidean norm over all numbers of the chosen parameters.
    pub fn global_norm(&self, ids: &[ParamId]) -> f32 {
        let squares: f64 = ids
            .iter()
            .map(|id| kernels::sum_of_squares(self.tensors[id.index()].data()))
            .sum();
        squares.sqrt() as f32
    }

    /// Scales the chosen ones so that their global norm is at most `max_norm`; gives the norm before.
    pub fn clip(&mut self, ids: &[ParamId], max_norm: f32) -> f32 {
        let norm = self.global_norm(ids);
        if norm > max_norm {
            // As PyTorch's clip_grad_norm_, whose denominator has 1e-6 added.
            self.scale(ids, max_norm / (norm + 1e-6));
        }
        norm
    }

    /// The gradient of one parameter.
    pub fn get(&self, id: ParamId) -> &Tensor {
        &self.tensors[id.index()]
    }

    /// The gradient of one parameter.
    pub fn get_mut(&mut self, id: ParamId) -> &mut Tensor {
        &mut self.tensors[id.index()]
    }
}
