"""What `faults.py` found, as JSON and as a table."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sdfgcn.files import write_json, write_text
from sdfgcn.provenance import provenance

STRIKES = 3  # most strikes of a run


@dataclass(frozen=True)
class Strike:
    """One strike of a run, and what was wrong with the end that it made."""

    case: str
    fault: str
    after_s: float
    wrong: list[str]


@dataclass(frozen=True)
class Trial:
    """A run that was struck, resumed and left to end; how it differs from an undisturbed one."""

    case: str
    strikes: list[Strike]
    wrong: list[str]


def summary(
    trials: Sequence[Trial], others: Sequence[Strike], exact: Mapping[str, bool]
) -> list[dict[str, Any]]:
    """A row for each command and fault: how often, and what went wrong each time that it did.

    Args:
        trials: Runs that were resumed.
        others: Runs that were not.
        exact: By the name of each case, in order: whether it must resume bit for bit.
    """
    found: dict[tuple[str, str], list[list[str]]] = {}
    for strike in [*(strike for trial in trials for strike in trial.strikes), *others]:
        found.setdefault((strike.case, strike.fault), []).append(strike.wrong)
    for trial in trials:
        if trial.strikes:
            what = "same as undisturbed" if exact[trial.case] else "in full"
            found.setdefault((trial.case, f"then resumed: {what}"), []).append(trial.wrong)
    order = list(exact)
    rows = sorted(found.items(), key=lambda item: (order.index(item[0][0]), item[0][1]))
    return [
        {"what": what, "fault": fault, "n": len(each), "wrong": [wrong for wrong in each if wrong]}
        for (what, fault), each in rows
    ]


def outcome(
    trials: Sequence[Trial],
    others: Sequence[Strike],
    exact: Mapping[str, bool],
    own: Mapping[str, int],
) -> dict[str, Any]:
    """What is written: counts, the summary, and all that went wrong."""
    strikes = [*(strike for trial in trials for strike in trial.strikes), *others]
    return {
        **provenance(),
        "minutes": own["minutes"],
        "seeds": [own["seed"]],
        "strikes": len(strikes),
        "resumed": sum(bool(trial.strikes) for trial in trials),
        "rows": summary(trials, others, exact),
        "wrong": [asdict(each) for each in (*trials, *strikes) if each.wrong],
    }


def united(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The outcomes of several experiments as one.

    Raises:
        SystemExit: They are of different commits.
    """
    if len({json.dumps(result["git"]) for result in results}) > 1:
        raise SystemExit("The folders are of different commits; give those of one.")
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for row in (row for result in results for row in result["rows"]):
        one = rows.setdefault((row["what"], row["fault"]), {**row, "n": 0, "wrong": []})
        one["n"] += row["n"]
        one["wrong"] += row["wrong"]
    lists = {
        key: [each for result in results for each in result[key]] for key in ("seeds", "wrong")
    }
    counts = {
        key: sum(result[key] for result in results) for key in ("minutes", "strikes", "resumed")
    }
    order = list(dict.fromkeys(what for what, _ in rows))
    ordered = sorted(rows.values(), key=lambda row: (order.index(row["what"]), row["fault"]))
    return {**results[0], **lists, **counts, "rows": ordered}


def write(folder: Path, result: dict[str, Any]) -> None:
    """Write `faults.json` and `faults.md`."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "faults.json", result)
    write_text(folder / "faults.md", markdown(result))


def markdown(result: dict[str, Any]) -> str:
    """The summary as a table."""
    lines = ["| what | fault | n | held | what broke |", "| --- | --- | --- | --- | --- |"]
    for row in result["rows"]:
        wrong = [text for texts in row["wrong"] for text in texts]
        broke = "; ".join(f"{text} ({wrong.count(text)})" for text in sorted(set(wrong))) or "-"
        held = row["n"] - len(row["wrong"])
        lines.append(f"| {row['what']} | {row['fault']} | {row['n']} | {held} | {broke} |")
    commit = (result["git"] or {}).get("commit", "unknown")[:10]
    seeds = ", ".join(map(str, result["seeds"]))
    return "\n".join(
        [
            *lines,
            f"\n{result['strikes']} strikes; {result['resumed']} runs resumed to their end, struck "
            f"up to {STRIKES} times each. Seeds {seeds}, commit {commit}.\n",
        ]
    )
