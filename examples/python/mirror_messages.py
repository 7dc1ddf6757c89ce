"""The messages of a MIRROR process set, byte for byte as the Rust processes lay them out in shared memory.

Generated from the Rust types, whose documentation says what each field means; do not edit. To write it anew:

    cargo run -p messages --example python_layouts > examples/python/mirror_messages.py
"""

import ctypes
from enum import IntEnum

AZIMUTHS = 36
HEIGHT_BANDS = 3
BEAMS = 108
EGO_VALUES = 5
SECTORS = 6
VERBAL = 120
LATENT = 128
ACTIONS = 2
CHOICES = 4
VISUAL_NUMBERS = 256
VERBAL_NUMBERS = 128
VISUAL_ITEMS = 16
VERBAL_ITEMS = 8
MAX_OBJECTS = 64
MAX_GROUP = 512

#: `Control.process` that addresses everybody.
EVERYBODY = 4294967295


class DomainNumber(IntEnum):
    """A domain."""

    HIGHWAY = 0
    DRIVING = 1
    SEARCH_RESCUE = 2
    BOMB_DEFUSAL = 3


class ObjectKind(IntEnum):
    """What an object on the highway is."""

    CAR = 0
    OTHER = 1


class EpisodeEnd(IntEnum):
    """Whether an episode goes on, and how it ended."""

    RUNNING = 0
    GOAL = 1
    COLLISION = 2
    OUT_OF_TIME = 3
    VOIDED = 4


class Presence(IntEnum):
    """Whether a person is at the wheel."""

    ABSENT = 0
    PRESENT = 1
    GIVEN_UP = 2


class CockpitEvent(IntEnum):
    """What a cockpit tells."""

    PRESENCE = 0
    HEARD = 1
    UNHEARD = 2
    SEEN = 3


class DecisionReason(IntEnum):
    """How a decision came about."""

    PLANNED = 0
    NO_PLANNER = 1
    HUMAN_SILENT = 2
    LATE = 3


class UtteranceContent(IntEnum):
    """What an utterance says."""

    NOTHING = 0
    SLOW = 1
    FAST = 2
    IN_WORDS = 3
    NOTICE = 4


class ImaginePhase(IntEnum):
    """What a question to the human model asks."""

    START = 0
    PERCEIVE = 1
    FORGET = 2
    COMPARE = 3


class ImagineStatus(IntEnum):
    """How the human model answered."""

    ANSWERED = 0
    NO_BELIEF = 1
    NO_GROUP = 2
    INCOMPARABLE = 3


class ControlCommand(IntEnum):
    """What the launcher asks of a process."""

    START = 1
    STOP = 2
    TAKE_OVER = 3
    REPORT = 4
    CONNECT = 5
    HAND_OVER = 6


class ProcessState(IntEnum):
    """Why a process reports."""

    READY = 1
    RUNNING = 2
    FINISHED = 3
    FAILED = 4
    CAUGHT_UP = 5
    HANDOVER_AGREED = 6
    TOO_LATE = 7
    RETIRED = 8


