//! Soft-Q imitation learning (Reddy et al. 2019) on the highway, over soft actor-critic: what people did earns 1, what the
//! policy itself does earns 0, and a recurrent policy learns to earn (paper §IV-A, baseline SQIL).
//!
//! ```text
//! y   = r + γ (1 − end) (min_i Q'_i(h_{t+1}, a') − α log π(a' | h_{t+1})),   a' ~ π,   r = 1 if demonstrated, else 0
//! L_Q = ½ Σ_i (Q_i(h_t, a_t) − y)²          moves the GRU and the critics
//! L_π = α log π(a | h_t) − min_i Q_i(h_t, a)  moves the policy's dense layers
//! ```
//!
//! Half of every batch is demonstrated, half lived. Policy and people see the same: in fog as far as the person does, in
//! clear weather everything, with words as in [`crate::lessons`].

use crate::config::{self, Checked};
use crate::lessons::{Lesson, Perceiver, SPOKEN_SEED, sizes};
use crate::sac::{HALF_LOG_TAU, log_det};
use domains::highway::AZIMUTHS;
use domains::highway::modalities::layout;
use domains::highway::road::RoadError;
use domains::highway::{End, Observation, Scene, World};
use models::policy::HeadScratch;
use models::utterances::UtteranceTable;
use models::{ActionDistribution, RecurrentPolicy, RecurrentSizes};
use nn::{
    Activation, Adam, Arena, Gradients, GruScratch, Mlp, MlpScratch, ParamId, Parameters, Tape,
    Tensor, Var, noise,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Settings. The paper had no time for SQIL on the highway ("several hours"); here its steps are limited to
/// `episodes · gradient_steps`, whatever has been learned by then.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Features of h and of the hidden layers.
    pub hidden: usize,
    /// Dense layers of policy and critics.
    pub layers: usize,
    /// Episodes lived, in clear weather and in fog by turns.
    pub episodes: usize,
    /// Gradient steps after each.
    pub gradient_steps: usize,
    /// Windows of a batch, half of them demonstrated.
    pub windows: usize,
    /// Steps of a window.
    pub window: usize,
    /// Steps of it that only build up h.
    pub burn_in: usize,
    /// Adam's rate.
    pub learning_rate: f32,
    /// γ, the planner's.
    pub discount: f32,
    /// Rate at which the target critics follow.
    pub target_rate: f32,
    /// α. Fixed: with rewards of 0 and 1 the return's scale is known, 1 / (1 − γ).
    pub temperature: f32,
    /// Largest norm of a gradient.
    pub gradient_clip: f32,
    /// Seed of everything.
    #[serde(default)]
    pub seed: u64,
}

impl Default for Settings {
    /// What ships ([`crate::config`]).
    fn default() -> Self {
        config::highway().sqil
    }
}

impl Checked for Settings {
    fn problem(&self) -> Option<String> {
        let least = self.burn_in + 2;
        (!(1..=1024).contains(&self.hidden)
            || !(1..=8).contains(&self.layers)
            || !(2..=10_000).contains(&self.windows)
            || !(least..=10_000).contains(&self.window)
            || self.learning_rate <= 0.0
            || self.gradient_clip <= 0.0
            || self.temperature <= 0.0
            || !(0.0..=1.0).contains(&self.discount)
            || !(0.0..=1.0).contains(&self.target_rate))
        .then(|| {
            "hidden from 1 to 1024; layers from 1 to 8; at least 2 windows of burn_in + 2 steps or more; rates positive"
                .to_owned()
        })
    }
}

/// A round, demonstrated or lived.
#[derive(Clone, Debug)]
pub struct Lived {
    /// What was perceived and done.
    pub lesson: Lesson,
    /// Whether it ended in a collision, which has no future.
    pub collided: bool,
}

/// What one episode and its gradient steps gave.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Metrics {
    /// Steps that the policy drove.
    pub steps: usize,
    /// Whether it collided.
    pub collided: bool,
    /// Mean L_Q.
    pub critic: f32,
    /// Mean Q of demonstrated actions less that of lived ones.
    pub advantage: f32,
}

/// Where the policy lives, and how far it sees there.
pub struct Place {
    /// The scene.
    pub scene: Arc<Scene>,
    /// What the person sees of each azimuth, in metres.
    pub visible_m: [f32; AZIMUTHS],
    /// Whether words are heard there, at random as experts hear them.
    pub words: bool,
}

