"""Writes pictures.numbers: what the public tools say about procedural pictures, and about the
reference pictures of LPIPS if their folder is given.

Usage: python make_pictures.py [LPIPS_REF] [LPIPS_ALEX_SAFETENSORS]
Needs: torch 2.0.1, torchvision 0.15.2, lpips 0.1.4, pytorch-msssim 1.0.0, scikit-image 0.26.0, scipy 1.17.1, numpy
1.26.4, pillow. torchvision's weights come from its download, or from the second argument.
"""

import json
import sys
from pathlib import Path

import lpips
import numpy as np
import torch
from PIL import Image
from pytorch_msssim import ms_ssim, ssim
from scipy.ndimage import laplace
from skimage.metrics import structural_similarity

HERE = Path(__file__).resolve().parent


def wave(width, height, channel, phase):
    """A procedural plane; test and script evaluate the same formula."""
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    value = 0.5 + 0.3 * np.sin(0.37 * column + 0.9 * channel + phase) * np.cos(0.23 * row - phase)
    return (value + 0.15 * (((column // 6) + (row // 5) + channel) % 2)).astype(np.float32)


def picture(size, phase):
    return np.stack([wave(*size, c, phase) for c in range(3)], axis=-1)


def network(weights):
    """PyPI lpips with AlexNet, its convolutions from a safetensors file if there is no network."""
    net = lpips.LPIPS(net="alex", pnet_rand=weights is not None, verbose=False)
    if weights is None:
        return net
    data = Path(weights).read_bytes()
    length = int.from_bytes(data[:8], "little")
    header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
    slices = {0: net.net.slice1, 3: net.net.slice2, 6: net.net.slice3}
    slices |= {8: net.net.slice4, 10: net.net.slice5}
    for number, part in slices.items():
        layer = getattr(part, str(number))
        for name in ("weight", "bias"):
            entry = header[f"features.{number}.{name}"]
            first, end = entry["data_offsets"]
            values = np.frombuffer(body[first:end], "<f4").reshape(entry["shape"])
            getattr(layer, name).data = torch.from_numpy(values.copy())
    return net


def tensor(image):
    return torch.from_numpy(image.transpose(2, 0, 1).astype(np.float32))[None]


def padded_ssim(a, b):
    """The SSIM of 3D Gaussian splatting: a window around every pixel, zeros beyond the border."""
    line = torch.exp(-(torch.arange(-5.0, 6.0, dtype=torch.float64) ** 2) / (2 * 1.5**2))
    window = torch.outer(line, line) / line.sum() ** 2
    mean = lambda x: torch.nn.functional.conv2d(
        x, window.expand(3, 1, 11, 11), padding=5, groups=3)
    ma, mb = mean(a), mean(b)
    va, vb, ab = mean(a * a) - ma**2, mean(b * b) - mb**2, mean(a * b) - ma * mb
    top = (2 * ma * mb + 0.01**2) * (2 * ab + 0.03**2)
    return (top / ((ma**2 + mb**2 + 0.01**2) * (va + vb + 0.03**2))).mean().item()


def compare(net, name, a, b, table):
    exact = a.astype(np.float64), b.astype(np.float64)
    table[f"ssim_{name}"] = structural_similarity(
        *exact, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        data_range=1, channel_axis=-1)
    grey = exact[0] @ [0.299, 0.587, 0.114]
    table[f"laplacian_variance_{name}"] = laplace(grey, mode="mirror").var()
    a, b = tensor(a), tensor(b)
    table[f"ssim_torch_{name}"] = ssim(a.double(), b.double(), data_range=1).item()
    table[f"ssim_padded_{name}"] = padded_ssim(a.double(), b.double())
    if min(a.shape[2:]) > 160:
        table[f"ms_ssim_{name}"] = ms_ssim(a.double(), b.double(), data_range=1).item()
    with torch.no_grad():
        table[f"lpips_{name}"] = net(a, b, normalize=True).item()
    square = (exact[0] - exact[1]) ** 2
    table[f"psnr_{name}"] = -10 * np.log10(square.mean())
    table[f"psnr_channel_mean_{name}"] = (-10 * np.log10(square.mean(axis=(0, 1)))).mean()


def main():
    net = network(sys.argv[2] if len(sys.argv) > 2 else None)
    table = {}
    for name, size, phase in [
        ("near", (48, 37), 0.05), ("far", (48, 37), 0.8),
        ("large_near", (203, 166), 0.05), ("large_far", (203, 166), 0.8),
    ]:
        compare(net, name, picture(size, phase), picture(size, 0.0), table)
    if len(sys.argv) > 1:
        read = lambda n: np.asarray(Image.open(Path(sys.argv[1]) / n).convert("RGB")) / 255.0
        reference = read("ex_ref.png")
        for name in ("p0", "p1"):
            compare(net, name, read(f"ex_{name}.png"), reference, table)
    text = "".join(f"{k} {v:.12g}\n" for k, v in table.items())
    (HERE / "pictures.numbers").write_text(text)


main()
