//! Simulated people: what they perceive, what they know, what they do.

use super::{Mask, Sight};

/// A simulated person. They take in everything that they perceive or are told and never forget it within a round.
///
/// A step is `look` (what they perceive by themselves), `perceive` (that and what was communicated), then `act`. For imagined
/// futures the same person is cloned, given other random numbers by `reseed`, and shown imagined observations.
pub trait Mind: Send {
    /// Starts a round with an empty memory; random numbers come from (seed, episode).
    fn reset(&mut self, seed: u64, episode: u32);

    /// Takes other random numbers and keeps the memory.
    fn reseed(&mut self, seed: u64, episode: u32, stream: u64);

    /// The true perceptual parameters.
    fn sight(&self) -> &Sight;

    /// What they perceive by themselves of an observation's visual modality.
    fn look(&mut self, visual: &[f32]) -> Mask;

    /// Takes in an observation: of `visual` what no mask governs and the regions in `perceived`, of `verbal` the utterances in
    /// it. Nothing else of the slices is read.
    fn perceive(&mut self, visual: &[f32], verbal: &[f32], perceived: Mask);

    /// Probabilities of the actions, given what they now know; `out` has as many places as there are actions.
    fn probabilities(&mut self, out: &mut [f32]);

    /// Draws an action from [`probabilities`](Mind::probabilities) and does it.
    fn act(&mut self) -> usize;

    /// Tells them what they did, in place of [`act`](Mind::act): where the real person's action is known.
    fn acted(&mut self, action: usize);
}
