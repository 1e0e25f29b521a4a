"""Left and right of somebody who was founded on images in which detectors exchange them."""

from __future__ import annotations

import numpy as np
import pytest

import fgpose
from fgpose.association.identity.sides import Sides
from fgpose.association.recording import associate
from fgpose.people_observations import Detections, PeopleObservations
from fgpose_benchmarks.synthetic import NO_OCCLUSION, DetectionNoise, motion_from_npz, ring_rig, simulate
from tests.conftest import MOCAP

RIG = ring_rig()
SKELETON = fgpose.load_skeleton("h36m_17")
SIDED = SKELETON.mirror != np.arange(SKELETON.n_joints)
FPS = 30.0


def filmed(
    exchanged: list[int], until_s: float, from_s: float = 0.0, apart_s: float = 0.0
) -> tuple[PeopleObservations, np.ndarray]:
    """One person, whom these cameras show with left and right exchanged meanwhile, each camera so much after the one
    before; and the truth."""
    truth_m, fps = motion_from_npz(MOCAP / "cmu_03_03_b.npz")
    truth_m = truth_m[:: int(fps / FPS)][:150]
    scene = simulate(truth_m, SKELETON, RIG, FPS, DetectionNoise(), NO_OCCLUSION, seed=0).observations
    images = []
    for frame, time_s in enumerate(scene.frame_time_s.tolist()):
        for camera, name in enumerate(RIG.names):
            points_px, confidence = scene.points2d_px[frame, camera], scene.confidence[frame, camera].astype(float)
            if camera in exchanged and from_s <= time_s < until_s:
                points_px, confidence = points_px[SKELETON.mirror], confidence[SKELETON.mirror]
            images.append(Detections(name, time_s + camera * apart_s, points_px[None], confidence[None]))
    images.sort(key=lambda image: image.time_s)
    return PeopleObservations(SKELETON, RIG.names, tuple(images)), truth_m


def tracked(seen: PeopleObservations) -> tuple[dict[int, np.ndarray], list[str]]:
    """Positions of the first person by frame, and what was said."""
    tracker = fgpose.Tracker(RIG, SKELETON, fgpose.Config(tracking={"max_processes": 1}))
    positions_m = {}
    for first in range(0, len(seen.images), RIG.n_cameras):
        for person in tracker.update(seen.images[first : first + RIG.n_cameras]):
            positions_m[first // RIG.n_cameras] = person.estimate.positions_m
    return positions_m, [event.what for event in tracker.events()]


def exchanged_share(positions_m: np.ndarray, truth_m: np.ndarray) -> float:
    """Of the joints of either side, those that are nearer to the one on the other side."""
    off_m = np.linalg.norm(positions_m - truth_m, axis=-1)[SIDED]
    return float(np.mean(off_m > np.linalg.norm(positions_m - truth_m[SKELETON.mirror], axis=-1)[SIDED]))


def test_most_of_the_time_says_which_side_is_left() -> None:
    sides = Sides(0.0)
    for number in range(900):
        sides.told(number / FPS, are_wrong=False)
    assert not sides.are_wrong
    n_wrong = 0
    while not sides.are_wrong:
        sides.told(30.0 + n_wrong / FPS, are_wrong=True)
        n_wrong += 1
    # Half of what is remembered of 3 s.
    assert n_wrong / FPS == pytest.approx(2.1, abs=0.2)
    assert sides.since_s == pytest.approx(30.0, abs=0.05)


def test_what_some_images_say_now_and_then_tells_nothing() -> None:
    sides = Sides(0.0)
    for number in range(900):
        sides.told(number / FPS, are_wrong=number % 3 == 0)
        assert not sides.are_wrong


@pytest.mark.parametrize("exchanged", [[0, 2], [0, 1, 2], [0, 1, 2, 3]])
def test_who_was_founded_with_exchanged_sides_is_put_right(exchanged: list[int]) -> None:
    """They are wrong in the first 0.1 s. All later images were turned round to fit the first ones, for ever."""
    seen, truth_m = filmed(exchanged, until_s=0.1)
    positions_m, events = tracked(seen)
    late = [exchanged_share(position_m, truth_m[frame]) for frame, position_m in positions_m.items() if frame > 30]
    assert len(late) > 100
    assert np.mean(late) < 0.02
    assert events.count("sides exchanged") <= 1


def test_detectors_that_exchange_sides_for_a_while_change_nothing() -> None:
    seen, truth_m = filmed([0, 1, 2], from_s=2.0, until_s=2.5)
    positions_m, events = tracked(seen)
    assert "sides exchanged" not in events
    shares = [exchanged_share(position_m, truth_m[frame]) for frame, position_m in positions_m.items()]
    assert np.mean(shares) < 0.02


@pytest.mark.parametrize("apart_s", [0.0, 0.007])
@pytest.mark.parametrize("exchanged", [[0, 2], [0, 1, 2], [0, 1, 2, 3]])
def test_a_recording_is_right_from_its_first_frame(exchanged: list[int], apart_s: float) -> None:
    seen, truth_m = filmed(exchanged, until_s=0.1, apart_s=apart_s)
    association = associate(seen, RIG)
    assert len(association.people) == 1
    of_person = association.of(0)
    assert not any(event.what == "sides exchanged" for event in association.events)
    time_s = np.broadcast_to(of_person.time_s.reshape(of_person.n_frames, -1), (of_person.n_frames, RIG.n_cameras))
    taken = np.floor(np.nan_to_num(time_s) * FPS + 0.01).astype(int), np.arange(RIG.n_cameras)
    true_px = RIG.project(truth_m)
    off_px, mirrored_px = (
        np.linalg.norm(of_person.points2d_px - each_px[taken], axis=-1)[..., SIDED]
        for each_px in (true_px, true_px[:, :, SKELETON.mirror])
    )
    assert np.isfinite(off_px).mean() > 0.9
    # Where cameras are not of one moment, up to five of the first images stay as they are; it was all or half.
    assert np.nanmean(off_px > mirrored_px) < 0.03
