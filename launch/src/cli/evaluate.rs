//! The command line of `mirror evaluate`.

use super::{Domain, Setting, examples, rounds};
use clap::{Args, Subcommand, ValueHint};
use std::path::PathBuf;

/// Which study.
#[derive(Debug, Subcommand)]
// Read once.
#[allow(clippy::large_enum_variant)]
pub enum Evaluate {
    /// How well models of people in a gridworld predict what they do, against the number of rounds learned from
    #[command(after_help = examples::FIT)]
    Fit(EvaluateFitArguments),
    /// What assistants with different models of people in a gridworld earn for them, and how much they say for it
    #[command(after_help = examples::COMMUNICATE)]
    Communicate(EvaluateCommunicateArguments),
    /// Collisions and communication on the highway, in clear weather and in fog, with and without an assistant
    #[command(after_help = examples::DRIVE)]
    Drive(EvaluateDriveArguments),
    /// How well human models predict recorded drivers, against the number of drivers that they learned from
    #[command(after_help = examples::REAL)]
    Real(EvaluateRealArguments),
    /// What was learned of people's sight, against the truth
    #[command(after_help = examples::IMPLANTS)]
    Implants(EvaluateImplantsArguments),
    /// What the highway's self-model foresees of cars that come near, against what then happens
    #[command(after_help = examples::FORESIGHT)]
    Foresight(EvaluateForesightArguments),
    /// How rounds go in the self-model's hands when it perceives no more than a person, beside the person's own
    #[command(after_help = examples::UNAIDED)]
    Unaided(EvaluateUnaidedArguments),
    /// Every study, one after the other, and the time of each
    #[command(after_help = examples::ALL)]
    All(EvaluateAllArguments),
}

/// Where a study's model, tables and section are.
#[derive(Args, Debug)]
pub struct StudyFiles {
    /// The robot's self-model [default: the one that ships]
    #[arg(long, value_name = "FILE.safetensors")]
    pub self_model: Option<PathBuf>,
    /// Folder for tables and plots; a study that was stopped goes on from what it finds there
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// The file whose section of this study is written [default: RESULTS.md in the folder]
    #[arg(long, value_name = "FILE.md")]
    pub results: Option<PathBuf>,
}

/// What every study of a gridworld takes.
#[derive(Args, Debug)]
pub struct GridworldStudyArguments {
    /// The gridworld
    #[arg(long, value_enum)]
    pub domain: Domain,
    /// How many of the simulated people
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10))]
    pub people: u32,
    /// Repetitions with other rounds and other first weights; intervals are over people
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub seeds: u32,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Model, tables and section.
    #[command(flatten)]
    pub files: StudyFiles,
    /// Three people and fewer of everything else: to see that it runs
    #[arg(long)]
    pub quick: bool,
}

/// Options of `mirror evaluate fit`.
#[derive(Args, Debug)]
pub struct EvaluateFitArguments {
    /// What every study takes.
    #[command(flatten)]
    pub common: GridworldStudyArguments,
    /// Percentages of 20 rounds to learn from
    #[arg(long, value_name = "PERCENT,…", value_delimiter = ',', default_value = "20,40,60,80,100", value_parser = clap::value_parser!(u32).range(1..=100))]
    pub fractions: Vec<u32>,
}

/// Options of `mirror evaluate communicate`.
#[derive(Args, Debug)]
pub struct EvaluateCommunicateArguments {
    /// What every study takes.
    #[command(flatten)]
    pub common: GridworldStudyArguments,
    /// Percentages of 20 rounds that models learn from
    #[arg(long, value_name = "PERCENT,…", value_delimiter = ',', default_value = "20,100", value_parser = clap::value_parser!(u32).range(1..=100))]
    pub fractions: Vec<u32>,
    /// Who decides what is communicated: nc (nobody), everything, ideal (imagining the person themselves), or an
    /// assistant with the human model mirror, mirror-p, bc, sqil or self
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    pub conditions: Vec<String>,
    /// Rounds a person and condition [default: about 20, every scenario equally often]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub rounds: Option<u32>,
    /// How every assistant decides, `race` or `ce`
    #[arg(long, value_name = "KIND", default_value = "race", value_parser = ["race", "ce"])]
    pub planner: String,
    /// Futures imagined for a plan of `--planner ce`; `mirror up` takes as many as its scene says
    #[arg(long, value_name = "N", default_value_t = 400, value_parser = clap::value_parser!(u32).range(20..=100_000))]
    pub samples: u32,
}

/// Options of `mirror evaluate all`.
#[derive(Args, Debug)]
pub struct EvaluateAllArguments {
    /// Folder for tables and plots; what was stopped goes on from what it finds there
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// The file whose sections are written [default: RESULTS.md in the folder]
    #[arg(long, value_name = "FILE.md")]
    pub results: Option<PathBuf>,
    /// Folder of other self-models than those that ship, under the same names
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub self_models: Option<PathBuf>,
    /// Recorded drivers for `mirror evaluate real`: a CommonRoad scenario (.xml), or a folder of them
    #[arg(long, value_name = "FILE.xml|DIR")]
    pub data: Option<PathBuf>,
    /// The quick form of every study: minutes, to see that it runs
    #[arg(long)]
    pub quick: bool,
}

