"""The registry of object sources, and the one way to load a catalogue."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from tqdm import tqdm

from sdfgcn.config import SPLITS, ObjectsConfig, lookup
from sdfgcn.errors import SdfgcnError
from sdfgcn.objects import household, scanned, shapenet
from sdfgcn.objects.model import ObjectModel, Recipe
from sdfgcn.objects.prepare import prepare
from sdfgcn.objects.storage import cache_dir, read_models, write_models
from sdfgcn.validation import validate_objects

FORMAT = 3  # raise it whenever the same settings would now give other objects
_NOT_IN_KEY = ("palette", "root", "split_file")  # these do not change what is cached, or see below

log = logging.getLogger(__name__)


def _no_fingerprint(cfg: ObjectsConfig) -> str:
    return ""


@dataclass(frozen=True)
class Source:
    """Where objects come from.

    Attributes:
        recipes: Lists every object of both splits; may download. Called only to build a cache.
        fingerprint: Text that changes when the same settings would give other objects.
        lenient: Leave out an object that cannot be built, with a warning, instead of failing.
    """

    recipes: Callable[[ObjectsConfig], list[Recipe]]
    fingerprint: Callable[[ObjectsConfig], str] = _no_fingerprint
    lenient: bool = False


SOURCES: dict[str, Source] = {
    "scanned": Source(scanned.recipes),
    "household": Source(household.recipes),
    "shapenet": Source(shapenet.recipes, shapenet.fingerprint, lenient=True),
}


def load_catalogue(cfg: ObjectsConfig, split: str) -> tuple[ObjectModel, ...]:
    """Return the objects of one split, building the cache first if need be.

    Args:
        cfg: Source, limits and settings (`conf/objects/`).
        split: "train" or "test".

    Returns:
        The object models, in a fixed order.

    Raises:
        SdfgcnError: An unknown source or split, a contradictory limit, a damaged or unwritable
            cache, no network for `scanned`, a bad directory for `shapenet`, or an empty split.
    """
    lookup(SOURCES, "objects", cfg.name)
    if split not in SPLITS:
        raise SdfgcnError(f"The split is '{split}', but must be one of {', '.join(SPLITS)}.")
    validate_objects(cfg)
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
    settings |= {"format": FORMAT, "fingerprint": SOURCES[cfg.name].fingerprint(cfg)}
    key = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]
    return cache_dir() / "objects" / f"{cfg.name}-{key}"


def _build(cfg: ObjectsConfig) -> list[ObjectModel]:
    source = SOURCES[cfg.name]
    models = []
    bar = tqdm(
        source.recipes(cfg), desc=f"Building the {cfg.name} catalogue", unit="object", disable=None
    )
    for recipe in bar:
        bar.set_postfix_str(recipe.name, refresh=False)
        try:
            models.append(prepare(recipe, cfg))
        except SdfgcnError as error:
            if not source.lenient:
                raise
            log.warning("Left out: %s", error)
    return models
