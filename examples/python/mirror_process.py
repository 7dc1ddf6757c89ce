"""A process of a MIRROR set, in Python: it joins a run, opens topics, waits, and keeps the launcher informed.

What a Rust process gets from the crate `runtime`, a Python process gets from here: the same topics with the same layout
check, headers and loss counts, the same conversation with the launcher (ready, start, take over, hand over, report,
stop), the same silence while it is on standby, and an end within a second when its launcher dies. Needs iceoryx2 0.10 from
PyPI and Linux. `human_model.py` shows how it is used.
"""

import bisect
import ctypes
import fcntl
import json
import os
import signal
import struct

import iceoryx2 as iox2
import mirror_messages as messages
from mirror_messages import EVERYBODY, ControlCommand, ProcessState
from mirror_ports import Input, Output, Turn, follow_clock, now_ns, position_of

#: Steps to read in silence before a process that is on standby says that it has caught up.
CATCH_UP_STEPS = 8
#: A sleeping process looks up this often, to connect to those that joined meanwhile, and to find what did not wake it.
LOOK_UP_NS = 250_000_000
#: Longest first sleep after a listener was emptied: longer than a sender takes from its message to its notification.
NAP_NS = 1_000_000


class Failure(Exception):
    """The process cannot go on; the text says why."""


class RunArguments:
    """What the launcher says about the run: the JSON file that it names as the last argument of the command line."""

    def __init__(self, path: str):
        try:
            with open(path, encoding="utf-8") as file:
                given = json.load(file)
            self.root, self.instance = given["root"], given["instance"]
            self.run_id, self.process, self.index = given["run_id"], given["process"], given["index"]
            self.launcher_pid = given["launcher_pid"]
            self.lockstep = given["clock"] == "lockstep"
            self.standby = given.get("standby", False)
            #: The process's own options, as the launcher would give them to the Rust process of that name.
            self.options = given.get("options") or {}
        except (OSError, ValueError, KeyError) as error:
            raise Failure(f"{path}: {error!r}") from error


def instance_prefix(arguments: RunArguments) -> str:
    """The start of all names that are an instance's."""
    place = f"{arguments.root}\n{arguments.instance}"
    hashed = 0xCBF2_9CE4_8422_2325
    for byte in place.encode():  # FNV-1a
        hashed = (hashed ^ byte) * 0x0000_0100_0000_01B3 % 2**64
    return f"m{hashed >> 32:08x}_"


def instance_config(arguments: RunArguments):
    """iceoryx2's configuration for an instance: its own root path and its own prefix."""
    config = iox2.config.default()
    config.global_cfg.root_path = iox2.Path.new(os.path.join(arguments.root, arguments.instance))
    config.global_cfg.prefix = iox2.FileName.new(instance_prefix(arguments))
    # The launcher cleans up, at moments of its own choosing.
    config.global_cfg.node.cleanup_dead_nodes_on_creation = False
    config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
    config.global_cfg.service.cleanup_dead_nodes_on_open = False
    return config


class Times:
    """Compute times, kept to three digits, tail and all."""

    def __init__(self):
        self._counts, self._longest, self._total = {}, 0, 0

    def record(self, ns: int):
        shift = max(0, ns.bit_length() - 10)
        key = (shift, ns >> shift)
        self._counts[key] = self._counts.get(key, 0) + 1
        self._longest, self._total = max(self._longest, ns), self._total + 1

    def summary_ns(self):
        """p50, p90, p99, p99.9 and the maximum; zeros if nothing was recorded."""
        if self._total == 0:
            return [0] * 5
        keys, so_far, sums = sorted(self._counts), 0, []
        for key in keys:
            so_far += self._counts[key]
            sums.append(so_far)
        at = [keys[bisect.bisect_left(sums, quantile * self._total)] for quantile in (0.5, 0.9, 0.99, 0.999)]
        return [min(value + 1 << shift, self._longest) for shift, value in at] + [self._longest]


