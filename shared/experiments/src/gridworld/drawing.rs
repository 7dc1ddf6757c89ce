//! Drawings of perceptual implants, learned against true, each as SVG and PNG.

use crate::drawing_file::{self, Drawing};
use domains::discrete::Domain;
use domains::driving::RANGE_CELLS;
use domains::search_rescue::SIZE;
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::path::Path;

/// Pixels along a side of a sketch.
const SIDE: u32 = 230;
const LEARNED: RGBColor = RGBColor(213, 94, 0);
const TRUE: RGBColor = RGBColor(0, 114, 178);
const GRID: RGBColor = RGBColor(205, 205, 205);

/// One person's limits.
#[derive(Clone, Debug)]
pub struct Sketch {
    /// Whose.
    pub domain: Domain,
    /// Who, where.
    pub title: String,
    /// True limits.
    pub truth: Vec<f64>,
    /// Learned limits.
    pub learned: Vec<f64>,
}

/// Draws sketches in `rows` rows into `stem.svg` and `stem.png`.
///
/// # Errors
/// If a file cannot be written.
pub fn draw(sketches: &[Sketch], rows: usize, stem: &Path) -> anyhow::Result<()> {
    let columns = sketches.len().div_ceil(rows.max(1)).max(1);
    let shape = (rows.max(1), columns);
    let size = (SIDE * columns as u32, SIDE * shape.0 as u32);
    drawing_file::write(&Sheet { sketches, shape }, size, stem)
}

/// Sketches in rows and columns.
struct Sheet<'a> {
    sketches: &'a [Sketch],
    shape: (usize, usize),
}

impl Drawing for Sheet<'_> {
    fn draw_on<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        on(root, self.sketches, self.shape)
    }
}

fn on<B: DrawingBackend>(
    root: &DrawingArea<B, Shift>,
    sketches: &[Sketch],
    shape: (usize, usize),
) -> Result<(), String>
where
    B::ErrorType: 'static,
{
    let text = |e: DrawingAreaErrorKind<B::ErrorType>| e.to_string();
    root.fill(&WHITE).map_err(text)?;
    for (area, sketch) in root.split_evenly(shape).iter().zip(sketches) {
        match sketch.domain {
            Domain::Driving => road(area, sketch),
            Domain::SearchRescue => house(area, sketch),
            Domain::BombDefusal => terminals(area, sketch),
        }
        .map_err(text)?;
    }
    Ok(())
}

type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Drawn<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

fn line<B: DrawingBackend>(
    chart: &mut Chart<B>,
    points: Vec<(f64, f64)>,
    style: impl Into<ShapeStyle>,
) -> Drawn<B> {
    chart.draw_series(std::iter::once(PathElement::new(points, style)))?;
    Ok(())
}

/// Two lanes from above, ahead is up, one's own car in the middle; a true limit of the whole range is an outline to the edge.
fn road<B: DrawingBackend>(area: &DrawingArea<B, Shift>, sketch: &Sketch) -> Drawn<B> {
    let range = f64::from(RANGE_CELLS);
    let mut chart = ChartBuilder::on(area)
        .caption(&sketch.title, ("sans-serif", 14))
        .margin(8)
        .y_label_area_size(34)
        .build_cartesian_2d(-1.3..1.3_f64, -range - 1.5..range + 1.5)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_labels(0)
        .y_labels(5)
        .y_desc("cells")
        .label_style(("sans-serif", 11))
        .draw()?;
    // Ahead left, ahead right, behind left, behind right.
    let limits = sketch.learned.iter().zip(&sketch.truth);
    for (k, (learned, truth)) in limits.enumerate() {
        let (left, sign) = (k % 2 == 0, if k < 2 { 1.0 } else { -1.0 });
        let (from, to) = if left { (-1.0, 0.0) } else { (0.0, 1.0) };
        let bar = [
            (from + 0.12, 0.0),
            (to - 0.12, sign * learned.min(range + 1.0)),
        ];
        chart.draw_series(std::iter::once(Rectangle::new(
            bar,
            LEARNED.mix(0.7).filled(),
        )))?;
        let reach = sign * truth.min(range + 1.0);
        let outline = vec![
            (from + 0.04, 0.0),
            (from + 0.04, reach),
            (to - 0.04, reach),
            (to - 0.04, 0.0),
        ];
        line(&mut chart, outline, TRUE.stroke_width(2))?;
    }
    for x in [-1.0, 0.0, 1.0] {
        line(&mut chart, vec![(x, -range - 1.5), (x, range + 1.5)], GRID)?;
    }
    let car = Rectangle::new([(-0.18, -0.5), (0.18, 0.5)], BLACK.filled());
    chart.draw_series(std::iter::once(car))?;
    Ok(())
}

