"""Topics of a MIRROR set, in Python: sending and receiving with headers, loss counts, and silence while it is another
process's turn. `mirror_process.Node` makes these ports.
"""

import ctypes
import mmap
import sys
import time
from collections import deque

import iceoryx2 as iox2
import mirror_messages as messages

#: Later than every step. A position is a pair: episode, step.
NEVER = (0xFFFF_FFFF, 0xFFFF_FFFF)
#: Messages that an input holds before the oldest is lost.
INPUT_BUFFER = 64
#: Messages that an output holds back while it is not this process's turn.
MOST_HELD = 4

#: For how many nanoseconds the set was suspended: its launcher writes them while everybody is stopped.
_suspended = None


def follow_clock(path: str):
    """Follows the clock of an instance, whose page is this file."""
    global _suspended
    with open(path, "rb") as file:
        _suspended = mmap.mmap(file.fileno(), 8, prot=mmap.PROT_READ)


def now_ns() -> int:
    """The clock of all headers: CLOCK_MONOTONIC without the time for which the set was suspended."""
    stood_still = int.from_bytes(_suspended[:8], sys.byteorder) if _suspended else 0
    return time.monotonic_ns() - stood_still


def position_of(message):
    """Where in the run a message belongs: episode, step."""
    return (message.header.episode, message.header.step)


class Turn:
    """From when until when a process is active: of two that change places, every step is one's or the other's."""

    def __init__(self, standby: bool):
        self.begin = NEVER if standby else (0, 0)
        self.end = NEVER
        self.sent, self.passed, self.reached = None, None, None

    def is_active(self, position) -> bool:
        return self.begin <= position < self.end

    def is_standby(self) -> bool:
        return self.begin == NEVER

    def note_sent(self, position):
        self.sent = position if self.sent is None else max(self.sent, position)

    def note_passed(self, position):
        self.passed = position if self.passed is None else max(self.passed, position)

    def has_retired(self) -> bool:
        """Whether it owes nothing any more: there is no handover step to come to, or it has come there."""
        return self.end == NEVER or (self.reached is not None and self.reached >= self.end)

    def take_over(self, handover_step) -> bool:
        if self.passed is not None and self.passed >= handover_step:
            return False
        self.begin, self.end = handover_step, NEVER
        return True

    def hand_over(self, handover_step) -> bool:
        if self.sent is not None and self.sent >= handover_step:
            return False
        self.end = handover_step
        return True


class Output:
    """The sending side of a topic. A process that is on standby, or has handed over, holds its messages back."""

    def __init__(self, node, topic: str):
        service = node._open(topic)
        static = service.static_config
        # Room for what every receiver may hold; by itself iceoryx2 would reserve the recorder's buffer for everybody.
        slots = static.subscriber_max_buffer_size + static.history_size + 16
        slots += 8 * (INPUT_BUFFER + static.subscriber_max_borrowed_samples)
        self._publisher = (
            service.publisher_builder().max_loaned_samples(MOST_HELD + 4).override_sample_preallocation(slots).create()
        )
        self._notifier = node._open_bell(topic).notifier_builder().default_event_id(iox2.EventId.new(0)).create()
        self._node, self._type = node, messages.TOPICS[topic]
        # What the launcher hears is always said at once.
        self._gated = not topic.startswith("run/")
        self._held = deque()
        self.sent = 0

    def send(self, position, cause_ns: int, write):
        """Sends a message about a position, filled in by `write(message)`; what it leaves alone is zero."""
        loan = self._publisher.loan_uninit()
        ctypes.memset(loan.payload_ptr, 0, ctypes.sizeof(self._type))
        message = self._type.from_address(loan.payload_ptr)
        write(message)
        header = message.header
        header.run_id, header.cause_ns = self._node.arguments.run_id, cause_ns
        header.episode, header.step = position
        header.compute_ns = self._node.computed_ns(now_ns())
        turn = self._node.turn
        if self._gated:
            turn.reached = position
        if self._gated and not turn.is_active(position):
            if len(self._held) == MOST_HELD:
                turn.note_passed(self._held.popleft()[0])
            self._held.append((position, loan))
            return
        if self._gated:
            turn.note_sent(position)
        self._dispatch(loan)

    def _dispatch(self, loan):
        header = self._type.from_address(loan.payload_ptr).header
        header.sequence, header.sent_ns = self.sent, now_ns()
        self.sent += 1
        loan.assume_init().send()
        self._notifier.notify()

    def _release(self):
        """Sends what was held back and is now this process's to say."""
        turn = self._node.turn
        kept = deque()
        for position, loan in self._held:
            if turn.is_active(position):
                self._dispatch(loan)
                turn.note_sent(position)
            else:
                kept.append((position, loan))
        self._held = kept

    def _connect(self):
        self._publisher.update_connections()


class Input:
    """The receiving side of a topic: the newest message (real time), or every message in order (lockstep)."""

    def __init__(self, node, topic: str, in_order: bool):
        self._listener = node._open_bell(topic).listener_builder().create()
        service = node._open(topic)
        buffer = min(INPUT_BUFFER, service.static_config.subscriber_max_buffer_size)
        self._subscriber = service.subscriber_builder().buffer_size(buffer).create()
        self._node, self._type, self._in_order = node, messages.TOPICS[topic], in_order
        self._sample = None
        self._is_notified = True  # see `_drain`
        self._next = {}  # by sender, the sequence number that is expected
        self._created_ns = now_ns()
        self.topic, self.received, self.lost = topic, 0, 0
        #: The message taken last. It lies in shared memory and stays there until the next is taken.
        self.message = None

    def pending(self) -> bool:
        return self._subscriber.has_samples()

    def take(self) -> bool:
        """Takes a message: the newest that waits, or the next in order. False, and nothing changes, if none waits."""
        taken = False
        while (sample := self._subscriber.receive()) is not None:
            if self._sample is not None:
                self._sample.delete()
            self._sample, taken = sample, True
            self._is_notified = True
            self.message = self._type.from_address(sample.payload_ptr)
            self.received += 1
            self._count_gap(sample.header.publisher_id.value, self.message.header.sequence)
            if self._in_order:
                break
        return taken

    def position(self):
        return None if self.message is None else position_of(self.message)

    def advance_to(self, position):
        """Takes messages until one about `position`, or a later one, is the current one. True: it is there. None: it
        has not come yet. False: it will not come in order any more."""
        while True:
            here = self.position()
            if here is not None and here >= position:
                return here == position or not self._in_order
            if not self.take():
                return None

    def _count_gap(self, sender, sequence):
        expected = self._next.get(sender)
        if expected is None:
            # Who was there before the run started should have seen everything; a latecomer starts in the middle.
            was_there = 0 < self._created_ns < self._node.start_ns
            expected = 0 if was_there else sequence
        self._next[sender] = sequence + 1
        # What a process misses of steps that are another's to speak of is missing nowhere.
        begin = self._node.turn.begin
        if begin == (0, 0) or position_of(self.message) > begin:
            self.lost += max(0, sequence - expected)

    def _mark_notified(self):
        """Has the next `_drain` empty the listener: it was notified, or may be in need of it."""
        self._is_notified = True

    def _drain(self):
        """Empties the listener, and returns how many notifications it held. None, and nothing happens, where no message was
        taken since that was last done, and nothing marked it.
        """
        if not self._is_notified:
            return None
        notifications = sum(event.count for event in self._listener.try_wait())
        self._is_notified = False
        return notifications
