//! The way back: gradients of a 1 × 1 loss with respect to leaves and wanted parameters.
//!
//! Nodes below which nothing is wanted are skipped with everything that they would cost. The first contribution to a
//! gradient replaces what lay there, so that nothing is zeroed beforehand.

use super::{Arena, Binary, Mark, Node, Op, Tape, Transposes, Unary, Var, value_of};
use crate::tensor::LANES;
use crate::{Activation, Gradients, ParamId, Parameters, SMALLEST_DEVIATION, kernels, product};

/// What one node's backward step sees.
struct Step<'s> {
    parameters: &'s Parameters,
    nodes: &'s [Node],
    values: &'s [f32],
    marks: &'s mut [Mark],
    /// Gradients of all nodes before this one.
    below: &'s mut [f32],
}

impl<'s> Step<'s> {
    fn value(&self, v: Var) -> &'s [f32] {
        value_of(self.parameters, self.values, &self.nodes[v.index()])
    }

    /// The gradient of an input, and whether this is the first contribution; none where nothing is wanted.
    fn gradient(&mut self, v: Var) -> Option<(bool, &mut [f32])> {
        let mark = &mut self.marks[v.index()];
        if !mark.needed {
            return None;
        }
        let first = !std::mem::replace(&mut mark.seen, true);
        let length = self.nodes[v.index()].len();
        Some((
            first,
            &mut self.below[mark.gradient..mark.gradient + length],
        ))
    }
}

/// Which parameters get gradients, and where; and weights' transposes, made once for all uses on the tape.
struct Sink<'s> {
    gradients: &'s mut Gradients,
    wanted: &'s dyn Fn(ParamId) -> bool,
    transposes: &'s mut Transposes,
}

impl Sink<'_> {
    /// Wᵀ, inputs × outputs.
    fn transposed(&mut self, parameters: &Parameters, weight: ParamId) -> &[f32] {
        let tensor = parameters.get(weight);
        let (rows, cols) = (tensor.rows(), tensor.cols());
        let memory = &mut *self.transposes;
        let place = &mut memory.places[weight.index()];
        let at = *place.get_or_insert_with(|| {
            let at = memory.used;
            memory.used += (rows * cols).next_multiple_of(LANES);
            memory.values.reserve(memory.used);
            let out = &mut memory.values.slice_mut()[at..];
            product::transpose(out, tensor.data(), rows, cols);
            at
        });
        &memory.values.slice()[at..at + rows * cols]
    }
}

