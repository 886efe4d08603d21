"""The hash-grid field of crates/radiance/src/hashgrid in PyTorch: the table `rays_pytorch` of
performance.py.

usage: reference.py        (pip install torch)

The same network and sampling as in the bench `kernels -- rays`: 16 grids of 2 features from 16
cells along the cube's edge, hashed into tables of 2^19; 64 units, one hidden layer for density,
two for colour, no biases; harmonics of degree 4; exponentials for density and radiance; samples at
1/128 of the distance in the occupied cells of 128^3. Random numbers differ.
"""

import math
import time

import torch

LEVELS, FEATURES, BASE, WIDTH, GEOMETRY = 16, 2, 16, 64, 15
CELLS = 128
NEAR, CONE, STEP_MIN = 0.05, 1.0 / 128.0, 0.005
PRIMES = (1, 2654435761 - 2**32, 805459861)


class TruncatedExp(torch.autograd.Function):
    """exp of the argument cut to +-15, in value and slope."""

    @staticmethod
    def forward(context, x):
        y = torch.exp(x.clamp(-15, 15))
        context.save_for_backward(y)
        return y

    @staticmethod
    def backward(context, d_y):
        return d_y * context.saved_tensors[0]


class Interpolate(torch.autograd.Function):
    """Weighted sums of eight entries. PyTorch's own way back through `embedding_bag` sorts all
    indices first and takes seven times as long."""

    @staticmethod
    def forward(context, table, index, weights):
        context.save_for_backward(index, weights)
        context.size = table.shape
        bag = torch.nn.functional.embedding_bag
        return bag(index, table, per_sample_weights=weights, mode="sum")

    @staticmethod
    def backward(context, d_out):
        index, weights = context.saved_tensors
        d_table = d_out.new_zeros(context.size)
        for f in range(FEATURES):
            d_table[:, f].index_add_(0, index.view(-1), (weights * d_out[:, f, None]).view(-1))
        return d_table, None, None


def harmonics(n):
    """Real spherical harmonics of unit vectors up to degree 3, 16 numbers each."""
    x, y, z = n.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    a, b = 1.0925484305920792, 0.5900435899266435
    c, d = 0.4570457994644657, 1.445305721320277
    return torch.stack([
        torch.full_like(x, 0.28209479177387814),
        -0.48860251190291987 * y, 0.48860251190291987 * z, -0.48860251190291987 * x,
        a * x * y, -a * y * z, 0.94617469575756 * zz - 0.31539156525252, -a * x * z,
        0.5462742152960396 * (xx - yy),
        b * y * (yy - 3 * xx), 2.890611442640554 * x * y * z, c * y * (1 - 5 * zz),
        0.3731763325901154 * z * (5 * zz - 3), c * x * (1 - 5 * zz), d * z * (xx - yy),
        b * x * (3 * yy - xx),
    ], -1)


class Field(torch.nn.Module):
    """Density [1/m] and linear radiance in a cube of half edge `bound` [m] around `centre`."""

    def __init__(self, centre, bound, log2_table, finest):
        super().__init__()
        self.register_buffer("centre", torch.tensor(centre, dtype=torch.float32))
        self.bound = bound
        growth = [l / (LEVELS - 1) for l in range(LEVELS)]
        scales = [BASE * (finest / BASE) ** part - 1 for part in growth]
        nodes = [math.ceil(scale) + 2 for scale in scales]
        most = 1 << log2_table
        self.dense = sum(n**3 <= most for n in nodes)
        entries = [n**3 if n**3 <= most else most for n in nodes]
        first = [sum(entries[:l]) for l in range(LEVELS)]
        factors = [(1, n, n * n) for n in nodes[: self.dense]] + [PRIMES] * (LEVELS - self.dense)
        self.register_buffer("scales", torch.tensor(scales, dtype=torch.float32))
        self.register_buffer("first", torch.tensor(first, dtype=torch.int32))
        self.register_buffer("factors", torch.tensor(factors, dtype=torch.int32))
        self.mask = most - 1
        self.table = torch.nn.Parameter(torch.empty(sum(entries), FEATURES).uniform_(-1e-4, 1e-4))
        linear = lambda i, o: torch.nn.Linear(i, o, bias=False)
        relu = torch.nn.ReLU(inplace=True)
        self.density = torch.nn.Sequential(
            linear(LEVELS * FEATURES, WIDTH), relu, linear(WIDTH, 1 + GEOMETRY)
        )
        self.colour = torch.nn.Sequential(
            linear(16 + GEOMETRY, WIDTH), relu, linear(WIDTH, WIDTH), relu, linear(WIDTH, 3)
        )

    def to_unit(self, points):
        return (points - self.centre) * (0.5 / self.bound) + 0.5

    def encode(self, unit):
        """Features of positions in the unit cube: trilinear in every grid."""
        with torch.no_grad():
            p = unit.clamp(0, 1)[:, None, :] * self.scales[:, None] + 0.5
            node = p.floor()
            fraction, node = p - node, node.to(torch.int32)
            low = node * self.factors
            x, y, z = torch.stack([low, low + self.factors], -1).unbind(2)
            d = self.dense
            grid = lambda v, axis: v[:, :, None, None, :].movedim(-1, axis)
            add = grid(x[:, :d], 4) + grid(y[:, :d], 3) + grid(z[:, :d], 2)
            mix = (grid(x[:, d:], 4) ^ grid(y[:, d:], 3) ^ grid(z[:, d:], 2)) & self.mask
            index = torch.cat([add, mix], 1) + self.first[:, None, None, None]
            u, v, w = torch.stack([1 - fraction, fraction], -1).unbind(2)
            weights = grid(u, 4) * grid(v, 3) * grid(w, 2)
        features = Interpolate.apply(self.table, index.view(-1, 8), weights.view(-1, 8))
        return features.view(len(unit), LEVELS * FEATURES)

    def forward(self, unit, seen):
        """Density and radiance at positions, with the harmonics of the directions they are seen
        from."""
        hidden = self.density(self.encode(unit))
        colour = self.colour(torch.cat([seen, hidden[:, 1:]], 1))
        return TruncatedExp.apply(hidden[:, 0]), TruncatedExp.apply(colour)


