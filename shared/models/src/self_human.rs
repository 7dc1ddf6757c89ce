//! The robot's self-model as a human model: unchanged (`self`), or with implants (`mirror`, `mirror-p`).

use crate::filter::{Scratch, sample};
use crate::human::{Beliefs, HumanModel, Kind, Perceiver};
use crate::implants::Posterior;
use crate::observation::{Communicated, Observations};
use crate::policy::ActionDistribution;
use crate::self_model::SelfModel;
use domains::ActionSpace;
use nn::Tensor;
use std::sync::Arc;

/// The self-model as a human model, with or without implants.
pub struct SelfHuman {
    model: Arc<SelfModel>,
    posterior: Option<Posterior>,
    /// See [`HumanModel::limits`].
    limits: Vec<f32>,
    perceiver: Perceiver,
    observed: Tensor,
    phi: Vec<f32>,
    scratch: Scratch,
}

/// Samples of a belief where it is chance what is perceived.
const SAMPLES: usize = 8;

impl SelfHuman {
    /// The self-model with implants, of which `posterior` tells what is known, or unchanged and seeing everything without.
    /// `heard`: the utterances that the person hears without an assistant.
    pub fn new(model: Arc<SelfModel>, posterior: Option<Posterior>, heard: u32) -> Self {
        let layout = &model.layout;
        let (perceiver, limits) = match &posterior {
            Some(posterior) => {
                let limits = posterior.hypotheses.iter().map(|h| h.limits.clone());
                let perceiver = Perceiver::new(layout, limits.collect(), heard);
                (perceiver, posterior.mean_limits())
            }
            None => {
                let limits = vec![f32::INFINITY; layout.perception.limits()];
                (Perceiver::of_everything(layout, heard), limits)
            }
        };
        Self {
            observed: Tensor::new(model.view.rows(), 0),
            model,
            posterior,
            limits,
            perceiver,
            phi: Vec::new(),
            scratch: Scratch::default(),
        }
    }
}

impl HumanModel for SelfHuman {
    fn kind(&self) -> &'static str {
        match &self.posterior {
            None => Kind::Myself,
            Some(posterior) if posterior.has_policy() => Kind::Mirror,
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
            let mask = self.perceiver.perceive(
                j,
                beliefs.hypothesis[j],
                visual,
                communicated[j],
                of_sight,
            );
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
        if let Some(posterior) = &self.posterior {
            for (j, h) in beliefs.hypothesis.iter().enumerate() {
                posterior.shift(*h as usize, beliefs.z.column(j), j, out, &mut self.phi);
            }
        }
    }

    fn weights(&self) -> &[f32] {
        self.posterior.as_ref().map_or(&[1.0], |p| &p.weights)
    }

    fn samples(&self) -> usize {
        match (&self.posterior, self.perceiver.noise_rows()) {
            (Some(_), 1..) => SAMPLES,
            _ => 1,
        }
    }

    fn limits(&self) -> &[f32] {
        &self.limits
    }

    fn shares_latent(&self) -> bool {
        true
    }
}
