//! Turns a LIDAR frame into the robot's belief, without allocating.

use crate::follow::Follow;
use messages::{DomainNumber, DriverAction, LidarFrame, Message, RobotBelief, Sensed};
use models::observation::{Encoded, read_visual};
use models::self_model::Decoder;
use models::{Filter, Observations, SelfModel};
use nn::Tensor;

/// The robot's belief from frame to frame.
pub struct Tracker {
    model: SelfModel,
    filter: Filter,
    decoder: Decoder,
    sensed: Observations,
    decoded: Observations,
    encoded: Encoded,
    action: Tensor,
    reward: Tensor,
    /// Nothing is hidden from the robot, and nothing is said to it.
    seen: Vec<f32>,
    heard: Vec<f32>,
    episode: Option<u32>,
}

impl Tracker {
    /// Follows the world with `model`.
    pub fn new(model: SelfModel) -> Self {
        let shape = model.sizes.shape;
        Self {
            filter: Filter::new(model.sizes.latent, 1),
            decoder: Decoder::default(),
            sensed: Observations::new(&shape, 1),
            decoded: Observations::new(&shape, 1),
            encoded: Encoded::new(shape, 1),
            action: Tensor::new(shape.action, 1),
            reward: Tensor::new(1, 1),
            seen: vec![1.0; shape.visual_mask],
            heard: vec![0.0; shape.verbal_mask],
            episode: None,
            model,
        }
    }

    /// Updates z^R with `frame`, given the action that the person took one step before (ignored at an episode's start),
    /// and writes what is believed into `out`, all but the header.
    pub fn observe(&mut self, frame: &LidarFrame, previous: [f32; 2], out: &mut RobotBelief) {
        let header = &frame.header;
        if header.step == 0 || self.episode != Some(header.episode) {
            self.filter.reset();
            self.episode = Some(header.episode);
        }
        self.sensed.set_lidar(0, &frame.range, &frame.ego);
        self.encoded.set(
            0,
            self.sensed.visual.column(0),
            self.sensed.verbal.column(0),
            &self.seen,
            &self.heard,
        );
        self.action.column_mut(0).copy_from_slice(&previous);
        self.filter.update(&self.model, &self.action, &self.encoded);

        let z = &self.filter.mean;
        self.decoder.observations(&self.model, z, &mut self.decoded);
        self.decoder.reward(&self.model, z, &mut self.reward);
        let latent = z.rows();
        out.latent = latent as u32;
        out.mean[..latent].copy_from_slice(z.column(0));
        out.deviation[..latent].copy_from_slice(self.filter.deviation.column(0));
        let verbal = self.decoded.verbal.column(0);
        out.verbal[..verbal.len()].copy_from_slice(verbal);
        out.verbal_len = verbal.len() as u32;
        out.domain = DomainNumber::Highway.wire();
        out.reward = self.reward.column(0)[0];
        let (decoded, sensed) = (self.decoded.visual.column(0), self.sensed.visual.column(0));
        read_visual(decoded, &mut out.visual[..decoded.len()]);
        out.visual_len = decoded.len() as u32;
        let squared = decoded.iter().zip(sensed).map(|(a, b)| (a - b) * (a - b));
        out.surprise = squared.sum::<f32>() / sensed.len() as f32;
    }
}

impl Follow for Tracker {
    type Sensed = LidarFrame;

    fn measure(&self) -> [u32; 3] {
        LidarFrame::ZERO.measure()
    }

    fn follows(&self, episode: u32) -> bool {
        self.episode == Some(episode)
    }

    fn observe(
        &mut self,
        frame: &LidarFrame,
        previous: Option<&DriverAction>,
        out: &mut RobotBelief,
    ) {
        let previous = previous.map_or([0.0; 2], |action| [action.throttle, action.steer]);
        Self::observe(self, frame, previous, out);
    }
}
