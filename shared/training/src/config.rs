//! Settings of every learner, from TOML: what ships ([`models::config`]), and a user's file over it.
//!
//! A file may hold any part of what ships; what it does not say stays as it is. A key that nobody knows, and a value of another
//! sort, are refused with file, line and column.

use crate::cloning::CloningSettings;
use crate::implants::ImplantSettings;
use crate::self_model::SelfModelSettings;
use crate::sqil::SqilSettings;
use domains::Layout;
use models::Sizes;
use models::config::{Network, shipped};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use thiserror::Error;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

/// All settings of a domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Networks of the self-model.
    pub network: Network,
    /// How the self-model is learned.
    pub self_model: SelfModelSettings,
    /// How implants are.
    pub implants: ImplantSettings,
    /// The recurrent policies of behavioural cloning and soft-Q imitation.
    pub policy: PolicySettings,
    /// Behavioural cloning.
    pub cloning: CloningSettings,
    /// Soft-Q imitation.
    pub sqil: SqilSettings,
}

/// The recurrent policies of behavioural cloning and soft-Q imitation: their networks, and what both learn from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicySettings {
    /// Features of h.
    pub hidden: usize,
    /// Neurons of each hidden dense layer.
    pub dense: usize,
    /// Rounds of an expert who sees everything, in the original setting, that are learned from beside the person's own.
    pub expert_rounds: u32,
}

impl Checked for PolicySettings {
    fn problem(&self) -> Option<String> {
        (!(1..=1024).contains(&self.hidden)
            || !(1..=4096).contains(&self.dense)
            || self.expert_rounds > 10_000)
            .then(|| {
                "hidden from 1 to 1024; dense from 1 to 4096; expert_rounds at most 10000"
                    .to_owned()
            })
    }
}

/// What a configuration says of recurrent policies.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Policies {
    /// Networks and expert.
    pub policy: PolicySettings,
    /// Behavioural cloning.
    pub cloning: CloningSettings,
    /// Soft-Q imitation.
    pub sqil: SqilSettings,
}

/// A configuration could not be used.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// It could not be read.
    #[error("{}: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// It is no TOML, or says something that no learner understands.
    #[error("{}:{line}:{column}: {message}", file.display())]
    Parse {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column in characters, from 1.
        column: usize,
        /// What is wrong there.
        message: String,
    },
    /// Its values make no sense together.
    #[error("{}: [{table}]: {problem}", file.display())]
    Problem {
        /// The file.
        file: PathBuf,
        /// The table.
        table: &'static str,
        /// What is wrong.
        problem: String,
    },
}

/// What a learner's settings can say of themselves.
pub trait Checked {
    /// A reason why these settings make no sense, if there is one.
    fn problem(&self) -> Option<String>;
}

impl Config {
    /// What ships for `domain`, with what `file` says instead.
    ///
    /// # Errors
    /// Names the file and the place in it.
    pub fn load(domain: &str, file: Option<&Path>) -> Result<Self, ConfigError> {
        let Some(file) = file else {
            return Ok(Self::shipped(domain));
        };
        let bytes = std::fs::read(file).map_err(|source| ConfigError::Read {
            file: file.to_owned(),
            source,
        })?;
        let text = String::from_utf8(bytes).map_err(|error| {
            let valid = error.utf8_error().valid_up_to();
            let before = String::from_utf8_lossy(&error.as_bytes()[..valid]).into_owned();
            at(file, &before, valid, "not UTF-8 text".to_owned())
        })?;
        let config: Self = merged(domain, file, &text)?;
        config.check(file)?;
        Ok(config)
    }

    /// What ships for a domain.
    ///
    /// # Panics
    /// If none does.
    pub fn shipped(domain: &str) -> Self {
        of_shipped(domain)
    }

    fn check(&self, file: &Path) -> Result<(), ConfigError> {
        let checks: [(&str, Option<String>); 5] = [
            ("self_model", self.self_model.problem()),
            ("implants", self.implants.problem()),
            ("policy", self.policy.problem()),
            ("cloning", self.cloning.problem()),
            ("sqil", self.sqil.problem()),
        ];
        for (table, problem) in checks {
            if let Some(problem) = problem {
                return Err(ConfigError::Problem {
                    file: file.to_owned(),
                    table,
                    problem,
                });
            }
        }
        Ok(())
    }

