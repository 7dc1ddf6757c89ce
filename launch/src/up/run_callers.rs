//! What callers at the control socket ask of a run: its status, and swaps.

use super::control_socket::{Answer, Question};
use super::run::Run;
use super::swap::{Around, Finished, Swap};
use crate::process::NAMES;
use anyhow::Result;

impl Run<'_> {
    /// Answers whoever asks at the control socket.
    pub(super) fn answer_callers(&mut self) -> Result<()> {
        while let Some((caller, question)) = self.socket.next() {
            match question {
                Err(why) => caller.tell(&Answer::Refused(why)),
                Ok(Question::Status) => caller.tell(&Answer::Done(self.status())),
                Ok(Question::Swap(_)) if self.swap.is_some() => {
                    caller.tell(&Answer::Refused("another swap is under way".to_owned()));
                }
                Ok(Question::Swap(asked)) => {
                    self.heads.forget_gaps();
                    let (plan, lost) = (self.plan.clone(), self.lost());
                    let begun = Swap::begin(&plan, &asked, caller, &mut self.around(lost));
                    match begun {
                        Ok(swap) => self.swap = Some(swap),
                        Err((caller, error)) => {
                            caller.tell(&Answer::Refused(format!("{error:#}")));
                        }
                    }
                }
            }
        }
        Ok(())
    }

    pub(super) fn around(&mut self, lost: u64) -> Around<'_> {
        Around {
            launcher: self.launcher,
            children: &mut self.children,
            supervisor: &mut self.supervisor,
            heads: &self.heads,
            screen: self.screen,
            lost,
            rate: self.rate.2,
            episode_steps: self.tally.steps() as f64 / self.tally.episodes.len().max(1) as f64,
        }
    }

    pub(super) fn with_swap(
        &mut self,
        act: impl FnOnce(&mut Swap, &mut Around) -> Result<Option<Finished>>,
    ) -> Result<()> {
        let Some(mut swap) = self.swap.take() else {
            return Ok(());
        };
        let lost = self.lost();
        match act(&mut swap, &mut self.around(lost))? {
            Some(finished) => self.finish_swap(swap, finished),
            None => {
                self.swap = Some(swap);
                Ok(())
            }
        }
    }

    pub(super) fn finish_swap(&mut self, swap: Swap, finished: Finished) -> Result<()> {
        let lost = self.lost();
        let (place, is_vacant) = (swap.place(), swap.old_is_gone());
        swap.end(&finished, &mut self.around(lost))?;
        match finished {
            Finished::Done(plan, report) => {
                let (process, from, to) = (&report.process, &report.from, &report.to);
                let (episode, step) = report.handover.unwrap_or_default();
                self.screen.line(&format!(
                    "SWAP {process}: {from} → {to} from episode {episode} step {step} on"
                ));
                self.plan = *plan;
                self.ending.swaps.push(report);
            }
            Finished::Failed(why) => {
                self.screen.warn(&format!("mirror: no swap: {why}"));
                if is_vacant {
                    self.supervisor.fill(place);
                }
            }
        }
        Ok(())
    }

    /// Messages that any port has lost, by all that was reported.
    pub(super) fn lost(&self) -> u64 {
        let reports = self.ending.reports.iter().flatten();
        reports
            .flat_map(|report| report.ports.iter().take(report.port_count as usize))
            .map(|port| port.lost)
            .sum()
    }

    pub(super) fn status(&self) -> serde_json::Value {
        let processes: Vec<_> = self
            .children
            .living()
            .iter()
            .map(|child| {
                serde_json::json!({
                    "process": NAMES[child.place],
                    "index": child.index,
                    "pid": child.pid(),
                    "phase": child.phase.name(),
                    "kind": self.plan.kind_of(child.place),
                    "position": self.heads.newest(child.place),
                })
            })
            .collect();
        let mut status = self.plan.status();
        status["phase"] = "driving".into();
        status["processes"] = processes.into();
        status["steps"] = self.tally.steps().into();
        status["dropped_lines"] = self.screen.dropped().into();
        status
    }
}
