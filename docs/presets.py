"""Writes the table of presets.md: values, meanings and sources as the program prints them.

usage: presets.py PROGRAM PRESETS.md        (Python 3.11)
"""

import pathlib
import subprocess
import sys
import tomllib

NAMES = ["paper-scannet", "paper-tum", "paper-synthetic", "default", "paper-rgb", "default-rgb"]
BEGIN, END = "<!-- VALUES -->\n", "<!-- /VALUES -->\n"


def printed(program, name):
    return subprocess.run([program, "presets", name], check=True, capture_output=True).stdout.decode()


def values(text):
    """All settings of a preset as {"section.key": value}."""

    def flat(table, path):
        for key, value in table.items():
            if isinstance(value, dict):
                yield from flat(value, path + [key])
            else:
                yield ".".join(path + [key]), value

    return dict(flat(tomllib.loads(text), []))


def words(text):
    """Meaning and source of every setting, from the comments above it, as {"section.key": (…, …)}."""
    found, comment, section = {}, [], ""
    for line in text.splitlines():
        if line.startswith("#"):
            comment.append(line[1:].strip())
            continue
        if line.startswith("["):
            section = line.strip("[]") + "."
        elif " = " in line:
            meaning, _, source = " ".join(comment).partition("Source: ")
            found[section + line.split(" = ")[0]] = (meaning.strip(), source.strip())
        comment = []
    return found


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
    texts = [printed(program, name) for name in NAMES]
    presets, about = [values(text) for text in texts], words(texts[-1])
    heads = ["key", *(f"`{name}`" for name in NAMES), "meaning", "source, and what was chosen"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for key in presets[0]:
        if key in ("preset", "i2slam_version"):
            continue
        cells = [f"`{key}`", *(show(preset[key]) for preset in presets), *about[key]]
        lines.append("| " + " | ".join(cells) + " |")
    path.write_text(before + BEGIN + "\n".join(lines) + "\n" + END + after)


main()
