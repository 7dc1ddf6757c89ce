//! Policies of one person, `bc` and `sqil`, from their demonstrations and an expert's in clear weather: one call for both.

use crate::cloning::{self, CloningError};
use crate::config::HighwayConfig;
use crate::demonstrations::Demonstrations;
use crate::lessons::{self, Lesson};
use crate::sqil::{self, Lived, Place};
use domains::highway::AZIMUTHS;
use domains::highway::{FileError, Scene, road::RoadError};
use models::utterances::UtteranceTable;
use models::{Kind, PersonalPolicy};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use thiserror::Error;

/// Seed of the expert's rounds, which are the same for everybody.
pub const EXPERT_SEED: u64 = 0x6578_7065;

/// The expert's demonstrations in clear weather, recorded when first asked for.
#[derive(Default)]
pub struct Expert {
    lessons: OnceLock<Vec<Lesson>>,
}

impl Expert {
    /// The rounds.
    ///
    /// # Errors
    /// If the scene or the utterances cannot be read.
    pub fn lessons(&self) -> Result<&[Lesson], PolicyError> {
        if let Some(lessons) = self.lessons.get() {
            return Ok(lessons);
        }
        let table = UtteranceTable::shipped().map_err(PolicyError::Utterances)?;
        let rounds = cloning::Settings::default().expert_rounds;
        let lessons = lessons::of_expert(clear()?, &table, EXPERT_SEED, rounds)?;
        // Whoever else recorded them meanwhile recorded the same.
        Ok(self.lessons.get_or_init(|| lessons))
    }
}

fn clear() -> Result<Arc<Scene>, PolicyError> {
    Ok(Arc::new(Scene::builtin("highway-clear")?))
}

/// A policy could not be learned.
#[derive(Debug, Error)]
pub enum PolicyError {
    /// The demonstrations do not suffice.
    #[error(transparent)]
    Demonstrations(#[from] CloningError),
    /// The expert's scene cannot be read.
    #[error(transparent)]
    Scene(#[from] FileError),
    /// Its road cannot be built.
    #[error(transparent)]
    Road(#[from] RoadError),
    /// The utterances cannot be read.
    #[error(transparent)]
    Utterances(models::utterances::TableError),
    /// The kind of human model is no policy.
    #[error("a human model of kind `{0}` is no policy of its own")]
    NoPolicy(&'static str),
}

/// A learned policy.
#[derive(Clone, Debug)]
pub struct Learned {
    /// The networks, and what the person sees, as the demonstrations say.
    pub person: PersonalPolicy,
    /// How learning went, in words.
    pub about: String,
}

/// Learns a policy of `kind`, with the settings of `config`. `progress` hears of (done, at most, a word).
///
/// # Errors
/// [`PolicyError`].
pub fn learn(
    kind: Kind,
    demonstrations: &Demonstrations,
    expert: &Expert,
    config: &HighwayConfig,
    seed: u64,
    progress: &(dyn Fn(u64, u64, &str) + Sync),
) -> Result<Learned, PolicyError> {
    let visible_m = demonstrations
        .visible_m
        .ok_or(CloningError::Unseen(kind.name()))?;
    let own = || {
        let rounds = demonstrations.rounds.iter();
        rounds.map(|round| lessons::of_round(round, &visible_m))
    };
    let (policy, about) = match kind {
        Kind::Bc => {
            let settings = cloning::Settings {
                seed,
                ..config.cloning
            };
            let most = (settings.epochs * settings.layers.len()) as u64;
            let passes = AtomicU64::new(0);
            let learned = cloning::learn(
                own().collect(),
                expert.lessons()?.to_vec(),
                &settings,
                &|layers, _, nll| {
                    let pass = passes.fetch_add(1, Ordering::Relaxed) + 1;
                    progress(pass, most, &format!("{layers} layers, validation {nll:.3}"));
                },
            )?;
            let trials: Vec<String> = learned
                .trials
                .iter()
                .map(|t| {
                    let (epoch, epochs) = (t.epoch, t.epochs);
                    format!(
                        "{} layers {:.3} (pass {epoch} of {epochs})",
                        t.layers, t.validation
                    )
                })
                .collect();
            let about = format!(
                "validation: {}; kept {} layers",
                trials.join(", "),
                learned.best.layers
            );
            (learned.policy, about)
        }
        Kind::Sqil => {
            let settings = sqil::Settings {
                seed,
                ..config.sqil
            };
            let expert = expert.lessons()?.iter().map(|lesson| Lived {
                lesson: lesson.clone(),
                collided: false,
            });
            let mut demonstrated: Vec<Lived> = own()
                .zip(&demonstrations.rounds)
                .map(|(lesson, round)| Lived {
                    lesson,
                    collided: round.collided,
                })
                .chain(expert)
                .collect();
            demonstrated.retain(|lived| lived.lesson.steps() >= settings.window);
            // What the person sees is what makes fog: the traffic is the same.
            let place = |visible_m, words| -> Result<Place, PolicyError> {
                Ok(Place {
                    scene: clear()?,
                    visible_m,
                    words,
                })
            };
            let places = [
                place([f32::INFINITY; AZIMUTHS], true)?,
                place(visible_m, false)?,
            ];
            let table = UtteranceTable::shipped().map_err(PolicyError::Utterances)?;
            let most = settings.episodes as u64;
            let mut last = sqil::Metrics::default();
            let policy = sqil::learn(
                &demonstrated,
                &places,
                &table,
                &settings,
                &mut |episode, metrics| {
                    last = metrics;
                    let word = format!("Q of people less that of its own {:.3}", metrics.advantage);
                    progress(episode as u64, most, &word);
                },
            )?;
            let steps = settings.episodes * settings.gradient_steps;
            let about = format!(
                "{} episodes, {steps} gradient steps, last L_Q {:.3}",
                settings.episodes, last.critic
            );
            (policy, about)
        }
        _ => return Err(PolicyError::NoPolicy(kind.name())),
    };
    Ok(Learned {
        person: PersonalPolicy {
            policy,
            limits: visible_m.to_vec(),
            heard: 0,
        },
        about,
    })
}
