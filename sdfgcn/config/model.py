"""What picks the push: the dataclasses of `conf/model/`."""

from __future__ import annotations

from dataclasses import dataclass

from omegaconf import MISSING

from sdfgcn.config.base import ComponentConfig


@dataclass
class ModelConfig(ComponentConfig):
    """Which method picks the push (`conf/model/`); each extends it with its own keys."""


@dataclass
class QNetworkConfig(ModelConfig):
    """A Q-network: a method that is trained, or evaluated from a checkpoint."""


@dataclass
class ConvWidthConfig:
    """Convolutions of a network over pictures: one entry a CNN block, in it one a convolution."""

    channels: list[list[int]] = MISSING
    strides: list[list[int]] = MISSING
    pooling: list[int] = MISSING
    hidden: int = MISSING


@dataclass
class ConvModelConfig(QNetworkConfig):
    """A Q-network over pictures without a graph (`conf/model/sdf_cnn.yaml`)."""

    features: str = MISSING
    sdf_unit: float = MISSING
    width: str = MISSING
    widths: dict[str, ConvWidthConfig] = MISSING


@dataclass
class ConvGcnConfig(ConvModelConfig):
    """A graph convolutional Q-network over pictures (`conf/model/sdfgcn.yaml` and ablations)."""

    edges: str = MISSING
    propagation: str = MISSING


@dataclass
class PoseGcnConfig(QNetworkConfig):
    """A graph convolutional Q-network over positions (`conf/model/pose_gcn.yaml`)."""

    features: str = MISSING
    position_unit: float = MISSING
    channels: list[list[int]] = MISSING
    hidden: int = MISSING
    edges: str = MISSING
    propagation: str = MISSING


# What stands behind each option of `conf/model/`; one that is not named has a name only.
MODEL_CONFIGS: dict[str, type[ModelConfig]] = {
    "sdfgcn": ConvGcnConfig,
    "separate": ConvGcnConfig,
    "segmentation_gcn": ConvGcnConfig,
    "pose_gcn": PoseGcnConfig,
    "gt_pose_gcn": PoseGcnConfig,
    "sdf_cnn": ConvModelConfig,
}