class March:
    """Samples of rays in occupied cells."""

    def __init__(self, field, occupied, step_max):
        self.field, self.occupied, self.step_max = field, occupied, step_max

    def samples(self, origins, directions, offsets):
        """(ray, place in the ray, depth, step) of every sample, ray after ray."""
        length = directions.norm(dim=1)
        # Distances follow each other by a step that depends on the distance, up to the longest
        # way through the cube.
        near = NEAR * length
        distances = [near + offsets * self.step(near)]
        while distances[-1].min().item() < 2 * math.sqrt(3) * self.field.bound:
            distances.append(distances[-1] + self.step(distances[-1]))
        depths = torch.stack(distances, 1) / length[:, None]
        o = self.field.to_unit(origins)[:, None, :]
        d = (directions * (0.5 / self.field.bound))[:, None, :]
        unit = o + depths[..., None] * d
        inside = ((unit >= 0) & (unit < 1)).all(-1)
        cell = (unit * CELLS).to(torch.int64).clamp(0, CELLS - 1)
        cell = (cell[..., 2] * CELLS + cell[..., 1]) * CELLS + cell[..., 0]
        held = inside & self.occupied[cell]
        place = held.cumsum(1) - 1
        ray, k = held.nonzero(as_tuple=True)
        depth = depths[ray, k]
        step = self.step(depth * length[ray]) / length[ray]
        return ray, place[ray, k], depth, step, unit[ray, k]

    def step(self, distance):
        return (distance * CONE).clamp(STEP_MIN, self.step_max)

    def render(self, origins, directions, offsets):
        """Radiance of rays, and how many samples that took."""
        with torch.no_grad():
            ray, place, depth, step, unit = self.samples(origins, directions, offsets)
            length = directions.norm(dim=1)
            seen = harmonics(directions / length[:, None])[ray]
        density, colour = self.field(unit, seen)
        return composite(len(origins), ray, place, density * step * length[ray], colour), len(ray)


def composite(rays, ray, place, thickness, colour):
    """Radiance of rays, front to back, from the samples' optical thickness and radiance."""
    longest = int(place.max()) + 1 if len(place) else 1
    at = ray * longest + place
    padded = thickness.new_zeros(rays * longest).index_put((at,), thickness).view(rays, longest)
    before = torch.cumsum(padded, 1) - padded
    weight = torch.exp(-before) * (1 - torch.exp(-padded))
    return thickness.new_zeros(rays, 3).index_add(0, ray, weight.view(-1)[at][:, None] * colour)


def main():
    """The room of the bench `kernels -- rays`: samples around the walls, forward and back."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    bound, wall, rays = 2.0, 1.8, 4096
    field = Field([0.0] * 3, bound, 19, int(2048 * bound))
    torch.nn.init.uniform_(field.table, -1, 1)
    far = ((torch.arange(CELLS) + 0.5) / CELLS * 2 * bound - bound).abs()
    far = torch.maximum(torch.maximum(far[:, None, None], far[:, None]), far)
    march = March(field, ((far - wall).abs() < 0.15).reshape(-1), 2 * math.sqrt(3) * bound / 128)
    origins, directions = 0.5 * (2 * torch.rand(rays, 3) - 1), 2 * torch.rand(rays, 3) - 1
    cotangent, offsets = torch.randn(rays, 3) / rays, torch.full((rays,), 0.5)
    best = [math.inf] * 2
    for _ in range(6):
        field.zero_grad()
        begun = time.process_time()
        shown, samples = march.render(origins, directions, offsets)
        between = time.process_time()
        shown.backward(cotangent)
        best = [min(best[0], between - begun), min(best[1], time.process_time() - between)]
    both = sum(best)
    print("# rays_pytorch\nlane,rays,samples,forward_ms,backward_ms,rays_per_s,million_samples_per_s")
    rates = f"{rays / both:.0f},{samples / both / 1e6:.3f}"
    print(f"pytorch,{rays},{samples},{1e3 * best[0]:.1f},{1e3 * best[1]:.1f},{rates}")


if __name__ == "__main__":
    main()