class Header(ctypes.Structure):
    LAYOUT = "mirror/Header/1 layout 79b8c58706d83b37"
    _fields_ = [
        ("run_id", ctypes.c_uint64),
        ("sequence", ctypes.c_uint64),
        ("sent_ns", ctypes.c_uint64),
        ("cause_ns", ctypes.c_uint64),
        ("compute_ns", ctypes.c_uint64),
        ("episode", ctypes.c_uint32),
        ("step", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/Header/1"


class LidarFrame(ctypes.Structure):
    LAYOUT = "mirror/LidarFrame/1 layout b68331de2b9332fe"
    _fields_ = [
        ("header", Header),
        ("range", ctypes.c_float * 108),
        ("object", ctypes.c_int32 * 36),
        ("speed_mps", ctypes.c_float * 36),
        ("ego", ctypes.c_float * 5),
        ("moving", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/LidarFrame/1"


class Observation(ctypes.Structure):
    LAYOUT = "mirror/Observation/2 layout 7889ae15c88d7626"
    _fields_ = [
        ("header", Header),
        ("visual", ctypes.c_float * 256),
        ("verbal", ctypes.c_float * 128),
        ("visual_len", ctypes.c_uint32),
        ("verbal_len", ctypes.c_uint32),
        ("domain", ctypes.c_uint32),
        ("legal", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/Observation/2"


class Picture(ctypes.Structure):
    LAYOUT = "mirror/Picture/1 layout 1991a10909834dc6"
    _fields_ = [
        ("header", Header),
        ("text", ctypes.c_uint8 * 1024),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/Picture/1"


class ObjectPose(ctypes.Structure):
    LAYOUT = "mirror/ObjectPose/1 layout d413802222b6d8ee"
    _fields_ = [
        ("x_m", ctypes.c_double),
        ("y_m", ctypes.c_double),
        ("heading_rad", ctypes.c_float),
        ("speed_mps", ctypes.c_float),
        ("length_m", ctypes.c_float),
        ("width_m", ctypes.c_float),
        ("id", ctypes.c_int32),
        ("kind", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/ObjectPose/1"


class Scene(ctypes.Structure):
    LAYOUT = "mirror/Scene/1 layout 65d893c53aca5c75"
    _fields_ = [
        ("header", Header),
        ("ego", ObjectPose),
        ("objects", ObjectPose * 64),
        ("count", ctypes.c_uint32),
        ("left_out", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/Scene/1"


class Outcome(ctypes.Structure):
    LAYOUT = "mirror/Outcome/2 layout ead2f26a1ea596af"
    _fields_ = [
        ("header", Header),
        ("reward", ctypes.c_float),
        ("speed", ctypes.c_float),
        ("brake", ctypes.c_float),
        ("steer", ctypes.c_float),
        ("change", ctypes.c_float),
        ("center", ctypes.c_float),
        ("proximity", ctypes.c_float),
        ("road", ctypes.c_float),
        ("collision", ctypes.c_float),
        ("terms", ctypes.c_float * 4),
        ("collided", ctypes.c_uint32),
        ("end", ctypes.c_uint32),
        ("other", ctypes.c_int32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/Outcome/2"


class RobotBelief(ctypes.Structure):
    LAYOUT = "mirror/RobotBelief/2 layout 74489725ed2fcf08"
    _fields_ = [
        ("header", Header),
        ("mean", ctypes.c_float * 128),
        ("deviation", ctypes.c_float * 128),
        ("visual", ctypes.c_float * 256),
        ("verbal", ctypes.c_float * 128),
        ("reward", ctypes.c_float),
        ("surprise", ctypes.c_float),
        ("latent", ctypes.c_uint32),
        ("visual_len", ctypes.c_uint32),
        ("verbal_len", ctypes.c_uint32),
        ("domain", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/RobotBelief/2"


class HumanBelief(ctypes.Structure):
    LAYOUT = "mirror/HumanBelief/2 layout 01cae98203b5e497"
    _fields_ = [
        ("header", Header),
        ("mean", ctypes.c_float * 128),
        ("deviation", ctypes.c_float * 128),
        ("action_mean", ctypes.c_float * 2),
        ("action_deviation", ctypes.c_float * 2),
        ("probability", ctypes.c_float * 4),
        ("kind", ctypes.c_uint8 * 16),
        ("latent", ctypes.c_uint32),
        ("log_likelihood", ctypes.c_float),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/HumanBelief/2"


class CommAction(ctypes.Structure):
    LAYOUT = "mirror/CommAction/3 layout aaa4e6b5cfa1d44f"
    _fields_ = [
        ("header", Header),
        ("visual_probability", ctypes.c_float * 16),
        ("verbal_probability", ctypes.c_float * 8),
        ("visual", ctypes.c_uint32),
        ("verbal", ctypes.c_uint32),
        ("value", ctypes.c_float),
        ("value_silent", ctypes.c_float),
        ("cost", ctypes.c_float),
        ("gain_now", ctypes.c_float),
        ("gain_later", ctypes.c_float),
        ("gain_error", ctypes.c_float),
        ("reason", ctypes.c_uint32),
        ("samples", ctypes.c_uint32),
        ("iterations", ctypes.c_uint32),
        ("futures", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/CommAction/3"


class Utterance(ctypes.Structure):
    LAYOUT = "mirror/Utterance/2 layout 1f311620f6b1c6a6"
    _fields_ = [
        ("text", ctypes.c_uint8 * 64),
        ("item", ctypes.c_uint32),
        ("kind", ctypes.c_uint32),
        ("range_m", ctypes.c_float),
        ("speed_mps", ctypes.c_float),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/Utterance/2"


class Display(ctypes.Structure):
    LAYOUT = "mirror/Display/2 layout a0901a834dfe7d49"
    _fields_ = [
        ("header", Header),
        ("utterances", Utterance * 8),
        ("utterance_count", ctypes.c_uint32),
        ("highlighted", ctypes.c_uint32),
        ("objects", ctypes.c_int32 * 16),
        ("object_count", ctypes.c_uint32),
        ("speech_ready_s", ctypes.c_float),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/Display/2"


class DriverAction(ctypes.Structure):
    LAYOUT = "mirror/DriverAction/2 layout 8e2b56c09d3f75df"
    _fields_ = [
        ("header", Header),
        ("throttle", ctypes.c_float),
        ("steer", ctypes.c_float),
        ("choice", ctypes.c_uint32),
        ("is_choice", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/DriverAction/2"


class Cockpit(ctypes.Structure):
    LAYOUT = "mirror/Cockpit/1 layout 9e1208af2efab2d9"
    _fields_ = [
        ("header", Header),
        ("happened_ns", ctypes.c_uint64),
        ("input_age_ns", ctypes.c_uint64),
        ("round_trip_ns", ctypes.c_uint64),
        ("text", ctypes.c_uint8 * 64),
        ("item", ctypes.c_uint32),
        ("event", ctypes.c_uint32),
        ("presence", ctypes.c_uint32),
        ("pages", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/Cockpit/1"


class ImagineRequest(ctypes.Structure):
    LAYOUT = "mirror/ImagineRequest/4 layout 68fef2d8c3139dfc"
    _fields_ = [
        ("header", Header),
        ("seed", ctypes.c_uint64),
        ("group", ctypes.c_uint32),
        ("phase", ctypes.c_uint32),
        ("rows", ctypes.c_uint32),
        ("first_future", ctypes.c_uint32),
        ("futures", ctypes.c_uint32),
        ("action_known", ctypes.c_uint32),
        ("action", ctypes.c_float * 4),
        ("visual_width", ctypes.c_uint32),
        ("verbal_width", ctypes.c_uint32),
        ("communicated", ctypes.c_uint32 * 512),
        ("visual", ctypes.c_float * 131072),
        ("verbal", ctypes.c_float * 65536),
        ("robot_mean", ctypes.c_float * 128),
        ("robot_deviation", ctypes.c_float * 128),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/ImagineRequest/4"


class ImagineAnswer(ctypes.Structure):
    LAYOUT = "mirror/ImagineAnswer/3 layout 2bb4119a6e3597e7"
    _fields_ = [
        ("header", Header),
        ("group", ctypes.c_uint32),
        ("rows", ctypes.c_uint32),
        ("status", ctypes.c_uint32),
        ("phase", ctypes.c_uint32),
        ("action", ctypes.c_float * 2048),
        ("divergence", ctypes.c_float * 512),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/ImagineAnswer/3"


class Control(ctypes.Structure):
    LAYOUT = "mirror/Control/1 layout 0495019d9ee05224"
    _fields_ = [
        ("header", Header),
        ("command", ctypes.c_uint32),
        ("process", ctypes.c_uint32),
        ("argument", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/Control/1"


class PortCount(ctypes.Structure):
    LAYOUT = "mirror/PortCount/1 layout 31f29576bfeee34d"
    _fields_ = [
        ("topic", ctypes.c_uint8 * 24),
        ("received", ctypes.c_uint64),
        ("lost", ctypes.c_uint64),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/PortCount/1"


class Report(ctypes.Structure):
    LAYOUT = "mirror/Report/2 layout 3c183460ff7f1ea8"
    _fields_ = [
        ("header", Header),
        ("process", ctypes.c_uint8 * 16),
        ("text", ctypes.c_uint8 * 256),
        ("ports", PortCount * 16),
        ("compute_ns", ctypes.c_uint64 * 5),
        ("steps", ctypes.c_uint64),
        ("missed_deadlines", ctypes.c_uint64),
        ("lost_wakeups", ctypes.c_uint64),
        ("allocations", ctypes.c_uint64),
        ("transport_allocations", ctypes.c_uint64),
        ("digest", ctypes.c_uint8 * 32),
        ("port_count", ctypes.c_uint32),
        ("index", ctypes.c_uint32),
        ("pid", ctypes.c_uint32),
        ("state", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/Report/2"


class Progress(ctypes.Structure):
    LAYOUT = "mirror/Progress/1 layout b8f804266f9519c4"
    _fields_ = [
        ("header", Header),
        ("process", ctypes.c_uint32),
        ("recorder", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name() -> str:
        return "mirror/Progress/1"


#: The message that travels on each topic.
TOPICS = {
    "world/lidar": LidarFrame,
    "world/observation": Observation,
    "world/picture": Picture,
    "world/scene": Scene,
    "world/motion": Scene,
    "world/outcome": Outcome,
    "belief/robot": RobotBelief,
    "belief/human": HumanBelief,
    "comm/action": CommAction,
    "comm/display": Display,
    "driver/action": DriverAction,
    "driver/cockpit": Cockpit,
    "human/imagine": ImagineRequest,
    "human/imagine/answer": ImagineAnswer,
    "run/control": Control,
    "run/report": Report,
    "run/progress": Progress,
}

#: Of every message: its bytes, and where each of its fields begins.
_PLACES = {
    Header: (48, [0, 8, 16, 24, 32, 40, 44]),
    LidarFrame: (792, [0, 48, 480, 624, 768, 788]),
    Observation: (1600, [0, 48, 1072, 1584, 1588, 1592, 1596]),
    Picture: (1072, [0, 48]),
    ObjectPose: (40, [0, 8, 16, 20, 24, 28, 32, 36]),
    Scene: (2656, [0, 48, 88, 2648, 2652]),
    Outcome: (112, [0, 48, 52, 56, 60, 64, 68, 72, 76, 80, 84, 100, 104, 108]),
    RobotBelief: (2632, [0, 48, 560, 1072, 2096, 2608, 2612, 2616, 2620, 2624, 2628]),
    HumanBelief: (1128, [0, 48, 560, 1072, 1080, 1088, 1104, 1120, 1124]),
    CommAction: (192, [0, 48, 112, 144, 148, 152, 156, 160, 164, 168, 172, 176, 180, 184, 188]),
    Utterance: (80, [0, 64, 68, 72, 76]),
    Display: (768, [0, 48, 688, 692, 696, 760, 764]),
    DriverAction: (64, [0, 48, 52, 56, 60]),
    Cockpit: (152, [0, 48, 56, 64, 72, 136, 140, 144, 148]),
    ImagineRequest: (789608, [0, 48, 56, 60, 64, 68, 72, 76, 80, 96, 100, 104, 2152, 526440, 788584, 789096]),
    ImagineAnswer: (10304, [0, 48, 52, 56, 60, 64, 8256]),
    Control: (64, [0, 48, 52, 56]),
    PortCount: (40, [0, 24, 32]),
    Report: (1088, [0, 48, 64, 320, 960, 1000, 1008, 1016, 1024, 1032, 1040, 1072, 1076, 1080, 1084]),
    Progress: (56, [0, 48, 52]),
}

for _structure, (_size, _offsets) in _PLACES.items():
    assert ctypes.sizeof(_structure) == _size, _structure
    assert [getattr(_structure, f[0]).offset for f in _structure._fields_] == _offsets, _structure