/// Learns from `demonstrations`, living in `places` by turns.
///
/// # Errors
/// If a scene's road cannot be built.
///
/// # Panics
/// If there is no demonstration as long as a window, or no place.
pub fn learn(
    demonstrations: &[Lived],
    places: &[Place],
    table: &UtteranceTable,
    settings: &Settings,
    progress: &mut dyn FnMut(usize, Metrics),
) -> Result<RecurrentPolicy, RoadError> {
    let mut worlds = Vec::new();
    for place in places {
        worlds.push(World::new(place.scene.clone())?);
    }
    let mut learner = Learner::new(settings);
    let mut own: Vec<Lived> = Vec::new();
    for episode in 0..settings.episodes {
        let at = episode % places.len();
        let (place, world) = (&places[at], &mut worlds[at]);
        let lived = learner.live(world, place, table, episode as u32);
        let mut metrics = Metrics {
            steps: lived.lesson.steps(),
            collided: lived.collided,
            ..Metrics::default()
        };
        own.push(lived);
        let mut done = 0;
        for _ in 0..settings.gradient_steps {
            // Nothing lived is long enough yet: wait for the next episode.
            if let Some((critic, advantage)) = learner.step(demonstrations, &own) {
                metrics.critic += critic;
                metrics.advantage += advantage;
                done += 1;
            }
        }
        metrics.critic /= done.max(1) as f32;
        metrics.advantage /= done.max(1) as f32;
        progress(episode + 1, metrics);
    }
    Ok(learner.policy())
}

/// Policy and critics with all that moves them.
struct Learner {
    settings: Settings,
    /// The policy, whose parameters hold the critics too.
    network: RecurrentPolicy,
    critics: [Mlp; 2],
    targets: Parameters,
    target_pairs: Vec<(ParamId, ParamId)>,
    target_critics: [Mlp; 2],
    value_ids: Vec<ParamId>,
    policy_ids: Vec<ParamId>,
    adam: Adam,
    gradients: Gradients,
    arena: Arena,
    rng: ChaCha8Rng,
    distribution: ActionDistribution,
    head: HeadScratch,
    mlp: MlpScratch,
}

impl Learner {
    fn new(settings: &Settings) -> Self {
        let sizes = RecurrentSizes {
            hidden: settings.hidden,
            dense: settings.hidden,
            ..sizes(settings.layers)
        };
        let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
        let mut network = RecurrentPolicy::new(sizes, &layout(), &mut rng);
        let actions = network.actions;
        let mut widths = vec![sizes.hidden + actions.rows()];
        widths.extend(vec![sizes.hidden; sizes.layers - 1]);
        widths.push(1);
        let critics = ["critic_1", "critic_2"].map(|name| {
            Mlp::new(
                &mut network.parameters,
                name,
                &widths,
                Activation::Identity,
                &mut rng,
            )
        });
        let (mut targets, mut target_pairs) = (Parameters::new(), Vec::new());
        let target_critics = critics.clone().map(|mut critic| {
            for layer in &mut critic.layers {
                for id in [&mut layer.weight, &mut layer.bias] {
                    let name = network.parameters.name(*id).to_owned();
                    let own = targets.add(name, network.parameters.get(*id).clone());
                    target_pairs.push((own, *id));
                    *id = own;
                }
            }
            critic
        });
        let ids = |prefix| network.parameters.ids_with_prefix(prefix);
        let value_ids = [ids("gru"), ids("critic")].concat();
        let policy_ids = ids("head");
        let all = network.parameters.ids().collect();
        Self {
            settings: *settings,
            adam: Adam::new(&network.parameters, all, settings.learning_rate),
            gradients: Gradients::for_params(&network.parameters),
            network,
            critics,
            targets,
            target_pairs,
            target_critics,
            value_ids,
            policy_ids,
            arena: Arena::new(),
            rng,
            distribution: ActionDistribution::new(actions, 1),
            head: HeadScratch::default(),
            mlp: MlpScratch::default(),
        }
    }

    /// The policy without the critics.
    fn policy(&self) -> RecurrentPolicy {
        let mut policy = RecurrentPolicy::new(
            self.network.sizes,
            &layout(),
            &mut ChaCha8Rng::seed_from_u64(0),
        );
        let ids: Vec<ParamId> = policy.parameters.ids().collect();
        for id in ids {
            // Created first, in the same order.
            let source = self.network.parameters.get(id);
            policy.parameters.get_mut(id).copy_from(source);
        }
        policy
    }

