#!/usr/bin/env python3
"""A Blender scene to an RGB-D sequence with motion blur, auto exposure and known truth.

    pip install bpy numpy
    python render_sequence.py --out DIR [--scene FILE.blend] [--trajectory POSES.txt] [options]

Renders with Cycles, and writes the layout of `i2slam synth` by the same formulas (docs/synthetic.md):
rgb/ depth/ sharp/ hdr/ rgb.txt depth.txt groundtruth.txt groundtruth_shutter.txt exposure.csv
camera.json README.md. The path is that of the scene's camera, or of --trajectory (TUM format,
world_from_camera, OpenCV axes; the groundtruth.txt of another sequence will do). Without --scene
a small room of the script's own is rendered, to try it.

Two passes: sharp frames give radiance, depth and exposure values; the exposure values give the
shutter; then every frame is rendered again with Cycles' motion blur. Pictures of a run that was
stopped are used again.
"""

import argparse
import math
import os
import struct
import sys
import zlib

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

GAMMA = 2.2
GREY = np.array([0.2126, 0.7152, 0.0722])
# Blender's camera looks along -z with y up; OpenCV's along z with y down.
BLENDER_FROM_OPENCV = Matrix.Diagonal((1.0, -1.0, -1.0, 1.0))
FARTHEST = 12.0  # metres
KEYS_PER_FRAME = 16


def arguments():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--out", required=True, help="folder for the sequence")
    p.add_argument("--scene", help=".blend file [default: a small room]")
    p.add_argument("--trajectory", help="poses in the TUM format [default: the scene's camera]")
    p.add_argument("--frames", type=int, default=80)
    p.add_argument("--fps", type=float, default=30.0)
    p.add_argument("--width", type=int, default=320)
    p.add_argument("--height", type=int, default=240)
    p.add_argument("--field-of-view", type=float, default=65.0, help="horizontal, degrees")
    p.add_argument("--samples", type=int, default=64, help="samples a pixel")
    p.add_argument("--smoothing", type=float, default=3.0, help="EV += (raw - EV) / this")
    p.add_argument("--shutter", type=float, nargs=2, default=(0.1, 1.0), metavar=("LEAST", "MOST"))
    p.add_argument("--seed", type=int, default=0, help="seed of Cycles")
    return p.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else None)


# Scene and camera -------------------------------------------------------------------------------


def open_scene(a):
    """The scene with its render settings; gives scene and camera object."""
    if a.scene:
        bpy.ops.wm.open_mainfile(filepath=os.path.abspath(a.scene))
    else:
        small_room(a)
    scene = bpy.context.scene
    camera = scene.camera
    if camera is None:
        sys.exit("the scene has no camera: add one, or make one active")
    scene.render.engine = "CYCLES"
    scene.cycles.samples = a.samples
    scene.cycles.seed = a.seed
    scene.cycles.use_denoising = True
    scene.cycles.pixel_filter_type = "BOX"
    scene.render.resolution_x, scene.render.resolution_y = a.width, a.height
    scene.render.resolution_percentage = 100
    scene.render.pixel_aspect_x = scene.render.pixel_aspect_y = 1.0
    scene.render.use_border = scene.render.use_compositing = scene.render.use_sequencer = False
    scene.render.film_transparent = False
    scene.view_settings.exposure, scene.view_settings.gamma = 0.0, 1.0
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.color_depth = "16"
    lens = camera.data
    lens.type, lens.sensor_fit = "PERSP", "HORIZONTAL"
    lens.angle = math.radians(a.field_of_view)
    lens.shift_x = lens.shift_y = 0.0
    lens.dof.use_dof = False
    if a.trajectory:
        animate(camera, read_trajectory(a.trajectory), scene, a.fps)
    camera.cycles.use_motion_blur, camera.cycles.motion_steps = True, 3
    return scene, camera


def read_trajectory(path):
    rows = [line.split() for line in open(path) if line.strip() and not line.startswith("#")]
    return sorted((tuple(map(float, row)) for row in rows), key=lambda row: row[0])


def pose_at(rows, time):
    """Location and rotation (OpenCV axes) between two rows: Lerp and Slerp."""
    after = next((i for i, row in enumerate(rows) if row[0] > time), len(rows) - 1)
    a, b = rows[max(after - 1, 0)], rows[after]
    u = 0.0 if b[0] == a[0] else min(max((time - a[0]) / (b[0] - a[0]), 0.0), 1.0)
    quaternion = lambda row: Quaternion((row[7], row[4], row[5], row[6]))
    return Vector(a[1:4]).lerp(Vector(b[1:4]), u), quaternion(a).slerp(quaternion(b), u)


