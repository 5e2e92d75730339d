#!/usr/bin/env python3
"""Trains the network for object masks (services/shared/networks/README.md has the recipe) on shards of `repose generate`.

    train_masks.py --data DIR [--data DIR ...] --checkpoint masks.pt --seconds 900 --stop-after 400
    train_masks.py --data ... --checkpoint masks.pt --seconds 900                # goes on from the checkpoint
    train_masks.py --checkpoint masks.pt --export weights.safetensors
    train_masks.py --weights weights.safetensors --golden golden.json

Shards that appear in the folders while it runs are taken in. A view is disturbed anew each time it is drawn, on the device: a depth camera's
faults (services/shared/sensor says where the model is from), scale, shifts, mirror images, wrong gravity and height. The learning
rate follows the clock: `--seconds` is the whole training's time, over all runs. Needs torch, numpy and safetensors.
"""
import argparse, json, math, multiprocessing, time, zlib
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from layers import Convolution, exported, restored
from safetensors.numpy import save_file
from torch import Tensor, nn

HEIGHT, WIDTH = 240, 320
CHANNELS = 12
# Columns to the right and rows down from a pixel to the one that it is compared with. The first two are its neighbours.
OFFSETS = [(1, 0), (0, 1), (4, 0), (0, 4), (4, 4), (-4, 4), (12, 0), (0, 12), (12, 12), (-12, 12)]
WIDTHS = (48, 64, 128, 192)
IGNORED = 255  # a label of a sliver, which nobody could tell
MISSING = 0.0  # depth where there is no reading


# ---- reading shards

def unpack(shard: dict, name: str, rect: dict) -> np.ndarray:
    """A layer's inverse depth in steps of 1e-4 1/m, u16 [height, width]."""
    low, high = np.frombuffer(zlib.decompress(shard[name].tobytes()), np.uint8).reshape(2, -1)
    folded = low | high.astype(np.uint16) << 8
    return np.cumsum((folded >> 1) ^ -(folded & 1), dtype=np.uint16).reshape(rect["height"], rect["width"])


