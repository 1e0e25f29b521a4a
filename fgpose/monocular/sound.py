"""When videos began, relative to each other, by the sound in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float

from fgpose.monocular.clips import Clip
from fgpose_factors.robust_statistics import robust_sigma

SIGMA_S = 0.01
"""Standard deviation of a start: sound travels 3.4 m in that time."""
_AUDIO_HZ = 8000
# Loudness in steps of 5 ms. What comes suddenly counts (its growth), as rooms and microphones colour everything else.
_STEP_HZ = 200
_QUIET = 1e-4  # of full scale: the noise of a 14-bit converter, so that silence has no onsets
# Of the shifts of two tracks that have nothing in common, some 10,000 are tried: the highest is about 4.
_MIN_SCORE, _DECISIVE = 8.0, 1.5
_PEAK_S = 0.1  # echoes make the peak so wide
_MIN_OVERLAP_S = 5.0
# Of three videos, shifts that agree are right.
_AGREE_S = 0.03
_PER_VALUE = _AUDIO_HZ // _STEP_HZ


@dataclass(frozen=True)
class HeardStart:
    """When a video began: time by its clock + offset_s is the same for all videos that were heard together."""

    offset_s: float
    score: float
    """Of the correlation with the others, in robust standard deviations of chance."""


def starts_by_sound(clips: Sequence[Clip]) -> dict[str, HeardStart]:
    """The starts of videos that share a sound, by name; without those in which it is not heard clearly.

    Onsets of the sound of every two videos are correlated. Of all videos the one that fits most others best is the one
    that they are compared with. Needs PyAV (check_sound)."""
    heard_in = {clip.name: onsets_of(clip.path) for clip in clips if not clip.files}
    onsets = {name: own for name, own in heard_in.items() if own is not None}
    shifts = {pair: _shift(onsets[pair[0]], onsets[pair[1]]) for pair in combinations(onsets, 2)}
    known = {pair: shift for pair, shift in shifts.items() if shift is not None}
    if not known:
        return {}
    known |= {(other, one): (-shift_s, score) for (one, other), (shift_s, score) in known.items()}
    reference = max(onsets, key=lambda name: sum(score for pair, (_, score) in known.items() if pair[0] == name))
    heard = {name: known[reference, name] for name in onsets if (reference, name) in known}
    heard = {name: own for name, own in heard.items() if not _contradicted(name, heard, known)}
    if not heard:
        return {}
    highest = max(score for _, score in heard.values())
    return {reference: HeardStart(0.0, highest)} | {name: HeardStart(*own) for name, own in heard.items()}


def check_sound() -> None:
    """Raise ImportError if PyAV is not installed (extra sound)."""
    try:
        import av  # noqa: F401
    except ModuleNotFoundError:
        raise ImportError('the sound of videos needs PyAV: pip install "fgpose[sound]"') from None


def onsets_of(path: Path) -> Float[np.ndarray, " step"] | None:
    """How much louder it becomes in each step of 5 ms from the first image of a video, standardised; None without
    sound."""
    samples = _samples(path)
    return None if samples is None else _onsets(samples)


def _samples(path: Path) -> Float[np.ndarray, " sample"] | None:
    """Of the sound, from the first image on."""
    import av

    with av.open(str(path)) as container:
        if not container.streams.audio or not container.streams.video:
            return None
        video = container.streams.video[0]
        begins_s = float((video.start_time or 0) * (video.time_base or 0))
        resampler, pieces = av.AudioResampler("flt", "mono", _AUDIO_HZ), list[np.ndarray]()
        first_s = 0.0
        for frame in container.decode(audio=0):
            first_s = first_s if pieces else float(frame.time or 0.0)
            pieces += [piece.to_ndarray()[0] for piece in resampler.resample(frame)]
    if not pieces:
        return None
    samples, late = np.concatenate(pieces).astype(float), round((first_s - begins_s) * _AUDIO_HZ)
    return np.pad(samples, (late, 0)) if late > 0 else samples[-late:]


def _onsets(samples: Float[np.ndarray, " sample"]) -> Float[np.ndarray, " step"] | None:
    steps = samples[: len(samples) // _PER_VALUE * _PER_VALUE].reshape(-1, _PER_VALUE)
    loudness = np.log(np.sqrt(np.mean(steps**2, axis=1)) + _QUIET)
    grows = np.maximum(np.diff(loudness, prepend=loudness[:1]), 0.0)
    spread = grows.std()
    return (grows - grows.mean()) / spread if spread > 0 else None


def _shift(one: Float[np.ndarray, " step"], other: Float[np.ndarray, " step"]) -> tuple[float, float] | None:
    """Time of the first = time of the second + shift, seconds, and its score; None where that is not clear."""
    from scipy.signal import correlate

    score = correlate(one, other, method="fft")
    lags = np.arange(len(score)) - (len(other) - 1)
    overlap = np.minimum(len(one), lags + len(other)) - np.maximum(0, lags)
    score = np.where(overlap >= _MIN_OVERLAP_S * _STEP_HZ, score / np.sqrt(np.maximum(overlap, 1)), 0.0)
    chance = robust_sigma(score[score != 0]) if score.any() else 0.0
    best = int(score.argmax())
    near = np.abs(lags - lags[best]) <= _PEAK_S * _STEP_HZ
    second = float(score[~near].max(initial=0.0))
    if chance == 0 or score[best] < _MIN_SCORE * chance or score[best] < _DECISIVE * second:
        return None
    return float(lags[best]) / _STEP_HZ, float(score[best] / chance)


def _contradicted(
    name: str, heard: dict[str, tuple[float, float]], known: dict[tuple[str, str], tuple[float, float]]
) -> bool:
    """Whether most others that it was compared with say something else."""
    others = [other for other in heard if (other, name) in known]
    agree = [abs(heard[other][0] + known[other, name][0] - heard[name][0]) <= _AGREE_S for other in others]
    return bool(agree) and not np.mean(agree) >= 0.5
