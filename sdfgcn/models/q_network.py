"""The base class of all Q-networks: construction, and the interface to TorchRL."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from sdfgcn.config import Config, QNetworkConfig
from sdfgcn.task.scene import Scene

ASKED = "asked"  # the key of the one action whose value is asked for


class QNetwork(TensorDictModuleBase):
    """Reads an observation of any batch shape and writes the value of every action.

    A subclass implements `action_values` and registers with `sdfgcn.registry.MODELS`. `*B` is the
    batch shape, N the number of rows, D the number of push directions.

    Where an observation also has `asked`, int64 [*B], only the value of that one action is asked
    for, and those of other objects may be missing (0) from `action_value`. An update of double DQN
    asks like this, and a network that overrides `row_values` then saves time.

    Attributes:
        in_keys: `scene`, `goal` and `matched`, as in `RearrangementEnv`.
        out_keys: `action_value`, float32 [*B, N * D], in the order of `PushSpace`'s actions.
        fixed_rows: Whether observations must have exactly `max_objects` rows.
        learner: How it is trained, a key of `sdfgcn.train.learners.LEARNERS`.
        config: The `model` part of the experiment's config.
        n_directions: The number D of directions.
        max_objects: The N that it was built for.
        image_size: Height and width of its pictures, pixels.
    """

    fixed_rows: ClassVar[bool] = False
    learner: ClassVar[str] = "double_dqn"

    def __init__(
        self, config: QNetworkConfig, n_directions: int, max_objects: int, image_size: int
    ):
        """Set the attributes of the same names."""
        super().__init__()
        self.in_keys = ["scene", "goal", "matched"]
        self.out_keys = ["action_value"]
        self.config = config
        self.n_directions = n_directions
        self.max_objects = max_objects
        self.image_size = image_size

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Set `action_value` and return the TensorDict."""
        scene, goal, matched = (tensordict[key] for key in self.in_keys)
        *batch, n = matched.shape
        flat = matched.reshape(-1, n)
        scenes = _flat(scene, len(flat)), _flat(goal, len(flat))
        asked = tensordict.get(ASKED, None)
        if asked is None:
            values = self.action_values(*scenes, flat)
        else:
            values = self.row_values(*scenes, flat, asked.reshape(-1) // self.n_directions)
        return tensordict.set("action_value", values.reshape(*batch, n * self.n_directions))

    def for_task(self, config: Config) -> QNetwork:
        """The network for evaluations of a config; one that plans has settings that may differ."""
        return self

    @abstractmethod
    def action_values(self, scene: Scene, goal: Scene, matched: Tensor) -> Tensor:
        """The value of every push of every object.

        Args:
            scene: Current scenes [B].
            goal: Goal scenes [B].
            matched: bool [B, N] the rows in which both show the same object.

        Returns:
            float32 [B, N, D], 0 for rows whose `node_mask` is false.
        """

    def row_values(self, scene: Scene, goal: Scene, matched: Tensor, rows: Tensor) -> Tensor:
        """The value of every push of one object per scene, where that is less work than of all.

        Args:
            scene: Current scenes [B].
            goal: Goal scenes [B].
            matched: bool [B, N] the rows in which both show the same object.
            rows: int64 [B] the asked row of each scene, which may be empty.

        Returns:
            float32 [B, N, D] as from `action_values` in the asked rows, anything finite elsewhere.
        """
        return self.action_values(scene, goal, matched)


def _flat(scenes: TensorDictBase, count: int) -> Scene:
    """View scenes of any batch shape as [count]; the memory is shared."""
    if not isinstance(scenes, Scene):  # some TorchRL operations return a plain TensorDict
        scenes = Scene.from_tensordict(scenes.select(*Scene.declared()))
    return scenes.reshape(count)


def spread_to_rows(values: Tensor, node_mask: Tensor) -> Tensor:
    """Put the values [M, D] of detected objects into their rows, those with `node_mask` [B, N].

    Returns:
        float32 [B, N, D], zero for the other rows.
    """
    spread = torch.zeros(*node_mask.shape, values.shape[-1], device=values.device)
    spread[node_mask] = values.float()
    return spread
