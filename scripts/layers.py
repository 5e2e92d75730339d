"""What the networks that are trained in Python and served by Repose have in common: a layer, the file that services/shared/networks/src/layer_file.rs reads, and,
of those that learn from objects, the shards, the training and the command line."""
import argparse, json, re, time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from safetensors import safe_open
from safetensors.numpy import load_file
from torch import Tensor, nn


class Convolution(nn.Module):
    """3 x 3 or 1 x 1, batch norm, ReLU."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1, size: int = 3, relu: bool = True):
        super().__init__()
        self.convolution = nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False)
        self.norm, self.relu = nn.BatchNorm2d(outputs), relu

    def forward(self, x: Tensor) -> Tensor:
        x = self.norm(self.convolution(x))
        return F.relu(x) if self.relu else x

    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight [outputs, rows, columns, inputs] and bias with the norm in them."""
        factor = self.norm.weight / (self.norm.running_var + self.norm.eps).sqrt()
        weight = self.convolution.weight * factor[:, None, None, None]
        return weight.permute(0, 2, 3, 1), self.norm.bias - self.norm.running_mean * factor


def exported(network: nn.Module, name: str) -> dict[str, np.ndarray]:
    """A network's layers for its weights file: norms folded in, in half precision."""
    tensors = {}
    for layer, module in network.named_children():
        if isinstance(module, Convolution):
            weight, bias = module.folded()
        else:
            weight, bias = module.weight, module.bias
            weight = weight.permute(0, 2, 3, 1) if weight.dim() == 4 else weight
        for part, values in (("weight", weight), ("bias", bias)):
            tensors[f"{name}/{layer}/{part}"] = values.detach().half().contiguous().numpy()
    return tensors


def restored(network: nn.Module, name: str, path: Path) -> dict[str, np.ndarray]:
    """Gives a network the layers of a weights file, to be evaluated; the file's tensors."""
    tensors = load_file(path)
    with torch.no_grad():
        for layer, module in network.named_children():
            weight, bias = (torch.from_numpy(tensors[f"{name}/{layer}/{part}"]).float() for part in ("weight", "bias"))
            weight = weight.permute(0, 3, 1, 2) if weight.dim() == 4 else weight
            if isinstance(module, Convolution):
                module.convolution.weight.copy_(weight)
                module.norm.bias.copy_(bias)
                module.norm.eps = 1e-12  # the norm is in the weights already
            else:
                module.weight.copy_(weight)
                module.bias.copy_(bias)
    network.eval()
    return tensors


def loaded(name: str, folders: list[Path]) -> list[dict[str, np.ndarray]]:
    """The shards `NAME-FIRST-END.safetensors` of some folders, in the order of their scenes. A network that learned from some that were made with other trees
    and networks than the rest would be right for neither, and of a scene that is in two one copy may be learned from while the other is held out."""
    named = re.compile(re.escape(name) + r"-(\d{7,})-(\d{7,})\.safetensors")
    files = [(named.fullmatch(path.name), path) for folder in folders for path in folder.glob(f"{name}-*.safetensors")]
    shards = sorted((int(match[1]), int(match[2]), path) for match, path in files if match)
    if not shards:
        raise SystemExit(f"--data: no {name}-*.safetensors in {', '.join(map(str, folders)) or 'no folder'}")
    for (_, end, path), (first, _, other) in pairwise(shards):
        if first < end:
            raise SystemExit(f"--data: {path} and {other} have scenes in common")
    made_with = {}
    for _, _, path in shards:
        with safe_open(path, "numpy") as shard:
            made_with.setdefault((shard.metadata() or {}).get("made_with"), path)
    if None in made_with:
        raise SystemExit(f"--data: {made_with[None]} does not say what it was made with: make it anew")
    if len(made_with) > 1:
        raise SystemExit(f"--data: {', '.join(f'{path} was made with {by}' for by, path in made_with.items())}: expected the same for all")
    return [load_file(path) for _, _, path in shards]


def check_batch(learned: np.ndarray, args: argparse.Namespace) -> None:
    """Refuses batches that what is learned from does not fill."""
    if not 1 <= args.batch <= len(learned):
        raise SystemExit(f"--batch {args.batch}: expected at least 1 and at most the {len(learned)} samples of --data that are learned from")


def trained(network: nn.Module, learned: np.ndarray, rises: float, loss_of: Callable[[np.ndarray, np.random.Generator], Tensor],
            held_out: Callable[[], dict], kept: dict[str, int], rng: np.random.Generator, args: argparse.Namespace) -> None:
    """Trains a network for some epochs of what is learned from, and keeps its state after each; goes on from that if it is there. The learning rate rises for a
    share of the steps; `loss_of` is told the sorted indices of a batch, `held_out` gives figures after each epoch, `kept` goes with the state."""
    per_epoch = len(learned) // args.batch
    total = max(int(per_epoch * args.epochs), 1)
    optimiser = torch.optim.AdamW(network.parameters(), lr=args.rate, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, args.rate, total_steps=total + 1, pct_start=rises)
    first = 0
    if args.checkpoint.exists():
        saved = torch.load(args.checkpoint, weights_only=True)
        if saved["total"] != total:
            raise SystemExit(f"{args.checkpoint}: of a run of {saved['total']} steps, expected {total}: take another file or the same data and --epochs")
        network.load_state_dict(saved["network"])
        optimiser.load_state_dict(saved["optimiser"])
        schedule.load_state_dict(saved["schedule"])
        first = saved["step"]
        rng = np.random.default_rng(args.seed + first)
    order, losses, start = rng.permutation(learned), [], time.time()
    for step in range(first, total):
        network.train()
        at = (step % per_epoch) * args.batch
        if at == 0:
            order = rng.permutation(learned)
        loss = loss_of(np.sort(order[at:at + args.batch]), rng)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        losses.append(loss.item())
        done = step + 1
        if done % 100 == 0:
            print(json.dumps({"step": done, "of": total, "loss": round(float(np.mean(losses[-100:])), 4), "seconds": round(time.time() - start)}), flush=True)
        if done % per_epoch == 0 or done == total:
            print(json.dumps({"held_out": held_out()}), flush=True)
            unfinished = args.checkpoint.with_name(args.checkpoint.name + ".tmp")
            state = {"network": network.state_dict(), "optimiser": optimiser.state_dict(), "schedule": schedule.state_dict()}
            torch.save({**state, "step": done, "total": total, **kept}, unfinished)
            unfinished.replace(args.checkpoint)


def run(description: str, name: str, epochs: float, batch: int, says: str, train: Callable, export: Callable, golden: Callable) -> None:
    """The command line of a network of that name: trains, or exports, or writes what the test in Rust compares with, `says`."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, action="append", default=[], help="a folder of shards; the last objects are held out")
    parser.add_argument("--checkpoint", type=Path, default=Path(f"{name}.pt"), help="where the state is kept after each epoch, and gone on from if it is there")
    parser.add_argument("--epochs", type=float, default=epochs)
    parser.add_argument("--batch", type=int, default=batch)
    parser.add_argument("--rate", type=float, default=2e-3, help="highest learning rate")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--export", type=Path, help="write the weights here instead of training")
    parser.add_argument("--weights", type=Path, help="exported weights, for --golden")
    parser.add_argument("--golden", type=Path, help=f"write {says} here, for the test in Rust")
    parser.add_argument("--recipe", default="", help="kept in the weights' metadata")
    args = parser.parse_args()
    if args.golden and not args.weights:
        parser.error("--golden needs --weights")
    if args.golden:
        golden(args)
    elif args.export:
        export(args)
    else:
        train(args)
