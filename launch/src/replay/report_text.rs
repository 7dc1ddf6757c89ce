//! What a replay found, as a table for people.

use super::report::{ReplayReport, Same, is_planned};
use crate::place::ItemNames;
use messages::DecisionReason;
use replay::{ReplayedDecision, Row};
use std::fmt::Write;

/// Most stretches of missing steps that are printed.
const MOST_MISSING: usize = 12;

impl ReplayReport {
    /// The report for people, with at most `lines` steps.
    pub fn text(&self, lines: usize) -> String {
        let mut out = String::new();
        self.write_recording(&mut out);
        self.write_steps(lines, &mut out);
        self.write_totals(&mut out);
        self.write_verdict(&mut out);
        out
    }

    fn write_recording(&self, out: &mut String) {
        let about = |key: &str| self.about.get(key).map_or("?", String::as_str);
        for part in &self.parts {
            let _ = writeln!(out, "{}: {} messages", part.file.display(), part.messages);
            if let Some(cut) = &part.cut {
                let _ = writeln!(
                    out,
                    "  CUT SHORT: {}",
                    cut.trim_start_matches("cut short at ")
                );
            }
            for damage in &part.damage {
                let damage = damage.trim_start_matches("damaged at ");
                let _ = writeln!(out, "  DAMAGED: {damage}");
            }
            if part.gone > 0 {
                let gone = part.gone;
                let _ = writeln!(out, "  {gone} messages that were in it are lost");
            }
            if let Some(lost) = part.counted_lost.filter(|lost| *lost > 0) {
                let _ = writeln!(
                    out,
                    "  INCOMPLETE: says itself that {lost} messages were lost"
                );
            }
        }
        for (topic, lost) in &self.gaps {
            let _ = writeln!(out, "  GAPS: {lost} messages missing on /{topic}");
        }
        if !self.missing.is_empty() {
            let listed = self.missing.iter().take(MOST_MISSING);
            let listed: Vec<_> = listed.map(ToString::to_string).collect();
            let more = match self.missing.len().saturating_sub(MOST_MISSING) {
                0 => String::new(),
                more => format!(" … and {more} more stretches (--summary FILE for all)"),
            };
            let _ = writeln!(out, "  MISSING: {}{more}", listed.join("; "));
        }
        let (clock, driver) = (&self.clock, &self.driver);
        let _ = writeln!(
            out,
            "scene {} · driver {driver} · seed {} · clock {clock} · recorded by version {}",
            about("scene"),
            about("seed"),
            about("version")
        );
        for (word, models) in [("then", &self.then), ("now ", &self.now)] {
            let _ = writeln!(
                out,
                "{word}  human model {:<9} planner {:<5} self-model {:.16}",
                models.human, models.planner, models.self_model
            );
        }
    }

    /// What the letters stand for.
    fn legend(&self) -> String {
        if self.items.word == ItemNames::SECTORS.word {
            return "F front, L left, R right or rear: LF is left-front, RR right-rear".to_owned();
        }
        let both = self.items.visual.iter().chain(self.items.verbal);
        let mut names: Vec<_> = both.map(|name| format!("{} {name}", short(name))).collect();
        names.dedup();
        names.join(", ")
    }

    fn write_steps(&self, lines: usize, out: &mut String) {
        let differs = |row: &&Row| row.then.is_some_and(|then| !then.says_the_same(&row.now));
        let rows: Vec<_> = self.step_list.iter().filter(differs).collect();
        if rows.is_empty() {
            return;
        }
        let _ = writeln!(
            out,
            "\n{}\nepisode  step   time s  {:<34}{:<34}{:>15}{:>13}{:>17}",
            self.legend(),
            "said then",
            "would be said now",
            "value then/now",
            "cost",
            "log p(action)"
        );
        for row in rows.iter().take(lines) {
            let (Some(then), now) = (row.then, row.now) else {
                continue;
            };
            let or_dash =
                |value: Option<f32>| value.map_or("–".to_owned(), |value| format!("{value:.2}"));
            let _ = writeln!(
                out,
                "{:>7}  {:>4}  {:>7.2}  {:<34}{:<34}{:>7} {:>7}{:>7.2} {:>5.2}{:>9} {:>7}{}",
                row.episode,
                row.step + 1,
                f64::from(row.step + 1) * f64::from(self.step_s),
                said(&then, self.items),
                said(&now, self.items),
                or_dash(is_planned(&then).then_some(then.value)),
                or_dash(is_planned(&now).then_some(now.value)),
                then.cost,
                now.cost,
                or_dash(row.log_likelihood_then),
                or_dash(row.log_likelihood_now),
                if row.after_gap { "  after a gap" } else { "" },
            );
        }
        if rows.len() > lines {
            let _ = writeln!(
                out,
                "         … and {} more (--lines N, or --summary FILE for all)",
                rows.len() - lines
            );
        }
    }

