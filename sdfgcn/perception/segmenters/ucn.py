"""Unseen object clustering as a segmenter: the trained network and mean shift."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import safetensors.torch
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from sdfgcn.errors import SdfgcnError
from sdfgcn.files import replaced
from sdfgcn.perception.segmenters.clustering import cluster, masks_of
from sdfgcn.perception.segmenters.config import UCNConfig
from sdfgcn.perception.segmenters.network import UCN
from sdfgcn.perception.trained import not_finite
from sdfgcn.registry import SEGMENTERS

SHIPPED = Path(__file__).parents[1] / "weights" / "ucn.safetensors"


@SEGMENTERS.register("ucn", config=UCNConfig)
class UCNSegmenter:
    """RGB picture -> object masks; see `conf/segmentation/ucn.yaml` for its settings."""

    def __init__(self, config: UCNConfig, network: UCN | None = None) -> None:
        """Use `network` (during training), or load the weights if it is None.

        Raises:
            SdfgcnError: The file is missing, damaged, or for other network sizes.
        """
        self._config = config
        self._network = network or load_network(config)

    def __call__(self, pixels: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Segment an RGB picture [H, W, 3] into disjoint object masks [m, H, W], largest first.

        Raises:
            SdfgcnError: The network does not accept pictures of this size.
        """
        return masks_of(self.clusters(pixels), self._config)

    def clusters(self, pixels: NDArray[np.uint8]) -> NDArray[np.int64]:
        """[H, W] the cluster of each pixel, before they become masks; 0 is the background."""
        embeddings = self.embeddings(pixels)
        points = embeddings.reshape(-1, embeddings.shape[-1])
        return cluster(points, self._config).reshape(embeddings.shape[:2])

    def embeddings(self, pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
        """[H, W, D] the unit embedding of each pixel."""
        stride = self._network.stride
        if pixels.shape[0] % stride or pixels.shape[1] % stride:
            raise SdfgcnError(
                f"env.arena.image_size is {pixels.shape[0]}, but the segmentation network needs a "
                f"multiple of {stride}."
            )
        with torch.inference_mode():
            picture = torch.from_numpy(pixels).permute(2, 0, 1)[None] / 255.0
            return self._network(picture)[0].permute(1, 2, 0).contiguous().numpy()


def make_network(config: UCNConfig) -> UCN:
    """Create an untrained network of the configured size."""
    return UCN(config.channels, config.widths, config.embedding)


def load_network(config: UCNConfig) -> UCN:
    """Load the trained network from `config.weights`, a safetensors file, or the shipped one.

    Raises:
        SdfgcnError: The file is missing, damaged, or for other network sizes.
    """
    path = SHIPPED if config.weights is None else Path(config.weights).expanduser()
    network = make_network(config)
    try:
        with safe_open(path, framework="pt") as file:
            sizes = json.loads((file.metadata() or {}).get("sizes", "null"))
        tensors = safetensors.torch.load_file(path)
    except (OSError, SafetensorError, ValueError) as error:
        raise SdfgcnError(
            f"The segmentation weights {path} cannot be read ({str(error).splitlines()[0]}); set "
            "env.perception.segmentation.weights to a file that "
            "`python -m sdfgcn.segmentation.train` wrote, or to null for the shipped ones."
        ) from error
    if sizes != network_sizes(config):
        raise SdfgcnError(
            f"The segmentation weights {path} are of a network with {_told(sizes)}, but "
            f"env.perception.segmentation asks for {_told(network_sizes(config))}; use the same "
            "sizes or train weights for these."
        )
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        raise SdfgcnError(
            f"The segmentation weights {path} lack layers or have others than this network; train "
            "them anew with `python -m sdfgcn.segmentation.train`."
        ) from error
    if name := not_finite(tensors):
        raise SdfgcnError(
            f"The segmentation weights {path} are damaged ('{name}' is not finite); train them "
            "anew with `python -m sdfgcn.segmentation.train`."
        )
    return network.eval()


def save_network(network: UCN, config: UCNConfig, path: Path) -> None:
    """Write the weights atomically, with the network sizes as metadata."""
    tensors = {name: value.contiguous() for name, value in network.state_dict().items()}
    metadata = {"sizes": json.dumps(network_sizes(config))}
    with replaced(path) as part:
        # Not save_file, whose files are readable by the owner only.
        part.write_bytes(safetensors.torch.save(tensors, metadata=metadata))


def network_sizes(config: UCNConfig) -> dict[str, object]:
    """The settings that determine the shapes of the weights."""
    return {
        "channels": config.channels,
        "widths": list(config.widths),
        "embedding": config.embedding,
    }


def _told(sizes: dict[str, object] | None) -> str:
    return ", ".join(f"{key} {value}" for key, value in (sizes or {}).items()) or "unknown sizes"
