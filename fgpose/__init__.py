"""fgpose: 3D human pose over time from several calibrated cameras, as a GTSAM factor graph.

rig = fgpose.load_rig("Calib.toml")
observations = fgpose.load_observations("pose/", rig, skeleton="body_25b", fps=60)
trajectory = fgpose.smooth(observations, rig)

Here is what everybody uses. The rest is in fgpose.calibration, fgpose.files, fgpose.people, fgpose.config (sections of
the configuration), and fgpose.diagnosis, fgpose.assessment and fgpose.kinematics (what their functions return). What
is in the ``__all__`` of these is stable (docs/reference/stability.md).
"""

import sys as _sys

if "".join(_sys.argv[:1]).endswith("/fgpose") or _sys.orig_argv[1:3] == ["-m", "fgpose"]:
    # Ctrl-C ends the command while it loads its modules: there, an interrupt would become any error.
    import signal as _signal

    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)

from importlib.metadata import version as _version

import lazy_loader as _lazy_loader

# Before anything loads OpenCV, whose limit it sets.
import fgpose.plain_files as _plain_files  # noqa: F401
from fgpose.deprecated import moved as _moved

# The names of __init__.pyi, each loaded when it is asked for: a process of fgpose live needs few of them.
_named, __dir__, __all__ = _lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    return _named(name) if name in __all__ else _moved(name)


__version__ = _version("fgpose")
