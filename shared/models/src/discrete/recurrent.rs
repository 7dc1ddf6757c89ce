//! Recurrent policies of the gridworlds' people: behavioural cloning (`bc`) and soft-Q imitation (`sqil`).
//!
//! ```text
//! h_t = GRU([features(x̊_t); a_{t−1}], h_{t−1}),   π(a | h_t) = softmax(dense layers of h_t)
//! ```
//!
//! Behavioural cloning learns the logits, soft-Q imitation Q-values of temperature 1, whose soft policy is the same softmax. These
//! models are told what the person can see (paper §IV-A); the belief that they carry is h.

use super::perception::{Perceiver, limits_of};
use super::reader::{Reader, ReaderScratch};
use super::sizes::Sizes;
use super::view::View;
use crate::human::{Beliefs, HumanModel};
use crate::observation::{Communicated, Observations};
use crate::policy::ActionDistribution;
use domains::discrete::{Domain, Layout, Mask, Sight};
use nn::{Activation, Gru, GruScratch, Mlp, MlpScratch, Parameters, Tape, Tensor, Var};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Sizes of a recurrent policy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChooserSizes {
    /// The self-model's, for what is observed and the networks that read it.
    pub model: Sizes,
    /// Features of h: the paper's 48.
    pub hidden: usize,
    /// Neurons of each hidden dense layer.
    pub dense: usize,
    /// Dense layers behind the GRU.
    pub layers: usize,
}

impl ChooserSizes {
    /// The paper's sizes with this many dense layers. Bomb defusal's layers have 64 neurons where the paper has 2048: a plan asks
    /// thousands of imagined people (DESIGN §9).
    pub fn of(layout: &Layout, layers: usize) -> Self {
        let model = Sizes::of(layout);
        Self {
            model,
            hidden: 48,
            dense: match layout.domain {
                Domain::Driving => 32,
                Domain::SearchRescue | Domain::BombDefusal => 64,
            },
            layers,
        }
    }
}

impl ChooserSizes {
    /// A reason why these sizes make no sense for a layout, if there is one.
    pub fn problem(&self, layout: &Layout) -> Option<String> {
        if let Some(reason) = self.model.problem(layout) {
            return Some(reason);
        }
        let possible = (1..=1024).contains(&self.hidden)
            && (1..=4096).contains(&self.dense)
            && (1..=8).contains(&self.layers);
        (!possible).then(|| {
            let Self {
                hidden,
                dense,
                layers,
                ..
            } = self;
            format!("a policy of {hidden} features and {layers} layers of {dense} is out of bounds")
        })
    }
}

/// A GRU followed by dense layers.
#[derive(Clone, Debug)]
pub struct RecurrentChooser {
    /// Sizes.
    pub sizes: ChooserSizes,
    /// How masked observations look.
    pub view: View,
    /// Every parameter of the networks below.
    pub parameters: Parameters,
    /// Reads observations.
    pub reader: Reader,
    /// `[features; a], h → h`.
    pub gru: Gru,
    /// `h →` a logit, or a value, of each action.
    pub head: Mlp,
}

impl RecurrentChooser {
    /// An untrained policy.
    pub fn new(sizes: ChooserSizes, layout: &Layout, rng: &mut ChaCha8Rng) -> Self {
        let view = View::new(layout);
        let mut p = Parameters::new();
        let reader = Reader::new(&sizes.model, &view, &mut p, rng);
        let actions = sizes.model.shape.action;
        let gru = Gru::new(&mut p, "gru", reader.rows() + actions, sizes.hidden, rng);
        let mut widths = vec![sizes.hidden];
        widths.extend(vec![sizes.dense; sizes.layers.saturating_sub(1)]);
        widths.push(actions);
        let head = Mlp::new(&mut p, "head", &widths, Activation::Identity, rng);
        Self {
            sizes,
            view,
            parameters: p,
            reader,
            gru,
            head,
        }
    }

    /// Logits, or values, of every step of a batch of sequences: `actions × (steps · columns)`. `observed`: `view rows × …`;
    /// `previous`: `actions × …`; both step after step.
    pub fn on_tape(
        &self,
        tape: &mut Tape,
        observed: &Tensor,
        previous: &Tensor,
        columns: usize,
    ) -> Var {
        let steps = observed.cols() / columns.max(1);
        let observed = tape.input(observed);
        let features = self.reader.on_tape(tape, observed);
        let previous = tape.input(previous);
        let input = tape.concat(&[features, previous]);
        let mut h = tape.constant(self.sizes.hidden, columns, 0.0);
        let mut all = Vec::with_capacity(steps);
        for t in 0..steps {
            let x = tape.columns(input, t * columns..(t + 1) * columns);
            h = tape.gru(&self.gru, x, h);
            all.push(h);
        }
        let h = tape.join(&all);
        tape.mlp(&self.head, h)
    }
}

