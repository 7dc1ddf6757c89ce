//! Deep Q-learning on the self-model's latent states (paper §III-A and appendix, "Model Architectures and Training").
//!
//! ```text
//! L   = −L_e + L_Q + w L_m
//! L_Q = E[(Q_ψ(z_t, a_t) − G_t)²]                                      ψ' ← ψ' + rate (ψ − ψ')
//! G_t = r_{t+1} + γ (1 − end_{t+1}) [(1 − λ_{t+1}) Q_ψ'(z_{t+1}, a*_{t+1}) + λ_{t+1} G_{t+1}]     a* = argmax_a Q_ψ(z, a)
//! L_m = E[max_a (Q_ψ(z_t, a) + m [a ≠ a^E_t]) − Q_ψ(z_t, a^E_t)]
//! ```
//!
//! Refinements of the paper's DQN, each with its reason:
//!
//! - The action is chosen by ψ and valued by ψ' (double Q-learning, van Hasselt et al. 2016): the plain maximum overestimates, and
//!   likelihoods and plans rest on the values themselves.
//! - Returns are followed along the sequence for as long as the action taken is the best one (Watkins' Q(λ); λ_t = 0 elsewhere):
//!   a rescue lies 24 steps ahead, and a training of minutes has no time to pass its value back step by step.
//! - L_m values the expert's action a^E above every other by a margin m (Hester et al. 2018, DQfD), in every state lived, whoever
//!   acted in it, so that the policy also learns the way back from where it strayed (Ross et al. 2011). Two actions' values often
//!   differ by less than the network's error: without L_m, now this, now that scenario of search and rescue ended between two cells
//!   of a corridor. Together with the cooling of the rate and sequences that end where rounds end, it gives the expert's return;
//!   which of the three does how much was not measured. The expert sees everything, so that what it does is a demonstration only to those who do: L_m counts where nothing was
//!   dropped, and what to do on partial sight is left to L_Q. (On the highway, SAC's loss is mixed with imitation, too.)
//! - Where there are images, q_φ learns from L_Q and L_m beside the ELBO (as in Yarats et al. 2021, SAC+AE). What matters of bomb
//!   defusal's image is one of six terminals, a sixth of what there is to reconstruct: z alone did not come to hold it within 2,500
//!   gradient steps; with their help it did in 1,800. Without images, z is a constant to L_Q.
//! - There, too, the ELBO's divergence counts little at first (Bowman et al. 2016): z begins as noise, and would be given up before
//!   it is of use. (Bomb defusal's terminals were read after 1,900 steps, without this not within 3,000.)
//! - At the end the learning rate falls to nothing, so that what is kept does not depend on the last few batches.

use crate::batches::Shard;
use crate::config::Checked;
use crate::sac::{foreseeing, lighter};
use crate::self_model::{Losses, Schedule};
use models::policy::largest;
use models::self_model::Batch;
use models::{Scratch, SelfModel};
use nn::{Arena, Gradients, ParamId, Parameters, Tape, Tensor, Var};
use serde::{Deserialize, Serialize};

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DqnSettings {
    /// Probability, in every step and whoever acts, of anything at all instead: who never sees a wrong button pressed cannot imagine what
    /// somebody's mistake costs.
    pub slips: f32,
    /// γ.
    pub discount: f32,
    /// Rate at which the target follows.
    pub target_rate: f32,
    /// λ where the best action was taken.
    pub trace: f32,
    /// m of L_m, the margin of Hester et al.
    pub margin: f32,
    /// w: weight of L_m.
    pub imitation: f32,
    /// Whether q_φ learns from L_Q and L_m beside the ELBO.
    pub joint: bool,
}

impl Checked for DqnSettings {
    fn problem(&self) -> Option<String> {
        let shares = [self.slips, self.discount, self.target_rate, self.trace];
        let others = [self.margin, self.imitation];
        (!shares.iter().all(|x| (0.0..=1.0).contains(x))
            || !others.iter().all(|x| x.is_finite() && *x >= 0.0))
        .then(|| {
            "dqn: slips, discount, target_rate and trace lie in [0, 1], margin and imitation are not negative"
                .to_owned()
        })
    }
}

/// The target of a run, and what moves it.
pub(crate) struct Dqn {
    settings: DqnSettings,
    /// ψ', with everything else beside it, unused.
    pub target: SelfModel,
    /// World model, Q-network.
    pub parts: Vec<Vec<ParamId>>,
}

/// One shard's memory.
#[derive(Default)]
pub(crate) struct DqnScratch {
    returns: Returns,
    rivals: Rivals,
}

impl Dqn {
    pub fn new(model: &SelfModel, settings: DqnSettings) -> Self {
        let ids = model.parameters.ids();
        let (q, world) = ids.partition(|id| model.parameters.name(*id).starts_with("q."));
        Self {
            settings,
            target: model.clone(),
            parts: vec![world, q],
        }
    }

