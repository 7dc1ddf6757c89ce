//! What a replay found: a table for people, and all of it as JSON.

use super::resolve::Resolved;
use crate::place::ItemNames;
use anyhow::{Context, Result};
use messages::DecisionReason;
use recorder::setup::KEY;
use replay::{Decision, Drive, MissingSteps, Part, Row};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

/// Version of the JSON.
const SCHEMA: &str = "mirror-replay/1";
/// Most stretches of missing steps that are printed.
const MOST_MISSING: usize = 12;

/// Which models.
#[derive(Clone, Debug, Serialize)]
pub struct Models {
    /// Human model.
    pub human: String,
    /// Planner.
    pub planner: String,
    /// BLAKE3 of the self-model's file.
    pub self_model: String,
}

/// Sums over the compared decisions.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Totals {
    /// Sectors to highlight, summed over steps.
    pub visual_items: u64,
    /// Sectors to speak about, summed over steps.
    pub verbal_items: u64,
    /// Steps for which anything was decided.
    pub steps_with_communication: u64,
    /// Cost of all that was decided.
    pub communication_cost: f64,
    /// Decisions that were planned, and so have a value.
    pub planned: u64,
    /// Mean of their predicted values.
    pub value_mean: Option<f64>,
    /// Mean log-likelihood of the actions that the person really took, under the human model's prediction a step before.
    pub log_likelihood_mean: Option<f64>,
}

/// How many messages have the same bytes as then, but for the header.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Same {
    /// Compared.
    pub compared: u64,
    /// Of these, the same.
    pub same: u64,
    /// Episode and step of the first that is not.
    pub first_difference: Option<(u32, u32)>,
}

impl Same {
    fn add(&mut self, row: &Row, same: Option<bool>) {
        if let Some(same) = same {
            self.compared += 1;
            self.same += u64::from(same);
            if !same {
                self.first_difference.get_or_insert((row.episode, row.step));
            }
        }
    }
}

/// The JSON.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// What was read: each file, its messages, where it breaks off.
    pub parts: Vec<Part>,
    /// Messages missing inside the recording, by topic.
    pub gaps: BTreeMap<&'static str, u64>,
    /// Whether the recording has all that was sent, as far as it can tell.
    pub complete: bool,
    /// Steps that are missing in an incomplete one.
    pub missing: Vec<MissingSteps>,
    /// Scene, seed, version … as the recording says.
    pub about: BTreeMap<String, String>,
    /// Who drove.
    pub driver: String,
    /// `lockstep` or `realtime`.
    pub clock: String,
    /// Models of the recording.
    pub then: Models,
    /// Models of the replay.
    pub now: Models,
    /// Why the decisions need not be the same; where empty, they must be.
    pub differences: Vec<String>,
    /// Whether every belief and decision has the same bytes as then; none where they need not, or where some of the drive is
    /// missing and nothing differs in the rest.
    pub reproduced: Option<bool>,
    /// Steps replayed.
    pub steps: u64,
    /// Recorded steps that could not be: frame or display is missing, or the recording was cut in them.
    pub skipped_steps: u64,
    /// Steps replayed after such a step of their episode: not compared bit by bit.
    pub steps_after_gap: u64,
    /// The robot's beliefs.
    pub robot_beliefs: Same,
    /// The human model's beliefs and predictions.
    pub human_beliefs: Same,
    /// Decisions.
    pub decisions: Same,
    /// Steps at which something else is communicated.
    pub differing_decisions: u64,
    /// Steps of which the recording has the decision: what the sums below are over.
    pub compared_decisions: u64,
    /// Actions that the mean log-likelihoods are over: those of which both models spoke.
    pub compared_actions: u64,
    /// Decided then.
    pub totals_then: Totals,
    /// Decided now.
    pub totals_now: Totals,
    /// Seconds that the replay took.
    pub wall_seconds: f64,
    /// Seconds of a control step.
    pub step_s: f32,
    /// Every step.
    pub step_list: Vec<Row>,
    /// What can be communicated.
    #[serde(skip)]
    items: ItemNames,
}

