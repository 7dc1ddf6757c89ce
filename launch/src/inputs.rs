//! What users name on the command line (scenes, people, models), resolved and checked before anything starts.

use crate::cli::PlannerKind;
use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::ValueEnum;
use domains::commonroad::Scenario;
use domains::highway::{Person, Scene};
use driver::Driving;
use models::{Kind, SelfModel};
use planning::Settings;
use std::path::{Path, PathBuf};

/// A scene, and where it came from.
#[derive(Clone, Debug)]
pub struct NamedScene {
    /// The scene, with the fog that was asked for.
    pub scene: Scene,
    /// Its name, for people.
    pub name: String,
    /// The CommonRoad file, if it is one.
    pub recording: Option<PathBuf>,
}

/// Who drives.
#[derive(Clone)]
pub struct NamedDriver {
    /// As the driver process wants it.
    pub driving: Driving,
    /// For people.
    pub name: String,
}

/// Reads who drives: `sim:ID`, `sim:FILE` or `recorded:ID`.
///
/// # Errors
/// Names the option, or the file and the place in it.
pub fn driver(text: &str) -> Result<NamedDriver> {
    let driving = match text.split_once(':') {
        Some(("sim", id)) if id.bytes().all(|byte| byte.is_ascii_digit()) => {
            let number = id
                .parse()
                .with_context(|| format!("--driver {text}: not a number"))?;
            Driving::Simulated(Person::builtin(number).with_context(|| format!("--driver {text}"))?)
        }
        Some(("sim", file)) => Driving::Simulated(Person::load(Path::new(file))?),
        Some(("recorded", id)) => {
            let car = id
                .parse()
                .with_context(|| format!("--driver {text}: {id:?} is no car's number"))?;
            Driving::Recorded(car)
        }
        _ => bail!("--driver {text}: expected sim:ID, sim:FILE.toml or recorded:ID"),
    };
    Ok(NamedDriver {
        driving,
        name: text.to_owned(),
    })
}

/// Reads a scene by name or file.
///
/// # Errors
/// Names the option, or the file and the place in it.
pub fn scene(text: &str, fog_m: Option<f64>, driving: &Driving) -> Result<NamedScene> {
    if let Some(fog_m) = fog_m {
        ensure!(
            (0.0..=1000.0).contains(&fog_m),
            "--fog {fog_m}: expected 0 to 1000 metres"
        );
    }
    let seat = match driving {
        Driving::Simulated(_) => None,
        Driving::Recorded(car) => Some(*car),
    };
    let path = Path::new(text);
    let extension = path
        .extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or_default();
    if extension.eq_ignore_ascii_case("xml") {
        let scene = Scenario::read(path)?.scene(fog_m, seat)?;
        scene.check(path)?;
        return Ok(NamedScene {
            name: scene.name.clone(),
            scene,
            recording: Some(path.to_owned()),
        });
    }
    if let Some(car) = seat {
        bail!(
            "--driver recorded:{car}: only a CommonRoad scenario has recorded drivers, and --scene {text} is none"
        );
    }
    let mut scene = match extension {
        "" if !path.exists() => Scene::builtin(text).context("--scene")?,
        _ => Scene::load(path)?,
    };
    if let Some(fog_m) = fog_m {
        scene.set_fog_m(fog_m);
    }
    Ok(NamedScene {
        name: scene.name.clone(),
        scene,
        recording: None,
    })
}

/// The kind of human model of that name.
///
/// # Errors
/// Lists the kinds that there are.
pub fn human(option: &str, text: &str) -> Result<Kind> {
    let kinds = || Kind::ALL.map(Kind::name).join(", ");
    Kind::parse(text).with_context(|| {
        format!(
            "{option} {text}: there is no such human model; there are {}",
            kinds()
        )
    })
}

/// The way to decide of that name.
///
/// # Errors
/// Lists the ways that there are.
pub fn planner(text: &str) -> Result<PlannerKind> {
    PlannerKind::from_str(text, false).map_err(|_| {
        let kinds: Vec<_> = PlannerKind::value_variants()
            .iter()
            .map(|kind| kind.name())
            .collect();
        anyhow!(
            "there is no planner {text:?}; there are {}",
            kinds.join(", ")
        )
    })
}

