"""Writes the trajectories of this folder and the numbers of evo for them.

Usage: python make.py [GROUNDTRUTH_OF_TUM_FR1_RPY_CLIP]
Needs: evo 1.38.1, scipy 1.17.1, numpy 2.4.6. `evo_ape` and `evo_rpe` must be on PATH.
"""

import json
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
from evo.core import sync
from evo.core.metrics import RPE
from evo.tools import file_interface
from scipy.spatial.transform import Rotation

HERE = Path(__file__).resolve().parent


def quaternion(rotation_vector):
    """Unit quaternion x y z w of a rotation vector [rad]."""
    angle = np.linalg.norm(rotation_vector)
    if angle < 1e-12:
        return np.array([0.0, 0.0, 0.0, 1.0])
    return np.append(rotation_vector / angle * np.sin(angle / 2), np.cos(angle / 2))


def product(a, b):
    """Hamilton product of quaternions x y z w."""
    v = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(v, a[3] * b[3] - a[:3] @ b[:3])


def rotate(q, p):
    return p + 2 * np.cross(q[:3], np.cross(q[:3], p) + q[3] * p)


def write(name, rows):
    lines = ["%.6f %s" % (row[0], " ".join("%.9f" % v for v in row[1:])) for row in rows]
    (HERE / name).write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(lines) + "\n")


def walk(rate, seconds):
    """A camera that walks round a table, looking about."""
    rows = []
    for t in np.arange(0.0, seconds, 1.0 / rate):
        centre = [1.2 * np.cos(0.7 * t), 0.9 * np.sin(0.7 * t), 0.3 * np.sin(1.9 * t) + 1.4]
        turn = np.array([0.2 * np.sin(1.1 * t), 0.3 * np.cos(0.8 * t), 0.7 * t])
        rows.append(np.concatenate([[100.0 + t], centre, quaternion(turn)]))
    return np.array(rows)


def disturbed(rows, seed, scale, noise_m, noise_rad, jitter_s):
    """The same walk in another frame and scale, with drift and noise, at jittered times."""
    rng = np.random.default_rng(seed)
    frame = quaternion(np.array([0.5, -1.1, 2.0]))
    out, drift = [], np.zeros(3)
    for row in rows:
        drift += rng.normal(0, noise_m / 4, 3)
        centre = rotate(frame, row[1:4] * scale) + [3.0, -2.0, 0.7] + drift
        centre = centre + rng.normal(0, noise_m, 3)
        turn = product(product(frame, row[4:8]), quaternion(rng.normal(0, noise_rad, 3)))
        out.append(np.concatenate([[row[0] + rng.uniform(-jitter_s, jitter_s)], centre, turn]))
    return np.array(out)


def evo(tool, truth, estimate, *options):
    with tempfile.TemporaryDirectory() as folder:
        saved = Path(folder) / "result.zip"
        command = [tool, "tum", str(truth), str(estimate), "--t_max_diff", "0.02", "--silent"]
        command += ["--save_results", str(saved), "--no_warnings", *options]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        with zipfile.ZipFile(saved) as archive:
            stats = json.loads(archive.read("stats.json"))
            if "alignment_transformation_sim3.npy" in archive.namelist():
                with archive.open("alignment_transformation_sim3.npy") as file:
                    matrix = np.load(file)
                stats["scale"] = np.cbrt(np.linalg.det(matrix[:3, :3]))
            with archive.open("error_array.npy") as file:
                stats["count"] = len(np.load(file))
            return stats


