//! The overview of the paper's claims at the top of `RESULTS.md`, collected from what the sections below say: every section
//! keeps its claims in a comment as JSON, and whoever writes a section writes the overview anew.
//!
//! ```text
//! <!-- mirror:claims begin -->            <!-- mirror:drive begin -->
//! | claim | … |                           …
//! <!-- mirror:claims end -->              <!-- mirror:drive claims [{"letter":"g", …}] -->
//! ```

use crate::results::{Claim, Verdict, write_section};
use crate::table::replace;
use anyhow::Context;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

/// The claims, by letter, as the overview words them.
const CLAIMS: [(char, &str); 8] = [
    ('a', "BC has the best policy NLL"),
    ('b', "every assistant that communicates beats NC"),
    (
        'c',
        "in driving and bomb defusal MIRROR's assistance gives the best performance of the learned models, with an amount of communication close to the ideal model's",
    ),
    (
        'd',
        "4 rounds suffice: performance from 20 % of the data is close to that from all of it",
    ),
    (
        'e',
        "in search and rescue SQIL is at most slightly better and speaks far more",
    ),
    (
        'f',
        "learned perceptual implants match the truth in the original and in the transfer setting, with bomb defusal's probabilities near the person's real ones",
    ),
    (
        'g',
        "on the highway MIRROR has fewer collisions than NC and BC",
    ),
    (
        'h',
        "MIRROR-KL communicates several times more than MIRROR without significantly fewer collisions",
    ),
];

/// Sections that each claim is judged in.
fn judged_in(letter: char) -> &'static [&'static str] {
    match letter {
        'a' => &["fit-driving", "fit-search_rescue", "fit-bomb_defusal"],
        'b' | 'd' => &[
            "communicate-driving",
            "communicate-search_rescue",
            "communicate-bomb_defusal",
        ],
        'c' => &["communicate-driving", "communicate-bomb_defusal"],
        'e' => &["communicate-search_rescue"],
        'f' => &[
            "implants-driving",
            "implants-search_rescue",
            "implants-bomb_defusal",
        ],
        _ => &["drive"],
    }
}

/// Writes a study's section of `file` with the claims that it judged, and the overview of all claims.
///
/// # Errors
/// If the file cannot be read or written, or holds one of two markers without the other.
pub fn write_study(
    file: &Path,
    study: &str,
    title: &str,
    body: &str,
    claims: &[Claim],
) -> anyhow::Result<()> {
    // No comment ends within the JSON.
    let json = serde_json::to_string(claims)?.replace('>', "\\u003e");
    let body = format!(
        "{}\n\n<!-- mirror:{study} claims {json} -->",
        body.trim_end()
    );
    write_section(file, study, title, &body)?;
    write_overview(file)
}

/// Writes the overview anew from what stands in `file`.
///
/// # Errors
/// See [`write_study`].
pub fn write_overview(file: &Path) -> anyhow::Result<()> {
    let text = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
    let body = overview(&found(&text, file)?);
    if !text.contains("<!-- mirror:claims begin -->") {
        // Above the first section.
        let at = text.find("<!-- mirror:").unwrap_or(text.len());
        let markers = "<!-- mirror:claims begin -->\n<!-- mirror:claims end -->\n\n";
        let with = format!("{}{markers}{}", &text[..at], &text[at..]);
        replace(file, &with)?;
    }
    write_section(file, "claims", "The paper's claims", &body)
}

/// Every section's claims.
fn found(text: &str, file: &Path) -> anyhow::Result<BTreeMap<String, Vec<Claim>>> {
    let mut all = BTreeMap::new();
    for (number, line) in text.lines().enumerate() {
        let Some(rest) = line.strip_prefix("<!-- mirror:") else {
            continue;
        };
        let Some((study, json)) = rest.split_once(" claims ") else {
            continue;
        };
        let json = json.strip_suffix(" -->").unwrap_or(json);
        let claims = serde_json::from_str(json)
            .with_context(|| format!("{}:{}: claims of {study}", file.display(), number + 1))?;
        all.insert(study.to_owned(), claims);
    }
    Ok(all)
}

