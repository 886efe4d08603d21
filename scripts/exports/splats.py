"""Gaussian splats on the CPU by gsplat's own pure-torch reference: projection and spherical harmonics.

gsplat's rasteriser needs CUDA; rasterise.c takes its place, and `python splats.py PLY` checks it and its
gradient against gsplat's `accumulate`. Needs gcc and `pip install gsplat torch numpy plyfile`.
"""

import ctypes
import pathlib
import subprocess
import sys
import tempfile
import types

import numpy as np
import torch
from gsplat.cuda._torch_impl import (
    _fully_fused_projection, _quat_scale_to_covar_preci, _spherical_harmonics, accumulate)

torch.set_num_threads(1)
FLAGS = "-O3 -march=native -ffast-math -fopenmp-simd -fPIC -shared".split()


def compiled():
    source = pathlib.Path(__file__).with_name("rasterise.c")
    library = pathlib.Path(tempfile.mkdtemp()) / "rasterise.so"
    subprocess.run(["gcc", *FLAGS, source, "-o", library, "-lm"], check=True)
    return ctypes.CDLL(library)


LIBRARY = compiled()


def call(arrays, radii, size, out, gradient=None, sums=None):
    def at(tensor):
        return ctypes.c_void_p(None if tensor is None else tensor.data_ptr())
    LIBRARY.rasterise(len(radii), *map(at, arrays), at(radii), *size, at(out), at(gradient), at(sums))


class Rasterise(torch.autograd.Function):
    """Colour and opacity [height, width, 4] of Gaussians in order of depth."""

    @staticmethod
    def forward(ctx, means, conics, colours, opacities, radii, size):
        arrays = [t.detach().contiguous().float() for t in (means, conics, colours, opacities)]
        out = torch.zeros(size[1], size[0], 4)
        call(arrays, radii, size, out)
        ctx.kept = arrays, radii, size, out
        return out

    @staticmethod
    def backward(ctx, gradient):
        arrays, radii, size, out = ctx.kept
        sums = torch.zeros(len(radii), 9)
        call(arrays, radii, size, out, gradient.contiguous(), sums)
        return sums[:, :2], sums[:, 2:5], sums[:, 5:8], sums[:, 8], None, None


def footprints(splats, world_to_camera, intrinsics, size):
    """What `accumulate` takes, in order of depth: means, conics, colours, opacities, radii."""
    covariances, _ = _quat_scale_to_covar_preci(
        splats["quats"], torch.exp(splats["scales"]), compute_preci=False)
    radii, means, depths, conics, _ = _fully_fused_projection(
        splats["means"], covariances, world_to_camera[None], intrinsics[None], *size)
    centre = -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]
    harmonics = splats["harmonics"]
    degree = int(harmonics.shape[1] ** 0.5) - 1
    colours = _spherical_harmonics(degree, splats["means"] - centre, harmonics)
    colours = torch.clamp_min(colours + 0.5, 0.0)
    order = torch.argsort(depths[0])
    order = order[(radii[0, order] > 0).all(dim=1)]
    opacities = torch.sigmoid(splats["opacities"])
    return [means[0, order], conics[0, order], colours[order], opacities[order], radii[0, order].contiguous()]


def render(splats, world_to_camera, intrinsics, size):
    """Colour and opacity [height, width, 4]; `size` is (width, height)."""
    return Rasterise.apply(*footprints(splats, world_to_camera, intrinsics, size), size)


