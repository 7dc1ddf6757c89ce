//! The settings that ship, one TOML file per domain (`shared/models/config`): network sizes here, those of learners in the
//! `training` crate. Nothing of it stands in code.

use crate::sizes::{Sizes, SizesError};
use domains::{Layout, bomb_defusal, highway, search_rescue};
use serde::{Deserialize, Serialize};

/// The file of a domain, and its name; a domain that does not ship begins with gridworld driving's.
pub fn shipped(domain: &str) -> (&'static str, &'static str) {
    macro_rules! file {
        ($name:literal) => {
            (
                concat!("config/", $name),
                include_str!(concat!("../config/", $name)),
            )
        };
    }
    match domain {
        highway::modalities::NAME => file!("highway.toml"),
        search_rescue::NAME => file!("search_rescue.toml"),
        bomb_defusal::NAME => file!("bomb_defusal.toml"),
        _ => file!("driving.toml"),
    }
}

/// Sizes of networks and fixed deviations, as a configuration has them in its table `network`; what observations look like,
/// the domain's layout says. [`Sizes`] documents the fields.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "`Sizes` has them")]
pub struct Network {
    pub latent: usize,
    pub transition_hidden: usize,
    pub encoder_hidden: usize,
    pub decoder_hidden: usize,
    pub policy_hidden: usize,
    pub image_deviation: f32,
    pub state_deviation: f32,
    pub verbal_deviation: f32,
    pub reward_deviation: f32,
    pub temperature: f32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image: Option<ImageNetwork>,
}

/// The networks that read and draw an image. [`crate::ImageSizes`] documents the fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "`ImageSizes` has them")]
pub struct ImageNetwork {
    pub channels: usize,
    pub patterns: usize,
    pub hidden: usize,
    pub features: usize,
}

/// Sizes of a recurrent policy: h, and each hidden dense layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub struct PolicyNetwork {
    /// Features of h.
    pub hidden: usize,
    /// Neurons of each hidden dense layer.
    pub dense: usize,
}

/// What this crate reads of a file.
#[derive(Deserialize)]
struct Networks {
    network: Network,
    policy: PolicyNetwork,
}

fn networks(domain: &str) -> Networks {
    let (name, text) = shipped(domain);
    // Every file that ships is read by a test.
    toml::from_str(text).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// The network sizes of the models that ship.
pub fn network(domain: &str) -> Network {
    networks(domain).network
}

/// Sizes of the recurrent policies that are learned by default.
pub fn policy(domain: &str) -> PolicyNetwork {
    networks(domain).policy
}

impl Network {
    /// With what the domain's observations look like.
    ///
    /// # Errors
    /// Says which size makes no sense.
    pub fn sizes(&self, layout: &Layout) -> Result<Sizes, SizesError> {
        if layout.image.is_some() && self.image.is_none() {
            let missing = "the domain has an image, and there is no table `network.image`";
            return Err(SizesError(missing.to_owned()));
        }
        let sizes = Sizes::with_network(self, layout);
        match sizes.problem(layout) {
            Some(problem) => Err(SizesError(problem)),
            None => Ok(sizes),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_domain_has_a_file_of_its_own() {
        let domains = ["highway", "driving", "search_rescue", "bomb_defusal"];
        for domain in domains {
            let (name, text) = shipped(domain);
            assert_eq!(name, format!("config/{domain}.toml"));
            assert!(text.contains(&format!("domain `{domain}`")), "{name}");
            assert!(network(domain).latent > 0 && policy(domain).hidden > 0);
        }
        assert_eq!(network("elsewhere"), network("driving"));
    }
}
