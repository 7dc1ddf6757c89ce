//! The gridworlds' self-model as a human model: unchanged (`self`), or with implants (`mirror`, `mirror-p`).

use super::filter::DiscreteScratch;
use super::implants::Implants;
use super::perception::Perceiver;
use super::self_model::DiscreteModel;
use crate::human::{Beliefs, HumanModel, Kind};
use crate::observation::{Communicated, Observations};
use crate::policy::ActionDistribution;
use crate::self_model::sample;
use domains::discrete::Mask;
use nn::{MlpScratch, Tensor};
use std::sync::Arc;

/// The self-model as a human model, with or without implants.
pub struct DiscreteHuman {
    model: Arc<DiscreteModel>,
    implants: Option<Implants>,
    perceiver: Perceiver,
    limits: Vec<f32>,
    heard: u32,
    observed: Tensor,
    delta: Tensor,
    scratch: DiscreteScratch,
    mlp: MlpScratch,
}

impl DiscreteHuman {
    /// The self-model with `implants`, or unchanged and seeing everything without. `heard`: the utterances that the person
    /// hears without an assistant; who speaks is no secret, so these are given, not learned.
    pub fn new(model: Arc<DiscreteModel>, implants: Option<Implants>, heard: u32) -> Self {
        let perceiver = Perceiver::new(&model.layout);
        let limits = implants
            .as_ref()
            .map_or_else(|| vec![f32::INFINITY; perceiver.limits()], Implants::limits);
        Self {
            observed: Tensor::new(model.view.rows(), 0),
            model,
            implants,
            perceiver,
            limits,
            heard,
            delta: Tensor::default(),
            scratch: DiscreteScratch::default(),
            mlp: MlpScratch::default(),
        }
    }

    /// What this model thinks limits the person's sight: cells, or probabilities; infinite where nothing does.
    pub fn limits(&self) -> &[f32] {
        &self.limits
    }
}

impl HumanModel for DiscreteHuman {
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

    fn distribution(&self, batch: usize) -> ActionDistribution {
        ActionDistribution::categorical(self.model.sizes.shape.action, batch)
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
        let chance = self.perceiver.noise_rows();
        let (of_z, of_sight) = match noise {
            None => (None, None),
            Some(noise) => {
                let (z, sight) = noise.split_at(self.model.sizes.latent * batch);
                (Some(z), (chance > 0).then_some(sight))
            }
        };
        for j in 0..batch {
            let visual = observations.visual.column(j);
            let noise = of_sight.map(|noise| &noise[j * chance..(j + 1) * chance]);
            // 4: x̌ = h_p(x̂)   5: û = w_ω(x̂)   6: x̊ = v(x̌, û)
            let mask = Mask {
                visual: self.perceiver.seen(&self.limits, visual, noise),
                verbal: self.heard,
            };
            let mask = mask | Mask::from(communicated[j]);
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
            None => beliefs.z.copy_from(&beliefs.mean),
        }
    }

    fn act(&mut self, beliefs: &Beliefs, out: &mut ActionDistribution) {
        self.model.policy(&mut self.scratch, &beliefs.z, out);
        if let Some(implants) = &self.implants {
            implants.shift(&beliefs.z, out, &mut self.mlp, &mut self.delta);
        }
    }

    fn shares_latent(&self) -> bool {
        true
    }
}
