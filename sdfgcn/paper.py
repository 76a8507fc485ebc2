"""What the paper reports in simulation (tables I and II), to print beside our own rows."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperFigure:
    """One row of a table of the paper.

    Attributes:
        table: Which table it stands in.
        success_rate: Share of successful episodes, 0 to 1.
        steps: Mean pushes over the successful episodes; None where none succeeded.
        error_mm: Mean position error over the successful episodes, millimetres; None likewise.
    """

    table: str
    success_rate: float
    steps: float | None
    error_mm: float | None


# Table I, left half: 3 objects that were seen in training.
_TRAIN: dict[str, tuple[float, float, float]] = {
    "rule_based": (0.68, 57.7, 30.7),
}

# Table II: objects held out from training, by their number. Its row for 3 objects repeats the
# right half of table I.
_TEST: dict[str, dict[int, tuple[float, float, float]]] = {
    "rule_based": {
        2: (0.78, 35.2, 31.2),
        3: (0.69, 59.1, 28.8),
        4: (0.37, 69.3, 31.0),
        5: (0.25, 89.8, 25.8),
        6: (0.20, 111.2, 31.0),
    },
}


def paper_figure(model: str, split: str, n_objects: int) -> PaperFigure | None:
    """Look up what the paper reports for random rearrangements in simulation.

    Args:
        model: An option of `conf/model/`.
        split: "train" or "test" objects.
        n_objects: Objects on the table.

    Returns:
        The figure, or None where the paper has none.
    """
    if split == "test" and n_objects in _TEST.get(model, {}):
        return PaperFigure("table II", *_TEST[model][n_objects])
    if split == "train" and n_objects == 3 and model in _TRAIN:
        return PaperFigure("table I", *_TRAIN[model])
    return None
