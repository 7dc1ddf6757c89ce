//! The command line.

mod evaluate;
mod examples;
mod offered;

pub use evaluate::*;

use clap::{Args, Parser, Subcommand, ValueEnum, ValueHint};
use clap_complete::Shell;
use planner::PlannerMethod;
use std::path::PathBuf;

/// The scene of `mirror up` where none is named.
pub const DEFAULT_SCENE: &str = "highway-fog";

/// The way from a user's own rounds to their own human model.
const OWN_MODELS: &str = "\
From rounds of your own to a human model of your own:
  1. Rounds: examples/python/rounds.py turns a table of your rounds into a file of demonstrations (or: mirror demos).
  2. Implants, bc or sqil learned from them: mirror train human --demos ROUNDS --out LEARNED
  3. In the set: mirror up --implants LEARNED, or while it runs: mirror swap human KIND --implants LEARNED
  4. A model of your own: implement models::HumanModel (Rust; the suite to pass: shared/models/tests/conformance.rs),
     or start from examples/python/human_model.py and run it by --exec human=COMMAND. docs/learn.md says more.";

/// MIRROR watches a person drive in fog and decides what to tell them, when, and how.
///
/// It runs as seven processes that exchange messages through shared memory: the world, the driver (a simulated person),
/// the robot's belief, the model of the person, the planner, the renderer and the recorder. `mirror up` starts them
/// all.
#[derive(Debug, Parser)]
#[command(
    name = "mirror",
    version,
    max_term_width = 110,
    after_help = format!("{}\n\n{OWN_MODELS}", examples::TOP)
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Compute with vectors of so many numbers (1, 4, 8, 16), emulated where the machine has none, in place of the
    /// widest that it has: slower, with the same results to the last bit
    #[arg(
        long,
        global = true,
        value_name = "N",
        default_value = "widest",
        hide_default_value = true
    )]
    pub vectors: nn::vectors::Vectors,
}

/// What to do.
#[derive(Debug, Subcommand)]
// Read once.
#[allow(clippy::large_enum_variant)]
pub enum Command {
    /// Start the process set, drive some episodes, and print what was communicated and a summary
    #[command(after_help = examples::UP)]
    Up(UpArguments),
    /// Feed a recorded drive to belief, human model and planner again: the same decisions, or those of another model
    #[command(after_help = examples::REPLAY)]
    Replay(ReplayArguments),
    /// Measure where the time goes in a set of processes: one started for this, or one that runs
    #[command(after_help = examples::PROFILE)]
    Profile(ProfileArguments),
    /// Record rounds that a simulated person lives without communication
    #[command(after_help = examples::DEMOS)]
    Demos(DemosArguments),
    /// Learn a model
    #[command(subcommand, after_help = examples::TRAIN)]
    Train(Train),
    /// Repeat the paper's studies with simulated people
    #[command(subcommand, after_help = examples::EVALUATE)]
    Evaluate(Evaluate),
    /// Replace a process of a running set: the new one takes over at a step border
    #[command(after_help = examples::SWAP)]
    Swap(SwapArguments),
    /// List the process sets that run: what each is, how far, and its processes
    #[command(after_help = examples::LS)]
    Ls(ListArguments),
    /// List the scenes that ship: domain, what it is, and how far people see in it
    #[command(after_help = examples::SCENES)]
    Scenes(ListArguments),
    /// List the simulated people that ship: what they see and how they decide
    #[command(after_help = examples::PEOPLE)]
    People(PeopleArguments),
    /// Print a script with which a shell completes commands, options, names and files
    #[command(after_help = examples::COMPLETIONS)]
    Completions(CompletionsArguments),
    /// Print the manual page, or write one for every command
    #[command(after_help = examples::MAN)]
    Man(ManArguments),
    /// Write the messages' ROS 2 definitions, for programs that read recordings
    #[command(after_help = examples::MESSAGES)]
    Messages(MessagesArguments),
    /// Show what is running, what a dead run left, whether this machine's limits suffice, and whether it keeps up in
    /// real time
    #[command(after_help = examples::DOCTOR)]
    Doctor(DoctorArguments),
    /// Run as one process of a set (this is how `up` starts itself)
    #[command(hide = true)]
    Process(ProcessArguments),
    /// Run somebody else's program as one process of a set, and end it, and all that it starts, with the set (this is
    /// how `up` starts what --exec names)
    #[command(hide = true)]
    ExecGuard(ExecGuardArguments),
}

