//! `RESULTS.md`: one file, in which every study owns the section between its two markers and leaves the rest alone.
//!
//! ```text
//! <!-- mirror:drive begin -->
//! …
//! <!-- mirror:drive end -->
//! ```

use crate::statistics::Interval;
use crate::table::replace;
use anyhow::{Context, ensure};
use std::fmt::Write;
use std::path::{Component, Path, PathBuf};

/// What became of a claim of the paper's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// It holds here too.
    Reproduced,
    /// A part of it does, or the data cannot tell.
    Partly,
    /// It does not.
    Not,
}

impl Verdict {
    /// As it is written.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Reproduced => "reproduced",
            Self::Partly => "partly",
            Self::Not => "not",
        }
    }

    /// Reproduced if all of them hold, partly if some do.
    pub fn of(parts: &[bool]) -> Self {
        match parts.iter().filter(|holds| **holds).count() {
            0 => Self::Not,
            n if n == parts.len() => Self::Reproduced,
            _ => Self::Partly,
        }
    }
}

/// A claim of the paper's with our answer.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Claim {
    /// Its letter in the list of claims.
    pub letter: char,
    /// The claim.
    pub claim: String,
    /// Our numbers with their intervals, and by what rule they were judged.
    pub ours: String,
    /// The answer.
    pub verdict: Verdict,
}

/// What was found, after the rule by which it is judged.
pub fn ruled(rule: &str, found: &str) -> String {
    format!(
        "Rule: {rule}. Found: {}",
        found.trim_end_matches([';', ',', ' '])
    )
}

/// Claims as a table.
pub fn claims_table(claims: &[Claim]) -> String {
    let mut text = String::from("| | claim | ours | |\n| --- | --- | --- | --- |\n");
    for claim in claims {
        let Claim {
            letter,
            claim,
            ours,
            verdict,
        } = claim;
        // A claim is one line of the table.
        let _ = writeln!(
            text,
            "| ({letter}) | {claim} | {ours} | **{}** |",
            verdict.word()
        );
    }
    text
}

/// `mean [low, high]`, each times `factor`.
pub fn with_interval(interval: &Interval, factor: f64, decimals: usize) -> String {
    let Interval { mean, low, high } = interval;
    format!(
        "{:.decimals$} [{:.decimals$}, {:.decimals$}]",
        mean * factor,
        low * factor,
        high * factor
    )
}

/// A probability, as small ones are written.
pub fn probability(p: f64) -> String {
    if p < 0.001 {
        "p < 0.001".to_owned()
    } else {
        format!("p = {p:.3}")
    }
}

/// Puts `body` (Markdown, headed by `## title`) into the study's section of `file`, which is made if it is not there.
/// Everything outside the section stays as it is. A section that is new comes last.
///
/// # Errors
/// If the file cannot be read or written, or holds one of the markers without the other.
pub fn write_section(file: &Path, study: &str, title: &str, body: &str) -> anyhow::Result<()> {
    let (begin, end) = (
        format!("<!-- mirror:{study} begin -->"),
        format!("<!-- mirror:{study} end -->"),
    );
    files::check_regular(file)?;
    let before = match std::fs::read_to_string(file) {
        Ok(text) => text,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => HEAD.to_owned(),
        Err(e) => return Err(e).with_context(|| file.display().to_string()),
    };
    let section = format!("{begin}\n## {title}\n\n{}\n{end}", body.trim_end());
    let text = match (before.find(&begin), before.find(&end)) {
        (Some(from), Some(to)) if from < to => {
            format!("{}{section}{}", &before[..from], &before[to + end.len()..])
        }
        (None, None) => format!("{}\n\n{section}\n", before.trim_end()),
        _ => {
            ensure!(
                false,
                "{}: one of {begin} and {end} is missing, or they stand in the wrong order",
                file.display()
            );
            before
        }
    };
    replace(file, &text)
}

const HEAD: &str = "# Results\n\nEach section is written by the command that it names; what stands outside the markers is not. \
Intervals are 95 %. Nothing about the simulated people was changed after these results were seen.\n";

/// How `to` is reached from the folder of `file`, for links; absolute where there is no common way.
pub fn link(file: &Path, to: &Path) -> String {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let (file, to) = (absolute(file), absolute(to));
    let folder: Vec<Component> = file
        .parent()
        .map_or(Vec::new(), |p| p.components().collect());
    let target: Vec<Component> = to.components().collect();
    let common = folder
        .iter()
        .zip(&target)
        .take_while(|(a, b)| a == b)
        .count();
    let mut path = PathBuf::new();
    for _ in common..folder.len() {
        path.push("..");
    }
    path.extend(&target[common..]);
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_study_owns_its_section_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("RESULTS.md");
        write_section(&file, "drive", "Drive", "one").expect("written");
        write_section(&file, "real", "Real", "two").expect("written");
        let mut text = std::fs::read_to_string(&file).expect("there");
        text.push_str("\nA note by hand.\n");
        std::fs::write(&file, &text).expect("written");
        write_section(&file, "drive", "Drive", "three\n").expect("written");
        let now = std::fs::read_to_string(&file).expect("there");
        assert_eq!(now, text.replace("one", "three"));
        assert!(now.find("## Drive").expect("a head") < now.find("## Real").expect("a head"));
        // Twice the same changes nothing.
        write_section(&file, "drive", "Drive", "three").expect("written");
        assert_eq!(std::fs::read_to_string(&file).expect("there"), now);
        std::fs::write(&file, now.replace("<!-- mirror:drive end -->", "")).expect("written");
        let error = write_section(&file, "drive", "Drive", "four").expect_err("half a section");
        assert!(error.to_string().contains("RESULTS.md"), "{error}");
    }

    #[test]
    fn links_lead_from_file_to_plot() {
        let at = |file: &str, to: &str| link(Path::new(file), Path::new(to));
        assert_eq!(at("/a/RESULTS.md", "/a/docs/x.svg"), "docs/x.svg");
        assert_eq!(at("/a/b/RESULTS.md", "/a/x.svg"), "../x.svg");
        assert_eq!(at("/a/RESULTS.md", "/a/x.svg"), "x.svg");
    }

    #[test]
    fn a_verdict_counts_its_parts() {
        assert_eq!(Verdict::of(&[true, true]), Verdict::Reproduced);
        assert_eq!(Verdict::of(&[true, false]), Verdict::Partly);
        assert_eq!(Verdict::of(&[false, false]), Verdict::Not);
    }
}
