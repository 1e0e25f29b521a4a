"""What of fgpose is public: the names in the ``__all__`` of fgpose and of its modules."""

from __future__ import annotations

from functools import cache
from types import ModuleType

import fgpose


@cache
def public_modules() -> tuple[ModuleType, ...]:
    """fgpose itself, and those that it names."""
    named = (getattr(fgpose, name) for name in fgpose.__all__)
    return (fgpose, *(each for each in named if isinstance(each, ModuleType)))


@cache
def public_names() -> dict[str, object]:
    """What is exported, by the dotted names."""
    each = ((module, name) for module in public_modules() for name in module.__all__)
    found = {f"{module.__name__}.{name}": getattr(module, name) for module, name in each}
    return {name: exported for name, exported in found.items() if not isinstance(exported, ModuleType)}
