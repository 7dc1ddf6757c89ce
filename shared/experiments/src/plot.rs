//! Plots with intervals, each as SVG and PNG: bars of several conditions, and lines over an amount of data.

use crate::drawing_file::{self, Drawing};
use crate::statistics::Interval;
use plotters::coord::Shift;
use plotters::prelude::*;
use std::path::Path;

/// Colours that differ in lightness too (Okabe and Ito's).
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(230, 159, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(213, 94, 0),
    RGBColor(90, 90, 90),
];
/// Pixels of a panel.
const PANEL: (u32, u32) = (380, 320);

/// Bars side by side.
#[derive(Clone, Debug)]
pub struct Bars {
    /// What is measured, with its unit.
    pub title: String,
    /// Name and value of each bar.
    pub bars: Vec<(String, Interval)>,
}

/// One line of a [`Lines`].
#[derive(Clone, Debug)]
pub struct Line {
    /// Its name.
    pub name: String,
    /// x, and y with its interval; in the order of x.
    pub points: Vec<(f64, Interval)>,
}

/// Lines over x.
#[derive(Clone, Debug)]
pub struct Lines {
    /// Title.
    pub title: String,
    /// Name of the x axis, with its unit.
    pub x: String,
    /// Name of the y axis, with its unit.
    pub y: String,
    /// Where the y axis ends at most; what lies above is drawn at its end.
    pub y_most: Option<f64>,
    /// Lines.
    pub lines: Vec<Line>,
}

/// Draws panels of bars beside each other into `stem.svg` and `stem.png`.
///
/// # Errors
/// If a file cannot be written.
pub fn bars(panels: &[Bars], stem: &Path) -> anyhow::Result<()> {
    let (rows, columns) = rows_and_columns(panels);
    let size = (width_of(panels) * columns as u32, PANEL.1 * rows as u32);
    drawing_file::write(&panels, size, stem)
}

/// A panel's width, in which the names of the most bars have room.
fn width_of(panels: &[Bars]) -> u32 {
    let most = panels.iter().map(|panel| panel.bars.len()).max();
    PANEL.0.max(60 + 60 * most.unwrap_or(0) as u32)
}

/// Panels that are too wide to stand beside each other stand in two rows.
fn rows_and_columns(panels: &[Bars]) -> (usize, usize) {
    let count = panels.len().max(1);
    match width_of(panels) > 2 * PANEL.0 * 3 / 4 && count > 2 {
        true => (2, count.div_ceil(2)),
        false => (1, count),
    }
}

/// Draws panels of lines beside each other into `stem.svg` and `stem.png`.
///
/// # Errors
/// If a file cannot be written.
pub fn lines(panels: &[Lines], stem: &Path) -> anyhow::Result<()> {
    let size = ((PANEL.0 + 140) * panels.len().max(1) as u32, PANEL.1 + 60);
    drawing_file::write(&panels, size, stem)
}

/// Smallest and largest number of intervals, with a little room; zero is always inside if `with_zero`.
fn room<'a>(intervals: impl Iterator<Item = &'a Interval>, with_zero: bool) -> (f64, f64) {
    let start = if with_zero {
        (0.0, 0.0)
    } else {
        (f64::INFINITY, f64::NEG_INFINITY)
    };
    let (low, high) = intervals
        .flat_map(|i| [i.low, i.mean, i.high])
        .filter(|x| x.is_finite())
        .fold(start, |(low, high), x| (low.min(x), high.max(x)));
    if low > high {
        return (0.0, 1.0);
    }
    let margin = (0.06 * (high - low)).max(1e-9);
    let low = if with_zero && low >= 0.0 {
        0.0
    } else {
        low - margin
    };
    (low, high + margin)
}

impl Drawing for &[Bars] {
    fn draw_on<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        bars_on(root, self)
    }
}

