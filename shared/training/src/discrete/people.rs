//! Human models of one person in a gridworld, learned from their rounds: one call for every kind.

use super::cloning;
use super::implants;
use super::rounds::Rounds;
use super::sqil;
use crate::config::{self, GridworldConfig};
use domains::Layout;
use domains::discrete::{Domain, Scene, Setting, WordsError, World};
use models::words::{TableError, shipped};
use models::{
    HumanModel, Implants, Kind, PersonalPolicy, RecurrentSizes, SelfHuman, SelfModel, SizesError,
};
use nn::checkpoint::CheckpointError;
use std::path::Path;
use std::sync::Arc;
use thiserror::Error;

/// What there is to learn from.
#[derive(Clone, Copy, Debug)]
pub struct Lessons<'a> {
    /// The person's rounds in the setting that the model is for.
    pub rounds: &'a Rounds,
    /// Their rounds in the original setting, where `rounds` are of the transfer setting: BC and SQIL learn from both (paper §IV-A).
    pub original: Option<&'a Rounds>,
    /// Rounds that say when BC and SQIL have learned enough; without them, every fifth of the others does.
    pub validation: Option<&'a Rounds>,
    /// Most phases of soft-Q imitation; as many as the configuration says by default.
    pub sqil_phases: Option<usize>,
    /// Settings other than what ships.
    pub config: Option<&'a GridworldConfig>,
}

impl Lessons<'_> {
    fn config(&self, layout: &Layout) -> GridworldConfig {
        self.config
            .cloned()
            .unwrap_or_else(|| config::gridworld(layout.domain))
    }
}

/// What was learned.
#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "there is one, and it is moved once"
)]
pub enum Learned {
    /// The self-model stays as it is.
    Nothing {
        /// Utterances that the person hears without an assistant.
        heard: u32,
    },
    /// `mirror` and `mirror-p`.
    Implants {
        /// The implants.
        implants: Implants,
        /// Utterances that the person hears without an assistant.
        heard: u32,
        /// How learning went, in words.
        about: String,
    },
    /// `bc` and `sqil`.
    Policy {
        /// Which.
        kind: Kind,
        /// The networks, and what the person perceives.
        person: PersonalPolicy,
        /// How learning went, in words.
        about: String,
    },
}

