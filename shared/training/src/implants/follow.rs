//! What a person believed at every step of their rounds, had they seen as far as a hypothesis says, and what the robot would have done
//! in that belief.

use super::longest;
use crate::rounds::Rounds;
use models::{
    ActionDistribution, Beliefs, Communicated, HumanModel, Observations, Posterior, Scratch,
    SelfHuman, SelfModel,
};
use nn::{Tensor, noise};
use std::sync::Arc;

/// The steps that count, round by round, each in as many columns as there are samples of what was noticed.
#[derive(Clone, Debug, Default)]
pub struct Followed {
    /// Columns per step.
    pub samples: usize,
    /// Rows of an action.
    pub actions: usize,
    /// The robot's distribution: logits (`actions` per column), or mean and deviation of u (twice as many).
    pub robot: Vec<f32>,
    /// z, `latent` per column.
    pub z: Vec<f32>,
    /// The action, `actions` per step.
    pub taken: Vec<f32>,
    /// Number of each step's round.
    pub round: Vec<u32>,
}

impl Followed {
    /// Steps.
    pub fn steps(&self) -> usize {
        self.round.len()
    }

    /// Rounds that have steps, or lie before one that has.
    pub fn rounds(&self) -> usize {
        self.round.last().map_or(0, |round| *round as usize + 1)
    }
}

/// Follows all rounds by each hypothesis, given as controls of its limits. `skip`: steps at each round's start that do not count.
pub(super) fn follow(
    model: &Arc<SelfModel>,
    hypotheses: &[&[f32]],
    rounds: &Rounds,
    samples: usize,
    skip: usize,
) -> Vec<Followed> {
    let perception = model.layout.perception;
    let limits: Vec<Vec<f32>> = hypotheses.iter().map(|c| perception.limits_of(c)).collect();
    let mut posterior = Posterior::of_limits(perception, limits[0].clone());
    posterior.hypotheses = limits
        .into_iter()
        .map(|limits| models::Implants {
            limits,
            policy: None,
        })
        .collect();
    posterior.weights = vec![1.0 / hypotheses.len() as f32; hypotheses.len()];
    let mut human = SelfHuman::new(Arc::clone(model), Some(posterior), rounds.heard);
    let (latent, actions) = (human.latent(), human.actions());
    let by_chance = human.noise_rows() > latent;
    let last = longest(rounds);
    let rounds = &rounds.rounds;
    // Column (h · rounds + r) · samples + k.
    let columns = hypotheses.len() * rounds.len() * samples;
    let mut beliefs = Beliefs::new(latent, columns);
    for (j, hypothesis) in beliefs.hypothesis.iter_mut().enumerate() {
        *hypothesis = (j / (rounds.len() * samples)) as u32;
    }
    let shape = model.sizes.shape;
    let mut observations = Observations::new(&shape, columns);
    let mut action = Tensor::new(shape.action, columns);
    let told = vec![Communicated::default(); columns];
    let mut chance = vec![0.0; human.noise_rows() * columns];
    let mut robot = ActionDistribution::new(actions, columns);
    let mut scratch = Scratch::default();
    let mut steps: Vec<Vec<Followed>> = (0..hypotheses.len())
        .map(|_| rounds.iter().map(|_| Followed::default()).collect())
        .collect();
    for t in 0..last {
        for (r, round) in rounds.iter().enumerate().filter(|(_, r)| t < r.len()) {
            for h in 0..hypotheses.len() {
                for k in 0..samples {
                    let j = (h * rounds.len() + r) * samples + k;
                    let Observations { visual, verbal } = &mut observations;
                    visual.column_mut(j).copy_from_slice(round.visual(t));
                    // On the highway nobody says anything without an assistant, and rounds hold no words.
                    match round.verbal(t) {
                        [] => verbal.column_mut(j).fill(0.0),
                        words => verbal.column_mut(j).copy_from_slice(words),
                    }
                    if t > 0 {
                        action.column_mut(j).copy_from_slice(round.action(t - 1));
                    }
                }
            }
        }
        if by_chance {
            // z is carried by its mean; what is noticed is drawn, and alike by every hypothesis.
            let rows = human.noise_rows() - latent;
            let own = rounds.len() * samples * rows;
            let of_sight = &mut chance[latent * columns..];
            let (first, rest) = of_sight.split_at_mut(own);
            noise::fill(first, SEED, t as u64);
            for other in rest.chunks_exact_mut(own) {
                other.copy_from_slice(first);
            }
        }
        human.perceive(
            &mut beliefs,
            &action,
            &observations,
            &told,
            by_chance.then_some(&chance[..]),
        );
        if t < skip {
            continue;
        }
        model.act(&mut scratch, &beliefs.z, &mut robot);
        for (h, own) in steps.iter_mut().enumerate() {
            for (r, round) in rounds.iter().enumerate().filter(|(_, r)| t < r.len()) {
                let first = (h * rounds.len() + r) * samples;
                let out = &mut own[r];
                for j in first..first + samples {
                    match &robot {
                        ActionDistribution::Gaussian { mean, deviation } => {
                            out.robot.extend_from_slice(mean.column(j));
                            out.robot.extend_from_slice(deviation.column(j));
                        }
                        ActionDistribution::Categorical { log_probability } => {
                            out.robot.extend_from_slice(log_probability.column(j));
                        }
                    }
                    out.z.extend_from_slice(beliefs.z.column(j));
                }
                out.taken.extend_from_slice(round.action(t));
                out.round.push(r as u32);
            }
        }
    }
    let join = |parts: Vec<Followed>| {
        let mut all = Followed {
            samples,
            actions: shape.action,
            ..Followed::default()
        };
        for part in parts {
            all.robot.extend(part.robot);
            all.z.extend(part.z);
            all.taken.extend(part.taken);
            all.round.extend(part.round);
        }
        all
    };
    steps.into_iter().map(join).collect()
}

/// Seed of what is noticed while people are followed: the same for everybody, so that hypotheses differ in nothing else.
const SEED: u64 = 5;
