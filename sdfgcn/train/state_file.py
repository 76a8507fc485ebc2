"""The state of a part of a training as files that hold data only: JSON and safetensors.

TorchRL's own files would do, but for its replay buffer's, which hold a pickle, and reading a pickle
runs whatever code it names.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import load_file, save_file
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.checkpoint import CheckpointAdapter

from sdfgcn.task.scene import Scene

STRUCTURE = "state.json"
TENSORS = "tensors.safetensors"


class StateFileAdapter(CheckpointAdapter):
    """Saves what has a `state_dict` and a `load_state_dict` as two files, and loads it.

    The state may consist of None, booleans, numbers, strings, lists, tuples, dicts, tensors,
    TensorDicts and scenes. Tensors are loaded to the CPU.
    """

    adapter_id = "sdfgcn.state_file"

    def save(
        self, component: Any, path: Path, *, args: tuple[Any, ...], kwargs: Mapping[str, Any]
    ) -> None:
        """Write the component's state to the folder `path`.

        Raises:
            TypeError: The state has something that is not listed above.
        """
        path.mkdir(parents=True)
        tensors: dict[str, Tensor] = {}
        structure = encoded(component.state_dict(), tensors)
        (path / STRUCTURE).write_text(json.dumps(structure), encoding="utf-8")
        save_file(tensors, path / TENSORS)

    def load(
        self,
        component: Any,
        path: Path,
        *,
        map_location: Any,
        tensor_load_kwargs: Mapping[str, Any],
        args: tuple[Any, ...],
        kwargs: Mapping[str, Any],
    ) -> None:
        """Restore the component's state from the folder `path`.

        Raises:
            ValueError: The files are not of such a state.
        """
        structure = json.loads((path / STRUCTURE).read_text(encoding="utf-8"))
        # Cloned, since the loaded ones still depend on the file.
        tensors = {name: value.clone() for name, value in load_file(path / TENSORS).items()}
        component.load_state_dict(decoded(structure, tensors))


def encoded(value: Any, tensors: dict[str, Tensor], path: str = "") -> Any:
    """Turn a state into JSON types.

    Args:
        value: The state; see `StateFileAdapter`.
        tensors: Receives its tensors, on the CPU, by their path in the state.
        path: The path of `value`.

    Raises:
        TypeError: The state has something else.
    """
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Tensor):
        name = f"{path}#{len(tensors)}"  # the number makes it unique
        kept = value.detach().cpu().contiguous()
        places = {tensor.untyped_storage().data_ptr() for tensor in tensors.values()}
        # The format cannot hold two tensors that share memory, as tied weights do.
        tensors[name] = kept.clone() if kept.untyped_storage().data_ptr() in places else kept
        return {"tensor": name}
    if isinstance(value, list | tuple):
        items = [encoded(item, tensors, f"{path}/{i}") for i, item in enumerate(value)]
        return items if isinstance(value, list) else {"tuple": items}
    if isinstance(value, Scene | TensorDictBase):
        kind = _name(type(value)) if isinstance(value, Scene) else "TensorDict"
        fields = {key: encoded(item, tensors, f"{path}/{key}") for key, item in value.items()}
        return {"batch": [kind, list(value.batch_size), fields]}
    if isinstance(value, Mapping):
        pairs = [[key, encoded(item, tensors, f"{path}/{key}")] for key, item in value.items()]
        if not all(isinstance(key, str | int) for key, _ in pairs):
            raise TypeError(f"{path} has a key that is neither a string nor a whole number")
        return {"dict": pairs}
    raise TypeError(f"{path} is of {type(value)}, which a checkpoint does not hold")


def decoded(value: Any, tensors: Mapping[str, Tensor]) -> Any:
    """The inverse of `encoded`.

    Raises:
        ValueError: `value` is not from `encoded`.
    """
    if isinstance(value, list):
        return [decoded(item, tensors) for item in value]
    if not isinstance(value, dict):
        return value
    try:
        ((kind, content),) = value.items()
        match kind:
            case "tensor":
                return tensors[content]
            case "tuple":
                return tuple(decoded(item, tensors) for item in content)
            case "dict":
                return {key: decoded(item, tensors) for key, item in content}
            case "batch":
                name, size, fields = content
                values = {key: decoded(item, tensors) for key, item in fields.items()}
                return _batch(name, size, values)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"not a state's structure ({error})") from error
    raise ValueError(f"not a state's structure: '{kind}'")


def _batch(name: str, size: list[int], values: dict[str, Any]) -> TensorDictBase | Scene:
    if name == "TensorDict":
        return TensorDict(values, batch_size=size)
    # Only classes that are there already: nothing that a file names is imported.
    return {_name(kind): kind for kind in _kinds(Scene)}[name](**values, batch_size=size)


def _name(kind: type[Scene]) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _kinds(base: type[Scene]) -> Iterator[type[Scene]]:
    yield base
    for kind in base.__subclasses__():
        yield from _kinds(kind)