/// The house from above in its 3 × 3 portions, somebody in its middle.
fn house<B: DrawingBackend>(area: &DrawingArea<B, Shift>, sketch: &Sketch) -> Drawn<B> {
    let size = SIZE as f64;
    let mut chart = ChartBuilder::on(area)
        .caption(&sketch.title, ("sans-serif", 14))
        .margin(8)
        .x_label_area_size(30)
        .y_label_area_size(34)
        .build_cartesian_2d(0.0..size, 0.0..size)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_labels(4)
        .y_labels(4)
        .x_desc("cells")
        .y_desc("cells")
        .label_style(("sans-serif", 11))
        .draw()?;
    let middle = size / 2.0;
    let (Some(&learned), Some(&truth)) = (sketch.learned.first(), sketch.truth.first()) else {
        return Ok(());
    };
    for portion in 0..9 {
        let (row, column) = (f64::from(portion / 3), f64::from(portion % 3));
        let centre = (3.0 * column + 1.5, 3.0 * row + 1.5);
        let away = (centre.0 - middle).hypot(centre.1 - middle);
        if away <= learned {
            let corners = [
                (3.0 * column, 3.0 * row),
                (3.0 * column + 3.0, 3.0 * row + 3.0),
            ];
            let seen = Rectangle::new(corners, LEARNED.mix(0.35).filled());
            chart.draw_series(std::iter::once(seen))?;
        }
        let dot = Circle::new(centre, 2, GRID.filled());
        chart.draw_series(std::iter::once(dot))?;
    }
    for at in [3.0, 6.0] {
        line(&mut chart, vec![(at, 0.0), (at, size)], GRID)?;
        line(&mut chart, vec![(0.0, at), (size, at)], GRID)?;
    }
    let circle = |radius: f64| -> Vec<(f64, f64)> {
        (0..=120)
            .map(|i| f64::from(i) / 120.0 * std::f64::consts::TAU)
            .map(|a| (middle + radius * a.cos(), middle + radius * a.sin()))
            .collect()
    };
    // What lies outside of the house is left out, piece by piece.
    let inside = |p: &(f64, f64)| (0.0..=size).contains(&p.0) && (0.0..=size).contains(&p.1);
    for (radius, colour, dashed) in [(truth, TRUE, false), (learned, LEARNED, true)] {
        for (i, pair) in circle(radius).windows(2).enumerate() {
            if pair.iter().all(inside) && !(dashed && i % 4 < 2) {
                line(&mut chart, pair.to_vec(), colour.stroke_width(2))?;
            }
        }
    }
    if truth > middle.hypot(middle) {
        // The whole house is truly seen.
        let edge = [
            (0.0, 0.0),
            (size, 0.0),
            (size, size),
            (0.0, size),
            (0.0, 0.0),
        ];
        line(&mut chart, edge.to_vec(), TRUE.stroke_width(3))?;
    }
    let person = Circle::new((middle, middle), 4, BLACK.filled());
    chart.draw_series(std::iter::once(person))?;
    Ok(())
}

/// Probabilities of the six terminals.
fn terminals<B: DrawingBackend>(area: &DrawingArea<B, Shift>, sketch: &Sketch) -> Drawn<B> {
    let all = sketch.learned.iter().chain(&sketch.truth);
    let most = all.fold(0.1_f64, |most, p| most.max(*p)) * 1.1;
    let count = sketch.learned.len() as f64;
    let mut chart = ChartBuilder::on(area)
        .caption(&sketch.title, ("sans-serif", 14))
        .margin(8)
        .x_label_area_size(30)
        .y_label_area_size(42)
        .build_cartesian_2d(0.5..count + 0.5, 0.0..most)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(WHITE)
        .bold_line_style(GRID)
        .x_labels(6)
        .y_labels(4)
        .x_label_formatter(&|x| format!("{x:.0}"))
        .x_desc("terminal")
        .y_desc("p a step")
        .label_style(("sans-serif", 11))
        .draw()?;
    for (k, (learned, truth)) in sketch.learned.iter().zip(&sketch.truth).enumerate() {
        let x = k as f64 + 1.0;
        let bar = Rectangle::new(
            [(x - 0.32, 0.0), (x + 0.32, *learned)],
            LEARNED.mix(0.7).filled(),
        );
        chart.draw_series(std::iter::once(bar))?;
        let real = vec![(x - 0.5, *truth), (x + 0.5, *truth)];
        line(&mut chart, real, TRUE.stroke_width(2))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_domain_is_drawn() {
        let folder = tempfile::tempdir().expect("a folder");
        for (domain, limits) in [
            (Domain::Driving, 4),
            (Domain::SearchRescue, 1),
            (Domain::BombDefusal, 6),
        ] {
            let sketch = |title: &str| Sketch {
                domain,
                title: title.to_owned(),
                truth: vec![0.4; limits],
                learned: vec![0.6; limits],
            };
            let stem = folder.path().join(domain.name());
            draw(&[sketch("person 1"), sketch("person 7")], 2, &stem).expect("drawn");
            let svg = std::fs::read_to_string(stem.with_extension("svg")).expect("there");
            assert!(svg.contains("person 7"), "{svg}");
            // The learned colour, and the true one.
            assert!(svg.contains("#D55E00") && svg.contains("#0072B2"), "{svg}");
            let png = std::fs::read(stem.with_extension("png")).expect("there");
            assert_eq!(&png[1..4], b"PNG");
        }
        assert!(draw(&[], 2, &folder.path().join("no/such")).is_err());
    }
}
