"""Texts of a recording: names, log, summary, and the table of Q-values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sdfgcn.envs.records import EpisodeStart, StepRecord
from sdfgcn.task.explanation import Explanation

_ARROWS = "→↗↑↖←↙↓↘"  # evenly around, counter-clockwise in the picture


def slot_name(episode: EpisodeStart, slot: int) -> str:
    """Name of the object in a slot."""
    name = "" if episode.truth is None else f" {episode.truth.objects[slot].name}"
    return f"#{slot}{name}"


def row_name(episode: EpisodeStart, row: int, slot: int) -> str:
    """Name of what a row shows; slot -1 means no object."""
    return slot_name(episode, slot) if slot >= 0 else f"row {row}"


def push_sentence(name: str, step: StepRecord) -> str:
    """The log line for a push of the object called `name`."""
    return f"{_status(step).capitalize()}: {_push(name, step)}, reward {step.reward:+.3f}."


def push_words(names: list[str], step: StepRecord, moved: NDArray, before: NDArray) -> str:
    """What the agent expected and did, and what came of it, as Markdown.

    Args:
        names: [m] of the rows before the push.
        step: The push.
        moved: [N, 2] displacement of each row's object, metres; NaN where unknown.
        before: [k] distances to the goals before the push, metres, as in `step.distances`.
    """
    row = step.push.row
    name = names[row] if row < len(names) else f"row {row}"
    lines = [f"### Push {step.index}: {_push(name, step)}: {_status(step)}"]
    if step.q_values is not None and row < len(names):
        values, legal = step.q_values[: len(names)], step.legal[: len(names)]
        value = float(values[row, step.push.direction])
        lines.append(f"**Chosen**: {value:.2f}, {_rank(value, values[legal])}.")
    if step.explanation is not None:
        lines.append(f"**Expected**: {_expected(names, step.explanation)}.")
    lengths = np.linalg.norm(moved, axis=1)
    actual = [f"{names[row]} {1000 * lengths[row]:.0f} mm" for row in _moved(lengths[: len(names)])]
    lines.append(f"**Moved**: {', '.join(actual) or 'nothing'}.")
    ways = [
        f"#{slot} {1000 * old:.0f} → {1000 * new:.0f}"
        for slot, (old, new) in enumerate(zip(before, step.distances, strict=False))
        if np.isfinite(old) and np.isfinite(new)
    ]
    lines.append(f"**To the goal (mm)**: {', '.join(ways) or 'unknown'}.")
    terms = [f"{name} {value:+.2f}" for name, value in step.reward_terms.items() if value]
    lines.append(f"**Reward** {step.reward:+.2f}: {', '.join(terms) or 'no term'}.")
    return "\n\n".join(lines)


def _expected(names: list[str], explanation: Explanation) -> str:
    lengths = np.linalg.norm(explanation.displacement[: len(names)], axis=1)
    moves = [
        f"{names[row]} {1000 * lengths[row]:.0f} ± {1000 * explanation.deviation[row]:.0f} mm"
        for row in _moved(lengths)
    ]
    return ", ".join(moves) or "nothing moves"


def _moved(lengths: NDArray) -> NDArray[np.intp]:
    """The rows that moved by a millimetre or more, furthest first."""
    order = np.argsort(-np.nan_to_num(lengths))
    return order[np.nan_to_num(lengths)[order] >= 0.001]


def score_table(names: list[str], step: StepRecord, count: int = 10) -> str:
    """The legal pushes of the highest value with the scores of an explanation, as Markdown."""
    assert step.q_values is not None and step.explanation is not None, "there is nothing to tell"
    values = step.q_values[: len(names)]
    rows, directions = np.nonzero(step.legal[: len(names)])
    best = np.argsort(-values[rows, directions], kind="stable")[:count]
    scores = step.explanation.scores
    lines = [
        f"| push | value | {' | '.join(scores)} |",
        f"| --- | ---: |{' ---: |' * len(scores)}",
    ]
    for row, k in zip(rows[best], directions[best], strict=True):
        push = f"{names[row]} {_head(360.0 * k / values.shape[1])}"
        if (row, k) == (step.push.row, step.push.direction):
            push = f"**{push}**"
        numbers = [values[row, k], *(of_all[row, k] for of_all in scores.values())]
        cells = [f"{number:.2f}" if np.isfinite(number) else "" for number in numbers]
        lines.append(f"| {push} | {' | '.join(cells)} |")
    return "\n".join(lines)


def push_heading(name: str, step: StepRecord) -> str:
    """A few words for a push of the object called `name`."""
    return _push(name, step).replace(" degrees", "°")


def outcome(last: StepRecord | None) -> str:
    """The outcome of an episode, given its last push."""
    if last is None:
        return "no push"
    if last.success:
        return "success"
    if last.out_of_range:
        return "out of range"
    if last.terminated:
        return "terminated"
    return "step limit" if last.truncated else "unfinished"


def summary(episode: EpisodeStart, last: StepRecord | None, total_reward: float) -> str:
    """A summary of the episode, as Markdown."""
    how = "as they truly lie" if episode.truth else "between the centres that were seen"
    lines = [
        f"# Seed {episode.seed}: {outcome(last)}",
        f"{last.index if last else 0} pushes, return {total_reward:.3f}. Errors: {how}.",
        "",
        "| object | category | error (mm) |",
        "| --- | --- | ---: |",
    ]
    for slot in range(episode.n_objects):
        category = episode.truth.objects[slot].category if episode.truth else ""
        distance = last.distances[slot] if last else np.nan
        error = f"{1000 * distance:.0f}" if np.isfinite(distance) else ""
        lines.append(f"| {slot_name(episode, slot)} | {category} | {error} |")
    return "\n".join(lines)


def q_table(names: list[str], step: StepRecord) -> str:
    """The Q-values behind a push, as a Markdown table of objects and directions.

    The push is in bold; illegal pushes are in brackets. `names`, like `step.q_values`, are by row
    of the scene before the push.
    """
    assert step.q_values is not None, "there is nothing to tell"
    values, legal = step.q_values[: len(names)], step.legal[: len(names)]
    n_directions = values.shape[1]
    pushed = (step.push.row, step.push.direction)
    heads = [_head(360.0 * k / n_directions) for k in range(n_directions)]
    if n_directions == len(_ARROWS):
        heads = list(_ARROWS)  # narrow, so that the last column is in sight
    lines = [
        f"{_push(names[pushed[0]], step)}: {_rank(float(values[pushed]), values[legal])}.",
        "",
        f"| object | {' | '.join(heads)} |",
        f"| --- |{' ---: |' * n_directions}",
    ]
    for row, name in enumerate(names):
        cells = [f"{value:.2f}" for value in values[row]]
        cells = [cell if legal[row, k] else f"({cell})" for k, cell in enumerate(cells)]
        if row == pushed[0]:
            cells[pushed[1]] = f"**{cells[pushed[1]]}**"
        lines.append(f"| {name[:18]} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", "Bold: the push. In brackets: not legal."])


def _head(degrees: float) -> str:
    nearest = round(degrees / 360.0 * len(_ARROWS)) % len(_ARROWS)
    return f"{_ARROWS[nearest]} {degrees:g}°"


def _status(step: StepRecord) -> str:
    return step.push.result.status.replace("_", " ")


def _push(name: str, step: StepRecord) -> str:
    return f"{name} towards {np.degrees(step.push.angle):g} degrees"


def _rank(value: float, legal: np.ndarray) -> str:
    better = int((legal > value).sum())
    if better == 0:
        return f"the highest value of {len(legal)} legal pushes"
    return f"number {better + 1} by value of {len(legal)} legal pushes"