/// Options of `mirror up`.
#[derive(Args, Debug)]
pub struct UpArguments {
    /// Where to drive: a scene that ships (`mirror scenes` lists them), a scene file (.toml), or recorded traffic from
    /// a CommonRoad scenario (.xml)
    #[arg(long, value_name = "NAME|FILE", default_value = DEFAULT_SCENE, value_parser = offered::scenes(), hide_possible_values = true)]
    pub scene: String,
    /// Highway: fog in which one sees this far ahead, in metres (0 to 1000), whatever the scene says
    #[arg(long, value_name = "METRES", allow_negative_numbers = true)]
    pub fog: Option<f64>,
    /// The robot's model of the person: `mirror` (learned perception and policy), `mirror-p` (perception only), `self`
    /// (the robot's own, unchanged), or a policy that was told what the person can see: `bc` (behavioural cloning),
    /// `sqil` (soft-Q imitation); in a gridworld also `ideal`, the simulated person's own model
    #[arg(long, value_name = "KIND", default_value = "mirror", value_parser = offered::humans(), hide_possible_values = true)]
    pub human: String,
    /// How to decide what to communicate
    #[arg(long, value_name = "KIND", value_enum, default_value_t = PlannerMethod::Race)]
    pub planner: PlannerMethod,
    /// Who drives: `sim:ID` (a simulated person, 1 to 21, in a gridworld 1 to 10), `sim:FILE.toml` (your own),
    /// `recorded:ID` (the person in that car of a CommonRoad scenario), or `browser`: you, at a page in a browser
    #[arg(
        long,
        value_name = "sim:ID|sim:FILE|recorded:ID|browser",
        default_value = "sim:1",
        value_parser = offered::drivers(),
        hide_possible_values = true
    )]
    pub driver: String,
    /// How many episodes to drive
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub episodes: u32,
    /// Whether everybody waits for everybody (the same bytes every time) or the world ticks at its own rate [default:
    /// lockstep; realtime where a person drives on the highway]
    #[arg(long, value_enum)]
    pub clock: Option<Clock>,
    /// Seed of everything that is random
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Write every message to this file, for Foxglove, PlotJuggler and rosbag tools
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    /// Write the summary to this file
    #[arg(long, value_name = "FILE.json")]
    pub summary: Option<PathBuf>,
    /// Name of this set of processes, for running several at once [default: up-PID]
    #[arg(long, value_name = "NAME")]
    pub instance: Option<String>,
    /// Run another program as one of the processes; it gets the path of its arguments (a JSON file) as its last
    /// argument
    #[arg(long, value_name = "PROCESS=COMMAND", value_hint = ValueHint::Other)]
    pub exec: Vec<String>,
    /// The robot's self-model [default: the one that ships]
    #[arg(long, value_name = "FILE.safetensors")]
    pub self_model: Option<PathBuf>,
    /// What the human model learned of this person, made by `mirror train human`: implants, or the policy of `bc` or
    /// `sqil` [default: learned at the start from six rounds without communication; in a gridworld, one of each
    /// scenario]
    #[arg(long, alias = "learned", value_name = "FILE.safetensors")]
    pub implants: Option<PathBuf>,
    /// Poll this long for a message before sleeping, in microseconds; pays off only with more cores than processes
    #[arg(long, value_name = "MICROSECONDS", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=1_000_000))]
    pub spin: u32,
    /// How often in a row a process that died is started again before the run ends; 0 ends it with the first death
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub restarts: u32,
    /// A process that is silent for so long, though asked several times, hangs: it is killed, and started again. Never
    /// sooner than after four times its longest step so far; in lockstep, one that computes (or waits for the disk) is
    /// waited for however long it takes, and only one that stands still hangs
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, value_parser = hang_limit, allow_negative_numbers = true)]
    pub hang_limit: f64,
    /// Print no events, only the summary
    #[arg(long)]
    pub quiet: bool,
    /// Serve a page that shows the run live: the drive from above, what the person is believed to see and know, what
    /// was said and why, and the time that every process takes
    #[arg(long)]
    pub view: bool,
    /// Where the pages of `--view` and `--driver browser` are served: an address of this machine, with a port or
    /// without. Other hosts reach them only with this option, and need the link with its token all the same; nothing is
    /// encrypted [default: 127.0.0.1, any free port]
    #[arg(long, value_name = "ADDRESS[:PORT]")]
    pub listen: Option<Listen>,
    /// With `--driver browser`: a round is void when nobody has been at the wheel for so long
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0, value_parser = void_after, allow_negative_numbers = true)]
    pub void_after: f64,
}

