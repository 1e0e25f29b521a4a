from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgpose.assessment.people import evaluate_people
from fgpose.association import matching
from fgpose.association.matching import hand_over
from fgpose.association.pose_filter import PoseFilters
from fgpose.association.recording import associate
from fgpose.correspondences import NOBODY
from fgpose.io.skeletons import load_skeleton
from fgpose.people_observations import Detections
from fgpose.trajectory import Trajectory
from fgpose_benchmarks.accuracy.methods import find_methods
from fgpose_benchmarks.people.ablation import ablations, fixed_gates, no_hand_over
from fgpose_benchmarks.people.methods import METHODS, TOLD
from fgpose_benchmarks.people.recording import PeopleRecording, PeopleResult
from fgpose_benchmarks.people.scores import score_people
from fgpose_benchmarks.people.truth import seen_by, true_association
from fgpose_benchmarks.synthetic import CrowdErrors, DetectionNoise
from tests.benchmarks.people.passing_people import changed, passing, recorded

MESS = CrowdErrors(
    missed_share=0.05, doubled_share=0.1, flipped_share=0.2, grabbed_share=1.0, false_people=0.5, min_visible_joints=1
)


def test_told_who_is_who_each_has_the_joints_that_are_theirs():
    recording = recorded(passing(), 4, MESS)
    known = true_association(recording)
    assert sorted(known.people) == [0, 1, 2]
    for person, seen in known.people.items():
        time_s = recording.frames.frame_time_s[seen.frames]
        true_px = recording.rig.project(recording.scene.truth(time_s)[person].positions_m)
        own_px = known.of(person).points2d_px
        given = seen.detection != NOBODY
        assert given.mean() > 0.7
        np.testing.assert_array_equal(given, np.isfinite(own_px).all(axis=-1))
        # Neither joints of others nor left for right; without noise the rest is exact.
        np.testing.assert_allclose(own_px[given], true_px[given], atol=1e-6)


def test_every_joint_that_shows_a_person_is_given_to_one_of_their_detections():
    recording = recorded(passing(), 4, replace(MESS, doubled_share=0.0))
    known = true_association(recording)
    shown = sum(
        int((joint_of == who[:, None])[who >= 0].sum())
        for joint_of, who in zip(recording.scene.joint_of, recording.scene.who, strict=True)
    )
    assert sum(int((seen.detection != NOBODY).sum()) for seen in known.people.values()) == shown


@pytest.mark.parametrize("name", ["fgpose batch", "fgpose online", "told who is who"])
def test_fgpose_finds_everybody_in_noisy_detections(name: str):
    recording = recorded(passing(2, 18), 3, noise=DetectionNoise())
    (method,) = find_methods([name], METHODS)
    score = score_people(recording, method.solve(recording), method)
    assert (score.method, score.group) == (name, "oracle" if method is TOLD else "ours")
    # Online, people are reported once they are confirmed, 0.1 to 0.3 s after the start of these 0.6 s.
    assert score.recall > (0.5 if name == "fgpose online" else 0.99)
    assert score.precision == 1.0
    assert (score.n_identities, score.switches) == (2, 0)
    # Detections are off by 5 px, 3 cm at 5 m and 850 px, in three views.
    assert 5 < score.mpjpe_mm < 60
    assert score.ms_per_frame > 0


def swapped(recording_truth: dict[int, Trajectory], frame: int) -> dict[int, Trajectory]:
    first, second = (recording_truth[n].positions_m for n in (0, 1))
    exchanged = [np.concatenate([a[:frame], b[frame:]]) for a, b in ((first, second), (second, first))]
    return {n: replace(recording_truth[n], positions_m=positions_m) for n, positions_m in enumerate(exchanged)}


def test_scores_are_those_of_the_protocol_and_rates_are_per_person_and_minute():
    recording = recorded(passing(2, 61), 3)
    result = PeopleResult(swapped(recording.truth, 20), 0.61)
    score = score_people(recording, result, TOLD)
    plain = evaluate_people(result.people, recording.truth)
    for name in ("recall", "precision", "f1", "mota", "idf1", "hota", "mpjpe_mm", "pcp", "wrong_person"):
        assert getattr(score, name) == getattr(plain, name)
    # Each of two people changes identity once, in 61 frames of 1/30 s.
    assert score.switches == pytest.approx(1 / (61 / 30 / 60))
    assert score.ms_per_frame == pytest.approx(10.0)


def test_people_are_seen_by_the_cameras_that_detect_them():
    recording = recorded(passing(2, 12), 3)
    assert all(seen.all() for seen in seen_by(3, recording).values())
    third_s = recording.frames.frame_time_s[2]

    def later(image: Detections) -> Detections:
        keep = image.camera == "ring_0" or image.time_s >= third_s
        n = image.n_people if keep else 0
        return Detections(image.camera, image.time_s, image.points2d_px[:n], image.confidence[:n])

    cut = changed(recording, later)
    who = tuple(who[: image.n_people] for who, image in zip(cut.scene.who, cut.scene.observations.images, strict=True))
    cut = replace(cut, scene=replace(cut.scene, who=who))
    for seen in seen_by(2, cut).values():
        assert seen.tolist() == [False] * 2 + [True] * 10
    assert not any(seen.any() for seen in seen_by(4, recording).values())


