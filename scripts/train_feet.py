#!/usr/bin/env python3
"""Trains the network that looks at feet (services/shared/networks/README.md has the recipe) on shards of `repose generate --feet`.

    train_feet.py --data DIR --checkpoint feet.pt --epochs 6
    train_feet.py --checkpoint feet.pt --export weights.safetensors
    train_feet.py --weights weights.safetensors --golden golden.json

Pictures are mirrored in half of the steps: left and right are alike. Needs torch, numpy and safetensors; two cores are enough.
"""
import argparse, json
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from layers import Convolution, check_batch, exported, loaded, restored, run, trained
from safetensors.numpy import save_file
from torch import Tensor, nn

SIDE, MEASURES = 56, 56
NUMBERS, CHANNELS, HIDDEN = MEASURES + 5, 9, 96
WIDTHS = (32, 48, 96)
STEP_M = 0.0005  # heights and depths are stored in steps of this
HELD_OUT = 0.1  # the share of the objects, the last ones, that figures are told of
NOTHING, OWN, OTHER, FURNITURE, BEYOND = range(5)
LOG_ODDS, UNUSUAL = 4.0, 4.0
LIKELIER = 0.08  # a level that is this much likelier than the rule's is taken in its place


# ---- objects

class Feet:
    """All objects of some folders of shards, and their levels."""

    def __init__(self, folders: list[Path]):
        shards = loaded("feet", folders)
        first = np.cumsum([0] + [len(shard["shown"]) for shard in shards])
        joined = lambda name: np.concatenate([shard[name] for shard in shards])
        self.heights, self.depths, self.shown, self.rises, self.objects = (joined(name) for name in ("heights", "depths", "shown", "rises", "objects"))
        self.levels, self.right = joined("levels"), joined("right").astype(bool)
        self.object_of = np.concatenate([shard["object_of"] + start for shard, start in zip(shards, first)])

    def __len__(self) -> int:
        return len(self.shown)

    def batch(self, levels: np.ndarray, mirrored: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """What is told of levels: pictures held against them [batch, CHANNELS, SIDE, SIDE] and numbers [batch, NUMBERS]."""
        of = self.object_of[levels]
        told = torch.from_numpy(self.levels[levels])
        depth, pixel, eye = torch.from_numpy(self.objects[of]).unbind(1)
        heights, depths = (torch.from_numpy(x[of].astype(np.float32) * STEP_M) for x in (self.heights, self.depths))
        pictures = held_against(heights, depths, torch.from_numpy(self.shown[of]), torch.from_numpy(self.rises[of]), depth, eye, told[:, 0])
        if mirrored is not None:
            pictures = torch.where(mirrored[:, None, None, None], pictures.flip(3), pictures)
        return pictures, numbers(told, torch.from_numpy(self.rises[of]), depth, pixel, eye)


# ---- what services/shared/networks/src/feet.rs computes too; lengths in metres, heights over the rule's level, depths behind the object's middle

def held_against(heights: Tensor, depths: Tensor, shown: Tensor, rises: Tensor, depth: Tensor, eye: Tensor, level: Tensor) -> Tensor:
    read = ((shown == OWN) | (shown == OTHER) | (shown == FURNITURE)).float()
    meets = ((level - eye)[:, None] / rises.clamp(max=-0.05) - depth[:, None])[:, :, None].expand(-1, -1, SIDE)
    share = lambda length, of: (length / of).clamp(-1, 1)
    over = heights - level[:, None, None]
    flags = [(shown == what).float() for what in (OWN, OTHER, FURNITURE, BEYOND)]
    lengths = [share(over, 0.05) * read, share(over, 0.012) * read, share(depths, 0.15) * read]
    return torch.stack([*lengths, *flags, share(meets, 0.15), share(depths - meets, 0.05) * read], 1)


def numbers(told: Tensor, rises: Tensor, depth: Tensor, pixel: Tensor, eye: Tensor) -> Tensor:
    of_picture = [told[:, 1] / LOG_ODDS, (pixel / 0.004).log(), rises[:, SIDE // 2], depth - 1.0, eye - 0.7]
    return torch.cat([told[:, 2:], torch.stack(of_picture, 1)], 1)


class FeetNetwork(nn.Module):
    """Pictures and numbers → log-odds [batch] that objects end at the levels."""

    def __init__(self) -> None:
        super().__init__()
        inputs = CHANNELS
        for k, width in enumerate(WIDTHS):
            setattr(self, f"down{k}", Convolution(inputs, width, 2))
            setattr(self, f"same{k}", Convolution(width, width))
            inputs = width
        self.picture, self.numbers = nn.Linear(2 * inputs, HIDDEN), nn.Linear(NUMBERS, HIDDEN)
        self.both, self.head = nn.Linear(2 * HIDDEN, HIDDEN), nn.Linear(HIDDEN, 1)
        self.register_buffer("mean", torch.zeros(NUMBERS))
        self.register_buffer("per_unit", torch.ones(NUMBERS))

    def forward(self, pictures: Tensor, numbers: Tensor) -> Tensor:
        x = pictures
        for k in range(len(WIDTHS)):
            x = getattr(self, f"same{k}")(getattr(self, f"down{k}")(x))
        seen = F.relu(self.picture(torch.cat([x.mean((2, 3)), x.amax((2, 3))], 1)))
        told = F.relu(self.numbers(((numbers - self.mean) * self.per_unit).clamp(-UNUSUAL, UNUSUAL)))
        both = F.dropout(torch.cat([seen, told], 1), 0.2, self.training)
        both = F.dropout(F.relu(self.both(both)), 0.2, self.training)
        return self.head(both)[:, 0] + LOG_ODDS * numbers[:, MEASURES]


# ---- training

def train(args: argparse.Namespace) -> None:
    torch.manual_seed(args.seed)
    rng = np.random.default_rng(args.seed)
    feet = Feet(args.data)
    is_learned = feet.object_of < int(len(feet) * (1 - HELD_OUT))
    learned, held_out = np.where(is_learned)[0], np.where(~is_learned)[0]
    check_batch(learned, args)
    network = FeetNetwork()
    usual = torch.cat([feet.batch(part)[1] for part in np.array_split(learned[:: max(len(learned) // 20000, 1)], 100)])
    network.mean.copy_(usual.mean(0))
    network.per_unit.copy_(1 / (usual.std(0) + 1e-6))
    print(json.dumps({"objects": len(feet), "levels": len(feet.right), "held_out": figures(None, feet, held_out)}), flush=True)

    def loss_of(batch: np.ndarray, rng: np.random.Generator) -> Tensor:
        logits = network(*feet.batch(batch, torch.from_numpy(rng.random(len(batch)) < 0.5)))
        return F.binary_cross_entropy_with_logits(logits, torch.from_numpy(feet.right[batch].astype(np.float32)))

    trained(network, learned, 0.15, loss_of, lambda: figures(network, feet, held_out), {"levels": len(learned)}, rng, args)


@torch.no_grad()
def figures(network: FeetNetwork | None, feet: Feet, levels: np.ndarray) -> dict[str, float]:
    """Log loss of levels, and the share of objects, and of the surest nine tenths, whose chosen level is right: of the network, or of the trees without one."""
    if network:
        network.eval()
        said = torch.cat([network(*feet.batch(part)) for part in np.array_split(levels, max(len(levels) // 512, 1))])
    else:
        said = torch.from_numpy(feet.levels[levels, 1])
    right = feet.right[levels]
    loss = F.binary_cross_entropy_with_logits(said, torch.from_numpy(right.astype(np.float32))).item()
    likely = torch.sigmoid(said).numpy()
    starts = np.unique(feet.object_of[levels], return_index=True)[1]
    best = np.array([start + (k if p[k] >= p[0] + LIKELIER else 0) for start, p in zip(starts, np.split(likely, starts[1:])) for k in [int(np.argmax(p))]])
    surest = best[np.argsort(-likely[best])][: len(best) * 9 // 10]
    return {"log_loss": round(loss, 4), "right": round(float(right[best].mean()), 4), "right_of_surest_90": round(float(right[surest].mean()), 4)}


def export(args: argparse.Namespace) -> None:
    """Weights with norms folded in, in half precision; what is usual of numbers in single."""
    saved = torch.load(args.checkpoint, map_location="cpu", weights_only=True)
    network = FeetNetwork()
    network.load_state_dict(saved["network"])
    tensors = exported(network.eval(), "feet")
    tensors |= {"feet/usual/mean": network.mean.numpy(), "feet/usual/per_unit": network.per_unit.numpy()}
    metadata = {"format": "repose-feet-1", "steps": str(saved["step"]), "levels": str(saved["levels"]), "torch": torch.__version__, "recipe": args.recipe}
    save_file(tensors, args.export, metadata)


# ---- what the test in Rust compares with

def by_formula() -> tuple[Tensor, Tensor]:
    """Five levels of a picture that the test in Rust makes too."""
    row, column = torch.meshgrid(torch.arange(SIDE), torch.arange(SIDE), indexing="ij")
    count, levels = 5, torch.arange(5).float() * 0.01 - 0.02
    heights, depths = ((7 * row + 3 * column) % 23).float() * 0.005 - 0.03, ((5 * row + 2 * column) % 19).float() * 0.01 - 0.1
    shown, rises = (row + 2 * column) % 5, -0.2 - torch.arange(SIDE).float() * 0.01
    every = lambda x: x[None].expand(count, *x.shape)
    depth, pixel, eye = (torch.full((count,), value) for value in (0.9, 0.003, 0.6))
    measures = (torch.arange(MEASURES).float() % 7) / 7 - 0.3
    told = torch.cat([levels[:, None], levels[:, None] * 40, every(measures)], 1)
    return held_against(every(heights), every(depths), every(shown), every(rises), depth, eye, levels), numbers(told, every(rises), depth, pixel, eye)


@torch.no_grad()
def golden(args: argparse.Namespace) -> None:
    """Log-odds by exported weights of the formula's levels."""
    network = FeetNetwork()
    tensors = restored(network, "feet", args.weights)
    network.mean.copy_(torch.from_numpy(tensors["feet/usual/mean"]))
    network.per_unit.copy_(torch.from_numpy(tensors["feet/usual/per_unit"]))
    args.golden.write_text(json.dumps([round(value, 4) for value in network(*by_formula()).tolist()]))


if __name__ == "__main__":
    run(__doc__, "feet", 6, 192, "what they say of levels by formula", train, export, golden)
