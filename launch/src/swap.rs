//! `mirror swap`: asks a running set to replace one of its processes, and shows what came of it.

use crate::cli::SwapArguments;
use crate::failure::Failure;
use crate::inputs;
use crate::screen::Screen;
use crate::up::control_socket::{self, Question, Replacement, WaitNotice};
use anyhow::{Context, Result, bail};
use runtime::instance::{self, lookup_roots};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Runs `mirror swap`.
pub fn swap(arguments: &SwapArguments) -> Result<ExitCode, Failure> {
    let (directory, report_to, question) = prepare(arguments).map_err(Failure::refused)?;
    let screen = Screen::new();
    let mut news = News::new(screen.clone());
    let report = control_socket::ask(&directory, &question, |waiting| news.tell(waiting));
    screen.finish();
    let report = report?;
    print(&screen, &report);
    if let Some(path) = report_to {
        let text = serde_json::to_string_pretty(&report).context("the report")?;
        files::write(&path, (text + "\n").as_bytes()).map_err(anyhow::Error::from)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn prepare(arguments: &SwapArguments) -> Result<(PathBuf, Option<PathBuf>, Question)> {
    let report = match &arguments.report {
        Some(path) => Some(inputs::writable("--report", path)?),
        None => None,
    };
    // The running set stands in another folder, perhaps.
    let implants = match &arguments.implants {
        Some(path) => Some(
            path.canonicalize()
                .with_context(|| format!("--implants {}", path.display()))?,
        ),
        None => None,
    };
    let question = Question::Swap(Replacement {
        process: arguments.process.clone(),
        kind: arguments.kind.clone(),
        exec: arguments.exec.clone(),
        implants,
    });
    Ok((running(arguments.instance.as_deref())?, report, question))
}

/// The directory of the running set of that name, or of the only one.
///
/// # Errors
/// When there is none, or several to choose from.
pub fn running(name: Option<&str>) -> Result<PathBuf> {
    let mut found = Vec::new();
    for root in lookup_roots() {
        found.extend(instance::list_instances(&root)?);
    }
    found.retain(|instance| instance.launcher.is_some());
    let running: Vec<String> = found.iter().map(|found| found.instance.clone()).collect();
    let chosen = match (name, running.as_slice()) {
        (Some(name), names) if names.iter().any(|running| running == name) => name,
        (Some(name), []) => bail!("--instance {name}: no process set is running"),
        (Some(name), names) => {
            bail!("--instance {name} is not running; {} are", names.join(", "))
        }
        (None, [only]) => only,
        (None, []) => bail!("no process set is running; start one with `mirror up`"),
        (None, names) => bail!(
            "several process sets are running: choose one with --instance ({})",
            names.join(", ")
        ),
    };
    let root = found.iter().find(|found| found.instance == *chosen);
    let root = root.map_or_else(|| instance::root_for(chosen), |found| found.root.clone());
    Ok(instance::directory(&root, chosen))
}

/// What a swap waits for, for who waits for it.
struct News {
    screen: Screen,
    said: String,
    told: Instant,
}

impl News {
    /// Between two lines about how far it is, where there is no status line.
    const PAUSE: Duration = Duration::from_secs(10);

    fn new(screen: Screen) -> Self {
        Self {
            screen,
            said: String::new(),
            told: Instant::now(),
        }
    }

    fn tell(&mut self, waiting: &WaitNotice) {
        let WaitNotice { what, so_far } = waiting;
        if *what != self.said {
            self.screen.warn(what);
            self.said.clone_from(what);
            self.told = Instant::now();
        }
        if so_far.is_empty() {
            return;
        }
        self.screen.status(so_far.clone());
        if !self.screen.has_status() && self.told.elapsed() >= Self::PAUSE {
            self.screen.warn(&format!("  {so_far}"));
            self.told = Instant::now();
        }
    }
}

fn print(screen: &Screen, report: &serde_json::Value) {
    let text = |key: &str| report[key].as_str().unwrap_or_default().to_owned();
    let number = |key: &str| report[key].as_f64().unwrap_or_default();
    screen.line(&format!(
        "{}: {} → {}",
        text("process"),
        text("from"),
        text("to")
    ));
    if let [episode, step] = report["border"].as_array().map_or(&[][..], Vec::as_slice) {
        screen.line(&format!(
            "  the new process speaks from episode {episode} step {step} on"
        ));
    }
    screen.line(&format!(
        "  steps without an answer {}, late answers {}, messages lost {}",
        number("ticks_without_answer"),
        number("late_answers"),
        number("lost_messages")
    ));
    screen.line(&format!(
        "  learning {:.0} ms, start {:.0} ms, catching up {:.0} ms, agreement {:.1} ms, to the border {:.0} ms; longest pause {:.1} ms",
        number("learn_ms"),
        number("start_ms"),
        number("catch_up_ms"),
        number("agree_ms"),
        number("cross_ms"),
        number("longest_gap_ms")
    ));
    if report["old_died"] == true {
        screen
            .line("  the old process died before the border; the new one went on where it stopped");
    }
}