def test_arrivals_passes_and_false_tracks_are_counted():
    """Both are found six frames late; the first two pass at 0.6 m; somebody is made up for 0.4 s."""
    recording = recorded(passing(2, 61), 3)
    late = {person: trajectory.positions_m.copy() for person, trajectory in recording.truth.items()}
    for positions_m in late.values():
        positions_m[:6] = np.nan
    late[7] = np.full_like(late[0], np.nan)
    late[7][20:32] = recording.truth[0].positions_m[20:32] + np.array([2.5, 0.0, 0.0])
    result = PeopleResult({n: replace(recording.truth[0], positions_m=each) for n, each in late.items()}, 0.61)
    score = score_people(recording, result, TOLD)
    assert score.confirmed_s == pytest.approx((0.2, 0.2))
    assert (score.n_unconfirmed, score.n_arrivals, score.n_mistaken) == (0, 0, 0)
    assert (score.n_short_returns, score.n_long_returns) == (0, 0)
    assert (score.n_passes, score.n_close_passes, score.pass_switches, score.close_switches) == (1, 0, 0, 0)
    assert score.false_tracks_s == pytest.approx((12 / 30,))
    assert (score.minutes, score.person_minutes) == pytest.approx((61 / 30 / 60, 2 * 61 / 30 / 60))


@pytest.mark.parametrize(("away_s", "kind"), [(4.0, "short"), (6.0, "long")])
def test_returns_after_five_seconds_are_counted_apart(away_s: float, kind: str):
    n_frames, motion = round((away_s + 3) * 30), passing(2, 2)
    truth_m = np.repeat(motion.truth_m[:, :1], n_frames, axis=1)
    truth_m[1, 30 : n_frames - 60] = np.nan
    recording = recorded(replace(motion, truth_m=truth_m), 3)
    score = score_people(recording, PeopleResult(recording.truth, 1.0), TOLD)
    counts = {"short": (score.n_short_returns, score.n_short_recognised)}
    counts["long"] = (score.n_long_returns, score.n_long_recognised)
    assert counts.pop(kind) == (1, 1)
    assert list(counts.values()) == [(0, 0)]
    assert (score.n_arrivals, score.n_mistaken) == (1, 0)


def n_regrouped(recording: PeopleRecording) -> int:
    """Joints that do not stay with the detection of which most joints are."""
    people = associate(recording.observations, recording.rig).people.values()
    return sum(
        int(((seen.detection != NOBODY) & (seen.detection != seen.main_detection[..., None])).sum()) for seen in people
    )


def with_exchanged_wrists(image: Detections) -> Detections:
    """The first camera gives each of two people the right wrist of the other."""
    if image.camera != "ring_0":
        return image
    wrist = load_skeleton("h36m_17").index("right_wrist")
    points2d_px = image.points2d_px.copy()
    points2d_px[:, wrist] = points2d_px[::-1, wrist]
    return Detections(image.camera, image.time_s, points2d_px, image.confidence)


def test_without_hand_over_detections_stay_whole():
    recording = changed(recorded(passing(2), 3), with_exchanged_wrists)
    assert n_regrouped(recording) > 0
    with no_hand_over():
        assert n_regrouped(recording) == 0
        people = associate(recording.observations, recording.rig).people.values()
        for seen in people:
            whole = [
                len(set(of_image.tolist()) - {NOBODY}) <= 1 for of_frame in seen.detection for of_image in of_frame
            ]
            assert all(whole)
    assert matching.hand_over is hand_over


def test_fixed_gates_do_not_depend_on_the_prediction():
    recording = recorded(passing(1, 2), 3)
    truth_m = recording.scene.motion.truth_m[0, 0]
    people = PoseFilters.at(0.0, truth_m, np.tile(0.01 * np.eye(3), (len(truth_m), 1, 1)))
    vague = replace(people, covariance=10 * people.covariance)

    def gates() -> list[np.ndarray]:
        return [each.seen_by(recording.rig, np.zeros(3)).covariance_px2 for each in (people, vague)]

    narrow, wide = gates()
    assert (np.linalg.det(wide) > 4 * np.linalg.det(narrow)).all()
    with fixed_gates():
        for gate in gates():
            np.testing.assert_array_equal(gate, np.broadcast_to(400 * np.eye(2), narrow.shape))
    np.testing.assert_array_equal(gates()[0], narrow)


def test_without_recognition_nobody_comes_back():
    motion = passing(1, 75)
    truth_m = motion.truth_m.copy()
    truth_m[:, 30:60] = np.nan
    gone = recorded(replace(motion, truth_m=truth_m), 3)
    forgets = {"as it is": 1, "no recognition": 2}
    for method in find_methods(list(forgets), ablations()):
        found = method.solve(gone)
        assert len(found.people) == forgets[method.name], method.name


def test_every_ablation_is_beside_the_one_that_is_told():
    assert [method.name for method in ablations()] == [
        "as it is",
        "fixed gates",
        "no hand-over of joints",
        "no recognition",
        "told who is who",
    ]
