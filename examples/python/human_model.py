#!/usr/bin/env python3
"""A human model in Python: another program in the place of a MIRROR set's human-model process.

    mirror up --exec human="python3 examples/python/human_model.py"
    mirror swap human --exec "python3 examples/python/human_model.py" --instance NAME      (and `swap human self` back)

Needs `pip install iceoryx2==0.10.* numpy`. To put your own model in, write a class with the methods of `SectorDriver`, and
hand it to `Mind` instead. `Mind` and `attend` are the part that every human model plays: it publishes what it believes of
the person after every step, and answers the planner's question what imagined people would do, whole groups at once.

In lockstep everybody waits for this process. In real time the planner waits 50 ms for an answer, and without one says
nothing and why (`DecisionReason.HUMAN_SILENT`); this model takes 1 to 3 ms for a group of 500 people.

The model: people remember, for each of the six sectors around the car, how far the nearest car is and how fast it comes
closer. They see as far as the fog lets them, see what is highlighted and hear what is said; what they do not see moves on in
their minds as it moved last, and is forgotten after some seconds. They follow the car ahead as the Intelligent Driver Model
does, keep their lane, and change it when the car ahead is in their way and they know of nobody beside them; hands and feet
come after only gradually.
"""

import argparse
import copy
import sys
from collections import deque

import numpy as np
from mirror_messages import ACTIONS, AZIMUTHS, BEAMS, EGO_VALUES, HEIGHT_BANDS, MAX_GROUP, SECTORS, VERBAL
from mirror_messages import ImaginePhase, ImagineStatus, UtteranceContent
from mirror_ports import now_ns, position_of
from mirror_process import Failure, Node, RunArguments

KIND = b"python"
#: Numbers of the visual modality.
LIDAR = BEAMS + EGO_VALUES
RANGE_M = 40.0
STEP_S = 0.15
#: Sectors, by azimuth of 10° anticlockwise from ahead: front, left front, left rear, rear, right rear, right front.
SECTOR_OF = np.repeat([0, 1, 2, 3, 4, 5], [1, 9, 8, 1, 8, 9])
FRONT, LEFT_FRONT, LEFT_REAR, RIGHT_REAR, RIGHT_FRONT = 0, 1, 2, 4, 5
#: A display shows the front half only.
ON_DISPLAY = (np.arange(AZIMUTHS) <= 9) | (np.arange(AZIMUTHS) >= 27)
#: How the planner scales the ego values, and what one of the car's own units is: rad, m/s, m, m, rad.
EGO_SCALE = np.array([60, 2, 2, 2, 60], np.float32)
EGO_UNIT = np.array([np.pi, 40 / 3.6, 1.75, 7.0, np.pi], np.float32)
#: Actions are kept this far inside (-1, 1) where their atanh is needed.
ACTION_EDGE = 0.97
GROUPS = 4


class People:
    """What people believe; the person is a group of one. Arrays are `people × sectors`, and `people × ego values`."""

    def __init__(self, rows: int):
        self.gap_m = np.full((rows, SECTORS), RANGE_M, np.float32)  # to the nearest car there; RANGE_M: none
        self.closing_mps = np.zeros((rows, SECTORS), np.float32)
        self.age = np.zeros((rows, SECTORS), np.float32)  # steps since they last knew
        self.ego = np.zeros((rows, EGO_VALUES), np.float32)  # rad, m/s, m, m, rad
        self.did = np.zeros((rows, ACTIONS), np.float32)  # atanh of their last action
        # Of that of their next; for the person, learned from what they do.
        self.deviation = np.tile(np.array([0.4, 0.2], np.float32), (rows, 1))

    def __len__(self) -> int:
        return len(self.gap_m)


class Chance:
    """What is left to chance in a question: people of one future share it, so that they differ by what they are told alone."""

    def __init__(self, seed: int, futures: int):
        self.random, self.futures = np.random.default_rng(seed), max(futures, 1)

    def standard_normal(self, shape, dtype=np.float32):
        """Of `shape`, whose first dimension are people: person j has what future j modulo `futures` has."""
        own = self.random.standard_normal((self.futures, *shape[1:]), dtype)
        return own[np.arange(shape[0]) % self.futures]


