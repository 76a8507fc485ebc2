"""An equivariant Q-network: scene and goal as seen on the table from each object.

Beyond the paper. SDFGCN sees whole pictures and has to learn that a push means the same wherever it
happens and wherever it heads. Here, turns by the angle between two directions and mirror images of
the table change nothing but which push a value belongs to; only the border of the allowed region
stays where it is.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import torch
from torch import Tensor, nn

from sdfgcn.config import ArenaConfig, QNetworkConfig, at_least, positive
from sdfgcn.errors import SdfgcnError
from sdfgcn.models.polar import PolarConv, PolarMaps, in_all_directions, reflected
from sdfgcn.models.q_network import QNetwork, spread_to_rows
from sdfgcn.registry import MODELS
from sdfgcn.task.scene import Scene

_MAPS = 6  # own, own goal, others, goals of others, border, the goal's direction


@dataclass
class PolarQConfig(QNetworkConfig):
    """A Q-network over polar maps (`conf/model/polar_q.yaml`).

    Attributes:
        rings, angles, radius: Of the polar maps; see `PolarMaps`.
        cut: Signed distances are cut at this value, and it is their unit; metres.
        channels: Of each convolution.
        strides: Of each convolution, by rings and by angles alike.
        hidden: Units of the last hidden layer.
        goal_unit: The unit of the way to an object's goal, metres.
        plane_height: Height of the plane onto which pixels are projected, metres.
        arena: The camera and the allowed region.
    """

    rings: int = at_least(4)
    angles: int = at_least(8)
    radius: float = positive()
    cut: float = positive()
    channels: list[int] = at_least(1)
    strides: list[int] = at_least(1)
    hidden: int = at_least(1)
    goal_unit: float = positive()
    plane_height: float = at_least(0)
    arena: ArenaConfig = field(default_factory=ArenaConfig)

    def check_network(self, image_size: int) -> None:
        """See `QNetworkConfig`."""
        super().check_network(image_size)
        if len(self.strides) != len(self.channels):
            raise SdfgcnError(
                f"model.strides is {self.strides}, but model.channels has {len(self.channels)} "
                "entries; give one stride for each convolution."
            )


@MODELS.register("polar_q", config=PolarQConfig)
class PolarQ(QNetwork):
    """Convolutions, circular along the angle, over the polar maps of each object."""

    def __init__(self, config: PolarQConfig, n_directions: int, max_objects: int, image_size: int):
        """Make the layers; see `QNetwork` for the arguments.

        Raises:
            SdfgcnError: The directions do not coincide with angles of the last maps.
        """
        super().__init__(config, n_directions, max_objects, image_size)
        rings, angles = config.rings, config.angles
        for stride in config.strides:
            rings, angles = (rings - 1) // stride + 1, (angles - 1) // stride + 1
        if angles % n_directions or angles % 2:
            raise SdfgcnError(
                f"env.push.directions is {n_directions}, but must divide {angles}, the even number "
                "of angles that model.strides leave of model.angles."
            )
        arena = replace(config.arena, image_size=image_size)
        self.maps = PolarMaps(
            arena, config.plane_height, config.rings, config.angles, config.radius
        )
        self._cut, self._goal_unit = config.cut, config.goal_unit
        channels = [_MAPS, *config.channels]
        self.blocks = nn.Sequential(
            *(
                PolarConv(*ends, (stride, stride))
                for ends, stride in zip(pairwise(channels), config.strides, strict=True)
            )
        )
        self.head = nn.Sequential(
            nn.Linear(3 * channels[-1] * rings, config.hidden),
            nn.ReLU(),
            nn.Linear(config.hidden, 1),
        )

    def action_values(self, scene: Scene, goal: Scene, matched: Tensor) -> Tensor:
        """See `QNetwork`."""
        return self._values(scene, goal, matched, scene.node_mask)

    def row_values(self, scene: Scene, goal: Scene, matched: Tensor, rows: Tensor) -> Tensor:
        """See `QNetwork`; the values of all other rows are 0."""
        numbers = torch.arange(matched.shape[-1], device=rows.device)
        return self._values(scene, goal, matched, scene.node_mask & (numbers == rows.unsqueeze(-1)))

    def _values(self, scene: Scene, goal: Scene, matched: Tensor, asked: Tensor) -> Tensor:
        """The values [B, N, D], of the rows `asked` [B, N] alone."""
        around = self.surroundings(scene, goal, matched & scene.node_mask & goal.node_mask, asked)
        return spread_to_rows(self.values_around(around), asked)

    def surroundings(self, scene: Scene, goal: Scene, matched: Tensor, asked: Tensor) -> Tensor:
        """What the network sees, from each asked object.

        Args:
            scene: Current scenes [B].
            goal: Goal scenes [B].
            matched: bool [B, N] the rows in which both show an object, and the same.
            asked: bool [B, N] the M objects from which to look.

        Returns:
            [M, 6, R, A]: distances to the object, its goal, all others, all others' goals, and the
            border of the allowed region, cut and in units of `cut`; and the way to the goal along
            each angle, in units of `goal_unit`. What does not exist is as far as possible; the way
            to a goal that is not known is 0.
        """
        with torch.autocast(asked.device.type, enabled=False):  # metres need all their digits
            return self._surroundings(scene, goal, matched, asked)

    def _surroundings(self, scene: Scene, goal: Scene, matched: Tensor, asked: Tensor) -> Tensor:
        batch, row = asked.nonzero(as_tuple=True)
        points = self.maps.points(scene.center[batch, row])[:, None]
        mine = torch.arange(asked.shape[1], device=row.device) == row[:, None]
        seen = []
        for pictures, present in ((scene, scene.node_mask), (goal, goal.node_mask)):
            fields = self.maps.distances(pictures.sdf[batch], points).squeeze(1)  # [M, N, R, A]
            known = present[batch] & (matched[batch] | ~mine if pictures is goal else True)
            fields = fields.masked_fill(~known[..., None, None], torch.inf)
            seen += [
                fields.masked_fill(~rows[..., None, None], torch.inf).amin(dim=1)
                for rows in (mine, ~mine)
            ]
        own, others, own_goal, other_goals = seen
        border = self.maps.inside_by(points.squeeze(1))
        distances = torch.stack([own, own_goal, others, other_goals, border], dim=1)
        way = (goal.center - scene.center)[batch, row] * matched[batch, row, None]
        headings = self.maps.around[-1] / self.config.radius  # type: ignore[index, attr-defined]
        along = (way @ headings.T / self._goal_unit)[:, None, None].expand(
            -1, 1, *distances.shape[2:]
        )
        return torch.cat([(distances / self._cut).clamp(-1.0, 1.0), along], dim=1)

    def values_around(self, around: Tensor) -> Tensor:
        """The values [M, D] of pushes in the middle of [M, 6, R, A], the same in a mirror."""
        plain, mirror = self._one_sided(torch.cat([around, reflected(around)])).chunk(2)
        # Seen in a mirror, the push in direction k heads in direction -k.
        return 0.5 * (plain + mirror.flip(1).roll(1, dims=1))

    def _one_sided(self, around: Tensor) -> Tensor:
        features = in_all_directions(self.blocks(around), self.n_directions)
        return self.head(features).squeeze(-1)
