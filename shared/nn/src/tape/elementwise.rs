//! Elementwise operations of one and two variables.

use super::{Binary, Op, Tape, Unary, Var};
use crate::kernels;

macro_rules! unary {
    ($( $(#[$doc:meta])* $name:ident, $op:ident; )*) => { $(
        $(#[$doc])*
        pub fn $name(&mut self, v: Var) -> Var {
            let (rows, cols) = self.shape(v);
            self.record(Op::Unary(Unary::$op, v), rows, cols, |before, out| {
                kernels::$name(true, out, before.value(v));
            })
        }
    )* };
}

macro_rules! binary {
    ($( $(#[$doc:meta])* $name:ident, $op:ident, $kernel:ident; )*) => { $(
        $(#[$doc])*
        ///
        /// # Panics
        /// If the shapes differ.
        pub fn $name(&mut self, a: Var, b: Var) -> Var {
            assert_eq!(self.shape(a), self.shape(b), "shapes of a pairwise operation");
            let (rows, cols) = self.shape(a);
            self.record(Op::Binary(Binary::$op, a, b), rows, cols, |before, out| {
                kernels::$kernel(true, out, before.value(a), before.value(b));
            })
        }
    )* };
}

#[allow(clippy::should_implement_trait)]
impl Tape<'_> {
    unary! {
        /// x²
        square, Square;
        /// eˣ
        exp, Exp;
        /// ln x
        ln, Ln;
        /// tanh x
        tanh, Tanh;
        /// 1/(1 + e⁻ˣ)
        sigmoid, Sigmoid;
        /// ln(1 + eˣ); without the floor of [`crate::Activation::Softplus`].
        softplus, Softplus;
        /// x where positive, eˣ − 1 elsewhere.
        elu, Elu;
        /// |x|; its slope at 0 counts as 0.
        abs, Abs;
        /// ln(1 − tanh²x), stable for large |x|.
        tanh_log, TanhLog;
    }

    binary! {
        /// a + b
        add, Add, sum2;
        /// a − b
        sub, Sub, difference;
        /// a · b
        mul, Mul, product;
        /// a / b
        div, Div, quotient;
        /// The smaller; at a tie each side gets half the gradient.
        min, Min, minimum;
        /// The larger; at a tie each side gets half the gradient.
        max, Max, maximum;
    }

    /// s · x
    pub fn scale(&mut self, v: Var, s: f32) -> Var {
        let (rows, cols) = self.shape(v);
        self.record(Op::Unary(Unary::Scale(s), v), rows, cols, |before, out| {
            kernels::scale(true, out, before.value(v), s)
        })
    }

    /// x + s
    pub fn offset(&mut self, v: Var, s: f32) -> Var {
        let (rows, cols) = self.shape(v);
        self.record(Op::Unary(Unary::Offset, v), rows, cols, |before, out| {
            kernels::offset(true, out, before.value(v), s);
        })
    }

    /// −x
    pub fn neg(&mut self, v: Var) -> Var {
        self.scale(v, -1.0)
    }

    /// x kept within [low, high]; no gradient where it was outside.
    pub fn clamp(&mut self, v: Var, low: f32, high: f32) -> Var {
        let (rows, cols) = self.shape(v);
        self.record(
            Op::Unary(Unary::Clamp(low, high), v),
            rows,
            cols,
            |before, out| kernels::clamp(true, out, before.value(v), low, high),
        )
    }

    /// Repeats a single column where more are needed.
    pub(super) fn same_columns(&mut self, v: Var, cols: usize) -> Var {
        if self.shape(v).1 == 1 && cols != 1 {
            self.broadcast(v, cols)
        } else {
            v
        }
    }
}
