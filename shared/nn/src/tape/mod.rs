//! The tape: records operations on batches as they are computed, and walks them backwards for gradients.
//!
//! All values of a tape lie one after another in its arena, and so do all gradients; a node stores places in there. A
//! tape that records the same operations again allocates nothing.

mod backward;
mod categorical;
mod elementwise;
mod gaussian;
mod image;
mod network;
mod shape;

use crate::image::Windows;
use crate::tensor::{Buffer, LANES};
use crate::{Activation, Gru, ParamId, Parameters};

/// A matrix on the tape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Var(u32);

impl Var {
    fn index(self) -> usize {
        self.0 as usize
    }
}

/// Functions of one number, applied to each.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Unary {
    Scale(f32),
    Offset,
    Square,
    Exp,
    Ln,
    Tanh,
    Sigmoid,
    Softplus,
    Elu,
    Abs,
    Clamp(f32, f32),
    TanhLog,
}

/// Functions of two numbers, applied pairwise.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Binary {
    Add,
    Sub,
    Mul,
    Div,
    Min,
    Max,
}

/// What made a node.
#[derive(Clone, Copy, Debug)]
enum Op {
    /// A constant: no gradient passes.
    Constant,
    Leaf,
    Param(ParamId),
    Dense {
        x: Var,
        weight: ParamId,
        bias: ParamId,
        activation: Activation,
    },
    /// `saved`: place of the gates, and of the hidden part after them.
    Gru {
        cell: Gru,
        x: Var,
        h: Var,
        saved: usize,
    },
    /// Range of `Arena::lists`.
    Concat {
        from: usize,
        count: usize,
    },
    Rows {
        x: Var,
        from: usize,
    },
    /// r × 1 to r × cols.
    Broadcast(Var),
    /// 1 × cols to r × cols.
    Spread(Var),
    Unary(Unary, Var),
    Binary(Binary, Var, Var),
    Sample {
        mean: Var,
        deviation: Var,
        noise: Var,
    },
    /// Terms, not summed.
    LogDensity {
        x: Var,
        mean: Var,
        deviation: Var,
    },
    /// Terms, not summed.
    Kl {
        mean_q: Var,
        dev_q: Var,
        mean_p: Var,
        dev_p: Var,
    },
    LogSoftmax(Var),
    /// `from`: place of the classes in `Arena::lists`.
    Select {
        x: Var,
        from: usize,
    },
    SumRows(Var),
    SumAll(Var, f32),
    /// The same numbers in another shape, in the same place.
    Reshape(Var),
    Unfold {
        x: Var,
        windows: Windows,
    },
    Fold {
        x: Var,
        windows: Windows,
    },
    /// Columns side by side; range of `Arena::lists`.
    Join {
        from: usize,
        count: usize,
    },
    Columns {
        x: Var,
        from: usize,
    },
    /// W x
    Product {
        x: Var,
        weight: ParamId,
    },
}

/// Where a node's value lies.
#[derive(Clone, Copy, Debug)]
enum Place {
    Arena(usize),
    Parameter(ParamId),
}

#[derive(Clone, Copy, Debug)]
struct Node {
    op: Op,
    rows: usize,
    cols: usize,
    place: Place,
}

impl Node {
    fn len(&self) -> usize {
        self.rows * self.cols
    }
}

/// A node's state on the way back.
#[derive(Clone, Copy, Debug, Default)]
struct Mark {
    /// Whether a wanted parameter or a leaf lies below.
    needed: bool,
    /// Whether anything has arrived in its gradient yet.
    seen: bool,
    /// Place of its gradient, if needed.
    gradient: usize,
}

/// A tape's memory, reused from step to step.
#[derive(Default)]
pub struct Arena {
    nodes: Vec<Node>,
    marks: Vec<Mark>,
    values: Buffer,
    used: usize,
    gradients: Buffer,
    scratch: Buffer,
    lists: Vec<u32>,
    transposes: Transposes,
}

/// Transposed weights of one way back, by parameter.
#[derive(Default)]
struct Transposes {
    values: Buffer,
    used: usize,
    places: Vec<Option<usize>>,
}

