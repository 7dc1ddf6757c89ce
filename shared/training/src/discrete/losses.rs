//! The losses of a gridworld's training step on one shard of a batch, and their gradients ([`super::dqn`] has the equations).

use super::batch::Shard;
use super::replay::NO_ACTION;
use super::settings::Settings;
use models::policy::largest;
use models::{Scratch, SelfModel};
use nn::{Arena, Gradients, Parameters, Tape, Tensor, Var};

/// A shard's losses.
#[derive(Clone, Copy, Default)]
pub(super) struct Losses {
    /// −ELBO.
    pub loss: f32,
    /// −Σ_m log p(x^m | z).
    pub reconstruction: f32,
    /// −log p(r | z).
    pub reward: f32,
    /// KL(q ‖ p).
    pub divergence: f32,
    /// L_Q.
    pub q: f32,
    /// L_m.
    pub imitation: f32,
}

impl Losses {
    /// Adds a share of other losses.
    pub fn accumulate(&mut self, other: Self, share: f32) {
        self.loss += share * other.loss;
        self.reconstruction += share * other.reconstruction;
        self.reward += share * other.reward;
        self.divergence += share * other.divergence;
        self.q += share * other.q;
        self.imitation += share * other.imitation;
    }
}

/// One shard's memory.
pub(super) struct Worker {
    /// What [`Worker::step`] found.
    pub gradients: Gradients,
    arena: Arena,
    returns: Returns,
    rivals: Rivals,
}

impl Worker {
    /// Memory for gradients of these parameters.
    pub fn new(parameters: &Parameters) -> Self {
        Self {
            gradients: Gradients::for_params(parameters),
            arena: Arena::new(),
            returns: Returns::default(),
            rivals: Rivals::default(),
        }
    }

    /// Gradients of all losses on one shard; the ELBO's divergence has weight `divergence`.
    pub fn step(
        &mut self,
        model: &SelfModel,
        target: &SelfModel,
        shard: &Shard,
        settings: &Settings,
        divergence: f32,
    ) -> Losses {
        let (columns, all) = (shard.batch.columns, shard.taken.len());
        let transitions = all - columns;
        self.gradients.zero();
        let mut tape = Tape::new(&model.parameters, &mut self.arena);
        let terms = model.negative_elbo(&mut tape, &shard.batch);
        let returns = &mut self.returns;
        returns.follow(model, target, tape.value(terms.z), shard, settings);

        let z = match settings.joint {
            true => terms.z,
            false => tape.stop(terms.z),
        };
        let before = tape.columns(z, 0..transitions);
        let values = tape.mlp(model.policy.q().0, before);
        let chosen = tape.select_log_prob(values, &returns.taken);
        let goal = tape.input(&returns.goal);
        let error = tape.sub(chosen, goal);
        let squared = tape.square(error);
        let q = mean_of(&mut tape, squared, &returns.counts);

        let rivals = &mut self.rivals;
        rivals.find(tape.value(values), shard, settings.margin);
        let rival = tape.select_log_prob(values, &rivals.rival);
        let expert = tape.select_log_prob(values, &rivals.expert);
        let ahead = tape.sub(rival, expert);
        let margin = tape.input(&rivals.margin);
        let short = tape.add(ahead, margin);
        let imitation = mean_of(&mut tape, short, &rivals.counts);

        let lighter = tape.scale(terms.divergence, divergence - 1.0);
        let total = tape.add(terms.loss, lighter);
        let total = tape.add(total, q);
        let weighted = tape.scale(imitation, settings.imitation);
        let total = tape.add(total, weighted);
        tape.backward(total, &mut self.gradients, &|_| true);
        Losses {
            loss: tape.scalar(terms.loss),
            reconstruction: tape.scalar(terms.reconstruction),
            reward: tape.scalar(terms.reward),
            divergence: tape.scalar(terms.divergence),
            q: tape.scalar(q),
            imitation: tape.scalar(imitation),
        }
    }
}

/// Mean of those of `terms` (1 × transitions) that count, a 1 each; 0 where none does.
fn mean_of(tape: &mut Tape, terms: Var, counts: &Tensor) -> Var {
    let number: f32 = counts.data().iter().sum();
    let counts = tape.input(counts);
    let counted = tape.mul(terms, counts);
    let sum = tape.sum(counted);
    tape.scale(sum, 1.0 / number.max(1.0))
}

/// G_t of every transition, with the action that it is the return of.
#[derive(Default)]
struct Returns {
    goal: Tensor,
    taken: Vec<u32>,
    /// 1 where an action was taken.
    counts: Tensor,
    scratch: Scratch,
    after: Tensor,
    future: Tensor,
    choices: Tensor,
}