class SectorDriver:
    """People who know the nearest car of each sector."""

    FORGET_STEPS = 20  # 3 s
    INERTIA = 0.7  # how much of an action stays in the next
    WHEELBASE_M, FULL_STEER_RAD, LANE_M = 2.85, np.radians(20.0), 3.5
    DESIRED_MPS, HEADWAY_S, STANDSTILL_M = 38 / 3.6, 1.2, 2.2 + 2.35  # the LIDAR sits in the car's middle
    ACCELERATION, DECELERATION, FULL_THROTTLE, FULL_BRAKE, DRAG = 2.8, 3.0, 3.5, 8.0, 0.03

    def __init__(self, sight_m):
        """`sight_m`: how far people see ahead, to the sides and behind; in between, on ellipse arcs through these."""
        front, side, rear = sight_m
        angle = np.arange(AZIMUTHS) * (2 * np.pi / AZIMUTHS)
        ends = np.where(np.cos(angle) > 0, front, rear)
        self.sight_m = np.minimum(RANGE_M, 1 / np.hypot(np.cos(angle) / ends, np.sin(angle) / side))
        self.sector_sight_m = self._nearest(self.sight_m[None, :])[0]

    @staticmethod
    def _nearest(by_azimuth):
        """Minimum over each sector's azimuths: `people × 6`."""
        return np.minimum.reduceat(by_azimuth, [0, 1, 10, 18, 19, 27], axis=1)

    def reset(self) -> People:
        """The person, who has perceived nothing yet."""
        return People(1)

    def spread(self, person: People, rows: int, random: Chance) -> People:
        """A group of people who believe about what the person believes."""
        group = People(rows)
        for name, array in vars(person).items():
            getattr(group, name)[:] = array
        noise = random.standard_normal(group.gap_m.shape, np.float32)
        known = group.gap_m < RANGE_M
        group.gap_m += np.where(known, self.gap_deviation_m(group) * noise, 0)
        np.clip(group.gap_m, 0.5, RANGE_M, out=group.gap_m)
        return group

    @staticmethod
    def gap_deviation_m(people: People):
        """The longer ago they last saw a car, the less people know where it is."""
        return 0.5 + 0.3 * people.age

    def perceive(self, people: People, did, range_m, ego, shown, heard, heard_m):
        """Takes in what people could perceive in a step.

        `did`: atanh of the action that they took one step before, `people × 2`, zeros at the start; `range_m`: nearest
        return, `people × azimuths`; `ego`: `people × 5`, as in `People`; `shown`, `heard`: which sectors are highlighted
        and spoken about, `people × 6`; `heard_m`: the distances that are said.
        """
        highlighted = shown[:, SECTOR_OF] & ON_DISPLAY
        visible = highlighted | (range_m <= self.sight_m)
        seen_m = self._nearest(np.where(visible, range_m, RANGE_M))
        noticed = seen_m < 0.95 * RANGE_M
        expected_m = np.clip(people.gap_m - STEP_S * people.closing_mps, 0.5, RANGE_M)
        # Where a car should be in sight and is not, there is none.
        gone = (expected_m < self.sector_sight_m) | (people.age > self.FORGET_STEPS)
        gap_m = np.where(gone, RANGE_M, expected_m)
        gap_m = np.where(heard, heard_m, gap_m)
        gap_m = np.where(noticed, seen_m, gap_m).astype(np.float32)
        known = noticed | heard
        moved_mps = np.clip((people.gap_m - gap_m) / STEP_S, -15, 15)
        followed = noticed & (people.gap_m < RANGE_M) & (people.age == 0)
        closing_mps = np.where(followed, 0.6 * people.closing_mps + 0.4 * moved_mps, people.closing_mps)
        people.closing_mps = np.where(gap_m < RANGE_M, closing_mps, 0).astype(np.float32)
        people.gap_m = gap_m
        people.age = np.where(known, 0, people.age + 1).astype(np.float32)
        people.ego, people.did = ego, did

    def predict(self, people: People):
        """What they will do: mean and deviation of atanh(action), `people × 2` each."""
        heading, speed, aside, across, turn = people.ego.T
        ahead_m = np.maximum(people.gap_m[:, FRONT] - self.STANDSTILL_M, 0.5)
        braking = 2 * np.sqrt(self.ACCELERATION * self.DECELERATION)
        wanted_m = speed * (self.HEADWAY_S + people.closing_mps[:, FRONT] / braking)
        crowded = np.where(people.gap_m[:, FRONT] < RANGE_M, (np.maximum(wanted_m, 0) / ahead_m) ** 2, 0)
        acceleration = self.ACCELERATION * (1 - (speed / self.DESIRED_MPS) ** 4 - np.minimum(crowded, 9))
        push = acceleration + self.DRAG * speed
        pedal = push / np.where(push > 0, self.FULL_THROTTLE, self.FULL_BRAKE)
        # The other lane lies to the right of who drives left of the road's middle.
        to_right = across > 0
        beside_m = np.where(to_right, people.gap_m[:, RIGHT_FRONT], people.gap_m[:, LEFT_FRONT])
        behind = np.where(to_right, RIGHT_REAR, LEFT_REAR)[:, None]
        behind_m = np.take_along_axis(people.gap_m, behind, 1)[:, 0]
        comes_mps = np.maximum(np.take_along_axis(people.closing_mps, behind, 1)[:, 0], 0)
        changes = (crowded > 1.2) & (beside_m > 12) & (behind_m > 6 + 2 * comes_mps) & (speed > 2)
        target_m = np.where(changes, np.where(to_right, -self.LANE_M, self.LANE_M), 0) - aside
        speed = np.maximum(speed, 2)
        slant = np.clip(target_m / (0.8 * speed), -0.18, 0.18)
        curvature = turn / 10 + (slant - heading) / (0.45 * speed)
        steer = np.arctan(self.WHEELBASE_M * curvature) / self.FULL_STEER_RAD
        action = np.stack([pedal, steer], 1)
        mean = self.INERTIA * people.did + (1 - self.INERTIA) * unsquash(action)
        return mean.astype(np.float32), people.deviation

    def learn(self, person: People, missed):
        """`missed`: by how much the person's atanh(action) was another than the predicted mean."""
        variance = 0.95 * person.deviation**2 + 0.05 * np.minimum(missed**2, 4)
        person.deviation = np.clip(np.sqrt(variance), 0.05, 1.5).astype(np.float32)

    def describe(self, person: People):
        """The belief as numbers, of at most `LATENT`, and their deviations."""
        known = person.gap_m[0] < RANGE_M
        gap_deviation = np.where(known, self.gap_deviation_m(person)[0], 0) / RANGE_M
        mean = [*(person.gap_m[0] / RANGE_M), *(person.closing_mps[0] / 10)]
        return mean, [*gap_deviation, *(0.05 + 0.01 * person.age[0])]


