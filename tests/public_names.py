"""What of fgpose is public: the names in the ``__all__`` of fgpose and of its modules."""

from __future__ import annotations

from functools import cache
from types import ModuleType

import fgpose


@cache
def public_modules() -> tuple[ModuleType, ...]:
    """fgpose itself, and those right below it that say what they export."""
    modules = (module for module in vars(fgpose).values() if isinstance(module, ModuleType))
    own = (module for module in modules if module.__name__.startswith("fgpose.") and hasattr(module, "__all__"))
    return (fgpose, *own)


@cache
def public_names() -> dict[str, object]:
    """What is exported, by the dotted names."""
    each = ((module, name) for module in public_modules() for name in module.__all__)
    return {f"{module.__name__}.{name}": getattr(module, name) for module, name in each}
