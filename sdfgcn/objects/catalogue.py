"""Loading a catalogue from the cache, which is built on first use."""

from __future__ import annotations

import hashlib
import json
import logging
from dataclasses import asdict
from pathlib import Path

from sdfgcn.config import SPLITS, ObjectsConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.model import ObjectModel, Recipe
from sdfgcn.objects.prepare import prepare
from sdfgcn.objects.storage import cache_dir, read_models, write_models
from sdfgcn.objects.visible import made_visible
from sdfgcn.progress_bar import progress_bar
from sdfgcn.registry import OBJECTS

FORMAT = 3  # increment whenever the same settings would yield different objects
# The palette does not affect the cached objects; the fingerprint covers the other two.
_NOT_IN_KEY = ("palette", "root", "split_file")

log = logging.getLogger(__name__)


def load_catalogue(cfg: ObjectsConfig, split: str) -> tuple[ObjectModel, ...]:
    """Return the objects of one split in a fixed order, building the cache if needed.

    Raises:
        SdfgcnError: The source or split is unknown, the limits contradict each other, the cache is
            damaged or not writable, `scanned` has no network, `shapenet` has a bad directory or no
            usable mesh, or the split is empty.
    """
    OBJECTS.find(cfg.name)
    if split not in SPLITS:
        raise SdfgcnError(f"The split is '{split}', but must be one of {', '.join(SPLITS)}.")
    cfg.check_limits()
    folder = catalogue_folder(cfg)
    if not folder.is_dir():
        write_models(folder, _build(cfg))
    models = read_models(folder, split)
    if not models:
        raise SdfgcnError(f"The catalogue {cfg.name} has no objects in its {split} split.")
    return models


def catalogue_folder(cfg: ObjectsConfig) -> Path:
    """Return the folder in which a catalogue with these settings is cached."""
    settings = {key: value for key, value in asdict(cfg).items() if key not in _NOT_IN_KEY}
    settings |= {"format": FORMAT, "fingerprint": OBJECTS.find(cfg.name).fingerprint(cfg)}
    key = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]
    return cache_dir() / "objects" / f"{cfg.name}-{key}"


def _build(cfg: ObjectsConfig) -> list[ObjectModel]:
    source = OBJECTS.find(cfg.name)
    recipes = source.recipes(cfg)
    bar = progress_bar(recipes, desc=f"Building the {cfg.name} catalogue", unit="object")
    models = []
    for recipe in bar:
        bar.set_postfix_str(recipe.name, refresh=False)
        if source.lenient:
            models += _if_usable(recipe, cfg)
        else:
            models.append(prepare(recipe, cfg))
    if not models:
        raise SdfgcnError(
            f"None of the {len(recipes)} objects of objects={cfg.name} can be used; the warnings "
            "before this say why."
        )
    return models


def _if_usable(recipe: Recipe, cfg: ObjectsConfig) -> list[ObjectModel]:
    """The object in a list, or an empty one and a line in the log that says what is wrong.

    A user's mesh may break any library on the way, and must not end the whole catalogue.
    """
    try:
        return [made_visible(prepare(recipe, cfg))]
    except SdfgcnError as error:
        log.warning("Left out: %s", error)
    except Exception as error:
        reason = " ".join(str(error).split()) or "no reason given"
        log.warning(
            "Left out: The object %s cannot be prepared (%s: %s).",
            recipe.name, type(error).__name__, reason,
        )  # fmt: skip
    return []
