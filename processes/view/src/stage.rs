//! Where a run takes place, as the page draws it.

use domains::discrete;
use domains::highway::outline::Outline;
use domains::highway::speech::SECTOR_NAMES;
use domains::highway::{self, Fog};
use scenario::Scenario;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Where a run takes place.
pub type Stage = Scenario<Road>;

/// The highway.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Road {
    /// The scene's name.
    pub name: String,
    /// Seconds of a step.
    pub step_s: f64,
    /// The road.
    pub outline: Outline,
    /// How far a person with average eyes sees ahead, aside and behind, in metres; none in clear weather.
    pub fog_m: Option<[f64; 3]>,
}

impl Road {
    /// The road of a scene, or of its recording.
    ///
    /// # Errors
    /// When it cannot be built.
    pub fn of(scene: &highway::Scene) -> anyhow::Result<Self> {
        let outline = match &scene.course {
            Some(course) => Outline::of(&course.road),
            None => Outline::of(&scene.road.build()?),
        };
        Ok(Self {
            name: scene.name.clone(),
            step_s: scene.step_s(),
            outline,
            fog_m: scene.fog.map(|fog| [fog.front_m, fog.side_m, fog.rear_m]),
        })
    }

    /// How far one sees, by azimuth.
    pub fn visible_m(&self) -> Option<Vec<f32>> {
        let [front, side, rear] = self.fog_m?;
        let fog = Fog::new(front as f32, side as f32, rear as f32);
        Some(fog.visible_m.to_vec())
    }
}

/// What the page is told of a stage.
pub trait Describe {
    /// As JSON.
    fn describe(&self) -> Value;
}

impl Describe for Stage {
    fn describe(&self) -> Value {
        match self {
            Self::Highway(road) => json!({
                "domain": "highway",
                "name": road.name,
                "step_s": road.step_s,
                "road": road.outline,
                "visible_m": road.visible_m(),
                "items": SECTOR_NAMES,
                "actions": ["throttle", "steer"],
            }),
            Self::Gridworld(scene) => {
                let mut stage = json!({
                    "domain": scene.domain().name(),
                    "name": scene.name(),
                    "step_s": discrete::STEP_S,
                });
                // What cannot be read here stops no process that has to read it too.
                if let Ok(layout) = models::words::layout_of(scene) {
                    stage["items"] = json!(layout.region_names);
                    stage["utterances"] = json!(layout.utterance_names);
                    stage["actions"] = json!(layout.action_names);
                    stage["image"] = json!(layout.image.map(|image| [
                        image.channels,
                        image.height,
                        image.width
                    ]));
                }
                stage
            }
        }
    }
}