def numbers(truth, estimate):
    table = {}
    runs = {
        "ape_se3": ("evo_ape", "-a"),
        "ape_sim3": ("evo_ape", "-a", "-s"),
        "rpe_translation": ("evo_rpe", "-r", "trans_part", "-d", "1", "-u", "f"),
        "rpe_rotation": ("evo_rpe", "-r", "angle_deg", "-d", "1", "-u", "f"),
        "rpe_5_translation": ("evo_rpe", "-r", "trans_part", "-d", "5", "-u", "f"),
        "rpe_5_rotation": ("evo_rpe", "-r", "angle_deg", "-d", "5", "-u", "f"),
        "rpe_5_all_translation": ("evo_rpe", "-r", "trans_part", "-d", "5", "-u", "f", "--all_pairs"),
        "rpe_5_all_rotation": ("evo_rpe", "-r", "angle_deg", "-d", "5", "-u", "f", "--all_pairs"),
    }
    for name, (tool, *options) in runs.items():
        stats = evo(tool, truth, estimate, *options)
        for key in ["rmse", "mean", "median", "max", "std", "count", "scale"]:
            if key in stats:
                table[f"{name}_{key}"] = stats[key]
    table |= drift_over_seconds(truth, estimate, 0.5)
    table["world_to_camera_mean"] = world_to_camera_mean(truth, estimate)
    return table


def associated(truth, estimate):
    """Poses of both files at the pairs that evo chooses, and the estimate's stamps."""
    a, b = (file_interface.read_tum_trajectory_file(f) for f in (truth, estimate))
    a, b = sync.associate_trajectories(a, b, max_diff=0.02)
    return a.poses_se3, b.poses_se3, b.timestamps


def drift_over_seconds(truth, estimate, seconds):
    """evo's error of a step on the pairs of the TUM benchmark's tool (fixed delta in seconds)."""
    truth, estimate, stamps = associated(truth, estimate)
    ends = [int(np.argmin(np.abs(stamps - (t + seconds)))) for t in stamps]
    pairs = [(i, j) for i, j in enumerate(ends) if j != len(stamps) - 1]
    errors = [RPE.rpe_base(truth[i], truth[j], estimate[i], estimate[j]) for i, j in pairs]
    translation = np.array([np.linalg.norm(e[:3, 3]) for e in errors])
    turns = [Rotation.from_matrix(e[:3, :3]).magnitude() for e in errors]
    table = {}
    for part, values in [("translation", translation), ("rotation", np.degrees(turns))]:
        of = {"rmse": np.sqrt((values**2).mean()), "mean": values.mean()}
        of |= {"median": np.median(values), "max": values.max(), "count": len(values)}
        table |= {f"rpe_seconds_{part}_{key}": value for key, value in of.items()}
    return table


def world_to_camera_mean(truth, estimate):
    """Mean distance of world-to-camera translations, world = first camera, after a rigid fit."""
    truth, estimate = (
        np.array([(np.linalg.inv(p) @ poses[0])[:3, 3] for p in poses])
        for poses in associated(truth, estimate)[:2]
    )
    # Rotation.align_vectors fits truth = R estimate on centred vectors.
    a, b = truth - truth.mean(axis=0), estimate - estimate.mean(axis=0)
    turn, _ = Rotation.align_vectors(a, b)
    return np.linalg.norm(a - turn.apply(b), axis=1).mean()


def save(name, table):
    (HERE / name).write_text("".join(f"{k} {v:.12g}\n" for k, v in table.items()))


def clip(truth):
    rows = np.loadtxt(truth)[::4]
    write("clip_estimate.txt", disturbed(rows, 3, 0.8, 0.01, 0.01, 0.004))
    save("clip.numbers", numbers(truth, HERE / "clip_estimate.txt"))


def main():
    truth = walk(60, 4.0)
    write("walk_truth.txt", truth)
    write("walk_estimate.txt", disturbed(truth[5::4], 1, 1.3, 0.02, 0.02, 0.006))
    save("walk.numbers", numbers(HERE / "walk_truth.txt", HERE / "walk_estimate.txt"))
    save("swapped.numbers", numbers(HERE / "walk_estimate.txt", HERE / "walk_truth.txt"))
    if len(sys.argv) > 1:
        clip(sys.argv[1])


main()