class Mind:
    """The person in the eyes of a model: what they believe now, what they believed lately, and imagined groups of them."""

    def __init__(self, model):
        self.model = model
        self.position, self.before, self.people, self.expected = None, None, None, None
        # A real-time plan starts several times from the same step while the person moves on.
        self.remembered = deque(maxlen=4)
        self.groups = {}

    def follows(self, episode: int) -> bool:
        return self.position is not None and self.position[0] == episode

    def observe(self, frame, display, taken, belief):
        """Updates the belief with what the person could perceive, and `taken`, what they did one step before (none at an
        episode's start); writes it into `belief`, all but the header."""
        position = position_of(frame)
        if position != self.position:
            did, likelihood = np.zeros((1, ACTIONS), np.float32), 0.0
            if position[1] == 0 or not self.follows(position[0]):
                self.people = self.model.reset()
            elif taken is not None:
                did[0] = unsquash(taken)
                likelihood = self._learn(did[0])
            self.before = (self.people, did, likelihood)
        # In real time a step may be shown again, with a decision that came late: then it is perceived anew.
        before, did, belief.log_likelihood = self.before
        self.people, self.position = copy.deepcopy(before), position
        range_m = RANGE_M * np.ctypeslib.as_array(frame.range).reshape(1, HEIGHT_BANDS, AZIMUTHS).min(axis=1)
        ego = (np.ctypeslib.as_array(frame.ego) * EGO_UNIT)[None, :]
        heard, heard_m = np.zeros((1, SECTORS), bool), np.full((1, SECTORS), RANGE_M, np.float32)
        for utterance in display.utterances[: min(display.utterance_count, SECTORS)]:
            if utterance.item < SECTORS and utterance.kind <= UtteranceContent.FAST:
                heard[0, utterance.item] = True
                is_car = utterance.kind != UtteranceContent.NOTHING
                heard_m[0, utterance.item] = utterance.range_m if is_car else RANGE_M
        shown = bits_of(np.array([display.highlighted]))
        self.model.perceive(self.people, did, range_m, ego, shown, heard, heard_m)
        self.expected = self.model.predict(self.people)
        self.remembered.append((position, copy.deepcopy(self.people)))
        mean, deviation = self.model.describe(self.people)
        belief.latent = len(mean)
        belief.mean[: len(mean)] = mean
        belief.deviation[: len(mean)] = deviation
        belief.action_mean[:] = np.tanh(self.expected[0][0]).tolist()
        belief.action_deviation[:] = self.expected[1][0].tolist()
        belief.kind[: len(KIND)] = KIND

    def _learn(self, u) -> float:
        """How likely the action tanh(u) was, as the logarithm of a density over (-1, 1), before the model learns of it."""
        mean, deviation = self.expected[0][0], self.expected[1][0]
        density = -0.5 * ((u - mean) / deviation) ** 2 - np.log(deviation) - 0.5 * np.log(2 * np.pi)
        density -= np.log(1 - np.tanh(u) ** 2)
        self.model.learn(self.people, u - mean)
        return float(density.sum())

    def answer(self, question, answer):
        """Answers a question about a group of imagined people."""
        group, rows = question.group, question.rows
        answer.group, answer.phase, answer.rows, answer.status = group, question.phase, rows, ImagineStatus.NO_GROUP
        if group >= GROUPS or rows > MAX_GROUP:
            return
        starts = question.phase == ImaginePhase.START
        futures = question.futures if starts else self.groups[group][2] if group in self.groups else 1
        random = Chance(question.seed, futures)
        if starts and rows > 0:
            known = [people for position, people in self.remembered if position == position_of(question)]
            if not known:
                answer.status = ImagineStatus.NO_BELIEF
                return
            people = self.model.spread(known[-1], rows, random)
            if question.action_known:
                actions = np.tile(np.array(question.action[:ACTIONS], np.float32), (rows, 1))
            else:
                actions = self._act(people, random)
        elif question.phase == ImaginePhase.PERCEIVE and group in self.groups and rows >= len(self.groups[group][1]):
            people, before, _ = self.groups[group]
            people, before = joined(people, before, rows, futures)
            lidar = np.ctypeslib.as_array(question.visual)[: rows * LIDAR].reshape(rows, LIDAR)
            range_m = RANGE_M * (1 - lidar[:, :BEAMS].reshape(rows, HEIGHT_BANDS, AZIMUTHS).max(axis=1))
            ego = lidar[:, BEAMS:] * (EGO_UNIT / EGO_SCALE)
            told = np.ctypeslib.as_array(question.communicated)[:rows]
            heard = bits_of(told >> 8)
            # Of each sector's 20 numbers the last is the distance, in ranges.
            verbal = np.ctypeslib.as_array(question.verbal)[: rows * VERBAL].reshape(rows, VERBAL)
            each = VERBAL // SECTORS
            heard_m = RANGE_M * np.clip(verbal[:, each - 1 :: each], 0, 1) if heard.any() else RANGE_M
            self.model.perceive(people, unsquash(before), range_m, ego, bits_of(told), heard, heard_m)
            actions = self._act(people, random)
        elif question.phase == ImaginePhase.FORGET:
            self.groups.pop(group, None)
            answer.status = ImagineStatus.ANSWERED
            return
        else:
            return
        self.groups[group] = (people, actions, futures)
        np.ctypeslib.as_array(answer.action)[: rows * ACTIONS] = actions.reshape(-1)
        answer.status = ImagineStatus.ANSWERED

    def _act(self, people, random):
        mean, deviation = self.model.predict(people)
        return np.tanh(mean + deviation * random.standard_normal(mean.shape, np.float32))


