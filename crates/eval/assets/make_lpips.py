"""Writes lpips_alex_f16.bin: python make_lpips.py lpips_alex.safetensors lpips_alex_f16.bin

The input has the keys `features.N.weight`, `features.N.bias` (torchvision's AlexNet, N = 0, 3, 6,
8, 10) and `linK.weight` (K = 0..4), all f32. Needs numpy.
"""

import json
import sys

import numpy as np

data = open(sys.argv[1], "rb").read()
length = int.from_bytes(data[:8], "little")
header, body = json.loads(data[8 : 8 + length]), data[8 + length :]


def tensor(key):
    first, end = header[key]["data_offsets"]
    return np.frombuffer(body[first:end], "<f4")


keys = [f"features.{n}.{part}" for n in (0, 3, 6, 8, 10) for part in ("weight", "bias")]
keys += [f"lin{k}.weight" for k in range(5)]
with open(sys.argv[2], "wb") as out:
    for key in keys:
        half = tensor(key).astype("<f2")
        assert np.isfinite(half).all()
        out.write(half.tobytes())
