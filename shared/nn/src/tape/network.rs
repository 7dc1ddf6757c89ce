//! Layers on the tape.

use super::{Op, Tape, Var};
use crate::{Dense, Gru, Mlp, kernels, product};

impl Tape<'_> {
    /// y = f(W x + b).
    ///
    /// # Panics
    /// If x does not have the layer's inputs as rows.
    pub fn dense(&mut self, layer: &Dense, x: Var) -> Var {
        let (inputs, batch) = self.shape(x);
        let weight = self.parameters.get(layer.weight);
        let bias = self.parameters.get(layer.bias);
        let outputs = weight.rows();
        assert_eq!(weight.cols(), inputs, "inputs of a dense layer");
        let op = Op::Dense {
            x,
            weight: layer.weight,
            bias: layer.bias,
            activation: layer.activation,
        };
        self.record(op, outputs, batch, |before, out| {
            let x = before.value(x);
            product::weight_times(true, out, weight.data(), x, outputs, inputs, batch);
            kernels::bias_activation(out, bias.data(), layer.activation);
        })
    }

    /// All layers of a network.
    pub fn mlp(&mut self, network: &Mlp, x: Var) -> Var {
        network
            .layers
            .iter()
            .fold(x, |x, layer| self.dense(layer, x))
    }

    /// h' of a GRU cell.
    ///
    /// # Panics
    /// If the shapes of x and h do not fit the cell.
    pub fn gru(&mut self, cell: &Gru, x: Var, h: Var) -> Var {
        let (inputs, batch) = self.shape(x);
        assert_eq!(inputs, cell.input(), "inputs of a GRU");
        assert_eq!(
            self.shape(h),
            (cell.hidden(), batch),
            "hidden state of a GRU"
        );
        let part = 3 * cell.hidden() * batch;
        let saved = self.take(2 * part);
        let op = Op::Gru {
            cell: *cell,
            x,
            h,
            saved,
        };
        let (rows, parameters) = (cell.hidden(), self.parameters);
        let at = self.take(rows * batch);
        let arena = &mut *self.arena;
        let (old, new) = arena.values.slice_mut().split_at_mut(saved);
        let (saved, out) = new.split_at_mut(at - saved);
        let (gates, hidden_part) = saved.split_at_mut(part);
        let value = |v: Var| super::value_of(parameters, old, &arena.nodes[v.index()]);
        cell.forward(
            parameters,
            value(x),
            value(h),
            gates,
            &mut hidden_part[..part],
            &mut out[..rows * batch],
            batch,
        );
        self.place(op, rows, batch, super::Place::Arena(at))
    }
}