    /// Drives an episode with the policy, sampled.
    fn live(
        &mut self,
        world: &mut World,
        place: &Place,
        table: &UtteranceTable,
        episode: u32,
    ) -> Lived {
        let Settings { seed, hidden, .. } = self.settings;
        world.reset(seed ^ 0x7371_696c, episode);
        let mut perceiver = Perceiver::new(
            place.visible_m,
            place.words.then_some(table),
            seed ^ SPOKEN_SEED ^ u64::from(episode) << 32,
        );
        let mut observation = Observation::default();
        let (mut h, mut next) = (Tensor::new(hidden, 1), Tensor::new(hidden, 1));
        let mut input = Tensor::new(self.network.sizes.input(), 1);
        let (mut scratch, mut drawn) = (GruScratch::default(), Tensor::new(2, 1));
        let mut epsilon = [0.0; 2];
        loop {
            world.observe(&mut observation);
            perceiver.perceive(&observation, input.column_mut(0));
            let p = &self.network.parameters;
            self.network
                .gru
                .infer(p, &input, &h, &mut scratch, &mut next);
            std::mem::swap(&mut h, &mut next);
            self.distribution
                .infer(&self.network.head, 1.0, p, &h, &mut self.head);
            noise::fill(&mut epsilon, self.rng.random(), 0);
            self.distribution.sample(Some(&epsilon), &mut drawn);
            let action = [drawn.data()[0], drawn.data()[1]];
            perceiver.acted(action);
            let outcome = world.step(action);
            if outcome.end != End::Running {
                return Lived {
                    lesson: perceiver.lesson(),
                    collided: outcome.collided,
                };
            }
        }
    }

    /// A random window of a round that is long enough: (round, first step).
    fn draw(&mut self, rounds: &[Lived]) -> Option<(usize, usize)> {
        let window = self.settings.window;
        for _ in 0..100 {
            let round = self.rng.random_range(0..rounds.len().max(1));
            let steps = rounds.get(round)?.lesson.steps();
            if steps >= window {
                return Some((round, self.rng.random_range(0..=steps - window)));
            }
        }
        None
    }

    /// One step of Adam; (L_Q, mean Q of demonstrated less lived actions). Nothing if there is nothing to draw.
    fn step(&mut self, demonstrations: &[Lived], own: &[Lived]) -> Option<(f32, f32)> {
        let Settings {
            hidden,
            windows,
            window,
            burn_in,
            ..
        } = self.settings;
        let half = windows / 2;
        let mut drawn: Vec<(&Lived, usize)> = Vec::with_capacity(windows);
        for i in 0..windows {
            let rounds = if i < half { demonstrations } else { own };
            let (round, start) = self.draw(rounds)?;
            drawn.push((&rounds[round], start));
        }
        let transitions = window - burn_in - 1;
        let count = transitions * windows;
        let mut states = Tensor::new(hidden, count);
        let mut nexts = Tensor::new(hidden, count);
        let mut actions = Tensor::new(2, count);
        for t in 0..transitions {
            for (j, (lived, start)) in drawn.iter().enumerate() {
                let taken = lived.lesson.action.column(start + burn_in + t);
                actions.column_mut(t * windows + j).copy_from_slice(taken);
            }
        }
        self.gradients.zero();
        let mut arena = std::mem::take(&mut self.arena);
        let mut tape = Tape::new(&self.network.parameters, &mut arena);
        let h = follow(&mut tape, &self.network, &drawn, window);
        for t in 0..transitions {
            let columns = t * windows * hidden..(t + 1) * windows * hidden;
            states.data_mut()[columns.clone()].copy_from_slice(tape.value(h[burn_in + t]));
            nexts.data_mut()[columns].copy_from_slice(tape.value(h[burn_in + t + 1]));
        }
        let y = {
            let seed = self.rng.random();
            targets(
                &self.network,
                &self.target_critics,
                &self.targets,
                &nexts,
                &drawn,
                &self.settings,
                seed,
                (&mut self.distribution, &mut self.head, &mut self.mlp),
            )
        };
        let mut loss: Option<Var> = None;
        let mut advantage = 0.0;
        for t in 0..transitions {
            let columns = t * windows..(t + 1) * windows;
            let taken = tape.input_with(2, windows, |out| {
                out.copy_from_slice(&actions.data()[2 * columns.start..2 * columns.end]);
            });
            let aim = tape.input_with(1, windows, |out| out.copy_from_slice(&y[columns.clone()]));
            let input = tape.concat(&[h[burn_in + t], taken]);
            for critic in &self.critics {
                let q = tape.mlp(critic, input);
                let values = tape.value(q);
                advantage += (values[..half].iter().sum::<f32>()
                    - values[half..].iter().sum::<f32>())
                    / (half * 2 * transitions) as f32;
                let error = tape.sub(q, aim);
                let squared = tape.square(error);
                let sum = tape.sum(squared);
                loss = Some(match loss {
                    None => sum,
                    Some(loss) => tape.add(loss, sum),
                });
            }
        }
        // A window holds at least one transition: see `Settings`.
        let loss = loss?;
        let loss = tape.scale(loss, 0.5 / count as f32);
        let critic = tape.scalar(loss);
        let value_ids = &self.value_ids;
        tape.backward(loss, &mut self.gradients, &|id| value_ids.contains(&id));

        let mut tape = Tape::new(&self.network.parameters, &mut arena);
        let seed = self.rng.random();
        let loss = actor_loss(
            &mut tape,
            &self.network,
            &self.critics,
            &states,
            self.settings.temperature,
            seed,
        );
        let policy_ids = &self.policy_ids;
        tape.backward(loss, &mut self.gradients, &|id| policy_ids.contains(&id));
        self.arena = arena;
        for ids in [&self.value_ids, &self.policy_ids] {
            self.gradients.clip(ids, self.settings.gradient_clip);
        }
        self.adam
            .step(&mut self.network.parameters, &self.gradients);
        for &(own, source) in &self.target_pairs {
            let source = self.network.parameters.get(source).data();
            let own = self.targets.get_mut(own).data_mut();
            for (own, source) in own.iter_mut().zip(source) {
                *own += self.settings.target_rate * (source - *own);
            }
        }
        Some((critic, advantage))
    }
}