def joined(people: People, actions, rows: int, futures: int):
    """A group of as many people as it had, or of more: those have been as the first of their future until now."""
    held = len(people)
    if rows > held:
        who = np.concatenate([np.arange(held), np.arange(held, rows) % max(futures, 1)])
        for name, array in vars(people).items():
            setattr(people, name, array[who])
        actions = actions[who]
    return people, actions


def unsquash(action):
    """atanh of actions, kept off the edge: people do press pedals to the floor."""
    return np.arctanh(np.clip(action, -ACTION_EDGE, ACTION_EDGE)).astype(np.float32)


def bits_of(words):
    """A bit per sector: `people × 6`."""
    return (words[:, None] >> np.arange(SECTORS) & 1).astype(bool)


def attend(node: Node, mind: Mind):
    """The human-model process: follows the person from step to step, and answers questions in between."""
    if node.arguments.options.get("gridworld"):
        raise Failure("this human model knows the highway alone, and the scene is a gridworld")
    lockstep = node.arguments.lockstep
    displays = node.input("comm/display", in_order=lockstep)
    lidar = node.input("world/lidar", in_order=lockstep)
    actions = node.input("driver/action", in_order=lockstep)
    questions = node.input("human/imagine", in_order=True)
    answers = node.output("human/imagine/answer")
    beliefs = node.output("belief/human")
    if not node.ready():
        return
    heard = None
    # A step begins with its display, the last of its inputs: until then questions start from the step before.
    while node.wait([displays, questions]):
        while questions.take():
            question = questions.message
            position = position_of(question)
            if node.is_active(position):
                answers.send(position, question.header.cause_ns, lambda answer: mind.answer(question, answer))
        if not displays.take():
            continue
        display = displays.message
        episode, step = displays.position()
        if lockstep and heard is not None and (episode, step) <= heard:  # Repeated by the successor of a renderer that died.
            continue
        heard = (episode, step)
        deadline_ns = None if lockstep else now_ns()
        there = node.wait_step(lidar, (episode, step), deadline_ns)
        if there is False:
            return
        if there is None:  # The display is older than what is left of its frames, for one that joined late.
            node.skip((episode, step))
            continue
        taken = None
        if step > 0 and mind.follows(episode):
            there = node.wait_step(actions, (episode, step - 1), deadline_ns)
            if there is False:
                return
            if there and actions.message is not None:
                taken = (actions.message.throttle, actions.message.steer)
        frame = lidar.message
        if frame is None:
            continue
        beliefs.send(position_of(frame), frame.header.cause_ns, lambda belief: mind.observe(frame, display, taken, belief))
        node.end_step()


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("run", metavar="RUN.json", help="the run's arguments; the launcher adds them")
    options.add_argument(
        "--sight",
        nargs=3,
        type=float,
        metavar=("FRONT_M", "SIDE_M", "REAR_M"),
        default=(15.0, 8.0, 3.0),
        help="how far people see; the default is the fog of the scene highway-fog",
    )
    given = options.parse_args()
    try:
        with Node(RunArguments(given.run)) as node:
            attend(node, Mind(SectorDriver(given.sight)))
    except Failure as failure:
        print(failure, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