def read_ply(path):
    """Gaussians of a PLY file in the layout of 3D Gaussian splatting, by plyfile."""
    from plyfile import PlyData
    vertex = PlyData.read(path)["vertex"]
    names = [p.name for p in vertex.properties]

    def columns(*wanted):
        return torch.from_numpy(np.stack([np.asarray(vertex[n], np.float32) for n in wanted], axis=1))
    harmonics = columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
    rest = [n for n in names if n.startswith("f_rest_")]
    if rest:
        # One channel after another.
        of_channels = columns(*(f"f_rest_{k}" for k in range(len(rest)))).reshape(len(harmonics), 3, -1)
        harmonics = torch.cat([harmonics, of_channels.transpose(1, 2)], dim=1)
    return {
        "means": columns("x", "y", "z"),
        "scales": columns("scale_0", "scale_1", "scale_2"),
        "quats": columns("rot_0", "rot_1", "rot_2", "rot_3"),
        "opacities": columns("opacity")[:, 0],
        "harmonics": harmonics,
    }


def weights_along_rays(alphas, ray_indices, n_rays):
    """What nerfacc, which needs CUDA too, gives `accumulate`: alpha times transmittance."""
    logs = torch.log1p(-alphas)
    before = torch.cumsum(logs, 0) - logs
    first = torch.searchsorted(ray_indices, ray_indices)
    transmittance = torch.exp(before - before[first])
    return alphas * transmittance, transmittance


def sums_along_rays(weights, values, ray_indices, n_rays):
    values = weights[:, None] if values is None else weights[:, None] * values
    return torch.zeros(n_rays, values.shape[1], dtype=values.dtype).index_add(0, ray_indices, values)


def check(path):
    """Compares picture and gradients with gsplat's `accumulate` in double precision."""
    sys.modules["nerfacc"] = types.SimpleNamespace(
        render_weight_from_alpha=weights_along_rays, accumulate_along_rays=sums_along_rays)
    size, splats = (48, 36), {k: v[::7] for k, v in read_ply(path).items()}
    intrinsics = torch.tensor([[40.0, 0, 24], [0, 40, 18], [0, 0, 1]])
    arrays = [t.detach().clone() for t in footprints(splats, torch.eye(4), intrinsics, size)]
    gradient = torch.rand(36, 48, 4, generator=torch.manual_seed(0)) - 0.5
    fast = [t.clone().requires_grad_() for t in arrays[:4]]
    picture = Rasterise.apply(*fast, arrays[4], size)
    (picture * gradient).sum().backward()

    means, conics, colours, opacities = exact = [t.double()[None].requires_grad_() for t in arrays[:4]]
    with torch.no_grad():
        pixels, gaussians = visits(means[0], conics[0], opacities[0], size)
    renders, alphas = accumulate(means, conics, opacities, colours, gaussians, pixels,
                                 torch.zeros_like(pixels), *size)
    reference = torch.cat([renders, alphas], dim=-1)[0]
    (reference * gradient).sum().backward()
    print(f"{len(means[0])} Gaussians, picture differs by {(picture - reference).abs().max():.1e}")
    for name, a, b in zip(["means", "conics", "colours", "opacities"], fast, exact):
        relative = (a.grad - b.grad[0]).norm() / b.grad.norm()
        print(f"gradient of {name}: relative difference {relative:.1e}")


def visits(means, conics, opacities, size):
    """Pixels and the Gaussians that each visits, in order, as gsplat's rasterize_to_indices finds them."""
    pixels, gaussians = [], []
    for pixel in range(size[0] * size[1]):
        d = torch.tensor([pixel % size[0] + 0.5, pixel // size[0] + 0.5]) - means
        s = 0.5 * (conics[:, 0] * d[:, 0] ** 2 + conics[:, 2] * d[:, 1] ** 2) + conics[:, 1] * d[:, 0] * d[:, 1]
        alphas = torch.clamp_max(opacities * torch.exp(-s), 0.999)
        ids = torch.nonzero(alphas >= 1 / 255)[:, 0]
        ids = ids[torch.cumprod(1 - alphas[ids], 0) > 1e-4]
        pixels.append(torch.full_like(ids, pixel)), gaussians.append(ids)
    return torch.cat(pixels), torch.cat(gaussians)


if __name__ == "__main__":
    check(sys.argv[1])
