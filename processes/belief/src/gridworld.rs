//! Turns a gridworld's observation into the robot's belief, without allocating.

use crate::follow::Follow;
use messages::{DriverAction, Observation, RobotBelief};
use models::discrete::{DiscreteFilter, DiscreteModel, DiscreteScratch};
use models::{Observations, WorldModel};
use nn::Tensor;

/// The robot's belief from observation to observation.
pub struct GridTracker {
    model: DiscreteModel,
    filter: DiscreteFilter,
    scratch: DiscreteScratch,
    decoded: Observations,
    reward: Tensor,
    observed: Tensor,
    action: Tensor,
    episode: Option<u32>,
}

impl GridTracker {
    /// Follows the world with `model`.
    pub fn new(model: DiscreteModel) -> Self {
        let shape = model.sizes.shape;
        Self {
            filter: DiscreteFilter::new(model.sizes.latent, 1),
            scratch: model.scratch(),
            decoded: Observations::new(&shape, 1),
            reward: Tensor::new(1, 1),
            observed: Tensor::new(model.view.rows(), 1),
            action: Tensor::new(shape.action, 1),
            episode: None,
            model,
        }
    }
}

impl Follow for GridTracker {
    type Sensed = Observation;

    fn measure(&self) -> [u32; 3] {
        let layout = &self.model.layout;
        [
            layout.domain.number(),
            layout.visual as u32,
            layout.verbal as u32,
        ]
    }

    fn follows(&self, episode: u32) -> bool {
        self.episode == Some(episode)
    }

    fn observe(
        &mut self,
        sensed: &Observation,
        previous: Option<&DriverAction>,
        out: &mut RobotBelief,
    ) {
        let header = &sensed.header;
        if header.step == 0 || !self.follows(header.episode) {
            self.filter.reset();
            self.episode = Some(header.episode);
        }
        self.action.fill(0.0);
        let choice = previous.and_then(DriverAction::discrete);
        if let Some(place) =
            choice.and_then(|choice| self.action.data_mut().get_mut(choice as usize))
        {
            *place = 1.0;
        }
        let model = &self.model;
        let everything = model.layout.everything();
        let column = self.observed.column_mut(0);
        model
            .view
            .write(sensed.visual(), sensed.verbal(), everything, column);
        self.filter.update(model, &self.action, &self.observed);

        let (z, scratch) = (&self.filter.mean, &mut self.scratch);
        let Observations { visual, verbal } = &mut self.decoded;
        model.visual(scratch, z, visual);
        model.verbal(scratch, z, verbal);
        model.reward(scratch, z, &mut self.reward);
        let (latent, visual, verbal) = (z.rows(), visual.column(0), verbal.column(0));
        out.domain = model.layout.domain.number();
        out.latent = latent as u32;
        out.mean[..latent].copy_from_slice(z.column(0));
        out.deviation[..latent].copy_from_slice(self.filter.deviation.column(0));
        (out.visual_len, out.verbal_len) = (visual.len() as u32, verbal.len() as u32);
        out.visual[..visual.len()].copy_from_slice(visual);
        out.verbal[..verbal.len()].copy_from_slice(verbal);
        out.reward = self.reward.column(0)[0];
        let squared = visual
            .iter()
            .zip(sensed.visual())
            .map(|(a, b)| (a - b) * (a - b));
        out.surprise = squared.sum::<f32>() / visual.len() as f32;
    }
}
