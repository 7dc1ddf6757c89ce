//! Inputs, and operations that move, repeat or sum numbers.

use super::{Op, Place, Tape, Var};
use crate::{ParamId, Tensor, kernels};
use std::ops::Range;

impl Tape<'_> {
    /// A constant: a copy of `x`.
    pub fn input(&mut self, x: &Tensor) -> Var {
        self.record(Op::Constant, x.rows(), x.cols(), |_, out| {
            out.copy_from_slice(x.data());
        })
    }

    /// A constant rows × cols that `write` fills, column after column (what it finds there is unspecified).
    pub fn input_with(&mut self, rows: usize, cols: usize, write: impl FnOnce(&mut [f32])) -> Var {
        self.record(Op::Constant, rows, cols, |_, out| write(out))
    }

    /// A constant of one number everywhere.
    pub fn constant(&mut self, rows: usize, cols: usize, value: f32) -> Var {
        self.record(Op::Constant, rows, cols, |_, out| out.fill(value))
    }

    /// A variable whose gradient can be read with [`Tape::grad`] after [`Tape::backward`].
    pub fn leaf(&mut self, x: &Tensor) -> Var {
        self.record(Op::Leaf, x.rows(), x.cols(), |_, out| {
            out.copy_from_slice(x.data());
        })
    }

    /// A parameter tensor itself as a variable, without copying it.
    pub fn param(&mut self, id: ParamId) -> Var {
        let tensor = self.parameters.get(id);
        self.place(
            Op::Param(id),
            tensor.rows(),
            tensor.cols(),
            Place::Parameter(id),
        )
    }

    /// The same numbers as a constant: no gradient passes.
    pub fn stop(&mut self, v: Var) -> Var {
        let node = self.arena.nodes[v.index()];
        self.place(Op::Constant, node.rows, node.cols, node.place)
    }

    /// [a; b; …]: rows stacked.
    ///
    /// # Panics
    /// If the parts' columns differ.
    pub fn concat(&mut self, parts: &[Var]) -> Var {
        let cols = self.shape(parts[0]).1;
        let mut rows = 0;
        for &part in parts {
            assert_eq!(self.shape(part).1, cols, "columns of concatenated parts");
            rows += self.shape(part).0;
        }
        let from = self.arena.lists.len();
        self.arena.lists.extend(parts.iter().map(|part| part.0));
        let op = Op::Concat {
            from,
            count: parts.len(),
        };
        self.record(op, rows, cols, |before, out| {
            let mut start = 0;
            for &part in parts {
                let x = before.value(part);
                let height = before.nodes[part.index()].rows;
                if height == 0 {
                    continue;
                }
                for (out, x) in out.chunks_exact_mut(rows).zip(x.chunks_exact(height)) {
                    out[start..start + height].copy_from_slice(x);
                }
                start += height;
            }
        })
    }

    /// Some of the rows.
    ///
    /// # Panics
    /// If the range leaves the variable.
    pub fn rows(&mut self, v: Var, range: Range<usize>) -> Var {
        let (height, cols) = self.shape(v);
        assert!(
            range.start <= range.end && range.end <= height,
            "rows out of range"
        );
        let (from, rows) = (range.start, range.len());
        self.record(Op::Rows { x: v, from }, rows, cols, |before, out| {
            if rows == 0 {
                return;
            }
            let x = before.value(v);
            for (out, x) in out.chunks_exact_mut(rows).zip(x.chunks_exact(height)) {
                out.copy_from_slice(&x[from..from + rows]);
            }
        })
    }

    /// [a, b, …]: columns side by side.
    ///
    /// # Panics
    /// If the parts' rows differ.
    pub fn join(&mut self, parts: &[Var]) -> Var {
        let rows = self.shape(parts[0]).0;
        let mut cols = 0;
        for &part in parts {
            assert_eq!(self.shape(part).0, rows, "rows of joined parts");
            cols += self.shape(part).1;
        }
        let from = self.arena.lists.len();
        self.arena.lists.extend(parts.iter().map(|part| part.0));
        let op = Op::Join {
            from,
            count: parts.len(),
        };
        self.record(op, rows, cols, |before, out| {
            let mut start = 0;
            for &part in parts {
                let x = before.value(part);
                out[start..start + x.len()].copy_from_slice(x);
                start += x.len();
            }
        })
    }

    /// Some of the columns.
    ///
    /// # Panics
    /// If the range leaves the variable.
    pub fn columns(&mut self, v: Var, range: Range<usize>) -> Var {
        let (rows, width) = self.shape(v);
        assert!(
            range.start <= range.end && range.end <= width,
            "columns out of range"
        );
        let op = Op::Columns {
            x: v,
            from: range.start,
        };
        self.record(op, rows, range.len(), |before, out| {
            out.copy_from_slice(&before.value(v)[range.start * rows..range.end * rows]);
        })
    }

    /// r × 1 repeated to r × cols.
    pub fn broadcast(&mut self, v: Var, cols: usize) -> Var {
        let (rows, one) = self.shape(v);
        assert_eq!(one, 1, "broadcast takes one column");
        self.record(Op::Broadcast(v), rows, cols, |before, out| {
            let x = before.value(v);
            if rows > 0 {
                out.chunks_exact_mut(rows)
                    .for_each(|out| out.copy_from_slice(x));
            }
        })
    }

    /// 1 × cols repeated to rows × cols.
    pub fn spread(&mut self, v: Var, rows: usize) -> Var {
        let (one, cols) = self.shape(v);
        assert_eq!(one, 1, "spread takes one row");
        self.record(Op::Spread(v), rows, cols, |before, out| {
            kernels::spread_row(true, out, before.value(v), rows);
        })
    }

    /// Sum over features: 1 × batch.
    pub fn sum_rows(&mut self, v: Var) -> Var {
        let (rows, cols) = self.shape(v);
        self.record(Op::SumRows(v), 1, cols, |before, out| {
            kernels::column_sums(out, before.value(v), rows);
        })
    }

    /// Sum of everything: 1 × 1.
    pub fn sum(&mut self, v: Var) -> Var {
        self.sum_all(v, 1.0)
    }

    /// Mean of everything: 1 × 1.
    pub fn mean(&mut self, v: Var) -> Var {
        let (rows, cols) = self.shape(v);
        self.sum_all(v, 1.0 / (rows * cols) as f32)
    }

    fn sum_all(&mut self, v: Var, factor: f32) -> Var {
        self.record(Op::SumAll(v, factor), 1, 1, |before, out| {
            out[0] = (kernels::sum_all(before.value(v)) * f64::from(factor)) as f32;
        })
    }

    /// Row `classes[j]` of column j: 1 × batch, of log-probabilities for instance.
    ///
    /// # Panics
    /// If there are not as many classes as columns, or one is out of range.
    pub fn select_log_prob(&mut self, v: Var, classes: &[u32]) -> Var {
        let (rows, cols) = self.shape(v);
        assert_eq!(classes.len(), cols, "one class per column");
        let from = self.arena.lists.len();
        self.arena.lists.extend_from_slice(classes);
        self.record(Op::Select { x: v, from }, 1, cols, |before, out| {
            let x = before.value(v);
            let classes = &before.lists[from..from + cols];
            for (j, (out, &class)) in out.iter_mut().zip(classes).enumerate() {
                assert!((class as usize) < rows, "class out of range");
                *out = x[j * rows + class as usize];
            }
        })
    }

    /// Logarithm of the softmax over each column.
    pub fn log_softmax(&mut self, v: Var) -> Var {
        let (rows, cols) = self.shape(v);
        self.record(Op::LogSoftmax(v), rows, cols, |before, out| {
            kernels::log_softmax(out, before.value(v), rows);
        })
    }
}
