"""Match current masks with goal masks by appearance (paper section V A).

Objects are a few pixels across and arbitrarily rotated. The features of each mask's patch are
therefore averaged over evenly spaced rotations, so that they can be compared by plain distance.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from torch import Tensor
from torch.nn.functional import grid_sample, normalize

from sdfgcn.config import EncoderConfig
from sdfgcn.perception.encoders.encoder import IMAGENET_MEAN, IMAGENET_STD
from sdfgcn.registry import ENCODERS

KEPT_FEATURES = 512  # feature vectors that a matcher caches, a kilobyte each
_MEAN = np.array(IMAGENET_MEAN, dtype=np.float32)
_STD = np.array(IMAGENET_STD, dtype=np.float32)


class Matcher:
    """Computes features of masked patches and the assignment of least total distance.

    Features depend on the patch alone, not on the rest of the picture, the object's position or
    the cache.
    """

    def __init__(self, config: EncoderConfig) -> None:
        """Load the encoder.

        Raises:
            SdfgcnError: There is no such encoder, or its weights cannot be loaded.
        """
        self._config = config
        self._encoder = ENCODERS.find(config.name)(config)
        turns = torch.arange(config.rotations) * (2.0 * math.pi / config.rotations)
        self._offsets = _offsets(config.input_size, turns, math.radians(config.camera_tilt))
        self._remembered = functools.lru_cache(maxsize=KEPT_FEATURES)(self._encode)

    def features(self, pixels: NDArray[np.uint8], masks: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Appearance features of the objects under masks [m, H, W] of a picture [H, W, 3].

        Objects whose appearance is unchanged come from the cache.

        Returns:
            [m, F]; zero for an empty mask.
        """
        rows = [self._feature(pixels, mask) for mask in masks]
        return np.stack(rows) if rows else np.zeros((0, self.n_features), dtype=np.float32)

    def match(
        self, features: NDArray[np.float32], goal_features: NDArray[np.float32]
    ) -> NDArray[np.int64]:
        """Assign current objects [m, F] to goal objects [n, F] by least total L2 distance.

        Uses the Hungarian algorithm.

        Returns:
            [m] distinct goal rows, -1 for unmatched objects; min(m, n) objects are matched.
        """
        correspondence = np.full(len(features), -1, dtype=np.int64)
        if len(features) and len(goal_features):
            cost = np.linalg.norm(features[:, None] - goal_features[None], axis=-1)
            rows, columns = linear_sum_assignment(cost)
            correspondence[rows] = columns
        return correspondence

    @functools.cached_property
    def n_features(self) -> int:
        """F, the length of a feature vector."""
        return len(self._encode(bytes(3), b"\x80", (1, 1), 1))

    def _feature(self, pixels: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
        if not mask.any():
            return np.zeros(self.n_features, dtype=np.float32)
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        inside = mask[box]
        patch = np.where(inside[..., None], pixels[box], 0).astype(np.uint8)
        # Bytes serve as the cache key, which excludes the position.
        return self._remembered(
            patch.tobytes(), np.packbits(inside).tobytes(), inside.shape, mask.shape[0]
        )

    def _encode(
        self, patch: bytes, packed: bytes, shape: tuple[int, int], height: int
    ) -> NDArray[np.float32]:
        """The features [F] of one object.

        Args:
            patch: Its bounding box, uint8 [h, w, 3].
            packed: The mask of the box, bool [h, w], packed to bits.
            shape: (h, w).
            height: Height of the whole picture, pixels.
        """
        rgb = np.frombuffer(patch, dtype=np.uint8).reshape(*shape, 3).astype(np.float32) / 255.0
        bits = np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=shape[0] * shape[1])
        mask = bits.reshape(shape).astype(bool)
        pictures, masks = self._turned(rgb, mask, self._config.patch * height)
        # Normalising weighs all stages equally; the mean over rotations is rotation-invariant.
        stages = [normalize(stage.mean(dim=0), dim=0) for stage in self._encoder(pictures, masks)]
        color = self._config.color_weight * torch.from_numpy(rgb[mask].mean(axis=0))
        feature = torch.cat([*stages, color]).numpy()
        feature.flags.writeable = False
        return feature

    def _turned(
        self, rgb: NDArray[np.float32], mask: NDArray[np.bool_], side: float
    ) -> tuple[Tensor, Tensor]:
        """Rotate and enlarge the object about its centroid, once per rotation.

        All objects are enlarged by the same factor, since size distinguishes them. The background
        is ImageNet's mean colour.

        Args:
            rgb: [h, w, 3], 0 to 1.
            mask: [h, w].
            side: Side of the picture square that becomes the network's input, pixels.

        Returns:
            float32 [R, 3, S, S] normalised pictures and [R, 1, S, S] masks.
        """
        normalised = (rgb - _MEAN) / _STD
        layers = np.dstack([normalised, np.ones_like(mask)]) * mask[..., None]
        image = torch.from_numpy(layers.astype(np.float32)).permute(2, 0, 1)
        rows, columns = np.nonzero(mask)
        centroid = torch.tensor([columns.mean() + 0.5, rows.mean() + 0.5])
        size = torch.tensor([mask.shape[1], mask.shape[0]])
        grid = ((centroid + side * self._offsets) / size * 2.0 - 1.0).float()
        batch = image.expand(len(grid), -1, -1, -1)
        sampled = grid_sample(batch, grid, mode="bicubic", align_corners=False)
        return sampled[:, :3], sampled[:, 3:].clamp(0.0, 1.0)


def _offsets(size: int, turns: Tensor, tilt: float) -> Tensor:
    """[R, S, S, 2] sampling offsets of the rotated input's pixels, in units of the patch's side.

    The table appears foreshortened along v by the cosine of the camera's tilt. Rotation takes
    place in the table plane, so that flat objects keep their shape.
    """
    steps = (torch.arange(size, dtype=torch.float64) + 0.5) / size - 0.5
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    cos, sin = (f(turns.double())[:, None, None] for f in (torch.cos, torch.sin))
    return torch.stack([cos * x - sin * y, (sin * x + cos * y) * math.cos(tilt)], dim=-1)
