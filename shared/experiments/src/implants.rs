//! Learnt perceptual implants against what the simulated driver can really see (paper, figure 6 and appendix "Learnt
//! perceptual implants"), per azimuth, with a drawing; and where the demonstrations cannot tell.

use crate::drawing_file::{self, Drawing};
use crate::drive::demonstrate;
use domains::highway::modalities::range_of;
use domains::highway::{AZIMUTHS, LIDAR_RANGE_M};
use domains::highway::{Cockpit, Person, Scene, SimulatedDriver, World};
use models::{Kind, SelfModel};
use plotters::coord::Shift;
use plotters::prelude::*;
use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use training::implants::{self, ImplantSettings};

/// What was learned of one azimuth.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Azimuth {
    /// Azimuth, anticlockwise from straight ahead, 10° each.
    pub azimuth: usize,
    /// What the person can really see there, in metres.
    pub true_m: f32,
    /// What was learned.
    pub learned_m: f32,
    /// The middle nine tenths of what it may be.
    pub interval_m: [f32; 2],
    /// Moments of the demonstrations in which a car stood in this azimuth within the LIDAR's range.
    pub moments: usize,
    /// Of these, moments in which the person could see it.
    pub seen: usize,
}

impl Azimuth {
    /// Whether a car was ever there in the demonstrations.
    pub fn present(&self) -> bool {
        self.moments > 0
    }

    /// Whether the demonstrations can tell the limit from both sides: cars were there within it and beyond it. Elsewhere
    /// they can at best bound it.
    pub fn crossed(&self) -> bool {
        self.seen > 0 && self.seen < self.moments
    }

    /// Distance between learned and true.
    pub fn error_m(&self) -> f32 {
        (self.learned_m.min(LIDAR_RANGE_M) - self.true_m.min(LIDAR_RANGE_M)).abs()
    }
}

/// One person's implants.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Report {
    /// Person.
    pub person: u32,
    /// Seconds that learning took.
    pub seconds: f64,
    /// Demonstration rounds.
    pub rounds: usize,
    /// −log-likelihood a step of what the person did, under the most probable hypothesis.
    pub loss: f32,
    /// Mean absolute error where cars were present, in metres.
    pub error_present_m: f32,
    /// Over all azimuths.
    pub error_m: f32,
    /// Where cars were on both sides of the true limit.
    pub error_crossed_m: f32,
    /// How many azimuths that were.
    pub crossed: usize,
    /// What always guessing the middle, 20 m, would give where cars were present.
    pub error_of_middle_m: f32,
    /// Per azimuth.
    pub azimuths: Vec<Azimuth>,
}

/// Learns one person's implants from `rounds` rounds in the default fog (`transfer`) or in clear weather, and compares.
///
/// # Errors
/// If person or scene cannot be read, or the rounds are too short.
pub fn report(
    model: &Arc<SelfModel>,
    id: u32,
    rounds: usize,
    transfer: bool,
    settings: &ImplantSettings,
) -> anyhow::Result<Report> {
    let scene = Arc::new(Scene::builtin(if transfer {
        "highway-fog"
    } else {
        "highway-clear"
    })?);
    let person = Person::builtin(id)?;
    let fog = scene.fog();
    let mut world = World::new(scene.clone())?;
    let cockpit = Cockpit::new(&scene, world.road(), scene.ego.start_s_m);
    let mut driver = SimulatedDriver::new(&person, &fog, cockpit);
    let demonstrations = demonstrate(&mut world, &mut driver, rounds);
    let started = std::time::Instant::now();
    let learned = implants::learn(
        model,
        Kind::Mirror,
        &demonstrations,
        settings,
        &mut |_, _| {},
    )?;
    let seconds = started.elapsed().as_secs_f64();
    let truth = person.visibility_m(&fog);
    let thresholds = learned.posterior.mean_limits();
    let interval = |azimuth| learned.posterior.interval(azimuth, 0.9);
    let azimuths: Vec<Azimuth> = (0..AZIMUTHS)
        .map(|azimuth| {
            let ranges = demonstrations
                .rounds
                .iter()
                .flat_map(|round| (settings.skip..round.len()).map(|t| round.visual(t)))
                .map(|visual| range_of(visual, azimuth))
                .filter(|range| *range < LIDAR_RANGE_M);
            let (mut moments, mut seen) = (0, 0);
            for range in ranges {
                moments += 1;
                seen += usize::from(range <= truth[azimuth]);
            }
            Azimuth {
                azimuth,
                true_m: truth[azimuth],
                learned_m: thresholds[azimuth],
                interval_m: interval(azimuth),
                moments,
                seen,
            }
        })
        .collect();
    let present: Vec<&Azimuth> = azimuths.iter().filter(|a| a.present()).collect();
    let mean = |values: &mut dyn Iterator<Item = f32>| {
        let (sum, n) = values.fold((0.0, 0), |(sum, n), v| (sum + v, n + 1));
        sum / n.max(1) as f32
    };
    Ok(Report {
        person: id,
        seconds,
        rounds,
        loss: learned.loss,
        error_present_m: mean(&mut present.iter().map(|a| a.error_m())),
        error_m: mean(&mut azimuths.iter().map(Azimuth::error_m)),
        error_crossed_m: mean(
            &mut azimuths
                .iter()
                .filter(|a| a.crossed())
                .map(Azimuth::error_m),
        ),
        crossed: azimuths.iter().filter(|a| a.crossed()).count(),
        error_of_middle_m: mean(
            &mut present
                .iter()
                .map(|a| (a.true_m.min(LIDAR_RANGE_M) - LIDAR_RANGE_M / 2.0).abs()),
        ),
        azimuths,
    })
}

