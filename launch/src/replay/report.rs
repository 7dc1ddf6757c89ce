//! What a replay found, as JSON; `report_text.rs` has it as a table for people.

use super::resolve::Resolved;
use crate::place::ItemNames;
use anyhow::{Context, Result};
use messages::DecisionReason;
use recorder::setup::KEY;
use replay::{Drive, MissingSteps, Part, ReplayedDecision, Row};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Version of the JSON.
const SCHEMA: &str = "mirror-replay/1";

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
    /// Mean log-likelihood of the actions that the person really took, under the human model's prediction a step
    /// before.
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
pub struct ReplayReport {
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
    /// Whether every belief and decision has the same bytes as then; none where they need not, or where some of the
    /// drive is missing and nothing differs in the rest.
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
    pub items: ItemNames,
}

impl ReplayReport {
    /// Puts it together.
    pub fn new(drive: &Drive, resolved: &Resolved, items: ItemNames, rows: Vec<Row>) -> Self {
        let whole = drive
            .steps
            .values()
            .filter(|step| step.seen.is_some() || step.display.is_some());
        let mut about = drive.found.about.clone();
        about.remove(KEY);
        let recorded_model = resolved.setup.files.get(crate::up::setup::SELF_MODEL);
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
}

impl Totals {
    fn add(&mut self, decision: &ReplayedDecision) {
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

/// Whether it has a value: there was a planner, and the human model answered it.
pub fn is_planned(decision: &ReplayedDecision) -> bool {
    !matches!(
        decision.reason(),
        Ok(DecisionReason::NoPlanner | DecisionReason::HumanSilent)
    )
}
