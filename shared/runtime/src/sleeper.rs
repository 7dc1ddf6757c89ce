//! Sleeping until a message comes: the one place where a process gives up the processor.

use crate::error::{NodeError, PortError};
use crate::input::Source;
use crate::poll::Poll;

/// A sleeping process looks up this often, to connect to those that joined meanwhile, and to find what did not wake it.
const LOOK_UP_NS: u64 = 250_000_000;
/// Longest first sleep after a listener was emptied: longer than a sender takes from its message to its notification.
const NAP_NS: u64 = 1_000_000;

/// Sleeps on descriptors and, before that, empties the listeners among them.
///
/// # How a wake-up gets lost
///
/// iceoryx2 0.10 wakes a listener by a datagram, and sends none where a state in shared memory says that one is there
/// already (`iceoryx2-cal`, `event/common.rs`). Who notifies
///
/// 1. counts the notification,
/// 2. turns IDLE to PENDING, or goes home if the state is NOTIFIED,
/// 3. sends a datagram,
/// 4. turns PENDING to NOTIFIED.
///
/// Who empties a listener (`try_wait`) turns NOTIFIED to IDLE and receives one datagram. If the state was not NOTIFIED,
/// it receives one, sets IDLE, *receives one more*; in both cases it then collects the counts. The step in italics is
/// the fault: a notification whose 2 and 3 fall between "sets IDLE" and "receives one more" loses its datagram, and its
/// 4 then says NOTIFIED over an empty socket. From then on every sender goes home at 2, and a process that only empties
/// what `ppoll` reports never resets the state.
///
/// # The order that finds it
///
/// *Empty, look at the messages, sleep.* A listener is emptied if, since it was last emptied, a message was taken from
/// it or its descriptor was readable; if any was, the messages are looked at before sleeping. Nobody waits for a
/// swallowed datagram:
///
/// - Its message was sent before its notification, so the look that follows the emptying finds it. A message was then
///   taken, so the listener is emptied again before the next sleep, which resets the state.
/// - A sender that goes home at 2 has sent its message before; the emptying that resets that NOTIFIED comes after, and
///   a look after that.
/// - A listener that is not emptied loses nothing: only emptying removes datagrams. More would not be safer, because
///   each emptying may swallow. In the usual order of things it cannot: the process was woken by a datagram, has worked
///   since, and finds NOTIFIED and the datagram.
///
/// One case is left to the clock. The swallowed datagram's message may have been taken *before* its notification, by a
/// process that was awake for another reason; then the look finds nothing, and 4 may come after it. So the first sleep
/// after an emptying is a nap of at most [`NAP_NS`], after which the listeners are emptied once more: by then the
/// sender has done its
/// 4. `tests/wakeup_order.rs` goes through every interleaving of this.
///
/// What remains is a sender that loses the processor for longer than a nap between a message and its notification, that
/// message being taken meanwhile, and comes back just within the second emptying. That delays a later message, once, by
/// at most [`LOOK_UP_NS`]: whenever a sleep ends without a readable descriptor, every listener is emptied whatever is
/// known of it. [`Sleeper::lost_wakeups`] counts the messages that a process then finds after it has slept for so long.
pub(crate) struct Sleeper {
    /// What to sleep on.
    pub(crate) poll: Poll,
    has_emptied: bool,
    has_looked_up: bool,
    lost_wakeups: u64,
}

/// Why a sleep ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Woken {
    /// A descriptor is readable.
    Ready,
    /// The nap is over.
    NapOver,
    /// The caller's time has come.
    TimeOver,
    /// Nothing came for so long that it is time to look up.
    LookUp,
}

impl Sleeper {
    pub(crate) fn new() -> Self {
        Self {
            poll: Poll::new(),
            has_emptied: false,
            has_looked_up: false,
            lost_wakeups: 0,
        }
    }

    /// Messages that waited for a look-up though their senders had notified us.
    pub(crate) fn lost_wakeups(&self) -> u64 {
        self.lost_wakeups
    }

    /// Before a sleep: empties a listener if it is in need of it. If this is true for any, the messages are to be
    /// looked at again before sleeping.
    pub(crate) fn empty(&mut self, source: &mut dyn Source) -> bool {
        let has_emptied = source.drain().is_some();
        self.has_emptied |= has_emptied;
        has_emptied
    }

    /// After a sleep that no descriptor ended: empties a listener whatever is known of it.
    ///
    /// # Errors
    /// [`PortError::Receive`].
    pub(crate) fn reset(&mut self, source: &mut dyn Source) -> Result<(), PortError> {
        source.mark_notified();
        let notifications = source.drain().unwrap_or_default();
        // A shorter sleep may well end while a sender is between its message and its datagram.
        if notifications > 0 && self.has_looked_up && source.pending()? {
            self.lost_wakeups += 1;
        }
        Ok(())
    }

    /// Sleeps until a descriptor is readable, for at most so long.
    ///
    /// # Errors
    /// [`NodeError::System`].
    pub(crate) fn sleep(&mut self, longest_ns: u64) -> Result<Woken, NodeError> {
        let naps = std::mem::take(&mut self.has_emptied);
        let (most_ns, woken) = match naps {
            true => (NAP_NS, Woken::NapOver),
            false => (LOOK_UP_NS, Woken::LookUp),
        };
        // What came just when the time was over did wake us.
        let ready = self.poll.wait(longest_ns.min(most_ns))? || self.poll.wait(0)?;
        let woken = match ready {
            true => Woken::Ready,
            false if longest_ns <= most_ns => Woken::TimeOver,
            false => woken,
        };
        self.has_looked_up = woken == Woken::LookUp;
        Ok(woken)
    }
}