/// Writes reports as `implants.csv`, one row per person and azimuth.
///
/// # Errors
/// If the file cannot be written.
pub fn write_csv(reports: &[Report], out: &Path) -> anyhow::Result<()> {
    let mut text = String::from("person,azimuth,true_m,learned_m,low_m,high_m,moments,seen\n");
    for report in reports {
        for a in &report.azimuths {
            writeln!(
                text,
                "{},{},{:.2},{:.2},{:.2},{:.2},{},{}",
                report.person,
                a.azimuth,
                a.true_m,
                a.learned_m,
                a.interval_m[0],
                a.interval_m[1],
                a.moments,
                a.seen
            )?;
        }
    }
    let path = out.join("implants.csv");
    Ok(files::write(&path, text.as_bytes())?)
}

/// Draws some people's implants seen from above, front up: the true limits as an outline, the learned ones as bars,
/// pale where the demonstrations had no cars on both sides of the limit and so cannot tell it. Writes `implants.svg` and `implants.png`.
///
/// # Errors
/// If a file cannot be written.
pub fn draw(reports: &[Report], out: &Path) -> anyhow::Result<()> {
    let columns = reports.len().clamp(1, 4);
    let rows = reports.len().div_ceil(columns).max(1);
    let size = (columns as u32 * 320, rows as u32 * 340);
    let sheet = Sheet {
        reports,
        shape: (rows, columns),
    };
    drawing_file::write(&sheet, size, &out.join("implants"))
}

/// People in rows and columns.
struct Sheet<'a> {
    reports: &'a [Report],
    shape: (usize, usize),
}

impl Drawing for Sheet<'_> {
    fn draw_on<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        draw_on(root, self.reports, self.shape)
    }
}

fn draw_on<B: DrawingBackend>(
    root: &DrawingArea<B, Shift>,
    reports: &[Report],
    shape: (usize, usize),
) -> Result<(), String>
where
    B::ErrorType: 'static,
{
    let text = |e: DrawingAreaErrorKind<B::ErrorType>| e.to_string();
    root.fill(&WHITE).map_err(text)?;
    for (area, report) in root.split_evenly(shape).iter().zip(reports) {
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .build_cartesian_2d(-42.0..42.0_f64, -42.0..44.0_f64)
            .map_err(text)?;
        for radius in [10.0, 20.0, 30.0, 40.0] {
            let circle = (0..=72).map(|i| at(f64::from(i) * 5.0, radius));
            chart
                .draw_series(LineSeries::new(circle, RGBColor(225, 225, 225)))
                .map_err(text)?;
        }
        for a in &report.azimuths {
            let middle = a.azimuth as f64 * 10.0;
            let reach = f64::from(a.learned_m.min(LIDAR_RANGE_M));
            let wedge = vec![(0.0, 0.0), at(middle - 4.0, reach), at(middle + 4.0, reach)];
            let colour = if a.crossed() {
                RGBColor(200, 40, 40).mix(0.75)
            } else {
                RGBColor(160, 160, 160).mix(0.35)
            };
            chart
                .draw_series(std::iter::once(Polygon::new(wedge, colour.filled())))
                .map_err(text)?;
        }
        let outline = (0..=AZIMUTHS * 2).map(|i| {
            let a = &report.azimuths[(i.div_ceil(2)) % AZIMUTHS];
            let edge = (i.div_ceil(2)) as f64 * 10.0 + if i % 2 == 0 { 5.0 } else { -5.0 };
            at(edge, f64::from(a.true_m.min(LIDAR_RANGE_M)))
        });
        chart
            .draw_series(LineSeries::new(outline, BLUE.stroke_width(2)))
            .map_err(text)?;
        let label = format!(
            "person {}: error {:.1} m where cars were",
            report.person, report.error_present_m
        );
        area.draw(&Text::new(label, (12, 4), ("sans-serif", 15)))
            .map_err(text)?;
    }
    Ok(())
}

/// A point at a bearing (degrees, anticlockwise from up) and distance.
fn at(bearing_deg: f64, distance: f64) -> (f64, f64) {
    let radians = bearing_deg.to_radians();
    (-distance * radians.sin(), distance * radians.cos())
}
