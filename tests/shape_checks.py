"""Shapes and types of all arguments and results, checked in the first calls of every function in every test.

jaxtyping checks every call, which takes two thirds of the time of the tests: solvers call the same function with the
same shapes thousands of times, and so do tests one after the other. Imported before fgpose.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable, Hashable
from typing import Any

import jaxtyping
import numpy as np

_check_every_call = jaxtyping.jaxtyped
_called: set[int] = set()
"""In this test, by the code of the function: a nested one is made anew by each call of the outer one."""
_checked: set[Hashable] = set()
"""In all tests: the code of a function, and the types and shapes of its arguments."""


def pytest_runtest_setup() -> None:
    _called.clear()


def _check_first_calls(fn: Any, *, typechecker: Any) -> Any:
    if inspect.isclass(fn):
        if dataclasses.is_dataclass(fn) and "__init__" in vars(fn):
            fn.__init__ = _check_first_calls(fn.__init__, typechecker=typechecker)
        return fn
    return _first_calls(fn, functools.cache(lambda: _check_every_call(fn, typechecker=typechecker)))


def _first_calls(plain: Callable[..., Any], checked: Callable[[], Callable[..., Any]]) -> Callable[..., Any]:
    """Checked by the one, then as it is; the check is made when it is needed, which takes time too."""
    code = id(plain.__code__)

    @functools.wraps(plain)
    def function(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        if code in _called:
            return plain(*args, **kwargs)
        _called.add(code)
        call = code, _kind(args), _kind(kwargs)
        if call in _checked:
            return plain(*args, **kwargs)
        result = checked()(*args, **kwargs)
        _checked.add(call)
        return result

    return function


def _kind(value: Any, depth: int = 3) -> Hashable:
    """What annotations say something about: types, shapes, words and what containers hold; not deeper, for a list may
    hold itself."""
    kind = type(value)
    if kind is np.ndarray:
        return value.dtype, value.shape
    if depth and (kind is tuple or kind is list):
        return kind, *(_kind(each, depth - 1) for each in value[:9])
    if depth and kind is dict:
        return *value, *(_kind(each, depth - 1) for each in value.values())
    return value[:99] if kind is str else kind


def _jaxtyped(fn: Any = None, **options: Any) -> Any:
    if fn is None and "typechecker" in options:
        return functools.partial(_check_first_calls, **options)
    return _check_every_call(fn, **options) if fn is not None else _check_every_call(**options)


jaxtyping.jaxtyped = _jaxtyped
