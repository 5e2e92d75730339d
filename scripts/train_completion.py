#!/usr/bin/env python3
"""Trains the network that completes shapes (services/shared/networks/README.md has the recipe) on shards of `repose generate --completion`.

    train_completion.py --data DIR --checkpoint completion.pt --epochs 10
    train_completion.py --checkpoint completion.pt --export weights.safetensors
    train_completion.py --weights weights.safetensors --golden golden.json

Objects are mirrored in half of the steps: left and right of the line of sight are alike. Needs torch, numpy and safetensors; one core is enough.
"""
import argparse, json
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from layers import Convolution, check_batch, exported, loaded, restored, run, trained
from safetensors.numpy import save_file
from torch import Tensor, nn

SIDE, SLABS, OF_SLAB, OF_OBJECT = 24, 8, 6, 5
CHANNELS = SLABS * OF_SLAB + OF_OBJECT
WIDTHS = (32, 64, 96)
HELD_OUT = 0.08  # the share of the objects, the last ones, that figures are told of


# ---- objects

class Objects:
    """All objects of some folders of shards."""

    def __init__(self, folders: list[Path]):
        shards = loaded("completion", folders)
        self.cells, self.objects, self.filled = (np.concatenate([shard[name] for shard in shards]) for name in ("cells", "objects", "filled"))

    def __len__(self) -> int:
        return len(self.cells)

    def batch(self, indices: np.ndarray, mirrored: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """What was seen [batch, CHANNELS, SIDE, SIDE] and how much of each cell's slabs is filled [batch, SLABS, SIDE, SIDE]."""
        cells = torch.from_numpy(self.cells[indices].astype(np.float32) / 127).permute(0, 3, 1, 2)
        objects = torch.from_numpy(self.objects[indices])[:, :, None, None].expand(-1, -1, SIDE, SIDE)
        filled = torch.from_numpy(self.filled[indices].astype(np.float32) / 3).permute(0, 3, 1, 2)
        seen = torch.cat([cells, objects], 1)
        if mirrored is None:
            return seen, filled
        flip = lambda x: torch.where(mirrored[:, None, None, None], x.flip(3), x)
        return flip(seen), flip(filled)


# ---- the network; services/shared/networks/src/completion.rs computes the same

class CompletionNetwork(nn.Module):
    """What was seen → logits [batch, SLABS, SIDE, SIDE] of cells that the object fills."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c = WIDTHS
        self.stem, self.same0 = Convolution(CHANNELS, a), Convolution(a, a)
        self.down1, self.same1 = Convolution(a, b, 2), Convolution(b, b)
        self.down2, self.same2, self.same2b = Convolution(b, c, 2), Convolution(c, c), Convolution(c, c)
        self.whole = nn.Linear(c, c)
        self.narrow1, self.join1 = Convolution(c, b, size=1, relu=False), Convolution(b, b)
        self.narrow0, self.join0 = Convolution(b, a, size=1, relu=False), Convolution(a, a)
        self.head = nn.Conv2d(a, SLABS, 1)

    def forward(self, x: Tensor) -> Tensor:
        x0 = self.stem(x)
        x0 = x0 + self.same0(x0)
        x1 = self.down1(x0)
        x1 = x1 + self.same1(x1)
        x2 = self.down2(x1)
        x2 = x2 + self.same2(x2)
        x2 = x2 + F.relu(self.whole(x2.mean((2, 3))))[:, :, None, None]
        x2 = x2 + self.same2b(x2)
        twice = lambda x: F.interpolate(x, scale_factor=2, mode="nearest")
        x1 = F.relu(x1 + twice(self.narrow1(x2)))
        x1 = x1 + self.join1(x1)
        x0 = F.relu(x0 + twice(self.narrow0(x1)))
        x0 = x0 + self.join0(x0)
        return self.head(x0)


# ---- training

def train(args: argparse.Namespace) -> None:
    torch.manual_seed(args.seed)
    rng = np.random.default_rng(args.seed)
    objects = Objects(args.data)
    learned = np.arange(int(len(objects) * (1 - HELD_OUT)))
    held_out = np.arange(len(learned), len(objects))
    check_batch(learned, args)
    network = CompletionNetwork()

    def loss_of(batch: np.ndarray, rng: np.random.Generator) -> Tensor:
        seen, filled = objects.batch(batch, torch.from_numpy(rng.random(args.batch) < 0.5))
        return F.binary_cross_entropy_with_logits(network(seen), filled)

    trained(network, learned, 0.1, loss_of, lambda: figures(network, objects, held_out), {"objects": len(learned)}, rng, args)


@torch.no_grad()
def figures(network: CompletionNetwork, objects: Objects, indices: np.ndarray) -> dict[str, float | list[list[float]]]:
    """Loss, and the share of what is likelier than not or true that is both: of the network, and of the rules that it is told of."""
    network.eval()
    loss, overlaps = 0.0, np.zeros(2)
    said: list[np.ndarray] = []
    true: list[np.ndarray] = []
    for part in np.array_split(indices, max(len(indices) // 128, 1)):
        seen, filled = objects.batch(part)
        logits = network(seen)
        loss += float(F.binary_cross_entropy_with_logits(logits, filled, reduction="sum"))
        rules = seen[:, :SLABS * OF_SLAB].unflatten(1, (SLABS, OF_SLAB))[:, :, -1] > 0.5
        for k, guess in enumerate((logits > 0, rules)):
            both, either = (f(guess, filled > 0.5).sum((1, 2, 3)) for f in (torch.logical_and, torch.logical_or))
            overlaps[k] += float((both / either.clamp_min(1)).sum())
        said.append(torch.sigmoid(logits[:, :, ::3, ::3]).flatten().numpy())
        true.append(filled[:, :, ::3, ::3].flatten().numpy())
    said_all, true_all = np.concatenate(said), np.concatenate(true)
    tenth = np.minimum((said_all * 10).astype(int), 9)
    calibration = [[round(float(x[tenth == k].mean()), 3) for x in (said_all, true_all)] for k in range(10) if (tenth == k).any()]
    count = max(len(indices), 1)
    per_cell = loss / (count * SLABS * SIDE * SIDE)
    return {"loss": round(per_cell, 4), "overlap": round(overlaps[0] / count, 4), "overlap_of_rules": round(overlaps[1] / count, 4), "said_and_true": calibration}


def export(args: argparse.Namespace) -> None:
    """Weights with norms folded in, in half precision."""
    saved = torch.load(args.checkpoint, map_location="cpu", weights_only=True)
    network = CompletionNetwork()
    network.load_state_dict(saved["network"])
    network.eval()
    metadata = {"format": "repose-completion-1", "steps": str(saved["step"]), "objects": str(saved["objects"]), "torch": torch.__version__, "recipe": args.recipe}
    save_file(exported(network, "completion"), args.export, metadata)


# ---- what the test in Rust compares with

def by_formula() -> Tensor:
    """Cells [1, CHANNELS, SIDE, SIDE] that the test in Rust makes too."""
    c, row, cell = torch.meshgrid(torch.arange(CHANNELS), torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
    return (((7 * row + 3 * cell + 5 * c) % 11).float() / 11 - 0.3)[None]


@torch.no_grad()
def golden(args: argparse.Namespace) -> None:
    """How likely every seventh cell is filled, slab by slab, by exported weights on the formula's cells."""
    network = CompletionNetwork()
    restored(network, "completion", args.weights)
    filled = torch.sigmoid(network(by_formula()))[0].flatten(1)[:, ::7].tolist()
    args.golden.write_text(json.dumps([[round(value, 5) for value in slab] for slab in filled]))


if __name__ == "__main__":
    run(__doc__, "completion", 10, 64, "what they say of cells by formula", train, export, golden)