def read_shard(path: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inverse depth u16 [views, H, W], labels u8 [views, H, W], cameras f32 [views, 7]: fx, fy, cx, cy, up in the camera's frame."""
    from safetensors.numpy import load_file
    shard = load_file(path)
    views = json.loads(zlib.decompress(shard["views"].tobytes()))
    inverse = np.zeros((len(views), HEIGHT, WIDTH), np.uint16)
    labels = np.zeros((len(views), HEIGHT, WIDTH), np.uint8)
    cameras = np.zeros((len(views), 7), np.float32)
    for v, view in enumerate(views):
        layers = [(f"{v:04}/background", view["background"], 0)]
        layers += [(f"{v:04}/object_{k}/alone", o["alone"], k + 1) for k, o in enumerate(view["objects"])]
        for name, rect, label in layers:
            window = np.s_[rect["y0"]:rect["y0"] + rect["height"], rect["x0"]:rect["x0"] + rect["width"]]
            near = unpack(shard, name, rect)
            wins = near > inverse[v][window]
            inverse[v][window][wins], labels[v][window][wins] = near[wins], label
        counts = np.bincount(labels[v].ravel(), minlength=256)
        labels[v][(counts < 15)[labels[v]]] = IGNORED
        camera = view["camera"]
        up = np.reshape(camera["world_from_camera"], (4, 4))[2, :3]  # the world's z axis, seen from the camera
        cameras[v] = [camera["fx"], camera["fy"], camera["cx"], camera["cy"], *up]
    return inverse, labels, cameras


class Views:
    """All views on the device; a pool of processes unpacks shards as they appear."""

    def __init__(self, folders: list[Path], device: str, most: int, processes: int):
        self.folders, self.device, self.count, self.known, self.pending = folders, device, 0, set(), []
        self.inverse = torch.empty((most, HEIGHT, WIDTH), dtype=torch.int16, device=device)  # the bits of u16
        self.labels = torch.empty((most, HEIGHT, WIDTH), dtype=torch.uint8, device=device)
        self.cameras = torch.empty((most, 7), device=device)
        self.pool = ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn"))

    def take_in(self, wait: bool = False) -> None:
        """Looks for new shards and takes in those that are unpacked."""
        for path in sorted(p for folder in self.folders for p in folder.glob("*.safetensors")):
            if path not in self.known:
                self.known.add(path)
                self.pending.append(self.pool.submit(read_shard, str(path)))
        for future in [f for f in self.pending if wait or f.done()]:
            self.pending.remove(future)
            try:
                inverse, labels, cameras = future.result()
            except FileNotFoundError:
                continue  # a longer run of the generator has put another in its place
            n = min(len(inverse), len(self.inverse) - self.count)
            at = slice(self.count, self.count + n)
            self.inverse[at].copy_(torch.from_numpy(inverse[:n].view(np.int16)))
            self.labels[at].copy_(torch.from_numpy(labels[:n]))
            self.cameras[at].copy_(torch.from_numpy(cameras[:n]))
            self.count += n


# ---- from a view to what a camera reports of it; every tensor is [batch, H, W] unless it says otherwise

def shifted(x: Tensor, columns: int, rows: int, fill: float) -> Tensor:
    """`x[..., v + rows, u + columns]` at (u, v), `fill` beyond the picture."""
    height, width = x.shape[-2:]
    padded = F.pad(x, (max(-columns, 0), max(columns, 0), max(-rows, 0), max(rows, 0)), value=fill)
    return padded[..., max(rows, 0):max(rows, 0) + height, max(columns, 0):max(columns, 0) + width]


def between(shape: tuple, low: float, high: float, device: torch.device) -> Tensor:
    return torch.rand(shape, device=device) * (high - low) + low


def chosen(inverse: Tensor, labels: Tensor, cameras: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Scaled, mirrored and moved views: inverse depth 1/m, labels, cameras."""
    n, device = len(inverse), inverse.device
    inverse = inverse / between((n, 1, 1), 0.8, 1.3, device)
    cameras = cameras.clone()
    flip = torch.rand(n, device=device) < 0.5
    columns = torch.arange(WIDTH, device=device)
    columns = torch.where(flip[:, None], WIDTH - 1 - columns, columns[None])
    cameras[:, 2] = torch.where(flip, WIDTH - 1 - cameras[:, 2], cameras[:, 2])
    cameras[:, 4] = torch.where(flip, -cameras[:, 4], cameras[:, 4])
    # What lies beyond the picture after a shift was not seen.
    moves = torch.rand(n, device=device) < 0.35
    du = torch.where(moves, torch.randint(-100, 101, (n,), device=device), 0)
    dv = torch.where(moves, torch.randint(-70, 71, (n,), device=device), 0)
    from_u = columns.gather(1, (torch.arange(WIDTH, device=device)[None] + du[:, None]).clamp(0, WIDTH - 1))
    rows = torch.arange(HEIGHT, device=device)[None] + dv[:, None]
    inside_u = (torch.arange(WIDTH, device=device)[None] + du[:, None]).clamp(0, WIDTH - 1) == torch.arange(WIDTH, device=device)[None] + du[:, None]
    inside_v = rows.clamp(0, HEIGHT - 1) == rows
    index = rows.clamp(0, HEIGHT - 1)[:, :, None] * WIDTH + from_u[:, None, :]
    inside = inside_v[:, :, None] & inside_u[:, None, :]
    take = lambda x: x.flatten(1).gather(1, index.flatten(1)).view_as(x)
    cameras[:, 2] -= du
    cameras[:, 3] -= dv
    return torch.where(inside, take(inverse), 0.0), torch.where(inside, take(labels), 0), cameras


def disturbed(inverse: Tensor, cameras: Tensor) -> Tensor:
    """What a depth camera reports of true inverse depth: depth, metres, 0 where it has no reading."""
    n, device = len(inverse), inverse.device
    each = lambda low, high: between((n, 1, 1), low, high, device)
    somewhere = lambda: torch.rand(inverse.shape, device=device)
    stereo = torch.rand((n, 1, 1), device=device) < 0.5
    of = lambda light, pair: torch.where(stereo, torch.tensor(pair, device=device), torch.tensor(light, device=device))
    focal = of(586.0, 665.0) * each(0.9, 1.15)
    baseline = of(0.075, 0.055) * each(0.8, 1.2)
    noise_px, step = of(0.055, 0.07) * each(0.4, 1.8), of(0.125, 1 / 32) * each(0.2, 1.0)
    edge_lost, edge_mixed = of(0.25, 0.10) * each(0.2, 2.0), of(0.05, 0.20) * each(0.2, 2.0)
    scale = cameras[:, 0, None, None] / focal
    left, right, above, below = (shifted(inverse, du, dv, -1.0) for du, dv in [(-1, 0), (1, 0), (0, -1), (0, 1)])
    left, right, above, below = (torch.where(x < 0, inverse, x) for x in (left, right, above, below))
    edge = torch.maximum((left + right - 2 * inverse).abs(), (above + below - 2 * inverse).abs()) > 0.02 * inverse
    flatter = lambda back, ahead: torch.where((inverse - back).abs() < (ahead - inverse).abs(), inverse - back, ahead - inverse)
    fx, fy, cx, cy = (cameras[:, k, None, None] for k in range(4))
    x, y = (torch.arange(WIDTH, device=device) - cx) / fx, (torch.arange(HEIGHT, device=device)[:, None] - cy) / fy
    nx, ny = flatter(left, right) * fx, flatter(above, below) * fy
    nz = inverse - nx * x - ny * y
    cosine = inverse / ((nx * nx + ny * ny + nz * nz) * (1 + x * x + y * y)).sqrt().clamp_min(1e-6)
    angle = cosine.clamp(0, 1).acos()
    # The other point of view sees in order along a row what it sees at all.
    shift = fx * baseline
    mirrored = torch.rand((n, 1, 1), device=device) < 0.2
    facing = torch.where(mirrored, inverse.flip(2), inverse)
    there = torch.where(facing > 0, torch.arange(WIDTH, device=device) - shift * facing, math.inf)
    seen_to = there.flip(2).cummin(2).values.flip(2)
    hidden = (there > shifted(seen_to, 1, 0, math.inf)) | (stereo & (there < 0) & (torch.rand((n, 1, 1), device=device) < 0.5))
    hidden = torch.where(mirrored, hidden.flip(2), hidden) & (torch.rand((n, 1, 1), device=device) < 0.8)
    ticket = somewhere()
    least = torch.minimum(torch.minimum(left, right), torch.minimum(torch.minimum(above, below), inverse))
    most = torch.maximum(torch.maximum(left, right), torch.maximum(torch.maximum(above, below), inverse))
    wander = scale * of(0.8, 1.0) * each(0.3, 1.5)
    du, dv = ((torch.randn(inverse.shape, device=device) * wander).round().long() for _ in range(2))
    columns = (torch.arange(WIDTH, device=device) + du).clamp(0, WIDTH - 1)
    rows = (torch.arange(HEIGHT, device=device)[:, None] + dv).clamp(0, HEIGHT - 1)
    wandered = inverse.flatten(1).gather(1, (rows * WIDTH + columns).flatten(1)).view_as(inverse)
    at_edge = torch.where(ticket < edge_lost + edge_mixed, least + somewhere() * (most - least), wandered)
    true = torch.where(edge, torch.where(ticket < edge_lost, 0.0, at_edge), inverse)
    window = (1, 3, 5)[int(torch.randint(0, 3, ()))]
    white = torch.randn((n, 1, HEIGHT + window - 1, WIDTH + window - 1), device=device)
    noise = F.avg_pool2d(white, window, 1)[:, 0] * window
    px_m = focal * baseline
    slant = angle / (math.pi / 2 - angle).clamp_min(0.02)
    slant_px = 1e-4 * each(0.3, 2.0) * slant.square() * true.clamp_min(0).sqrt() * px_m * true.square()
    disparity = true * px_m + (noise_px.square() + slant_px.square()).sqrt() * noise
    # Lenses bend a flat wall by some thousandths, smoothly.
    bend = F.interpolate(torch.randn((n, 1, 5, 6), device=device), (HEIGHT, WIDTH), mode="bicubic")[:, 0]
    disparity = (disparity / step).round() * step * (1 + 0.0015 * each(0.0, 1.5) * bend)
    depth = px_m / disparity.clamp_min(1e-3)
    low = of(1.20, 1.25) * each(0.85, 1.1)
    grazing = (angle > low) & (somewhere() < (angle - low) / 0.2)
    blobs = F.interpolate(torch.rand((n, 1, HEIGHT // 6, WIDTH // 6), device=device), (HEIGHT, WIDTH))[:, 0]
    lost = (blobs < 0.005 * each(0.0, 4.0)) | grazing | hidden | (true <= 0) | (disparity <= 0) | (depth > 4.0) | (depth < 0.25)
    # Dark and shining places in clouds, on some pictures.
    cloud = F.interpolate(torch.randn((n, 1, 12, 16), device=device), (HEIGHT, WIDTH), mode="bicubic")[:, 0]
    lost |= (cloud > each(1.6, 3.0)) & (torch.rand((n, 1, 1), device=device) < 0.3)
    depth = torch.where(lost, MISSING, (depth * 1000).round() / 1000)
    return without_flying(depth, cameras)


def without_flying(depth: Tensor, cameras: Tensor) -> Tensor:
    """As services/perception/src/readings/flying.rs: readings between two surfaces, and lonely ones, are taken out."""
    limit = 6.0 / cameras[:, 0, None, None] * depth + 0.006 * depth * depth
    missing = torch.where(depth > 0, depth, math.nan)
    left, right, above, below = (shifted(missing, du, dv, math.nan) for du, dv in [(-1, 0), (1, 0), (0, -1), (0, 1)])
    lies = lambda a, b: ((depth - a > limit) & (b - depth > limit)) | ((a - depth > limit) & (depth - b > limit))
    near = lambda a: (a - depth).abs() <= limit
    alone = ~(near(left) | near(right) | near(above) | near(below))
    return torch.where(lies(left, right) | lies(above, below) | alone, MISSING, depth)


# ---- what the network reads; services/shared/networks/src/masks/inputs.rs computes the same

def inputs(depth: Tensor, cameras: Tensor, jitter: bool) -> Tensor:
    """[batch, 12, H, W]: reading or not, height (coarse, fine), depth, normal (right, away, up), bends (x, y; near, far), slope of sight."""
    n, device = len(depth), depth.device
    fx, fy, cx, cy = (cameras[:, k, None, None] for k in range(4))
    x = ((torch.arange(depth.shape[2], device=device) - cx) / fx).expand_as(depth)
    y = ((torch.arange(depth.shape[1], device=device)[:, None] - cy) / fy).expand_as(depth)
    up = cameras[:, 4:7]
    if jitter:
        up = up + torch.randn_like(up) * torch.where(torch.rand((n, 1), device=device) < 0.2, 0.05, 0.012)
    up = F.normalize(up, dim=1)
    away = away_of(up)
    right = torch.linalg.cross(away, up)
    along = lambda axis, a, b, c: axis[:, 0, None, None] * a + axis[:, 1, None, None] * b + axis[:, 2, None, None] * c
    valid = depth > 0
    point = torch.stack([x * depth, y * depth, depth], 1)
    height = along(up, *point.unbind(1))
    across = [shifted(point, 2, 0, 0.0) - shifted(point, -2, 0, 0.0), shifted(point, 0, 2, 0.0) - shifted(point, 0, -2, 0.0)]
    known = valid & (shifted(depth, 2, 0, 0.0) > 0) & (shifted(depth, -2, 0, 0.0) > 0) & (shifted(depth, 0, 2, 0.0) > 0) & (shifted(depth, 0, -2, 0.0) > 0)
    normal = F.normalize(torch.linalg.cross(across[1], across[0], dim=1), dim=1) * known[:, None]
    n_right, n_away, n_up = (along(axis, *normal.unbind(1)) for axis in (right, away, up))
    reference = level(height, depth, known & (n_up > 0.9))
    if jitter:
        wrong = torch.rand((n, 1, 1), device=device)
        elsewhere = torch.where(wrong < 0.05, between((n, 1, 1), -0.9, -0.3, device), between((n, 1, 1), -0.15, 0.15, device))
        reference = reference + torch.where(wrong < 0.15, elsewhere, 0.004 * torch.randn((n, 1, 1), device=device))
    height = height - reference

    def bend(arm: int, du: int, dv: int) -> Tensor:
        before, after = shifted(depth, -arm * du, -arm * dv, 0.0), shifted(depth, arm * du, arm * dv, 0.0)
        relief = ((before + after) / 2 - depth) / (arm * depth.clamp_min(0.05) / fx)
        return relief.clamp(-1, 1) * (valid & (before > 0) & (after > 0))

    slope = along(up, x, y, torch.ones_like(x)) / (1 + x * x + y * y).sqrt()
    features = [valid.float(), (2 * height).clamp(-1.5, 1.5) * valid, (20 * height).clamp(-1, 1) * valid, (depth - 0.9).clamp(-1, 1.5) * valid,
                n_right, n_away, n_up, bend(1, 1, 0), bend(1, 0, 1), bend(4, 1, 0), bend(4, 0, 1), slope]
    return torch.stack(features, 1)


def away_of(up: Tensor) -> Tensor:
    """[batch, 3] → [batch, 3], unit, level: as `away_in_camera` in services/shared/geometry/src/viewer.rs. The line of sight over the ground,
    or the picture's up for a camera that looks steeply down."""
    sight = torch.tensor([0.0, 0.0, 1.0], device=up.device).expand_as(up)
    vertical = up[:, 2:].abs().clamp(max=1.0)
    off_vertical = vertical.acos()
    share = ((math.pi / 4 - off_vertical) / (math.pi / 12)).clamp(0, 1)
    picture = torch.stack([torch.zeros_like(up[:, 0]), up[:, 2] + up[:, 2].sign(), -up[:, 1]], 1)
    away = sight * (1 - share) / off_vertical.clamp_min(math.pi / 6).sin() + picture * share / (1 + vertical)
    return F.normalize(away - up * (away * up).sum(1, keepdim=True), dim=1)


def level(height: Tensor, depth: Tensor, upward: Tensor) -> Tensor:
    """The height of the main support, [batch, 1, 1]: of what faces up, the fullest three of bins of a centimetre, and the mean within them.

    What is near counts more, by the square of its depth, or the floor would win over a small table. Without anything that faces up,
    all readings count."""
    n = len(height)
    counted = torch.where(upward.flatten(1).any(1)[:, None, None], upward, depth > 0).flatten(1)
    bins = ((height + 4.0) * 100).floor().long().clamp(1, 598).flatten(1)
    weight = counted / depth.flatten(1).clamp_min(0.05).square()
    counts = torch.zeros((n, 600), device=height.device).scatter_add_(1, bins, weight)
    middle = (counts[:, :-2] + counts[:, 1:-1] + counts[:, 2:]).argmax(1, keepdim=True) + 1
    within = counted & ((bins - middle).abs() <= 1)
    mean = (height.flatten(1) * within).sum(1) / within.sum(1).clamp_min(1)
    return mean[:, None, None]


# ---- the network

class MaskNetwork(nn.Module):
    """[batch, 12, H, W], sides multiples of 16 → logits [batch, 1 + offsets, H, W]: object, same object as the pixel at each offset."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = WIDTHS
        self.stem = Convolution(4 * CHANNELS, a)
        self.same0 = Convolution(a, a)
        self.down1, self.same1 = Convolution(a, b, 2), Convolution(b, b)
        self.down2, self.same2 = Convolution(b, c, 2), Convolution(c, c)
        self.down3, self.same3, self.same3b = Convolution(c, d, 2), Convolution(d, d), Convolution(d, d)
        self.whole = nn.Linear(d, d)
        self.narrow2, self.join2 = Convolution(d, c, size=1, relu=False), Convolution(c, c)
        self.narrow1, self.join1 = Convolution(c, b, size=1, relu=False), Convolution(b, b)
        self.narrow0, self.join0 = Convolution(b, a, size=1, relu=False), Convolution(a, a)
        self.head = nn.Conv2d(a, 4 * (1 + len(OFFSETS)), 1)

    def forward(self, x: Tensor) -> Tensor:
        x0 = self.stem(F.pixel_unshuffle(x, 2))
        x0 = x0 + self.same0(x0)
        x1 = self.down1(x0)
        x1 = x1 + self.same1(x1)
        x2 = self.down2(x1)
        x2 = x2 + self.same2(x2)
        x3 = self.down3(x2)
        x3 = x3 + self.same3(x3)
        x3 = x3 + F.relu(self.whole(x3.mean((2, 3))))[:, :, None, None]
        x3 = x3 + self.same3b(x3)
        twice = lambda x: F.interpolate(x, scale_factor=2, mode="nearest")
        x2 = F.relu(x2 + twice(self.narrow2(x3)))
        x2 = x2 + self.join2(x2)
        x1 = F.relu(x1 + twice(self.narrow1(x2)))
        x1 = x1 + self.join1(x1)
        x0 = F.relu(x0 + twice(self.narrow0(x1)))
        x0 = x0 + self.join0(x0)
        return F.pixel_shuffle(self.head(x0), 2)


# ---- training

def losses(logits: Tensor, labels: Tensor, depth: Tensor) -> tuple[Tensor, dict[str, float | Tensor]]:
    """Cross-entropy of `object` and of `same object` where either pixel is one; cuts are rare and count more. Missing readings count nothing."""
    known = (depth > 0) & (labels != IGNORED)
    is_object = (labels > 0) & (labels != IGNORED)
    one = F.binary_cross_entropy_with_logits(logits[:, 0], is_object.float(), reduction="none")
    total = (one * known).sum() / known.sum()
    right = ((logits[:, 0] > 0) & is_object & known).sum() / (((logits[:, 0] > 0) | is_object) & known).sum()
    told: dict[str, float | Tensor] = {"object": total.detach(), "iou": right.detach()}
    number = labels.float()
    for k, (du, dv) in enumerate(OFFSETS):
        other = shifted(number, du, dv, float(IGNORED))
        counts = known & (shifted(depth, du, dv, 0.0) > 0) & (other != IGNORED) & (is_object | (other > 0))
        same = (number == other) & counts
        weight = counts * torch.where(same, 1.0, 3.0 if k < 2 else 1.5)
        pair = F.binary_cross_entropy_with_logits(logits[:, 1 + k], same.float(), reduction="none")
        pair = (pair * weight).sum() / weight.sum().clamp_min(1)
        total = total + pair * (0.5 if k < 2 else 0.25)
        told[f"{du},{dv}"] = pair.detach()
    return total, told


def batch_of(views: Views, indices: Tensor, augment: bool) -> tuple[Tensor, Tensor, Tensor]:
    inverse, labels, cameras = (views.inverse[indices].int() & 0xFFFF) * 1e-4, views.labels[indices], views.cameras[indices]
    if augment:
        inverse, labels, cameras = chosen(inverse, labels, cameras)
    depth = disturbed(inverse, cameras)
    return inputs(depth, cameras, augment), labels, depth


def train(args: argparse.Namespace) -> None:
    device = "cuda" if torch.cuda.is_available() else "cpu"
    torch.manual_seed(args.seed)
    torch.backends.cudnn.benchmark = True
    views = Views(args.data, device, args.most_views, args.processes)
    validation = Views(args.validation, device, args.validation_views, args.processes)
    network = MaskNetwork().to(device, memory_format=torch.channels_last)
    averaged = {k: v.detach().clone() for k, v in network.state_dict().items()}
    optimiser = torch.optim.AdamW(network.parameters(), lr=1e-3, weight_decay=0.02)
    step, spent = 0, 0.0
    if args.checkpoint.exists():
        saved = torch.load(args.checkpoint, map_location=device, weights_only=True)
        network.load_state_dict(saved["network"])
        optimiser.load_state_dict(saved["optimiser"])
        averaged, step, spent = saved["averaged"], saved["step"], saved["spent"]
        torch.manual_seed(args.seed + step)
    while views.count < args.least_views:
        views.take_in()
        time.sleep(0.2)
    validation.take_in(wait=True)
    start, before = time.time(), spent
    while spent < args.seconds and spent - before < args.stop_after:
        share = min(spent / args.seconds, 1.0)
        rate = args.rate * min(1.0, (step + 1) / 300) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share)))
        for group in optimiser.param_groups:
            group["lr"] = rate
        x, labels, depth = batch_of(views, torch.randint(0, views.count, (args.batch,), device=device), True)
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            logits = network(x.contiguous(memory_format=torch.channels_last))
        loss, told = losses(logits.float(), labels, depth)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimiser.step()
        keep = min(0.9985, step / (step + 30))
        with torch.no_grad():
            pairs = [(averaged[k], v) for k, v in network.state_dict().items() if v.is_floating_point()]
            torch._foreach_lerp_([a for a, _ in pairs], [v for _, v in pairs], 1 - keep)
        step += 1
        spent = before + time.time() - start
        if step % 50 == 0:
            views.take_in()
        if step % args.tell == 0:
            line = {"step": step, "spent": round(spent), "views": views.count, "loss": round(loss.item(), 4), **{k: round(float(v), 4) for k, v in told.items()}}
            print(json.dumps(line), flush=True)
        if step % (args.tell * 5) == 0:
            validate(averaged, validation, args)
    validate(averaged, validation, args)
    # Beside its place first: a run that is killed here leaves the checkpoint that it began with.
    unfinished = args.checkpoint.with_name(args.checkpoint.name + ".tmp")
    torch.save({"network": network.state_dict(), "optimiser": optimiser.state_dict(), "averaged": averaged, "step": step, "spent": spent,
                "views": views.count}, unfinished)
    unfinished.replace(args.checkpoint)
    views.pool.shutdown(cancel_futures=True)
    validation.pool.shutdown(cancel_futures=True)


@torch.no_grad()
def validate(averaged: dict[str, Tensor], views: Views, args: argparse.Namespace) -> None:
    """Losses of the averaged weights on the validation folders, always under the same faults."""
    if views.count == 0:
        return
    network = MaskNetwork().to(views.device)
    network.load_state_dict(averaged)
    network.eval()
    sums: dict[str, float] = {}
    batches = torch.arange(views.count, device=views.device).split(args.batch)
    devices = [torch.cuda.current_device()] if views.device == "cuda" else []
    with torch.random.fork_rng(devices=devices):
        torch.manual_seed(0)
        for indices in batches:
            x, labels, depth = batch_of(views, indices, False)
            _, told = losses(network(x), labels, depth)
            for k, v in told.items():
                sums[k] = sums.get(k, 0.0) + float(v) / len(batches)
    print(json.dumps({"validation": {k: round(v, 4) for k, v in sums.items()}}), flush=True)


def loaded(checkpoint: Path) -> tuple[MaskNetwork, dict]:
    saved = torch.load(checkpoint, map_location="cpu", weights_only=True)
    network = MaskNetwork()
    network.load_state_dict(saved["averaged"])
    return network.eval(), saved


def export(args: argparse.Namespace) -> None:
    """The averaged weights, norms folded, in half precision."""
    network, saved = loaded(args.checkpoint)
    metadata = {"format": "repose-masks-1", "offsets": json.dumps(OFFSETS), "steps": str(saved["step"]), "views": str(saved["views"]),
                "seconds": str(round(saved["spent"])), "torch": torch.__version__, "recipe": args.recipe}
    save_file(exported(network, "masks"), args.export, metadata)


def golden_scene() -> tuple[Tensor, Tensor]:
    """A table with a box and a hole, by formula, so that the test in Rust makes the same: depth [1, 48, 64] and its camera."""
    v, u = torch.meshgrid(torch.arange(48.0), torch.arange(64.0), indexing="ij")
    cameras = torch.tensor([[60.0, 60.0, 31.5, 23.5, 0.0, -0.8, -0.6]])
    depth = 0.7 / (0.6 + 0.8 * (v - 23.5) / 60.0)
    depth = torch.where((u >= 20) & (u < 40) & (v >= 16) & (v < 30), depth - 0.05, depth)
    return torch.where((u >= 50) & (v < 8), MISSING, depth)[None], cameras


@torch.no_grad()
def golden(args: argparse.Namespace) -> None:
    """Inputs and logits of exported weights on the formula's scene, every 7th pixel, for the test in Rust."""
    network = MaskNetwork()
    restored(network, "masks", args.weights)
    x = inputs(*golden_scene(), False)
    told = {"inputs": x[0].flatten(1)[:, ::7].tolist(), "logits": network(x)[0].flatten(1)[:, ::7].tolist()}
    args.golden.write_text(json.dumps({k: [[round(value, 5) for value in row] for row in rows] for k, rows in told.items()}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, action="append", default=[], help="a folder of shards to train on")
    parser.add_argument("--validation", type=Path, action="append", default=[], help="a folder of shards to report losses on")
    parser.add_argument("--checkpoint", type=Path, default=Path("masks.pt"), help="where the state is kept, and gone on from if it is there")
    parser.add_argument("--seconds", type=float, default=900, help="length of the whole training")
    parser.add_argument("--stop-after", type=float, default=math.inf, help="end this run after so many seconds, to be gone on with")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--rate", type=float, default=2e-3, help="highest learning rate")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=4, help="processes that unpack shards")
    parser.add_argument("--least-views", type=int, default=1000, help="begin once there are so many")
    parser.add_argument("--most-views", type=int, default=60000, help="room for so many on the device")
    parser.add_argument("--validation-views", type=int, default=512)
    parser.add_argument("--tell", type=int, default=100, help="steps between lines")
    parser.add_argument("--export", type=Path, help="write the weights here instead of training")
    parser.add_argument("--weights", type=Path, help="exported weights, for --golden")
    parser.add_argument("--golden", type=Path, help="write their inputs and logits on a scene by formula here, for the test in Rust")
    parser.add_argument("--recipe", default="", help="kept in the weights' metadata")
    args = parser.parse_args()
    if args.golden is not None:
        golden(args)
    elif args.export is not None:
        export(args)
    else:
        train(args)


if __name__ == "__main__":
    main()