fn bars_on<B: DrawingBackend>(root: &DrawingArea<B, Shift>, panels: &[Bars]) -> Result<(), String>
where
    B::ErrorType: 'static,
{
    let text = |e: DrawingAreaErrorKind<B::ErrorType>| e.to_string();
    root.fill(&WHITE).map_err(text)?;
    // What begins with the same word has the same colour, in every panel.
    let word = |name: &str| name.split(' ').next().unwrap_or_default().to_owned();
    let mut words: Vec<String> = Vec::new();
    for (name, _) in panels.iter().flat_map(|panel| &panel.bars) {
        if !words.contains(&word(name)) {
            words.push(word(name));
        }
    }
    for (area, panel) in root
        .split_evenly(rows_and_columns(panels))
        .iter()
        .zip(panels)
    {
        let (low, high) = room(panel.bars.iter().map(|(_, i)| i), true);
        let names: Vec<&str> = panel.bars.iter().map(|(name, _)| name.as_str()).collect();
        let mut chart = ChartBuilder::on(area)
            .caption(&panel.title, ("sans-serif", 15))
            .margin(10)
            .x_label_area_size(28)
            .y_label_area_size(48)
            .build_cartesian_2d(-0.5..names.len() as f64 - 0.5, low..high)
            .map_err(text)?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_labels(0)
            .y_labels(6)
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(225, 225, 225))
            .label_style(("sans-serif", 12))
            .draw()
            .map_err(text)?;
        for (i, (name, interval)) in panel.bars.iter().enumerate() {
            let x = i as f64;
            let colour = words.iter().position(|known| *known == word(name));
            let bar = Rectangle::new(
                [(x - 0.34, 0.0), (x + 0.34, interval.mean)],
                COLOURS[colour.unwrap_or(i) % COLOURS.len()].filled(),
            );
            chart.draw_series(std::iter::once(bar)).map_err(text)?;
            for line in whisker(x, 0.09, interval) {
                let line = PathElement::new(line, BLACK.stroke_width(1));
                chart.draw_series(std::iter::once(line)).map_err(text)?;
            }
            let (px, _) = chart.backend_coord(&(x, low));
            let (base_x, _) = area.get_base_pixel();
            let width = (name.chars().count() as f64 * 6.2) as i32;
            let place = (px - base_x - width / 2, PANEL.1 as i32 - 30);
            area.draw(&Text::new(name.clone(), place, ("sans-serif", 12)))
                .map_err(text)?;
        }
    }
    Ok(())
}

/// An interval's line and its two ends.
fn whisker(x: f64, half: f64, interval: &Interval) -> Vec<Vec<(f64, f64)>> {
    let Interval { low, high, .. } = *interval;
    vec![
        vec![(x, low), (x, high)],
        vec![(x - half, low), (x + half, low)],
        vec![(x - half, high), (x + half, high)],
    ]
}

impl Drawing for &[Lines] {
    fn draw_on<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        lines_on(root, self)
    }
}