    fn write_totals(&self, out: &mut String) {
        let (then, now) = (&self.totals_then, &self.totals_now);
        let mut line = |what: &str, then: String, now: String| {
            let _ = writeln!(out, "{what:<44}{then:>12}{now:>12}");
        };
        line("", "then".to_owned(), "now".to_owned());
        let count = |value: u64| value.to_string();
        let number = |value: f64| format!("{value:.2}");
        line(
            "decisions compared",
            count(self.compared_decisions),
            count(self.compared_decisions),
        );
        line(
            &format!("{} highlighted × steps", self.items.word),
            count(then.visual_items),
            count(now.visual_items),
        );
        line(
            &format!("{} to speak about × steps", self.items.word),
            count(then.verbal_items),
            count(now.verbal_items),
        );
        line(
            "steps with anything to communicate",
            count(then.steps_with_communication),
            count(now.steps_with_communication),
        );
        line(
            "communication cost",
            number(then.communication_cost),
            number(now.communication_cost),
        );
        let mean =
            |value: Option<f64>| value.map_or("–".to_owned(), |value| format!("{value:.3}"));
        line(
            "mean predicted value",
            mean(then.value_mean),
            mean(now.value_mean),
        );
        line(
            &format!(
                "mean log-likelihood of {} recorded actions",
                self.compared_actions
            ),
            mean(then.log_likelihood_mean),
            mean(now.log_likelihood_mean),
        );
    }

    fn write_verdict(&self, out: &mut String) {
        let Self {
            steps,
            wall_seconds,
            ..
        } = self;
        let _ = writeln!(
            out,
            "\n{steps} steps replayed in {wall_seconds:.1} s, {} could not be ({} of the replayed come after such a step)",
            self.skipped_steps, self.steps_after_gap
        );
        let same = |what: &str, same: &Same| {
            let first = same
                .first_difference
                .map_or(String::new(), |(episode, step)| {
                    format!(", first difference at episode {episode} step {step}")
                });
            format!("{what} {} of {}{first}", same.same, same.compared)
        };
        let _ = writeln!(
            out,
            "same bytes (all but the header): {} · {} · {}",
            same("robot's beliefs", &self.robot_beliefs),
            same("human beliefs", &self.human_beliefs),
            same("decisions", &self.decisions)
        );
        let _ = writeln!(
            out,
            "{} of {} decisions communicate something else",
            self.differing_decisions, self.compared_decisions
        );
        let verdict = match self.reproduced {
            Some(true) => "REPRODUCED bit for bit",
            Some(false) => "NOT REPRODUCED: everything is as recorded, and yet something differs",
            None if self.differences.is_empty() => "what is there is the same bit for bit",
            None => "need not be the same:",
        };
        let _ = writeln!(out, "{verdict}");
        for difference in &self.differences {
            let _ = writeln!(out, "  {difference}");
        }
        if !self.differences.is_empty() {
            let _ = writeln!(
                out,
                "  (person and world are as recorded at every step, whatever would have been said before it)"
            );
        }
        if !self.complete {
            let _ = writeln!(
                out,
                "this is only a part of the drive: the recording is incomplete, and nothing is shown of what it lacks"
            );
        }
    }
}

/// A decision in words.
fn said(decision: &ReplayedDecision, items: ItemNames) -> String {
    let listed = |bits: u32, names: &[&str]| {
        let named = names
            .iter()
            .enumerate()
            .filter(|(item, _)| bits >> item & 1 == 1);
        named
            .map(|(_, name)| short(name))
            .collect::<Vec<_>>()
            .join(" ")
    };
    let mut parts = Vec::new();
    if decision.visual != 0 {
        parts.push(format!("show {}", listed(decision.visual, items.visual)));
    }
    if decision.verbal != 0 {
        parts.push(format!("say {}", listed(decision.verbal, items.verbal)));
    }
    match (parts.is_empty(), decision.reason()) {
        (true, Ok(DecisionReason::HumanSilent)) => "nothing (no answer)".to_owned(),
        (true, _) => "nothing".to_owned(),
        (false, _) => parts.join(", "),
    }
}

/// `left-front` as `LF`, `top left` as `TL`.
fn short(name: &str) -> String {
    name.split(['-', ' '])
        .filter_map(|word| word.chars().next())
        .map(|letter| letter.to_ascii_uppercase())
        .collect()
}
