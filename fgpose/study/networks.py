"""The network of a study."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from fgpose.monocular.network import Network
from fgpose.monocular.networks import open_network
from fgpose.study.study import Detect, Study


def network(study: Study) -> Network:
    """The network of a study, opened once in a process. Raises ValueError and OSError as open_network."""
    return _network(study.detect, study.base)


@lru_cache(maxsize=1)
def _network(settings: Detect, base: Path) -> Network:
    file = base / settings.model
    return open_network(
        file if file.is_file() else settings.model,
        kind=settings.network,
        detector=base / settings.detector if settings.detector else None,
        max_people=settings.max_people,
    )
