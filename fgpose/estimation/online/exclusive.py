"""Objects that one thread at a time may use: the others wait."""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

_Args = ParamSpec("_Args")
_Result = TypeVar("_Result")
_Self = TypeVar("_Self", bound="Exclusive")


class Exclusive:
    """Its methods that are marked by exclusive wait for each other. The lock is not pickled or copied, and copy.copy is
    copy.deepcopy: two that share what they change would ruin it."""

    def __init__(self) -> None:
        self._lock = threading.RLock()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_lock"}

    def __copy__(self: _Self) -> _Self:
        return copy.deepcopy(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._lock = threading.RLock()


def exclusive(method: Callable[Concatenate[_Self, _Args], _Result]) -> Callable[Concatenate[_Self, _Args], _Result]:
    """A method that begins when no other thread is in one of the same object."""

    @wraps(method)
    def alone(self: _Self, *args: _Args.args, **options: _Args.kwargs) -> _Result:
        with self._lock:
            return method(self, *args, **options)

    return alone
