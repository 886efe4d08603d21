"""Writes aliked_t16_f16.bin: python make_aliked.py aliked-t16.pth aliked_t16_f16.bin

The input is the state dictionary of github.com/Shiaoming/ALIKED. Needs numpy and torch.
"""

import sys

import numpy as np
import torch

state = torch.load(sys.argv[1], map_location="cpu")
parts = []


def put(tensor):
    half = tensor.contiguous().flatten().numpy().astype("<f2")
    assert np.isfinite(half).all()
    parts.append(half)


def fold(weight, norm):
    """Weights and biases of a convolution with the batch normalisation behind it."""
    scale = state[norm + ".weight"] / torch.sqrt(state[norm + ".running_var"] + 1e-5)
    return weight * scale[:, None, None, None], state[norm + ".bias"] - state[norm + ".running_mean"] * scale


for block in (1, 2, 3, 4):
    for conv in (1, 2):
        name = f"block{block}.conv{conv}"
        if block < 3:
            weight = state[name + ".weight"]
        else:
            put(state[name + ".offset_conv.weight"])
            put(state[name + ".offset_conv.bias"])
            weight = state[name + ".regular_conv.weight"]
        for tensor in fold(weight, f"block{block}.bn{conv}"):
            put(tensor)
    if block > 1:
        put(state[f"block{block}.downsample.weight"])
        put(state[f"block{block}.downsample.bias"])
for i in (1, 2, 3, 4):
    put(state[f"conv{i}.weight"])
for i in (0, 2, 4, 6):
    put(state[f"score_head.{i}.weight"])
for key in (
    "offset_conv.0.weight",
    "offset_conv.0.bias",
    "offset_conv.2.weight",
    "offset_conv.2.bias",
    "sf_conv.weight",
    "agg_weights",
):
    put(state["desc_head." + key])
with open(sys.argv[2], "wb") as out:
    out.write(np.concatenate(parts).tobytes())