impl Arena {
    /// Empty; grows with the first tape.
    pub fn new() -> Self {
        Self::default()
    }

    /// Bytes of values, gradients and scratch held.
    pub fn bytes(&self) -> usize {
        4 * (self.values.slice().len()
            + self.gradients.slice().len()
            + self.scratch.slice().len()
            + self.transposes.values.slice().len()
            + self.lists.capacity())
    }
}

/// Records operations over parameters. Variables of one tape must not be used with another.
pub struct Tape<'a> {
    parameters: &'a Parameters,
    arena: &'a mut Arena,
}

/// A node's value, given all values recorded before.
fn value_of<'s>(parameters: &'s Parameters, values: &'s [f32], node: &Node) -> &'s [f32] {
    match node.place {
        Place::Arena(at) => &values[at..at + node.len()],
        Place::Parameter(id) => parameters.get(id).data(),
    }
}

/// What a new node's computation sees: the values before it.
struct Before<'s> {
    parameters: &'s Parameters,
    nodes: &'s [Node],
    values: &'s [f32],
    lists: &'s [u32],
}

impl<'s> Before<'s> {
    fn value(&self, v: Var) -> &'s [f32] {
        value_of(self.parameters, self.values, &self.nodes[v.index()])
    }
}

impl<'a> Tape<'a> {
    /// An empty tape over these parameters, in the memory of earlier ones.
    pub fn new(parameters: &'a Parameters, arena: &'a mut Arena) -> Self {
        arena.nodes.clear();
        arena.marks.clear();
        arena.lists.clear();
        arena.used = 0;
        Self { parameters, arena }
    }

    /// The parameters that it was made over.
    pub fn parameters(&self) -> &'a Parameters {
        self.parameters
    }

    /// Rows and columns.
    pub fn shape(&self, v: Var) -> (usize, usize) {
        let node = &self.arena.nodes[v.index()];
        (node.rows, node.cols)
    }

    /// The numbers, column after column.
    pub fn value(&self, v: Var) -> &[f32] {
        value_of(
            self.parameters,
            self.arena.values.slice(),
            &self.arena.nodes[v.index()],
        )
    }

    /// The only number of a 1 × 1 variable.
    pub fn scalar(&self, v: Var) -> f32 {
        assert_eq!(self.shape(v), (1, 1), "not a single number");
        self.value(v)[0]
    }

    /// After [`Tape::backward`]: the loss's gradient with respect to a leaf (or a parameter taken by
    /// [`Tape::param`]); empty where the loss does not depend on it. What other variables show is unspecified, since
    /// layers work in place.
    pub fn grad(&self, v: Var) -> &[f32] {
        match self.arena.marks.get(v.index()) {
            Some(mark) if mark.needed && mark.seen => {
                let length = self.arena.nodes[v.index()].len();
                &self.arena.gradients.slice()[mark.gradient..mark.gradient + length]
            }
            _ => &[],
        }
    }

    /// Takes memory for `length` numbers.
    fn take(&mut self, length: usize) -> usize {
        let at = self.arena.used;
        self.arena.used = at + length.next_multiple_of(LANES);
        self.arena.values.reserve(self.arena.used);
        at
    }

    fn place(&mut self, op: Op, rows: usize, cols: usize, place: Place) -> Var {
        self.arena.nodes.push(Node {
            op,
            rows,
            cols,
            place,
        });
        Var(self.arena.nodes.len() as u32 - 1)
    }

    /// Adds a node whose value `compute` writes.
    fn record(
        &mut self,
        op: Op,
        rows: usize,
        cols: usize,
        compute: impl FnOnce(&Before, &mut [f32]),
    ) -> Var {
        let at = self.take(rows * cols);
        let arena = &mut *self.arena;
        let (old, new) = arena.values.slice_mut().split_at_mut(at);
        let before = Before {
            parameters: self.parameters,
            nodes: &arena.nodes,
            values: old,
            lists: &arena.lists,
        };
        compute(&before, &mut new[..rows * cols]);
        self.place(op, rows, cols, Place::Arena(at))
    }
}
