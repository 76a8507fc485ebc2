"""Put a trained network of an experiment into the package, with its model card.

    python experiments/release.py sdfgcn multirun/trainings/sdfgcn_contest/seed_0 --table table1

Copies the policy to `outputs/experiments/weights/<name>/` and writes its card from `policy.json`,
`train.csv` and the rows of the method in `experiments/results/<table>.json`. With `--publish` both
go to `sdfgcn/weights/<name>/`, so that `checkpoint=<name>` runs it.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from common import PUBLISH, RESULTS, SCRATCH

from sdfgcn.agents.policy import RELEASED, find_policy, load_network
from sdfgcn.agents.policy_file import ABOUT, WEIGHTS, checksum
from sdfgcn.comparison.table import CONDITIONS
from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.report import commit_of, decimal, markdown_table, percent
from sdfgcn.files import write_json, write_text
from sdfgcn.train.progress import read_curve

POINTS = 12  # rows of the learning curve in the card
# What a model does not know, for its card.
_LIMITS = {
    "push_model": "**What it does not know:** the height and the weight of objects, so whether one "
    "tips over or rolls on; which side of an object the mask hides; whether the tool, coming down, "
    "will touch a taller neighbour. It learned the gripper's pushes of 60 mm and the camera of "
    "`env.arena`; with others it has to be trained again."
}


def card(name: str, about: dict[str, Any], curve: Sequence[dict], rows: Sequence[dict]) -> str:
    """The model card in Markdown.

    Args:
        name: The name to load the weights by.
        about: The content of `policy.json`.
        curve: The rows of `train.csv`.
        rows: The rows of the method in the experiment's table.
    """
    training, spent = about["training"], about["spent"]
    counts = training.get("curriculum.counts") or [training["n_objects"]]
    parts = [
        f"# Model card: {name}",
        f"`python run.py checkpoint={name}` evaluates it; `sdfgcn.load_policy({name!r})` loads it.",
        "\n".join(
            [
                f"- **Model:** {about['model']['name']}, {about['directions']} directions.",
                f"- **Training:** seed {about['seed']}, commit {commit_of(about['git'])}; "
                f"{spent['pushes']} pushes, {spent['updates']} updates of "
                f"{training['train.batch_size']} transitions, {spent['hours']:.2f} hours.",
                f"- **World:** env={training['train.env.name']}, objects="
                f"{training['train.env.objects.name']} (split {training['train.env.split']}), "
                f"{', '.join(map(str, counts))} objects "
                f"(curriculum={training['curriculum.name']}), "
                f"perception={training['train.env.perception.name']}, "
                f"robot={training['train.env.robot.name']}.",
            ]
        ),
        _curve(curve),
        "Success and out of range in training: the last 100 episodes, random pushes included.",
        *([_LIMITS[kind]] if (kind := about["model"]["name"]) in _LIMITS else []),
        "**On held-out objects** (loop distance and threshold in metres):",
        _results(rows),
        "In brackets: 95% intervals from a bootstrap over training seeds, then scenes (Wilson's at "
        "0% and 100%). Licence: MIT, as the project.",
    ]
    return "\n\n".join(parts) + "\n"


def _curve(rows: Sequence[dict]) -> str:
    step = max(1, len(rows) // POINTS)
    heads = ("pushes", "updates", "epsilon", "objects", "success", "out of range", "loss")
    return markdown_table(
        heads,
        [
            [
                *(row["pushes"], row["updates"], f"{float(row['epsilon']):.2f}", row["n_objects"]),
                *(_share(row[key]) for key in ("success_rate", "out_of_range_rate")),
                row["loss"],
            ]
            for row in rows[step - 1 :: step]
        ],
    )


def _share(text: str) -> str:
    return percent(float(text)) if text else "-"


def _results(rows: Sequence[dict]) -> str:
    heads = [key.replace("_", " ") for key in CONDITIONS]
    heads += ["seeds", "episodes", "success", "pushes", "error (mm)", "out of range"]
    return markdown_table(
        heads,
        [
            [
                *("-" if row[key] is None else str(row[key]) for key in CONDITIONS),
                *(str(len(row["seeds"])), str(row["episodes"])),
                percent(row["success_rate"], row["success_rate_ci95"]),
                decimal(row["pushes"], row["pushes_ci95"]),
                decimal(row["error_mm"], row["error_mm_ci95"]),
                percent(row["out_of_range_rate"]),
            ]
            for row in rows
        ],
    )


def _weights_folder(publish: bool) -> Path:
    return RELEASED if publish else SCRATCH / "weights"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Put a trained network into the package.")
    parser.add_argument("name", help="the name to load it by")
    parser.add_argument("training", type=Path, help="the folder of its training")
    parser.add_argument("--method", help="its method in the table; by default the name")
    parser.add_argument(
        "--table", nargs="+", required=True, help="tables in results/ with its rows"
    )
    parser.add_argument("--results", type=Path, default=RESULTS, help="where the tables are")
    parser.add_argument("--weights", type=Path, help="another folder for the weights")
    parser.add_argument(
        PUBLISH, action="store_true", help="write to sdfgcn/weights, which git tracks"
    )
    given = parser.parse_args(arguments)
    try:
        policy = find_policy(given.training)
        _, about = load_network(policy)
        if about["budget"] is None:
            raise SdfgcnError(f"{policy} is of an unfinished training; finish it first.")
        tables = [given.results / f"{table}.json" for table in given.table]
        every = [row for table in tables for row in json.loads(table.read_text(encoding="utf-8"))]
        method = given.method or given.name
        rows = [row for row in every if row["method"] == method]
        if not rows:
            raise SdfgcnError(f"{', '.join(map(str, tables))} have no rows of {method}.")
        text = card(given.name, about, read_curve(given.training / "train.csv"), rows)
        folder = (given.weights or _weights_folder(given.publish)) / given.name
        folder.mkdir(parents=True, exist_ok=True)
        weights = (policy / WEIGHTS).read_bytes()
        (folder / WEIGHTS).write_bytes(weights)
        write_json(folder / ABOUT, about | {"sha256": checksum(weights)})  # older ones have none
        write_text(folder / "README.md", text)
    except (SdfgcnError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    print(text, end="")
    print(f"Wrote {folder}.", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