impl Returns {
    /// From the last step to the first. `z`: `latent × all`.
    fn follow(
        &mut self,
        model: &SelfModel,
        target: &SelfModel,
        z: &[f32],
        shard: &Shard,
        settings: &Settings,
    ) {
        let (batch, latent) = (&shard.batch, model.sizes.latent);
        let columns = batch.columns;
        let transitions = shard.taken.len() - columns;
        self.after.resize_to(latent, transitions);
        self.after
            .data_mut()
            .copy_from_slice(&z[latent * columns..]);
        target.q_values(&mut self.scratch, &self.after, &mut self.future);
        model.q_values(&mut self.scratch, &self.after, &mut self.choices);
        self.goal.resize_to(1, transitions);
        for j in (0..transitions).rev() {
            let next = j + columns;
            let best = largest(self.choices.column(j));
            let mut future = self.future.column(j)[best];
            if usize::from(shard.taken[next]) == best {
                // The last step's action is none, so that there is a G_{t+1} here.
                let followed = self.goal.data()[next];
                future += settings.trace * (followed - future);
            }
            let future = settings.discount * (1.0 - shard.terminal[next]) * future;
            self.goal.data_mut()[j] = batch.reward.data()[next] + future;
        }
        self.counts.resize_to(1, transitions);
        self.taken.clear();
        for (&taken, counts) in shard.taken.iter().zip(self.counts.data_mut()) {
            let (action, count) = known(taken);
            *counts = count;
            self.taken.push(action);
        }
    }
}

/// The best other actions of L_m beside the expert's.
#[derive(Default)]
struct Rivals {
    rival: Vec<u32>,
    expert: Vec<u32>,
    /// m, or 0 where the expert's action is itself the best by m.
    margin: Tensor,
    /// 1 where the expert is known.
    counts: Tensor,
}

impl Rivals {
    /// `values`: `actions × transitions`.
    fn find(&mut self, values: &[f32], shard: &Shard, margin: f32) {
        let transitions = shard.expert.len() - shard.batch.columns;
        let actions = values.len() / transitions;
        self.margin.resize_to(1, transitions);
        self.counts.resize_to(1, transitions);
        self.rival.clear();
        self.expert.clear();
        for (j, values) in values.chunks_exact(actions).enumerate() {
            let (expert, count) = known(shard.expert[j]);
            let mut best = (expert, 0.0, values[expert as usize]);
            for (action, value) in (0..).zip(values) {
                if action != expert && value + margin > best.2 {
                    best = (action, margin, value + margin);
                }
            }
            self.rival.push(best.0);
            self.expert.push(expert);
            self.margin.data_mut()[j] = best.1;
            self.counts.data_mut()[j] = count;
        }
    }
}

/// An action and 1, or any action and 0 if there is none.
fn known(action: u8) -> (u32, f32) {
    match action {
        NO_ACTION => (0, 0.0),
        action => (action.into(), 1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use domains::discrete::{Discrete, Domain, Scene, Setting, World};
    use models::Sizes;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use std::sync::Arc;

    /// L_m compares with the best other action, is 0 where the expert's is ahead by the margin, and counts nothing where there is
    /// no expert.
    #[test]
    fn rivals_are_within_the_margin() {
        let scene = Scene::of(Domain::SearchRescue, Setting::Original);
        let words = models::words::shipped(Domain::SearchRescue).unwrap();
        let world = World::new(&scene, &words).unwrap();
        let layout = Arc::new(world.layout().clone());
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let model = SelfModel::new(Sizes::of(&layout), layout, &mut rng);
        let mut shard = Shard {
            batch: models::self_model::Batch::new(&model, 2, 3),
            taken: vec![NO_ACTION; 6],
            expert: vec![2, 1, NO_ACTION, 0, 0, 0],
            terminal: vec![0.0; 6],
        };
        let values = [0.0, 0.5, 1.0, 0.9, 0.0, 1.0, 0.1, 0.0, 5.0, 0.0, 0.0, 0.0];
        let mut rivals = Rivals::default();
        rivals.find(&values, &shard, 0.8);
        assert_eq!(rivals.rival[..2], [3, 1]);
        assert_eq!(rivals.expert[..2], [2, 1]);
        assert_eq!(rivals.margin.data()[..2], [0.8, 0.0]);
        assert_eq!(rivals.counts.data(), [1.0, 1.0, 0.0]);
        // The expert's action is a rival to no one, not even to itself where it is behind.
        shard.expert[1] = 0;
        rivals.find(&values, &shard, 0.8);
        assert_eq!((rivals.rival[1], rivals.margin.data()[1]), (1, 0.8));
    }
}
