"""Trained Q-networks as files: weights (safetensors) and metadata (JSON).

A policy is a folder with `weights.safetensors` and `policy.json`, written by a run or released in
`sdfgcn/weights/`; `policy_file.py` says how they are checked. Nothing here needs Hydra.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf
from safetensors.torch import save

from sdfgcn.agents import policy_file
from sdfgcn.agents.epsilon_greedy import EpsilonGreedy, QAgent
from sdfgcn.agents.policy_file import ABOUT, KEYS, WEIGHTS, checksum, read_weights
from sdfgcn.config import Config, QNetworkConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.files import replaced, write_json
from sdfgcn.models import build_q_network, empty_q_network
from sdfgcn.models.q_network import QNetwork
from sdfgcn.registry import MODELS

RELEASED = Path(__file__).resolve().parents[1] / "weights"


def save_policy(folder: Path, network: QNetwork, about: Mapping[str, Any]) -> None:
    """Write a policy; `about` says how it was trained, in JSON types.

    `policy.json` is written last, so a folder that has it is complete.

    Raises:
        ValueError: `about` has a key that is not in `policy_file.KEYS`, so it could not be loaded.
    """
    if unknown := about.keys() - set(KEYS):
        raise ValueError(f"A policy has no {sorted(unknown)}.")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ABOUT).unlink(missing_ok=True)
    weights = {name: value.contiguous() for name, value in network.state_dict().items()}
    content = save(weights)
    with replaced(folder / WEIGHTS) as part:
        part.write_bytes(content)  # save_file would make it unreadable for other users
    kind = {
        "sha256": checksum(content),
        "model": asdict(network.config),
        "directions": network.n_directions,
        "max_objects": network.max_objects,
        "image_size": network.image_size,
    }
    write_json(folder / ABOUT, {**kind, **about})


def find_policy(checkpoint: str | Path) -> Path:
    """The folder of a policy.

    Args:
        checkpoint: The name of a released policy, a policy's folder, or a run folder with one.

    Raises:
        SdfgcnError: There is no such policy.
    """
    for folder in (RELEASED / checkpoint, Path(checkpoint), Path(checkpoint) / "policy"):
        if (folder / ABOUT).is_file():
            return folder
    released = sorted(path.parent.name for path in RELEASED.glob(f"*/{ABOUT}"))
    raise SdfgcnError(
        f"checkpoint is '{checkpoint}', but there is no policy ({ABOUT}) in that folder or in its "
        f"folder policy, and the released ones are: {', '.join(released) or 'none'}."
    )


def read_about(folder: Path) -> dict[str, Any]:
    """The content of `policy.json` in a policy's folder.

    Raises:
        SdfgcnError: It is damaged, has an unknown key, or a number that makes no sense.
    """
    with _faults_named(folder):
        return policy_file.read_about(folder)


def load_network(checkpoint: str | Path) -> tuple[QNetwork, dict[str, Any]]:
    """Load a trained network; `checkpoint` is as for `find_policy`.

    Returns:
        The network, on the CPU, and the content of `policy.json`; both are shared by all callers.

    Raises:
        SdfgcnError: There is no such policy, or its files are damaged: the weights have another
            checksum than `policy.json` says, are of another network, or are not finite.
    """
    folder = find_policy(checkpoint).resolve()
    files = (folder / ABOUT, folder / WEIGHTS)
    return _load(folder, tuple(file.stat().st_mtime_ns if file.is_file() else 0 for file in files))


def load_policy(
    checkpoint: str | Path,
    epsilon: float = 0.0,
    loop_distance: float | None = 0.02,
    seed: int = 0,
) -> EpsilonGreedy:
    """Load a trained policy that can be called with observations; needs no Hydra.

    Args:
        checkpoint: The name of a released policy, a policy's folder, or a run folder with one.
        epsilon: Share of random pushes.
        loop_distance: States are the same if no object's centres are further apart than this,
            metres, and no push is repeated in the same state; None allows repeats.
        seed: Seed of the random pushes.

    Raises:
        SdfgcnError: There is no such policy, or its files are damaged.
    """
    network, _ = load_network(checkpoint)
    rng = np.random.default_rng(seed)
    return EpsilonGreedy(QAgent(network), rng, epsilon, loop_distance)


def trained_agent(config: Config) -> QAgent:
    """Build the agent of the trained Q-network in `config.checkpoint`.

    Raises:
        SdfgcnError: `config.checkpoint` names no weights of this model, or they were trained with
            a number of directions or a picture size other than those of `config.env`.
    """
    if config.checkpoint is None:
        raise SdfgcnError(
            f"model.name is '{config.model.name}', which needs trained weights: give checkpoint=..."
        )
    network, about = load_network(config.checkpoint)
    if config.model.name not in ("released", about["model"]["name"]):
        raise SdfgcnError(
            f"checkpoint={config.checkpoint} holds weights of model={about['model']['name']}, but "
            f"model.name is '{config.model.name}'."
        )
    for key, asked, trained in (
        ("env.push.directions", config.env.push.directions, network.n_directions),
        ("env.arena.image_size", config.env.arena.image_size, network.image_size),
    ):
        if asked != trained:
            raise SdfgcnError(
                f"{key} is {asked}, but checkpoint={config.checkpoint} was trained with {trained}; "
                "use that value, or train a network for yours."
            )
    most = trained_objects(about)
    if network.fixed_rows and most is not None and config.env.n_objects > most:
        raise SdfgcnError(
            f"n_objects is {config.env.n_objects}, but checkpoint={config.checkpoint} was trained "
            f"with at most {most}, and model={about['model']['name']} has inputs of its own for "
            "each object; ask for fewer, or take a model with a graph."
        )
    return QAgent(network.for_task(config))


def trained_objects(about: Mapping[str, Any]) -> int | None:
    """The most objects in a training episode, from `policy.json`; None if it does not say."""
    training = about.get("training", {})
    counts = training.get("curriculum.counts") or [training.get("n_objects")]
    return max(counts) if None not in counts else None


@lru_cache(maxsize=4)
def _load(folder: Path, written: tuple[int, ...]) -> tuple[QNetwork, dict[str, Any]]:
    about = read_about(folder)
    with _faults_named(folder):
        schema = OmegaConf.structured(MODELS.config_type(about["model"]["name"]))
        model = OmegaConf.to_object(OmegaConf.merge(schema, about["model"]))
        assert isinstance(model, QNetworkConfig)
        sizes = (about["directions"], about["max_objects"], about["image_size"])
        weights = read_weights(folder, about, empty_q_network(model, *sizes).state_dict())
        network = build_q_network(model, *sizes, 0)
        network.load_state_dict(weights)
    return network.eval().requires_grad_(False), about


@contextmanager
def _faults_named(folder: Path) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # damaged files raise all kinds of errors
        ours = isinstance(error, policy_file.PolicyFileError | SdfgcnError)
        reason = str(error).rstrip(".") if ours else type(error).__name__
        raise SdfgcnError(
            f"The policy in {folder} is damaged ({reason}); train it again or copy it anew."
        ) from error
