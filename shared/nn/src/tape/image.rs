//! Convolution and transposed convolution on the tape, out of unfold, fold, reshape and matrix products (see [`crate::Conv`]).

use super::{Op, Tape, Var};
use crate::image::Windows;
use crate::{Conv, Deconv, ParamId, product};

impl Tape<'_> {
    /// The same numbers in another shape, without copying them.
    ///
    /// # Panics
    /// If the number of elements differs.
    pub fn reshape(&mut self, v: Var, rows: usize, cols: usize) -> Var {
        let node = self.arena.nodes[v.index()];
        assert_eq!(node.len(), rows * cols, "elements of a reshaped variable");
        self.place(Op::Reshape(v), rows, cols, node.place)
    }

    /// The windows of images: image × batch → patch × (positions · batch).
    ///
    /// # Panics
    /// If v does not hold such images.
    pub fn unfold(&mut self, windows: Windows, v: Var) -> Var {
        let (rows, batch) = self.shape(v);
        assert_eq!(rows, windows.image(), "image to unfold");
        let (rows, cols) = (windows.patch(), windows.positions() * batch);
        self.record(Op::Unfold { x: v, windows }, rows, cols, |before, out| {
            windows.unfold(true, out, before.value(v));
        })
    }

    /// Windows added into their places: patch × (positions · batch) → image × batch.
    ///
    /// # Panics
    /// If v does not hold such windows.
    pub fn fold(&mut self, windows: Windows, v: Var) -> Var {
        let (rows, cols) = self.shape(v);
        let positions = windows.positions();
        assert_eq!(rows, windows.patch(), "windows to fold");
        assert!(cols.is_multiple_of(positions), "windows to fold");
        let (rows, cols) = (windows.image(), cols / positions);
        self.record(Op::Fold { x: v, windows }, rows, cols, |before, out| {
            windows.fold(true, out, before.value(v));
        })
    }

    /// W x.
    ///
    /// # Panics
    /// If the shapes do not fit.
    pub fn weight_times(&mut self, weight: ParamId, x: Var) -> Var {
        let (inputs, batch) = self.shape(x);
        let w = self.parameters.get(weight);
        let outputs = w.rows();
        assert_eq!(w.cols(), inputs, "inputs of a product");
        self.record(Op::Product { x, weight }, outputs, batch, |before, out| {
            product::weight_times(true, out, w.data(), before.value(x), outputs, inputs, batch);
        })
    }

    /// A convolution: image × batch → output × batch.
    pub fn conv(&mut self, conv: &Conv, x: Var) -> Var {
        let batch = self.shape(x).1;
        let windows = self.unfold(conv.windows, x);
        let out = self.dense(&conv.layer, windows);
        self.reshape(out, conv.output(), batch)
    }

    /// A transposed convolution: input × batch → image × batch.
    pub fn deconv(&mut self, deconv: &Deconv, x: Var) -> Var {
        let (rows, batch) = self.shape(x);
        assert_eq!(
            rows,
            deconv.input(),
            "feature map of a transposed convolution"
        );
        let pixels = self.reshape(x, deconv.channels(), deconv.windows.positions() * batch);
        let made = self.weight_times(deconv.weight, pixels);
        let image = self.fold(deconv.windows, made);
        let (rows, channels) = (deconv.windows.image(), deconv.windows.channels);
        let bias = self.param(deconv.bias);
        let bias = self.broadcast(bias, batch);
        let bias = self.reshape(bias, 1, channels * batch);
        let bias = self.spread(bias, rows / channels);
        let bias = self.reshape(bias, rows, batch);
        self.add(image, bias)
    }
}