/// A person could not be learned.
#[derive(Debug, Error)]
pub enum LearnError {
    /// The ideal model is the person's own.
    #[error("human model `ideal` is the simulated person's own and learns nothing")]
    Own,
    /// There are no rounds.
    #[error(transparent)]
    Empty(#[from] implants::NothingToLearn),
    /// BC and SQIL are told what the person can see, and the rounds do not say.
    #[error(
        "human model `{}` has to be told what the person can see, and the rounds do not say (tensor \"limits\")",
        .0.name()
    )]
    Unseen(Kind),
    /// Fewer rounds than learning and validation take.
    #[error("{found} rounds with a step in them: human model `{}` needs five, of which one says when to stop", .kind.name())]
    TooFew {
        /// Rounds.
        found: usize,
        /// Of which kind.
        kind: Kind,
    },
    /// SQIL acts in a world, and the domain has none here.
    #[error("domain `{0}` has no world of its own for soft-Q imitation to act in")]
    NoWorld(&'static str),
    /// The configuration has sizes that make no sense.
    #[error("[network] or [policy]: {0}")]
    Sizes(#[from] SizesError),
    /// The world that SQIL acts in cannot be made.
    #[error(transparent)]
    Table(#[from] TableError),
    /// See [`LearnError::Table`].
    #[error(transparent)]
    Words(#[from] WordsError),
}

/// Learns what `kind` takes. `progress` hears of (done, at most, a word).
///
/// # Errors
/// [`LearnError`].
pub fn learn(
    kind: Kind,
    model: &SelfModel,
    lessons: &Lessons,
    seed: u64,
    progress: &mut dyn FnMut(u64, u64, &str),
) -> Result<Learned, LearnError> {
    let rounds = lessons.rounds;
    let heard = rounds.heard;
    match kind {
        Kind::Myself => Ok(Learned::Nothing { heard }),
        Kind::Ideal => Err(LearnError::Own),
        Kind::Mirror | Kind::MirrorP => {
            let settings = implants::Settings {
                seed,
                ..lessons.config(&model.layout).implants
            };
            let most = settings.all_iterations(model) as u64;
            let with_policy = kind == Kind::Mirror;
            let learned =
                implants::learn(model, with_policy, rounds, &settings, &mut |done, loss| {
                    progress(done as u64, most, &format!("loss {loss:.4}"));
                })?;
            Ok(Learned::Implants {
                about: format!("last loss {:.4}", learned.loss),
                implants: learned.implants,
                heard,
            })
        }
        Kind::Bc | Kind::Sqil => policy(kind, model, lessons, seed, progress),
    }
}

fn policy(
    kind: Kind,
    model: &SelfModel,
    lessons: &Lessons,
    seed: u64,
    progress: &mut dyn FnMut(u64, u64, &str),
) -> Result<Learned, LearnError> {
    let layout = &model.layout;
    let rounds = lessons.rounds;
    // What limits the person's sight there, and what they hear.
    let sight_of = |rounds: &Rounds| {
        let limits = rounds.limits.clone();
        limits
            .map(|limits| (limits, rounds.heard))
            .ok_or(LearnError::Unseen(kind))
    };
    let sight = sight_of(rounds)?;
    let mut places = vec![(world_of(rounds)?, sight.clone())];
    let mut all = rounds.clone();
    if let Some(original) = lessons.original {
        // One round of each in turn, so that every part of them holds both.
        let mut others = original.rounds.iter().cloned();
        let own = std::mem::take(&mut all.rounds);
        for round in own {
            all.rounds.push(round);
            all.rounds.extend(others.next());
        }
        all.rounds.extend(others);
        places.push((world_of(original)?, sight_of(original)?));
    }
    if all.steps() == 0 {
        return Err(implants::NothingToLearn.into());
    }
    let none = Rounds::new(layout, rounds.setting, rounds.heard);
    let validation = lessons.validation.unwrap_or(&none);
    let found = all.rounds.iter().filter(|round| !round.is_empty()).count();
    if validation.steps() == 0 && found < 5 {
        return Err(LearnError::TooFew { found, kind });
    }
    let config = lessons.config(layout);
    let network = config.policy;
    let network = network.unwrap_or_else(|| models::config::policy(layout.domain));
    let sizes = RecurrentSizes {
        model: config.network.sizes(layout)?,
        hidden: network.hidden,
        dense: network.dense,
        layers: 1,
    };
    if let Some(problem) = sizes.problem(layout) {
        return Err(SizesError(problem).into());
    }
    let (policy, about) = if kind == Kind::Bc {
        let settings = cloning::Settings {
            seed,
            ..config.cloning
        };
        let cloned = cloning::learn(layout, sizes, &all, validation, &settings);
        let tried: Vec<String> = cloned
            .tried
            .iter()
            .map(|(layers, nll)| format!("{layers} layers {nll:.4}"))
            .collect();
        let about = format!(
            "validation: {}; kept {} layers",
            tried.join(", "),
            cloned.policy.sizes.layers
        );
        (cloned.policy, about)
    } else {
        let default = config.sqil;
        let settings = sqil::Settings {
            seed,
            phases: lessons.sqil_phases.unwrap_or(default.phases),
            ..default
        };
        let most = settings.phases as u64;
        let imitated = sqil::learn(
            places,
            sizes,
            &all,
            validation,
            &settings,
            &mut |phase, nll| {
                progress(phase as u64, most, &format!("validation {nll:.4}"));
            },
        );
        (
            imitated.policy,
            format!("validation {:.4}", imitated.validation),
        )
    };
    Ok(Learned::Policy {
        kind,
        person: PersonalPolicy {
            policy,
            limits: sight.0,
            heard: sight.1,
        },
        about,
    })
}

/// The default world of the setting that rounds were played in.
fn world_of(rounds: &Rounds) -> Result<World, LearnError> {
    let domain = Domain::from_name(rounds.domain).ok_or(LearnError::NoWorld(rounds.domain))?;
    let words = shipped(domain)?;
    let scene = Scene::of(domain, rounds.setting);
    Ok(World::new(&scene, &words)?)
}

impl Learned {
    /// The human model, on the self-model that it was learned with.
    pub fn human(&self, model: &Arc<SelfModel>) -> Box<dyn HumanModel> {
        match self {
            Self::Nothing { heard } => Box::new(SelfHuman::new(Arc::clone(model), None, *heard)),
            Self::Implants {
                implants, heard, ..
            } => Box::new(SelfHuman::new(
                Arc::clone(model),
                Some(implants.clone()),
                *heard,
            )),
            Self::Policy { kind, person, .. } => {
                Box::new(person.clone().human(*kind, &model.layout))
            }
        }
    }

    /// How learning went, in words.
    pub fn about(&self) -> &str {
        match self {
            Self::Nothing { .. } => "nothing to learn",
            Self::Implants { about, .. } | Self::Policy { about, .. } => about,
        }
    }

    /// Writes what was learned; nothing for `self`. `command` is how it was made.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(
        &self,
        path: &Path,
        model: &SelfModel,
        command: &str,
    ) -> Result<(), CheckpointError> {
        match self {
            Self::Nothing { .. } => Ok(()),
            Self::Implants {
                implants, heard, ..
            } => implants.save(path, model, *heard, command),
            Self::Policy {
                kind,
                person,
                about,
            } => {
                let notes = [("mirror.learning", about.clone())];
                person.save(path, *kind, &model.layout, command, &notes)
            }
        }
    }
}

/// Whether BC and SQIL learn from rounds of the original setting too.
pub fn wants_original(kind: Kind, setting: Setting) -> bool {
    matches!(kind, Kind::Bc | Kind::Sqil) && setting == Setting::Transfer
}
