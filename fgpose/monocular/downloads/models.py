"""The networks whose weights fgpose can fetch: their list, and how they get into the user's cache.

The weights are TensorFlow Lite files in registry packages and are converted to ONNX here. The conversion always gives
the same bytes (with onnx 1.15 to 1.23), so both the source and the result are checked by their digests.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fgpose.monocular.downloads import packages
from fgpose.monocular.downloads.cache import CachedFile, Say, cache_folder, provide
from fgpose.monocular.downloads.packages import Download, Member, Package
from fgpose.shown.unknown_names import did_you_mean

_WHEEL = Package("PyPI", "mediapipe", "0.10.21")
_TARBALL = Package("npm", "@mediapipe/pose", "0.5.1675469404")
_FOLDER = "models/blazepose"
_LICENCE = "Apache-2.0"
# The fourth output, a segmentation mask, takes half of the time and is not used.
_LANDMARK_OUTPUTS = ("Identity", "Identity_1", "Identity_3", "Identity_4")


@dataclass(frozen=True)
class PulledModel:
    """A model in the user's cache."""

    landmarks: Path
    """ONNX file of the network that finds the joints of a person."""
    detector: Path
    """ONNX file of the network that finds the people."""


@dataclass(frozen=True)
class Model:
    """A model that can be fetched."""

    name: str
    licence: str
    skeleton: str
    landmarks: CachedFile
    detector: CachedFile
    licence_text: CachedFile

    @property
    def n_bytes(self) -> int:
        """Size in the cache; several models share the detector."""
        return self.landmarks.n_bytes + self.detector.n_bytes

    @property
    def files(self) -> tuple[CachedFile, ...]:
        return self.landmarks, self.detector, self.licence_text

    def in_cache(self) -> PulledModel | None:
        """Where it is, if it is there and unharmed."""
        folder = cache_folder()
        return self._within(folder) if all(file.is_intact(folder) for file in self.files) else None

    def pull(self, progress: Say | None = None, download: Download = packages.download) -> PulledModel:
        """As pull() below."""
        pulled = self.in_cache()
        if pulled is None:
            _require_converter()
            provide(self.files, cache_folder(), download, progress)
            pulled = self._within(cache_folder())
        return pulled

    def _within(self, folder: Path) -> PulledModel:
        return PulledModel(folder / self.landmarks.path, folder / self.detector.path)


def pull(name: str, progress: Say | None = None, *, download: Download = packages.download) -> PulledModel:
    """Fetch a model into the user's cache, with its licence and a note on its origin.

    If it is there already, its files are only compared with their digests; that needs no network.

    Args:
        name: of a model in MODELS.
        progress: told what is done next.
        download: fetches a package.

    Raises:
        ValueError: no model has this name, or what was fetched is damaged or not the expected content.
        OSError: the package cannot be fetched, or the cache cannot be written; the message says what to do.
        ImportError: what the conversion needs is not installed.
    """
    return find_model(name).pull(progress, download)


def find_model(name: str) -> Model:
    """The model of this name. Raises ValueError if there is none."""
    for model in MODELS:
        if model.name == name:
            return model
    names = [model.name for model in MODELS]
    raise ValueError(f"no model {name!r}{did_you_mean(name, names)}; there is {', '.join(names)}")


def _converted(name: str, source: Member, n_bytes: int, sha256: str, outputs: tuple[str, ...]) -> CachedFile:
    """The ONNX file of a network, with a note of what was changed, as the licence asks (Apache-2.0, section 4b)."""
    origin = {
        "source": str(source),
        "source_sha256": source.sha256,
        "license": _LICENCE,
        "changes": f"converted from TensorFlow Lite to ONNX by fgpose; outputs kept: {', '.join(outputs)}",
    }
    note = "".join(f"{key}: {value}\n" for key, value in origin.items()) + "The licence is in LICENSE.\n"
    convert = partial(_convert, name=str(source), outputs=outputs, metadata=origin)
    return CachedFile(f"{_FOLDER}/{name}.onnx", source, n_bytes, sha256, convert, note)


def _require_converter() -> None:
    """Before anything is fetched."""
    try:
        import onnx  # noqa: F401
        import tflite  # noqa: F401
    except ImportError:
        raise ImportError("converting weights needs onnx and tflite: pip install 'fgpose[video]'") from None


def _convert(data: bytes, *, name: str, outputs: tuple[str, ...], metadata: dict[str, str]) -> bytes:
    from fgpose.monocular.downloads.tflite import convert

    return convert(data, name=name, outputs=outputs, metadata=metadata)


_LICENCE_TEXT = CachedFile.copy_of(
    Member(
        _WHEEL,
        "mediapipe-0.10.21.dist-info/LICENSE",
        12_331,
        "8707eef0533987efc5b155d64761eeb6e20793f50b9bd1a68dad1cf4719d0ed8",
    ),
    f"{_FOLDER}/LICENSE",
)
_DETECTOR = _converted(
    "blazepose-detector",
    Member(
        _WHEEL,
        "mediapipe/modules/pose_detection/pose_detection.tflite",
        2_959_046,
        "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    ),
    5_963_417,
    "c77228ddb5e58b8dcd09f6e1e1e2cc67de407d0db52a8bfdb36c0b262285d79b",
    ("Identity", "Identity_1"),
)


def _blazepose(variant: str, source: Member, n_bytes: int, sha256: str) -> Model:
    name = f"blazepose-{variant}"
    landmarks = _converted(name, source, n_bytes, sha256, _LANDMARK_OUTPUTS)
    return Model(name, _LICENCE, "blazepose_33", landmarks, _DETECTOR, _LICENCE_TEXT)


MODELS = (
    _blazepose(
        "lite",
        Member(
            _TARBALL,
            "package/pose_landmark_lite.tflite",
            2_819_824,
            "f17bfbecadb61c3be1baa8b8d851cc6619c870a87167b32848ad20db306b9d61",
        ),
        2_757_548,
        "04a0b4135aec18a07675e5cdc9ad3eff976fedbdeab2a2c475a1b50758013074",
    ),
    _blazepose(
        "full",
        Member(
            _WHEEL,
            "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
            6_440_512,
            "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
        ),
        6_373_110,
        "ecdfed92cb7cf98f6191fc6ae8389767611fa8b16f4be101fe9ee37b35d88c7a",
    ),
    _blazepose(
        "heavy",
        Member(
            _TARBALL,
            "package/pose_landmark_heavy.tflite",
            27_709_200,
            "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe",
        ),
        27_581_230,
        "e3f8181699ff9b84b525cf07f7e18285df7531745569a448d446c145a0973bbd",
    ),
)
"""From the fastest to the most accurate."""
