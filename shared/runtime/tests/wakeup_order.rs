//! Every interleaving of senders that notify and a process that empties its listener, looks and sleeps, in a model of
//! iceoryx2 0.10's event (`iceoryx2-cal`, `event/common.rs`) with that crate's steps as single ones.

use std::collections::HashSet;

/// The state of a listener in shared memory.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
enum Mark {
    Idle,
    Pending,
    Notified,
}

/// What a sender does next.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
enum Sender {
    Message,
    Mark,
    Datagram,
    Notified,
}

/// What the process does next.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
enum Process {
    Look,
    /// `try_wait`: turns NOTIFIED to IDLE, or else …
    Reset,
    ReceiveOnly,
    /// … receives, …
    Receive,
    /// … sets IDLE, …
    SetIdle,
    /// … and receives again.
    ReceiveMore,
    Nap,
    Sleep,
}

/// When the process empties its listener.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Order {
    /// When its descriptor was readable, and then looks.
    WhenReadable,
    /// Before it sleeps, if it took a message or the descriptor was readable since; then it looks again.
    BeforeSleep,
    /// The same, and the first sleep after it is a nap.
    BeforeSleepAndNap,
}

#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
struct State {
    mark: Mark,
    datagrams: u8,
    /// Messages sent and not taken.
    waiting: u8,
    senders: [(Sender, u8); 2],
    process: Process,
    is_notified: bool,
    has_emptied: bool,
}

impl State {
    fn new(messages: [u8; 2]) -> Self {
        Self {
            mark: Mark::Idle,
            datagrams: 0,
            waiting: 0,
            senders: messages.map(|messages| (Sender::Message, messages)),
            process: Process::Look,
            is_notified: false,
            has_emptied: false,
        }
    }

    /// Whether no sender is between a message and the end of its notification.
    fn senders_rest(&self) -> bool {
        self.senders
            .iter()
            .all(|(next, _)| *next == Sender::Message)
    }

    /// A message waits, and nothing will ever wake the process.
    fn is_stuck(&self) -> bool {
        let all_sent = self.senders.iter().all(|(_, left)| *left == 0);
        let asleep = self.process == Process::Sleep && self.datagrams == 0;
        asleep && self.waiting > 0 && all_sent && self.senders_rest()
    }

    fn sender_steps(mut self, which: usize) -> Option<Self> {
        let (next, left) = self.senders[which];
        self.senders[which].0 = match next {
            Sender::Message => {
                self.senders[which].1 = left.checked_sub(1)?;
                self.waiting += 1;
                Sender::Mark
            }
            Sender::Mark => match self.mark {
                Mark::Idle => {
                    self.mark = Mark::Pending;
                    Sender::Datagram
                }
                Mark::Pending => Sender::Datagram,
                Mark::Notified => Sender::Message,
            },
            Sender::Datagram => {
                self.datagrams += 1;
                Sender::Notified
            }
            Sender::Notified => {
                if self.mark == Mark::Pending {
                    self.mark = Mark::Notified;
                }
                Sender::Message
            }
        };
        Some(self)
    }

    fn process_steps(mut self, order: Order) -> Option<Self> {
        self.process = match self.process {
            Process::Look if self.waiting > 0 => {
                self.waiting -= 1;
                self.is_notified = true;
                Process::Look
            }
            Process::Look if order == Order::WhenReadable => Process::Sleep,
            Process::Look if self.is_notified => {
                (self.is_notified, self.has_emptied) = (false, true);
                Process::Reset
            }
            Process::Look if self.has_emptied && order == Order::BeforeSleepAndNap => {
                self.has_emptied = false;
                Process::Nap
            }
            Process::Look => Process::Sleep,
            Process::Reset if self.mark == Mark::Notified => {
                self.mark = Mark::Idle;
                Process::ReceiveOnly
            }
            Process::Reset => Process::Receive,
            Process::Receive => {
                self.datagrams = self.datagrams.saturating_sub(1);
                Process::SetIdle
            }
            Process::SetIdle => {
                self.mark = Mark::Idle;
                Process::ReceiveMore
            }
            Process::ReceiveOnly | Process::ReceiveMore => {
                self.datagrams = self.datagrams.saturating_sub(1);
                Process::Look
            }
            Process::Nap | Process::Sleep if self.datagrams > 0 => {
                self.is_notified = true;
                match order {
                    Order::WhenReadable => Process::Reset,
                    _ => Process::Look,
                }
            }
            // A nap is longer than a notification takes; then the listener is emptied, and the next sleep is a long
            // one.
            Process::Nap if self.senders_rest() => Process::Reset,
            Process::Nap | Process::Sleep => return None,
        };
        Some(self)
    }
}

/// The first state found in which a message waits for ever, and how many states were seen.
fn explore(order: Order, messages: [u8; 2]) -> (Option<State>, usize) {
    let mut seen = HashSet::new();
    let mut open = vec![State::new(messages)];
    while let Some(state) = open.pop() {
        if !seen.insert(state) {
            continue;
        }
        if state.is_stuck() {
            return (Some(state), seen.len());
        }
        let next = [
            state.sender_steps(0),
            state.sender_steps(1),
            state.process_steps(order),
        ];
        open.extend(next.into_iter().flatten());
    }
    (None, seen.len())
}

#[test]
fn emptying_what_is_readable_loses_wake_ups() {
    for messages in [[3, 0], [1, 2]] {
        assert!(
            explore(Order::WhenReadable, messages).0.is_some(),
            "{messages:?}"
        );
    }
}

#[test]
fn emptying_before_the_look_is_not_enough_for_messages_taken_early() {
    assert!(explore(Order::BeforeSleep, [3, 0]).0.is_some());
}

#[test]
fn emptying_before_the_look_and_napping_loses_none() {
    for messages in [[5, 0], [4, 4], [1, 6]] {
        let (stuck, seen) = explore(Order::BeforeSleepAndNap, messages);
        assert_eq!(stuck, None, "{messages:?}");
        assert!(seen > 100, "{seen} states");
    }
}
