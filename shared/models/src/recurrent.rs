//! Recurrent policies as human models: behavioural cloning (`bc`) and soft-Q imitation (`sqil`).
//!
//! A GRU takes what the person perceives and their last action, and dense layers give a Gaussian with diagonal covariance
//! (paper, appendix "CARLA"):
//!
//! ```text
//! h_t = GRU([x̊_t; masks; a_{t−1}], h_{t−1}),   a_t = tanh(u),   u ~ N(μ(h_t), σ(h_t)²)
//! ```
//!
//! These models are told what the person can see (paper §IV-A); the belief that they carry is h.

use crate::human::{Beliefs, HumanModel, Kind};
use crate::implants::Implants;
use crate::observation::{
    AZIMUTHS, Communicated, Encoded, Observations, RANGE_M, SECTORS, Shape, overlay,
};
use crate::policy::ActionDistribution;
use crate::self_model::SelfModel;
use nn::{Activation, Gru, GruScratch, Mlp, Parameters, Tape, Tensor, Var};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Sizes of a recurrent policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecurrentSizes {
    /// Modalities and action.
    pub shape: Shape,
    /// Features of h, and neurons of each hidden dense layer.
    pub hidden: usize,
    /// Dense layers after the GRU.
    pub layers: usize,
}

impl RecurrentSizes {
    /// The highway's (paper, appendix "CARLA").
    pub const HIGHWAY: Self = Self {
        shape: Shape::HIGHWAY,
        hidden: 128,
        layers: 3,
    };

    /// Rows of the GRU's input: the masked observation with its masks, and the last action.
    pub const fn input(&self) -> usize {
        self.shape.encoded() + self.shape.action
    }
}

/// A GRU followed by dense layers.
#[derive(Clone, Debug)]
pub struct RecurrentPolicy {
    /// Sizes.
    pub sizes: RecurrentSizes,
    /// Every parameter of the networks below.
    pub parameters: Parameters,
    /// `[x̊; masks; a] , h → h`.
    pub gru: Gru,
    /// `h → [mean; deviation before softplus]` of the action before tanh.
    pub head: Mlp,
}

impl RecurrentPolicy {
    /// An untrained policy.
    pub fn new(sizes: RecurrentSizes, rng: &mut ChaCha8Rng) -> Self {
        let mut parameters = Parameters::new();
        let gru = Gru::new(&mut parameters, "gru", sizes.input(), sizes.hidden, rng);
        let mut widths = vec![sizes.hidden; sizes.layers];
        widths.push(2 * sizes.shape.action);
        let head = Mlp::new(&mut parameters, "head", &widths, Activation::Identity, rng);
        Self {
            sizes,
            parameters,
            gru,
            head,
        }
    }

    /// h_t on a tape: `input` of [`RecurrentSizes::input`] rows, `hidden` h_{t−1}.
    pub fn step(&self, tape: &mut Tape, input: Var, hidden: Var) -> Var {
        tape.gru(&self.gru, input, hidden)
    }

    /// Mean and deviation of u, `2 × batch` each, from h on a tape.
    pub fn action(&self, tape: &mut Tape, hidden: Var) -> (Var, Var) {
        let output = tape.mlp(&self.head, hidden);
        SelfModel::gaussian(tape, output, self.sizes.shape.action)
    }
}

/// A recurrent policy as a human model.
pub struct RecurrentHuman {
    kind: Kind,
    policy: Arc<RecurrentPolicy>,
    /// What the person can see of each azimuth: told, not learned.
    visible_m: [f32; AZIMUTHS],
    encoded: Encoded,
    input: Tensor,
    before: Tensor,
    scratch: GruScratch,
}

impl RecurrentHuman {
    /// A person who sees each azimuth up to `visible_m`. `kind` says how the policy was learned.
    pub fn new(kind: Kind, policy: Arc<RecurrentPolicy>, visible_m: [f32; AZIMUTHS]) -> Self {
        let sizes = policy.sizes;
        Self {
            kind,
            visible_m,
            encoded: Encoded::new(sizes.shape, 0),
            input: Tensor::new(sizes.input(), 0),
            before: Tensor::new(sizes.hidden, 0),
            scratch: GruScratch::default(),
            policy,
        }
    }
}

impl HumanModel for RecurrentHuman {
    fn kind(&self) -> &'static str {
        self.kind.name()
    }

    fn latent(&self) -> usize {
        self.policy.sizes.hidden
    }

    fn perceive(
        &mut self,
        beliefs: &mut Beliefs,
        actions: &Tensor,
        observations: &Observations,
        communicated: &[Communicated],
        _noise: Option<&[f32]>, // h follows from what was perceived, without chance
    ) {
        let batch = observations.batch();
        let hidden = self.policy.sizes.hidden;
        self.encoded.resize(batch);
        self.input.resize_to(self.policy.sizes.input(), batch);
        self.before.resize_to(hidden, batch);
        for j in 0..batch {
            let visual = observations.visual.column(j);
            let mut visual_mask = [0.0; AZIMUTHS];
            let mut verbal_mask = [0.0; SECTORS];
            Implants::visible(&self.visible_m, visual, &mut visual_mask);
            overlay(communicated[j], visual, &mut visual_mask, &mut verbal_mask);
            let verbal = observations.verbal.column(j);
            self.encoded
                .set(j, visual, verbal, &visual_mask, &verbal_mask);
            let (observed, action) = self
                .input
                .column_mut(j)
                .split_at_mut(self.policy.sizes.shape.encoded());
            observed.copy_from_slice(self.encoded.rows.column(j));
            if beliefs.fresh {
                action.fill(0.0);
            } else {
                action.copy_from_slice(actions.column(j));
            }
        }
        if beliefs.fresh {
            self.before.fill(0.0);
        } else {
            self.before.copy_from(&beliefs.z);
        }
        beliefs.fresh = false;
        self.policy.gru.infer(
            &self.policy.parameters,
            &self.input,
            &self.before,
            &mut self.scratch,
            &mut beliefs.mean,
        );
        beliefs.deviation.resize_to(hidden, batch);
        beliefs.deviation.fill(0.0);
        beliefs.z.copy_from(&beliefs.mean);
    }

    fn act(&mut self, beliefs: &Beliefs, out: &mut ActionDistribution) {
        out.infer_network(&self.policy.head, &self.policy.parameters, &beliefs.z);
    }

    fn visible_m(&self) -> [f32; AZIMUTHS] {
        self.visible_m.map(|limit| limit.clamp(0.0, RANGE_M))
    }
}
