"""ImageNet-pretrained networks that turn pictures of objects into features (`encoder=NAME`)."""

from __future__ import annotations

from collections.abc import Callable

from sdfgcn.config import EncoderConfig
from sdfgcn.perception.encoders.efficientnet_lite0 import EfficientNetLite0
from sdfgcn.perception.encoders.encoder import Encoder
from sdfgcn.perception.encoders.resnet import ResNet

ENCODERS: dict[str, Callable[[EncoderConfig], Encoder]] = {
    "efficientnet_lite0": EfficientNetLite0,
    "resnet": ResNet,
}
