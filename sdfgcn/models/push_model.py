"""A model of pushes: from masks alone, where every object ends after every push.

Its action values are those of a planner that looks one or two pushes ahead: how many pushes fewer
are needed after a push, less the risk that it moves something out of range.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from sdfgcn.config import ArenaConfig, Config, QNetworkConfig, number, positive, several
from sdfgcn.errors import SdfgcnError
from sdfgcn.models.planner import PlannerConfig, pushes_needed, risk_of_leaving
from sdfgcn.models.polar import PolarConv, PolarMaps, in_all_directions, reflected
from sdfgcn.models.q_network import QNetwork
from sdfgcn.registry import MODELS
from sdfgcn.task.explanation import Explanation
from sdfgcn.task.scene import Scene


@dataclass
class PushModelConfig(QNetworkConfig):
    """The push model and its planner (`conf/model/push_model.yaml`).

    Attributes:
        rings, angles, radius: Of the polar maps; see `PolarMaps`.
        cut: Distances are cut at this value, and it is their unit; metres.
        trunk: Channels of the convolutions that look at the pushed object and its surroundings.
        pair: Channels of those that also look at one object that may move.
        hidden: Units of the last hidden layer.
        unit: The displacement that is one at the output, metres.
        deviation_min: Least standard deviation of a prediction, metres.
        planner: How a push is chosen.
        success_threshold: Distance within which an object is at its goal, metres.
        plane_height: Height of the plane onto which pixels are projected, metres.
        arena: The camera and the allowed region.
    """

    own_curriculum: ClassVar[str] = "many"

    rings: int = number(4, 256)
    angles: int = number(8, 1024)
    radius: float = number(0.001, 2)
    cut: float = number(0.001, 2)
    trunk: list[int] = several(1, 4096)
    pair: list[int] = several(1, 4096)
    hidden: int = number(1, 16_384)
    unit: float = number(0.0001, 1)
    deviation_min: float = number(1e-6, 1)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    success_threshold: float = positive(10)
    plane_height: float = number(0, 0.1)
    arena: ArenaConfig = field(default_factory=ArenaConfig)


class Moves(NamedTuple):
    """Predicted displacements of objects j by pushes of objects i in D directions.

    Attributes:
        mean: float32 [B, I, N, D, 2] metres on the table.
        deviation: float32 [B, I, N, D] standard deviation of each coordinate, metres.
        near: bool [B, I, N] whether j is near enough to i to be moved; the others stay.
    """

    mean: Tensor
    deviation: Tensor
    near: Tensor


@MODELS.register("push_model", config=PushModelConfig)
class PushModel(QNetwork):
    """Predicts displacements from polar maps, and values pushes by the scene that they lead to.

    An object's surroundings are encoded once; from that and the map of an object that may move come
    its displacements by pushes in all directions, in the frame of each push. Turns by the angle
    between two directions and mirror images are exact, as maps are averaged over both mirror images
    and convolutions are circular. Only the border of the allowed region stays where it is.
    """

    learner: ClassVar[str] = "displacement"
    config: PushModelConfig

    def __init__(
        self, config: PushModelConfig, n_directions: int, max_objects: int, image_size: int
    ):
        """Make the layers; see `QNetwork` for the arguments.

        Raises:
            SdfgcnError: The directions do not coincide with angles of the maps.
        """
        super().__init__(config, n_directions, max_objects, image_size)
        if (config.angles // 2) % n_directions:
            raise SdfgcnError(
                f"env.push.directions is {n_directions}, but must divide half of model.angles "
                f"({config.angles})."
            )
        arena = replace(config.arena, image_size=image_size)
        self.maps = PolarMaps(
            arena, config.plane_height, config.rings, config.angles, config.radius
        )
        first, second = config.trunk
        third, fourth = config.pair
        self.trunk = nn.Sequential(PolarConv(3, first), PolarConv(first, second, (2, 2)))
        self.asked = nn.Sequential(PolarConv(1, first // 2), PolarConv(first // 2, second, (2, 2)))
        self.pair = nn.Sequential(PolarConv(2 * second, third), PolarConv(third, fourth, (2, 1)))
        rings = (((config.rings - 1) // 2 + 1) - 1) // 2 + 1
        self.head = nn.Sequential(
            nn.Linear(3 * fourth * rings, config.hidden), nn.ReLU(), nn.Linear(config.hidden, 3)
        )
        turns = torch.arange(n_directions) * (2.0 * math.pi / n_directions)
        cos, sin = turns.cos(), turns.sin()
        frames = torch.stack([torch.stack([cos, -sin], -1), torch.stack([sin, cos], -1)], -2)
        self.register_buffer("frames", frames, persistent=False)  # [D, 2, 2] push to table

    # ------------------------------------------------------------------ prediction

    def moves(
        self,
        scene: Scene,
        rows: Tensor | None = None,
        mirrored: bool = True,
        shift: Tensor | None = None,
    ) -> Moves:
        """Predict what each push moves, and where to.

        Args:
            scene: Current scenes [B].
            rows: int64 [B, I] the objects that are pushed; None for all, so that I = N.
            mirrored: Whether to average over both mirror images. Without, it takes half the time,
                for training with scenes that are mirrored at random.
            shift: [B, N, 2] how far objects are from where the scenes show them, metres; None if
                they are there.
        """
        sdf, occupied = scene.sdf, scene.node_mask
        center = scene.center if shift is None else scene.center + shift
        batch, n = occupied.shape
        if rows is None:
            rows = torch.arange(n, device=occupied.device).expand(batch, n)
        pushed = rows[..., None].expand(-1, -1, 2)
        points = self.maps.points(center.gather(1, pushed))
        fields = self.maps.distances(sdf, points, shift)  # [B, I, N, R, A]
        fields = fields.masked_fill(~occupied[:, None, :, None, None], torch.inf)
        own = torch.zeros_like(fields[:, :, :, 0, 0], dtype=torch.bool).scatter_(
            2, rows[..., None], True
        )
        near = (fields.amin(dim=(-2, -1)) < 0.0) | own
        near &= occupied[:, None, :] & occupied.gather(1, rows)[..., None]
        others = fields.masked_fill(own[..., None, None], torch.inf).amin(dim=2)
        mine = fields.masked_fill(~own[..., None, None], torch.inf).amin(dim=2)
        around = self._cut(torch.stack([mine, others, self.maps.inside_by(points)], dim=2))
        some = near.any(dim=-1)
        mean, log_deviation = self._displacements(
            around[some], self._cut(fields[near]), _ranks(near, some), mirrored
        )
        deviation = self.config.deviation_min + self.config.unit * log_deviation.exp()
        directions = self.n_directions
        all_mean = mean.new_zeros(batch, rows.shape[1], n, directions, 2)
        all_deviation = mean.new_full(
            (batch, rows.shape[1], n, directions), self.config.deviation_min
        )
        all_mean[near] = torch.einsum("dab,pdb->pda", self.frames, mean * self.config.unit)
        all_deviation[near] = deviation
        return Moves(all_mean, all_deviation, near)

    def _cut(self, distances: Tensor) -> Tensor:
        return (distances / self.config.cut).clamp(-1.0, 1.0)

    def _displacements(
        self, around: Tensor, asked: Tensor, ranks: Tensor, mirrored: bool = True
    ) -> tuple[Tensor, Tensor]:
        """Displacements in the frame of each push, in units.

        Args:
            around: [Q, 3, R, A] the surroundings of the pushed objects: distances to the object, to
                all others, and to the border of the allowed region.
            asked: [P, R, A] the objects that may move, around the pushed ones.
            ranks: int64 [P] which of the Q objects is pushed.
            mirrored: See `moves`.

        Returns:
            mean [P, D, 2] and log deviation [P, D].
        """
        if not mirrored:
            outputs = self._one_sided(around, asked, ranks)
            return outputs[..., :2], outputs[..., 2]
        plain, mirror = self._one_sided(  # in one batch, which is faster than two
            torch.cat([around, reflected(around)]),
            torch.cat([asked, reflected(asked)]),
            torch.cat([ranks, ranks + len(around)]),
        ).chunk(2)
        # Seen in a mirror, the push in direction k heads in direction -k and its left is right.
        mirror = mirror.flip(1).roll(1, dims=1) * mirror.new_tensor([1.0, -1.0, 1.0])
        both = 0.5 * (plain + mirror)
        return both[..., :2], both[..., 2]

    def _one_sided(self, around: Tensor, asked: Tensor, ranks: Tensor) -> Tensor:
        """[P, D, 3] displacement and log deviation, without averaging over mirror images."""
        features = torch.cat([self.trunk(around)[ranks], self.asked(asked[:, None])], dim=1)
        return self.head(in_all_directions(self.pair(features), self.n_directions))

    # ------------------------------------------------------------------ planning

    def for_task(self, config: Config) -> PushModel:
        """See `QNetwork`: the same weights, with the planner and the threshold of the config."""
        model = config.model
        planner = model.planner if isinstance(model, PushModelConfig) else self.config.planner
        other = copy.copy(self)
        other.config = replace(
            self.config, planner=planner, success_threshold=config.env.success_threshold
        )
        return other

    def action_values(self, scene: Scene, goal: Scene, matched: Tensor) -> Tensor:
        """See `QNetwork`: the pushes saved by each push, as its planner expects."""
        moves = self.moves(scene)
        saved = self._saved(scene.center, goal.center, matched, moves)
        if self.config.planner.depth == 2:
            saved = saved + self._saved_next(scene, goal, matched, moves, saved)
        return saved * scene.node_mask[..., None]

    @torch.no_grad()
    def explain(self, td: TensorDictBase) -> Explanation:
        """What it expects of the push `td["action"]` in the observation of one env.

        The scores of every push: "pushes saved" by it, "out of range", the number of objects that
        are expected there afterwards, and with a depth of 2 "saved by the next" for the pushes
        after which it looked further.
        """
        scene, goal, matched = (td[key][None] for key in self.in_keys)
        moves = self.moves(scene)
        value = self._saved(scene.center, goal.center, matched, moves)
        risk = self._risk(scene.center, moves).sum(dim=2)
        scores = {"pushes saved": value + self.config.planner.risk * risk, "out of range": risk}
        if self.config.planner.depth == 2:
            weighed = torch.zeros_like(value, dtype=torch.bool).flatten(1)
            weighed = weighed.scatter_(1, self._best(scene, value), True).unflatten(
                1, value.shape[1:]
            )
            later = self._saved_next(scene, goal, matched, moves, value)
            scores["saved by the next"] = later.masked_fill(~weighed, torch.nan)
        row, direction = divmod(int(td["action"]), self.n_directions)
        return Explanation(
            displacement=moves.mean[0, row, :, direction].numpy(),
            deviation=moves.deviation[0, row, :, direction].numpy(),
            scores={name: values[0].numpy() for name, values in scores.items()},
        )

    def _risk(self, center: Tensor, moves: Moves) -> Tensor:
        """[B, N, N, D] probability that each push leaves each object out of range."""
        ends = self.maps.inside_by(center[:, None, :, None] + moves.mean)
        return risk_of_leaving(ends, moves.deviation) * moves.near[..., None]

    def _best(self, scene: Scene, saved: Tensor) -> Tensor:
        """[B, K] the pushes after which a second one is looked for: the most valuable."""
        first = saved.masked_fill(~scene.node_mask[..., None], -torch.inf).flatten(1)
        return first.topk(min(self.config.planner.width, first.shape[1])).indices

    def _saved(self, center: Tensor, target: Tensor, matched: Tensor, moves: Moves) -> Tensor:
        """The pushes saved by each push [B, N, D] of objects at [B, N, 2] with goals [B, N, 2]."""
        planner, threshold = self.config.planner, self.config.success_threshold
        here = center - target
        then = here[:, None, :, None] + moves.mean  # [B, N, N, D, 2]
        before = pushes_needed(planner, threshold, here.norm(dim=-1), here.new_zeros(()))
        after = pushes_needed(planner, threshold, then.norm(dim=-1), moves.deviation)
        saved = (before[:, None, :, None] - after) * (matched[:, None] & moves.near)[..., None]
        return (saved - planner.risk * self._risk(center, moves)).sum(dim=2)

    def _saved_next(
        self, scene: Scene, goal: Scene, matched: Tensor, moves: Moves, saved: Tensor
    ) -> Tensor:
        """The pushes saved by the best second push after each of the best ones; 0 after others."""
        n, count = saved.shape[1], len(saved)
        best = self._best(scene, saved)
        width = best.shape[1]
        rows, directions = best // self.n_directions, best % self.n_directions
        each = torch.arange(count, device=best.device)[:, None]
        shift = moves.mean[each, rows, :, directions].flatten(0, 1)  # [B K, N, 2]
        after = scene.repeat_interleave(width, dim=0)
        later = self._saved(
            after.center + shift,
            goal.center.repeat_interleave(width, dim=0),
            matched.repeat_interleave(width, dim=0),
            self.moves(after, shift=shift),
        )
        later = later.masked_fill(~after.node_mask[..., None], 0.0).flatten(1).amax(dim=1)
        gained = torch.zeros_like(saved).flatten(1)
        gained.scatter_(1, best, later.clamp_min(0.0).unflatten(0, (count, width)))
        return gained.unflatten(1, (n, self.n_directions))


def _ranks(near: Tensor, some: Tensor) -> Tensor:
    """For each true entry of `near` [B, I, N], the rank of its [B, I] among those with any."""
    numbers = (some.flatten().cumsum(0) - 1).unflatten(0, some.shape)
    return numbers[..., None].expand_as(near)[near]
