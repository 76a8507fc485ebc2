"""The training loop of the segmentation network, and its files."""

from __future__ import annotations

import json
import math
import pickle
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from filelock import FileLock, Timeout

from sdfgcn.config import SegmentationTrainingConfig
from sdfgcn.config.diff import differences, flat
from sdfgcn.errors import SdfgcnError
from sdfgcn.files import CsvTable, replaced, write_json
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.perception.segmenters.config import UCNConfig
from sdfgcn.perception.segmenters.network import UCN
from sdfgcn.perception.segmenters.ucn import UCNSegmenter, make_network, save_network
from sdfgcn.progress_bar import progress_bar
from sdfgcn.segmentation.augment import augmented
from sdfgcn.segmentation.dataset import Pictures, load_pictures
from sdfgcn.segmentation.loss import clustering_loss
from sdfgcn.segmentation.scores import Example, score, summary, views

# What `torch.load` may raise for a truncated file or one that is no checkpoint.
_UNREADABLE = (
    OSError,
    RuntimeError,
    ValueError,
    TypeError,
    LookupError,
    EOFError,
    pickle.PickleError,
)

# Keys that may change on resume: how the training is run, and for how long. With another number of
# steps, the learning rate follows the new cosine schedule from then on.
_FREE_KEYS = (
    "steps",
    "out",
    "torch_threads",
    "checkpoint_steps",
    "validation_scenes",
    "arrangements.workers",
)
_SEGMENTATION = "env.perception.segmentation."  # binding: read by network or loss
_BINDING = tuple(_SEGMENTATION + key for key in ("channels", "widths", "embedding", "min_pixels"))
COLUMNS = ("step", "seconds", "learning_rate", "loss", "pull", "push")
SCORES = ("overlap_f", "overlap_precision", "overlap_recall", "boundary_f", "count_right")