/// A recurrent policy as a human model.
pub struct RecurrentHuman {
    kind: &'static str,
    policy: Arc<RecurrentChooser>,
    perceiver: Perceiver,
    /// The person's true limits: told, not learned.
    limits: Vec<f32>,
    heard: u32,
    last: Mask,
    observed: Tensor,
    input: Tensor,
    before: Tensor,
    reader: ReaderScratch,
    gru: GruScratch,
    mlp: MlpScratch,
}

impl RecurrentHuman {
    /// A person of this sight; `kind`, "bc" or "sqil", says how the policy was learned.
    pub fn new(
        kind: &'static str,
        policy: Arc<RecurrentChooser>,
        layout: &Layout,
        sight: &Sight,
    ) -> Self {
        Self {
            kind,
            perceiver: Perceiver::new(layout),
            limits: limits_of(&sight.perception),
            heard: sight.heard,
            last: Mask::NONE,
            observed: Tensor::new(policy.view.rows(), 0),
            input: Tensor::default(),
            before: Tensor::default(),
            reader: ReaderScratch::default(),
            gru: GruScratch::default(),
            mlp: MlpScratch::default(),
            policy,
        }
    }
}

impl RecurrentHuman {
    /// What the last person of the last batch perceived.
    pub fn perceived(&self) -> Mask {
        self.last
    }
}

impl HumanModel for RecurrentHuman {
    fn kind(&self) -> &'static str {
        self.kind
    }

    fn latent(&self) -> usize {
        self.policy.sizes.hidden
    }

    fn noise_rows(&self) -> usize {
        self.latent() + self.perceiver.noise_rows()
    }

    fn distribution(&self, batch: usize) -> ActionDistribution {
        ActionDistribution::categorical(self.policy.sizes.model.shape.action, batch)
    }

    fn perceive(
        &mut self,
        beliefs: &mut Beliefs,
        actions: &Tensor,
        observations: &Observations,
        communicated: &[Communicated],
        noise: Option<&[f32]>,
    ) {
        let batch = observations.batch();
        let policy = &*self.policy;
        let hidden = policy.sizes.hidden;
        self.observed.resize_to(policy.view.rows(), batch);
        let chance = self.perceiver.noise_rows();
        // h follows from what is perceived without chance; what is perceived may not.
        let of_sight = noise.map(|noise| &noise[hidden * batch..]);
        for j in 0..batch {
            let visual = observations.visual.column(j);
            let noise = of_sight
                .filter(|_| chance > 0)
                .map(|noise| &noise[j * chance..(j + 1) * chance]);
            let mask = Mask {
                visual: self.perceiver.seen(&self.limits, visual, noise),
                verbal: self.heard,
            };
            let mask = mask | Mask::from(communicated[j]);
            self.last = mask;
            let (verbal, out) = (observations.verbal.column(j), self.observed.column_mut(j));
            policy.view.write(visual, verbal, mask, out);
        }
        self.before.resize_to(hidden, batch);
        if beliefs.fresh {
            self.before.fill(0.0);
        } else {
            self.before.copy_from(&beliefs.mean);
        }
        let taken = policy.sizes.model.shape.action;
        let rows = policy.reader.rows() + taken;
        let (input, fresh) = (&mut self.input, beliefs.fresh);
        policy.reader.infer(
            &policy.parameters,
            &mut self.reader,
            &self.observed,
            |features| {
                input.resize_to(rows, batch);
                for j in 0..batch {
                    let column = input.column_mut(j);
                    let mut at = 0;
                    for block in features {
                        column[at..at + block.rows()].copy_from_slice(block.column(j));
                        at += block.rows();
                    }
                    if fresh {
                        column[at..].fill(0.0);
                    } else {
                        column[at..].copy_from_slice(actions.column(j));
                    }
                }
            },
        );
        policy.gru.infer(
            &policy.parameters,
            &self.input,
            &self.before,
            &mut self.gru,
            &mut beliefs.mean,
        );
        beliefs.deviation.resize_to(hidden, batch);
        beliefs.deviation.fill(0.0);
        beliefs.z.copy_from(&beliefs.mean);
        beliefs.fresh = false;
    }

    fn act(&mut self, beliefs: &Beliefs, out: &mut ActionDistribution) {
        let policy = &*self.policy;
        policy.head.infer(
            &policy.parameters,
            &beliefs.z,
            &mut self.mlp,
            &mut out.log_probability,
        );
        nn::log_softmax_in_place(&mut out.log_probability);
    }
}
