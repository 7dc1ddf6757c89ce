//! The pages of a run: the cockpit, which the driver's process serves, and the live view, whose process is none of the
//! set's: nobody waits for it, and one that dies is started again.

use super::plan::RunPlan;
use crate::own;
use crate::screen::Screen;
use anyhow::{Context, Result};
use runtime::{RunArguments, now_ns};
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::os::unix::process::CommandExt;
use std::process::{Child, Stdio};
use std::time::Duration;
use web::Access;

const MS: u64 = 1_000_000;
/// A view that dies is started again after so long …
const AGAIN_NS: u64 = 500 * MS;
/// … so often in a row; one that lived for a minute begins anew.
const MOST_DEATHS: u32 = 5;
const WELL_NS: u64 = 60_000 * MS;
/// How long the view may take to end.
const PATIENCE: Duration = Duration::from_secs(3);

/// A run's pages.
pub struct Pages {
    links: Vec<String>,
    view: Option<ViewProcess>,
}

struct ViewProcess {
    arguments: RunArguments,
    child: Option<Child>,
    started_ns: u64,
    deaths: u32,
}

impl Pages {
    /// Finds an address and a token for each page, where their processes will look for them.
    ///
    /// # Errors
    /// When nobody can listen where the pages shall be served.
    pub fn prepare(plan: &RunPlan, run: &RunArguments) -> Result<Self> {
        let mut listen = plan.listen.unwrap_or_else(Access::loopback);
        let mut links = Vec::new();
        if plan.driver.has_cockpit && !plan.exec.contains_key("driver") {
            let access = access(listen)?;
            access.save(&driver::cockpit::access_file(run))?;
            links.push(format!("drive at {}", access.link()));
            // The next port, where a port was asked for.
            if listen.port() != 0 {
                listen.set_port(listen.port().saturating_add(1));
            }
        }
        let mut view = None;
        if plan.view {
            let access = access(listen)?;
            access.save(&view::access_file(run))?;
            links.push(format!("watch at {}", access.link()));
            view = Some(ViewProcess {
                arguments: run
                    .for_process("view", u32::MAX)
                    .with_options(&plan.view_options()?)?,
                child: None,
                started_ns: 0,
                deaths: 0,
            });
        }
        Ok(Self { links, view })
    }

    /// Says where the pages are, and starts the view.
    pub fn open(&mut self, screen: &Screen) {
        for link in &self.links {
            screen.line(link);
        }
        self.look(screen);
    }

    /// Starts the view again if it has died.
    pub fn look(&mut self, screen: &Screen) {
        let Some(view) = &mut self.view else {
            return;
        };
        let now = now_ns();
        if let Some(child) = &mut view.child {
            let Ok(Some(status)) = child.try_wait() else {
                return;
            };
            view.child = None;
            if now - view.started_ns > WELL_NS {
                view.deaths = 0;
            }
            view.deaths += 1;
            let after = match view.deaths {
                MOST_DEATHS.. => "; the run goes on without it",
                _ => "; it is started again",
            };
            screen.warn(&format!("mirror: the live view ended: {status}{after}"));
        }
        if view.deaths < MOST_DEATHS && now - view.started_ns > AGAIN_NS {
            view.started_ns = now;
            match start(&view.arguments, screen) {
                Ok(child) => view.child = Some(child),
                Err(error) => {
                    view.deaths = MOST_DEATHS;
                    screen.warn(&format!("mirror: no live view: {error:#}"));
                }
            }
        }
    }

    /// Stops the view with SIGSTOP, or has it go on with SIGCONT, as the set.
    pub fn signal(&self, signal: libc::c_int) {
        if let Some(child) = self.view.as_ref().and_then(|view| view.child.as_ref()) {
            // SAFETY: signals our child, which was not waited for yet.
            unsafe { libc::kill(child.id() as libc::pid_t, signal) };
        }
    }

    /// Ends the view.
    pub fn close(&mut self) {
        self.signal(libc::SIGTERM);
        let Some(mut child) = self.view.take().and_then(|view| view.child) else {
            return;
        };
        let since = std::time::Instant::now();
        while matches!(child.try_wait(), Ok(None)) {
            if since.elapsed() > PATIENCE {
                let _ = child.kill();
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Pages {
    fn drop(&mut self) {
        self.close();
    }
}

fn access(listen: SocketAddr) -> Result<Access> {
    Access::new(listen).context("serving pages")
}

fn start(arguments: &RunArguments, screen: &Screen) -> Result<Child> {
    let file = arguments.write().context("arguments of view")?;
    let mut child = own::command()
        .arg("process")
        .arg(file)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        // Ctrl-C reaches the launcher alone, which ends the others.
        .process_group(0)
        .spawn()
        .context("starting view")?;
    if let Some(errors) = child.stderr.take() {
        let screen = screen.clone();
        std::thread::spawn(move || {
            for line in BufReader::new(errors).lines().map_while(Result::ok) {
                screen.warn(&format!("view: {line}"));
            }
        });
    }
    Ok(child)
}