fn overview(found: &BTreeMap<String, Vec<Claim>>) -> String {
    let mut text = String::from(
        "Verdicts of the sections below, where the numbers and the rules stand. Over several sections: reproduced if it is in all, not if it is in none, else partly.\n\n\
         | | claim | verdict | by section |\n| --- | --- | --- | --- |",
    );
    for (letter, claim) in CLAIMS {
        let sections = judged_in(letter);
        let verdicts: Vec<(&str, Verdict)> = sections
            .iter()
            .filter_map(|section| {
                let claims = found.get(*section)?;
                let claim = claims.iter().find(|claim| claim.letter == letter)?;
                Some((*section, claim.verdict))
            })
            .collect();
        let all = |verdict| verdicts.iter().all(|(_, v)| *v == verdict);
        let verdict = match verdicts.len() {
            0 => "not run".to_owned(),
            _ => {
                let word = if all(Verdict::Reproduced) {
                    Verdict::Reproduced
                } else if all(Verdict::Not) {
                    Verdict::Not
                } else {
                    Verdict::Partly
                };
                let missing = sections.len() - verdicts.len();
                let rest = match missing {
                    0 => String::new(),
                    n => format!(" ({n} of {} sections not run)", sections.len()),
                };
                format!("**{}**{rest}", word.word())
            }
        };
        let by: Vec<String> = verdicts
            .iter()
            .map(|(section, verdict)| format!("{section}: {}", verdict.word()))
            .collect();
        let _ = write!(
            text,
            "\n| ({letter}) | {claim} | {verdict} | {} |",
            by.join(", ")
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(letter: char, verdict: Verdict) -> Claim {
        Claim {
            letter,
            claim: "x --> y".to_owned(),
            ours: "1 > 0".to_owned(),
            verdict,
        }
    }

    #[test]
    fn the_overview_follows_the_sections() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("RESULTS.md");
        write_section(&file, "real", "Real", "no claims here").expect("written");
        let row = |letter: char| -> String {
            let text = std::fs::read_to_string(&file).expect("there");
            let start = format!("| ({letter}) |");
            let line = text.lines().find(|line| line.starts_with(&start));
            line.expect("a row").to_owned()
        };
        let study = |name: &str, claims: &[Claim]| {
            write_study(&file, name, "Title", "body", claims).expect("written");
        };
        study("fit-driving", &[claim('a', Verdict::Reproduced)]);
        assert!(row('a').contains("**reproduced** (2 of 3 sections not run)"));
        assert!(row('g').contains("not run"));
        study("fit-search_rescue", &[claim('a', Verdict::Not)]);
        study("fit-bomb_defusal", &[claim('a', Verdict::Reproduced)]);
        assert!(row('a').contains("**partly**") && !row('a').contains("not run"));
        // What is judged again is told again; the overview stays at the top.
        study("fit-search_rescue", &[claim('a', Verdict::Reproduced)]);
        assert!(row('a').contains("**reproduced** |"), "{}", row('a'));
        study(
            "drive",
            &[claim('g', Verdict::Not), claim('h', Verdict::Partly)],
        );
        assert!(row('g').contains("**not**") && row('h').contains("**partly**"));
        let text = std::fs::read_to_string(&file).expect("there");
        assert!(text.find("## The paper's claims") < text.find("## Real"));
        assert_eq!(text.matches("mirror:claims begin").count(), 1);
        // Damage is told with its place.
        let bad = text.replace("[{\"letter\":\"g\"", "[{\"lettre\":\"g\"");
        std::fs::write(&file, bad).expect("written");
        let error = write_overview(&file).expect_err("damaged").to_string();
        assert!(
            error.contains("RESULTS.md:") && error.contains("drive"),
            "{error}"
        );
    }
}
