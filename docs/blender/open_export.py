"""Makes a Blender scene of two exports of one result: the mesh, and the camera along its path.

    i2slam export RESULT --format mesh --out room.glb
    i2slam export RESULT --format nerfstudio --out room-pictures
    blender --background --python docs/blender/open_export.py -- room.glb room-pictures room.blend

Both exports must have the same `--up`. The camera has the lens of the recording, stands where
each picture was taken at the frame of its number, and has that picture as its background. Also runs with `pip install bpy`
(`python3 open_export.py room.glb room-pictures room.blend`); tried with 5.0.1.
"""

import argparse
import json
import os
import sys

import bpy
from mathutils import Matrix


def parse():
    own = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]
    parser = argparse.ArgumentParser(prog="open_export.py")
    parser.add_argument("mesh", help="of `i2slam export --format mesh`, .glb")
    parser.add_argument("pictures", help="of `i2slam export --format nerfstudio`, a folder")
    parser.add_argument("scene", help="the .blend file to write")
    parser.add_argument("--fps", type=int, default=30, help="pictures a second of the recording")
    return parser.parse_args(own)


def camera_of(transforms):
    """A camera with the lens of the pictures; its sensor is 36 mm wide."""
    width, height = transforms["w"], transforms["h"]
    data = bpy.data.cameras.new("filmed")
    data.sensor_fit, data.sensor_width = "HORIZONTAL", 36.0
    data.lens = transforms["fl_x"] / width * data.sensor_width
    data.shift_x = 0.5 - transforms["cx"] / width
    data.shift_y = (transforms["cy"] - height / 2) / width
    data.clip_start = 0.01
    camera = bpy.data.objects.new("filmed", data)
    bpy.context.collection.objects.link(camera)
    return camera


def numbers(frames):
    """Frames of the timeline: the numbers in the pictures' names, from 1 on."""
    named = [int(os.path.splitext(os.path.basename(f["file_path"]))[0]) for f in frames]
    return [number - named[0] + 1 for number in named], named[0] - 1


def animate(camera, frames):
    """Sets the pose of every frame. Axes are Blender's: z up; the camera looks along its -z."""
    camera.rotation_mode = "QUATERNION"
    before = None
    for number, frame in zip(numbers(frames)[0], frames):
        pose = Matrix(frame["transform_matrix"])
        turn = pose.to_quaternion()
        # Of two quaternions for one rotation the nearer one, for the frames between.
        if before is not None and before.dot(turn) < 0:
            turn.negate()
        camera.location, camera.rotation_quaternion, before = pose.to_translation(), turn, turn
        camera.keyframe_insert("location", frame=number)
        camera.keyframe_insert("rotation_quaternion", frame=number)


def show_pictures(camera, folder, frames):
    """Puts the pictures behind the view of the camera."""
    first = os.path.abspath(os.path.join(folder, frames[0]["file_path"]))
    image = bpy.data.images.load(first)
    image.source = "SEQUENCE"
    background = camera.data.background_images.new()
    background.image = image
    user = background.image_user
    places, user.frame_offset = numbers(frames)
    user.frame_start, user.frame_duration, user.use_auto_refresh = 1, places[-1], True
    camera.data.show_background_images = True


def main():
    arguments = parse()
    with open(os.path.join(arguments.pictures, "transforms.json"), encoding="utf-8") as file:
        transforms = json.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=os.path.abspath(arguments.mesh))
    frames = transforms["frames"]
    camera = camera_of(transforms)
    animate(camera, frames)
    show_pictures(camera, arguments.pictures, frames)
    scene = bpy.context.scene
    scene.camera = camera
    scene.frame_start, scene.frame_end = 1, numbers(frames)[0][-1]
    render = scene.render
    render.resolution_x, render.resolution_y = transforms["w"], transforms["h"]
    render.fps = arguments.fps
    # The colours of the mesh are those of the pictures, and are not to be graded once more.
    scene.view_settings.view_transform = "Standard"
    bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath(arguments.scene))
    print(f"{len(frames)} frames in {arguments.scene}")


main()
