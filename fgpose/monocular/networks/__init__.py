"""Networks by name: those whose weights fgpose fetches, and ONNX files of the user."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from fgpose.extensions import added
from fgpose.monocular.downloads.cache import Say
from fgpose.monocular.network import Network
from fgpose.monocular.networks.devices import Device, chosen_device

NetworkKind = Literal["blazepose", "rtmpose", "rtmw3d", "metrabs"]

DEFAULT_MODEL = "blazepose-full"


def open_network(
    model: str | Path = DEFAULT_MODEL,
    *,
    kind: NetworkKind = "blazepose",
    detector: Path | None = None,
    skeleton: str | Path | None = None,
    max_people: int = 1,
    device: Device = "auto",
    progress: Say | None = None,
) -> Network:
    """A network with one thread for each run, as cameras are processed in parallel.

    Args:
        model: the name of a model that can be pulled, which is done if it is not in the cache; of a detector that
            another package adds (entry point of the group fgpose.detectors, called with max_people); or an ONNX file.
        kind: which network such a file is.
        detector: ONNX file that finds the people: YOLOX, for blazepose its own detector. Needed with a file of any kind
            but blazepose, for which it is pulled.
        skeleton: of a MeTRAbs file, whose joints depend on its export.
        max_people: how many people to find in an image at most.
        device: where the network runs; one that another package adds says so itself.
        progress: told what is done next while weights are fetched.

    Raises:
        ValueError: there is no such model, the device is not available or does not start, a file is another network, or
            an argument is missing or does not belong to the kind.
        OSError: a file cannot be read, or the weights cannot be fetched; the message says what to do.
    """
    if (others := added("fgpose.detectors").get(str(model))) is not None:
        if device != "auto":
            raise ValueError(f"{model} of another package says itself where it runs: leave out the device (--device)")
        return others(max_people=max_people)
    chosen_device(device)  # before anything is fetched
    path = Path(model)
    if path.suffix != ".onnx" and not path.is_file():
        if kind != "blazepose" or detector is not None:
            raise ValueError(f"{model} is not an ONNX file, which --detector and every --network but blazepose need")
        _refuse_skeleton(skeleton, kind)
        return _blazepose(str(model), None, None, max_people, device, progress)
    if kind == "blazepose":
        _refuse_skeleton(skeleton, kind)
        return _blazepose(DEFAULT_MODEL, path, detector, max_people, device, progress)
    if detector is None:
        raise ValueError(f"{kind} needs a network that finds the people: an ONNX file of YOLOX (detector, --detector)")
    if kind == "metrabs":
        if skeleton is None:
            raise ValueError("metrabs needs the skeleton of the joints that its file gives (skeleton, --skeleton)")
        from fgpose.monocular.networks.metrabs import MeTRAbs

        return MeTRAbs(path, detector, skeleton, max_people=max_people, device=device)
    _refuse_skeleton(skeleton, kind)
    if kind == "rtmpose":
        from fgpose.monocular.networks.rtmpose import RTMPose

        return RTMPose(path, detector, max_people=max_people, device=device)
    from fgpose.monocular.networks.rtmw3d import RTMW3D

    return RTMW3D(path, detector, max_people=max_people, device=device)


def _blazepose(
    name: str,
    landmarks: Path | None,
    detector: Path | None,
    max_people: int,
    device: Device,
    progress: Say | None,
) -> Network:
    from fgpose.monocular.downloads.models import pull
    from fgpose.monocular.networks.blazepose import BlazePose

    if landmarks is None or detector is None:
        pulled = pull(name, progress)
        landmarks, detector = landmarks or pulled.landmarks, detector or pulled.detector
    return BlazePose(landmarks, detector, max_people=max_people, device=device)


def _refuse_skeleton(skeleton: str | Path | None, kind: NetworkKind) -> None:
    if skeleton is not None:
        raise ValueError(f"the joints of {kind} are known: a skeleton is for metrabs only")
