//! Who drives on the highway: a simulated person, or a recorded one.

use crate::person::ActingPerson;
use anyhow::{Context, Result};
use domains::commonroad::Scenario;
use domains::highway::speech::Heard;
use domains::highway::{self, Cockpit, Scene, Shown, SimulatedDriver, UtteranceKind, World};
use messages::{Display, DriverAction, LidarFrame, Message, SECTORS, Sensed, UtteranceContent};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// A seat on the highway.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HighwaySeat {
    /// The scene: what the cockpit and the weather are like.
    pub scene: Scene,
    /// The CommonRoad file whose road and traffic take the place of the scene's own.
    #[serde(default)]
    pub recording: Option<PathBuf>,
    /// Who drives.
    pub person: Driving,
}

/// Who drives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
// One of them exists, once.
#[allow(clippy::large_enum_variant)]
pub enum Driving {
    /// A simulated person.
    Simulated(highway::Person),
    /// The person in this car of the recording.
    Recorded(i32),
}

impl HighwaySeat {
    /// Nanoseconds of a step in the real-time clock.
    pub fn step_ns(&self) -> u64 {
        (1e9 * self.scene.step_s() / self.scene.clock.rate) as u64
    }
}

/// The person at the wheel, with buffers for what they are shown.
pub struct HighwayDriver {
    who: AtTheWheel,
    seed: u64,
    observation: highway::Observation,
    shown: Shown,
}

// One of them exists, once.
#[allow(clippy::large_enum_variant)]
enum AtTheWheel {
    Simulated(SimulatedDriver),
    /// Replays its own copy of the world; the recording alone says what happens there.
    Recorded(World),
}

impl HighwayDriver {
    /// Seats the person.
    ///
    /// # Errors
    /// When the recording's file is not what it was when the run was planned.
    pub fn new(options: &HighwaySeat, seed: u64) -> Result<Self> {
        let mut scene = options.scene.clone();
        scene.seat = match options.person {
            Driving::Simulated(_) => None,
            Driving::Recorded(car) => Some(car),
        };
        if let Some(file) = &options.recording {
            scene.course = Some(Arc::new(Scenario::read(file)?.course(scene.seat)?));
        }
        let world = World::new(Arc::new(scene)).context("the scene's road")?;
        let who = match &options.person {
            Driving::Simulated(person) => {
                let cockpit = Cockpit::new(&options.scene, world.road(), world.ego().at.s_m);
                AtTheWheel::Simulated(SimulatedDriver::new(person, &options.scene.fog(), cockpit))
            }
            Driving::Recorded(car) => {
                world
                    .recorded_action()
                    .with_context(|| format!("no recorded car {car} to drive as"))?;
                AtTheWheel::Recorded(world)
            }
        };
        Ok(Self {
            who,
            seed,
            observation: highway::Observation::default(),
            shown: Shown::default(),
        })
    }
}

impl ActingPerson for HighwayDriver {
    type Sensed = LidarFrame;

    fn measure(&self) -> [u32; 3] {
        LidarFrame::ZERO.measure()
    }

    fn reset(&mut self, episode: u32) {
        self.shown = Shown::default();
        match &mut self.who {
            AtTheWheel::Simulated(driver) => driver.reset(self.seed, episode),
            AtTheWheel::Recorded(world) => world.reset(self.seed, episode),
        }
    }

    fn see(&mut self, display: &Display) {
        self.shown.highlighted = display.highlighted;
        self.shown.highlighted_objects = display.objects;
        for utterance in display
            .utterances
            .iter()
            .take(display.utterance_count as usize)
        {
            let kind = match utterance.content() {
                Ok(UtteranceContent::Nothing) => Some(UtteranceKind::Nothing),
                Ok(UtteranceContent::Slow) => Some(UtteranceKind::Slow),
                Ok(UtteranceContent::Fast) => Some(UtteranceKind::Fast),
                _ => None,
            };
            let sector = utterance.item as usize;
            if let (Some(kind), true) = (kind, sector < SECTORS) {
                let (range_m, speed_mps) = (utterance.range_m, utterance.speed_mps);
                self.shown.utterances[sector] = Some(Heard {
                    kind,
                    range_m,
                    speed_mps,
                });
            }
        }
    }

    fn act(&mut self, frame: &LidarFrame, out: &mut DriverAction) {
        [out.throttle, out.steer] = match &mut self.who {
            AtTheWheel::Simulated(driver) => {
                self.observation.range = frame.range;
                self.observation.object = frame.object;
                self.observation.speed_mps = frame.speed_mps;
                self.observation.ego = frame.ego;
                self.observation.moving = frame.moving != 0;
                driver.act(&self.observation, &self.shown)
            }
            AtTheWheel::Recorded(world) => {
                // In real time a frame may have been passed over: the recording goes on with the world's step.
                while world.steps() < frame.header.step {
                    world.step([0.0; 2]);
                }
                world.recorded_action().unwrap_or_default()
            }
        };
        self.shown.utterances = [None; SECTORS];
    }
}
