"""Runs the benches and writes their tables into performance.md, with plots beside it.

usage: performance.py [--from LOG] [TABLE ...]        (Python 3.9; PyTorch for one table)

Without names all tables are made anew: ten minutes on a quiet machine. `--from` reads tables from
the output of earlier benches instead of running them. Every table is also kept as
performance/TABLE.csv.
"""

import argparse
import csv
import importlib.util
import io
import math
import pathlib
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
PAGE, KEPT = HERE / "performance.md", HERE / "performance"

# Bench, package, and the words that ask for its tables; each line is a process of its own. Without
# a package a program beside this one, in PyTorch.
RUNS = [
    ("kernels", "i2slam-radiance", ["machine"]),
    ("kernels", "i2slam-radiance", ["stages", "step"]),
    ("kernels", "i2slam-radiance", ["size"]),
    ("kernels", "i2slam-radiance", ["memory"]),
    ("kernels", "i2slam-radiance", ["rays"]),
    ("hashgrid/reference.py", None, ["rays_pytorch"]),
    ("blur", "i2slam", ["steps"]),
    ("blur", "i2slam", ["quality"]),
    ("frame", "i2slam", ["frame", "presets"]),
]
# Tables that come with another.
WITH = {"stages": ["work"], "memory": ["bytes"]}


def run(bench, package, words):
    command = ["cargo", "bench", "-q", "-p", package, "--bench", bench, "--", *words]
    if package is None:
        if importlib.util.find_spec("torch") is None:
            print(f"{bench}: no PyTorch here, so its table stays as it was")
            return ""
        command = [sys.executable, str(HERE / bench)]
    print("$", " ".join(command), flush=True)
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=HERE.parent)
    return done.stdout


def tables(text):
    """{name: rows} of the sections of a bench's output; the first row is the header."""
    found, name = {}, None
    for line in text.splitlines():
        if line.startswith("# "):
            name = line[2:].strip()
        elif name and line.strip() and not line.startswith("time,"):
            found.setdefault(name, []).append(next(csv.reader(io.StringIO(line))))
    return found


def markdown(rows):
    head = [cell.replace("_", " ") for cell in rows[0]]
    lines = [head, ["---"] * len(head), *rows[1:]]
    return "".join("| " + " | ".join(row) + " |\n" for row in lines)


def put(page, name, text):
    begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->\n"
    if begin not in page:
        return page
    before, rest = page.split(begin, 1)
    return before + begin + text + end + rest.split(end, 1)[1]


