"""ResNet-18 or ResNet-50 (He et al. 2016) with a torchvision state dict that the user gives.

The authors match by ResNet-50. Modules are named as torchvision names them, so that its files
load; torchvision itself is not needed.
"""

from __future__ import annotations

import pickle
import re
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from sdfgcn.config import EncoderConfig, one_of
from sdfgcn.errors import SdfgcnError
from sdfgcn.perception.encoders.encoder import Encoder
from sdfgcn.registry import ENCODERS

_WIDTHS = (64, 128, 256, 512)
_UNREADABLE = (
    *(OSError, EOFError, RuntimeError, ValueError, pickle.UnpicklingError, SafetensorError),
)


class BasicBlock(nn.Module):
    """Two 3x3 convolutions and a shortcut."""

    expansion = 1

    def __init__(self, inputs: int, width: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, width, 3, stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.relu = nn.ReLU(inplace=True)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.downsample = _shortcut(inputs, width, stride)

    def forward(self, x: Tensor) -> Tensor:
        """[B, inputs, h, w] -> [B, width, h / stride, w / stride]."""
        y = self.bn2(self.conv2(self.relu(self.bn1(self.conv1(x)))))
        return self.relu(y + (x if self.downsample is None else self.downsample(x)))


class Bottleneck(nn.Module):
    """1x1, 3x3 and 1x1 convolutions and a shortcut; the 3x3 one strides, as in torchvision."""

    expansion = 4

    def __init__(self, inputs: int, width: int, stride: int) -> None:
        super().__init__()
        outputs = self.expansion * width
        self.conv1 = nn.Conv2d(inputs, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, stride, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, outputs, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(outputs)
        self.relu = nn.ReLU(inplace=True)
        self.downsample = _shortcut(inputs, outputs, stride)

    def forward(self, x: Tensor) -> Tensor:
        """[B, inputs, h, w] -> [B, 4 * width, h / stride, w / stride]."""
        y = self.relu(self.bn2(self.conv2(self.relu(self.bn1(self.conv1(x))))))
        y = self.bn3(self.conv3(y))
        return self.relu(y + (x if self.downsample is None else self.downsample(x)))


def _shortcut(inputs: int, outputs: int, stride: int) -> nn.Sequential | None:
    """The projection of a shortcut; None where the shapes agree."""
    if stride == 1 and inputs == outputs:
        return None
    conv = nn.Conv2d(inputs, outputs, 1, stride, bias=False)
    return nn.Sequential(conv, nn.BatchNorm2d(outputs))


# Kind of block, and blocks in each of the four stages, by depth (He et al. 2016, table 1).
DEPTHS: dict[int, tuple[type[BasicBlock] | type[Bottleneck], tuple[int, int, int, int]]] = {
    18: (BasicBlock, (2, 2, 2, 2)),
    50: (Bottleneck, (3, 4, 6, 3)),
}


class TorchvisionResNet(nn.Module):
    """The network with torchvision's names, the classifier included, so that keys can be strict."""

    def __init__(self, depth: int) -> None:
        """Build it with random weights; `depth` is a key of `DEPTHS`."""
        super().__init__()
        block, counts = DEPTHS[depth]
        self.conv1 = nn.Conv2d(3, _WIDTHS[0], 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(_WIDTHS[0])
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        inputs = _WIDTHS[0]
        for number, (width, count) in enumerate(zip(_WIDTHS, counts, strict=True), start=1):
            blocks = []
            for i in range(count):
                blocks.append(block(inputs, width, stride=2 if i == 0 and number > 1 else 1))
                inputs = block.expansion * width
            self.add_module(f"layer{number}", nn.Sequential(*blocks))
        self.fc = nn.Linear(inputs, 1000)


@dataclass
class ResNetConfig(EncoderConfig):
    """Which network, and its weights."""

    path: str | None = None
    depth: int = one_of(*DEPTHS)


@ENCODERS.register("resnet", config=ResNetConfig)
class ResNet(Encoder):
    """Stages 1 to 4 are torchvision's `layer1` to `layer4`."""

    n_stages = len(_WIDTHS)

    def __init__(self, config: ResNetConfig) -> None:
        """Build the network and load its weights.

        Raises:
            SdfgcnError: `stages` is out of range; `path` is missing, cannot be read, or holds
                something else than a torchvision state dict of that depth.
        """
        super().__init__(config.stages)
        with torch.device("meta"):  # nothing drawn from torch's generator
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


def _read(path: Path) -> dict[str, Tensor]:
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        return torch.load(path, map_location="cpu", weights_only=True)
    except _UNREADABLE as error:
        raise SdfgcnError(f"'{path}' cannot be read as weights ({_short(error)}).") from error


def _first_fault(error: Exception) -> str:
    """The first of the many keys that torch complains of."""
    message = " ".join(str(error).split())
    found = re.search(r'(Missing|Unexpected) key\(s\) in state_dict: ("[^"]+")', message)
    if found:
        return f"{found[1].lower()} key {found[2]}"
    found = re.search(r"size mismatch for ([\w.]+)", message)
    return f"the wrong shape of {found[1]}" if found else _short(error)


def _short(error: Exception) -> str:
    """The first sentence of a message, on one line."""
    return " ".join(str(error).split()).split(". ")[0].rstrip(".") or type(error).__name__