impl Tape<'_> {
    /// Adds the loss's gradients with respect to the wanted parameters to `gradients` (zero those first, unless they
    /// are meant to add up), and makes the leaves' readable with [`Tape::grad`].
    ///
    /// # Panics
    /// If the loss is not 1 × 1.
    pub fn backward(
        &mut self,
        loss: Var,
        gradients: &mut Gradients,
        wanted: &dyn Fn(ParamId) -> bool,
    ) {
        assert_eq!(self.shape(loss), (1, 1), "a loss is a single number");
        self.mark(loss, wanted);
        let parameters = self.parameters;
        let Arena {
            nodes,
            marks,
            values,
            gradients: memory,
            scratch,
            lists,
            transposes,
            ..
        } = &mut *self.arena;
        if !marks[loss.index()].needed {
            return;
        }
        let memory = memory.slice_mut();
        memory[marks[loss.index()].gradient] = 1.0;
        marks[loss.index()].seen = true;
        transposes.used = 0;
        transposes.places.clear();
        transposes.places.resize(parameters.len(), None);
        let mut sink = Sink {
            gradients,
            wanted,
            transposes,
        };
        for i in (0..=loss.index()).rev() {
            let Mark {
                needed,
                seen,
                gradient,
            } = marks[i];
            if !(needed && seen) {
                continue;
            }
            let node = nodes[i];
            let (below, own) = memory.split_at_mut(gradient);
            let mut step = Step {
                parameters,
                nodes,
                values: values.slice(),
                marks,
                below,
            };
            let own = &mut own[..node.len()];
            step.run(Var(i as u32), &node, own, &mut sink, scratch, lists);
        }
    }

    /// Finds which nodes need a gradient and gives those memory.
    fn mark(&mut self, loss: Var, wanted: &dyn Fn(ParamId) -> bool) {
        let arena = &mut *self.arena;
        arena.marks.clear();
        arena.marks.resize(arena.nodes.len(), Mark::default());
        let mut used = 0;
        for (i, node) in arena.nodes[..=loss.index()].iter().enumerate() {
            let need = |v: Var| arena.marks[v.index()].needed;
            let needed = match node.op {
                Op::Constant => false,
                Op::Leaf => true,
                Op::Param(id) => wanted(id),
                Op::Dense {
                    x, weight, bias, ..
                } => need(x) || wanted(weight) || wanted(bias),
                Op::Gru { cell, x, h, .. } => {
                    need(x) || need(h) || cell.ids().into_iter().any(wanted)
                }
                Op::Concat { from, count } | Op::Join { from, count } => arena.lists
                    [from..from + count]
                    .iter()
                    .any(|&part| need(Var(part))),
                Op::Rows { x, .. }
                | Op::Select { x, .. }
                | Op::Unfold { x, .. }
                | Op::Columns { x, .. }
                | Op::Fold { x, .. } => need(x),
                Op::Product { x, weight } => need(x) || wanted(weight),
                Op::Broadcast(x)
                | Op::Spread(x)
                | Op::Unary(_, x)
                | Op::LogSoftmax(x)
                | Op::SumRows(x)
                | Op::SumAll(x, _)
                | Op::Reshape(x) => need(x),
                Op::Binary(_, a, b) => need(a) || need(b),
                Op::Sample {
                    mean,
                    deviation,
                    noise,
                } => need(mean) || need(deviation) || need(noise),
                Op::LogDensity { x, mean, deviation } => need(x) || need(mean) || need(deviation),
                Op::Kl {
                    mean_q,
                    dev_q,
                    mean_p,
                    dev_p,
                } => need(mean_q) || need(dev_q) || need(mean_p) || need(dev_p),
            };
            if needed {
                arena.marks[i] = Mark {
                    needed,
                    seen: false,
                    gradient: used,
                };
                used += node.len().next_multiple_of(LANES);
            }
        }
        arena.gradients.reserve(used);
    }
}

