//! What each process of a run is started with: its options, made of the run's plan.

use super::plan::RunPlan;
use super::setup;
use crate::learned::ImplantSource;
use crate::process::NAMES;
use crate::screen;
use anyhow::{Context, Result, bail};
use domains::highway::Scene;
use driver::{GridworldSeat, HighwaySeat};
use models::Kind;
use recorder::recording::About;
use recorder::setup::Setup;
use recorder::visual::RoadLine;
use runtime::RunArguments;
use scenario::Scenario;
use std::collections::BTreeMap;
use std::path::PathBuf;
use world::HighwayRoad;

impl RunPlan {
    /// The arguments that a process is started with.
    ///
    /// # Errors
    /// When options cannot be written as JSON.
    pub fn arguments(&self, run: &RunArguments, index: usize) -> Result<RunArguments> {
        let process = NAMES[index];
        let plain = RunArguments {
            spin_us: self.spin_us,
            ..run.for_process(process, index as u32)
        };
        let scenario = match self.scene.gridworld() {
            None => Scenario::Highway(()),
            Some(scene) => Scenario::Gridworld(scene.clone()),
        };
        let with_options = match process {
            "world" => plain.with_options(&world::WorldOptions {
                scenario: self.world(),
                episodes: self.episodes,
                seed: self.seed,
                has_cockpit: self.driver.has_cockpit,
            }),
            "driver" => plain.with_options(&driver::DriverOptions {
                scenario: self.seat()?,
                seed: self.seed,
                cockpit: self.driver.has_cockpit.then_some(driver::CockpitOptions {
                    void_after_s: self.void_after_s,
                    episodes: self.episodes,
                }),
            }),
            "belief" => plain.with_options(&belief::BeliefOptions {
                model: self.self_model.0.clone(),
                scenario,
            }),
            "human" => plain.with_options(&human::HumanOptions {
                kind: self.human,
                model: self.self_model.0.clone(),
                implants: match &self.implants {
                    ImplantSource::None => None,
                    ImplantSource::File(path) => Some(path.clone()),
                    ImplantSource::Learn(_) => bail!("the human model has not learned yet"),
                },
                person: match &self.modelled {
                    Scenario::Gridworld(person) if self.human == Kind::Ideal => {
                        Some(person.clone())
                    }
                    _ => None,
                },
                scenario,
                seed: self.seed,
            }),
            "planner" => plain.with_options(&planner::PlannerOptions {
                method: self.planner,
                model: Some(self.self_model.0.clone()),
                settings: self.settings,
                seed: self.seed,
                step_s: self.scene.step_s() as f32,
                real_step_s: Some((self.scene.step_ns() as f64 * 1e-9) as f32),
                patience_ms: 50,
                scenario,
            }),
            "renderer" => plain.with_options(&renderer::RendererOptions {
                step_s: self.scene.step_s() as f32,
                speech_interval_s: match &self.scene.scenario {
                    Scenario::Highway(road) => road.scene.communication.speech_interval_s as f32,
                    Scenario::Gridworld(_) => 0.0,
                },
                print: !self.quiet,
                colours: screen::has_colours(),
                scenario,
            }),
            "recorder" => plain.with_options(&recorder::RecorderOptions {
                record: self.record.clone(),
                result: Some(self.recorder_result(run)),
                about: self.about(run)?,
                road: match &self.scene.scenario {
                    Scenario::Highway(road) => {
                        road_lines(&road.scene).with_context(|| self.scene.name.clone())?
                    }
                    Scenario::Gridworld(_) => Vec::new(),
                },
                ..recorder::RecorderOptions::default()
            }),
            other => bail!("there is no process {other:?}"),
        };
        with_options.with_context(|| format!("options of {process}"))
    }

    /// The world, for its process.
    fn world(&self) -> Scenario<HighwayRoad> {
        match &self.scene.scenario {
            Scenario::Highway(road) => Scenario::Highway(road.clone()),
            Scenario::Gridworld((scene, _)) => Scenario::Gridworld(scene.clone()),
        }
    }

