//! Turns what is sensed into the robot's belief, without allocating.

use domains::ActionSpace;
use domains::highway::modalities::{read_visual, write_visual};
use messages::{DriverAction, LidarFrame, Observation, RobotBelief, Sensed};
use models::{Filter, Observations, Scratch, SelfModel, WorldModel};
use nn::Tensor;
use std::marker::PhantomData;

/// What the tracker asks of a message in which a world is sensed.
pub trait Readable: Sensed {
    /// Writes the modalities as the self-model takes them.
    fn read(&self, visual: &mut [f32], verbal: &mut [f32]);

    /// Writes a decoded visual modality in the units in which this message has it.
    fn decoded(visual: &[f32], out: &mut [f32]);
}

/// Ranges and ego values; nobody talks to the robot.
impl Readable for LidarFrame {
    fn read(&self, visual: &mut [f32], _verbal: &mut [f32]) {
        write_visual(&self.range, &self.ego, visual);
    }

    fn decoded(visual: &[f32], out: &mut [f32]) {
        read_visual(visual, out);
    }
}

impl Readable for Observation {
    fn read(&self, visual: &mut [f32], verbal: &mut [f32]) {
        visual.copy_from_slice(self.visual());
        verbal.copy_from_slice(self.verbal());
    }

    fn decoded(visual: &[f32], out: &mut [f32]) {
        out.copy_from_slice(visual);
    }
}

/// The robot's belief from step to step of a world that is sensed in `S`.
pub struct Tracker<S> {
    model: SelfModel,
    domain: u32,
    filter: Filter,
    scratch: Scratch,
    sensed: Observations,
    decoded: Observations,
    reward: Tensor,
    observed: Tensor,
    action: Tensor,
    episode: Option<u32>,
    senses: PhantomData<S>,
}

impl<S: Readable> Tracker<S> {
    /// Follows the world with `model`.
    pub fn new(model: SelfModel) -> Self {
        let shape = model.sizes.shape;
        Self {
            domain: model.layout.number,
            filter: Filter::new(model.sizes.latent, 1),
            scratch: model.scratch(),
            sensed: Observations::new(&shape, 1),
            decoded: Observations::new(&shape, 1),
            reward: Tensor::new(1, 1),
            observed: Tensor::new(model.view.rows(), 1),
            action: Tensor::new(shape.action, 1),
            episode: None,
            senses: PhantomData,
            model,
        }
    }

    /// What [`Sensed::measure`] must be for this model.
    pub fn measure(&self) -> [u32; 3] {
        let layout = &self.model.layout;
        [self.domain, layout.visual as u32, layout.verbal as u32]
    }

    /// Whether there is a belief about this episode yet.
    pub fn follows(&self, episode: u32) -> bool {
        self.episode == Some(episode)
    }

    /// Updates z^R with what is sensed, given what the person did one step before (ignored at an episode's start), and writes
    /// what is believed into `out`, all but the header.
    pub fn observe(&mut self, sensed: &S, previous: Option<&DriverAction>, out: &mut RobotBelief) {
        let (episode, step) = sensed.header().map_or((0, 0), |h| (h.episode, h.step));
        if step == 0 || !self.follows(episode) {
            self.filter.reset();
            self.episode = Some(episode);
        }
        self.set_action(previous);
        let model = &self.model;
        let Observations { visual, verbal } = &mut self.sensed;
        sensed.read(visual.column_mut(0), verbal.column_mut(0));
        let (visual, verbal) = (visual.column(0), verbal.column(0));
        let column = self.observed.column_mut(0);
        model
            .view
            .write(visual, verbal, model.layout.sensed, column);
        self.filter.update(model, &self.action, &self.observed);

        let (z, scratch) = (&self.filter.mean, &mut self.scratch);
        let Observations {
            visual: decoded,
            verbal: heard,
        } = &mut self.decoded;
        model.visual(scratch, z, decoded);
        model.verbal(scratch, z, heard);
        model.reward(scratch, z, &mut self.reward);
        let (latent, decoded, heard) = (z.rows(), decoded.column(0), heard.column(0));
        out.domain = self.domain;
        out.latent = latent as u32;
        out.mean[..latent].copy_from_slice(z.column(0));
        out.deviation[..latent].copy_from_slice(self.filter.deviation.column(0));
        (out.visual_len, out.verbal_len) = (decoded.len() as u32, heard.len() as u32);
        S::decoded(decoded, &mut out.visual[..decoded.len()]);
        out.verbal[..heard.len()].copy_from_slice(heard);
        out.reward = self.reward.column(0)[0];
        let squared = decoded.iter().zip(visual).map(|(a, b)| (a - b) * (a - b));
        out.surprise = squared.sum::<f32>() / visual.len() as f32;
    }

    /// What the person did, as the model takes it.
    fn set_action(&mut self, previous: Option<&DriverAction>) {
        let column = self.action.column_mut(0);
        column.fill(0.0);
        let Some(previous) = previous else {
            return;
        };
        match self.model.layout.actions {
            ActionSpace::Continuous(_) => {
                column.copy_from_slice(&[previous.throttle, previous.steer]);
            }
            ActionSpace::Discrete(_) => {
                let choice = previous.discrete();
                if let Some(place) = choice.and_then(|choice| column.get_mut(choice as usize)) {
                    *place = 1.0;
                }
            }
        }
    }
}