impl Step<'_> {
    /// Passes a node's gradient `g` on to its inputs.
    fn run(
        &mut self,
        this: Var,
        node: &Node,
        g: &mut [f32],
        sink: &mut Sink,
        scratch: &mut crate::tensor::Buffer,
        lists: &[u32],
    ) {
        let (rows, cols) = (node.rows, node.cols);
        match node.op {
            Op::Constant | Op::Leaf => {}
            Op::Param(id) => kernels::copy(false, sink.gradients.get_mut(id).data_mut(), g),
            Op::Dense {
                x,
                weight,
                bias,
                activation,
            } => {
                let y = self.value(this);
                match activation {
                    Activation::Identity => {}
                    Activation::Elu => kernels::elu_back(g, y),
                    Activation::Tanh => kernels::tanh_back(g, y),
                    Activation::Softplus => kernels::softplus_back(g, y, SMALLEST_DEVIATION),
                }
                self.linear(sink, g, x, weight, Some(bias), rows, cols);
            }
            Op::Gru { cell, x, h, saved } => {
                let part = 3 * rows * cols;
                scratch.reserve(2 * part);
                let (d_input, d_hidden) = scratch.slice_mut()[..2 * part].split_at_mut(part);
                let (gates, hidden_part) = self.values[saved..saved + 2 * part].split_at(part);
                let state = self.value(h);
                let dh = self.gradient(h);
                cell.backward(gates, hidden_part, state, g, d_input, d_hidden, dh, cols);
                let (wx, bx) = (cell.input_weight, cell.input_bias);
                let (wh, bh) = (cell.hidden_weight, cell.hidden_bias);
                self.linear(sink, d_input, x, wx, Some(bx), 3 * rows, cols);
                self.linear(sink, d_hidden, h, wh, Some(bh), 3 * rows, cols);
            }
            Op::Concat { from, count } => {
                let mut start = 0;
                for &part in &lists[from..from + count] {
                    let height = self.nodes[part as usize].rows;
                    if height > 0
                        && let Some((first, dx)) = self.gradient(Var(part))
                    {
                        for (dx, g) in dx.chunks_exact_mut(height).zip(g.chunks_exact(rows)) {
                            accumulate(first, dx, &g[start..start + height]);
                        }
                    }
                    start += height;
                }
            }
            Op::Rows { x, from } => {
                let height = self.nodes[x.index()].rows;
                if rows > 0
                    && let Some((first, dx)) = self.gradient(x)
                {
                    if first {
                        dx.fill(0.0);
                    }
                    for (dx, g) in dx.chunks_exact_mut(height).zip(g.chunks_exact(rows)) {
                        accumulate(first, &mut dx[from..from + rows], g);
                    }
                }
            }
            Op::Broadcast(x) => {
                if let Some((first, dx)) = self.gradient(x) {
                    kernels::row_sums(first, dx, g);
                }
            }
            Op::Spread(x) => {
                if let Some((first, dx)) = self.gradient(x) {
                    scratch.reserve(cols);
                    let sums = &mut scratch.slice_mut()[..cols];
                    kernels::column_sums(sums, g, rows);
                    kernels::copy(first, dx, sums);
                }
            }
            Op::SumRows(x) => {
                let height = self.nodes[x.index()].rows;
                if let Some((first, dx)) = self.gradient(x) {
                    kernels::spread_row(first, dx, g, height);
                }
            }
            Op::SumAll(x, factor) => {
                let value = g[0] * factor;
                if let Some((first, dx)) = self.gradient(x) {
                    if first {
                        dx.fill(value);
                    } else {
                        dx.iter_mut().for_each(|d| *d += value);
                    }
                }
            }
            Op::Join { from, count } => {
                let mut start = 0;
                for &part in &lists[from..from + count] {
                    let length = self.nodes[part as usize].len();
                    if let Some((first, dx)) = self.gradient(Var(part)) {
                        kernels::copy(first, dx, &g[start..start + length]);
                    }
                    start += length;
                }
            }
            Op::Columns { x, from } => {
                if let Some((first, dx)) = self.gradient(x) {
                    if first {
                        dx.fill(0.0);
                    }
                    let at = from * rows;
                    kernels::copy(false, &mut dx[at..at + g.len()], g);
                }
            }
            Op::Reshape(x) => {
                if let Some((first, dx)) = self.gradient(x) {
                    kernels::copy(first, dx, g);
                }
            }
            Op::Unfold { x, windows } => {
                if let Some((first, dx)) = self.gradient(x) {
                    windows.fold(first, dx, g);
                }
            }
            Op::Fold { x, windows } => {
                if let Some((first, dx)) = self.gradient(x) {
                    windows.unfold(first, dx, g);
                }
            }
            Op::Product { x, weight } => self.linear(sink, g, x, weight, None, rows, cols),
            Op::Unary(op, x) => self.unary(op, x, this, g),
            Op::Binary(op, a, b) => self.binary(op, a, b, this, g),
            Op::Sample {
                mean,
                deviation,
                noise,
            } => {
                let (s, e) = (self.value(deviation), self.value(noise));
                if let Some((first, d)) = self.gradient(mean) {
                    kernels::copy(first, d, g);
                }
                if let Some((first, d)) = self.gradient(deviation) {
                    kernels::product(first, d, g, e);
                }
                if let Some((first, d)) = self.gradient(noise) {
                    kernels::product(first, d, g, s);
                }
            }
            Op::LogDensity { x, mean, deviation } => {
                let [xs, m, s] = [x, mean, deviation].map(|v| self.value(v));
                if let Some((first, d)) = self.gradient(x) {
                    kernels::log_density_d_mean(first, d, g, xs, m, s, -1.0);
                }
                if let Some((first, d)) = self.gradient(mean) {
                    kernels::log_density_d_mean(first, d, g, xs, m, s, 1.0);
                }
                if let Some((first, d)) = self.gradient(deviation) {
                    kernels::log_density_d_deviation(first, d, g, xs, m, s);
                }
            }
            Op::Kl {
                mean_q,
                dev_q,
                mean_p,
                dev_p,
            } => {
                let [mq, sq, mp, sp] = [mean_q, dev_q, mean_p, dev_p].map(|v| self.value(v));
                if let Some((first, d)) = self.gradient(mean_q) {
                    kernels::kl_d_mean(first, d, g, mq, mp, sp, 1.0);
                }
                if let Some((first, d)) = self.gradient(mean_p) {
                    kernels::kl_d_mean(first, d, g, mq, mp, sp, -1.0);
                }
                if let Some((first, d)) = self.gradient(dev_q) {
                    kernels::kl_d_dev_q(first, d, g, sq, sp);
                }
                if let Some((first, d)) = self.gradient(dev_p) {
                    kernels::kl_d_dev_p(first, d, g, mq, sq, mp, sp);
                }
            }
            Op::LogSoftmax(x) => {
                let y = self.value(this);
                if rows > 0
                    && let Some((first, dx)) = self.gradient(x)
                {
                    for ((dx, g), y) in dx
                        .chunks_exact_mut(rows)
                        .zip(g.chunks_exact(rows))
                        .zip(y.chunks_exact(rows))
                    {
                        let mut total = [0.0];
                        kernels::column_sums(&mut total, g, rows);
                        kernels::log_softmax_d(first, dx, g, y, total[0]);
                    }
                }
            }
            Op::Select { x, from } => {
                let height = self.nodes[x.index()].rows;
                if let Some((first, dx)) = self.gradient(x) {
                    if first {
                        dx.fill(0.0);
                    }
                    for (j, &class) in lists[from..from + cols].iter().enumerate() {
                        dx[j * height + class as usize] += g[j];
                    }
                }
            }
        }
    }

    /// Gradients of y = W x (+ b) from dy.
    #[allow(clippy::too_many_arguments)]
    fn linear(
        &mut self,
        sink: &mut Sink,
        g: &[f32],
        x: Var,
        weight: ParamId,
        bias: Option<ParamId>,
        outputs: usize,
        batch: usize,
    ) {
        let inputs = self.nodes[x.index()].rows;
        if let Some(bias) = bias
            && (sink.wanted)(bias)
        {
            kernels::row_sums(false, sink.gradients.get_mut(bias).data_mut(), g);
        }
        if (sink.wanted)(weight) {
            let dw = sink.gradients.get_mut(weight).data_mut();
            product::add_outer(dw, g, self.value(x), outputs, inputs, batch);
        }
        if self.marks[x.index()].needed {
            let transposed = sink.transposed(self.parameters, weight);
            if let Some((first, dx)) = self.gradient(x) {
                product::weight_times(first, dx, transposed, g, inputs, outputs, batch);
            }
        }
    }

    fn unary(&mut self, op: Unary, x: Var, this: Var, g: &[f32]) {
        let (value, y) = (self.value(x), self.value(this));
        let Some((first, dx)) = self.gradient(x) else {
            return;
        };
        match op {
            Unary::Scale(s) => kernels::scale(first, dx, g, s),
            Unary::Offset => kernels::copy(first, dx, g),
            Unary::Square => kernels::square_d(first, dx, g, value),
            Unary::Exp => kernels::exp_d(first, dx, g, y),
            Unary::Ln => kernels::ln_d(first, dx, g, value),
            Unary::Tanh => kernels::tanh_d(first, dx, g, y),
            Unary::Sigmoid => kernels::sigmoid_d(first, dx, g, y),
            Unary::Softplus => kernels::softplus_d(first, dx, g, value),
            Unary::Elu => kernels::elu_d(first, dx, g, y),
            Unary::Abs => kernels::abs_d(first, dx, g, value),
            Unary::Clamp(low, high) => kernels::clamp_d(first, dx, g, value, low, high),
            Unary::TanhLog => kernels::tanh_log_d(first, dx, g, value),
        }
    }

    fn binary(&mut self, op: Binary, a: Var, b: Var, this: Var, g: &[f32]) {
        let (va, vb, y) = (self.value(a), self.value(b), self.value(this));
        if let Some((first, da)) = self.gradient(a) {
            match op {
                Binary::Add | Binary::Sub => kernels::copy(first, da, g),
                Binary::Mul => kernels::product(first, da, g, vb),
                Binary::Div => kernels::quotient(first, da, g, vb),
                Binary::Min => kernels::minimum_d(first, da, g, va, vb),
                Binary::Max => kernels::maximum_d(first, da, g, va, vb),
            }
        }
        if let Some((first, db)) = self.gradient(b) {
            match op {
                Binary::Add => kernels::copy(first, db, g),
                Binary::Sub => kernels::scale(first, db, g, -1.0),
                Binary::Mul => kernels::product(first, db, g, va),
                Binary::Div => kernels::quotient_d_below(first, db, g, y, vb),
                Binary::Min => kernels::minimum_d(first, db, g, vb, va),
                Binary::Max => kernels::maximum_d(first, db, g, vb, va),
            }
        }
    }
}

fn accumulate(first: bool, to: &mut [f32], from: &[f32]) {
    if first {
        to.copy_from_slice(from);
    } else {
        to.iter_mut().zip(from).for_each(|(a, b)| *a += b);
    }
}
