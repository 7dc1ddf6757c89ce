"""Rounds that you recorded yourself, as the file that `mirror train human --domain driving|search_rescue|bomb_defusal --demos` reads.

    python3 rounds.py DOMAIN original|transfer ROUNDS.csv OUT.safetensors

The table has a line per step, rounds one after the other: `round` (any name; a new one begins a new round), `action` (number of the
action that the person took), `reward`, `perceived` (optional: a bit per visual region that they saw, and from bit 32 on per utterance
that they heard; only `bc` and `sqil` use it), then the visual modality as `v0`, `v1`, … and the verbal one as `w0`, `w1`, …: what
could be sensed before the action, as `domains::discrete::Layout` orders it. `bc` and `sqil` have to be told besides what limits the
person's sight: give `write_rounds` the `limits`. Nothing but Python's own library is needed.
"""

import csv
import json
import struct
import sys


def write_rounds(path, domain, setting, rounds, heard=0, limits=None, source=""):
    """`rounds`: lists of steps (action, reward, perceived, visual numbers, verbal numbers). `heard`: a bit per utterance that the
    person hears without an assistant. `limits`: how far they see (4 numbers in driving, 1 in search and rescue) or how likely they notice
    each terminal (6, bomb defusal)."""
    steps = [step for round in rounds for step in round]
    columns = {
        "length": ("U64", "Q", [len(round) for round in rounds]),
        "action": ("U8", "B", [step[0] for step in steps]),
        "reward": ("F32", "f", [step[1] for step in steps]),
        "perceived": ("U64", "Q", [step[2] for step in steps]),
        "visual": ("F32", "f", [x for step in steps for x in step[3]]),
        "verbal": ("F32", "f", [x for step in steps for x in step[4]]),
    }
    if limits is not None:
        columns["limits"] = ("F32", "f", limits)
    # The widest numbers first, so that all lie where their type wants them.
    order = sorted(columns, key=lambda name: -struct.calcsize(columns[name][1]))
    header, body = {}, b""
    for name in order:
        dtype, code, numbers = columns[name]
        data = struct.pack(f"<{len(numbers)}{code}", *numbers)
        header[name] = {"dtype": dtype, "shape": [len(numbers)], "data_offsets": [len(body), len(body) + len(data)]}
        body += data
    header["__metadata__"] = {
        "mirror.checkpoint": "1",
        "mirror.holds": "demonstrations",
        "mirror.domain": domain,
        "mirror.setting": setting,
        "mirror.heard": str(heard),
        "mirror.rounds": str(len(rounds)),
        "mirror.command": source,
    }
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    with open(path, "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text + body)


def read_table(path):
    """The rounds of a table, as `write_rounds` wants them."""
    rounds, last = [], None
    with open(path, newline="") as file:
        table = csv.DictReader(file)
        names = {letter: modality_columns(path, table.fieldnames or [], letter) for letter in "vw"}
        for line in table:
            try:
                action = int(line["action"])
                if not 0 <= action < 256:
                    raise ValueError(f"action {action}")
                visual, verbal = ([float(line[name]) for name in names[letter]] for letter in "vw")
                step = action, float(line["reward"]), int(line.get("perceived") or 0), visual, verbal
                name = line["round"]
            except (KeyError, TypeError, ValueError) as error:
                sys.exit(f"{path}: line {table.line_num}: {type(error).__name__}: {error}")
            if name != last or not rounds:
                rounds.append([])
                last = name
            rounds[-1].append(step)
    if not rounds:
        sys.exit(f"{path}: there is no step in it")
    return rounds


def modality_columns(path, columns, letter):
    """The columns `v0`, `v1`, … of a modality, none left out."""
    found = {name for name in columns if name[:1] == letter and name[1:].isdigit()}
    names = [f"{letter}{i}" for i in range(len(found))]
    for name in names:
        if name not in found:
            sys.exit(f"{path}: line 1: there is no column {name}, though there are {len(found)} of its kind")
    return names


if __name__ == "__main__":
    if len(sys.argv) != 5 or sys.argv[2] not in ("original", "transfer"):
        sys.exit("usage: rounds.py DOMAIN original|transfer ROUNDS.csv OUT.safetensors")
    _, domain, setting, table, out = sys.argv
    try:
        write_rounds(out, domain, setting, read_table(table), source="rounds.py " + table)
    except OSError as error:
        sys.exit(f"{error.filename}: {error.strerror}")
