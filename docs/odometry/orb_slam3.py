"""ORB-SLAM3, by colour alone or with depth, for the table of docs/experiments/path.md.

    pip install orbslam3-python==2.0.0 numpy
    python3 orb_slam3.py train VOCABULARY.txt SEQUENCE...
    python3 orb_slam3.py run VOCABULARY.txt SEQUENCE OUT.txt [features] [seconds between frames]
    python3 orb_slam3.py rgbd VOCABULARY.txt SEQUENCE OUT.txt [features] [seconds between frames]

A sequence has rgb.txt and a camera.json with an undistorted camera (pixel centres at one half); without
one it is taken as TUM fr1. `rgbd` needs a copy made by `i2slam degrade`, whose depth has the number of its
picture, and leaves out pictures without depth. The package brings no vocabulary: `train` makes one of ten to the fourth words
from every fourth picture. OUT.txt gets `world_from_camera` of every tracked frame in the TUM format.
"""

import json
import os
import pathlib
import sys
import time

import cv2
import numpy as np

BRANCHES, LEVELS = 10, 4
TUM_FR1 = {
    "width": 640, "height": 480, "fx": 517.306408, "fy": 516.469215, "cx": 318.643040, "cy": 255.313989,
    "distortion": [0.262383, -0.953104, -0.005358, 0.002628, 1.163314],
}


def pictures(sequence):
    """Stamp and file of every picture."""
    lines = [line.split() for line in open(sequence / "rgb.txt") if line.strip() and line[0] != "#"]
    return [(float(stamp), str(sequence / name)) for stamp, name in lines]


def train(out, sequences):
    """Hierarchical k-majority in Hamming distance, leaves weighted by how rare they are."""
    orb, found = cv2.ORB_create(1000), []
    for sequence in sequences:
        for _, path in pictures(sequence)[::4]:
            descriptors = orb.detectAndCompute(cv2.imread(path, 0), None)[1]
            found += [] if descriptors is None else [descriptors]
    bits = np.unpackbits(np.vstack(found), axis=1).astype(np.float32)
    random, nodes = np.random.default_rng(0), []

    def split(members, parent, level):
        if len(members) <= BRANCHES:
            groups, centres = [np.array([m]) for m in members], bits[members]
        else:
            centres = bits[random.choice(members, BRANCHES, replace=False)]
            for _ in range(6):
                nearest = (bits[members] @ (1 - 2 * centres).T + centres.sum(1)).argmin(1)
                groups = [members[nearest == k] for k in range(BRANCHES)]
                means = [bits[g].mean(0) > 0.5 if len(g) else c for g, c in zip(groups, centres)]
                centres = np.stack(means).astype(np.float32)
        for group, centre in zip(groups, centres):
            if len(group):
                is_leaf = level == LEVELS or len(group) == 1
                nodes.append((parent, is_leaf, np.packbits(centre.astype(np.uint8)), len(group)))
                if not is_leaf:
                    split(group, len(nodes), level + 1)

    split(np.arange(len(bits)), 0, 1)
    total = sum(count for _, is_leaf, _, count in nodes if is_leaf)
    with open(out, "w") as file:
        file.write(f"{BRANCHES} {LEVELS} 0 0\n")
        for parent, is_leaf, descriptor, count in nodes:
            weight = np.log(total / count) if is_leaf else 0
            file.write(f"{parent} {int(is_leaf)} {' '.join(map(str, descriptor))} {weight}\n")


def settings(sequence, features):
    """Settings of ORB-SLAM3's examples for TUM RGB-D, with this camera; pixel centres at integers."""
    file = sequence / "camera.json"
    camera, half = (json.load(open(file)), 0.5) if file.is_file() else (TUM_FR1, 0.0)
    lens = dict(zip(["k1", "k2", "p1", "p2", "k3"], list(camera.get("distortion", [])) + [0] * 5))
    values = {
        "File.version": '"1.0"', "Camera.type": '"PinHole"',
        "Camera1.fx": float(camera["fx"]), "Camera1.fy": float(camera["fy"]),
        "Camera1.cx": float(camera["cx"] - half), "Camera1.cy": float(camera["cy"] - half),
        **{f"Camera1.{name}": float(value) for name, value in lens.items()},
        "Camera.width": camera["width"], "Camera.height": camera["height"],
        "Camera.fps": 30, "Camera.RGB": 1,
        "ORBextractor.nFeatures": features, "ORBextractor.scaleFactor": 1.2, "ORBextractor.nLevels": 8,
        "ORBextractor.iniThFAST": 20, "ORBextractor.minThFAST": 7,
        "Stereo.ThDepth": 40.0, "Stereo.b": 0.07732, "RGBD.DepthMapFactor": 5000.0,
        "Viewer.KeyFrameSize": 0.05, "Viewer.KeyFrameLineWidth": 1.0, "Viewer.GraphLineWidth": 0.9,
        "Viewer.PointSize": 2.0, "Viewer.CameraSize": 0.08, "Viewer.CameraLineWidth": 3.0,
        "Viewer.ViewpointX": 0.0, "Viewer.ViewpointY": -0.7, "Viewer.ViewpointZ": -1.8,
        "Viewer.ViewpointF": 500.0,
    }
    return "%YAML:1.0\n" + "".join(f"{name}: {value}\n" for name, value in values.items())


def quaternion(rotation):
    """x y z w."""
    vector = cv2.Rodrigues(rotation)[0][:, 0]
    angle = np.linalg.norm(vector)
    axis = vector / angle if angle > 1e-12 else vector
    return [*(np.sin(angle / 2) * axis), np.cos(angle / 2)]


def run(vocabulary, sequence, out, features, pause, with_depth):
    import orbslam3.orbslam3_enhanced as orbslam3

    file = pathlib.Path(out).with_suffix(".yaml")
    file.write_text(settings(sequence, features))
    sensor = orbslam3.Sensor.RGBD if with_depth else orbslam3.Sensor.MONOCULAR
    system = orbslam3.System(vocabulary, str(file), sensor)
    system.set_use_viewer(False)
    system.initialize()
    frames, tracked = pictures(sequence), 0
    for stamp, path in frames:
        colour = cv2.cvtColor(cv2.imread(path), cv2.COLOR_BGR2RGB)
        depth = sequence / "depth" / pathlib.Path(path).name
        if not with_depth:
            system.process_image_mono(colour, stamp)
        elif depth.is_file():
            system.process_image_rgbd(colour, cv2.imread(str(depth), cv2.IMREAD_UNCHANGED), stamp)
        else:
            continue
        tracked += system.get_tracking_state() == orbslam3.TrackingState.OK
        time.sleep(pause)
    time.sleep(2)
    with open(out, "w") as file:
        for stamp, camera_from_world in system.get_trajectory_points():
            pose = np.linalg.inv(np.array(camera_from_world, float))
            numbers = [stamp, *pose[:3, 3], *quaternion(pose[:3, :3])]
            file.write(" ".join(f"{number:.6f}" for number in numbers) + "\n")
    print(f"{tracked} of {len(frames)} frames tracked", flush=True)
    os._exit(0)  # its threads do not end by themselves


if sys.argv[1] == "train":
    train(sys.argv[2], [pathlib.Path(name) for name in sys.argv[3:]])
else:
    name, out, rest = pathlib.Path(sys.argv[3]), sys.argv[4], sys.argv[5:]
    features, pause = int(rest[0]) if rest else 2000, float(rest[1]) if rest[1:] else 0.15
    run(sys.argv[2], name, out, features, pause, sys.argv[1] == "rgbd")
