//! Drawing an action from its probabilities.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// An index drawn with probability proportional to its weight; the last of positive weight where rounding leaves none.
pub(crate) fn draw(weights: &[f32], random: &mut ChaCha8Rng) -> usize {
    let total: f32 = weights.iter().sum();
    let mut left = random.random::<f32>() * total;
    let mut last = 0;
    for (index, weight) in weights.iter().enumerate() {
        if *weight <= 0.0 {
            continue;
        }
        last = index;
        if left < *weight {
            break;
        }
        left -= weight;
    }
    last
}