/// L_π over states that are taken as they are, `hidden × count`.
fn actor_loss(
    tape: &mut Tape,
    network: &RecurrentPolicy,
    [first, second]: &[Mlp; 2],
    states: &Tensor,
    temperature: f32,
    seed: u64,
) -> Var {
    let h = tape.input(states);
    let (mean, deviation) = network.gaussian(tape, h);
    let epsilon = tape.input_with(2, states.cols(), |out| noise::fill(out, seed, 1));
    let u = tape.gaussian_sample(mean, deviation, epsilon);
    let density = tape.gaussian_log_density(u, mean, deviation);
    let squash = tape.tanh_log_det(u);
    let log_density = tape.sub(density, squash);
    let action = tape.tanh(u);
    let input = tape.concat(&[h, action]);
    let (first, second) = (tape.mlp(first, input), tape.mlp(second, input));
    let q = tape.min(first, second);
    let entropy = tape.scale(log_density, temperature);
    let loss = tape.sub(entropy, q);
    tape.mean(loss)
}

/// h of every step of the windows, from h = 0.
fn follow(
    tape: &mut Tape,
    network: &RecurrentPolicy,
    drawn: &[(&Lived, usize)],
    window: usize,
) -> Vec<Var> {
    let rows = network.sizes.input();
    let mut h = tape.constant(network.sizes.hidden, drawn.len(), 0.0);
    (0..window)
        .map(|t| {
            let input = tape.input_with(rows, drawn.len(), |out| {
                for (out, (lived, start)) in out.chunks_exact_mut(rows).zip(drawn) {
                    out.copy_from_slice(lived.lesson.input.column(start + t));
                }
            });
            h = tape.gru(&network.gru, input, h);
            h
        })
        .collect()
}

