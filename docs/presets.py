"""Writes the table of presets.md: the values that the program prints.

usage: presets.py PROGRAM PRESETS.md        (Python 3.11)
"""

import pathlib
import subprocess
import sys
import tomllib

NAMES = ["default", "default-rgb", "paper-scannet", "paper-tum", "paper-synthetic", "paper-rgb"]
BEGIN, END = "<!-- VALUES -->\n", "<!-- /VALUES -->\n"


def values(program, name):
    """All settings of a preset as {"section.key": value}."""

    def flat(table, path):
        for key, value in table.items():
            if isinstance(value, dict):
                yield from flat(value, path + [key])
            else:
                yield ".".join(path + [key]), value

    printed = subprocess.run([program, "presets", name], check=True, capture_output=True).stdout
    return dict(flat(tomllib.loads(printed.decode()), []))


def show(value):
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)


def main():
    program, path = sys.argv[1], pathlib.Path(sys.argv[2])
    before, rest = path.read_text().split(BEGIN)
    _, after = rest.split(END)
    presets = [values(program, name) for name in NAMES]
    heads = ["key", *(f"`{name}`" for name in NAMES)]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    same = []
    for key in presets[0]:
        if key in ("preset", "i2slam_version"):
            continue
        cells = [show(preset[key]) for preset in presets]
        if len(set(cells)) == 1:
            same.append(f"`{key}` {cells[0]}")
        else:
            lines.append("| " + " | ".join([f"`{key}`", *cells]) + " |")
    lines += ["", "Equal in all presets: " + ", ".join(same) + "."]
    path.write_text(before + BEGIN + "\n".join(lines) + "\n" + END + after)


main()
