//! What the person is believed to believe, as something that can be seen: z^H through the self-model's decoder.

use crate::stage::Stage;
use anyhow::Result;
use domains::Layout;
use domains::highway::modalities::{self, read_visual};
use messages::HumanBelief;
use models::{Observations, Posterior, Scratch, SelfModel, WorldModel};
use nn::Tensor;
use scenario::Scenario;
use std::path::Path;
use std::sync::Arc;

/// The self-model, and what was learned of the person's sight.
pub struct Decoder {
    model: SelfModel,
    scratch: Scratch,
    z: Tensor,
    decoded: Tensor,
    out: Vec<f32>,
    is_highway: bool,
    sight: Option<Vec<f32>>,
}

impl Decoder {
    /// Of a stage, by the robot's self-model and the file of what the human model learned.
    ///
    /// # Errors
    /// Names the file that cannot be used.
    pub fn new(stage: &Stage, model: &Path, implants: Option<&Path>) -> Result<Self> {
        let layout: Arc<Layout> = match stage {
            Scenario::Highway(_) => modalities::layout(),
            Scenario::Gridworld(scene) => models::words::layout_of(scene)?,
        };
        let model = SelfModel::load(model, layout)?;
        // The file of a policy has other limits: those that it was told.
        let sight = implants
            .and_then(|path| Posterior::load(path, &model).ok())
            .map(|(posterior, _)| posterior.mean_limits());
        let shape = model.sizes.shape;
        let decoded = Observations::new(&shape, 1).visual;
        Ok(Self {
            scratch: model.scratch(),
            z: Tensor::new(model.sizes.latent, 1),
            out: vec![0.0; decoded.rows()],
            decoded,
            is_highway: stage.highway().is_some(),
            sight,
            model,
        })
    }

    /// How far the person sees, as learned: on the highway in metres by azimuth.
    pub fn sight(&self) -> Option<&[f32]> {
        self.sight.as_deref()
    }

    /// What the person believes to be there, in the units in which it is sensed; none of a model whose belief is not of
    /// the robot's kind.
    pub fn decode(&mut self, belief: &HumanBelief) -> Option<&[f32]> {
        let kind = runtime::text_of(&belief.kind);
        let is_self_model = models::Kind::parse(&kind).is_some_and(models::Kind::is_self_model);
        let latent = belief.latent as usize;
        if !is_self_model || latent != self.z.rows() {
            return None;
        }
        self.z.column_mut(0).copy_from_slice(&belief.mean[..latent]);
        self.model
            .visual(&mut self.scratch, &self.z, &mut self.decoded);
        match self.is_highway {
            true => read_visual(self.decoded.column(0), &mut self.out),
            false => self.out.copy_from_slice(self.decoded.column(0)),
        }
        Some(&self.out)
    }
}