fn void_after(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds @ 0.0..=86_400.0) => Ok(seconds),
        _ => Err("expected 0 to 86400".to_owned()),
    }
}

/// Where pages are served.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Listen(pub std::net::SocketAddr);

impl std::str::FromStr for Listen {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let port = |address| std::net::SocketAddr::new(address, 0);
        let bare = text
            .strip_prefix('[')
            .and_then(|text| text.strip_suffix(']'));
        text.parse()
            .or_else(|_| bare.unwrap_or(text).parse().map(port))
            .map(Self)
            .map_err(|_| {
                "expected an address such as 127.0.0.1, 0.0.0.0:8080 or [::1]:8080".to_owned()
            })
    }
}

fn hang_limit(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds @ 0.1..=86_400.0) => Ok(seconds),
        _ => Err("expected 0.1 to 86400".to_owned()),
    }
}

/// Options of `mirror replay`.
#[derive(Args, Debug)]
pub struct ReplayArguments {
    /// What `mirror up --record` wrote; its further parts (FILE.part2.mcap …) are found beside it
    #[arg(value_name = "FILE.mcap")]
    pub recording: PathBuf,
    /// Ask this human model instead of the recorded one
    #[arg(long, value_name = "KIND", value_parser = offered::humans(), hide_possible_values = true)]
    pub human: Option<String>,
    /// Decide in this way instead of the recorded one
    #[arg(long, value_name = "KIND", value_enum)]
    pub planner: Option<PlannerMethod>,
    /// What the human model learned of the person [default: what the recording carries; for another human model,
    /// learned at the start from the recorded simulated person]
    #[arg(long, value_name = "FILE.safetensors")]
    pub implants: Option<PathBuf>,
    /// The robot's self-model [default: the recorded one, which must not have changed since]
    #[arg(long, alias = "model", value_name = "FILE.safetensors")]
    pub self_model: Option<PathBuf>,
    /// Write the comparison to this file, every step included
    #[arg(long, value_name = "FILE.json")]
    pub summary: Option<PathBuf>,
    /// Name of this set of processes, for running several at once [default: replay-PID]
    #[arg(long, value_name = "NAME")]
    pub instance: Option<String>,
    /// Print at most so many steps at which another decision is made; the summary file has all
    #[arg(long, value_name = "N", default_value_t = 40)]
    pub lines: usize,
    /// Afterwards, serve a page that shows the recording, and beside it what is decided now, until Ctrl-C
    #[arg(long)]
    pub view: bool,
    /// Where the page of `--view` is served: see `mirror up --help` [default: 127.0.0.1, any free port]
    #[arg(long, value_name = "ADDRESS[:PORT]")]
    pub listen: Option<Listen>,
}

/// Options of `mirror profile`.
#[derive(Args, Debug)]
pub struct ProfileArguments {
    /// Watch this set, which runs already, instead of starting one
    #[arg(long, value_name = "INSTANCE", conflicts_with_all = [
        "scene", "fog", "human", "planner", "driver", "episodes", "clock", "seed", "record", "summary", "instance", "exec",
        "self_model", "implants", "spin", "restarts", "hang_limit", "quiet", "view", "listen", "void_after",
    ])]
    pub attach: Option<String>,
    /// Folder for profile.json, profile.hlog (HdrHistogram) and trace.json (Perfetto)
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: Option<PathBuf>,
    /// Say what became slower or faster since this older profile.json
    #[arg(long, value_name = "FILE")]
    pub against: Option<PathBuf>,
    /// Draw a typical step and the slowest
    #[arg(long, value_name = "FILE.svg")]
    pub picture: Option<PathBuf>,
    /// Watch for so long [default: 10 if attached, else until the episodes are over]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true)]
    pub seconds: Option<f64>,
    /// Afterwards, measure for so long how much watching slows a tick; a set started for this drives on meanwhile
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 5.0,
        allow_negative_numbers = true
    )]
    pub own_cost: f64,
    /// What to start.
    #[command(flatten, next_help_heading = "The set to start")]
    pub scene: UpArguments,
}