fn lines_on<B: DrawingBackend>(root: &DrawingArea<B, Shift>, panels: &[Lines]) -> Result<(), String>
where
    B::ErrorType: 'static,
{
    let text = |e: DrawingAreaErrorKind<B::ErrorType>| e.to_string();
    root.fill(&WHITE).map_err(text)?;
    for (area, panel) in root
        .split_evenly((1, panels.len().max(1)))
        .iter()
        .zip(panels)
    {
        let intervals = panel
            .lines
            .iter()
            .flat_map(|l| l.points.iter().map(|(_, i)| i));
        let most = panel.y_most.unwrap_or(f64::INFINITY);
        let cut = |i: &Interval| Interval {
            mean: i.mean.min(most),
            low: i.low.min(most),
            high: i.high.min(most),
        };
        let shown: Vec<Interval> = intervals.map(cut).collect();
        // An interval far below says no more than that it is wide.
        let lowest = shown.iter().map(|i| i.mean).fold(f64::INFINITY, f64::min);
        let least = match panel.y_most {
            Some(most) if lowest.is_finite() => lowest - (most - lowest),
            _ => f64::NEG_INFINITY,
        };
        let cut = |i: &Interval| Interval {
            low: i.low.max(least),
            ..cut(i)
        };
        let shown: Vec<Interval> = shown.iter().map(cut).collect();
        let (low, high) = room(shown.iter(), false);
        let xs = panel
            .lines
            .iter()
            .flat_map(|l| l.points.iter().map(|(x, _)| *x));
        let (first, last) = xs.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| {
            (a.min(x), b.max(x))
        });
        let (first, last) = if first > last {
            (0.0, 1.0)
        } else {
            (first, last)
        };
        let margin = (0.05 * (last - first)).max(0.5);
        let mut chart = ChartBuilder::on(area)
            .caption(&panel.title, ("sans-serif", 15))
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(52)
            .build_cartesian_2d(first - margin..last + margin, low..high)
            .map_err(text)?;
        chart
            .configure_mesh()
            .x_desc(&panel.x)
            .y_desc(&panel.y)
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(225, 225, 225))
            .label_style(("sans-serif", 12))
            .axis_desc_style(("sans-serif", 13))
            .draw()
            .map_err(text)?;
        let count = panel.lines.len() as f64;
        for (i, line) in panel.lines.iter().enumerate() {
            let colour = COLOURS[i % COLOURS.len()];
            // A little aside, so that intervals at one x do not hide each other.
            let aside = 0.12 * margin * (i as f64 - (count - 1.0) / 2.0);
            let series = LineSeries::new(
                line.points.iter().map(|(x, y)| (x + aside, cut(y).mean)),
                colour.stroke_width(2),
            );
            chart
                .draw_series(series)
                .map_err(text)?
                .label(&line.name)
                .legend(move |(x, y)| {
                    PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2))
                });
            for (x, y) in &line.points {
                for piece in whisker(x + aside, 0.06 * margin, &cut(y)) {
                    let piece = PathElement::new(piece, colour.stroke_width(1));
                    chart.draw_series(std::iter::once(piece)).map_err(text)?;
                }
            }
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.8))
            .border_style(RGBColor(200, 200, 200))
            .label_font(("sans-serif", 12))
            .draw()
            .map_err(text)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interval(mean: f64) -> Interval {
        Interval {
            mean,
            low: mean - 0.1,
            high: mean + 0.2,
        }
    }

    #[test]
    fn both_formats_are_written_and_name_what_they_show() {
        let folder = tempfile::tempdir().expect("a folder");
        let stem = folder.path().join("p");
        let panel = Bars {
            title: "Collisions (%)".to_owned(),
            bars: vec![
                ("nobody".to_owned(), interval(1.0)),
                ("all".to_owned(), interval(0.0)),
            ],
        };
        bars(&[panel], &stem).expect("drawn");
        let svg = std::fs::read_to_string(stem.with_extension("svg")).expect("there");
        assert!(
            svg.contains("Collisions (%)") && svg.contains("nobody"),
            "{svg}"
        );
        let png = std::fs::read(stem.with_extension("png")).expect("there");
        assert_eq!(&png[1..4], b"PNG");
        let panel = Lines {
            title: "NLL".to_owned(),
            x: "drivers".to_owned(),
            y: "nats a step".to_owned(),
            y_most: Some(2.5),
            lines: vec![Line {
                name: "bc".to_owned(),
                points: vec![(2.0, interval(3.0)), (8.0, interval(2.0))],
            }],
        };
        lines(&[panel], &stem).expect("drawn");
        let svg = std::fs::read_to_string(stem.with_extension("svg")).expect("there");
        assert!(svg.contains("nats a step") && svg.contains("bc"), "{svg}");
        assert!(bars(&[], &folder.path().join("no/such")).is_err());
    }
}
