//! What the study of recorded drivers found: intervals over splits, a table, a plot.

use super::{Drivers, MODELS, Rule, Study, TESTED, WARM_UP, key};
use crate::plot::{Line, Lines, lines};
use crate::results::{link, with_interval};
use crate::statistics::{Interval, over_people};
use crate::table::write_json;
use models::Kind;
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;

/// One model's likelihood having learned from so many drivers.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// Model.
    pub model: &'static str,
    /// Drivers learned from.
    pub drivers: usize,
    /// −log π in nats a step, mean over the tested drivers: over splits with interval.
    pub nll: Interval,
    /// The same of the driver in the middle, whom no single strange drive can move.
    pub median: Interval,
}

/// What the study found.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Drivers that were kept.
    pub drivers: usize,
    /// Drivers of each split that were tested.
    pub tested: usize,
    /// Drivers and files that were left out, with the reason.
    pub left_out: Vec<(String, String)>,
    /// Splits.
    pub splits: u64,
    /// Fog that perception was limited by, as a distance ahead.
    pub fog_m: Option<f64>,
    /// Who was left out.
    pub rule: Rule,
    /// Numbers of drivers learned from.
    pub counts: Vec<usize>,
    /// Results.
    pub points: Vec<Point>,
}

impl Report {
    pub(super) fn new(
        study: &Study,
        drivers: &Drivers,
        counts: &[usize],
        rows: &[Vec<String>],
    ) -> Self {
        let mut points = Vec::new();
        for kind in MODELS {
            for &count in counts {
                let learned = if kind == Kind::Myself { 0 } else { count };
                let over_splits = |column: usize| -> Interval {
                    let values: Vec<f64> = (0..study.splits)
                        .filter_map(|split| {
                            let key = key((kind, split, learned));
                            let row = rows.iter().find(|row| row[..3].join(",") == key)?;
                            row[column].parse().ok()
                        })
                        .collect();
                    over_people(&values)
                };
                points.push(Point {
                    model: kind.name(),
                    drivers: count,
                    nll: over_splits(4),
                    median: over_splits(5),
                });
            }
        }
        Self {
            drivers: drivers.kept.len(),
            tested: drivers.kept.len() / TESTED,
            left_out: drivers.left_out.clone(),
            splits: study.splits,
            fog_m: study.fog_m,
            rule: study.rule,
            counts: counts.to_vec(),
            points,
        }
    }

    /// Results of one model, in the order of [`Report::counts`].
    pub fn of(&self, model: &str) -> impl Iterator<Item = &Point> {
        self.points.iter().filter(move |point| point.model == model)
    }

    /// Writes `real.json`, `real.svg` and `real.png`.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, out: &Path) -> anyhow::Result<()> {
        write_json(&out.join("real.json"), self)?;
        let panel = |title: &str, value: fn(&Point) -> Interval| Lines {
            title: title.to_owned(),
            x: "drivers learned from".to_owned(),
            y: "−log π(a), nats a step".to_owned(),
            y_most: self.most(value),
            lines: MODELS
                .iter()
                .map(|kind| Line {
                    name: kind.name().to_owned(),
                    points: self
                        .of(kind.name())
                        .map(|point| (point.drivers as f64, value(point)))
                        .collect(),
                })
                .collect(),
        };
        let panels = [
            panel("The middle one of the tested drivers", |point| point.median),
            panel("Mean over the tested drivers", |point| point.nll),
        ];
        lines(&panels, &out.join("real"))
    }

    /// A model that learned from too few can be wrong by hundreds of nats; the plot ends a little above the unchanged
    /// self-model's likelihood.
    fn most(&self, value: fn(&Point) -> Interval) -> Option<f64> {
        let own = self.of(Kind::Myself.name()).map(|point| value(point).mean);
        own.reduce(f64::max).map(|own| own + 0.1 * own.abs())
    }

    /// The study's section of RESULTS.md. `command` made it; `note` says what was special about the run.
    pub fn section(&self, results: &Path, out: &Path, command: &str, note: &str) -> String {
        let perception = match self.fog_m {
            None => "Perception is unlimited, up to the LIDAR's 40 m.".to_owned(),
            Some(m) => format!("Perception is limited as in fog of {m} m ahead; BC is told so."),
        };
        let mut text = format!(
            "`{command}`: −log π(a) of recorded drivers (CommonRoad) in nats a control step, mean over {} splits with 95 % intervals over splits, which share drivers and so are not independent. \
             {} drivers, of whom {} are tested in each split and never learned from; {} left out. {} {perception} The first {WARM_UP} steps of a drive are not scored. {note}\n\n",
            self.splits,
            self.drivers,
            self.tested,
            self.left_out.len(),
            self.rule.words(),
        );
        let mut table = |title: &str, value: fn(&Point) -> Interval| {
            let _ = write!(text, "| {title} |");
            for count in &self.counts {
                let _ = write!(text, " {count} drivers |");
            }
            let _ = write!(text, "\n| --- |{}", " --- |".repeat(self.counts.len()));
            for kind in MODELS {
                let _ = write!(text, "\n| {} |", kind.name());
                for point in self.of(kind.name()) {
                    let _ = write!(text, " {} |", with_interval(&value(point), 1.0, 2));
                }
            }
            text.push_str("\n\n");
        };
        table("mean over drivers", |point| point.nll);
        table("driver in the middle", |point| point.median);
        let plot = |extension| link(results, &out.join("real").with_extension(extension));
        let _ = writeln!(
            text,
            "![likelihood of recorded drivers; what lies above the plot is cut]({})\n\n([PNG]({}), [table]({}), [who was left out]({}))",
            plot("svg"),
            plot("png"),
            plot("csv"),
            plot("json"),
        );
        text
    }
}
