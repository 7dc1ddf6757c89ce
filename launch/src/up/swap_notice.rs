//! What a swap under way waits for, told to who asked for it.

use super::control_socket::WaitNotice;
use super::swap::{Around, Swap, SwapStage, WORLD};
use runtime::now_ns;

/// How often who asked is told what is waited for.
const TELL_NS: u64 = 1_000_000_000;

impl Swap {
    /// Tells who asked what is waited for: at once where that will take long, else after a second, and then once a
    /// second.
    pub(super) fn tell_waiting(&mut self, around: &Around) {
        let now = now_ns();
        let takes_long = match self.stage {
            SwapStage::Learning(_) => true,
            SwapStage::Crossing => self.waits_for_episode(),
            _ => false,
        };
        let due_ns = match self.told {
            Some((since_ns, told_ns)) if since_ns == self.since_ns => told_ns + TELL_NS,
            _ if takes_long => 0,
            _ => self.since_ns + TELL_NS,
        };
        if now < due_ns {
            return;
        }
        let waiting = WaitNotice {
            what: format!("{}: {}", self.report.process, self.waits_for()),
            so_far: around
                .heads
                .newest(WORLD)
                .map_or(String::new(), |(episode, step)| {
                    format!("episode {episode} is at step {step}")
                }),
        };
        if let Some(caller) = &mut self.caller {
            caller.tell_waiting(waiting);
        }
        self.told = Some((self.since_ns, now));
    }

    /// What the present stage waits for, in words.
    fn waits_for(&self) -> String {
        let to = &self.report.to;
        match self.stage {
            SwapStage::Learning(_) => format!("{to} learns what it takes of the person"),
            SwapStage::Starting => format!("{to} starts"),
            SwapStage::CatchingUp => format!("{to} reads along until it has caught up"),
            SwapStage::AskingNew | SwapStage::AskingOld => {
                "old and new agree when to change".to_owned()
            }
            SwapStage::TakingOver => format!("the old one died, and {to} goes on in its place"),
            SwapStage::Crossing if self.waits_for_episode() => {
                let before = self.handover.0.saturating_sub(1);
                format!("changes between two episodes: {to} waits for the end of episode {before}")
            }
            SwapStage::Crossing => {
                let (episode, step) = self.handover;
                format!("{to} waits for episode {episode}, step {step}")
            }
            SwapStage::Settling => format!("{to} has taken over; its first steps are watched"),
        }
    }
}
