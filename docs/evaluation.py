"""What the public tools say about two folders of pictures, for the table in evaluation.md.

Usage: python evaluation.py RENDERS REFERENCE [--depth RENDERED TRUE] [--weights LPIPS_ALEX]
Needs: torch, torchvision, lpips, pytorch-msssim, scikit-image, scipy, OpenEXR, numpy, pillow. Pictures of
the same name are compared; PNG by the image metrics, EXR as radiance. `--weights` takes AlexNet
from a safetensors file instead of torchvision's download.
"""

import argparse
import json
from pathlib import Path

import lpips
import numpy as np
import torch
from PIL import Image
from pytorch_msssim import ms_ssim, ssim
from scipy.ndimage import laplace
from skimage.metrics import structural_similarity


def network(weights):
    net = lpips.LPIPS(net="alex", pnet_rand=weights is not None, verbose=False)
    if weights is None:
        return net
    data = Path(weights).read_bytes()
    length = int.from_bytes(data[:8], "little")
    header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
    parts = {0: net.net.slice1, 3: net.net.slice2, 6: net.net.slice3}
    parts |= {8: net.net.slice4, 10: net.net.slice5}
    for number, part in parts.items():
        for name in ("weight", "bias"):
            entry = header[f"features.{number}.{name}"]
            first, end = entry["data_offsets"]
            values = np.frombuffer(body[first:end], "<f4").reshape(entry["shape"])
            getattr(getattr(part, str(number)), name).data = torch.from_numpy(values.copy())
    return net


def tensor(image):
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None]


def padded_ssim(a, b):
    """3D Gaussian splatting's SSIM: a window around every pixel, zeros beyond the border."""
    line = torch.exp(-(torch.arange(-5.0, 6.0, dtype=torch.float64) ** 2) / (2 * 1.5**2))
    window = (torch.outer(line, line) / line.sum() ** 2).expand(3, 1, 11, 11)
    mean = lambda x: torch.nn.functional.conv2d(x, window, padding=5, groups=3)
    ma, mb = mean(a), mean(b)
    va, vb, ab = mean(a * a) - ma**2, mean(b * b) - mb**2, mean(a * b) - ma * mb
    top = (2 * ma * mb + 0.01**2) * (2 * ab + 0.03**2)
    return (top / ((ma**2 + mb**2 + 0.01**2) * (va + vb + 0.03**2))).mean().item()


def compare(net, a, b, depth):
    """One pair in [0, 1]."""
    square, (x, y) = (a - b) ** 2, (tensor(a), tensor(b))
    channel_psnr = lambda s: (-10 * np.log10(s.mean(axis=(0, 1)))).mean()
    perceptual = lambda p, q: net(p.float(), q.float(), normalize=True).item()
    row = {
        "psnr_sharp_db": -10 * np.log10(square.mean()),
        "psnr_channel_mean_db": channel_psnr(square),
        "ssim_sharp": structural_similarity(
            a, b, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
            channel_axis=-1, data_range=1),
        "ssim_sharp (pytorch-msssim)": ssim(x, y, data_range=1).item(),
        "ms_ssim_sharp": ms_ssim(x, y, data_range=1).item(),
        "lpips_sharp": perceptual(x, y),
        "psnr_monogs_db": -10 * np.log10(square[b > 0].mean()),
        "ssim_monogs": padded_ssim(x, y),
        "laplacian_variance": laplace(a @ [0.299, 0.587, 0.114], mode="mirror").var(),
    }
    if depth is not None:
        drawn, true = depth
        valid = (true > 0)[..., None]
        row["psnr_valid_depth_db"] = -10 * np.log10(square[valid[..., 0]].mean())
        row["psnr_splatam_db"] = channel_psnr(square * valid)
        x, y = tensor(a * valid), tensor(b * valid)
        row["ms_ssim_splatam"] = ms_ssim(x, y, data_range=1).item()
        row["lpips_splatam"] = perceptual(x, y)
        row["depth_l1_m"] = np.abs(drawn - true)[true > 0].mean()
    return row


def radiance(renders, reference, names):
    """All frames as one, after one gain, and one per channel (median of ratios)."""
    import OpenEXR

    def read(path):
        channels = OpenEXR.File(str(path)).channels()
        if "RGB" in channels:
            return channels["RGB"].pixels[..., :3].astype(np.float64)
        return np.stack([channels[c].pixels for c in "RGB"], axis=-1).astype(np.float64)

    both = [np.concatenate([read(f / n) for n in names]) for f in (renders, reference)]
    estimate, truth = (np.maximum(image, 0) for image in both)
    white = np.percentile(truth, 99)
    stops = lambda v: np.log2(np.maximum(v, white * 2.0**-16))
    shown = lambda v: np.log1p(5000 * np.tanh(v / white)) / np.log1p(5000)
    table = {}
    for name, axis in [("", None), ("_channel_gains", (0, 1))]:
        lit = (estimate > 0) & (truth > 0)
        ratio = np.where(lit, truth / np.where(lit, estimate, 1), np.nan)
        scaled = estimate * np.exp(np.nanmedian(np.log(ratio), axis=axis))
        rmse = np.sqrt(((stops(scaled) - stops(truth)) ** 2).mean())
        table[f"hdr_log2_psnr{name}_db"] = 20 * np.log10(16 / rmse)
        mu = -10 * np.log10(((shown(scaled) - shown(truth)) ** 2).mean())
        table[f"hdr_mu_law_psnr{name}_db"] = mu
    return table


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("renders", type=Path)
    parser.add_argument("reference", type=Path)
    parser.add_argument("--depth", type=Path, nargs=2)
    parser.add_argument("--weights")
    arguments = parser.parse_args()
    names = {p.name for p in arguments.renders.iterdir()}
    names = sorted(names & {p.name for p in arguments.reference.iterdir()})
    if names[0].endswith(".exr"):
        table = radiance(arguments.renders, arguments.reference, names)
    else:
        net, rows = network(arguments.weights), []
        picture = lambda p: np.asarray(Image.open(p).convert("RGB")) / 255.0
        metres = lambda p: np.asarray(Image.open(p)).astype(np.float64) / 5000
        with torch.no_grad():
            for name in names:
                depth = arguments.depth and [metres(f / name) for f in arguments.depth]
                a, b = (picture(f / name) for f in (arguments.renders, arguments.reference))
                rows.append(compare(net, a, b, depth))
        table = {key: np.mean([row[key] for row in rows]) for key in rows[0]}
    print(len(names), "pictures")
    for key, value in table.items():
        print(f"{key:<36}{value:.7f}")


main()
