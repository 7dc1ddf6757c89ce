//! What people remember, as numbers: what is not known is 0.

/// A choice from 0, if it is known.
pub(crate) fn of_index(index: Option<usize>) -> f32 {
    index.map_or(0.0, |index| 1.0 + index as f32)
}

/// The choice among `count` that [`of_index`] wrote.
pub(crate) fn to_index(number: f32, count: usize) -> Option<usize> {
    (number as usize)
        .checked_sub(1)
        .filter(|index| *index < count)
}

/// Whether something is so, if it is known.
pub(crate) fn of_truth(truth: Option<bool>) -> f32 {
    truth.map_or(0.0, |yes| if yes { 1.0 } else { -1.0 })
}

/// The answer that [`of_truth`] wrote.
pub(crate) fn to_truth(number: f32) -> Option<bool> {
    (number != 0.0).then_some(number > 0.0)
}
