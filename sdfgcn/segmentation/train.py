"""Train the segmentation network: `python -m sdfgcn.segmentation.train`.

Takes overrides as `run.py` does; `conf/train_segmentation.yaml` has the keys. The folder `out` holds the
config, a checkpoint, `metrics.csv` and, in the end, `ucn.safetensors`; the same folder goes on
with a training that was cut off.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")  # before MuJoCo loads: render without a display

import hydra
import torch
from hydra.core.config_store import ConfigStore
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from sdfgcn.config import SegmentationTrainingConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.opengl import check_opengl
from sdfgcn.segmentation.training import train
from sdfgcn.validation import validate_segmentation_training

CONF = Path(__file__).resolve().parents[2] / "conf"

ConfigStore.instance().store(name="train_segmentation_schema", node=SegmentationTrainingConfig)


def typed(cfg: DictConfig) -> SegmentationTrainingConfig:
    """Turn Hydra's config into dataclasses and validate it.

    Raises:
        SdfgcnError: A value is out of its range.
        OmegaConfBaseException: A key is unknown or a value is missing.
    """
    values = OmegaConf.to_container(cfg, resolve=True)
    config = OmegaConf.to_object(
        OmegaConf.merge(OmegaConf.structured(SegmentationTrainingConfig), values)
    )
    assert isinstance(config, SegmentationTrainingConfig)
    validate_segmentation_training(config)
    return config


def main() -> int:
    """Train as the command line says; return the exit code."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises then, instead of printing lines of its own
    composed: list[DictConfig] = []

    # Hydra only composes: an error of its job would come with lines of its own.
    @hydra.main(config_path=str(CONF), config_name="train_segmentation", version_base="1.3")
    def compose(cfg: DictConfig) -> None:
        composed.append(cfg)

    try:
        compose()
        for cfg in composed:  # none after --help or --cfg
            config = typed(cfg)
            check_opengl()
            torch.set_num_threads(config.torch_threads)
            print(f"Wrote {train(config, Path(config.out))}.")
    except (SdfgcnError, HydraException, OmegaConfBaseException) as error:
        reasons = [str(link).splitlines()[0] for link in (error, error.__cause__) if link]
        print(": ".join(reasons), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
