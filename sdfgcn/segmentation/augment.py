"""Cheap augmentations of training pictures and their labels."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import avg_pool2d

FLIP, TURN, COLOUR, NOISE, BLUR = 0.5, 0.25, 0.5, 0.25, 0.08  # probability of each


def augmented(
    rng: np.random.Generator, pixels: NDArray[np.uint8], labels: NDArray[np.uint8]
) -> tuple[Tensor, Tensor]:
    """Randomly flip, rotate, recolour, blur and add noise to square pictures [B, H, W, 3].

    Returns:
        [B, 3, H, W] float32, 0 to 1, and [B, H, W] int64.
    """
    pictures, truths = [], []
    for picture, truth in zip(pixels, labels, strict=True):
        if rng.random() < FLIP:
            picture, truth = picture[:, ::-1], truth[:, ::-1]
        if rng.random() < TURN:
            turns = int(rng.integers(1, 4))
            picture, truth = np.rot90(picture, turns), np.rot90(truth, turns)
        pictures.append(_recoloured(rng, picture.astype(np.float32) / 255.0))
        truths.append(truth.astype(np.int64))
    batch = torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2)
    blurred = np.flatnonzero(rng.random(len(batch)) < BLUR)
    if len(blurred):
        batch[blurred] = avg_pool2d(batch[blurred], 3, 1, 1, count_include_pad=False)
    return batch, torch.from_numpy(np.stack(truths))


def _recoloured(rng: np.random.Generator, picture: NDArray[np.float32]) -> NDArray[np.float32]:
    if rng.random() < COLOUR:
        picture = picture[..., rng.permutation(3)]  # another hue, cheaply
        gain = rng.uniform(0.6, 1.3) * rng.normal(1.0, 0.05, 3)
        picture = picture * gain.astype(np.float32) + np.float32(rng.normal(0.0, 0.03))
    if rng.random() < NOISE:
        strength = np.float32(rng.uniform(0.0, 0.02))
        picture = picture + strength * rng.standard_normal(picture.shape, dtype=np.float32)
    return np.clip(picture, 0.0, 1.0)
