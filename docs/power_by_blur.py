#!/usr/bin/env python3
"""Whether the blurred pictures of a rendered sequence are means of light.

    python3 docs/power_by_blur.py SEQUENCE [NOISE]

SEQUENCE has rgb/, sharp/, depth/, exposure.csv, groundtruth_shutter.txt and the response of Reinhard
(`i2slam synth` with response = "reinhard", or a path-traced sequence). A blurred pixel that saw the places u
of the sharp picture of its own frame during the exposure has

    ln x = (1/p) ln mean_u x_u^p + g

with the true response, motion and depth; p = 1 for means of light. Length and time of the exposure and the
gain g of each channel are unknowns beside p, as in crates/formation/src/blur_estimate/power.rs, but without
its instruments, as there is one sharp picture: what noise that has lowers p. NOISE is the deviation of more of
it, in 8-bit steps. It prints p of the eight frames with the most blur. Needs no packages.
"""

import csv
import json
import math
import random
import struct
import sys
import zlib
from pathlib import Path

FRAMES, PIXELS, MOMENTS = 8, 1500, 12
# Inverse of Reinhard's response at the 256 values; 255 may be clipped.
LINEAR = [u / (1 - u) for u in (min(max(v, 0.5) / 255, 0.9985) ** 2.2 for v in range(256))]


def read_png(path):
    """Rows of bytes, channels, of a PNG without interlacing."""
    data, at, packed = path.read_bytes(), 8, b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + 8 + length]
        at += 12 + length
        if kind == b"IHDR":
            width, height, bits, colour = struct.unpack(">IIBB", body[:10])
        if kind == b"IDAT":
            packed += body
    channels = {0: 1, 2: 3, 4: 2, 6: 4}[colour]
    step = channels * bits // 8
    stride, raw, rows, above = width * step, zlib.decompress(packed), [], bytearray(width * step)
    for y in range(height):
        start = y * (stride + 1)
        kind, row = raw[start], bytearray(raw[start + 1 : start + 1 + stride])
        for x in range(stride):
            left, up = row[x - step] if x >= step else 0, above[x]
            corner = above[x - step] if x >= step else 0
            row[x] = (row[x] + predicted(kind, left, up, corner)) & 255
        rows.append(row)
        above = row
    return rows, channels


def predicted(kind, left, up, corner):
    if kind < 4:
        return (0, left, up, (left + up) // 2)[kind]
    to_left, to_up, to_corner = abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)
    if to_left <= to_up and to_left <= to_corner:
        return left
    return up if to_up <= to_corner else corner


def between(first, second, share):
    """A pose (translation, quaternion) between two: (rotation matrix, translation)."""
    t = [a * (1 - share) + b * share for a, b in zip(first[:3], second[:3])]
    sign = 1 if sum(a * b for a, b in zip(first[3:], second[3:])) >= 0 else -1
    q = [a * (1 - share) + sign * b * share for a, b in zip(first[3:], second[3:])]
    norm = math.sqrt(sum(v * v for v in q))
    x, y, z, w = (v / norm for v in q)
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ], t


