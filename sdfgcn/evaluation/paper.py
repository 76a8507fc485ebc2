"""The paper's simulation results (tables I and II), to print beside our own."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperFigure:
    """One row of a table of the paper.

    Attributes:
        method: The model, or the paper's name for how it was trained.
        table: The table it is from.
        success_rate: Share of successful episodes, 0 to 1.
        pushes: Mean over successful episodes; None if there are none.
        error_mm: Mean position error over successful episodes, millimetres; None if there are none.
    """

    method: str
    table: str
    success_rate: float
    pushes: float | None
    error_mm: float | None


_Figures = tuple[float, float | None, float | None]

# Table I: 3 objects, from the training or the test split; trained with 3 objects.
_TABLE_I: dict[str, dict[str, _Figures]] = {
    "rule_based": {"train": (0.68, 57.7, 30.7), "test": (0.69, 59.1, 28.8)},
    "pose_gcn": {"train": (0.40, 45.1, 30.1), "test": (0.33, 33.7, 33.7)},
    "gt_pose_gcn": {"train": (0.41, 42.0, 31.5), "test": (0.51, 44.5, 31.3)},
    "segmentation_gcn": {"train": (0.18, 44.3, 31.4), "test": (0.16, 41.6, 26.3)},
    "sdf_cnn": {"train": (0.75, 41.1, 30.0), "test": (0.70, 37.3, 30.3)},
    "separate": {"train": (0.67, 39.1, 25.9), "test": (0.65, 36.2, 26.2)},
    "sdfgcn": {"train": (0.80, 35.0, 29.5), "test": (0.80, 34.6, 31.3)},
}

MODELS = frozenset(_TABLE_I)  # what the paper has figures for, as options of `conf/model/`

# Table II: test objects, by their number. For 3 objects, the rows of the rule-based agent and of
# SDFGCN-fixed repeat table I.
_TABLE_II: dict[str, dict[int, _Figures]] = {
    "rule_based": {
        2: (0.78, 35.2, 31.2),
        3: (0.69, 59.1, 28.8),
        4: (0.37, 69.3, 31.0),
        5: (0.25, 89.8, 25.8),
        6: (0.20, 111.2, 31.0),
    },
    "SDFGCN-fixed": {
        2: (0.88, 20.3, 33.0),
        3: (0.80, 34.6, 31.3),
        4: (0.61, 47.5, 29.6),
        5: (0.12, 58.2, 30.0),
        6: (0.0, None, None),
    },
    "SDFGCN-random": {
        2: (0.87, 21.0, 32.0),
        3: (0.76, 34.3, 30.1),
        4: (0.68, 48.5, 29.2),
        5: (0.60, 85.9, 27.2),
        6: (0.35, 99.5, 26.9),
    },
    "SDFGCN-curriculum": {
        2: (0.84, 24.0, 30.8),
        3: (0.83, 34.7, 28.6),
        4: (0.64, 48.9, 28.9),
        5: (0.61, 77.3, 26.9),
        6: (0.44, 100.9, 28.7),
    },
}

_SDFGCN = {"off": "SDFGCN-fixed", "random": "SDFGCN-random", "on": "SDFGCN-curriculum"}


def paper_figure(
    model: str,
    split: str,
    n_objects: int,
    curriculum: str | None = None,
    trained_objects: int | None = None,
) -> PaperFigure | None:
    """Look up what the paper reports for random rearrangements in simulation.

    Args:
        model: An option of `conf/model/`.
        split: "train" or "test" objects.
        n_objects: Objects on the table.
        curriculum: The option of `conf/curriculum/` that the model was trained with; None if it is
            not trained, or this is unknown.
        trained_objects: Objects in a training episode; used only if `curriculum` is "off".

    Returns:
        The figure, or None if the paper has none for a model trained in this way.
    """
    if model not in _TABLE_I:
        return None
    method = model
    if model != "rule_based":
        if curriculum is None or (curriculum == "off" and trained_objects != 3):
            return None
        if model == "sdfgcn":
            method = _SDFGCN[curriculum]
        elif curriculum != "off":
            return None
    if split == "test" and n_objects in _TABLE_II.get(method, {}):
        return PaperFigure(method, "table II", *_TABLE_II[method][n_objects])
    if n_objects == 3 and method in (model, "SDFGCN-fixed"):
        return PaperFigure(method, "table I", *_TABLE_I[model][split])
    return None
