//! `--picture FILE.svg`: a typical step and the slowest in all processes, with arrows along the messages and the
//! critical path marked.

use crate::result::{Span, Trace};
use messages::PROCESSES;
use std::collections::BTreeSet;
use std::fmt::Write;

const WIDTH: f64 = 1180.0;
const LEFT: f64 = 96.0;
const RIGHT: f64 = 24.0;
const TOP: f64 = 74.0;
const ROW: f64 = 58.0;
const BAR: f64 = 24.0;
/// Bars narrower than this have no label.
const LABELLED: f64 = 62.0;

/// A drawing of some steps, one below the other, each with its title.
pub fn svg(panels: &[(String, Trace)], subtitle: &str) -> String {
    let mut body = String::new();
    let mut height = 0.0;
    for (title, trace) in panels {
        let _ = writeln!(body, r#"<g transform="translate(0 {height:.0})">"#);
        height += panel(&mut body, trace, title, subtitle);
        body += "</g>\n";
    }
    legend(&mut body, height + 8.0);
    height += 28.0;
    format!(
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0}" font-family="Helvetica, Arial, sans-serif">
<rect width="100%" height="100%" fill="#ffffff"/>
<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto-start-reverse"><path d="M0 0 8 4 0 8z" fill="#566"/></marker></defs>
{body}</svg>
"##
    )
}

/// Draws one step and returns its height.
fn panel(out: &mut String, trace: &Trace, title: &str, subtitle: &str) -> f64 {
    let rows: Vec<&str> = PROCESSES
        .into_iter()
        .filter(|name| trace.spans.iter().any(|span| span.process == *name))
        .collect();
    let height = TOP + ROW * rows.len() as f64 + 50.0;
    // A little of before and after, so that what reaches over the borders is seen to.
    let length = trace.latency_ns as f64;
    let (from, to) = (-0.04 * length, 1.06 * length);
    let scale = (WIDTH - LEFT - RIGHT) / (to - from);
    let drawing = StepDrawing {
        rows,
        x: move |ns: f64| LEFT + (ns.clamp(from, to) - from) * scale,
    };
    for (y, size, weight, text) in [(26, 17, "bold", title), (47, 12, "normal", subtitle)] {
        let _ = writeln!(
            out,
            r##"<text x="{LEFT}" y="{y}" font-size="{size}" font-weight="{weight}" fill="#333">{}</text>"##,
            escaped(text)
        );
    }
    drawing.axis(out, length, height - 50.0);
    drawing.bars(out, trace);
    drawing.arrows(out, trace);
    height
}

struct StepDrawing<'a, X> {
    rows: Vec<&'a str>,
    x: X,
}

