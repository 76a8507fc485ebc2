"""Layers of the Q-networks: blocks, propagation along edges, and the output head.

Propagation follows the paper's rule H' = act(D^-1/2 (A + I) D^-1/2 H W), where W is a convolution
or, for positions, a linear layer (section V B).

`shared` is that rule as written, and it cannot solve the task. Take a complete graph in which all
n objects have their goals. With the self loop, every node has degree n + 1, and a current node gets
(the sum of all current nodes + its goal's node) / (n + 1), so its own features are lost in the sum.
After two such layers it has a sum over all objects, which does not say which goal belongs to which
object, and its own features, returned through its goal's node. Swapping the goals of two objects
changes no Q-value.

`split` gives the self loop its own weights, as the authors' code does:
H' = act(D^-1/2 (A H W + I H W_own) D^-1/2). With W_own = W the two rules are the same.

`relational` is `split` with other weights of the edges. In `split`, a node gets a quarter of itself
and of its goal with 3 objects, a seventh with 6, so a network that was trained with 3 objects meets
features of other magnitudes with 6. Here these shares are a quarter with any number of objects, and
the mean of the others in the picture has a half; with 3 objects that all have their goals, the two
rules are the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Generator, Tensor, nn
from torch.nn.functional import conv2d, relu

from sdfgcn.errors import SdfgcnError
from sdfgcn.models.graph import Hop

# In a graph of three objects with goals, a node gets a quarter of each of its three neighbours and
# a quarter of itself. With these gains, each part is as large as one node's features.
NEIGHBOURS_GAIN, OWN_GAIN = 4.0 / 3.0, 4.0


class Rule(NamedTuple):
    """How features spread: see the module's docstring.

    Attributes:
        own_weights: Whether the self loop has its own weights.
        fixed_shares: Whether edges have the weights of `with_fixed_shares`, not `normalise`.
    """

    own_weights: bool
    fixed_shares: bool


PROPAGATIONS: dict[str, Rule] = {
    "split": Rule(own_weights=True, fixed_shares=False),
    "shared": Rule(own_weights=False, fixed_shares=False),
    "relational": Rule(own_weights=True, fixed_shares=True),
}


class Propagation(nn.Module):
    """One propagation layer, with equal numbers of input and output channels."""

    def __init__(self, layer: Callable[..., nn.Module], propagation: str):
        """Make the weights.

        `layer` builds a convolution or linear layer and takes `bias`; `propagation` is a key of
        `PROPAGATIONS`, explained in the module's docstring.
        """
        super().__init__()
        self.weights = layer(bias=True)
        self.own_weights = layer(bias=False) if PROPAGATIONS[propagation].own_weights else None

    def forward(self, rows: Tensor, hop: Hop) -> Tensor:
        """Propagate features [M, ...] of the nodes that `hop` reads once.

        Returns:
            [M_out, ...] the new features of the nodes that `hop` computes.
        """
        spread = self.weights(hop.mix(rows, own=self.own_weights is None))
        if self.own_weights is not None:
            share = hop.own_share.to(rows.dtype).reshape(-1, *(1,) * (rows.dim() - 1))
            spread += self.own_weights(hop.own(rows)).mul_(share)
        return relu(spread, inplace=True)


def conv_block(
    n_inputs: int, channels: Sequence[int], strides: Sequence[int], pooling: int
) -> nn.Sequential:
    """3x3 convolutions, each followed by a ReLU, then max pooling (paper Fig. 4)."""
    layers: list[nn.Module] = []
    for (before, after), stride in zip(pairwise([n_inputs, *channels]), strides, strict=True):
        layers += [nn.Conv2d(before, after, 3, stride, padding=1), nn.ReLU(inplace=True)]
    if pooling > 1:
        layers.append(nn.MaxPool2d(pooling))
    return nn.Sequential(*layers)


def labelled_block(block: nn.Module, pictures: Tensor, label: float) -> Tensor:
    """Apply a block to pictures [M, H, W] with a second channel that is `label` everywhere.

    A convolution is linear, so what it makes of the second channel is computed once and added. So
    the input, the largest of all tensors, is not written again with twice its size.

    Returns:
        [M, C, h, w] the block's output for input [M, 2, H, W].
    """
    conv, *others = block.children()
    assert isinstance(conv, nn.Conv2d)
    # Channels last if the weights are: otherwise each convolution copies its input twice.
    dim = -1 if in_channels_last(block) else 1
    pictures = pictures.unsqueeze(dim).movedim(dim, 1)
    weight, label_weight = conv.weight.split(1, dim=1)
    rows = conv2d(pictures, weight, conv.bias, conv.stride, conv.padding)
    if label:
        channel = pictures.new_full((1, 1, *pictures.shape[2:]), label)
        rows += conv2d(channel, label_weight, None, conv.stride, conv.padding)
    for layer in others:
        rows = layer(rows)
    return rows


def in_channels_last(block: nn.Module) -> bool:
    """Whether the weights of a block's first convolution are in channels-last format."""
    weight = next(block.children()).weight  # TorchRL's losses leave `parameters()` empty
    assert isinstance(weight, Tensor)
    return not weight.is_contiguous() and weight.is_contiguous(memory_format=torch.channels_last)


def linear_block(n_inputs: int, channels: Sequence[int]) -> nn.Sequential:
    """Linear layers, each followed by a ReLU."""
    layers: list[nn.Module] = []
    for before, after in pairwise([n_inputs, *channels]):
        layers += [nn.Linear(before, after), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


def q_head(n_inputs: int, hidden: int, n_outputs: int) -> nn.Sequential:
    """Flatten, then two linear layers (paper section V B)."""
    return nn.Sequential(
        nn.Flatten(),
        nn.Linear(n_inputs, hidden),
        nn.ReLU(inplace=True),
        nn.Linear(hidden, n_outputs),
    )


def check_widths(
    key: str, values: Sequence[Sequence[int]], blocks: Sequence[Sequence[object]]
) -> None:
    """Check that `values` has one number for every entry of every block in `blocks`.

    Raises:
        SdfgcnError: There are too few or too many numbers.
    """
    lengths = [len(block) for block in blocks]
    if not values or [len(block) for block in values] != lengths or min(lengths) < 1:
        raise SdfgcnError(
            f"{key} is {values}, but must have an entry for every block and layer of channels, "
            f"whose lengths are {lengths}."
        )


@torch.no_grad()
def initialise(network: nn.Module, generator: Generator) -> None:
    """Draw the weights of convolutions and linear layers (He et al. 2015); biases are zero."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d | nn.Linear):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu", generator=generator)
            if module.bias is not None:
                module.bias.zero_()
    # A split layer adds two outputs, which doubles the variance, and normalising the adjacency
    # makes its inputs smaller.
    for module in network.modules():
        if isinstance(module, Propagation) and module.own_weights is not None:
            module.weights.weight.mul_(math.sqrt(0.5) * NEIGHBOURS_GAIN)  # type: ignore[operator]
            module.own_weights.weight.mul_(math.sqrt(0.5) * OWN_GAIN)  # type: ignore[operator]
