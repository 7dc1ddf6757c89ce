//! The robot's self-model as a human model: unchanged (`self`), or with implants (`mirror`, `mirror-p`).

use crate::filter::{Scratch, sample};
use crate::human::{Beliefs, HumanModel, Kind, Perceiver};
use crate::implants::Implants;
use crate::observation::{Communicated, Observations};
use crate::policy::ActionDistribution;
use crate::self_model::SelfModel;
use domains::ActionSpace;
use nn::{MlpScratch, Tensor};
use std::sync::Arc;

/// The self-model as a human model, with or without implants.
pub struct SelfHuman {
    model: Arc<SelfModel>,
    implants: Option<Implants>,
    perceiver: Perceiver,
    observed: Tensor,
    delta: Tensor,
    scratch: Scratch,
    mlp: MlpScratch,
}

impl SelfHuman {
    /// The self-model with `implants`, or unchanged and seeing everything without. `heard`: the utterances that the person
    /// hears without an assistant.
    pub fn new(model: Arc<SelfModel>, implants: Option<Implants>, heard: u32) -> Self {
        let layout = &model.layout;
        let perceiver = match &implants {
            Some(implants) => Perceiver::new(layout, implants.limits(), heard),
            None => Perceiver::of_everything(layout, heard),
        };
        Self {
            observed: Tensor::new(model.view.rows(), 0),
            model,
            implants,
            perceiver,
            delta: Tensor::default(),
            scratch: Scratch::default(),
            mlp: MlpScratch::default(),
        }
    }
}

impl HumanModel for SelfHuman {
    fn kind(&self) -> &'static str {
        match &self.implants {
            None => Kind::Myself,
            Some(implants) if implants.has_policy() => Kind::Mirror,
            Some(_) => Kind::MirrorP,
        }
        .name()
    }

    fn latent(&self) -> usize {
        self.model.sizes.latent
    }

    fn noise_rows(&self) -> usize {
        self.latent() + self.perceiver.noise_rows()
    }

    fn actions(&self) -> ActionSpace {
        self.model.layout.actions
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
        self.observed.resize_to(self.model.view.rows(), batch);
        let (of_z, of_sight) = noise
            .map(|noise| noise.split_at(self.model.sizes.latent * batch))
            .unzip();
        for j in 0..batch {
            let visual = observations.visual.column(j);
            let mask = self
                .perceiver
                .perceive(j, visual, communicated[j], of_sight);
            let (verbal, out) = (observations.verbal.column(j), self.observed.column_mut(j));
            self.model.view.write(visual, verbal, mask, out);
        }
        // 7: z^H ~ q_φ(z^H | z^H', ǎ, x̊)
        let previous = (!beliefs.fresh).then_some((&beliefs.z, actions));
        self.model.infer(
            &mut self.scratch,
            previous,
            &self.observed,
            &mut beliefs.mean,
            &mut beliefs.deviation,
        );
        beliefs.fresh = false;
        match of_z {
            Some(noise) => sample(&beliefs.mean, &beliefs.deviation, noise, &mut beliefs.z),
            None => {
                beliefs
                    .z
                    .resize_to(beliefs.mean.rows(), beliefs.mean.cols());
                beliefs.z.copy_from(&beliefs.mean);
            }
        }
    }

    fn act(&mut self, beliefs: &Beliefs, out: &mut ActionDistribution) {
        self.model.act(&mut self.scratch, &beliefs.z, out);
        if let Some(implants) = &self.implants {
            implants.shift(&beliefs.z, out, &mut self.mlp, &mut self.delta);
        }
    }

    fn limits(&self) -> &[f32] {
        &self.perceiver.limits
    }

    fn shares_latent(&self) -> bool {
        true
    }
}
