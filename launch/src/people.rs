//! `mirror people`: the simulated people that ship, what they see and how they decide.

use crate::cli::{Domain, PeopleArguments};
use crate::columns;
use crate::console::out;
use crate::failure::Failure;
use crate::inputs;
use anyhow::{Context, Result};
use clap::ValueEnum;
use domains::discrete::{self, Limits, Mind, Setting, SimulatedPerson};
use domains::{bomb_defusal, driving, highway, search_rescue};
use serde::Serialize;
use std::process::ExitCode;

/// The scene of the highway that people's sight is told for.
const FOGGY: &str = "highway-fog";
/// People who ship for each gridworld.
const IN_A_GRIDWORLD: u32 = 10;

/// A simulated person.
#[derive(Clone, Debug, Serialize)]
struct Row {
    /// The domain, as `--domain` has it.
    domain: &'static str,
    /// For `--driver`; the number alone is for `--person`.
    driver: String,
    /// What they see by themselves, without an assistant.
    sees: Sees,
    /// Everything else about them, as in a person's file.
    parameters: Parameters,
}

/// What a person sees.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
enum Sees {
    /// How far a car is seen in fog, straight ahead, to the left, and straight behind.
    Metres {
        ahead_m: f32,
        side_m: f32,
        behind_m: f32,
    },
    /// How far a car in either lane is seen in fog.
    Cells { ahead_cells: f32, behind_cells: f32 },
    /// How near a portion of the map is seen in smoke.
    Radius { radius_cells: f32 },
    /// Probability of noticing a terminal within a step.
    Chance { notice_per_step: f32 },
}

/// A person's file.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
enum Parameters {
    Highway(highway::Person),
    Driving(driving::Person),
    SearchRescue(Box<search_rescue::Person>),
    BombDefusal(bomb_defusal::Person),
}

