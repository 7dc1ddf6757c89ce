//! Recurrent policies as human models: behavioural cloning (`bc`) and soft-Q imitation (`sqil`).
//!
//! A GRU takes what the person perceives and their last action, and dense layers give the action (paper, appendix): a Gaussian
//! with diagonal covariance where actions are numbers, logits where they are choices.
//!
//! ```text
//! h_t = GRU([features(x̊_t); a_{t−1}], h_{t−1})
//! a_t = tanh(u),  u ~ N(μ(h_t), σ(h_t)²)      or      π(a | h_t) = softmax(dense layers of h_t)
//! ```
//!
//! Of choices, behavioural cloning learns the logits, soft-Q imitation Q-values of temperature 1, whose soft policy is the same
//! softmax. These models are told what the person can see (paper §IV-A); the belief that they carry is h.

use crate::config::{self, PolicyNetwork};
use crate::human::{Beliefs, HumanModel, Kind, Perceiver};
use crate::observation::{Communicated, Observations};
use crate::policy::{ActionDistribution, HeadScratch};
use crate::reader::{Reader, ReaderScratch};
use crate::sizes::Sizes;
use crate::view::View;
use domains::{ActionSpace, Layout, Mask};
use nn::{Activation, Gru, GruScratch, Mlp, Parameters, Tape, Tensor, Var};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Sizes of a recurrent policy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecurrentSizes {
    /// The self-model's, for what is observed and the networks that read it.
    pub model: Sizes,
    /// Features of h: the paper's 48.
    pub hidden: usize,
    /// Neurons of each hidden dense layer.
    pub dense: usize,
    /// Dense layers behind the GRU.
    pub layers: usize,
}

impl RecurrentSizes {
    /// The sizes of a domain's configuration, with this many dense layers.
    pub fn of(layout: &Layout, layers: usize) -> Self {
        let PolicyNetwork { hidden, dense } = config::policy(layout.domain);
        Self {
            model: Sizes::of(layout),
            hidden,
            dense,
            layers,
        }
    }

    /// The same with this many dense layers.
    pub fn with_layers(self, layers: usize) -> Self {
        Self { layers, ..self }
    }

    /// Rows of the GRU's input where there is no image: the masked observation with its masks, and the last action.
    pub const fn input(&self) -> usize {
        self.model.shape.encoded() + self.model.shape.action
    }

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
pub struct RecurrentPolicy {
    /// Sizes.
    pub sizes: RecurrentSizes,
    /// How masked observations look.
    pub view: View,
    /// Every parameter of the networks below.
    pub parameters: Parameters,
    /// Reads observations.
    pub reader: Reader,
    /// `[features; a], h → h`.
    pub gru: Gru,
    /// `h →` mean and deviation before softplus of an action before tanh, or a logit or value of each choice.
    pub head: Mlp,
    /// What the person does.
    pub actions: ActionSpace,
}

impl RecurrentPolicy {
    /// An untrained policy.
    pub fn new(sizes: RecurrentSizes, layout: &Layout, rng: &mut ChaCha8Rng) -> Self {
        let view = View::new(layout);
        let mut p = Parameters::new();
        let reader = Reader::new(&sizes.model, &view, &mut p, rng);
        let actions = sizes.model.shape.action;
        let gru = Gru::new(&mut p, "gru", reader.rows() + actions, sizes.hidden, rng);
        let mut widths = vec![sizes.hidden];
        widths.extend(vec![sizes.dense; sizes.layers.saturating_sub(1)]);
        widths.push(match layout.actions {
            ActionSpace::Continuous(n) => 2 * n,
            ActionSpace::Discrete(n) => n,
        });
        let head = Mlp::new(&mut p, "head", &widths, Activation::Identity, rng);
        Self {
            sizes,
            view,
            parameters: p,
            reader,
            gru,
            head,
            actions: layout.actions,
        }
    }

    /// h after every step of a batch of sequences: `hidden × (steps · columns)`, which the head takes. `observed`:
    /// `view rows × …`; `previous`: `actions × …`; both step after step. `before`: h before the first, `hidden × columns`.
    pub fn follow(
        &self,
        tape: &mut Tape,
        observed: &Tensor,
        previous: &Tensor,
        before: &Tensor,
    ) -> Var {
        let columns = before.cols();
        let steps = observed.cols() / columns.max(1);
        let observed = tape.input(observed);
        let features = self.reader.on_tape(tape, observed);
        let previous = tape.input(previous);
        let input = tape.concat(&[features, previous]);
        let mut h = tape.input(before);
        let mut all = Vec::with_capacity(steps);
        for t in 0..steps {
            let x = tape.columns(input, t * columns..(t + 1) * columns);
            h = tape.gru(&self.gru, x, h);
            all.push(h);
        }
        tape.join(&all)
    }
}

/// A recurrent policy as a human model.
pub struct RecurrentHuman {
    kind: Kind,
    policy: Arc<RecurrentPolicy>,
    /// The person's true limits: told, not learned.
    perceiver: Perceiver,
    limits: Vec<f32>,
    last: Mask,
    observed: Tensor,
    input: Tensor,
    before: Tensor,
    reader: ReaderScratch,
    gru: GruScratch,
    head: HeadScratch,
}

impl RecurrentHuman {
    /// A person whose sight has these limits, and who hears the utterances in `heard` without an assistant. `kind` says how the
    /// policy was learned.
    pub fn new(
        kind: Kind,
        policy: Arc<RecurrentPolicy>,
        layout: &Arc<Layout>,
        limits: Vec<f32>,
        heard: u32,
    ) -> Self {
        Self {
            kind,
            perceiver: Perceiver::new(layout, vec![limits.clone()], heard),
            limits,
            last: Mask::NONE,
            observed: Tensor::new(policy.view.rows(), 0),
            input: Tensor::default(),
            before: Tensor::default(),
            reader: ReaderScratch::default(),
            gru: GruScratch::default(),
            head: HeadScratch::default(),
            policy,
        }
    }

    /// What the last person of the last batch perceived.
    pub fn perceived(&self) -> Mask {
        self.last
    }
}

impl HumanModel for RecurrentHuman {
    fn kind(&self) -> &'static str {
        self.kind.name()
    }

    fn latent(&self) -> usize {
        self.policy.sizes.hidden
    }

    fn noise_rows(&self) -> usize {
        self.latent() + self.perceiver.noise_rows()
    }

    fn actions(&self) -> ActionSpace {
        self.policy.actions
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
        // h follows from what is perceived without chance; what is perceived may not.
        let of_sight = noise.map(|noise| &noise[hidden * batch..]);
        for j in 0..batch {
            let visual = observations.visual.column(j);
            let mask = self
                .perceiver
                .perceive(j, 0, visual, communicated[j], of_sight);
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
        out.infer(
            &policy.head,
            1.0,
            &policy.parameters,
            &beliefs.z,
            &mut self.head,
        );
    }

    fn limits(&self) -> &[f32] {
        &self.limits
    }
}
