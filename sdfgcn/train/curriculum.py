"""The number of objects in the next training episode (`curriculum=`; paper section VI C)."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import torch
from scipy.stats import binomtest
from tensordict import TensorDictBase
from torch import Tensor

from sdfgcn.config import CurriculumConfig


class ObjectCountSampler:
    """Draws the number of objects of an episode, in any process.

    `reached`, the number of open counts, is in memory shared by all processes, so the learner
    opens the next count for all workers at once.
    """

    def __init__(self, curriculum: CurriculumConfig, n_objects: int) -> None:
        """Open the counts with which training starts.

        Args:
            curriculum: The config.
            n_objects: The count used without a curriculum.
        """
        self.counts = tuple(curriculum.counts) or (n_objects,)
        grows = curriculum.name == "on"
        self._newest_share = curriculum.newest_share if grows else 0.0
        self.reached: Tensor = torch.tensor([1 if grows else len(self.counts)]).share_memory_()

    @property
    def newest(self) -> int:
        """The count opened last."""
        return self.counts[int(self.reached) - 1]

    def draw(self, rng: np.random.Generator) -> int:
        """The number of objects of the next episode."""
        *earlier, newest = self.counts[: int(self.reached)]
        if self._newest_share > 0.0:
            if not earlier or rng.random() < self._newest_share:
                return newest
            return int(rng.choice(earlier))
        return int(rng.choice([*earlier, newest]))


class Curriculum:
    """Opens the next count once the newest is mastered; runs in the learner's process."""

    def __init__(self, config: CurriculumConfig, counts: ObjectCountSampler) -> None:
        self._config = config
        self._counts = counts
        self._recent: deque[bool] = deque(maxlen=max(config.window, 1))

    @property
    def newest(self) -> int:
        """The newest number of objects of an episode."""
        return self._counts.newest

    def pushed(self, collected: TensorDictBase) -> None:
        """Record the episodes that end in [T] pushes from a collector."""
        outcome = collected["next"]
        for i in outcome["done"].squeeze(-1).nonzero().squeeze(-1).tolist():
            self.episode_ended(int(outcome["n_objects"][i]), bool(outcome["success"][i]))

    def episode_ended(self, n_objects: int, success: bool) -> None:
        """Record the end of an episode; only those at the newest count matter."""
        counts = self._counts
        if int(counts.reached) == len(counts.counts) or n_objects != counts.newest:
            return
        self._recent.append(success)
        if len(self._recent) == self._config.window and self._mastered():
            counts.reached += 1
            self._recent.clear()

    def _mastered(self) -> bool:
        """Whether the newest count's success rate is above the threshold, and not by chance.

        The last episodes are a moving sample: sooner or later, their mean exceeds a threshold that
        the true rate stays below. So it is Wilson's one-sided lower bound that has to exceed it.
        """
        config = self._config
        successes = binomtest(sum(self._recent), len(self._recent))
        bound = successes.proportion_ci(2.0 * config.confidence - 1.0, method="wilson").low
        return bool(bound > config.success_threshold)

    def state_dict(self) -> dict[str, Any]:
        """The state for a checkpoint."""
        return {"reached": int(self._counts.reached), "recent": list(map(int, self._recent))}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state from a checkpoint."""
        self._counts.reached.fill_(int(state["reached"]))
        self._recent.clear()
        self._recent.extend(bool(int(value)) for value in state["recent"])
