"""Texts of a recording: names, log, summary, and the table of Q-values."""

from __future__ import annotations

import numpy as np

from sdfgcn.envs.records import EpisodeStart, StepRecord

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
    status = step.push.result.status.replace("_", " ")
    return f"{_push(name, step)}: {status}, reward {step.reward:+.3f}."


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
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join([*lines, "", "Bold: the push. In brackets: not legal."])


def _head(degrees: float) -> str:
    nearest = round(degrees / 360.0 * len(_ARROWS)) % len(_ARROWS)
    return f"{_ARROWS[nearest]} {degrees:g}°"


def _push(name: str, step: StepRecord) -> str:
    return f"{name} towards {np.degrees(step.push.angle):g} degrees"


def _rank(value: float, legal: np.ndarray) -> str:
    better = int((legal > value).sum())
    if better == 0:
        return f"the highest Q-value of {len(legal)} legal pushes"
    return f"number {better + 1} by Q-value of {len(legal)} legal pushes"