impl<X: Fn(f64) -> f64> StepDrawing<'_, X> {
    fn y(&self, process: &str) -> Option<f64> {
        let row = self.rows.iter().position(|name| *name == process)?;
        Some(TOP + ROW * row as f64 + (ROW - BAR) / 2.0)
    }

    fn axis(&self, out: &mut String, length: f64, bottom: f64) {
        for (row, name) in self.rows.iter().enumerate() {
            let y = TOP + ROW * row as f64;
            let shade = if row % 2 == 0 { "#f6f7f9" } else { "#ffffff" };
            let _ = writeln!(
                out,
                r##"<rect x="0" y="{y:.1}" width="{WIDTH}" height="{ROW}" fill="{shade}"/><text x="{:.1}" y="{:.1}" font-size="13" text-anchor="end" fill="#222">{name}</text>"##,
                LEFT - 10.0,
                y + ROW / 2.0 + 4.0
            );
        }
        let step = nice_step(length / 8.0);
        let (unit, divisor) = if length >= 2e6 {
            ("ms", 1e6)
        } else {
            ("µs", 1e3)
        };
        let mut at = 0.0;
        while at <= length * 1.05 {
            let x = (self.x)(at);
            let _ = writeln!(
                out,
                r##"<line x1="{x:.1}" x2="{x:.1}" y1="{TOP}" y2="{bottom:.1}" stroke="#d9dde2" stroke-width="1"/><text x="{x:.1}" y="{:.1}" font-size="11" text-anchor="middle" fill="#555">{} {unit}</text>"##,
                bottom + 16.0,
                trimmed(at / divisor)
            );
            at += step;
        }
        for at in [0.0, length] {
            let x = (self.x)(at);
            let _ = writeln!(
                out,
                r##"<line x1="{x:.1}" x2="{x:.1}" y1="{:.1}" y2="{bottom:.1}" stroke="#333" stroke-width="1.2" stroke-dasharray="4 3"/>"##,
                TOP - 6.0
            );
        }
    }

    fn bars(&self, out: &mut String, trace: &Trace) {
        for span in &trace.spans {
            let (fill, stroke) = match span.kind.as_str() {
                "compute" => ("#3f7fb8", "#2a5a86"),
                "unknown" => ("#bbbbbb", "#999999"),
                _ => ("#f3d9a8", "#d3ab62"),
            };
            self.bar(out, span, fill, stroke);
        }
        // The critical path: a line below the bars that it runs through.
        for span in &trace.path {
            if let Some(y) = self.y(&span.process) {
                let (x1, x2) = ((self.x)(span.from_ns as f64), (self.x)(span.to_ns as f64));
                let _ = writeln!(
                    out,
                    r##"<rect x="{x1:.1}" y="{:.1}" width="{:.2}" height="5" fill="#c8312b"><title>{}</title></rect>"##,
                    y + BAR + 2.0,
                    (x2 - x1).max(0.6),
                    escaped(&told(span))
                );
            }
        }
    }

    fn bar(&self, out: &mut String, span: &Span, fill: &str, stroke: &str) {
        let Some(y) = self.y(&span.process) else {
            return;
        };
        let (x1, x2) = ((self.x)(span.from_ns as f64), (self.x)(span.to_ns as f64));
        let width = x2 - x1;
        if width <= 0.0 {
            return;
        }
        let _ = writeln!(
            out,
            r##"<rect x="{x1:.1}" y="{y:.1}" width="{:.2}" height="{BAR}" fill="{fill}" stroke="{stroke}" stroke-width="0.5"><title>{}</title></rect>"##,
            width.max(1.0),
            escaped(&told(span))
        );
        if width >= LABELLED && span.kind == "compute" {
            let text = span.what.trim_start_matches("computes ");
            let _ = writeln!(
                out,
                r##"<text x="{:.1}" y="{:.1}" font-size="10.5" text-anchor="middle" fill="#ffffff" pointer-events="none">{}</text>"##,
                (x1 + x2) / 2.0,
                y + BAR / 2.0 + 3.5,
                escaped(text)
            );
        }
    }

    fn arrows(&self, out: &mut String, trace: &Trace) {
        let mut drawn = BTreeSet::new();
        for arrow in &trace.arrows {
            let (Some(y1), Some(y2)) = (self.y(&arrow.from), self.y(&arrow.to)) else {
                continue;
            };
            if arrow.sent_ns < 0 && arrow.used_ns < 0 {
                continue;
            }
            let (x1, x2) = (
                (self.x)(arrow.sent_ns as f64),
                (self.x)(arrow.used_ns as f64),
            );
            // Hundreds of questions of one plan would be a black band: of those that fall together, one is drawn.
            let place = (
                arrow.topic.as_str(),
                (x1 / 3.0) as i64,
                (x2 / 3.0) as i64,
                &arrow.to,
            );
            if !drawn.insert(place) {
                continue;
            }
            let (y1, y2) = if y2 > y1 {
                (y1 + BAR, y2)
            } else {
                (y1, y2 + BAR)
            };
            let _ = writeln!(
                out,
                r##"<path d="M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}" stroke="#566" stroke-width="0.9" fill="none" marker-end="url(#head)" opacity="0.75"><title>{}: {} to {}</title></path>"##,
                escaped(&arrow.topic),
                escaped(&arrow.from),
                escaped(&arrow.to)
            );
        }
    }
}

fn legend(out: &mut String, y: f64) {
    let items = [
        ("#3f7fb8", 12.0, "computes"),
        (
            "#f3d9a8",
            12.0,
            "its newest input is there, it has not begun; or it awaits answers",
        ),
        ("#c8312b", 5.0, "critical path"),
    ];
    let mut x = LEFT;
    for (fill, height, text) in items {
        let _ = writeln!(
            out,
            r##"<rect x="{x:.1}" y="{:.1}" width="22" height="{height}" fill="{fill}"/><text x="{:.1}" y="{y:.1}" font-size="12" fill="#333">{text}</text>"##,
            y - height / 2.0 - 4.0,
            x + 28.0
        );
        x += 60.0 + 6.3 * text.len() as f64;
    }
    let _ = writeln!(
        out,
        r##"<path d="M{x:.1} {0:.1}h26" stroke="#566" marker-end="url(#head)"/><text x="{1:.1}" y="{y:.1}" font-size="12" fill="#333">a message, from its sending to its use</text>"##,
        y - 4.0,
        x + 34.0
    );
}

fn told(span: &Span) -> String {
    let us = (span.to_ns - span.from_ns) as f64 / 1000.0;
    format!("{}: {} {us:.1} µs", span.process, span.what)
}

/// A round number at least as large: 1, 2 or 5 times a power of ten.
fn nice_step(least: f64) -> f64 {
    let power = 10.0_f64.powf(least.max(1.0).log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .map(|factor| factor * power)
        .into_iter()
        .find(|step| *step >= least)
        .unwrap_or(10.0 * power)
}

fn trimmed(value: f64) -> String {
    let text = format!("{value:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}
