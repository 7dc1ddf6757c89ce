//! Which kind of world a run is in, the highway or a gridworld, with what somebody has to know about each of them.

use domains::discrete::Scene;
use serde::{Deserialize, Serialize};

/// The kind of world, with what is known of it: `H` on the highway, `G` in a gridworld, where the scene says it all
/// unless somebody needs more. As JSON, an object with one key, `highway` or `gridworld`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
// One of them exists, once.
#[allow(clippy::large_enum_variant)]
pub enum Scenario<H = (), G = Scene> {
    /// The highway.
    Highway(H),
    /// Driving, search and rescue, or bomb defusal.
    Gridworld(G),
}

impl<H: Default, G> Default for Scenario<H, G> {
    fn default() -> Self {
        Self::Highway(H::default())
    }
}

impl<H, G> Scenario<H, G> {
    /// What is known of the highway, if it is the highway.
    pub fn highway(&self) -> Option<&H> {
        match self {
            Self::Highway(highway) => Some(highway),
            Self::Gridworld(_) => None,
        }
    }

    /// What is known of the gridworld, if it is one.
    pub fn gridworld(&self) -> Option<&G> {
        match self {
            Self::Highway(_) => None,
            Self::Gridworld(gridworld) => Some(gridworld),
        }
    }
}

/// As JSON, the gridworld's scene, and null for the highway: for processes that need to know nothing about the
/// highway's.
pub mod scene_or_null {
    use super::{Scenario, Scene};
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    /// For `#[serde(with)]`.
    ///
    /// # Errors
    /// The serializer's.
    pub fn serialize<S: Serializer>(scenario: &Scenario, to: S) -> Result<S::Ok, S::Error> {
        scenario.gridworld().serialize(to)
    }

    /// For `#[serde(with)]`, together with `default`.
    ///
    /// # Errors
    /// The deserializer's.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Scenario, D::Error> {
        let scene = Option::<Scene>::deserialize(from)?;
        Ok(scene.map_or(Scenario::Highway(()), Scenario::Gridworld))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{json, to_value};

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Options {
        #[serde(default, with = "scene_or_null")]
        gridworld: Scenario,
    }

    /// Recordings and other people's programs read what is written here.
    #[test]
    fn the_json_is_as_it_was() -> Result<(), Box<dyn std::error::Error>> {
        let read = |json| serde_json::from_value::<Options>(json);
        let highway = Options {
            gridworld: Scenario::Highway(()),
        };
        assert_eq!(to_value(&highway)?, json!({ "gridworld": null }));
        assert_eq!(read(json!({}))?, highway);
        assert_eq!(read(json!({ "gridworld": null }))?, highway);
        let scene = Scene::builtin("search-smoke")?;
        let smoke = Options {
            gridworld: Scenario::Gridworld(scene.clone()),
        };
        assert_eq!(to_value(&smoke)?, json!({ "gridworld": scene }));
        assert_eq!(read(json!({ "gridworld": scene }))?, smoke);
        let tagged: Scenario<u8> = serde_json::from_value(json!({ "highway": 7 }))?;
        assert_eq!(tagged.highway(), Some(&7));
        assert_eq!(to_value(&tagged)?, json!({ "highway": 7 }));
        Ok(())
    }
}