def animate(camera, rows, scene, fps):
    """Keys so dense that straight lines between them do; times count from the first pose."""
    camera.animation_data_clear()
    camera.parent = None
    camera.constraints.clear()
    camera.rotation_mode = "QUATERNION"
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"
    start, last = rows[0][0], None
    for key in range(int((rows[-1][0] - start) * fps * KEYS_PER_FRAME) + 2 * KEYS_PER_FRAME):
        frame = (key - KEYS_PER_FRAME) / KEYS_PER_FRAME
        location, rotation = pose_at(rows, start + frame / fps)
        matrix = Matrix.Translation(location) @ rotation.to_matrix().to_4x4() @ BLENDER_FROM_OPENCV
        quaternion = matrix.to_quaternion()
        if last is not None and quaternion.dot(last) < 0.0:
            quaternion.negate()  # neighbours on one side of the sphere, or keys interpolate the long way
        camera.location, camera.rotation_quaternion, last = matrix.translation, quaternion, quaternion
        camera.keyframe_insert("location", frame=scene.frame_start + frame)
        camera.keyframe_insert("rotation_quaternion", frame=scene.frame_start + frame)


def go_to(scene, frame):
    """Frames count from the scene's first one and need not be whole."""
    whole = math.floor(scene.frame_start + frame)
    scene.frame_set(whole, subframe=scene.frame_start + frame - whole)


def world_from_camera(scene, camera, frame):
    """The pose in OpenCV axes."""
    go_to(scene, frame)
    matrix = camera.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world
    return matrix.normalized() @ BLENDER_FROM_OPENCV


# Pictures ---------------------------------------------------------------------------------------


def render(scene, frame, path, shutter=None):
    """Linear radiance (height, width, 3) of a frame, blurred over `shutter` frames if given."""
    scene.render.use_motion_blur = shutter is not None
    if shutter is not None:
        scene.render.motion_blur_shutter = shutter
        # The centre of the shutter is the frame's time; the setting has moved between versions.
        owner = scene.render if hasattr(scene.render, "motion_blur_position") else scene.cycles
        owner.motion_blur_position = "CENTER"
    if not os.path.exists(path):
        go_to(scene, frame)
        scene.render.filepath = path
        bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.empty(width * height * image.channels, dtype=np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, image.channels)[::-1, :, :3].astype(np.float64)
    bpy.data.images.remove(image)
    return pixels


def depth(scene, camera, frame, lens):
    """Z-depth at pixel centres [m], 0 where there is nothing within 12 m."""
    pose = world_from_camera(scene, camera, frame)
    rotation, origin = pose.to_3x3(), pose.translation
    graph = bpy.context.evaluated_depsgraph_get()
    out = np.zeros((lens["height"], lens["width"]))
    for row in range(lens["height"]):
        for column in range(lens["width"]):
            local = Vector((
                (column + 0.5 - lens["cx"]) / lens["fx"],
                (row + 0.5 - lens["cy"]) / lens["fy"],
                1.0,
            ))
            hit, place, *_ = scene.ray_cast(graph, origin, (rotation @ local).normalized())
            if hit:
                z = (place - origin).dot(rotation.col[2])
                out[row, column] = z if z <= FARTHEST else 0.0
    return out


def response(exposed):
    exposed = np.maximum(exposed, 0.0)
    return (exposed / (exposed + 1.0)) ** (1.0 / GAMMA)


def write_png(path, pixels):
    """uint8 (h, w, 3) or uint16 (h, w)."""
    height, width = pixels.shape[:2]
    deep = pixels.dtype == np.uint16
    raw = pixels.astype(">u2" if deep else np.uint8).reshape(height, -1).view(np.uint8)
    lines = np.hstack([np.zeros((height, 1), np.uint8), raw]).tobytes()

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", width, height, 16 if deep else 8, 0 if deep else 2, 0, 0, 0)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header))
        file.write(chunk(b"IDAT", zlib.compress(lines, 6)) + chunk(b"IEND", b""))


def write_colour(path, exposed):
    write_png(path, np.rint(255.0 * response(exposed)).clip(0, 255).astype(np.uint8))


# Formulas of the paper's appendix ---------------------------------------------------------------


def raw_exposure_value(radiance):
    """log2(CRF^-1(1/2) / median Y)"""
    median = np.median(radiance @ GREY)
    return math.log2(0.5**GAMMA / (1.0 - 0.5**GAMMA) / median) if median > 0.0 else None


def shutter_rule(values, least, most):
    """a, b of SV = a 2^EV + b"""
    gains = 2.0 ** np.array(values)
    if gains.max() - gains.min() <= 1e-6 * gains.max():
        return 0.0, 0.5 * (least + most)
    a = (most - least) / (gains.max() - gains.min())
    return a, least - a * gains.min()


