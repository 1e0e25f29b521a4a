"""Somebody after somebody else, where no image shows more than one person."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from rooms import FPS, body_m, image

from fgpose.association.chosen_person import main_person, ranked
from fgpose.association.recording import associate
from fgpose.association.successive import successive
from fgpose.correspondences import NOBODY
from fgpose.geometry.camera import CameraRig
from fgpose.people_observations import PeopleObservations
from fgpose.skeleton import Skeleton
from fgpose_benchmarks.synthetic import ring_rig

Shown = Callable[[float, int], list[np.ndarray]]
"""Whom a camera shows at a time."""


def recording(rig: CameraRig, skeleton: Skeleton, shown: Shown, duration_s: float) -> PeopleObservations:
    rng, n_frames = np.random.default_rng(0), round(duration_s * FPS)
    images = tuple(
        image(rig, c, t / FPS, shown(t / FPS, c), rng) for t in range(n_frames) for c in range(rig.n_cameras)
    )
    return PeopleObservations(skeleton, rig.names, images)


def relay(gone_s: float, come_s: float, first_m: np.ndarray, second_m: np.ndarray) -> Shown:
    def shown(time_s: float, camera: int) -> list[np.ndarray]:
        return [first_m] if time_s < gone_s else [second_m] if time_s >= come_s else []

    return shown


@pytest.mark.parametrize("come_s", [2.0, 2.3])
def test_somebody_elsewhere_at_once_is_somebody_else(come_s: float, rig: CameraRig, skeleton: Skeleton):
    """Of the same size: nobody is three metres away in no time."""
    here_m, there_m = body_m(skeleton, (0.0, -1.5)), body_m(skeleton, (0.0, 1.5))
    found = successive(recording(rig, skeleton, relay(2.0, come_s, here_m, there_m), 4.5), rig)
    assert found is not None
    assert found.n_people == 2
    (change,) = found.changes
    assert change.is_somebody_else
    assert change.away_m == pytest.approx(3.0, abs=0.05)
    assert (change.before, change.after) == (0, 1)
    assert change.come_s == pytest.approx(come_s, abs=2 / FPS)
    assert "somebody else" in str(change)
    first, second = found.association.people.values()
    assert (first.main_detection[: round(1.9 * FPS)] == 0).all()
    assert second.first_frame >= 2.0 * FPS - 1e-9


def test_a_child_after_an_adult_is_somebody_else_wherever_it_comes(rig: CameraRig, skeleton: Skeleton):
    adult_m, child_m = body_m(skeleton), body_m(skeleton, size=0.6)
    found = successive(recording(rig, skeleton, relay(2.0, 4.0, adult_m, child_m), 6.0), rig)
    assert found is not None
    assert found.n_people == 2
    assert found.changes[0].log_odds < -20


def test_who_comes_back_is_the_same_person(rig: CameraRig, skeleton: Skeleton):
    here_m, near_m = body_m(skeleton), body_m(skeleton, (0.3, 0.2))
    people = recording(rig, skeleton, relay(2.0, 3.5, here_m, near_m), 5.5)
    found = successive(people, rig)
    assert found is None or found.n_people == 1
    chosen = main_person(people, rig)
    assert (chosen.n_people, str(chosen)) == (1, "")
    assert (people.of_person(chosen.seen).seen.any(axis=(1, 2)) == (people.n_showing > 0)).all()


@pytest.mark.parametrize(("turned_deg", "until_s"), [(120.0, 4.5), (180.0, 3.5)])
def test_whom_one_camera_alone_saw_walk_is_nobody_else_when_others_see_them(
    turned_deg: float, until_s: float, rig: CameraRig, skeleton: Skeleton
):
    """Three metres, across its rays and towards it: its track is elsewhere, or still there when all see somebody."""
    ahead = -rig.cameras[0].position_m[:2] / np.linalg.norm(rig.cameras[0].position_m[:2])
    cos, sin = np.cos(np.deg2rad(turned_deg)), np.sin(np.deg2rad(turned_deg))
    along = np.append(np.array([[cos, -sin], [sin, cos]]) @ ahead, 0.0)

    def shown(time_s: float, camera: int) -> list[np.ndarray]:
        walked_m = 3.0 * np.clip((time_s - 2.0) / (until_s - 2.0), 0.0, 1.0) * along
        return [body_m(skeleton) + walked_m] if camera == 0 or not 2.0 <= time_s < until_s else []

    found = successive(recording(rig, skeleton, shown, 8.0), rig)
    for change in () if found is None else found.changes:
        assert change.gone_s <= change.come_s
        assert not change.is_somebody_else


def test_one_person_throughout_is_not_followed_at_all(rig: CameraRig, skeleton: Skeleton):
    told: list[int] = []
    people = recording(rig, skeleton, lambda time_s, camera: [body_m(skeleton, (0.5 * time_s, 0.0))], 2.0)
    assert successive(people, rig, progress=lambda done, of: told.append(done)) is None
    assert told == []


def test_of_two_the_one_who_is_seen_for_longer_is_chosen_and_it_is_said(rig: CameraRig, skeleton: Skeleton):
    here_m, there_m = body_m(skeleton, (0.0, -1.5)), body_m(skeleton, (0.0, 1.5))
    people = recording(rig, skeleton, relay(1.5, 1.8, here_m, there_m), 4.8)
    chosen = main_person(people, rig)
    assert chosen.n_people == 2
    assert (chosen.seen.main_detection[: round(1.5 * FPS)] == NOBODY).all()
    assert (chosen.seen.main_detection[round(1.8 * FPS) :] == 0).all()
    assert str(chosen) == ("one of 2 people: seen most, by 4.0 of 4 cameras for 3.0 s; the next by 4.0 for 1.5 s")


def test_a_reflection_is_not_the_main_person(skeleton: Skeleton):
    """A mirror behind the person: all cameras see both for as long, the reflection listed first."""
    rig = ring_rig(8)
    before = rig.subset([c.name for c in rig.cameras if c.position_m[1] < 0.5])
    person_m = body_m(skeleton, (0.0, 0.3))
    reflected_m = (person_m * [1, -1, 1] + [0, 2 * 1.5, 0])[skeleton.mirror]
    people = recording(before, skeleton, lambda time_s, camera: [reflected_m, person_m], 1.5)
    chosen = main_person(people, before)
    assert chosen.n_people == 2
    assert (chosen.seen.main_detection == 1).all()
    assert chosen.reason.startswith("seen by 5.0 of 5 cameras for 1.5 s, ")
    assert "% larger in the images than the next" in chosen.reason
    sizes = [each.size_rad for each in ranked(associate(people, before))]
    assert sizes[0] > sizes[1]


def test_a_by_stander_nearer_to_the_cameras_is_not_the_main_person(rig: CameraRig, skeleton: Skeleton):
    """Seen for less than four fifths of the time: however near."""
    here_m, by_stander_m = body_m(skeleton), body_m(skeleton, (1.2, 1.2))

    def shown(time_s: float, camera: int) -> list[np.ndarray]:
        return [by_stander_m, here_m] if time_s < 1.0 else [here_m]

    chosen = main_person(recording(rig, skeleton, shown, 2.5), rig)
    assert chosen.n_people == 2
    assert (chosen.seen.main_detection[round(1.1 * FPS) :] == 0).all()
    assert "seen most" in chosen.reason


def test_one_camera_alone_tells_nothing_of_who_comes(rig: CameraRig, skeleton: Skeleton):
    people = recording(rig, skeleton, relay(1.0, 2.0, body_m(skeleton), body_m(skeleton, size=0.6)), 3.0)
    one = rig.subset(rig.names[:1])
    images = tuple(each for each in people.images if each.camera == rig.names[0])
    assert successive(replace(people, camera_names=one.names, images=images), one) is None
