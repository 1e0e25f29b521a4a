"""The public names: few in fgpose, complete in what their signatures name, and old ones that still work."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import typing
from collections.abc import Iterator
from types import ModuleType

import pytest

import fgpose
from fgpose.deprecated import GONE_IN, MOVED
from tests.public_names import public_modules, public_names


def functions_of(exported: object) -> Iterator[object]:
    """A function itself; of a class its annotations, and what can be called of it."""
    if not inspect.isclass(exported):
        yield inspect.unwrap(typing.cast(typing.Any, exported))
        return
    yield exported
    for name, member in vars(exported).items():
        if not name.startswith("_") or name in ("__init__", "__iter__", "__getitem__"):
            getter = getattr(member, "fget", None) or getattr(member, "func", None)
            function = getter or getattr(member, "__func__", member)
            if inspect.isfunction(function):
                yield function


def annotated() -> Iterator[tuple[str, typing.Any]]:
    """All functions and classes that a user meets, with the public name that leads there."""
    for name, exported in public_names().items():
        if inspect.isclass(exported) or callable(exported):
            yield from ((name, each) for each in functions_of(exported) if hasattr(each, "__annotations__"))


def types_in(hint: object) -> Iterator[type]:
    """The types of fgpose that a type is made of."""
    if inspect.isclass(hint) and hint.__module__.partition(".")[0] == "fgpose":
        yield hint
    for argument in hint if isinstance(hint, list) else typing.get_args(hint):
        yield from types_in(argument)


def test_a_type_in_a_public_signature_is_public() -> None:
    exported = set(map(id, public_names().values()))
    hidden = {
        f"{kind.__module__}.{kind.__qualname__} in {name}"
        for name, each in annotated()
        for field, hint in typing.get_type_hints(each).items()
        if not field.startswith("_")
        for kind in types_in(hint)
        if id(kind) not in exported
    }
    assert sorted(hidden) == []


def test_no_public_signature_names_what_is_private() -> None:
    private = [
        f"{name}: {field}: {hint}"
        for name, each in annotated()
        for field, hint in inspect.get_annotations(each).items()
        if not field.startswith("_") and re.search(r"\b_\w", re.sub(r"'[^']*'|\"[^\"]*\"", "", str(hint)))
    ]
    assert private == []


def test_the_walk_sees_what_it_is_about() -> None:
    hints = [(name, hint) for name, each in annotated() for hint in typing.get_type_hints(each).values()]
    seen = {(name, kind) for name, hint in hints for kind in types_in(hint)}
    assert ("fgpose.smooth_people", fgpose.people.SmoothedPeople) in seen
    assert ("fgpose.people.SmoothedPeople", fgpose.people.Association) in seen
    assert ("fgpose.Tracker", fgpose.calibration.RunningOffsets) in seen


@pytest.mark.parametrize("module", public_modules()[1:], ids=lambda module: module.__name__)
def test_a_docstring_is_the_table_of_contents(module: ModuleType) -> None:
    assert set(module.__all__) <= set(re.findall(r"\w+", module.__doc__ or ""))
    assert module.__name__ in (fgpose.__doc__ or "")


def test_fgpose_has_what_everybody_uses() -> None:
    assert sum(name.count(".") == 1 for name in public_names()) <= 30


@pytest.mark.parametrize("old", MOVED)
def test_an_old_name_works_and_says_where_it_is_now(old: str) -> None:
    message = rf"^fgpose\.{old} is now {re.escape(MOVED[old])}; the old name is gone in {re.escape(GONE_IN)}$"
    with pytest.warns(DeprecationWarning, match=message):
        found = getattr(fgpose, old)
    assert found is public_names()[MOVED[old]]


def test_python_shows_the_line_that_uses_an_old_name() -> None:
    command = [sys.executable, "-c", "import fgpose; fgpose.refine_rig"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert run.stderr.startswith(
        "<string>:1: DeprecationWarning: fgpose.refine_rig is now fgpose.calibration.refine_rig;"
    )


def test_old_names_are_not_shown() -> None:
    assert set(MOVED).isdisjoint(dir(fgpose))
    assert set(MOVED).isdisjoint(fgpose.__all__)


def test_a_name_that_never_was_is_an_error() -> None:
    with pytest.raises(AttributeError, match="module 'fgpose' has no attribute 'smoooth'"):
        getattr(fgpose, "smoooth")  # noqa: B009


def test_old_names_are_gone_when_it_was_said() -> None:
    def number(version: str) -> list[int]:
        return [int(part) for part in version.split(".")[:2]]

    assert number(fgpose.__version__) < number(GONE_IN)
