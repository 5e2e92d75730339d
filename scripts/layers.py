"""What the networks that are trained in Python and served by Repose have in common: a layer, and the file that services/shared/networks/src/layer_file.rs reads."""
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
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
