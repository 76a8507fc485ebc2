"""ResNet-18 or ResNet-50 (He et al. 2016) with a user-supplied torchvision state dict.

The authors match with ResNet-50. Module names follow torchvision, so that its files load;
torchvision itself is not needed.
"""

from __future__ import annotations

import pickle
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn, relu_

from sdfgcn.config import EncoderConfig, one_of
from sdfgcn.errors import SdfgcnError
from sdfgcn.perception.encoders.encoder import Encoder
from sdfgcn.perception.trained import not_finite
from sdfgcn.registry import ENCODERS

_WIDTHS = (64, 128, 256, 512)
_UNREADABLE = (
    *(OSError, EOFError, RuntimeError, ValueError, pickle.UnpicklingError, SafetensorError),
)


class Block(nn.Module):
    """Convolutions with a shortcut, which is a projection if the shapes differ."""

    def __init__(self, inputs: int, width: int, outputs: int, stride: int, kernels: Sequence[int]):
        """Create the layers; the first 3x3 convolution has the stride, as in torchvision."""
        super().__init__()
        self._depth, channels = len(kernels), inputs
        strides = [stride if k == kernels.index(3) else 1 for k in range(len(kernels))]
        for k, (kernel, step) in enumerate(zip(kernels, strides, strict=True), start=1):
            after = outputs if k == len(kernels) else width
            conv = nn.Conv2d(channels, after, kernel, step, padding=kernel // 2, bias=False)
            self.add_module(f"conv{k}", conv)
            self.add_module(f"bn{k}", nn.BatchNorm2d(after))
            channels = after
        self.downsample: nn.Module = nn.Identity()
        if stride != 1 or inputs != outputs:
            conv = nn.Conv2d(inputs, outputs, 1, stride, bias=False)
            self.downsample = nn.Sequential(conv, nn.BatchNorm2d(outputs))

    def forward(self, x: Tensor) -> Tensor:
        """[B, inputs, h, w] -> [B, outputs, h / stride, w / stride]."""
        y = x
        for k in range(1, self._depth + 1):
            y = self.get_submodule(f"bn{k}")(self.get_submodule(f"conv{k}")(y))
            y = relu_(y) if k < self._depth else y
        return relu_(y + self.downsample(x))


# Depth -> kernel sizes of a block, its output channels / width, and the number of blocks in each of
# the four stages (He et al. 2016, table 1).
DEPTHS: dict[int, tuple[tuple[int, ...], int, tuple[int, int, int, int]]] = {
    18: ((3, 3), 1, (2, 2, 2, 2)),
    50: ((1, 3, 1), 4, (3, 4, 6, 3)),
}


class TorchvisionResNet(nn.Module):
    """The network with torchvision's names, including the classifier for strict loading."""

    def __init__(self, depth: int) -> None:
        """Create the layers; `depth` is a key of `DEPTHS`."""
        super().__init__()
        kernels, expansion, counts = DEPTHS[depth]
        self.conv1 = nn.Conv2d(3, _WIDTHS[0], 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(_WIDTHS[0])
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        inputs = _WIDTHS[0]
        for number, (width, count) in enumerate(zip(_WIDTHS, counts, strict=True), start=1):
            blocks = []
            for i in range(count):
                stride = 2 if i == 0 and number > 1 else 1
                blocks.append(Block(inputs, width, expansion * width, stride, kernels))
                inputs = expansion * width
            self.add_module(f"layer{number}", nn.Sequential(*blocks))
        self.fc = nn.Linear(inputs, 1000)


@dataclass
class ResNetConfig(EncoderConfig):
    """The depth of the network and the path of its weights."""

    path: str | None = None
    depth: int = one_of(*DEPTHS)


@ENCODERS.register("resnet", config=ResNetConfig)
class ResNet(Encoder):
    """Stages 1 to 4 are torchvision's `layer1` to `layer4`."""

    n_stages = len(_WIDTHS)

    def __init__(self, config: ResNetConfig) -> None:
        """Build the network and load its weights.

        Raises:
            SdfgcnError: `stages` is out of range; `path` is missing, cannot be read, or is not a
                torchvision state dict of that depth.
        """
        super().__init__(config.stages)
        with torch.device("meta"):  # draws nothing from torch's generator
            self._network = TorchvisionResNet(config.depth)
        _load(self._network, config)
        self._network.eval().requires_grad_(False).float()
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def stem(self, pictures: Tensor) -> Tensor:
        """[B, 3, S, S] -> [B, 64, S / 4, S / 4]."""
        network = self._network
        return network.maxpool(network.relu(network.bn1(network.conv1(pictures))))

    def stage(self, number: int, maps: Tensor) -> Tensor:
        """One of `layer1` to `layer4`."""
        return self._network.get_submodule(f"layer{number}")(maps)


def _load(network: nn.Module, config: ResNetConfig) -> None:
    if config.path is None:
        raise SdfgcnError(
            f"encoder={config.name} has no weights: set env.perception.encoder.path to a "
            f"torchvision state dict of ResNet-{config.depth} (.pth or .safetensors)."
        )
    path = Path(config.path).expanduser()
    if not path.is_file():
        raise SdfgcnError(
            f"env.perception.encoder.path is '{config.path}', but there is no such file."
        )
    state = _read(path)
    try:
        network.load_state_dict(state, assign=True)
    except (AttributeError, RuntimeError, TypeError) as error:
        raise SdfgcnError(
            f"'{path}' does not hold torchvision's ResNet-{config.depth}: {_first_fault(error)}; "
            "give that network's file as env.perception.encoder.path, or set "
            "env.perception.encoder.depth to the file's."
        ) from error
    if name := not_finite(state):
        raise SdfgcnError(f"'{path}' is damaged: its weights '{name}' are not finite.")


def _read(path: Path) -> dict[str, Tensor]:
    """Read a user's file as data; neither way runs code that a file may hold."""
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        return torch.load(path, map_location="cpu", weights_only=True)
    except _UNREADABLE as error:
        raise SdfgcnError(f"'{path}' cannot be read as weights ({_short(error)}).") from error


def _first_fault(error: Exception) -> str:
    """The first of the faults in torch's message."""
    message = " ".join(str(error).split())
    found = re.search(r'(Missing|Unexpected) key\(s\) in state_dict: ("[^"]+")', message)
    if found:
        return f"{found[1].lower()} key {found[2]}"
    found = re.search(r"size mismatch for ([\w.]+)", message)
    return f"the wrong shape of {found[1]}" if found else _short(error)


def _short(error: Exception) -> str:
    """The first sentence of a message, on one line."""
    return " ".join(str(error).split()).split(". ")[0].rstrip(".") or type(error).__name__
