"""Mutated tables of rounds: `examples/python/rounds.py` reads each or refuses it with the file's name and the line, and never fails
otherwise. Called with the path of `rounds.py` and how many tables to try; all in one process, for starting Python takes longer."""

import importlib.util
import os
import random
import sys
import tempfile

NUMBERS = ["1e39", "-1", "NaN", "inf", "1e999", "0", "1_0", "9223372036854775808", "340282366920938463463374607431768211456", "0,5", "", '"', "１"]


def table():
    names = ["round", "step", "action", "reward", "perceived"] + [f"v{i}" for i in range(5)] + [f"w{i}" for i in range(8)]
    lines = [",".join(names)]
    for number in range(3):
        for step in range(4):
            numbers = [f"{0.1 * step - place:.3f}" for place in range(13)]
            lines.append(",".join([f"r{number}", str(step), str(step % 4), "-0.5", str(1 << 33), *numbers]))
    return "\n".join(lines) + "\n"


def mutate(text, chance):
    encoding = chance.choice(["utf-8", "utf-8", "utf-8-sig", "utf-16", "utf-16-le", "latin-1"])
    for _ in range(chance.randint(1, 3)):
        lines = text.split("\n")
        at = chance.randrange(len(lines))
        cells = lines[at].split(",")
        place = chance.randrange(len(cells))
        kind = chance.randrange(8)
        if kind == 0:
            cells[place] = chance.choice(NUMBERS)
        elif kind == 1:
            del cells[place]
        elif kind == 2:
            cells.insert(place, cells[place])
        elif kind == 3:
            cells[place] = chance.choice([' {} ', '"{}"', '"{}', "{}\t", "é{}"]).format(cells[place])
        lines[at] = chance.choice([",", ",", ",", ";", "\t", ", "]).join(cells)
        if kind == 4:
            del lines[at]
        elif kind == 5:
            lines.insert(at, lines[chance.randrange(len(lines))])
        elif kind == 6:
            lines[at:] = lines[at + 1 :] + [lines[at]]
        text = chance.choice(["\n", "\n", "\r\n", "\n\n"]).join(lines)
    data = bytearray(text.encode(encoding, "replace"))
    for _ in range(chance.choice([0, 0, 0, 1, 4])):
        data[chance.randrange(len(data))] = chance.randrange(256)
    if chance.randrange(8) == 0:
        del data[chance.randrange(len(data)) :]
    return bytes(data)


def main(script, count):
    spec = importlib.util.spec_from_file_location("rounds", script)
    rounds = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(rounds)
    read = refused = 0
    with tempfile.TemporaryDirectory() as folder:
        path, out = os.path.join(folder, "rounds.csv"), os.path.join(folder, "rounds.safetensors")
        for number in range(count):
            data = mutate(table(), random.Random(number))
            with open(path, "wb") as file:
                file.write(data)
            try:
                rounds.write_rounds(out, "driving", "transfer", rounds.read_table(path))
                read += 1
            except rounds.TableError as error:
                refused += 1
                assert str(error).startswith(path + ": "), f"table {number}: {error}"
            except Exception as error:
                sys.exit(f"table {number}: {type(error).__name__}: {error}")
    assert read and refused, (read, refused)
    print(f"{read} read, {refused} refused")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