impl Report {
    /// Puts it together.
    pub fn new(drive: &Drive, resolved: &Resolved, items: ItemNames, rows: Vec<Row>) -> Self {
        let whole = drive
            .steps
            .values()
            .filter(|step| step.seen.is_some() || step.display.is_some());
        let mut about = drive.found.about.clone();
        about.remove(KEY);
        let recorded_model = resolved.setup.files.get(super::setup::SELF_MODEL);
        let mut report = Self {
            schema: SCHEMA,
            parts: drive.parts.clone(),
            gaps: drive.gaps.clone(),
            complete: drive.is_complete(),
            missing: Vec::new(),
            about,
            driver: resolved.setup.driver.clone(),
            clock: resolved.setup.clock.clone(),
            then: Models {
                human: resolved.then.0.clone(),
                planner: resolved.then.1.clone(),
                self_model: recorded_model
                    .map(|file| file.blake3.clone())
                    .unwrap_or_default(),
            },
            now: Models {
                human: resolved.human.kind.name().to_owned(),
                planner: resolved.planner.method.name().to_owned(),
                self_model: resolved.self_model.clone(),
            },
            differences: resolved.differences.clone(),
            reproduced: None,
            steps: rows.len() as u64,
            skipped_steps: (whole.count() - rows.len()) as u64,
            steps_after_gap: rows.iter().filter(|row| row.after_gap).count() as u64,
            robot_beliefs: Same::default(),
            human_beliefs: Same::default(),
            decisions: Same::default(),
            differing_decisions: 0,
            compared_decisions: 0,
            compared_actions: 0,
            totals_then: Totals::default(),
            totals_now: Totals::default(),
            wall_seconds: 0.0,
            step_s: resolved.planner.step_s,
            step_list: rows,
            items,
        };
        if !report.complete {
            report.missing = drive.missing_steps();
        }
        report.compare();
        report
    }

    /// Whether the whole drive was replayed and nothing differs that must not.
    pub fn is_success(&self) -> bool {
        self.complete && self.reproduced != Some(false)
    }

    fn compare(&mut self) {
        let mut likelihoods = [0.0_f64; 2];
        for row in &self.step_list {
            if !row.after_gap {
                self.robot_beliefs.add(row, row.robot_same);
                self.human_beliefs.add(row, row.human_same);
                self.decisions.add(row, row.decision_same);
            }
            if let Some(then) = &row.then {
                self.compared_decisions += 1;
                self.differing_decisions += u64::from(!then.says_the_same(&row.now));
                self.totals_then.add(then);
                self.totals_now.add(&row.now);
            }
            if let (Some(then), Some(now)) = (row.log_likelihood_then, row.log_likelihood_now) {
                self.compared_actions += 1;
                likelihoods[0] += f64::from(then);
                likelihoods[1] += f64::from(now);
            }
        }
        for (totals, likelihood) in [&mut self.totals_then, &mut self.totals_now]
            .into_iter()
            .zip(likelihoods)
        {
            let planned = totals.planned as f64;
            totals.value_mean = totals.value_mean.map(|sum| sum / planned);
            totals.log_likelihood_mean =
                (self.compared_actions > 0).then(|| likelihood / self.compared_actions as f64);
        }
        if self.differences.is_empty() {
            let all = [self.robot_beliefs, self.human_beliefs, self.decisions];
            let same = all.iter().all(|same| same.same == same.compared);
            self.reproduced = match (self.complete, same) {
                (true, same) => Some(same && self.decisions.compared > 0),
                (false, true) => None,
                (false, false) => Some(false),
            };
        }
    }

    /// Writes the JSON.
    ///
    /// # Errors
    /// Names the file.
    pub fn save(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).context("the replay's summary")?;
        Ok(files::write(path, (text + "\n").as_bytes())?)
    }

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

impl Totals {
    fn add(&mut self, decision: &Decision) {
        self.visual_items += u64::from(decision.visual.count_ones());
        self.verbal_items += u64::from(decision.verbal.count_ones());
        self.steps_with_communication += u64::from(decision.visual | decision.verbal != 0);
        self.communication_cost += f64::from(decision.cost);
        if is_planned(decision) {
            self.planned += 1;
            *self.value_mean.get_or_insert(0.0) += f64::from(decision.value);
        }
    }
}

fn is_planned(decision: &Decision) -> bool {
    !matches!(
        decision.reason(),
        Ok(DecisionReason::NoPlanner | DecisionReason::HumanSilent)
    )
}

/// A decision in words.
fn said(decision: &Decision, items: ItemNames) -> String {
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
