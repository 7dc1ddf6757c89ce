//! Human models of one person, learned from their rounds: one call for every kind and domain.

use crate::cloning::{self, CloningSettings, NothingToClone};
use crate::config::Config;
use crate::environment::{self, EnvironmentError};
use crate::implants::{self, ImplantError, ImplantSettings};
use crate::rounds::{Round, Rounds};
use crate::sqil::{self, Place, SqilSettings};
use crate::trajectory::{Trajectory, hold_out};
use domains::Layout;
use domains::discrete::Setting;
use models::{
    HumanModel, Kind, PersonalPolicy, Posterior, RecurrentSizes, SelfHuman, SelfModel, SizesError,
    View,
};
use nn::checkpoint::CheckpointError;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use thiserror::Error;

/// Seed of the expert's rounds, which are the same for everybody.
const EXPERT_SEED: u64 = 0x6578_7065;
/// Steps after which an expert's round is cut.
const EXPERT_STEPS: usize = 400;

/// What there is to learn from.
#[derive(Clone, Copy, Debug)]
pub struct Demonstrations<'a> {
    /// The person's rounds in the setting that the model is for.
    pub rounds: &'a Rounds,
    /// Their rounds in the original setting, where `rounds` are of the transfer setting: BC and SQIL learn from both (paper §IV-A).
    pub original: Option<&'a Rounds>,
    /// Rounds that say when BC and SQIL have learned enough; without them, a quarter of the others does.
    pub validation: Option<&'a Rounds>,
}