def cubic(t):
    """Weights of Keys' cubic convolution."""
    before, here = ((-t / 2 + 1) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1
    return [before, here, ((2 - 1.5 * t) * t + 0.5) * t, (t - 1) * t * t / 2]


def with_noise(rows, deviation):
    noisy = lambda value: min(max(round(random.gauss(value, deviation)), 0), 255)
    return [[noisy(value) for value in row] for row in rows] if deviation else rows


def observations(folder, camera, poses, colour, depth, noise):
    """(ln of the blurred value, ln of those that the pixel saw, channel) of random pixels of a frame."""
    blurred, channels = read_png(folder / colour)
    sharp, sharp_channels = read_png(folder / "sharp" / Path(colour).name)
    sharp, (ranges, _) = with_noise(sharp, noise), read_png(folder / depth)
    width, height = camera["width"], camera["height"]
    middle, origin = between(*poses, 0.5)
    moments = [between(*poses, (m + 0.5) / MOMENTS) for m in range(MOMENTS)]
    distance = lambda x, y: (ranges[y][2 * x] << 8 | ranges[y][2 * x + 1]) / camera["depth_scale"]
    found = []
    for _ in range(PIXELS):
        x, y = random.randrange(12, width - 12), random.randrange(12, height - 12)
        z = distance(x, y)
        edges = (distance(x + dx, y + dy) for dx, dy in ((8, 0), (-8, 0), (0, 8), (0, -8)))
        if z <= 0 or any(abs(other - z) > 0.03 * z for other in edges):
            continue
        ray = (x + 0.5 - camera["cx"]) / camera["fx"], (y + 0.5 - camera["cy"]) / camera["fy"], 1
        point = [z * part for part in ray]
        logs = [[], [], []]
        for rotation, translation in moments:
            rows = zip(rotation, translation, origin)
            world = [sum(r * p for r, p in zip(row, point)) + t - o for row, t, o in rows]
            seen = [sum(middle[k][axis] * world[k] for k in range(3)) for axis in range(3)]
            u = camera["fx"] * seen[0] / seen[2] + camera["cx"] - 0.5
            v = camera["fy"] * seen[1] / seen[2] + camera["cy"] - 0.5
            column, row = math.floor(u), math.floor(v)
            if not (1 <= column < width - 2 and 1 <= row < height - 2):
                break
            across, down = cubic(u - column), cubic(v - row)
            for c in range(3):
                around = [sharp[row - 1 + j][(column - 1) * sharp_channels + c :: sharp_channels] for j in range(4)]
                light = [sum(w * LINEAR[v] for w, v in zip(across, line)) for line in around]
                value = sum(w * line for w, line in zip(down, light))
                logs[c].append(math.log(max(value, 1e-4)))
        for c in range(3):
            value = blurred[y][x * channels + c]
            is_exposed = 15 < value < 247 and all(-4.5 < log < 2.5 for log in logs[c])
            if len(logs[c]) == MOMENTS and is_exposed:
                found.append((math.log(LINEAR[value]), logs[c], c))
    return found


def solve(matrix, right):
    rows = [row + [value] for row, value in zip(matrix, right)]
    for i in range(len(rows)):
        pivot = max(range(i, len(rows)), key=lambda r: abs(rows[r][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for r in range(len(rows)):
            if r != i:
                factor = rows[r][i] / rows[i][i]
                rows[r] = [a - factor * b for a, b in zip(rows[r], rows[i])]
    return [row[-1] / row[i] for i, row in enumerate(rows)]


def power(found):
    """p by Gauss-Newton with Geman and McClure's weights."""
    unknowns = [1.0] + [0.0] * 5
    for _ in range(8):
        p, length, time, *gains = unknowns
        terms = []
        for blurred, logs, channel in found:
            mean = sum(logs) / MOMENTS
            raised = [math.exp(p * (log - mean)) for log in logs]
            total = sum(raised) / MOMENTS
            first, last = 1.5 * raised[0] - 0.5 * raised[1], 1.5 * raised[-1] - 0.5 * raised[-2]
            by_power = sum((log - mean) * r for log, r in zip(logs, raised)) / (MOMENTS * total * p)
            slopes = [0.0] * 6
            slopes[0] = by_power - math.log(total) / p**2
            slopes[1] = ((first + last) / total / 2 - 1) / p
            slopes[2] = (last - first) / total / p
            slopes[3 + channel] = 1.0
            shown = mean + math.log(total) / p + gains[channel]
            terms.append((blurred - shown - length * slopes[1] - time * slopes[2], slopes))
        deviation = max(1.48 * sorted(abs(r) for r, _ in terms)[len(terms) // 2], 0.005)
        matrix, right = [[1e-9 * (i == j) for j in range(6)] for i in range(6)], [0.0] * 6
        for residual, slopes in terms:
            weight = (1 + (residual / (2 * deviation)) ** 2) ** -2
            for i in range(6):
                right[i] += weight * slopes[i] * residual
                for j in range(6):
                    matrix[i][j] += weight * slopes[i] * slopes[j]
        step = solve(matrix, right)
        step[0] = min(max(step[0], -0.3), 0.3)
        unknowns = [a + b for a, b in zip(unknowns, step)]
    return unknowns[0]


def main():
    folder, noise = Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 0.0
    random.seed(1)
    camera = json.loads((folder / "camera.json").read_text())
    lines = lambda name: [l.split() for l in (folder / name).read_text().splitlines() if l and l[0] != "#"]
    blur = [float(row["blur_px_median"]) for row in csv.DictReader((folder / "exposure.csv").open())]
    shutter = [[float(v) for v in line[1:]] for line in lines("groundtruth_shutter.txt")]
    colour, depth = ([line[1] for line in lines(name)] for name in ("rgb.txt", "depth.txt"))
    powers = []
    for frame in sorted(range(len(blur)), key=lambda i: -blur[i])[:FRAMES]:
        poses = shutter[frame][:7], shutter[frame][7:]
        found = observations(folder, camera, poses, colour[frame], depth[frame], noise)
        powers.append(power(found))
        print(f"frame {frame}, {blur[frame]:.1f} px, {len(found)} observations: p = {powers[-1]:.2f}")
    mean = sum(powers) / len(powers)
    spread = math.sqrt(sum((p - mean) ** 2 for p in powers) / (len(powers) - 1))
    print(f"p = {mean:.2f} ± {spread / math.sqrt(len(powers)):.2f}")


if __name__ == "__main__":
    main()