    /// Losses and gradients of one shard.
    pub fn step(
        &self,
        model: &SelfModel,
        shard: &Shard,
        schedule: Schedule,
        scratch: &mut DqnScratch,
        arena: &mut Arena,
        gradients: &mut Gradients,
    ) -> Losses {
        let settings = &self.settings;
        let transitions = (shard.batch.steps - 1) * shard.batch.columns;
        let mut tape = Tape::new(&model.parameters, arena);
        let terms = model.negative_elbo(&mut tape, &shard.batch);
        let returns = &mut scratch.returns;
        returns.follow(model, &self.target, tape.value(terms.z), shard, settings);

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

        let rivals = &mut scratch.rivals;
        rivals.find(tape.value(values), shard, settings.margin);
        let rival = tape.select_log_prob(values, &rivals.rival);
        let expert = tape.select_log_prob(values, &rivals.expert);
        let ahead = tape.sub(rival, expert);
        let margin = tape.input(&rivals.margin);
        let short = tape.add(ahead, margin);
        let imitation = mean_of(&mut tape, short, &rivals.counts);

        let total = lighter(&mut tape, &terms, schedule.divergence);
        let (total, foresight) = foreseeing(&mut tape, model, shard, &terms, schedule, total);
        let total = tape.add(total, q);
        let weighted = tape.scale(imitation, settings.imitation);
        let total = tape.add(total, weighted);
        tape.backward(total, gradients, &|_| true);
        Losses {
            loss: tape.scalar(terms.loss),
            reconstruction: tape.scalar(terms.reconstruction),
            reward: tape.scalar(terms.reward),
            divergence: tape.scalar(terms.divergence),
            ending: tape.scalar(terms.ending),
            value: tape.scalar(q),
            policy: tape.scalar(imitation),
            foresight,
            log_density: 0.0,
        }
    }

    /// ψ' ← ψ' + rate (ψ − ψ').
    pub fn follow(&mut self, online: &Parameters) {
        let [_, q_ids] = &self.parts[..] else {
            return;
        };
        for &id in q_ids {
            let source = online.get(id).data();
            let target = self.target.parameters.get_mut(id).data_mut();
            for (target, source) in target.iter_mut().zip(source) {
                *target += self.settings.target_rate * (source - *target);
            }
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
        settings: &DqnSettings,
    ) {
        let (batch, latent) = (&shard.batch, model.sizes.latent);
        let columns = batch.columns;
        let transitions = (batch.steps - 1) * columns;
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
            // After the last step nothing is done, so that there is a G_{t+1} where something is.
            if taken_after(batch, next) == Some(best as u32) {
                let followed = self.goal.data()[next];
                future += settings.trace * (followed - future);
            }
            let future = settings.discount * (1.0 - shard.batch.ended.data()[next]) * future;
            self.goal.data_mut()[j] = batch.reward.data()[next] + future;
        }
        self.counts.resize_to(1, transitions);
        self.taken.clear();
        for (j, counts) in self.counts.data_mut().iter_mut().enumerate() {
            let taken = taken_after(batch, j);
            *counts = f32::from(u8::from(taken.is_some()));
            self.taken.push(taken.unwrap_or(0));
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
        let transitions = (shard.batch.steps - 1) * shard.batch.columns;
        let actions = shard.expert.rows();
        self.margin.resize_to(1, transitions);
        self.counts.resize_to(1, transitions);
        self.rival.clear();
        self.expert.clear();
        for (j, values) in values.chunks_exact(actions).enumerate() {
            let expert = choice(shard.expert.column(j));
            self.counts.data_mut()[j] = f32::from(u8::from(expert.is_some()));
            let expert = expert.unwrap_or(0);
            let mut best = (expert, 0.0, values[expert as usize]);
            for (action, value) in (0..).zip(values) {
                if action != expert && value + margin > best.2 {
                    best = (action, margin, value + margin);
                }
            }
            self.rival.push(best.0);
            self.expert.push(expert);
            self.margin.data_mut()[j] = best.1;
        }
    }
}

/// What was done after an observation; nothing after the last one of a sequence or a round.
fn taken_after(batch: &Batch, at: usize) -> Option<u32> {
    let next = at + batch.columns;
    if next >= batch.action.cols() {
        return None;
    }
    choice(batch.action.column(next))
}

/// The choice that a column is; none if it is zeros.
fn choice(action: &[f32]) -> Option<u32> {
    action
        .iter()
        .position(|x| *x > 0.0)
        .map(|choice| choice as u32)
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
            batch: Batch::new(&model, 2, 3),
            expert: Tensor::new(4, 6),
            imitated: Tensor::new(1, 6),
        };
        shard.expert.column_mut(0)[2] = 1.0;
        shard.expert.column_mut(1)[1] = 1.0;
        let values = [0.0, 0.5, 1.0, 0.9, 0.0, 1.0, 0.1, 0.0, 5.0, 0.0, 0.0, 0.0];
        let mut rivals = Rivals::default();
        rivals.find(&values, &shard, 0.8);
        assert_eq!(rivals.rival[..2], [3, 1]);
        assert_eq!(rivals.expert[..2], [2, 1]);
        assert_eq!(rivals.margin.data()[..2], [0.8, 0.0]);
        assert_eq!(rivals.counts.data(), [1.0, 1.0, 0.0]);
        // The expert's action is a rival to no one, not even to itself where it is behind.
        shard
            .expert
            .column_mut(1)
            .copy_from_slice(&[1.0, 0.0, 0.0, 0.0]);
        rivals.find(&values, &shard, 0.8);
        assert_eq!((rivals.rival[1], rivals.margin.data()[1]), (1, 0.8));
    }
}