    /// The person and where they are, for their process.
    fn seat(&self) -> Result<Scenario<HighwaySeat, GridworldSeat>> {
        Ok(match (&self.scene.scenario, &self.driver.who) {
            (Scenario::Highway(road), Scenario::Highway(person)) => {
                Scenario::Highway(HighwaySeat {
                    scene: road.scene.clone(),
                    recording: road.recording.clone(),
                    person: person.clone(),
                })
            }
            (Scenario::Gridworld((scene, _)), Scenario::Gridworld(person)) => {
                Scenario::Gridworld(GridworldSeat {
                    scene: scene.clone(),
                    person: person.clone(),
                })
            }
            _ => bail!("{} is not at home in this scene", self.driver.name),
        })
    }

    /// What the live view is started with.
    ///
    /// # Errors
    /// When the road cannot be built.
    pub fn view_options(&self) -> Result<view::ViewOptions> {
        let stage = match &self.scene.scenario {
            Scenario::Highway(road) => Scenario::Highway(
                view::Road::of(&road.scene).with_context(|| self.scene.name.clone())?,
            ),
            Scenario::Gridworld((scene, _)) => Scenario::Gridworld(scene.clone()),
        };
        let about = ["driver", "human", "planner"]
            .map(|process| (process.to_owned(), self.kind_of_process(process)));
        Ok(view::ViewOptions {
            stage,
            model: self.self_model.0.clone(),
            implants: match &self.implants {
                ImplantSource::File(path) => Some(path.clone()),
                ImplantSource::None | ImplantSource::Learn(_) => None,
            },
            about: about.into(),
        })
    }

    /// Where the recorder says what it recorded.
    pub fn recorder_result(&self, run: &RunArguments) -> PathBuf {
        run.directory().join("recorder-result.json")
    }

    fn about(&self, run: &RunArguments) -> Result<About> {
        let setup = match (&self.record, self.setup.get()) {
            (None, _) => Setup::default(),
            (_, Some(setup)) => setup.clone(),
            (_, None) => {
                let setup = setup::setup(self, self.options(run)?)?;
                self.setup.get_or_init(|| setup).clone()
            }
        };
        Ok(About {
            scene: self.scene.name.clone(),
            human: self.kind_of_process("human"),
            planner: self.kind_of_process("planner"),
            seed: self.seed,
            run_id: run.run_id,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            step_ns: (1e9 * self.scene.step_s()).round() as u64,
            setup,
        })
    }

    /// Every process's options but the recorder's, by process.
    fn options(&self, run: &RunArguments) -> Result<BTreeMap<String, serde_json::Value>> {
        let mut options = BTreeMap::new();
        for (index, process) in NAMES.into_iter().enumerate() {
            if process != "recorder" {
                options.insert(process.to_owned(), self.arguments(run, index)?.options);
            }
        }
        Ok(options)
    }
}

/// The road's lines, for the recording's picture.
fn road_lines(scene: &Scene) -> Result<Vec<RoadLine>> {
    const STEP_M: f64 = 5.0;
    let built;
    let road = match &scene.course {
        Some(course) => &course.road,
        None => {
            built = scene.road.build()?;
            &built
        }
    };
    let mut lines = Vec::new();
    for (index, lane) in road.lanes().iter().enumerate() {
        // A lane's left line, and for the first lane the right one too; the outermost are drawn through.
        let (from_m, to_m) = (lane.from_m.max(0.0), lane.to_m.min(road.length_m()));
        for side in [-0.5, 0.5] {
            if side < 0.0 && index > 0 {
                continue;
            }
            let steps = ((to_m - from_m) / STEP_M).ceil().max(1.0) as usize;
            let points_m = (0..=steps).map(|step| {
                let s_m = from_m + (to_m - from_m) * step as f64 / steps as f64;
                let d_m = road.lane_offset_m(index, s_m) + side * road.lane_width_m(index, s_m);
                let (x_m, y_m, ..) = road.place(s_m, d_m);
                [x_m, y_m]
            });
            let dashed = side > 0.0 && index + 1 < road.lanes().len();
            lines.push(RoadLine {
                points_m: points_m.collect(),
                dashed,
            });
        }
    }
    Ok(lines)
}