    /// Sizes of the self-model over a domain's observations; `file` is where these settings come from.
    ///
    /// # Errors
    /// Names the file and the size that makes no sense.
    pub fn sizes(&self, layout: &Layout, file: Option<&Path>) -> Result<Sizes, ConfigError> {
        let sizes = self.network.sizes(layout);
        sizes.map_err(|error| ConfigError::Problem {
            file: file
                .unwrap_or(Path::new(shipped(layout.domain).0))
                .to_owned(),
            table: "network",
            problem: error.to_string(),
        })
    }

    /// As TOML that [`Self::load`] reads back as the same. Seeds are no part of it.
    pub fn to_toml(&self) -> String {
        let mut all = Table::try_from(self).unwrap_or_default();
        for (_, table) in &mut all {
            if let Value::Table(table) = table {
                table.remove("seed");
            }
        }
        all.to_string()
    }
}

fn of_shipped<T: DeserializeOwned>(domain: &str) -> T {
    let (name, text) = shipped(domain);
    // Every file that ships is read by a test.
    toml::from_str(text).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// What ships of the self-model's training for a domain.
pub fn self_model(domain: &str) -> SelfModelSettings {
    #[derive(Deserialize)]
    struct Part {
        self_model: SelfModelSettings,
    }
    of_shipped::<Part>(domain).self_model
}

/// What ships of recurrent policies for a domain.
pub fn policies(domain: &str) -> Policies {
    of_shipped(domain)
}

/// What is wrong at byte `start` of a file's text.
fn at(file: &Path, text: &str, start: usize, message: String) -> ConfigError {
    let mut end = start.min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    let before = &text[..end];
    ConfigError::Parse {
        file: file.to_owned(),
        line: before.matches('\n').count() + 1,
        column: before.rsplit('\n').next().unwrap_or("").chars().count() + 1,
        message,
    }
}

fn merged<T: DeserializeOwned>(domain: &str, file: &Path, text: &str) -> Result<T, ConfigError> {
    let at = |start: usize, message: String| at(file, text, start, message);
    let said = DeTable::parse(text).map_err(|error| {
        let start = error.span().map_or(0, |span| span.start);
        at(start, error.message().to_owned())
    })?;
    let (name, base) = shipped(domain);
    let mut all: Table = base.parse().unwrap_or_else(|e| panic!("{name}: {e}"));
    overlay(said.get_ref(), &mut all).map_err(|(start, message)| at(start, message))?;
    all.try_into::<T>()
        .map_err(|error: toml::de::Error| at(0, error.message().to_owned()))
}

/// Writes what a file says over what ships; where in the text it says something that cannot be meant.
fn overlay(said: &DeTable<'_>, all: &mut Table) -> Result<(), (usize, String)> {
    for (key, value) in said.iter() {
        let name: &str = key.get_ref();
        let Some(known) = all.get_mut(name) else {
            let known: Vec<_> = all.keys().map(String::as_str).collect();
            let message = format!("unknown key `{name}`; there are {}", known.join(", "));
            return Err((key.span().start, message));
        };
        replace(name, value, known)?;
    }
    Ok(())
}

fn replace(
    name: &str,
    said: &Spanned<DeValue<'_>>,
    known: &mut Value,
) -> Result<(), (usize, String)> {
    let wrong = |expected: &str| {
        let message = format!(
            "`{name}` is {}, expected {expected}",
            said.get_ref().type_str()
        );
        Err((said.span().start, message))
    };
    let number = |value: &DeValue<'_>| -> Option<f64> {
        match value {
            DeValue::Float(x) => x.as_str().replace('_', "").parse().ok(),
            DeValue::Integer(x) => i64::from_str_radix(x.as_str(), x.radix())
                .ok()
                .map(|x| x as f64),
            _ => None,
        }
    };
    match (known, said.get_ref()) {
        (Value::Table(known), DeValue::Table(said)) => return overlay(said, known),
        (Value::Float(known), said) => match number(said) {
            Some(x) if (x as f32).is_finite() => *known = x,
            _ => return wrong("a finite number"),
        },
        (Value::Integer(known), DeValue::Integer(x)) => {
            match i64::from_str_radix(x.as_str(), x.radix()) {
                Ok(x) if (0..=u32::MAX.into()).contains(&x) => *known = x,
                _ => return wrong("a whole number from 0 to 4294967295"),
            }
        }
        (Value::Boolean(known), DeValue::Boolean(x)) => *known = *x,
        (Value::Array(known), DeValue::Array(said_values)) => {
            if said_values.len() != known.len() {
                return wrong(&format!("{} numbers", known.len()));
            }
            for (known, said) in known.iter_mut().zip(said_values.iter()) {
                replace(name, said, known)?;
            }
        }
        (Value::Table(_), _) => return wrong("a table"),
        (Value::Integer(_), _) => return wrong("a whole number"),
        (Value::Boolean(_), _) => return wrong("true or false"),
        (Value::Array(_), _) => return wrong("an array"),
        (Value::String(_) | Value::Datetime(_), _) => return wrong("a number"),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn file(text: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let path = folder.path().join("mine.toml");
        std::fs::write(&path, text).expect("written");
        (folder, path)
    }

    #[test]
    fn what_ships_is_sound_and_printing_it_gives_it_back() {
        let highway = Config::shipped("highway");
        assert!(highway.check(Path::new("highway")).is_ok());
        let (_folder, path) = file(&highway.to_toml());
        let back = Config::load("highway", Some(&path)).expect("read back");
        assert_eq!(back, highway);
        for domain in ["driving", "search_rescue", "bomb_defusal"] {
            let config = Config::shipped(domain);
            assert!(config.check(Path::new(domain)).is_ok());
            let (_folder, path) = file(&config.to_toml());
            let back = Config::load(domain, Some(&path)).expect("read back");
            assert_eq!(back, config);
        }
    }

    #[test]
    fn a_part_of_a_file_changes_that_part() {
        let (_folder, path) = file("[network]\nlatent = 32\n[sqil]\nlearning_rate = 1\n");
        let config = Config::load("driving", Some(&path)).expect("read");
        assert_eq!(
            (config.network.latent, config.sqil.learning_rate),
            (32, 1.0)
        );
        let mut expected = Config::shipped("driving");
        expected.network.latent = 32;
        expected.sqil.learning_rate = 1.0;
        assert_eq!(config, expected);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_place() {
        for (text, place, word) in [
            (
                "[implants]\n  lerning_rate = 1\n",
                ":2:3:",
                "`lerning_rate`",
            ),
            ("[networks]\n", ":1:2:", "`networks`"),
            ("[sqil]\nrounds = \"x\"\n", ":2:10:", "string"),
            ("[sqil]\nrounds = -1\n", ":2:10:", "from 0 to"),
            ("[sqil]\nrounds = 4294967296\n", ":2:10:", "from 0 to"),
            ("[sqil]\nlearning_rate = 1e39\n", ":2:17:", "finite"),
            ("[sqil]\nlearning_rate = nan\n", ":2:17:", "finite"),
            ("[cloning]\nlayers = [1, 2]\n", ":2:10:", "3 numbers"),
            ("[cloning\n", ":1:9:", ""),
            (
                "[self_model]\nlength = 1\n",
                "mine.toml: [self_model]",
                "length",
            ),
            ("network = 3\n", ":1:11:", "a table"),
        ] {
            let (_folder, path) = file(text);
            let error = Config::load("driving", Some(&path)).expect_err(text);
            let error = error.to_string();
            let named = ["mine.toml", place, word].iter().all(|s| error.contains(s));
            assert!(named, "{text:?}: {error}");
        }
    }

    #[test]
    fn bytes_that_are_no_text_are_named_with_their_place() {
        let (_folder, path) = file("");
        std::fs::write(&path, b"[sqil]\nrounds = \xff").expect("written");
        let error = Config::load("highway", Some(&path)).expect_err("no text");
        assert!(
            error.to_string().contains("mine.toml:2:10: not UTF-8"),
            "{error}"
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

        /// Whatever stands in a file, it is read or refused.
        #[test]
        fn no_file_panics(text in "[\\[\\]a-z_=0-9.\\-\"\n ]{0,60}") {
            let (_folder, path) = file(&text);
            let _ = Config::load("bomb_defusal", Some(&path));
            let _ = Config::load("highway", Some(&path));
        }
    }
}
