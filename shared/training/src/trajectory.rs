//! What a recurrent policy learns from: rounds as the person perceived them, step by step, with what they did. BC and SQIL are
//! told what the person could really see (paper §IV-A).

use crate::rounds::Round;
use domains::ActionSpace;
use models::View;
use models::policy::largest;
use nn::Tensor;

/// One round as it was perceived.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// Masked observations with their masks, `view rows × steps`.
    pub observed: Tensor,
    /// a_t, `numbers of an action × steps`; of a choice, zeros with a one.
    pub action: Tensor,
    /// Whether nothing can follow the last step.
    pub ended: bool,
}

impl Trajectory {
    /// A round whose [`Round::perceived`] is known.
    ///
    /// # Panics
    /// If it is not.
    pub fn new(round: &Round, view: &View, actions: ActionSpace) -> Self {
        let steps = round.len();
        let mut observed = Tensor::new(view.rows(), steps);
        for t in 0..steps {
            let (visual, verbal) = (round.visual(t), round.verbal(t));
            view.write(visual, verbal, round.perceived[t], observed.column_mut(t));
        }
        Self {
            observed,
            action: Tensor::from_slice(actions.rows(), steps, &round.action),
            ended: round.ended,
        }
    }

    /// Steps.
    pub fn steps(&self) -> usize {
        self.action.cols()
    }
}

/// Parts of trajectories side by side; tensors are `features × (steps · columns)`, step after step.
pub struct Sequences {
    /// Steps of the longest part.
    pub steps: usize,
    /// Parts.
    pub columns: usize,
    /// What was perceived.
    pub observed: Tensor,
    /// a_{t−1}.
    pub previous: Tensor,
    /// a_t.
    pub action: Tensor,
    /// a_t as numbers of choices.
    pub taken: Vec<u32>,
    /// 1 where there is a step, `1 × …`.
    pub weight: Tensor,
    /// 1 where there is one after which nothing can follow.
    pub last: Tensor,
}

impl Sequences {
    /// Up to `longest` steps of each trajectory, from a step of its own on.
    ///
    /// # Panics
    /// If there is no part.
    pub fn new(parts: &[(&Trajectory, usize)], longest: usize) -> Self {
        let first = parts[0].0;
        let left = |(trajectory, start): &(&Trajectory, usize)| {
            trajectory.steps().saturating_sub(*start).min(longest)
        };
        let steps = parts.iter().map(left).max().unwrap_or(0);
        let columns = parts.len();
        let all = steps * columns;
        let mut out = Self {
            steps,
            columns,
            observed: Tensor::new(first.observed.rows(), all),
            previous: Tensor::new(first.action.rows(), all),
            action: Tensor::new(first.action.rows(), all),
            taken: vec![0; all],
            weight: Tensor::new(1, all),
            last: Tensor::new(1, all),
        };
        for (j, &(trajectory, start)) in parts.iter().enumerate() {
            for t in 0..left(&(trajectory, start)) {
                let (at, from) = (t * columns + j, start + t);
                let observed = trajectory.observed.column(from);
                out.observed.column_mut(at).copy_from_slice(observed);
                if from > 0 {
                    let before = trajectory.action.column(from - 1);
                    out.previous.column_mut(at).copy_from_slice(before);
                }
                let action = trajectory.action.column(from);
                out.action.column_mut(at).copy_from_slice(action);
                out.taken[at] = largest(action) as u32;
                out.weight.data_mut()[at] = 1.0;
                let is_last = trajectory.ended && from + 1 == trajectory.steps();
                out.last.data_mut()[at] = f32::from(u8::from(is_last));
            }
        }
        out
    }

    /// The rounds that have a step, cut into windows that follow each other: as many columns in each.
    pub fn windows(rounds: &[Trajectory], window: usize) -> Vec<Self> {
        let used: Vec<&Trajectory> = rounds.iter().filter(|r| r.steps() > 0).collect();
        let longest = used.iter().map(|r| r.steps()).max().unwrap_or(0);
        let part = |start| {
            let parts: Vec<_> = used.iter().map(|round| (*round, start)).collect();
            Self::new(&parts, window)
        };
        (0..longest).step_by(window).map(part).collect()
    }

    /// All steps of the rounds that have some; none if none has.
    pub fn whole(rounds: &[Trajectory]) -> Option<Self> {
        Self::windows(rounds, usize::MAX).pop()
    }

    /// Steps that there are.
    pub fn counted(&self) -> f32 {
        self.weight.data().iter().sum()
    }
}

/// Holds out a quarter of the rounds, at least one of two or more, for validation: (to learn from, to validate on).
pub fn hold_out<T>(rounds: Vec<T>) -> (Vec<T>, Vec<T>) {
    let n = rounds.len();
    let held = if n < 2 { 0 } else { n.div_ceil(4) };
    // Evenly spread, the last one among them.
    let is_held = |i: usize| held > 0 && (i + 1) * held / n > i * held / n;
    let (mut learn, mut validate) = (Vec::new(), Vec::new());
    for (i, round) in rounds.into_iter().enumerate() {
        if is_held(i) {
            validate.push(round);
        } else {
            learn.push(round);
        }
    }
    (learn, validate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_of_the_rounds_is_held_out() {
        for (rounds, held) in [(1, 0), (2, 1), (4, 1), (6, 2), (20, 5)] {
            let (learn, validate) = hold_out((1..=rounds).collect());
            assert_eq!((learn.len(), validate.len()), (rounds - held, held));
            let mut all: Vec<usize> = learn.into_iter().chain(validate).collect();
            all.sort_unstable();
            assert_eq!(all, (1..=rounds).collect::<Vec<_>>());
        }
    }

    /// A part begins with the action before it, and what lies beyond a round's end weighs nothing.
    #[test]
    fn parts_know_what_came_before_and_where_they_end() {
        let steps = |n: usize, ended| Trajectory {
            observed: Tensor::from_slice(1, n, &(0..n).map(|t| t as f32).collect::<Vec<_>>()),
            action: Tensor::from_slice(1, n, &(0..n).map(|t| -(t as f32)).collect::<Vec<_>>()),
            ended,
        };
        let (long, short) = (steps(5, false), steps(2, true));
        let parts = Sequences::new(&[(&long, 2), (&short, 0)], 3);
        assert_eq!((parts.steps, parts.columns, parts.counted()), (3, 2, 5.0));
        assert_eq!(parts.observed.data(), [2.0, 0.0, 3.0, 1.0, 4.0, 0.0]);
        assert_eq!(parts.previous.data(), [-1.0, 0.0, -2.0, 0.0, -3.0, 0.0]);
        assert_eq!(parts.weight.data(), [1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
        assert_eq!(parts.last.data(), [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    }
}