def blur_length(z, lens, middle, ends):
    """Median over pixels of the distance between a point's places at shutter open and close [px]."""
    rows, columns = np.nonzero(z)
    if len(rows) == 0:
        return 0.0
    depths = z[rows, columns]
    points = np.stack([
        (columns + 0.5 - lens["cx"]) / lens["fx"] * depths,
        (rows + 0.5 - lens["cy"]) / lens["fy"] * depths,
        depths,
        np.ones_like(depths),
    ])
    places = []
    for end in ends:
        p = np.array(end.inverted() @ middle) @ points
        places.append(np.stack([lens["fx"] * p[0] / p[2], lens["fy"] * p[1] / p[2]]))
    return float(np.median(np.hypot(*(places[0] - places[1]))))


# The sequence -----------------------------------------------------------------------------------


def numbers(matrix):
    t, q = matrix.translation, matrix.to_quaternion()
    return f"{t.x:.7f} {t.y:.7f} {t.z:.7f} {q.x:.9f} {q.y:.9f} {q.z:.9f} {q.w:.9f}"


def text(folder, name, lines):
    with open(os.path.join(folder, name), "w") as file:
        file.write("\n".join(lines) + "\n")


def sharp_pass(a, scene, camera, lens):
    values, poses, depths = [], [], []
    for i in range(a.frames):
        radiance = render(scene, i, f"{a.out}/hdr/{i:06d}.exr")
        raw = raw_exposure_value(radiance)
        if not values:
            values.append(raw if raw is not None else 0.0)
        else:
            last = values[-1]
            values.append(last if raw is None else last + (raw - last) / a.smoothing)
        write_colour(f"{a.out}/sharp/{i:06d}.png", 2.0 ** values[-1] * radiance)
        z = depth(scene, camera, i, lens)
        write_png(f"{a.out}/depth/{i:06d}.png", np.rint(5000.0 * z).clip(0, 65535).astype(np.uint16))
        poses.append(world_from_camera(scene, camera, i))
        depths.append(z)
        print(f"sharp {i + 1}/{a.frames}  EV {values[-1]:.3f}", flush=True)
    return values, poses, depths


def blurred_pass(a, scene, camera, lens, values, poses, depths):
    slope, offset = shutter_rule(values, *a.shutter)
    table = ["frame,timestamp,ev,dt,shutter_fraction,shutter_seconds,blur_px_median,wb_r,wb_g,wb_b"]
    shutter_poses = [
        "# poses at shutter open and shutter close, world_from_camera, OpenCV axes",
        "# timestamp tx0 ty0 tz0 qx0 qy0 qz0 qw0 tx1 ty1 tz1 qx1 qy1 qz1 qw1",
    ]
    for i, value in enumerate(values):
        share = slope * 2.0**value + offset
        stamp = i / a.fps
        blurred = render(scene, i, f"{a.out}/.work/{i:06d}.exr", shutter=share)
        write_colour(f"{a.out}/rgb/{i:06d}.png", 2.0**value * blurred)
        ends = [world_from_camera(scene, camera, i + side * share / 2.0) for side in (-1.0, 1.0)]
        blur = blur_length(depths[i], lens, poses[i], ends)
        row = f"{i},{stamp:.6f},{value:.6f},{2.0**value:.6f},{share:.6f},{share / a.fps:.8f},{blur:.3f}"
        table.append(row + ",1,1,1")
        shutter_poses.append(f"{stamp:.6f} " + " ".join(map(numbers, ends)))
        print(f"blurred {i + 1}/{a.frames}  shutter {share:.3f}  blur {blur:.1f} px", flush=True)
    text(a.out, "exposure.csv", table)
    text(a.out, "groundtruth_shutter.txt", shutter_poses)
    return slope, offset


def write_rest(a, lens, poses, slope, offset):
    stamps = [i / a.fps for i in range(a.frames)]
    for kind, about in (("rgb", "colour images (motion-blurred)"), ("depth", "z-depth, 5000 = 1 m")):
        lines = [f"{t:.6f} {kind}/{i:06d}.png" for i, t in enumerate(stamps)]
        text(a.out, f"{kind}.txt", [f"# {about}", "# timestamp filename"] + lines)
    head = ["# world_from_camera at mid-exposure, OpenCV axes, metres", "# timestamp tx ty tz qx qy qz qw"]
    text(a.out, "groundtruth.txt", head + [f"{t:.6f} {numbers(p)}" for t, p in zip(stamps, poses)])
    keys = [f'  "{key}": {value!r},' for key, value in lens.items()]
    text(a.out, "camera.json", ["{"] + keys + [
        f'  "fps": {a.fps!r},',
        '  "depth_scale": 5000.0,',
        '  "pixel_centre": 0.5,',
        '  "distortion": [0, 0, 0, 0, 0],',
        f'  "shutter_a": {slope!r},',
        f'  "shutter_b": {offset!r}',
        "}",
    ])
    text(a.out, "README.md", [
        f"# Sequence of {a.scene or 'a small room'}, rendered with Cycles",
        "",
        f"{a.frames} frames at {a.fps} fps, {a.width}x{a.height}, {a.samples} samples a pixel. Same layout and",
        "formulas as `i2slam synth`: dt = 2^EV, EV follows the median grey to 127.5, SV = a 2^EV + b,",
        "rgb = round(255 ((dt B)/(dt B + 1))^(1/2.2)) with B the average of radiance over the shutter;",
        f"a = {slope:.6f}, b = {offset:.6f}. Depth is exact, from ray casts at pixel centres. No noise.",
        "Check and state the licence of the scene before passing this on.",
    ])


