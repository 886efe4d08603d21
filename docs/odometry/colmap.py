"""The camera path of a sequence by COLMAP, to be set beside our own front end.

    pip install pycolmap==4.2.1
    python3 docs/odometry/colmap.py SEQUENCE OUT.txt [--stride N] [--threads N]
    i2slam eval --align sim3 --groundtruth SEQUENCE/groundtruth.txt OUT.txt

Known pinhole camera (camera.json, else --camera), SIFT on the CPU, all pairs matched, incremental
reconstruction with the intrinsics held; everything else as COLMAP has it by default. The largest
model is written in the TUM format, world_from_camera.
"""

import argparse
import json
import shutil
import tempfile
import time
from pathlib import Path

import pycolmap


def pictures(sequence, stride):
    """Stamp and path of every stride-th colour picture."""
    lines = (sequence / "rgb.txt").read_text().splitlines()
    rows = [line.split() for line in lines if line and not line.startswith("#")]
    return [(float(stamp), sequence / name) for stamp, name in rows][::stride]


def intrinsics(sequence, given):
    """fx, fy, cx, cy, pixel centres at one half as COLMAP has them."""
    if given:
        return [float(value) for value in given.split(",")]
    camera = json.loads((sequence / "camera.json").read_text())
    return [camera[name] for name in ("fx", "fy", "cx", "cy")]


def reconstruct(frames, camera, folder, threads):
    """The largest model that COLMAP finds."""
    images = folder / "images"
    images.mkdir()
    for index, (_, path) in enumerate(frames):
        shutil.copy(path, images / f"{index:06}{path.suffix}")
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE"
    reader.camera_params = ",".join(str(value) for value in camera)
    extraction = pycolmap.FeatureExtractionOptions()
    matching = pycolmap.FeatureMatchingOptions()
    pipeline = pycolmap.IncrementalPipelineOptions()
    for options in (extraction, matching, pipeline):
        options.num_threads = threads
    pipeline.ba_refine_focal_length = False
    pipeline.ba_refine_principal_point = False
    pipeline.ba_refine_extra_params = False
    database = folder / "database.db"
    cpu = pycolmap.Device.cpu
    pycolmap.extract_features(
        database, images, camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader, extraction_options=extraction, device=cpu,
    )
    pycolmap.match_exhaustive(database, matching_options=matching, device=cpu)
    models = pycolmap.incremental_mapping(database, images, folder, options=pipeline)
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def write_path(model, frames, out):
    """world_from_camera of every registered picture: stamp, t, q as x y z w."""
    lines = []
    for image in model.images.values():
        if not image.has_pose:
            continue
        pose = image.cam_from_world().inverse()
        stamp = frames[int(Path(image.name).stem)][0]
        numbers = [*pose.translation, *pose.rotation.quat]
        lines.append((stamp, " ".join(f"{number:.9f}" for number in numbers)))
    out.write_text("".join(f"{stamp:.6f} {rest}\n" for stamp, rest in sorted(lines)))
    return len(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequence", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--stride", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--camera", help="fx,fy,cx,cy, pixel centres at one half")
    arguments = parser.parse_args()
    frames = pictures(arguments.sequence, arguments.stride)
    begin = time.time()
    with tempfile.TemporaryDirectory() as folder:
        camera = intrinsics(arguments.sequence, arguments.camera)
        model = reconstruct(frames, camera, Path(folder), arguments.threads)
        if model is None:
            raise SystemExit("COLMAP found no model")
        count = write_path(model, frames, arguments.out)
    print(f"{count} of {len(frames)} frames posed, {time.time() - begin:.0f} s")


if __name__ == "__main__":
    main()