class Node:
    """A process's place in a run. Used with `with`: what goes wrong inside is told to the launcher."""

    def __init__(self, arguments: RunArguments):
        self.arguments, self.turn, self.times = arguments, Turn(arguments.standby), Times()
        self.start_ns, self.steps, self.missed, self.lost_wakeups = 0, 0, 0, 0
        self._has_emptied = False
        self._stopped = self._leaving = self._started = False
        self._catch_up = CATCH_UP_STEPS if arguments.standby else 0
        self._banked_ns, self._woken_ns = 0, now_ns()
        self._inputs, self._outputs, self._waitsets, self._services = [], [], {}, []
        self._follow_launcher()
        clock = instance_prefix(arguments) + "clock"
        follow_clock(os.path.join(arguments.root, arguments.instance, clock))
        iox2.set_log_level(iox2.LogLevel.Error)
        self._config = instance_config(arguments)
        self._node = (
            iox2.NodeBuilder.new()
            .name(iox2.NodeName.new(arguments.process))
            .config(self._config)
            .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            .create(iox2.ServiceType.Ipc)
        )
        self._control = self.input("run/control", in_order=True)
        self._report = self.output("run/report")
        # The launcher's words are no business of the run's losses.
        self._inputs.remove(self._control)

    def _follow_launcher(self):
        """Ends with SIGTERM, with SIGINT, and with the launcher."""
        # A signal makes this descriptor readable, so that no wait can miss one that came just before it.
        self._wake_up, wake = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: self._stop())
        signal.signal(signal.SIGHUP, lambda *_: self._stop_with_launcher())
        self._launcher = -1
        pid = self.arguments.launcher_pid
        if pid == 0:
            return
        gone = Failure(f"the launcher (process {pid}) of instance {self.arguments.instance} is gone")
        try:
            self._launcher = os.pidfd_open(pid)
        except ProcessLookupError:
            raise gone from None
        if os.getppid() == pid:
            set_death_signal = 1  # PR_SET_PDEATHSIG
            ctypes.CDLL(None).prctl(set_death_signal, signal.SIGHUP)
        if os.getppid() != pid and not self._is_locked():
            raise gone  # and its number was given away

    def _is_locked(self) -> bool:
        """A living launcher holds its instance's lock."""
        question = struct.pack("hhqqi", fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
        try:
            with open(os.path.join(self.arguments.root, self.arguments.instance + ".lock"), "rb") as file:
                answer = fcntl.fcntl(file, fcntl.F_OFD_GETLK, question)
        except OSError:
            return False
        return struct.unpack_from("h", answer)[0] != fcntl.F_UNLCK

    def _stop(self):
        self._stopped = True

    def _stop_with_launcher(self):
        # The death signal also comes when only the launcher's thread that started this process ends.
        if os.getppid() != self.arguments.launcher_pid:
            self._stop()
            signal.alarm(1)  # ends a process too busy to look

    # Ports

    def output(self, topic: str) -> Output:
        """The sending side of a topic."""
        self._outputs.append(Output(self, topic))
        return self._outputs[-1]

    def input(self, topic: str, in_order: bool) -> Input:
        """The receiving side of a topic."""
        self._inputs.append(Input(self, topic, in_order))
        return self._inputs[-1]

    def _open(self, topic: str):
        """The topic's service, which the launcher has made: with this very layout, or not at all."""
        kind = messages.TOPICS[topic]
        key = iox2.AttributeKey.new("mirror.layout")
        verifier = iox2.AttributeVerifier.new().require(key, iox2.AttributeValue.new(kind.LAYOUT))
        name = iox2.ServiceName.new(topic)
        try:
            service = self._node.service_builder(name).publish_subscribe(kind).open_with_attributes(verifier)
        except iox2.PublishSubscribeOpenError as error:
            if "Incompatible" not in str(error):
                raise Failure(f"topic `{topic}`: could not open the service: {error}") from error
            pattern = iox2.MessagingPattern.PublishSubscribe
            details = iox2.Service.details(name, self._config, pattern, iox2.ServiceType.Ipc)
            theirs = [value.to_string() for value in details.attributes().key_values(key)] if details else []
            theirs = theirs[0] if theirs else "an unknown layout"
            raise Failure(f"topic `{topic}`: this process speaks {kind.LAYOUT}, the running set speaks {theirs}") from error
        self._services.append(service)
        return service

    def _open_bell(self, topic: str):
        """The event service of the same name, which wakes those who wait for the topic's messages."""
        service = self._node.service_builder(iox2.ServiceName.new(topic)).event().open()
        self._services.append(service)
        return service

    def connect(self):
        """Connects this process's outputs to those who joined since; inputs do so whenever they are looked at."""
        for output in self._outputs:
            output._connect()

    # Waiting

    def ready(self) -> bool:
        """Tells the launcher that all ports stand, and waits for its start. False if the run ends before it began."""
        self.connect()
        self._say(ProcessState.READY)
        while not self._started:
            if not self.wait([]):
                return False
        self.connect()
        self._banked_ns, self._woken_ns = 0, now_ns()
        return True

    def wait(self, inputs) -> bool:
        """Waits until a message waits at any of `inputs`. False: the process shall end."""
        # Also one that cannot keep pace, such as one on standby, hears the launcher.
        if inputs:
            self._serve_control()
        return self._wait_until(inputs, lambda: any(source.pending() for source in inputs), None)

    def wait_step(self, source: Input, position, deadline_ns=None):
        """Waits until `source` holds its message about `position`. True: it does, or, after the deadline, does not yet.
        None: in order, it will not come any more. False: the process shall end."""
        found = []

        def is_there():
            found[:] = [source.advance_to(position)]
            return found[0] is not None

        if not self._wait_until([source], is_there, deadline_ns):
            return False
        return None if found[0] is False else True

    def _wait_until(self, inputs, is_done, deadline_ns) -> bool:
        self._banked_ns = self.computed_ns(now_ns())
        try:
            while not self._stopped:
                # The launcher first: one that always has work waiting must hear it, too.
                was_started = self._started
                if self._serve_control():
                    if self._started != was_started:
                        return True
                    continue
                if is_done():
                    return True
                now = now_ns()
                if deadline_ns is not None and now >= deadline_ns:
                    return True
                # What is emptied is looked at again before the process sleeps.
                if not self._empty([self._control, *inputs]):
                    self._sleep(inputs, None if deadline_ns is None else deadline_ns - now)
            return False
        finally:
            self._woken_ns = now_ns()

    # iceoryx2 0.10 can swallow a wake-up: while a listener is emptied, the datagram of the next notification may be taken
    # away before its sender marks the listener as notified, after which nobody sends another. So the order is: empty,
    # look at the messages, sleep. A message whose datagram was swallowed is found by the look, since it is sent before;
    # and a listener from which a message was taken is emptied again before the next sleep, which resets the mark. The
    # first sleep after an emptying is a nap, for a message may have been taken before its notification. The Rust crate
    # `runtime` has the whole argument (`sleeper.rs`).

    def _empty(self, sources) -> bool:
        """Before a sleep: empties the listeners that need it. True: look at the messages again."""
        has_emptied = [source._drain() is not None for source in sources]
        self._has_emptied = self._has_emptied or any(has_emptied)
        return any(has_emptied)

    def _sleep(self, inputs, longest_ns):
        naps, self._has_emptied = self._has_emptied, False
        timeout_ns = NAP_NS if naps else LOOK_UP_NS
        looks_up = not naps
        if longest_ns is not None and longest_ns <= timeout_ns:
            timeout_ns, looks_up = longest_ns, False
        waitset, launcher, listeners = self._waitset(inputs)
        events, _ = waitset.wait_and_process_with_timeout(iox2.Duration.from_nanos(timeout_ns))
        try:
            os.read(self._wake_up, 512)
        except BlockingIOError:
            pass
        if launcher is not None and any(event.has_event_from(launcher) for event in events):
            self._stop()
            signal.alarm(1)
        for source, guard in listeners:
            if any(event.has_event_from(guard) for event in events):
                source._mark_notified()
        if not events:
            if not naps:
                self.connect()
            self._reset([source for source, _ in listeners], looks_up)

    def _reset(self, sources, looks_up: bool):
        """After a sleep that nothing ended: whatever is known of the listeners, they are emptied. What is found after a
        whole sleep did not wake this process though its sender meant to.
        """
        for source in sources:
            source._mark_notified()
            if source._drain() and looks_up and source.pending():
                self.lost_wakeups += 1

    def _waitset(self, inputs):
        """What to wait on for these inputs, made once for each combination of them."""
        key = tuple(id(source) for source in inputs)
        if key not in self._waitsets:
            disabled = iox2.SignalHandlingMode.Disabled
            waitset = iox2.WaitSetBuilder.new().signal_handling_mode(disabled).create(iox2.ServiceType.Ipc)
            sources = [self._control, *inputs]
            listeners = [(source, waitset.attach_notification(source._listener)) for source in sources]
            descriptor = iox2.FileDescriptor.non_owning_new
            wake_up = waitset.attach_notification_fd(descriptor(self._wake_up))
            launcher = None
            if self._launcher >= 0:
                launcher = waitset.attach_notification_fd(descriptor(self._launcher))
            self._waitsets[key] = (waitset, launcher, listeners, wake_up)
        return self._waitsets[key][:3]

    # The launcher

    def _serve_control(self) -> bool:
        heard = False
        while self._control.take():
            heard = True
            control = self._control.message
            if control.header.run_id != self.arguments.run_id:
                continue
            if control.process not in (EVERYBODY, self.arguments.index):
                continue
            handover_step = position_of(control)
            if control.command in (ControlCommand.START, ControlCommand.TAKE_OVER):
                if not self._started and control.process == EVERYBODY:
                    self.start_ns = control.header.sent_ns
                self._started = True
            if control.command == ControlCommand.STOP:
                # Who has handed over still owes what lies before the handover step, unless the run is over for everybody.
                self._leaving = True
                self._stopped = control.process == EVERYBODY or self.turn.has_retired()
            elif control.command == ControlCommand.REPORT:
                self._say(ProcessState.RUNNING)
            elif control.command == ControlCommand.CONNECT:
                self.connect()
            elif control.command == ControlCommand.TAKE_OVER:
                done = self.turn.take_over(handover_step)
                if done:
                    for source in self._inputs:  # What it missed while it stood by is missing nowhere.
                        source.received = source.lost = 0
                    self.connect()
                    self._release()
                self._say(ProcessState.HANDOVER_AGREED if done else ProcessState.TOO_LATE, about=handover_step)
            elif control.command == ControlCommand.HAND_OVER:
                done = self.turn.hand_over(handover_step)
                self._release()
                self._say(ProcessState.HANDOVER_AGREED if done else ProcessState.TOO_LATE, about=handover_step)
        return heard

    def _release(self):
        for output in self._outputs:
            output._release()

    def _say(self, state: ProcessState, text: str = "", about=None):
        def write(report):
            report.process = (ctypes.c_uint8 * 16)(*self.arguments.process.encode()[:16])
            line = text.encode()[:256].decode(errors="ignore").encode()
            report.text = (ctypes.c_uint8 * 256)(*line)
            report.compute_ns = (ctypes.c_uint64 * 5)(*self.times.summary_ns())
            report.steps, report.missed_deadlines = self.steps, self.missed
            report.lost_wakeups = self.lost_wakeups
            report.pid, report.index, report.state = os.getpid(), self.arguments.index, state
            report.port_count = min(len(self._inputs), len(report.ports))
            for port, source in zip(report.ports, self._inputs):
                port.topic = (ctypes.c_uint8 * 24)(*source.topic.encode()[:24])
                port.received, port.lost = source.received, source.lost

        self._report.send(about or self.turn.sent or (0, 0), 0, write)

    # Steps

    def is_active(self, position) -> bool:
        """Whether it is this process's to send what is about this position. Outputs heed it by themselves."""
        return self.turn.is_active(position)

    def skip(self, position):
        """This position passes without anything computed for it."""
        self.turn.note_passed(position)
        self.turn.reached = position

    def computed_ns(self, now: int) -> int:
        """What this step computed until `now`, without waiting."""
        return self._banked_ns + now - self._woken_ns

    def end_step(self):
        """Ends a step: its compute time is counted, and one on standby may have caught up with it."""
        now = now_ns()
        self.times.record(self.computed_ns(now))
        self._banked_ns, self._woken_ns = 0, now
        self.steps += 1
        self._stopped = self._stopped or (self._leaving and self.turn.has_retired())
        if self._catch_up > 0:
            self._catch_up -= 1
            if self._catch_up == 0 and self.turn.is_standby():
                self._say(ProcessState.CAUGHT_UP)

    def __enter__(self) -> "Node":
        return self

    def __exit__(self, kind, error, _trace):
        if error is None:
            self._say(ProcessState.FINISHED)
        else:
            self._say(ProcessState.FAILED, f"{error}" if isinstance(error, Failure) else f"{kind.__name__}: {error}")
        return False