/// A path that a file can be written to: its directory exists.
///
/// # Errors
/// Names the path.
pub fn writable(option: &str, path: &Path) -> Result<PathBuf> {
    let path = std::path::absolute(path).with_context(|| format!("{option} {}", path.display()))?;
    let directory = path.parent().unwrap_or(Path::new("/"));
    ensure!(
        directory.is_dir(),
        "{option} {}: {} is no directory",
        path.display(),
        directory.display()
    );
    ensure!(
        !path.is_dir(),
        "{option} {}: that is a directory",
        path.display()
    );
    Ok(path)
}

/// The planner's settings: the scene's.
///
/// # Errors
/// Names the scene's key that the planner cannot use.
pub fn settings(scene: &NamedScene) -> Result<Settings> {
    let (planning, communication) = (&scene.scene.planning, &scene.scene.communication);
    let power = communication.verbal_power;
    ensure!(
        power == 3.0,
        "{}: communication.verbal_power is {power}: the planner knows only 3",
        scene.name
    );
    let settings = Settings {
        horizon: planning.horizon as usize,
        hold: planning.repeat as usize,
        samples: planning.samples as usize,
        iterations: planning.iterations as usize,
        elites: planning.elites as usize,
        smoothing: planning.smoothing as f32,
        first_probability: planning.first_probability as f32,
        warm_start: planning.warm_start as f32,
        discount: planning.discount as f32,
        reward_weight: planning.reward_weight as f32,
        visual_cost: communication.visual_cost as f32,
        verbal_cost: communication.verbal_cost as f32,
        visual_threshold: planning.visual_threshold as f32,
        verbal_threshold: planning.verbal_threshold as f32,
        ..Settings::default()
    };
    match settings.problem() {
        Some(problem) => bail!("{}: [planning]: {problem}", scene.name),
        None => Ok(settings),
    }
}

/// Where the files that ship lie: beside the sources that this program was built from.
pub fn pretrained() -> PathBuf {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/pretrained"));
    folder.canonicalize().unwrap_or_else(|_| folder.to_owned())
}

/// The robot's self-model: the given file or the one that ships.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn self_model(given: Option<&Path>) -> Result<(PathBuf, SelfModel)> {
    let path = match given {
        Some(path) => std::path::absolute(path).with_context(|| path.display().to_string())?,
        None => pretrained().join("highway-self.safetensors"),
    };
    let model = models::checkpoint::load_self_model(&path)?;
    Ok((path, model))
}

/// Where what a human model learned of the person comes from: implants, or the policy of `bc` and `sqil`.
#[derive(Clone, Debug, PartialEq)]
pub enum ImplantSource {
    /// It has none.
    None,
    /// A file that was read and fits.
    File(PathBuf),
    /// They are learned from this person's driving before the run starts.
    Learn(Box<Person>),
}

/// What the human model learned of this person: the given file, the one that ships, or what is still to be learned.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn implants(
    given: Option<&Path>,
    human: Kind,
    driving: &Driving,
    model: &SelfModel,
) -> Result<ImplantSource> {
    if human == Kind::Myself {
        ensure!(given.is_none(), "--implants: human model `self` has none");
        return Ok(ImplantSource::None);
    }
    if let (Some(path), false) = (given, human.is_self_model()) {
        let path = std::path::absolute(path).with_context(|| path.display().to_string())?;
        models::recurrent_file::load_policy(&path, human)?;
        return Ok(ImplantSource::File(path));
    }
    let Some(path) = given else {
        return match driving {
            Driving::Simulated(person) => Ok(ImplantSource::Learn(Box::new(person.clone()))),
            Driving::Recorded(car) => {
                bail!(
                    "--human {} needs --implants for recorded driver {car}; or use --human self",
                    human.name()
                )
            }
        };
    };
    let path = std::path::absolute(path).with_context(|| path.display().to_string())?;
    let implants = models::checkpoint::load_implants(&path, model)?;
    let has_policy = implants.has_policy();
    ensure!(
        has_policy == (human == Kind::Mirror),
        "{}: has {} policy implant, which is not human model `{}`",
        path.display(),
        if has_policy { "a" } else { "no" },
        human.name()
    );
    Ok(ImplantSource::File(path))
}