/// `mirror people`.
pub fn people(arguments: &PeopleArguments) -> Result<ExitCode, Failure> {
    let domains = match arguments.domain {
        Some(domain) => vec![domain],
        None => Domain::value_variants().to_vec(),
    };
    let rows = domains
        .iter()
        .map(|domain| of(*domain))
        .collect::<Result<Vec<Vec<Row>>>>()?;
    if arguments.json {
        let all: Vec<&Row> = rows.iter().flatten().collect();
        out!(
            "{}",
            serde_json::to_string_pretty(&all).context("people as JSON")?
        );
        return Ok(ExitCode::SUCCESS);
    }
    for (place, (domain, rows)) in domains.iter().zip(&rows).enumerate() {
        if place > 0 {
            out!("");
        }
        out!("{}", heading(*domain));
        let (head, cells) = cells(rows);
        for line in columns::lines(&head, &cells) {
            out!("  {line}");
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn of(domain: Domain) -> Result<Vec<Row>> {
    match domain.gridworld() {
        None => (1..=highway::Person::COUNT).map(highway_driver).collect(),
        Some(domain) => (1..=IN_A_GRIDWORLD)
            .map(|id| in_gridworld(domain, id))
            .collect(),
    }
}

fn highway_driver(id: u32) -> Result<Row> {
    let person = highway::Person::builtin(id)?;
    let fog = highway::Scene::builtin(FOGGY)?.fog();
    let visible_m = person.visibility_m(&fog);
    let quarter = visible_m.len() / 4;
    Ok(Row {
        domain: Domain::Highway.name(),
        driver: format!("sim:{id}"),
        sees: Sees::Metres {
            ahead_m: visible_m[0],
            side_m: visible_m[quarter],
            behind_m: visible_m[2 * quarter],
        },
        parameters: Parameters::Highway(person),
    })
}

fn in_gridworld(domain: discrete::Domain, id: u32) -> Result<Row> {
    let scene = discrete::Scene::of(domain, Setting::Transfer);
    let words = inputs::words(domain)?;
    let person = SimulatedPerson::builtin(&scene, id, &words)?;
    let sees = match person.sight().limits {
        Limits::Thresholds([ahead_cells, _, behind_cells, _]) => Sees::Cells {
            ahead_cells,
            behind_cells,
        },
        Limits::Radius(radius_cells) => Sees::Radius { radius_cells },
        Limits::Probabilities([notice_per_step, ..]) => Sees::Chance { notice_per_step },
    };
    let parameters = match domain {
        discrete::Domain::Driving => Parameters::Driving(driving::Person::builtin(id)?),
        discrete::Domain::SearchRescue => {
            Parameters::SearchRescue(Box::new(search_rescue::Person::builtin(id)?))
        }
        discrete::Domain::BombDefusal => {
            Parameters::BombDefusal(bomb_defusal::Person::builtin(id)?)
        }
    };
    Ok(Row {
        domain: domain.name(),
        driver: format!("sim:{id}"),
        sees,
        parameters,
    })
}

/// What stands above a domain's people.
fn heading(domain: Domain) -> String {
    let how = match domain {
        Domain::Highway => {
            "sight in highway-fog; car following by the Intelligent Driver Model, lane changes by MOBIL"
        }
        Domain::Driving => {
            "sight in driving-fog; plans by the cross-entropy method for a reward with these weights \
             (closeness of the car front left, front right, rear left, rear right)"
        }
        Domain::SearchRescue => {
            "sight in search-smoke; from subgoal to subgoal by shortest paths, the most likely first"
        }
        Domain::BombDefusal => {
            "chance of noticing a terminal; presses by the rules, guessing the bomb's type unless told"
        }
    };
    format!("{}: {how}", domain.name())
}

/// Column heads, and a row of text for each person.
fn cells(rows: &[Row]) -> (Vec<&'static str>, Vec<Vec<String>>) {
    let head = match rows.first().map(|row| &row.parameters) {
        None => vec![],
        Some(Parameters::Highway(_)) => vec![
            "driver",
            "ahead m",
            "side m",
            "behind m",
            "desired km/h",
            "headway s",
            "standstill m",
            "politeness",
            "delay steps",
        ],
        Some(Parameters::Driving(_)) => vec![
            "driver",
            "ahead cells",
            "behind cells",
            "closeness",
            "lane change",
            "right lane",
            "horizon steps",
            "slip",
        ],
        Some(Parameters::SearchRescue(_)) => vec![
            "driver",
            "radius cells",
            "first corridor",
            "then to",
            "slip",
        ],
        Some(Parameters::BombDefusal(_)) => {
            vec!["driver", "notices, a step", "mean steps to notice"]
        }
    };
    (head, rows.iter().map(text).collect())
}

fn text(row: &Row) -> Vec<String> {
    let mut text = vec![row.driver.clone()];
    match &row.sees {
        Sees::Metres {
            ahead_m,
            side_m,
            behind_m,
        } => text.extend([ahead_m, side_m, behind_m].map(|m| format!("{m:.1}"))),
        Sees::Cells {
            ahead_cells,
            behind_cells,
        } => text.extend([ahead_cells, behind_cells].map(f32::to_string)),
        Sees::Radius { radius_cells } => text.push(radius_cells.to_string()),
        Sees::Chance { notice_per_step } => {
            text.push(format!("{notice_per_step:.3}"));
            text.push(format!("{:.0}", 1.0 / notice_per_step));
        }
    }
    match &row.parameters {
        Parameters::Highway(person) => {
            let (following, changing) = (&person.following, &person.changing);
            text.extend([
                format!("{:.1}", following.desired_kmh),
                format!("{:.2}", following.headway_s),
                format!("{:.1}", following.standstill_m),
                format!("{:.2}", changing.politeness),
                person.reacting.delay_steps.to_string(),
            ]);
        }
        Parameters::Driving(person) => {
            let weights = &person.weights;
            let closeness = weights.closeness.map(|weight| format!("{weight:.1}"));
            text.extend([
                closeness.join(" "),
                format!("{:.2}", weights.change),
                format!("{:.2}", weights.offset),
                person.planning.horizon.to_string(),
                format!("{:.3}", person.slip),
            ]);
        }
        Parameters::SearchRescue(person) => {
            let (corridor, probability) = likeliest(&person.searching[0]);
            let (place, then) = likeliest(&person.searching[corridor]);
            text.extend([
                format!("{} {:.0} %", SUBGOALS[corridor], 100.0 * probability),
                format!("{} {:.0} %", SUBGOALS[place], 100.0 * then),
                format!("{:.3}", person.slip),
            ]);
        }
        Parameters::BombDefusal(_) => {}
    }
    text
}

/// Subgoals of search and rescue, in the order of a person's file.
const SUBGOALS: [&str; search_rescue::SUBGOALS] = [
    "entrance",
    "top corridor",
    "bottom corridor",
    "top right",
    "middle right",
    "bottom right",
];

/// The most likely next subgoal, and its probability.
fn likeliest(row: &[f32]) -> (usize, f32) {
    let of = |(at, probability): (usize, &f32)| (at, *probability);
    let cells = row.iter().enumerate().map(of);
    cells.fold((0, 0.0), |best, cell| match cell.1 > best.1 {
        true => cell,
        false => best,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everybody_who_ships_is_listed_as_their_file_says() {
        for domain in Domain::value_variants() {
            let rows = of(*domain).unwrap();
            let (head, cells) = cells(&rows);
            for row in &cells {
                assert_eq!(row.len(), head.len(), "{row:?}");
            }
        }
        let rows = of(Domain::Highway).unwrap();
        assert_eq!(rows.len(), 21);
        // The file of person 3 says 0.951 times the fog's 15 m, and 1.161 times its 3 m.
        let Sees::Metres {
            ahead_m, behind_m, ..
        } = rows[2].sees
        else {
            panic!("{:?}", rows[2].sees);
        };
        assert!((ahead_m - 14.265).abs() < 1e-3 && (behind_m - 3.483).abs() < 1e-3);
        let rows = of(Domain::BombDefusal).unwrap();
        assert_eq!(
            rows[2].sees,
            Sees::Chance {
                notice_per_step: 0.054
            }
        );
        assert_eq!(text(&rows[2]), ["sim:3", "0.054", "19"]);
    }
}
