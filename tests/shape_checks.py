"""Shapes and types of all arguments and results, checked in the first calls of every function in every test.

jaxtyping checks every call, which takes two thirds of the time of the tests: solvers call the same function with the
same shapes thousands of times. Imported before fgpose.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

import jaxtyping

_FIRST_CALLS = 1
_check_every_call = jaxtyping.jaxtyped
_calls: dict[int, int] = {}
"""In this test, by the code of the function: a nested one is made anew by each call of the outer one."""


def pytest_runtest_setup() -> None:
    _calls.clear()


def _check_first_calls(fn: Any, *, typechecker: Any) -> Any:
    if inspect.isclass(fn):
        plain = fn.__init__
        fn = _check_every_call(fn, typechecker=typechecker)
        if fn.__init__ is not plain:
            checked = fn.__init__
            fn.__init__ = _first_calls(plain, lambda: checked)
        return fn
    if not inspect.isfunction(fn):
        return _check_every_call(fn, typechecker=typechecker)
    return _first_calls(fn, functools.cache(lambda: _check_every_call(fn, typechecker=typechecker)))


def _first_calls(plain: Callable[..., Any], checked: Callable[[], Callable[..., Any]]) -> Callable[..., Any]:
    """Checked by the one, then as it is; the check is made when it is needed, which takes time too."""
    code = id(plain.__code__)

    @functools.wraps(plain)
    def function(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        count = _calls.get(code, 0)
        if count >= _FIRST_CALLS:
            return plain(*args, **kwargs)
        _calls[code] = count + 1
        return checked()(*args, **kwargs)

    return function


def _jaxtyped(fn: Any = None, **options: Any) -> Any:
    if fn is None and "typechecker" in options:
        return functools.partial(_check_first_calls, **options)
    return _check_every_call(fn, **options) if fn is not None else _check_every_call(**options)


jaxtyping.jaxtyped = _jaxtyped  # pyright: ignore[reportAttributeAccessIssue]
