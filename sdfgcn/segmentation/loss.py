"""The metric-learning loss of unseen object clustering (Xiang et al. 2020, equations 1 and 2).

With one change: there each cluster counts equally, here each pixel that is drawn. The table's
outermost pixels are many and an object's few, so that a mean over clusters would give a pixel just
outside an object a tenth of the weight of one just inside. Masks then grow by a pixel all around,
which is nothing at 640 pixels and a quarter of the overlap F-measure at 96.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize, one_hot


def clustering_loss(
    embeddings: Tensor, labels: Tensor, pull: float, push: float, min_pixels: int
) -> tuple[Tensor, Tensor]:
    """Draw each cluster's pixels to its centre and the centres of a picture apart.

    A cluster is an object or the table. The distance is the cosine distance (1 - cos) / 2, and a
    centre is the mean direction of its pixels.

    Args:
        embeddings: [B, D, H, W] of length 1.
        labels: [B, H, W] int64, 0 for the table, 1 to n for objects.
        pull: Distance of a pixel to its centre from which on it is drawn (alpha).
        push: Distance of two centres up to which they repel (delta).
        min_pixels: A smaller cluster is left out.

    Returns:
        The mean squared distance of the drawn pixels, and the mean over pairs of centres of their
        squared lack of distance; each a mean over pictures.
    """
    batch = len(embeddings)
    points = embeddings.flatten(2)  # [B, D, P]
    members = one_hot(labels.flatten(1)).to(points.dtype)  # [B, P, K]
    size = members.sum(dim=1)  # [B, K]
    there = (size >= min_pixels).to(points.dtype)
    centers = normalize(torch.einsum("bdp,bpk->bkd", points, members), dim=2)
    distances = 0.5 * (1.0 - torch.einsum("bkd,bdp->bpk", centers, points))
    # Only pixels beyond the margin count, in the sum and in the number that it is divided by.
    far = members * there[:, None, :] * (distances.detach() > pull)
    pulled = (far * distances.square()).sum(dim=(1, 2)) / far.sum(dim=(1, 2)).clamp(min=1.0)
    between = 0.5 * (1.0 - centers @ centers.transpose(1, 2))  # [B, K, K]
    pairs = (there[:, :, None] * there[:, None, :]).triu(diagonal=1)
    lack = (push - between).clamp(min=0.0).square()
    pushed = (pairs * lack).sum(dim=(1, 2)) / pairs.sum(dim=(1, 2)).clamp(min=1.0)
    return pulled.sum() / batch, pushed.sum() / batch
