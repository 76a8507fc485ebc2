"""Writing files so that a reader never sees half of one."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any


def write_text(path: Path, text: str) -> None:
    """Write a text file in one step: it appears whole or not at all.

    Args:
        path: The file; it is replaced if it exists.
        text: Its content.
    """
    part = path.with_name(f".{path.name}.part")
    with part.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file in one step.

    Raises:
        ValueError: A number is not finite; JSON has no such value.
    """
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")
