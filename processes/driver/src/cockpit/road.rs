//! The highway as the cockpit's page is shown it.

use super::Table;
use super::page::{CarOnPage, ToPage};
use crate::HighwaySeat;
use anyhow::{Context, Result};
use domains::commonroad::Scenario;
use domains::highway::World;
use domains::highway::outline::Outline;
use messages::{Display, LidarFrame, Message, ObjectKind, ObjectPose, Scene, Sensed};
use serde_json::{Value, json};
use std::sync::Arc;

/// Cars this much farther away than one can see are not sent to the page, unless they are highlighted: what is not
/// there cannot be looked up.
const BEYOND_M: f64 = 15.0;

/// The highway.
pub struct Drive {
    scene: Value,
    /// How far one sees in the direction in which one sees farthest.
    sight_m: f64,
    boxes: Vec<i32>,
}

impl Drive {
    /// The seat's road.
    ///
    /// # Errors
    /// When the road cannot be built, or the recording is not what it was.
    pub fn new(seat: &HighwaySeat) -> Result<Self> {
        let mut scene = seat.scene.clone();
        scene.seat = None;
        if let Some(file) = &seat.recording {
            scene.course = Some(Arc::new(Scenario::read(file)?.course(None)?));
        }
        let world = World::new(Arc::new(scene.clone())).context("the scene's road")?;
        let visible_m = scene.fog().visible_m;
        let fog = scene.fog.map(|fog| [fog.front_m, fog.side_m, fog.rear_m]);
        let ego = &scene.ego;
        Ok(Self {
            scene: json!({
                "domain": "highway",
                "name": scene.name,
                "step_s": scene.step_s(),
                "road": Outline::of(world.road()),
                "goal_s_m": scene.episode.goal_s_m,
                "fog": fog,
                "ego": {
                    "length_m": ego.length_m,
                    "width_m": ego.width_m,
                    "wheelbase_m": ego.wheelbase_m,
                    "steer_deg": ego.steer_deg,
                    "throttle_limit_kmh": ego.throttle_limit_kmh,
                },
            }),
            sight_m: f64::from(visible_m.iter().copied().fold(0.0, f32::max)),
            boxes: Vec::with_capacity(16),
        })
    }

    fn is_sent(&self, ego: &ObjectPose, car: &ObjectPose) -> bool {
        let distance_m = (car.x_m - ego.x_m).hypot(car.y_m - ego.y_m);
        let clear = self.scene["fog"].is_null();
        clear || distance_m < self.sight_m + BEYOND_M || self.boxes.contains(&car.id)
    }
}

impl Table for Drive {
    type Sensed = LidarFrame;

    fn measure(&self) -> [u32; 3] {
        LidarFrame::ZERO.measure()
    }

    fn scene(&self) -> Value {
        self.scene.clone()
    }

    fn holds_input(&self) -> bool {
        true
    }

    fn reset(&mut self, _: u32) {
        self.boxes.clear();
    }

    fn sense(&mut self, _: &LidarFrame) {}

    fn shown(&self) -> Option<Value> {
        None
    }

    fn see(&mut self, display: &Display) {
        let shown = display.objects.iter().take(display.object_count as usize);
        self.boxes.clear();
        self.boxes.extend(shown.copied().filter(|id| *id >= 0));
    }

    fn motion(&mut self, scene: &Scene, number: u64) -> Option<ToPage> {
        let ego = &scene.ego;
        let cars = scene.objects.iter().take(scene.count as usize);
        let cars = cars.filter(|car| self.is_sent(ego, car)).map(|car| {
            CarOnPage(
                car.id,
                round(car.x_m),
                round(car.y_m),
                round(car.heading_rad.into()),
                round(car.speed_mps.into()),
                car.length_m,
                car.width_m,
                car.kind == ObjectKind::Other.wire(),
            )
        });
        Some(ToPage::Motion {
            n: number,
            e: scene.header.episode,
            k: scene.header.step,
            at: scene.header.sent_ns as f64 * 1e-6,
            ego: [
                round(ego.x_m),
                round(ego.y_m),
                round(ego.heading_rad.into()),
                round(ego.speed_mps.into()),
            ],
            cars: cars.collect(),
        })
    }
}

/// To a tenth of a millimetre: a page needs no more digits.
fn round(value: f64) -> f64 {
    (value * 1e4).round() * 1e-4
}