/// How time passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Clock {
    /// Everybody waits for what a step needs
    Lockstep,
    /// The world ticks at its own rate and takes the newest action
    Realtime,
}

/// Options of `mirror scenes` and `mirror ls`.
#[derive(Args, Debug)]
pub struct ListArguments {
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `mirror people`.
#[derive(Args, Debug)]
pub struct PeopleArguments {
    /// Only those of this domain
    #[arg(long, value_enum)]
    pub domain: Option<Domain>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `mirror completions`.
#[derive(Args, Debug)]
pub struct CompletionsArguments {
    /// The shell
    #[arg(value_enum)]
    pub shell: Shell,
}

/// Options of `mirror man`.
#[derive(Args, Debug)]
pub struct ManArguments {
    /// Folder for the pages of all commands, mirror.1, mirror-up.1 and so on; made if it is not there
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: Option<PathBuf>,
}

/// Options of `mirror messages`.
#[derive(Args, Debug)]
pub struct MessagesArguments {
    /// Folder for the package `mirror_msgs`: package.xml, CMakeLists.txt, msg/*.msg; made if it is not there
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
}

/// Options of `mirror doctor`.
#[derive(Args, Debug)]
pub struct DoctorArguments {
    /// Remove what dead runs left
    #[arg(long)]
    pub clean: bool,
}

/// Options of `mirror swap`.
#[derive(Args, Debug)]
pub struct SwapArguments {
    /// The process to replace: world, driver, belief, human, planner, renderer or recorder
    #[arg(value_parser = offered::processes(), hide_possible_values = true)]
    pub process: String,
    /// What to replace it by: a kind of human model or planner, a driver (sim:ID), or `same` for another of the same
    /// kind
    #[arg(required_unless_present = "exec", value_parser = offered::kinds(), hide_possible_values = true)]
    pub kind: Option<String>,
    /// The running set [default: the only one that runs]
    #[arg(long, value_name = "NAME")]
    pub instance: Option<String>,
    /// Replace it by another program; it gets the path of its arguments (a JSON file) as its last argument
    #[arg(long, value_name = "COMMAND", value_hint = ValueHint::CommandString)]
    pub exec: Option<String>,
    /// What the new human model learned of this person [default: learned now]
    #[arg(long, value_name = "FILE.safetensors")]
    pub implants: Option<PathBuf>,
    /// Write the report to this file
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
}

/// Options of `mirror process`.
#[derive(Args, Debug)]
pub struct ProcessArguments {
    /// The process's arguments, as `up` wrote them
    #[arg(value_name = "FILE.json")]
    pub run: PathBuf,
}

/// Options of `mirror exec-guard`.
#[derive(Args, Debug)]
pub struct ExecGuardArguments {
    /// The launcher's process id
    pub launcher: u32,
    /// The process that the program stands in for
    pub process: String,
    /// The program, as the shell reads it
    pub program: String,
    /// The program's last argument: the process's arguments, as `up` wrote them
    #[arg(value_name = "FILE.json")]
    pub run: PathBuf,
}

/// What to learn.
#[derive(Debug, Subcommand)]
pub enum Train {
    /// Learn the robot's self-model by acting, from nothing (on two cores, about half an hour for the highway,
    /// minutes for a gridworld)
    #[command(name = "self", after_help = examples::TRAIN_SELF)]
    Myself(TrainSelfArguments),
    /// Learn what a person sees and how they act, from demonstrations; the self-model stays as it is (seconds)
    #[command(after_help = examples::TRAIN_HUMAN)]
    Human(TrainHumanArguments),
}

/// A domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Domain {
    /// Driving on a highway
    Highway,
    /// Driving in a gridworld
    Driving,
    /// Search and rescue in a gridworld
    #[value(name = "search_rescue")]
    SearchRescue,
    /// Bomb defusal
    #[value(name = "bomb_defusal")]
    BombDefusal,
}

impl Domain {
    /// Its name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self.gridworld() {
            None => "highway",
            Some(domain) => domain.name(),
        }
    }

    /// The gridworld that it is; none for the highway.
    pub fn gridworld(self) -> Option<domains::discrete::Domain> {
        match self {
            Self::Highway => None,
            Self::Driving => Some(domains::discrete::Domain::Driving),
            Self::SearchRescue => Some(domains::discrete::Domain::SearchRescue),
            Self::BombDefusal => Some(domains::discrete::Domain::BombDefusal),
        }
    }
}

