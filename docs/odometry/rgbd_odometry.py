"""Frame-to-frame odometry with depth, for the table of docs/experiments/path.md.

    pip install opencv-contrib-python-headless==4.10.0.84 open3d==0.19.0 numpy
    i2slam degrade SEQUENCE --out COPY        # undistorted, in the TUM layout, with camera.json
    python3 rgbd_odometry.py METHOD COPY OUT.txt

METHOD is photometric, rgbd-icp or icp (OpenCV), or open3d (its hybrid term). Frames without depth get
no pose; a step that fails counts as no motion. OUT.txt gets `world_from_camera` in the TUM format.
"""

import json
import pathlib
import sys

import cv2
import numpy as np

NEAREST_M, FARTHEST_M = 0.3, 6.0


def frames(folder):
    """Stamp, colour and depth file of every frame that has depth."""
    lists = []
    for name in ("rgb.txt", "depth.txt"):
        lines = [line.split() for line in open(folder / name) if line.strip() and line[0] != "#"]
        lists.append([(float(stamp), folder / file) for stamp, file in lines])
    depth = {file.name: (stamp, file) for stamp, file in lists[1]}
    # The copy numbers colour and depth alike.
    found = [(stamp, file, depth[file.name]) for stamp, file in lists[0] if file.name in depth]
    return [(stamp, file, other) for stamp, file, (_, other) in found]


def opencv_step(method, matrix):
    create = {
        "photometric": cv2.rgbd.RgbdOdometry_create,
        "rgbd-icp": cv2.rgbd.RgbdICPOdometry_create,
        "icp": cv2.rgbd.ICPOdometry_create,
    }[method]
    odometry = create(matrix)
    for name, value in [("MinDepth", NEAREST_M), ("MaxDepth", FARTHEST_M)]:
        getattr(odometry, f"set{name}")(value)

    def step(before, now):
        sides = []
        for colour, depth in (before, now):
            grey = cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY)
            sides += [grey, depth, (depth > 0).astype(np.uint8) * 255]
        done, transform = odometry.compute(*sides, None)
        return transform if done else None

    return step


def open3d_step(matrix, size):
    import open3d as o3d

    camera = o3d.camera.PinholeCameraIntrinsic(*size, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
    option = o3d.pipelines.odometry.OdometryOption()
    term = o3d.pipelines.odometry.RGBDOdometryJacobianFromHybridTerm()

    def image(colour, depth):
        return o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(np.ascontiguousarray(colour[:, :, ::-1])), o3d.geometry.Image(depth),
            depth_scale=1.0, depth_trunc=FARTHEST_M,
        )

    def step(before, now):
        done, transform, _ = o3d.pipelines.odometry.compute_rgbd_odometry(
            image(*before), image(*now), camera, np.eye(4), term, option
        )
        return transform if done else None

    return step


def quaternion(rotation):
    """x y z w."""
    vector = cv2.Rodrigues(rotation)[0][:, 0]
    angle = np.linalg.norm(vector)
    axis = vector / angle if angle > 1e-12 else vector
    return [*(np.sin(angle / 2) * axis), np.cos(angle / 2)]


def main():
    method, folder, out = sys.argv[1], pathlib.Path(sys.argv[2]), sys.argv[3]
    camera = json.load(open(folder / "camera.json"))
    # Pixel centres at integers.
    matrix = np.array(
        [[camera["fx"], 0, camera["cx"] - 0.5], [0, camera["fy"], camera["cy"] - 0.5], [0, 0, 1]]
    )
    step = open3d_step(matrix, (camera["width"], camera["height"])) if method == "open3d" else (
        opencv_step(method, matrix)
    )
    world_from_camera, before, failed = np.eye(4), None, 0
    with open(out, "w") as file:
        for stamp, colour, depth in frames(folder):
            metres = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED).astype(np.float32) / 5000
            now = (cv2.imread(str(colour)), metres)
            if before is not None:
                now_from_before = step(before, now)
                failed += now_from_before is None
                if now_from_before is not None:
                    world_from_camera = world_from_camera @ np.linalg.inv(now_from_before)
            before = now
            numbers = [*world_from_camera[:3, 3], *quaternion(world_from_camera[:3, :3])]
            file.write(f"{stamp:.6f} " + " ".join(f"{n:.7f}" for n in numbers) + "\n")
    print(f"{failed} steps failed")


main()