def small_room(a):
    """Floor, walls, boxes with a checked texture, a window of light, a moving camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene

    def material(name, colour, scale=0.0):
        made = bpy.data.materials.new(name)
        made.use_nodes = True
        shader = next(n for n in made.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
        shader.inputs["Base Color"].default_value = (*colour, 1.0)
        shader.inputs["Roughness"].default_value = 0.8
        if scale:
            nodes, links = made.node_tree.nodes, made.node_tree.links
            checks, place = nodes.new("ShaderNodeTexChecker"), nodes.new("ShaderNodeNewGeometry")
            checks.inputs["Scale"].default_value = scale
            checks.inputs["Color1"].default_value = (*colour, 1.0)
            checks.inputs["Color2"].default_value = (*(0.35 * c for c in colour), 1.0)
            links.new(place.outputs["Position"], checks.inputs["Vector"])
            links.new(checks.outputs["Color"], shader.inputs["Base Color"])
        return made

    def box(size, location, made):
        bpy.ops.mesh.primitive_cube_add(size=1.0, location=location)
        bpy.context.object.scale = size
        bpy.context.object.data.materials.append(made)

    wall, floor = material("wall", (0.7, 0.66, 0.6), 5.03), material("floor", (0.5, 0.3, 0.18), 3.07)
    box((5, 4, 0.1), (0, 0, -0.05), floor)
    box((5, 4, 0.1), (0, 0, 2.65), material("ceiling", (0.8, 0.8, 0.78)))
    for size, location in (
        ((0.1, 4, 2.6), (2.55, 0, 1.3)), ((0.1, 4, 2.6), (-2.55, 0, 1.3)),
        ((5, 0.1, 2.6), (0, 2.05, 1.3)), ((5, 0.1, 2.6), (0, -2.05, 1.3)),
    ):
        box(size, location, wall)
    rng = np.random.default_rng(a.seed)
    for i in range(9):
        x, y = rng.uniform(0.4, 2.1), rng.uniform(-1.5, 1.5)
        size = rng.uniform(0.25, 0.7, 3)
        box(size, (x, y, size[2] / 2), material(f"box {i}", rng.uniform(0.15, 0.8, 3), rng.uniform(8, 25)))
    light = bpy.data.lights.new("window", "AREA")
    light.energy, light.shape, light.size, light.size_y = 60.0, "RECTANGLE", 1.4, 1.2
    lamp = bpy.data.objects.new("window", light)
    lamp.location, lamp.rotation_euler = (0.8, 1.95, 1.7), (math.radians(-90), 0, 0)
    scene.collection.objects.link(lamp)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    rows = []
    for i in range(-5, a.frames + 6):
        t = i / a.fps
        yaw = 0.45 * math.sin(1.1 * t) + 0.04 * math.sin(23.0 * t)
        forward = Vector((math.cos(yaw), math.sin(yaw), -0.15 + 0.03 * math.sin(17.0 * t))).normalized()
        right = forward.cross(Vector((0, 0, 1))).normalized()
        axes = Matrix((right, forward.cross(right), forward)).transposed().to_quaternion()
        place = (-1.8 + 0.3 * t, 0.4 * math.sin(0.7 * t), 1.4)
        rows.append((t, *place, axes.x, axes.y, axes.z, axes.w))
    first = next(i for i, row in enumerate(rows) if abs(row[0]) < 1e-9)
    animate(camera, rows[first:], scene, a.fps)


def main():
    a = arguments()
    for folder in ("rgb", "depth", "sharp", "hdr", ".work"):
        os.makedirs(os.path.join(a.out, folder), exist_ok=True)
    a.out = os.path.abspath(a.out)
    scene, camera = open_scene(a)
    focal = 0.5 * a.width / math.tan(math.radians(a.field_of_view) / 2.0)
    lens = {"width": a.width, "height": a.height, "fx": focal, "fy": focal, "cx": a.width / 2, "cy": a.height / 2}
    values, poses, depths = sharp_pass(a, scene, camera, lens)
    slope, offset = blurred_pass(a, scene, camera, lens, values, poses, depths)
    write_rest(a, lens, poses, slope, offset)


if __name__ == "__main__":
    main()
