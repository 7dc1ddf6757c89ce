//! The simulated person's own model as a human model (`ideal`, the paper's IM): they perceive, remember and choose as they
//! themselves do. Nobody has it of a real person.
//!
//! A belief is what the person remembers, as numbers ([`Mind::write_memory`]), and a number that their next choice draws from. What
//! chance had them notice, or where they mean to go, is theirs to know: the model draws it.

use crate::human::{Beliefs, HumanModel, Kind};
use crate::observation::{Communicated, Observations};
use crate::policy::{ActionDistribution, largest};
use domains::ActionSpace;
use domains::discrete::{MAX_ACTIONS, Mind, SimulatedPerson};
use nn::Tensor;

/// Streams of random numbers: of what is perceived, and of what is then chosen.
const PERCEIVING: u64 = 31;
const CHOOSING: u64 = 32;

/// A simulated person, asked about people like them.
pub struct IdealHuman {
    person: SimulatedPerson,
    actions: usize,
}

impl IdealHuman {
    /// The model of `person`, who chooses among so many actions.
    pub fn new(person: SimulatedPerson, actions: usize) -> Self {
        Self { person, actions }
    }

    /// Numbers of a memory.
    fn memory(&self) -> usize {
        self.person.memory_len()
    }
}

impl HumanModel for IdealHuman {
    fn kind(&self) -> &'static str {
        Kind::Ideal.name()
    }

    /// The memory, and the number that the next choice draws from.
    fn latent(&self) -> usize {
        self.memory() + 1
    }

    fn noise_rows(&self) -> usize {
        self.latent() + 1
    }

    fn actions(&self) -> ActionSpace {
        ActionSpace::Discrete(self.actions)
    }

    fn perceive(
        &mut self,
        beliefs: &mut Beliefs,
        actions: &Tensor,
        observations: &Observations,
        communicated: &[Communicated],
        noise: Option<&[f32]>,
    ) {
        let (batch, latent, memory) = (observations.batch(), self.latent(), self.memory());
        for tensor in [&mut beliefs.mean, &mut beliefs.deviation, &mut beliefs.z] {
            tensor.resize_to(latent, batch);
        }
        for j in 0..batch {
            let chance = noise.map_or(0.0, |noise| noise[latent * batch + j]);
            let z = beliefs.z.column_mut(j);
            self.person.reset(0, 0);
            self.person
                .reseed(u64::from(chance.to_bits()), 0, PERCEIVING);
            if !beliefs.fresh {
                self.person.read_memory(&z[..memory]);
                let action = largest(actions.column(j));
                // Where nothing is known to have been done, cars have moved nonetheless; 0 is to keep one's lane.
                let is_driver = matches!(self.person, SimulatedPerson::Driving(_));
                if actions.column(j)[action] > 0.0 || is_driver {
                    self.person.observed(action);
                }
            }
            let (visual, verbal) = (observations.visual.column(j), observations.verbal.column(j));
            // 4: x̌ = h_p(x̂)   5: û = w_ω(x̂)   6: x̊ = v(x̌, û)   7: z^H
            let seen = self.person.look(visual);
            let perceived = seen | communicated[j].mask();
            self.person.perceive(visual, verbal, perceived);
            self.person.write_memory(&mut z[..memory]);
            z[memory] = chance;
        }
        beliefs.mean.copy_from(&beliefs.z);
        beliefs.deviation.fill(0.0);
        beliefs.fresh = false;
    }

    fn act(&mut self, beliefs: &Beliefs, out: &mut ActionDistribution) {
        let (memory, batch) = (self.memory(), beliefs.z.cols());
        let ActionDistribution::Categorical { log_probability } = out else {
            return;
        };
        log_probability.resize_to(self.actions, batch);
        for j in 0..batch {
            let z = beliefs.z.column(j);
            self.person.read_memory(&z[..memory]);
            let chance = u64::from(z[memory].to_bits());
            self.person.reseed(chance, 0, CHOOSING);
            let mut probabilities = [0.0; MAX_ACTIONS];
            let probabilities = &mut probabilities[..self.actions];
            self.person.probabilities(probabilities);
            if probabilities.iter().all(|p| *p <= 0.0) {
                // Imagined observations may put people where nobody can be, such as into a wall.
                probabilities.fill(1.0 / self.actions as f32);
            }
            let log = log_probability.column_mut(j);
            for (log, p) in log.iter_mut().zip(probabilities) {
                // What they would never do keeps a finite likelihood.
                *log = p.max(f32::MIN_POSITIVE).ln();
            }
        }
    }
}