def keep(name, rows):
    with open(KEPT / f"{name}.csv", "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


COLOURS = ["#1f6fb4", "#d4570f", "#2c8a3c", "#8a4bb0", "#777777", "#b01e4e"]
WIDTH, HEIGHT, KEY = 380, 300, 60
LEFT, RIGHT, TOP, BOTTOM = 56, 12, 30, 44


def short(value):
    """A number with k or M for thousands or millions."""
    for size, unit in ((1e6, " M"), (1e3, " k")):
        if value >= size:
            return f"{value / size:g}{unit}"
    return f"{value:g}"


class Panel:
    """One plot: lines of (x, y) by name."""

    def __init__(self, title, x, y, lines, log=(False, False)):
        self.title, self.x, self.y, self.lines = title, x, y, lines
        self.log = log
        spans = [[p[k] for line in lines.values() for p in line] for k in (0, 1)]
        self.low = [min(span) for span in spans]
        self.high = [max(span) for span in spans]

    def place(self, k, value):
        low, high = self.low[k], self.high[k]
        if self.log[k]:
            low, high, value = math.log10(low), math.log10(high), math.log10(value)
        part = (value - low) / ((high - low) or 1.0)
        if k == 0:
            return LEFT + part * (WIDTH - LEFT - RIGHT)
        return HEIGHT - BOTTOM - part * (HEIGHT - TOP - BOTTOM)

    def ticks(self, k):
        low, high = self.low[k], self.high[k]
        if self.log[k]:
            powers = range(math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9) + 1)
            return [10.0**n for n in powers]
        step = 10.0 ** math.floor(math.log10((high - low or 1.0) / 4))
        step *= next(m for m in (1, 2, 5, 10) if (high - low) / (m * step) <= 6)
        return [n * step for n in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]

    def svg(self, left):
        out = [f'<g transform="translate({left} 0)">']
        text = '<text x="{:.1f}" y="{:.1f}" text-anchor="{}">{}</text>'
        out.append(text.format((LEFT + WIDTH - RIGHT) / 2, 18, "middle", self.title))
        out.append(text.format((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 8, "middle", self.x))
        turned = f'<text transform="translate(14 {HEIGHT / 2}) rotate(-90)" text-anchor="middle">'
        out.append(f"{turned}{self.y}</text>")
        for k in (0, 1):
            for tick in self.ticks(k):
                at, label = self.place(k, tick), short(tick)
                ends = (at, TOP, at, HEIGHT - BOTTOM) if k == 0 else (LEFT, at, WIDTH - RIGHT, at)
                out.append('<path d="M{:.1f} {:.1f}L{:.1f} {:.1f}" stroke="#ddd"/>'.format(*ends))
                if k == 0:
                    out.append(text.format(at, HEIGHT - BOTTOM + 16, "middle", label))
                else:
                    out.append(text.format(LEFT - 5, at + 4, "end", label))
        for (name, line), colour in zip(self.lines.items(), COLOURS * 9):
            places = [(self.place(0, x), self.place(1, y)) for x, y in line]
            path = "L".join(f"{x:.1f} {y:.1f}" for x, y in places)
            out.append(f'<path d="M{path}" fill="none" stroke="{colour}" stroke-width="1.8"/>')
            out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{colour}"/>' for x, y in places]
        for k, (name, colour) in enumerate(zip(self.lines, COLOURS * 9)):
            x, y = LEFT + 160 * (k % 2), HEIGHT + 14 + 16 * (k // 2)
            out.append(f'<rect x="{x}" y="{y - 6}" width="12" height="4" fill="{colour}"/>')
            out.append(text.format(x + 16, y, "start", name))
        return "\n".join(out + ["</g>"])


def draw(name, panels):
    size = f'width="{WIDTH * len(panels)}" height="{HEIGHT + KEY}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif" font-size="11">'
    body = [panel.svg(WIDTH * k) for k, panel in enumerate(panels)]
    back = '<rect width="100%" height="100%" fill="white"/>'
    (KEPT / f"{name}.svg").write_text("\n".join([head, back, *body, "</svg>"]) + "\n")


def columns(rows):
    """Rows as dictionaries, numbers as numbers."""

    def number(cell):
        try:
            return float(cell)
        except ValueError:
            return cell

    return [dict(zip(rows[0], map(number, row))) for row in rows[1:]]


def plot_quality(rows):
    routes = ["sharp", "exact", "image", "image_without_margin"]
    panels = []
    for motion in dict.fromkeys(row["motion"] for row in rows):
        own = [row for row in rows if row["motion"] == motion and row["blur_px"] > 0]
        lines = {r.replace("image_without", "no").replace("_", " "): [(row["blur_px"], row[r]) for row in own] for r in routes if r in rows[0]}
        panels.append(Panel(motion, "blur [px]", "PSNR to 32 exact views [dB]", lines))
    draw("quality", panels)


def plot_size(rows):
    def panel(title, by, x, x_title):
        keys = list(dict.fromkeys(row[by] for row in rows))
        lines = {}
        for key in keys:
            own = [row for row in rows if row[by] == key]
            name = f"{key:g} px wide" if by == "width" else f"{short(key)} Gaussians"
            lines[name] = [(x(row), row["forward_ms"] + row["backward_ms"]) for row in own]
        return Panel(title, x_title, "forward and backward [ms]", lines, (True, True))

    gaussians = panel("by Gaussians", "width", lambda row: row["gaussians"], "Gaussians")
    pixels = panel("by pixels", "gaussians", lambda row: row["width"] * row["height"], "pixels")
    draw("size", [gaussians, pixels])


def plot_long(rows):
    memory = {"memory [GB]": [(row["frame"], row["memory_gb"]) for row in rows]}
    time = {"processor s": [(row["frame"], row["s_per_frame"]) for row in rows]}
    panels = [("memory while frames come", "GB", memory), ("time", "processor s a frame", time)]
    draw("long", [Panel(title, "frames", unit, line) for title, unit, line in panels])


def plot_stages(rows, machine):
    limits = machine[-1]
    peak, band = limits["gflop_per_s"], limits["read_gb_per_s"]
    own = [row for row in rows if row["mflop"] > 0]
    roof = [(x, min(peak, band * x)) for x in (0.1, 0.3, 1, 3, peak / band, 30, 100)]
    lines = {"roof": sorted(roof)}
    lines |= {row["stage"]: [(row["flop_per_byte"], row["mflop"] / row["ms"])] for row in own}
    panel = Panel("roofline", "FLOP per byte", "GFLOP/s", lines, (True, True))
    draw("roofline", [panel])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--from", dest="log", type=pathlib.Path)
    parser.add_argument("tables", nargs="*")
    asked = parser.parse_args()
    found = tables(asked.log.read_text()) if asked.log else {}
    for bench, package, words in RUNS if not asked.log else []:
        words = [word for word in words if not asked.tables or word in asked.tables]
        if words:
            found |= tables(run(bench, package, words))
    if asked.tables:
        wanted = {name for word in asked.tables for name in [word, *WITH.get(word, [])]}
        found = {name: rows for name, rows in found.items() if name in wanted}
    KEPT.mkdir(exist_ok=True)
    page = PAGE.read_text()
    for name, rows in found.items():
        if len(rows) < 2:
            print(f"{name}: the bench gave no rows, so the table stays as it was")
            continue
        keep(name, rows)
        page = put(page, name, markdown(rows))
    PAGE.write_text(page)
    every = {p.stem: columns(list(csv.reader(p.open()))) for p in KEPT.glob("*.csv")}
    plots = {"quality": plot_quality, "size": plot_size, "long": plot_long}
    for name, plot in plots.items():
        if every.get(name):
            plot(every[name])
    if every.get("stages") and every.get("machine"):
        plot_stages(every["stages"], every["machine"])


if __name__ == "__main__":
    main()