impl<'a> Demonstrations<'a> {
    /// Only a person's rounds.
    pub const fn of(rounds: &'a Rounds) -> Self {
        Self {
            rounds,
            original: None,
            validation: None,
        }
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
        /// What is known of them.
        posterior: Posterior,
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
    /// The rounds do not suffice for implants.
    #[error(transparent)]
    Implants(#[from] ImplantError),
    /// The rounds do not suffice for a policy.
    #[error(transparent)]
    Cloning(#[from] NothingToClone),
    /// BC and SQIL are told what the person could see, and the rounds do not say.
    #[error(
        "human model `{}` has to be told what the person can see, and the rounds do not say (tensor \"limits\")",
        .0.name()
    )]
    Unseen(Kind),
    /// Fewer rounds than learning and validation take.
    #[error("{found} round with a step in it: human model `{}` needs two, of which one says when to stop", .kind.name())]
    TooFew {
        /// Rounds.
        found: usize,
        /// Of which kind.
        kind: Kind,
    },
    /// The configuration has sizes that make no sense.
    #[error("[network] or [policy]: {0}")]
    Sizes(#[from] SizesError),
    /// The world that SQIL or an expert acts in cannot be made.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
}

/// Learns what `kind` takes. `progress` hears of (done, at most, a word).
///
/// # Errors
/// [`LearnError`].
pub fn learn(
    kind: Kind,
    model: &Arc<SelfModel>,
    demonstrations: &Demonstrations,
    config: &Config,
    seed: u64,
    progress: &(dyn Fn(u64, u64, &str) + Sync),
) -> Result<Learned, LearnError> {
    let rounds = demonstrations.rounds;
    let heard = rounds.heard;
    match kind {
        Kind::Myself => Ok(Learned::Nothing { heard }),
        Kind::Ideal => Err(LearnError::Own),
        Kind::Mirror | Kind::MirrorP => {
            let settings = ImplantSettings {
                seed,
                ..config.implants
            };
            let learned = implants::learn(model, kind, rounds, &settings, &mut |done, all| {
                progress(done as u64, all as u64, "hypotheses");
            })?;
            let (kept, tried) = (learned.posterior.weights.len(), learned.tried);
            Ok(Learned::Implants {
                posterior: learned.posterior,
                heard,
                about: format!(
                    "loss {:.4}; kept {kept} of {tried} hypotheses",
                    learned.loss
                ),
            })
        }
        Kind::Bc | Kind::Sqil => {
            policy(kind, &model.layout, demonstrations, config, seed, progress)
        }
    }
}

fn policy(
    kind: Kind,
    layout: &Layout,
    demonstrations: &Demonstrations,
    config: &Config,
    seed: u64,
    progress: &(dyn Fn(u64, u64, &str) + Sync),
) -> Result<Learned, LearnError> {
    let rounds = demonstrations.rounds;
    // What limits the person's sight there, and what they hear.
    let sight_of = |rounds: &Rounds| {
        let limits = rounds.limits.clone();
        limits
            .map(|limits| (limits, rounds.heard))
            .ok_or(LearnError::Unseen(kind))
    };
    let (limits, heard) = sight_of(rounds)?;
    let sizes = RecurrentSizes {
        model: config.network.sizes(layout)?,
        hidden: config.policy.hidden,
        dense: config.policy.dense,
        layers: 1,
    };
    if let Some(problem) = sizes.problem(layout) {
        return Err(SizesError(problem).into());
    }
    let mut own = perceived(kind, rounds)?;
    if let Some(original) = demonstrations.original {
        // One round of each in turn, so that every part of them holds both.
        own = by_turns(own, perceived(kind, original)?);
    }
    let expert_rounds = match config.policy.expert_rounds {
        0 => None,
        count => {
            let mut world = environment::shipped(layout.domain, Setting::Original)?;
            Some(Rounds::of_expert(
                &mut *world,
                EXPERT_SEED,
                count,
                EXPERT_STEPS,
            ))
        }
    };
    let expert = match &expert_rounds {
        None => Vec::new(),
        Some(rounds) => perceived(kind, rounds)?,
    };
    let held = demonstrations.validation;
    let held = held.map(|rounds| perceived(kind, rounds)).transpose()?;
    let held = held.filter(|held| !held.is_empty());
    let found = own.len();
    let stops = kind == Kind::Bc || config.sqil.patience > 0;
    if found + expert.len() == 0 {
        return Err(NothingToClone {
            learned: 0,
            validated: held.map_or(0, |held| held.len()),
        }
        .into());
    }
    let (mut train, held) = match held {
        Some(held) => (own, held),
        None if stops => hold_out(own),
        None => (own, Vec::new()),
    };
    // A single round says nothing of when to stop; the expert's have to.
    let (expert, held) = match stops && held.is_empty() {
        true => hold_out(expert),
        false => (expert, held),
    };
    if stops && held.is_empty() {
        return Err(LearnError::TooFew { found, kind });
    }
    train.extend(expert);
    let view = View::new(layout);
    let trajectory = |round: &Round| Trajectory::new(round, &view, layout.actions);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let told = train
        .iter()
        .filter(|(_, setting)| *setting == Setting::Original)
        .filter_map(|(round, _)| round.told_what_was_seen(layout, &mut rng));
    let told: Vec<Round> = told.collect();
    let train: Vec<Trajectory> = train
        .iter()
        .map(|(round, _)| *round)
        .chain(&told)
        .map(trajectory)
        .collect();
    let held: Vec<Trajectory> = held.iter().map(|(round, _)| trajectory(round)).collect();
    let (policy, about) = if kind == Kind::Bc {
        let settings = CloningSettings {
            seed,
            ..config.cloning
        };
        clone(layout, sizes, &train, &held, &settings, progress)?
    } else {
        let settings = SqilSettings {
            seed,
            ..config.sqil
        };
        let place = |setting, limits: &Vec<f32>, heard, words| -> Result<Place, LearnError> {
            Ok(Place {
                environment: environment::shipped(layout.domain, setting)?,
                limits: limits.clone(),
                heard,
                words,
            })
        };
        let mut places = vec![place(rounds.setting, &limits, heard, false)?];
        if let Some(original) = demonstrations.original {
            let (limits, heard) = sight_of(original)?;
            places.push(place(original.setting, &limits, heard, false)?);
        }
        if config.policy.expert_rounds > 0 {
            let everything = vec![f32::INFINITY; layout.perception.limits()];
            places.push(place(Setting::Original, &everything, 0, true)?);
        }
        imitate(&mut places, sizes, &train, &held, &settings, progress)
    };
    Ok(Learned::Policy {
        kind,
        person: PersonalPolicy {
            policy,
            limits,
            heard,
        },
        about,
    })
}

/// Rounds with a step in them, each with its setting, if what was perceived of them is known.
fn perceived(kind: Kind, rounds: &Rounds) -> Result<Vec<(&Round, Setting)>, LearnError> {
    let used = rounds.rounds.iter().filter(|round| !round.is_empty());
    used.map(|round| match round.perceived.len() == round.len() {
        true => Ok((round, rounds.setting)),
        false => Err(LearnError::Unseen(kind)),
    })
    .collect()
}

/// One of each in turn, and then what is left.
fn by_turns<T>(own: Vec<T>, others: Vec<T>) -> Vec<T> {
    let mut others = others.into_iter();
    let mut all = Vec::new();
    for round in own {
        all.push(round);
        all.extend(others.next());
    }
    all.extend(others);
    all
}

fn clone(
    layout: &Layout,
    sizes: RecurrentSizes,
    train: &[Trajectory],
    held: &[Trajectory],
    settings: &CloningSettings,
    progress: &(dyn Fn(u64, u64, &str) + Sync),
) -> Result<(models::RecurrentPolicy, String), LearnError> {
    let validations = settings.iterations / settings.every * settings.layers.len();
    let done = AtomicU64::new(0);
    let tell = |layers: usize, _: usize, nll: f32| {
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        let word = format!("{layers} layers, validation {nll:.3}");
        progress(done, validations as u64, &word);
    };
    let cloned = cloning::learn(layout, sizes, train, held, settings, &tell)?;
    let trials = cloned.trials.iter().map(|trial| {
        let (pass, passes) = (trial.iteration, trial.iterations);
        let (layers, nll) = (trial.layers, trial.validation);
        format!("{layers} layers {nll:.4} (pass {pass} of {passes})")
    });
    let trials: Vec<String> = trials.collect();
    let about = format!(
        "validation: {}; kept {} layers",
        trials.join(", "),
        cloned.best.layers
    );
    Ok((cloned.policy, about))
}

fn imitate(
    places: &mut [Place],
    sizes: RecurrentSizes,
    train: &[Trajectory],
    held: &[Trajectory],
    settings: &SqilSettings,
    progress: &(dyn Fn(u64, u64, &str) + Sync),
) -> (models::RecurrentPolicy, String) {
    let most = settings.phases as u64;
    let word = |progress: sqil::Progress| match progress.validation {
        Some(nll) => format!("validation {nll:.4}"),
        None => format!("last L_Q {:.4}", progress.loss),
    };
    let tell = |phase: usize, now: sqil::Progress| progress(phase as u64, most, &word(now));
    let imitated = sqil::learn(places, sizes, train, held, settings, &tell);
    let about = word(imitated.progress);
    (imitated.policy, about)
}

impl Learned {
    /// The human model, on the self-model that it was learned with.
    pub fn human(&self, model: &Arc<SelfModel>) -> Box<dyn HumanModel> {
        match self {
            Self::Nothing { heard } => Box::new(SelfHuman::new(Arc::clone(model), None, *heard)),
            Self::Implants {
                posterior, heard, ..
            } => Box::new(SelfHuman::new(
                Arc::clone(model),
                Some(posterior.clone()),
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
                posterior, heard, ..
            } => posterior.save(path, model, *heard, command),
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
