//! Network sizes and fixed deviations of self-models (paper, appendix, "Model Architectures and Training").

use crate::config::{self, Network};
use crate::observation::Shape;
use domains::Layout;
use serde::{Deserialize, Serialize};

/// Most dimensions of z: what a message holds.
pub const MOST_LATENT: usize = 128;

/// Sizes that make no sense, and why.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct SizesError(pub String);

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

/// Sizes and fixed deviations of a self-model. The deviations are ours: they set how much each modality counts in the ELBO.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sizes {
    /// Modalities, their masks, and numbers of an action.
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
    /// Of the policy, and of its critics.
    pub policy_hidden: usize,
    /// σ of p(x^visual | z) for pixels.
    pub image_deviation: f32,
    /// σ of p(x^visual | z) for the other visual numbers.
    pub state_deviation: f32,
    /// σ of p(x^verbal | z).
    pub verbal_deviation: f32,
    /// σ of p(r | z).
    pub reward_deviation: f32,
    /// Temperature of the Boltzmann policy softmax(Q / temperature), by which actions have likelihoods.
    pub temperature: f32,
}

impl Sizes {
    /// The sizes of the self-models that ship ([`crate::config`] says why they are so). A domain that does not ship has those
    /// of gridworld driving.
    pub fn of(layout: &Layout) -> Self {
        Self::with_network(&config::network(layout.domain), layout)
    }

    /// These networks over observations of a domain.
    pub(crate) fn with_network(network: &Network, layout: &Layout) -> Self {
        let image = layout.image.zip(network.image);
        let image = image.map(|(image, networks)| ImageSizes {
            height: image.height,
            width: image.width,
            colours: image.channels,
            kernel: image.kernel,
            stride: image.stride,
            channels: networks.channels,
            patterns: networks.patterns,
            hidden: networks.hidden,
            features: networks.features,
        });
        Self {
            shape: Shape::of(layout),
            image,
            latent: network.latent,
            transition_hidden: network.transition_hidden,
            encoder_hidden: network.encoder_hidden,
            decoder_hidden: network.decoder_hidden,
            policy_hidden: network.policy_hidden,
            image_deviation: network.image_deviation,
            state_deviation: network.state_deviation,
            verbal_deviation: network.verbal_deviation,
            reward_deviation: network.reward_deviation,
            temperature: network.temperature,
        }
    }

    /// With so many neurons in every hidden layer.
    pub fn with_hidden(self, neurons: usize) -> Self {
        Self {
            transition_hidden: neurons,
            encoder_hidden: neurons,
            decoder_hidden: neurons,
            policy_hidden: neurons,
            ..self
        }
    }

    /// A reason why these sizes make no sense for a layout, if there is one.
    pub fn problem(&self, layout: &Layout) -> Option<String> {
        let expected = Self::of(layout);
        let (picture, its) = (self.image, expected.image);
        let picture = picture.map(|image| image.windows());
        let its = its.map(|image| image.windows());
        if self.shape != expected.shape || picture != its {
            return Some(format!(
                "made for observations of {:?} {picture:?}, the domain has {:?} {its:?}",
                self.shape, expected.shape
            ));
        }
        if let Some(image) = self.image {
            let sizes = [image.channels, image.patterns, image.hidden, image.features];
            if sizes.iter().any(|n| !(1..=1024).contains(n)) {
                return Some(format!("image networks of 1 to 1024, not {sizes:?}"));
            }
        }
        if self.latent > MOST_LATENT {
            return Some(format!(
                "z of {} dimensions: a message holds {MOST_LATENT}",
                self.latent
            ));
        }
        let layers = [
            self.latent,
            self.transition_hidden,
            self.encoder_hidden,
            self.decoder_hidden,
            self.policy_hidden,
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