/// y of every transition, in the order of [`Learner::step`]'s states.
#[expect(
    clippy::too_many_arguments,
    reason = "one call from one place, all of different types"
)]
fn targets(
    network: &RecurrentPolicy,
    critics: &[Mlp; 2],
    parameters: &Parameters,
    nexts: &Tensor,
    drawn: &[(&Lived, usize)],
    settings: &Settings,
    seed: u64,
    (distribution, head, mlp): (&mut ActionDistribution, &mut HeadScratch, &mut MlpScratch),
) -> Vec<f32> {
    let (windows, half) = (drawn.len(), drawn.len() / 2);
    let count = nexts.cols();
    let mut epsilon = vec![0.0; 2 * count];
    noise::fill(&mut epsilon, seed, 0);
    let mut action = Tensor::new(2, count);
    distribution.infer(&network.head, 1.0, &network.parameters, nexts, head);
    distribution.sample(Some(&epsilon), &mut action);
    let mut q = [Tensor::new(1, count), Tensor::new(1, count)];
    for (critic, q) in critics.iter().zip(&mut q) {
        critic.infer_stacked(parameters, &[nexts, &action], mlp, q);
    }
    let Some((mean, std)) = distribution.gaussian() else {
        return Vec::new(); // the highway's actions are numbers
    };
    (0..count)
        .map(|i| {
            let (t, j) = (i / windows, i % windows);
            let (lived, start) = drawn[j];
            let mut log_density = 0.0;
            for d in 0..2 {
                let (noise, deviation) = (epsilon[2 * i + d], std.column(i)[d]);
                let u = mean.column(i)[d] + deviation * noise;
                log_density += -0.5 * noise * noise - deviation.ln() - HALF_LOG_TAU - log_det(u);
            }
            let future = q[0].data()[i].min(q[1].data()[i]) - settings.temperature * log_density;
            // The last step before a collision: what follows it is its end.
            let next = start + settings.burn_in + t + 1;
            let ends = lived.collided && next + 1 == lived.lesson.steps();
            let reward = f32::from(u8::from(j < half));
            reward + settings.discount * f32::from(u8::from(!ends)) * future
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use models::policy::unsquash;

    fn few() -> Settings {
        Settings {
            hidden: 24,
            layers: 2,
            episodes: 6,
            gradient_steps: 120,
            windows: 8,
            window: 8,
            burn_in: 2,
            learning_rate: 3e-3,
            ..Settings::default()
        }
    }

    fn clear() -> Place {
        Place {
            scene: Arc::new(Scene::builtin("highway-clear").expect("a scene")),
            visible_m: [f32::INFINITY; AZIMUTHS],
            words: false,
        }
    }

    /// People who always do the same, whatever there is to see.
    fn demonstrations(action: [f32; 2]) -> Vec<Lived> {
        let mut lesson = crate::lessons::Lesson::silent(40);
        for t in 0..40 {
            let column = lesson.action.column_mut(t);
            column.copy_from_slice(&action);
        }
        let collided = false;
        vec![Lived { lesson, collided }]
    }

    fn learned(action: [f32; 2], settings: &Settings) -> RecurrentPolicy {
        let table = UtteranceTable::shipped().expect("utterances");
        let places = [clear()];
        learn(
            &demonstrations(action),
            &places,
            &table,
            settings,
            &mut |_, _| {},
        )
        .expect("a road")
    }

    /// Mean of u after a few steps of nothing to see.
    fn habit(policy: &RecurrentPolicy) -> f32 {
        let mut h = Tensor::new(policy.sizes.hidden, 1);
        let mut next = Tensor::new(policy.sizes.hidden, 1);
        let input = Tensor::new(policy.sizes.input(), 1);
        let mut distribution = ActionDistribution::new(policy.actions, 1);
        for _ in 0..6 {
            let mut scratch = GruScratch::default();
            policy
                .gru
                .infer(&policy.parameters, &input, &h, &mut scratch, &mut next);
            std::mem::swap(&mut h, &mut next);
        }
        let mut head = HeadScratch::default();
        distribution.infer(&policy.head, 1.0, &policy.parameters, &h, &mut head);
        let (mean, _) = distribution.gaussian().expect("numbers");
        mean.column(0)[0]
    }

    #[test]
    fn it_does_as_people_do() {
        let (slow, fast) = (learned([-0.7, 0.0], &few()), learned([0.7, 0.0], &few()));
        let apart = unsquash(0.7) - unsquash(-0.7);
        let ours = habit(&fast) - habit(&slow);
        assert!(ours > 0.3 * apart, "{ours} of {apart}");
    }

    #[test]
    fn same_seed_same_bytes() {
        let once = Settings {
            episodes: 2,
            gradient_steps: 3,
            ..few()
        };
        let (a, b) = (learned([0.2, 0.1], &once), learned([0.2, 0.1], &once));
        assert_eq!(a.parameters, b.parameters);
        assert_ne!(a.parameters, learned([0.1, 0.1], &once).parameters);
    }
}
