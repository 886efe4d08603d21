"""Writes the values of the presets into the table of presets.md; the last column is kept.

usage: presets.py PROGRAM PRESETS.md        (Python 3.11)
"""

import pathlib
import subprocess
import sys
import tomllib

NAMES = ["paper-scannet", "paper-tum", "paper-synthetic", "default"]
BEGIN, END = "<!-- VALUES -->\n", "<!-- /VALUES -->\n"


def values(program, name):
    """All settings of a preset as {"section.key": value}."""
    text = subprocess.run([program, "presets", name], check=True, capture_output=True).stdout

    def flat(table, path):
        for key, value in table.items():
            if isinstance(value, dict):
                yield from flat(value, path + [key])
            else:
                yield ".".join(path + [key]), value

    return dict(flat(tomllib.loads(text.decode()), []))


def show(value):
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)


def main():
    program, path = sys.argv[1], pathlib.Path(sys.argv[2])
    before, rest = path.read_text().split(BEGIN)
    table, after = rest.split(END)
    rows = [line.strip("|").split("|") for line in table.splitlines()[2:]]
    sources = {row[0].strip(" `"): row[-1].strip() for row in rows}
    presets = [values(program, name) for name in NAMES]
    lines = ["| key | " + " | ".join(f"`{n}`" for n in NAMES) + " | source, and what was chosen |"]
    lines.append("|---" * (len(NAMES) + 2) + "|")
    for key in presets[0]:
        if key in ("preset", "i2slam_version"):
            continue
        cells = [show(preset[key]) for preset in presets]
        if not sources.get(key):
            print(f"{key}: no source is given", file=sys.stderr)
        lines.append(f"| `{key}` | {' | '.join(cells)} | {sources.get(key, '')} |")
    path.write_text(before + BEGIN + "\n".join(lines) + "\n" + END + after)


main()
