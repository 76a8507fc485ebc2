"""Train the segmentation network: `python -m sdfgcn.segmentation.train KEY=VALUE ...`.

`conf/train_segmentation.yaml` has the keys. The folder `out` receives the config, a checkpoint,
`metrics.csv` and finally `ucn.safetensors`; with the same folder, an interrupted training resumes.
"""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from sdfgcn.compose import compose_config, conf_dir
from sdfgcn.config import SegmentationTrainingConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.opengl import check_opengl
from sdfgcn.segmentation.training import train
from sdfgcn.validation import typed_segmentation_training

CONFIG = "train_segmentation"  # in conf/


def load_config(*overrides: str) -> SegmentationTrainingConfig:
    """The validated config of a training.

    Raises:
        SdfgcnError: A value is out of its range.
        HydraException: An override cannot be parsed, or names an unknown key or option.
        OmegaConfBaseException: A value is missing or of the wrong type.
    """
    return typed_segmentation_training(compose_config(overrides, CONFIG))


def main(arguments: list[str]) -> int:
    """Run the command line; return the exit code."""
    if {"-h", "--help"} & set(arguments):
        print(f"{__doc__}\n{(conf_dir() / CONFIG).with_suffix('.yaml').read_text()}")
        return 0
    try:
        check_opengl()
        config = load_config(*arguments)
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
    sys.exit(main(sys.argv[1:]))