/// Options of `mirror evaluate drive`.
#[derive(Args, Debug)]
pub struct EvaluateDriveArguments {
    /// The domain: only the highway
    #[arg(long, value_enum, default_value_t = Domain::Highway)]
    pub domain: Domain,
    /// Conditions: clear, silent (NC), everything, or planned with mirror, mirror-p, self, bc, sqil, or matched with
    /// mirror-kl; all but the first in fog
    #[arg(
        long,
        value_name = "NAME,…",
        value_delimiter = ',',
        default_value = "clear,silent,everything,bc,mirror,mirror-kl"
    )]
    pub conditions: Vec<String>,
    /// How many of the simulated people drive
    #[arg(long, value_name = "N", default_value_t = 21, value_parser = clap::value_parser!(u32).range(1..=21))]
    pub people: u32,
    /// Seeds per person under conditions without a planner
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub seeds: u32,
    /// Seeds per person under conditions with a planner
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub planned_seeds: u32,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Rounds that the human model learns from
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = rounds)]
    pub rounds: usize,
    /// Model, tables and section.
    #[command(flatten)]
    pub files: StudyFiles,
    /// Three people, one seed, and a planner that imagines a fifth as many futures: minutes, to see that it runs
    #[arg(long)]
    pub quick: bool,
}

/// Options of `mirror evaluate implants`.
#[derive(Args, Debug)]
pub struct EvaluateImplantsArguments {
    /// The domain
    #[arg(long, value_enum, default_value_t = Domain::Highway)]
    pub domain: Domain,
    /// How many of the simulated people [default: all, 21 on the highway, 10 in a gridworld]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=21))]
    pub people: Option<u32>,
    /// Rounds that the human model learns from [default: 6 on the highway, 20 in a gridworld]
    #[arg(long, value_name = "N", value_parser = rounds)]
    pub rounds: Option<usize>,
    /// What the people could see, on the highway; in a gridworld both settings are studied
    #[arg(long, value_enum, default_value_t = Setting::Transfer)]
    pub setting: Setting,
    /// In a gridworld: repetitions with other rounds and other first weights
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub seeds: u32,
    /// In a gridworld: the first seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Model, tables and section.
    #[command(flatten)]
    pub files: StudyFiles,
    /// Three people: to see that it runs
    #[arg(long)]
    pub quick: bool,
}

/// Options of `mirror evaluate foresight`.
#[derive(Args, Debug)]
pub struct EvaluateForesightArguments {
    /// How many of the simulated people drive, in fog and without an assistant
    #[arg(long, value_name = "N", default_value_t = 21, value_parser = clap::value_parser!(u32).range(1..=21))]
    pub people: u32,
    /// Seeds; each has the six cases
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub seeds: u32,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// The robot's self-model [default: the one that ships]
    #[arg(long, value_name = "FILE.safetensors")]
    pub self_model: Option<PathBuf>,
    /// Folder for foresight.json
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// Three people, one seed: to see that it runs
    #[arg(long)]
    pub quick: bool,
}

/// Options of `mirror evaluate unaided`.
#[derive(Args, Debug)]
pub struct EvaluateUnaidedArguments {
    /// The domain: the highway in fog, or a gridworld in its transfer setting
    #[arg(long, value_enum, default_value_t = Domain::Highway)]
    pub domain: Domain,
    /// How many of the simulated people: persons 1 to this number [default: all, 21 on the highway and 10 in a gridworld]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=21))]
    pub people: Option<u32>,
    /// Seeds
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub seeds: u32,
    /// The first seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Rounds of a seed; the highway's six cases take turns
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u32).range(1..))]
    pub rounds: u32,
    /// The robot's self-model [default: the one that ships]
    #[arg(long, value_name = "FILE.safetensors")]
    pub self_model: Option<PathBuf>,
    /// Folder for unaided.json
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// Three people, one seed: to see that it runs
    #[arg(long)]
    pub quick: bool,
}

/// Options of `mirror evaluate real`.
#[derive(Args, Debug)]
pub struct EvaluateRealArguments {
    /// CommonRoad scenario (.xml), or a folder of them, of which <https://commonroad.in.tum.de/scenarios> has many;
    /// every moving vehicle is a driver [default: highway-recorded, the scene that ships, whose drivers are simulated]
    #[arg(long, value_name = "FILE.xml|DIR")]
    pub data: Option<PathBuf>,
    /// Splits of the drivers into two thirds to learn from and one third to test
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(2..=1000))]
    pub splits: u32,
    /// Seed of the splits and of learning
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Take it that the drivers saw this far ahead, in metres [default: as far as the LIDAR]
    #[arg(long, value_name = "METRES", value_parser = fog)]
    pub fog: Option<f64>,
    /// Model, tables and section.
    #[command(flatten)]
    pub files: StudyFiles,
    /// Two splits and three numbers of drivers: to see that it runs
    #[arg(long)]
    pub quick: bool,
}

fn fog(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(metres) if (0.0..=1000.0).contains(&metres) => Ok(metres),
        _ => Err("expected 0 to 1000 metres".to_owned()),
    }
}
