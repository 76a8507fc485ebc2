"""Sphinx's settings: `sphinx-build -W -b html docs docs/_build` builds the manual."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import os
import re
import sys
import textwrap
from pathlib import Path
from typing import Any

from omegaconf import MISSING
from sphinx.application import Sphinx

os.environ.setdefault("MUJOCO_GL", "egl")
sys.path.insert(0, str(Path(__file__).parent))

import config_reference

import sdfgcn

project = "sdfgcn"
author = "the sdfgcn authors"
project_copyright = author
version = release = sdfgcn.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
]
exclude_patterns = ["_build", "_templates"]
templates_path = ["_templates"]
smartquotes_action = "D"  # dashes alone: quotes stay as they are written

html_theme = "furo"
html_title = f"sdfgcn {version}"
html_static_path = ["_static"]
html_css_files = ["manual.css"]

myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3

default_role = "py:obj"  # docstrings have single backticks; what is no object stays plain code
autodoc_default_options = {"members": True, "member-order": "bysource"}
autoclass_content = "both"  # what `__init__` takes is said there
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autosummary_generate = True
napoleon_use_ivar = True
napoleon_attr_annotations = False
napoleon_custom_sections = ["Observation"]
python_use_unqualified_type_names = True

REFERENCE = "<!-- config reference -->"
ARRAY = re.compile(
    r"~?numpy\.ndarray\[~?tuple\[~?typing\.Any, \.\.\.\], ~?numpy\.dtype\[~?([\w.]+)\]\]"
)


def fill_reference(app: Sphinx, page: str, source: list[str]) -> None:
    """Put the generated reference of all config keys into its page."""
    if REFERENCE in source[0]:
        for file in sdfgcn.conf_dir().rglob("*.yaml"):
            app.env.note_dependency(str(file))
        before, _, _ = source[0].partition(REFERENCE)  # after it stands what GitHub shows
        source[0] = before + config_reference.text()


def read_docstring(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """Docstrings are plain text with code in backticks and indented examples: make it so."""
    own = what == "class" and str(getattr(obj.__init__, "__module__", "")).startswith("sdfgcn")
    if what == "class" and not (own and any(lines)):
        lines[:] = [*class_docstring(obj).splitlines(), ""]
    read: list[str] = []
    for line in lines:
        example = what == "module" and line.startswith("    ")
        if example and not read[-1]:
            read += ["::", ""]
        read.append(line if example else escaped(line))
    lines[:] = read


def class_docstring(cls: type) -> str:
    """The docstring of a class alone; read from the source where a TensorClass has replaced it."""
    if not (cls.__doc__ or "").startswith(f"{cls.__name__}("):
        return inspect.getdoc(cls) or ""
    tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
    return ast.get_docstring(tree.body[0]) or ""


def escaped(line: str) -> str:
    """A line in which `[*B, N]` begins no emphasis; a list item stays one."""
    item = re.match(r"\s*\* ", line)
    head, rest = (item[0], line[item.end() :]) if item else ("", line)
    parts = re.split(r"(`+[^`]*`+)", rest)
    parts[::2] = [re.sub(r"([*|]|_\b)", r"\\\1", part) for part in parts[::2]]
    return head + "".join(parts)


def skip(app: Sphinx, what: str, name: str, obj: Any, skipped: bool, options: Any) -> bool | None:
    """Leave out what other packages put into our classes."""
    owner = getattr(getattr(obj, "fget", obj), "__module__", None) or "sdfgcn"
    return None if owner.startswith("sdfgcn") else True


def shorten(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, arguments: str, result: str
) -> tuple[str, str] | None:
    """Signatures that can be read: of `__init__` where a metaclass hides it, arrays as NDArray."""
    if not arguments:
        return None
    fields = dataclasses.fields(obj) if dataclasses.is_dataclass(obj) else ()
    if any(field.default == MISSING for field in fields):
        return "", ""  # a config, whose values come from YAML
    if what == "class" and arguments == "(*args, **kwargs)":
        own = [*inspect.signature(obj.__init__).parameters.values()][1:]
        arguments = str(inspect.Signature(own)).replace("'", "")
        arguments = "" if arguments == "(*args, **kwargs)" else arguments  # of a protocol
    return ARRAY.sub(r"NDArray[\1]", arguments), ARRAY.sub(r"NDArray[\1]", result or "")


def setup(app: Sphinx) -> None:
    """Connect the functions above to Sphinx; forget pages of modules that are gone."""
    for page in (Path(__file__).parent / "_api").glob("*.rst"):
        module = Path(sdfgcn.__file__).parents[1].joinpath(*page.stem.split("."))
        if not (module.is_dir() or module.with_suffix(".py").is_file()):
            page.unlink()
    app.connect("source-read", fill_reference)
    app.connect("autodoc-process-docstring", read_docstring, priority=400)  # before napoleon
    app.connect("autodoc-skip-member", skip)
    app.connect("autodoc-process-signature", shorten)