/// What the person could see.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Setting {
    /// Clear weather, clear air, the robot's own rules
    Original,
    /// Fog, smoke, newer rules
    Transfer,
}

/// Options of `mirror demos`.
#[derive(Args, Debug)]
pub struct DemosArguments {
    /// The domain
    #[arg(long, value_enum, default_value_t = Domain::Highway)]
    pub domain: Domain,
    /// The simulated person: 1 to 21 on the highway, 1 to 10 in a gridworld, or a person's file
    #[arg(long, value_name = "ID|FILE.toml", value_parser = offered::people(), hide_possible_values = true)]
    pub person: String,
    /// What the person could see
    #[arg(long, value_enum, default_value_t = Setting::Transfer)]
    pub setting: Setting,
    /// How many rounds; six show every case of the highway once, nine every scenario of a gridworld
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = rounds)]
    pub rounds: usize,
    /// Seed of the rounds
    #[arg(long, value_name = "N", default_value_t = crate::inputs::DEMONSTRATION_SEED)]
    pub seed: u64,
    /// Where to write them
    #[arg(long, value_name = "FILE.safetensors")]
    pub out: PathBuf,
}

fn rounds(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(rounds @ 1..=10_000) => Ok(rounds),
        _ => Err("expected 1 to 10000".to_owned()),
    }
}

/// Options of `mirror train human`.
#[derive(Args, Debug)]
pub struct TrainHumanArguments {
    /// What to learn: `mirror` (perception and policy), `mirror-p` (perception only), or a policy of its own from these
    /// rounds (on the highway, and an expert's in clear weather), by likelihood (`bc`) or by soft-Q imitation (`sqil`)
    #[arg(long, value_name = "KIND", default_value = "mirror", value_parser = offered::learners(), hide_possible_values = true)]
    pub kind: String,
    /// The domain
    #[arg(long, value_enum, default_value_t = Domain::Highway)]
    pub domain: Domain,
    /// What `mirror demos` recorded
    #[arg(
        long,
        value_name = "FILE.safetensors",
        required_unless_present = "print_config"
    )]
    pub demos: Option<PathBuf>,
    /// In a gridworld, rounds of the same person in the original setting, from which `bc` and `sqil` learn too
    #[arg(long, value_name = "FILE.safetensors")]
    pub original: Option<PathBuf>,
    /// Where to write what was learned, for `mirror up --implants`
    #[arg(
        long,
        value_name = "FILE.safetensors",
        required_unless_present = "print_config"
    )]
    pub out: Option<PathBuf>,
    /// The robot's self-model [default: the one that ships]
    #[arg(long, value_name = "FILE.safetensors")]
    pub self_model: Option<PathBuf>,
    /// Seed of the first weights and of the noise
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Settings other than those that ship: a TOML file, or a part of one; docs/learn.md says more
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath)]
    pub config: Option<PathBuf>,
    /// Print the settings that this would use, as --config takes them, and do nothing
    #[arg(long)]
    pub print_config: bool,
}

/// Options of `mirror train self`.
#[derive(Args, Debug)]
pub struct TrainSelfArguments {
    /// The domain
    #[arg(long, value_enum, default_value_t = Domain::Highway)]
    pub domain: Domain,
    /// Where to write the model; what is needed to continue goes to FILE.training.safetensors
    #[arg(
        long,
        value_name = "FILE.safetensors",
        required_unless_present = "print_config"
    )]
    pub out: Option<PathBuf>,
    /// Seed of everything that is random [default: 0]
    #[arg(long, value_name = "N", conflicts_with = "resume")]
    pub seed: Option<u64>,
    /// Phases in all, those before a --resume included, each of some rounds (on the highway, one) and some gradient steps
    /// [default: as many as the shipped model had]
    #[arg(long, alias = "episodes", value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub phases: Option<u32>,
    /// Continue where an earlier run stopped: the result is the same as if it had not
    #[arg(long)]
    pub resume: bool,
    /// Write one line of JSON per phase to this file
    #[arg(long, value_name = "FILE.jsonl")]
    pub metrics: Option<PathBuf>,
    /// Settings other than those that ship: a TOML file, or a part of one; docs/learn.md says more
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath, conflicts_with = "resume")]
    pub config: Option<PathBuf>,
    /// Print the settings that this would use, as --config takes them, and do nothing
    #[arg(long)]
    pub print_config: bool,
}