def train(config: SegmentationTrainingConfig, folder: Path) -> Path:
    """Train the network, or resume the folder's training; return the weights file.

    Raises:
        SdfgcnError: The folder is in use, or its checkpoint is damaged or from another training.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / ".lock", timeout=0):
            training = Training(config, folder)
            training.resume()
            write_json(folder / "config.json", asdict(config))
            training.run(load_pictures(config), validation_views(config))
            weights = folder / "ucn.safetensors"
            save_network(training.network, _ucn(config), weights)
            return weights
    except Timeout:
        raise SdfgcnError(
            f"Another process is training in {folder}; wait for it or use another out=..."
        ) from None


class Training:
    """Network, optimiser and step: the state kept in a checkpoint.

    The pictures of an update and their augmentation depend only on the seed and the step, so no
    generator state needs to be saved.
    """

    def __init__(self, config: SegmentationTrainingConfig, folder: Path) -> None:
        """Start at step 0 with weights initialised from the seed."""
        self._config, self._folder = config, folder
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.network: UCN = make_network(_ucn(config))
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        )
        self.step = 0
        self._seconds = 0.0
        self._rows: list[dict[str, float]] = []
        self._metrics = CsvTable(folder / "metrics.csv", (*COLUMNS, *SCORES))

    # ------------------------------------------------------------------ the loop

    def run(self, pictures: Pictures, scenes: list[Example]) -> None:
        """Train to the last step, validating and saving a checkpoint every `checkpoint_steps`."""
        config, clock = self._config, time.monotonic()
        recent: list[tuple[float, float]] = []
        with progress_bar(
            total=config.steps, initial=self.step, desc="Training", unit="update"
        ) as bar:
            while self.step < config.steps:
                recent.append(self._update(pictures))
                self.step += 1
                bar.update()
                if self.step % config.checkpoint_steps == 0 or self.step == config.steps:
                    self._seconds += time.monotonic() - clock
                    row = self._row(recent, scenes)
                    self._rows.append(row)
                    bar.set_postfix(F=f"{row['overlap_f']:.3f}", count=f"{row['count_right']:.2f}")
                    self.save()
                    recent, clock = [], time.monotonic()

    def _update(self, pictures: Pictures) -> tuple[float, float]:
        """Take one optimiser step; return both terms of the loss.

        Raises:
            SdfgcnError: The loss or its gradient is not finite.
        """
        config = self._config
        rng = np.random.default_rng([config.seed, self.step])
        chosen = np.sort(rng.integers(len(pictures.pixels), size=config.batch))
        batch, labels = augmented(rng, pictures.pixels[chosen], pictures.labels[chosen])
        for group in self._optimiser.param_groups:
            group["lr"] = self._learning_rate()
        pull, push = clustering_loss(
            self.network(batch),
            labels,
            config.pull,
            config.push,
            _ucn(config).min_pixels,
        )
        self._optimiser.zero_grad()
        (pull + push).backward()
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        if not (pull + push + norm).isfinite():
            raise SdfgcnError(
                f"In update {self.step + 1}, the loss is {(pull + push).item():g} and the norm of "
                f"its gradient {norm.item():g}, so training cannot go on: lower learning_rate (now "
                f"{config.learning_rate:g})."
            )
        self._optimiser.step()
        return pull.item(), push.item()

    def _learning_rate(self) -> float:
        """Linear warm-up, then cosine decay to zero."""
        config = self._config
        if self.step < config.warmup:
            return config.learning_rate * (self.step + 1) / config.warmup
        done = (self.step - config.warmup) / max(1, config.steps - config.warmup)
        return config.learning_rate * 0.5 * (1.0 + math.cos(math.pi * done))

    def _row(self, recent: list[tuple[float, float]], scenes: list[Example]) -> dict[str, float]:
        """The row of `metrics.csv` for the updates since the last one."""
        segmenter = UCNSegmenter(_ucn(self._config), self.network.eval())
        scores = summary([scores for _, _, scores in score(segmenter, scenes)])
        self.network.train()
        pull, push = np.mean(recent, axis=0)
        return {
            "step": self.step,
            "seconds": round(self._seconds, 1),
            "learning_rate": self._learning_rate(),
            "loss": float(pull + push),
            "pull": float(pull),
            "push": float(push),
            **scores,
        }

    # ------------------------------------------------------------------ checkpoints

    @property
    def _checkpoint(self) -> Path:
        return self._folder / "checkpoint.pt"

    def save(self) -> None:
        """Write checkpoint and metrics, each atomically; the checkpoint holds the metrics too."""
        content = {
            "config": json.dumps(flat(asdict(self._config))),
            "network": self.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "step": self.step,
            "seconds": self._seconds,
            "rows": self._rows,
        }
        with replaced(self._checkpoint) as part:
            torch.save(content, part)
        self._metrics.write(self._rows)

    def resume(self) -> None:
        """Resume from the folder's checkpoint, if there is one.

        Raises:
            SdfgcnError: The checkpoint is damaged or from another training.
        """
        if not self._checkpoint.exists():
            return
        state = _read_checkpoint(self._checkpoint)
        before, now = (
            {key: value for key, value in values.items() if _binds(key)}
            for values in (json.loads(state["config"]), flat(asdict(self._config)))
        )
        if differing := differences(before, now):
            raise SdfgcnError(
                f"{self._checkpoint} is of another training, which differs in {differing}; use the "
                "same values or another out=..."
            )
        self.network.load_state_dict(state["network"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.step, self._seconds = state["step"], state["seconds"]
        self._rows = state["rows"]
        self._metrics.write(self._rows)


def validation_views(config: SegmentationTrainingConfig) -> list[Example]:
    """Views of the environment's own start layouts, with training objects of every catalogue."""
    each = max(1, config.validation_scenes // len(config.catalogues))
    return [
        view
        for objects in config.catalogues.values()
        for view in views(
            replace(config.env, objects=objects),
            load_catalogue(objects, "train"),
            [config.n_objects],
            each,
        )
    ]


def _read_checkpoint(path: Path) -> dict[str, Any]:
    """Read the file as data: with `weights_only`, torch refuses one that would run code."""
    try:
        state = torch.load(path, weights_only=True)
        missing = {"config", "network", "optimiser", "step", "seconds", "rows"} - set(state)
        if missing:
            raise ValueError(f"it lacks {sorted(missing)[0]}")
    except _UNREADABLE as error:
        raise SdfgcnError(
            f"The checkpoint {path} cannot be read ({type(error).__name__}); delete it to "
            "start from the beginning, or use another out=..."
        ) from error
    return state


def _binds(key: str) -> bool:
    """Whether this key must keep its value when a training resumes."""
    if key.startswith(_SEGMENTATION):
        return key in _BINDING
    return key not in _FREE_KEYS


def _ucn(config: SegmentationTrainingConfig) -> UCNConfig:
    segmentation = config.env.perception.segmentation
    assert isinstance(segmentation, UCNConfig)
    return segmentation
