"""Rounds that you recorded yourself, as the file that `mirror train human --domain driving|search_rescue|bomb_defusal --demos` reads.

    python3 rounds.py DOMAIN original|transfer ROUNDS.csv OUT.safetensors

The table has a line per step, rounds one after the other: `round` (any name; a new one begins a new round), `action` (number of the
action that the person took), `reward`, `perceived` (optional: a bit per visual region that they saw, and from bit 32 on per utterance
that they heard; only `bc` and `sqil` use it), `step` (optional: counts up by one within a round, so that a lost line is noticed), then
the visual modality as `v0`, `v1`, … and the verbal one as `w0`, `w1`, …: what could be sensed before the action, as
`domains::discrete::Layout` orders it. Other columns are passed over. `bc` and `sqil` have to be told besides what limits the person's
sight: give `write_rounds` the `limits`. Nothing but Python's own library is needed.

Cells are separated by commas, numbers have a point. The text is UTF-8 or UTF-16, with or without a byte-order mark; spaces around
cells, empty lines, and empty cells past the last column do no harm. Whatever would have to be guessed is refused, with file and line.
"""

import csv
import io
import json
import re
import struct
import sys

DOMAINS = ("driving", "search_rescue", "bomb_defusal")
SETTINGS = ("original", "transfer")
NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
# Spreadsheets and data frames write whole numbers as `3.0`, too.
WHOLE = re.compile(r"([0-9]{1,20})(\.0*)?")


class TableError(Exception):
    """A table that cannot be read; says which, and where in it."""


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
        # A file's name may hold bytes that are no text.
        "mirror.command": source.encode("utf-8", "replace").decode(),
    }
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    with open(path, "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text + body)


def read_table(path):
    """The rounds of a table, as `write_rounds` wants them. `TableError` says what is wrong, and where."""
    with open(path, "rb") as file:
        data = file.read()
    # Strict: a quotation mark that is never closed would swallow the rest of the table.
    lines = csv.reader(io.StringIO(text_of(path, data), newline=""), strict=True)
    try:
        return rounds_of(path, lines)
    except csv.Error as error:
        raise TableError(f"{path}: line {max(lines.line_num, 1)}: {error}") from None


def text_of(path, data):
    """What a spreadsheet program wrote, as text."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif data[1:2] == b"\0":
        encoding = "utf-16-le"
    elif data[:1] == b"\0":
        encoding = "utf-16-be"
    else:
        encoding = "utf-8-sig"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        # Counted without a byte-order mark, which is no part of what was decoded.
        at = error.start + len(data) - len(error.object)
        line = 1 + data[:at].count(b"\n")
        name = "UTF-8" if encoding == "utf-8-sig" else "UTF-16"
        raise TableError(f"{path}: line {line}: byte {at} is not {name} text") from None


def rounds_of(path, lines):
    """The rounds of a table's lines."""

    def wrong(said):
        return TableError(f"{path}: line {max(lines.line_num, 1)}: {said}")

    columns, places = None, None
    rounds, began, last, step_before = [], {}, None, None
    for cells in lines:
        cells = [cell.strip() for cell in cells]
        if not any(cells):
            continue
        if columns is None:
            columns, places = cells, columns_of(cells, wrong)
            continue
        if len(cells) < len(columns) or any(cells[len(columns):]):
            hint = " (a comma within a number?)" if len(cells) > len(columns) else ""
            raise wrong(f"{len(cells)} cells, where the first line names {len(columns)} columns{hint}")

        def cell(name):
            return cells[places[name]]

        name = cell("round")
        if not name:
            raise wrong("round is empty")
        step = None if "step" not in places else whole(cell("step"), "step", 1 << 63, wrong)
        if name != last:
            if name in began:
                raise wrong(f"round {shown(name)} began at line {began[name]} and had ended: a round's steps stand one after the other")
            began[name], last = lines.line_num, name
            rounds.append([])
        elif step is not None and step != step_before + 1:
            raise wrong(f"step {step} follows step {step_before}: a step is missing or out of order")
        step_before = step
        perceived = cell("perceived") if "perceived" in places else ""
        rounds[-1].append(
            (
                whole(cell("action"), "action", 256, wrong),
                number(cell("reward"), "reward", wrong),
                whole(perceived or "0", "perceived", 1 << 64, wrong),
                [number(cells[place], columns[place], wrong) for place in places["v"]],
                [number(cells[place], columns[place], wrong) for place in places["w"]],
            )
        )
    if not rounds:
        raise TableError(f"{path}: there is no step in it")
    return rounds


def columns_of(columns, wrong):
    """Where each column stands: by name, and in order those of the modalities `v` and `w`."""
    places = {}
    for place, name in enumerate(columns):
        if name and name in places:
            raise wrong(f"column {shown(name)} stands twice")
        places[name] = place
    missing = [name for name in ("round", "action", "reward", "v0", "w0") if name not in places]
    for letter in "vw":
        # In ASCII digits: `v²` is a digit to Python, and no column.
        found = [name for name in places if re.fullmatch(letter + "(0|[1-9][0-9]{0,8})", name)]
        names = [f"{letter}{i}" for i in range(len(found))]
        missing += [name for name in names[1:] if name not in places]
        places[letter] = [places[name] for name in names if name in places]
    if missing:
        said = f"columns found: {', '.join(shown(name) for name in columns)}; missing: {', '.join(missing)}"
        if len(columns) == 1 and re.search("[;\t]", columns[0]):
            said += "; write a comma between cells, and a point in numbers"
        raise wrong(said)
    return places


def number(text, name, wrong):
    """A cell as a number that a 32-bit float holds."""
    if not NUMBER.fullmatch(text):
        hint = "; write a point, not a comma" if NUMBER.fullmatch(text.replace(",", ".", 1)) else ""
        raise wrong(f"{name} is {shown(text)}, which is no number{hint}")
    value = float(text)
    try:
        struct.pack("<f", value)
    except OverflowError:
        value = float("inf")
    if value in (float("inf"), float("-inf")):
        raise wrong(f"{name} is {shown(text)}, which no 32-bit number holds")
    return value


def whole(text, name, limit, wrong):
    """A cell as a whole number below `limit`."""
    found = WHOLE.fullmatch(text)
    if not found or int(found[1]) >= limit:
        raise wrong(f"{name} is {shown(text)}, which is no whole number from 0 to {limit - 1}")
    return int(found[1])


def shown(text):
    """Text for a message: quoted, and cut where it is long."""
    return repr(text if len(text) <= 60 else text[:60] + "…")


def main(arguments):
    """The command; its exit status."""
    if len(arguments) != 4 or arguments[0] not in DOMAINS or arguments[1] not in SETTINGS:
        print(f"usage: rounds.py {'|'.join(DOMAINS)} {'|'.join(SETTINGS)} ROUNDS.csv OUT.safetensors", file=sys.stderr)
        return 2
    domain, setting, table, out = arguments
    try:
        rounds = read_table(table)
        write_rounds(out, domain, setting, rounds, source="rounds.py " + table)
    except TableError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    print(f"{out}: {len(rounds)} rounds, {sum(len(round) for round in rounds)} steps")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
