"""The contents of one picture as a typed container.

An observation holds two scenes, `scene` (the table now) and `goal`: row i of both shows the same
object wherever `matched` is true. Each field is declared once, with its source, its shape, how it
is mirrored and how a replay buffer stores it. The env, the replay buffer, hindsight, the mirror
and the networks handle whole scenes and keep no list of fields, so a subclass with another field
only has to be set as the env's `scene_type`.

Shapes: `*B` is the batch shape, N the rows (`env.max_objects`), H and W the picture's size, m the
detected objects.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self, cast

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorClass
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded


@dataclass(frozen=True)
class Detections:
    """The m objects detected in one picture.

    Attributes:
        masks: bool [m, H, W].
        sdf: float32 [m, H, W] signed distance to the mask's contour, pixels, negative inside.
        center: float64 [m, 2] detected centre on the table, metres.
        position: float64 [m, 2] true centre, metres; equals `center` if the truth is unknown.
    """

    masks: NDArray[np.bool_]
    sdf: NDArray[np.float32]
    center: NDArray[np.float64]
    position: NDArray[np.float64]


@dataclass(frozen=True)
class SceneField:
    """How one field of a scene is computed, mirrored and stored.

    Attributes:
        of: Computes the field [m, ...] from detections.
        shape: Shape of one row, given the picture's size in pixels.
        dtype: Type of the tensor.
        mirror: Maps the field, of any batch shape, to that of the scene mirrored at x = 0.
        as_mask: Whether a replay buffer stores the field as the bits of `field < 0` and restores
            signed distances from them.
    """

    of: Callable[[Detections], NDArray]
    shape: Callable[[int], tuple[int, ...]]
    dtype: torch.dtype
    mirror: Callable[[Tensor], Tensor]
    as_mask: bool


def unchanged(values: Tensor) -> Tensor:
    """The mirror image of values without left and right."""
    return values


def flipped(pictures: Tensor) -> Tensor:
    """The mirror image of pictures [..., H, W]."""
    return pictures.flip(-1)


def reflected(points: Tensor) -> Tensor:
    """The mirror image of points [..., 2] on the table."""
    return points * torch.tensor([-1.0, 1.0], device=points.device)


def scene_field(
    of: Callable[[Detections], NDArray],
    shape: Callable[[int], tuple[int, ...]] = lambda size: (),
    dtype: torch.dtype = torch.float32,
    mirror: Callable[[Tensor], Tensor] = unchanged,
    as_mask: bool = False,
) -> Any:
    """Declare a field of a scene; see `SceneField`."""
    return dataclasses.field(metadata={"scene": SceneField(of, shape, dtype, mirror, as_mask)})


class Scene(TensorClass["nocast"]):  # type: ignore[misc, name-defined]
    """The contents of one picture by row; rows without a detected object are zero.

    Attributes:
        sdf: float32 [*B, N, H, W] signed distances, pixels, negative inside (paper section III B).
        node_mask: bool [*B, N] which rows hold a detected object.
        center: float32 [*B, N, 2] detected centre on the table, metres.
        position: float32 [*B, N, 2] true centre of the row's object, metres.
    """

    sdf: Tensor = scene_field(
        lambda seen: seen.sdf, lambda size: (size, size), mirror=flipped, as_mask=True
    )
    node_mask: Tensor = scene_field(
        lambda seen: np.ones(len(seen.masks), dtype=bool), dtype=torch.bool
    )
    center: Tensor = scene_field(lambda seen: seen.center, lambda size: (2,), mirror=reflected)
    position: Tensor = scene_field(lambda seen: seen.position, lambda size: (2,), mirror=reflected)

    @classmethod
    def declared(cls) -> dict[str, SceneField]:
        """Every field by name."""
        return {field.name: field.metadata["scene"] for field in dataclasses.fields(cls)}

    @classmethod
    def spec(cls, n: int, size: int) -> Composite:
        """The TorchRL spec of a scene with `n` rows and pictures of `size` pixels."""
        leaves: dict[str, Any] = {}
        for name, field in cls.declared().items():
            shape = (n, *field.shape(size))
            leaf = Binary(shape=shape, dtype=torch.bool) if field.dtype == torch.bool else None
            leaves[name] = leaf or Unbounded(shape, dtype=field.dtype)
        return Composite(leaves, data_cls=cls)

    @classmethod
    def of(cls, seen: Detections, rows: NDArray[np.bool_], n: int, size: int) -> Self:
        """Put detections into rows.

        Args:
            seen: The m detections.
            rows: bool [k], m of them true: the rows of the detections, in order; k <= n.
            n: Rows of the scene.
            size: Height and width of the picture, pixels.
        """
        values = {}
        places = np.flatnonzero(rows)
        for name, field in cls.declared().items():
            tensor = torch.zeros((n, *field.shape(size)), dtype=field.dtype)
            # NumPy casts to the field's type.
            target = tensor.numpy()
            target[places] = field.of(seen)
            values[name] = tensor
        return cls(**values, batch_size=[])

    @property
    def masks(self) -> Tensor:
        """Bool [*B, N, H, W] mask of each row."""
        return self.sdf < 0.0

    def mirrored(self) -> Self:
        """The scene mirrored at x = 0."""
        return self._changed(lambda name, field, values: field.mirror(values))

    def packed(self, pack: Callable[[Tensor, Tensor], Tensor]) -> Self:
        """The scene as a replay buffer stores it.

        Args:
            pack: Turns signed distances [*B, N, H, W] and the node mask [*B, N] into bits.
        """
        return self._changed(
            lambda name, field, values: pack(values, self.node_mask) if field.as_mask else values
        )

    def unpacked(self, unpack: Callable[[Tensor, Tensor], Tensor]) -> Self:
        """The inverse of `packed`; `unpack` turns bits back into signed distances."""
        return self._changed(
            lambda name, field, values: unpack(values, self.node_mask) if field.as_mask else values
        )

    def by_row(self) -> Self:
        """The same data with batch shape [*B, N], so that rows can be indexed."""
        return cast(
            Self, self._changed(lambda name, field, values: values).auto_batch_size_(self.ndim + 1)
        )

    def _changed(self, change: Callable[[str, SceneField, Tensor], Tensor]) -> Self:
        values = {
            name: change(name, field, self.get(name)) for name, field in self.declared().items()
        }
        return type(self)(**values, batch_size=self.batch_size)
