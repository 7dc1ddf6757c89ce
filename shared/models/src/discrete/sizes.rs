//! Network sizes and fixed deviations of the gridworlds' self-models (paper, appendix, "Model Architectures and Training").

use crate::observation::Shape;
use domains::discrete::{Domain, Layout};
use serde::{Deserialize, Serialize};

/// The image at the head of the visual modality, and the networks that read and draw it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageSizes {
    /// Rows of pixels.
    pub height: usize,
    /// Columns of pixels.
    pub width: usize,
    /// Colours.
    pub colours: usize,
    /// Pixels along a side of the convolution's window.
    pub kernel: usize,
    /// Pixels from one window to the next.
    pub stride: usize,
    /// Channels of the convolution: the paper's 4.
    pub channels: usize,
    /// Channels from which the image is drawn. The paper names none; a window of the image is a sum of so many patterns, so
    /// that with the encoder's 4 nothing but the house's walls could be drawn, and no victim, obstacle or terminal.
    pub patterns: usize,
    /// Neurons of the dense layers behind the convolution: the paper's 48, bomb defusal's 64.
    pub hidden: usize,
    /// Numbers that image and words are each reduced to: the paper's 16.
    pub features: usize,
}

impl ImageSizes {
    /// The image as windows over it.
    pub fn windows(&self) -> nn::Windows {
        nn::Windows {
            height: self.height,
            width: self.width,
            channels: self.colours,
            kernel: self.kernel,
            stride: self.stride,
        }
    }
}

/// Sizes and fixed deviations of a gridworld's self-model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sizes {
    /// Whose.
    pub domain: Domain,
    /// Modalities, their masks, and how many actions there are.
    pub shape: Shape,
    /// The image, if there is one.
    pub image: Option<ImageSizes>,
    /// Dimensions of z.
    pub latent: usize,
    /// Neurons of each hidden layer of the transition.
    pub transition_hidden: usize,
    /// Of the posterior.
    pub encoder_hidden: usize,
    /// Of the decoders.
    pub decoder_hidden: usize,
    /// Of the Q-network.
    pub q_hidden: usize,
    /// σ of p(x^visual | z) for pixels.
    pub image_deviation: f32,
    /// σ of p(x^visual | z) for the other visual numbers: less than half of a cell, in which they count.
    pub state_deviation: f32,
    /// σ of p(x^verbal | z).
    pub verbal_deviation: f32,
    /// σ of p(r | z).
    pub reward_deviation: f32,
    /// Temperature of the Boltzmann policy softmax(Q / temperature), by which actions have likelihoods.
    pub temperature: f32,
}

impl Sizes {
    /// The paper's sizes for a domain.
    ///
    /// Bomb defusal's Q-network has 256 neurons a layer where the paper has 2048: with 2048, an implant step and a plan would
    /// take a hundred times the time that they have here (DESIGN §9), and its task needs no such network. The transitions of
    /// search and rescue have 64, the size of its other decoders; the paper names none. Those of bomb defusal have 128, and its
    /// rewards a smaller σ: with 64 and 0.5, the reward of a right press, 4, was imagined as 0.6, that of a wrong one, −6, as 0. Deviations and
    /// temperature are ours: what matters should be worth several nats, and a mistake that costs a whole reward be rare. At
    /// temperature 1 people in driving are more likely (0.52 nats a step instead of 0.71 with their true limits), but imagined
    /// people then heed what they are told less than real ones do, and assistants say less than would help.
    pub fn of(layout: &Layout) -> Self {
        let shape = Shape {
            visual: layout.visual,
            visual_mask: layout.regions,
            verbal: layout.verbal,
            verbal_mask: layout.utterances,
            action: layout.actions,
        };
        let image = layout.image.map(|image| ImageSizes {
            height: image.height,
            width: image.width,
            colours: image.channels,
            kernel: image.kernel,
            stride: image.stride,
            channels: 4,
            patterns: 16,
            hidden: 48,
            features: 16,
        });
        let driving = Self {
            domain: layout.domain,
            shape,
            image,
            latent: 48,
            transition_hidden: 32,
            encoder_hidden: 64,
            decoder_hidden: 32,
            q_hidden: 128,
            image_deviation: 0.3,
            state_deviation: 0.04,
            verbal_deviation: 0.2,
            reward_deviation: 0.5,
            temperature: 0.5,
        };
        match layout.domain {
            Domain::Driving => driving,
            Domain::SearchRescue => Self {
                state_deviation: 0.08,
                transition_hidden: 64,
                encoder_hidden: 128,
                decoder_hidden: 64,
                q_hidden: 200,
                ..driving
            },
            Domain::BombDefusal => Self {
                image: image.map(|image| ImageSizes {
                    patterns: 9,
                    hidden: 64,
                    ..image
                }),
                transition_hidden: 128,
                encoder_hidden: 64,
                decoder_hidden: 64,
                q_hidden: 256,
                state_deviation: 0.08,
                reward_deviation: 0.25,
                ..driving
            },
        }
    }

    /// A reason why these sizes make no sense for a layout, if there is one.
    pub fn problem(&self, layout: &Layout) -> Option<String> {
        let expected = Self::of(layout);
        if self.domain != expected.domain {
            let (ours, theirs) = (layout.domain.name(), self.domain.name());
            return Some(format!("made for {theirs}, not for {ours}"));
        }
        if self.shape != expected.shape || self.image != expected.image {
            return Some(format!(
                "made for observations of {:?} {:?}, the domain has {:?} {:?}",
                self.shape, self.image, expected.shape, expected.image
            ));
        }
        let layers = [
            self.latent,
            self.transition_hidden,
            self.encoder_hidden,
            self.decoder_hidden,
            self.q_hidden,
        ];
        if layers.iter().any(|n| !(1..=4096).contains(n)) {
            return Some(format!("layers from 1 to 4096 neurons, not {layers:?}"));
        }
        let scales = [
            self.image_deviation,
            self.state_deviation,
            self.verbal_deviation,
            self.reward_deviation,
            self.temperature,
        ];
        (!scales.iter().all(|x| x.is_finite() && *x > 0.0))
            .then(|| format!("deviations and temperature must be positive, not {scales:?}"))
    }

    /// Numbers of the image at the head of the visual modality.
    pub fn image_numbers(&self) -> usize {
        self.image.map_or(0, |image| image.windows().image())
    }
}
